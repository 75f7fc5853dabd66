"""What a MAVLink link loses, by the sequence numbers of its messages."""

from array import array
from collections import OrderedDict
from dataclasses import dataclass, field

_MODULUS = 256
_REORDERED = 128
"""A number that is so far behind the newest is an older message, not a loss of more."""
_JUMP = 64
"""More messages missing than this at once are a jump: a sender that began anew, or a long gap."""
_MOST_SENDERS = 512
"""Components whose sequence is followed at once; of more, those heard from last."""


@dataclass(slots=True)
class Sequence:
    """Messages of one component of one system.

    Attributes:
        received: How many came, duplicates left out.
        lost: How many are missing between them.
        duplicates: How many came twice.
        reordered: How many came after a later one.
        jumps: How often the number jumped; what is missing then is not known, and not counted.
    """

    received: int = 0
    lost: int = 0
    duplicates: int = 0
    reordered: int = 0
    jumps: int = 0
    _newest: int = -1
    _seen: "array[int]" = field(default_factory=lambda: array("q"))
    """By number, how many messages had been sent when it was last seen."""
    _checksums: "array[int]" = field(default_factory=lambda: array("H"))
    """By number, the checksum of the message."""
    _count: int = 0

    def add(self, number: int, checksum: int) -> bool:
        """Count a message; returns whether it came before: with this number, and the same."""
        if self._newest < 0:
            self._seen = array("q", [-_MODULUS]) * _MODULUS
            self._checksums = array("H", [0]) * _MODULUS
            return self._advance(number, 1, checksum)
        ahead = (number - self._newest) % _MODULUS
        if 0 < ahead < _REORDERED:
            if ahead > _JUMP:
                self.jumps += 1
            else:
                self.lost += ahead - 1
            return self._advance(number, ahead, checksum)
        back = self._count - (_MODULUS - ahead) % _MODULUS
        if self._seen[number] == back and self._checksums[number] == checksum:
            self.duplicates += 1
            return True
        self.received += 1
        self.reordered += 1
        self.lost = max(self.lost - 1, 0)
        self._seen[number], self._checksums[number] = back, checksum
        return False

    def _advance(self, number: int, by: int, checksum: int) -> bool:
        self._newest, self._count = number, self._count + by
        self._seen[number], self._checksums[number] = self._count, checksum
        self.received += 1
        return False

    def count(self, other: "Sequence") -> None:
        """Add the counts of another sequence."""
        self.received += other.received
        self.lost += other.lost
        self.duplicates += other.duplicates
        self.reordered += other.reordered
        self.jumps += other.jumps


@dataclass(slots=True)
class Link:
    """All that came over one link, by system and component.

    Attributes:
        sequences: Those heard from last, at most 512: forged senders take a bounded memory.
    """

    sequences: OrderedDict[tuple[int, int], Sequence] = field(default_factory=OrderedDict)
    _left: dict[int, Sequence] = field(default_factory=dict)

    @property
    def systems(self) -> set[int]:
        """Ids of all systems that sent anything."""
        return {system for system, _ in self.sequences} | set(self._left)

    def add(self, system: int, component: int, number: int, checksum: int) -> bool:
        """Count a message; returns whether it came before."""
        key = system, component
        one = self.sequences.get(key)
        if one is None:
            one = self.sequences[key] = Sequence()
            if len(self.sequences) > _MOST_SENDERS:
                (owner, _), old = self.sequences.popitem(last=False)
                self._left.setdefault(owner, Sequence()).count(old)
        else:
            self.sequences.move_to_end(key)
        return one.add(number, checksum)

    def of(self, system: int) -> Sequence:
        """Sums over the components of a system."""
        total = Sequence()
        if system in self._left:
            total.count(self._left[system])
        for (owner, _), one in self.sequences.items():
            if owner == system:
                total.count(one)
        return total
