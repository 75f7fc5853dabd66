"""Datagrams -> messages of one aircraft, and the counts of all that came."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from twin.logs.mavlink.dialect import BAD, GCS, Message, dialect, parser
from twin.logs.mavlink.link import Link, Sequence
from twin.logs.mavlink.tlog import checksum_of
from twin.logs.mavlink.unpacked import unpacked

Sender = tuple[str, int]
_MOST_SENDERS = 64
"""Of which what they send is taken apart: one that makes up addresses fills no memory."""


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
        others: Messages of other systems, or of the same id from elsewhere, by who sent them.
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
    _parsers: dict[Sender, Any] = field(default_factory=dict)

    @property
    def sequence(self) -> Sequence:
        """Counts of the aircraft's messages."""
        return Sequence() if self.system is None else self.link.of(self.system)

    def messages(self, datagram: bytes, sender: Sender) -> Iterator[Received]:
        """Messages of the aircraft in a datagram, those that came before left out."""
        self.datagrams += 1
        self.octets += len(datagram)
        if sender not in self._parsers:
            if len(self._parsers) >= _MOST_SENDERS:
                self.others["more senders than are listened to"] += 1
                return
            self._parsers[sender] = parser()
        reader, found = self._parsers[sender], unpacked(datagram)
        if found is None:
            found = [(m, bytes(m.get_msgbuf())) for m in reader.parse_buffer(datagram) or ()]
            self._drop_rest(reader)
        for message, frame in found:
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

    def _drop_rest(self, reader: Any) -> None:
        """A frame does not go on in the next datagram."""
        if left := reader.buf_len():
            self.garbage += left
            reader.buf, reader.buf_index = bytearray(), 0
            reader.expected_length = dialect.HEADER_LEN_V1 + 2

    def _count_bad(self, content: bytes) -> None:
        if content and content[0] in (dialect.PROTOCOL_MARKER_V1, dialect.PROTOCOL_MARKER_V2):
            self.wrong += 1
        else:
            self.garbage += len(content)

    def _is_of_the_aircraft(self, message: Message, sender: Sender) -> bool:
        system = message.get_srcSystem()
        if message.get_type() == "HEARTBEAT" and message.type == GCS:
            self.others[f"ground station, system {system}"] += 1
            return False
        if self.sender is None and self.system in (None, system) and _is_vehicle(message):
            self.system, self.sender = system, sender
        if self.sender is None:
            return False
        if system != self.system:
            self.others[f"system {system} at {sender[0]}:{sender[1]}"] += 1
            return False
        if sender != self.sender and not (self.silent and sender[0] == self.sender[0]):
            self.others[f"system {system} again, at {sender[0]}:{sender[1]}"] += 1
            return False
        if sender != self.sender:
            self.sender = sender  # of the same machine, after a silence
        return True


def _is_vehicle(message: Message) -> bool:
    """Whether a message is one of an aircraft, not of what stands on the ground.

    One of an unknown kind has no checksum that could be tested: random bytes look like it.
    """
    kind = message.get_type()
    known = not kind.startswith("UNKNOWN")
    return bool(message.get_srcSystem()) and known and kind != "TIMESYNC"
