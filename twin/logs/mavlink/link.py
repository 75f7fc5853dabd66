"""What a MAVLink link loses, by the sequence numbers of its messages."""

from dataclasses import dataclass, field

_MODULUS = 256
_REORDERED = 128
"""A number that is so far behind the newest is an older message, not a loss of more."""
_JUMP = 64
"""More messages missing than this at once are a jump: a sender that began anew, or a long gap."""


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
    _seen: list[tuple[int, int]] = field(default_factory=list)
    """By number, how many messages had been sent when it was last seen, and its checksum."""
    _count: int = 0

    def add(self, number: int, checksum: int) -> bool:
        """Count a message; returns whether it came before: with this number, and the same."""
        if self._newest < 0:
            self._seen = [(-_MODULUS, 0)] * _MODULUS
            return self._advance(number, 1, checksum)
        ahead = (number - self._newest) % _MODULUS
        if 0 < ahead < _REORDERED:
            if ahead > _JUMP:
                self.jumps += 1
            else:
                self.lost += ahead - 1
            return self._advance(number, ahead, checksum)
        back = self._count - (_MODULUS - ahead) % _MODULUS
        if self._seen[number] == (back, checksum):
            self.duplicates += 1
            return True
        self.received += 1
        self.reordered += 1
        self.lost = max(self.lost - 1, 0)
        self._seen[number] = back, checksum
        return False

    def _advance(self, number: int, by: int, checksum: int) -> bool:
        self._newest, self._count = number, self._count + by
        self._seen[number] = self._count, checksum
        self.received += 1
        return False


@dataclass(slots=True)
class Link:
    """All that came over one link, by system and component."""

    sequences: dict[tuple[int, int], Sequence] = field(default_factory=dict)

    def add(self, system: int, component: int, number: int, checksum: int) -> bool:
        """Count a message; returns whether it came before."""
        one = self.sequences.setdefault((system, component), Sequence())
        return one.add(number, checksum)

    def of(self, system: int) -> Sequence:
        """Sums over the components of a system."""
        total = Sequence()
        for (owner, _), one in self.sequences.items():
            if owner == system:
                total.received += one.received
                total.lost += one.lost
                total.duplicates += one.duplicates
                total.reordered += one.reordered
                total.jumps += one.jumps
        return total
