"""Datagrams -> messages of one aircraft, and the counts of all that came."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

from twin.logs.mavlink.frames import (
    BAD,
    GCS,
    Link,
    Message,
    Sequence,
    checksum_of,
    dialect,
    parser,
    unpacked,
)

Sender = tuple[str, int]
_MOST_OTHERS = 32
"""Other senders that are listed by name; messages of more are counted together."""
MORE_OTHERS = "further senders"
_FEW = 10
"""A sender of fewer messages that is silent gives its place to the next aircraft."""


@dataclass(frozen=True, slots=True)
class Received:
    """A message of the aircraft.

    Attributes:
        message: The message.
        frame: Its bytes.
    """

    message: Message
    frame: bytes


@dataclass(slots=True)
class Receiver:
    """Takes datagrams apart and keeps to one aircraft.

    Attributes:
        system: System id of the aircraft; None: the first one that is heard.
        sender: Where its messages come from; None: nothing came yet.
        datagrams: How many came.
        octets: How many bytes.
        garbage: Bytes that are no message.
        wrong: Frames whose checksum or length is wrong.
        version_1: Messages of MAVLink 1.
        others: Messages of other systems, or of the same id from elsewhere, by who sent them: the
            first 32, and `MORE_OTHERS`.
        link: Sequence numbers.
        silent: Whether the aircraft has not been heard for a while, and may send from another port.
    """

    system: int | None = None
    sender: Sender | None = None
    datagrams: int = 0
    octets: int = 0
    garbage: int = 0
    wrong: int = 0
    version_1: int = 0
    others: Counter[str] = field(default_factory=Counter)
    link: Link = field(default_factory=Link)
    silent: bool = False
    _wanted: int | None = field(init=False)

    def __post_init__(self) -> None:
        self._wanted = self.system

    @property
    def sequence(self) -> Sequence:
        """Counts of the aircraft's messages."""
        return Sequence() if self.system is None else self.link.of(self.system)

    def messages(self, datagram: bytes, sender: Sender) -> Iterator[Received]:
        """Messages of the aircraft in a datagram, those that came before left out."""
        self.datagrams += 1
        self.octets += len(datagram)
        for message, frame in self._taken_apart(datagram):
            if message.get_type() == BAD:
                self._count_bad(frame)
            elif self._is_of_the_aircraft(message, sender) and not self.link.add(
                message.get_srcSystem(),
                message.get_srcComponent(),
                message.get_seq(),
                checksum_of(frame),
            ):
                self.version_1 += frame[0] == dialect.PROTOCOL_MARKER_V1
                yield Received(message, frame)

    def _taken_apart(self, datagram: bytes) -> list[tuple[Message, bytes]]:
        """Messages of a datagram with their frames.

        A frame does not go on in the next datagram: nothing is kept of a sender.
        """
        found = unpacked(datagram)
        if found is None:
            reader = parser()
            found = [(m, bytes(m.get_msgbuf())) for m in reader.parse_buffer(datagram) or ()]
            self.garbage += reader.buf_len()
        return found

    def _count_bad(self, content: bytes) -> None:
        if content and content[0] in (dialect.PROTOCOL_MARKER_V1, dialect.PROTOCOL_MARKER_V2):
            self.wrong += 1
        else:
            self.garbage += len(content)

    def _is_of_the_aircraft(self, message: Message, sender: Sender) -> bool:
        system = message.get_srcSystem()
        if message.get_type() == "HEARTBEAT" and message.type == GCS:
            return self._is_other(f"ground station, system {system}")
        if self.silent and self.sender != sender and self.sequence.received < _FEW:
            self.system, self.sender = self._wanted, None  # what was heard first was no aircraft
        if self.sender is None and self.system in (None, system) and _is_vehicle(message):
            self.system, self.sender = system, sender
        if self.sender is None:
            return False
        if system != self.system:
            return self._is_other(f"system {system} at {sender[0]}:{sender[1]}")
        if sender != self.sender and not (self.silent and sender[0] == self.sender[0]):
            return self._is_other(f"system {system} again, at {sender[0]}:{sender[1]}")
        if sender != self.sender:
            self.sender = sender  # of the same machine, after a silence
        return True

    def _is_other(self, who: str) -> bool:
        """Count a message that is not of the aircraft."""
        known = who in self.others or len(self.others) < _MOST_OTHERS
        self.others[who if known else MORE_OTHERS] += 1
        return False


def _is_vehicle(message: Message) -> bool:
    """Whether a message is one of an aircraft, not of what stands on the ground.

    One of an unknown kind has no checksum that could be tested: random bytes look like it.
    """
    kind = message.get_type()
    known = not kind.startswith("UNKNOWN")
    return bool(message.get_srcSystem()) and known and kind != "TIMESYNC"
