"""MAVLink frames: the dialect, telemetry logs, datagrams, losses of a link, and the one parser of
files and streams.

The dialect is pymavlink's `ardupilotmega`: `common` and the additions of ArduPilot, which include
rotor speeds from speed controllers. ESC_STATUS of `common` is in no dialect of pymavlink 2.4.50.
"""

import re
import struct
from array import array
from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache
from operator import itemgetter
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega

dialect: Any = ardupilotmega
Message = Any
"""A message of pymavlink: its fields are attributes, `get_type()` returns its name."""
MARKERS = (dialect.PROTOCOL_MARKER_V1, dialect.PROTOCOL_MARKER_V2)
"""First bytes of a frame of MAVLink 1 and 2."""
GCS = dialect.MAV_TYPE_GCS  # MAV_TYPE of a ground station
AUTOPILOT = dialect.MAV_COMP_ID_AUTOPILOT1  # component id
BAD = "BAD_DATA"
"""Name of an invalid message in pymavlink."""
MOTORS = {
    dialect.MAV_TYPE_TRICOPTER: 3,
    dialect.MAV_TYPE_QUADROTOR: 4,
    dialect.MAV_TYPE_HEXAROTOR: 6,
    dialect.MAV_TYPE_OCTOROTOR: 8,
    dialect.MAV_TYPE_DECAROTOR: 10,
    dialect.MAV_TYPE_DODECAROTOR: 12,
}
"""Number of motors by the type in the heartbeat."""
TYPES = {count: kind for kind, count in MOTORS.items()}  # MAV_TYPE by motors
PHASES = {
    dialect.MAV_LANDED_STATE_ON_GROUND: "ground",
    dialect.MAV_LANDED_STATE_TAKEOFF: "takeoff",
    dialect.MAV_LANDED_STATE_LANDING: "land",
}
"""Phase of flight by the state of the land detector (EXTENDED_SYS_STATE.landed_state)."""
AUTOPILOTS = {  # names by MAV_AUTOPILOT
    dialect.MAV_AUTOPILOT_PX4: "PX4",
    dialect.MAV_AUTOPILOT_ARDUPILOTMEGA: "ArduPilot",
    dialect.MAV_AUTOPILOT_GENERIC: "generic autopilot",
}


def parser(system: int = 0, component: int = 0) -> Any:
    """A parser and packer of frames that continues after invalid bytes.

    Args:
        system: Own system id, for messages that are packed.
        component: Own component id.
    """
    made = dialect.MAVLink(None, system, component)
    made.robust_parsing = True
    return made


def packed(message: Message, packer: Any) -> bytes:
    """The frame of a message, with the next sequence number of its sender, a `parser`."""
    frame = bytes(message.pack(packer))
    packer.seq = (packer.seq + 1) % _MODULUS
    return frame


# -- telemetry logs -----------------------------------------------------------------------------
#
# Telemetry logs (.tlog) of ground stations: the time of arrival before each MAVLink frame.
#
# The time is in us since 1970, 8 bytes, big-endian.

_STAMP = struct.Struct(">Q")  # us since 1970
_HEAD = _STAMP.size  # size of the stamp, bytes
_YEAR_2000_US, _YEAR_2100_US = 946_684_800_000_000, 4_102_444_800_000_000  # us since 1970
_DAY_US = 86_400_000_000  # largest interval between stamps of one log
_V1 = MARKERS[0]  # first byte of MAVLink 1
_SIGNATURE = 13  # bytes at the end of a signed frame
_BEGIN = re.compile(rb"(?s)(?=\x00[\x03-\x0e].{6}[\xfd\xfe])")
"""First two bytes of a stamp of the years 2000 to 2100, and the first byte of a frame."""


def checksum_of(frame: bytes) -> int:
    """The last bytes of a frame: its checksum, or the end of its signature."""
    return int.from_bytes(frame[-2:], "little")


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame.

    Attributes:
        arrival_us: Time of arrival, us since 1970.
        content: Bytes of the frame.
        system: System id of the sender.
        component: Component id of the sender.
        number: Sequence number.
        kind: Message id.
    """

    arrival_us: int
    content: bytes
    system: int
    component: int
    number: int
    kind: int

    @property
    def checksum(self) -> int:
        """Last bytes of the frame, as in `checksum_of`."""
        return checksum_of(self.content)


def stamped(arrival_us: int, frame: bytes) -> bytes:
    """A frame as stored in a telemetry log."""
    return _STAMP.pack(arrival_us) + frame


def frames(blob: bytes) -> Iterator[Frame | int]:
    """Frames of a telemetry log, and the numbers of invalid bytes between them."""
    at, before, lost = 0, None, 0
    while at < len(blob):
        length = _length(blob, at + _HEAD) if _begins(blob, at, before) else 0
        end = at + _HEAD + length
        if not length or end > len(blob) or not (end == len(blob) or _follows(blob, end)):
            found = _BEGIN.search(blob, at + 1)
            begin = len(blob) if found is None else found.start()
            at, lost = begin, lost + begin - at
            continue
        if lost:
            yield lost
            lost = 0
        (before,) = _STAMP.unpack_from(blob, at)
        yield _frame(before, blob[at + _HEAD : end])
        at = end
    if lost:
        yield lost


def _frame(arrival_us: int, content: bytes) -> Frame:
    if content[0] == _V1:
        number, system, component, kind = content[2:6]
    else:
        number, system, component = content[4:7]
        kind = int.from_bytes(content[7:10], "little")
    return Frame(arrival_us, content, system, component, number, kind)


def _begins(blob: bytes, at: int, before: int | None) -> bool:
    """Whether a time near the previous one and the first byte of a frame are at this offset."""
    if len(blob) < at + _HEAD + 1 or blob[at + _HEAD] not in MARKERS:
        return False
    (stamp,) = _STAMP.unpack_from(blob, at)
    if not _YEAR_2000_US < stamp < _YEAR_2100_US:
        return False
    return before is None or abs(stamp - before) < _DAY_US


def _follows(blob: bytes, at: int) -> bool:
    """Whether another frame begins at this offset, as far as the file goes."""
    if len(blob) < at + _HEAD + 1:
        return True
    (stamp,) = _STAMP.unpack_from(blob, at)
    return blob[at + _HEAD] in MARKERS and _YEAR_2000_US < stamp < _YEAR_2100_US


def _length(blob: bytes, at: int) -> int:
    """Size of the frame at this offset, bytes; 0 where its head is incomplete."""
    if len(blob) < at + 3:
        return 0
    payload = blob[at + 1]
    if blob[at] == _V1:
        return int(payload + dialect.HEADER_LEN_V1 + 2)
    signed = blob[at + 2] & dialect.MAVLINK_IFLAG_SIGNED
    return int(payload + dialect.HEADER_LEN_V2 + 2 + (_SIGNATURE if signed else 0))


# -- datagrams ----------------------------------------------------------------------------------
#
# Fast parser of MAVLink 2 datagrams: one unpacking per frame.
#
# pymavlink processes a datagram byte by byte and creates an object for every field of every
# message, which is most of the cost of listening. Complete frames of known kinds with numeric
# fields are parsed here; pymavlink parses all else: text, signatures, MAVLink 1, damage.

_HEADER = struct.Struct("<BBBBBBBHB")  # of MAVLink 2
_CHECKSUM_SIZE = 2  # bytes
_KIND = struct.Struct("<HB")  # message id, 24 bits
_MARKER = MARKERS[1]  # first byte of MAVLink 2


class Unpacked(tuple[Any, ...]):
    """A message: header and payload, in the order of the wire; its fields are attributes.

    It has those methods of a pymavlink message that are used here.
    """

    __slots__ = ()
    kind = ""

    def get_type(self) -> str:
        """Name of the message."""
        return self.kind

    def get_seq(self) -> int:
        """Sequence number."""
        return int(self[4])

    def get_srcSystem(self) -> int:  # noqa: N802
        """System id of the sender."""
        return int(self[5])

    def get_srcComponent(self) -> int:  # noqa: N802
        """Component id of the sender."""
        return int(self[6])


def unpacked(datagram: bytes) -> list[tuple[Message, bytes]] | None:
    """Messages of a datagram with their frames; None where pymavlink has to parse it."""
    found, at, end = [], 0, len(datagram)
    while at < end:
        if end - at < _HEADER.size or datagram[at] != _MARKER or datagram[at + 2]:
            return None
        last = at + _HEADER.size + datagram[at + 1] + _CHECKSUM_SIZE
        low, high = _KIND.unpack_from(datagram, at + 7)
        made = _made(low | high << 16)
        if last > end or made is None:
            return None
        extra, whole, message = made
        frame = datagram[at:last]
        if dialect.x25crc(frame[1:-_CHECKSUM_SIZE] + extra).crc != checksum_of(frame):
            return None
        content = frame[:-_CHECKSUM_SIZE].ljust(whole.size, b"\0")  # trailing zeros are not sent
        found.append((message(whole.unpack_from(content)), frame))
        at = last
    return found


@cache
def _made(kind: int) -> tuple[bytes, struct.Struct, type[Unpacked]] | None:
    """Checksum prefix, layout and class of a kind of message."""
    about = dialect.mavlink_map.get(kind)
    if about is None or "s" in about.unpacker.format:
        return None
    fields, at = {}, len(_HEADER.unpack(bytes(_HEADER.size)))
    for name, length in zip(about.ordered_fieldnames, about.lengths, strict=True):
        where = at if length == 1 else slice(at, at + length)
        fields[name] = property(itemgetter(where))
        at += length
    layout = struct.Struct(_HEADER.format + about.unpacker.format.removeprefix("<"))
    own = {"__slots__": (), "kind": about.msgname, **fields}
    return bytes([about.crc_extra]), layout, type(about.msgname, (Unpacked,), own)


# -- losses of a link ---------------------------------------------------------------------------
#
# Losses of a MAVLink link, by the sequence numbers of its messages.

_MODULUS = 256  # modulus of 8-bit sequence numbers
_REORDERED = 128
"""Distance behind the newest number from which it is an older message, not a loss."""
_JUMP = 64
"""Largest number of missing messages; more are a jump: a sender that restarted, or a long gap."""
_MOST_SENDERS = 512
"""Largest number of components whose sequence is tracked; of more, the most recent ones."""


@dataclass(slots=True)
class Sequence:
    """Counts of the messages of one component of one system.

    Attributes:
        received: Number of messages received, without duplicates.
        lost: Number of messages missing in the sequence.
        duplicates: Number of messages received twice.
        reordered: Number of messages received after a later one.
        jumps: Number of jumps of the sequence number; messages missing in a jump are unknown and
            not counted.
    """

    received: int = 0
    lost: int = 0
    duplicates: int = 0
    reordered: int = 0
    jumps: int = 0
    _newest: int = -1
    _sent_at: "array[int]" = field(default_factory=lambda: array("q"))
    """Number of messages sent when a sequence number was last received, by number."""
    _checksums: "array[int]" = field(default_factory=lambda: array("H"))
    """Checksum of the last message with a sequence number, by number."""
    _count: int = 0

    def add(self, number: int, checksum: int) -> bool:
        """Count a message; returns whether it is a duplicate: same number and same checksum."""
        if self._newest < 0:
            self._sent_at = array("q", [-_MODULUS]) * _MODULUS
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
        if self._sent_at[number] == back and self._checksums[number] == checksum:
            self.duplicates += 1
            return True
        self.received += 1
        self.reordered += 1
        self.lost = max(self.lost - 1, 0)
        self._sent_at[number], self._checksums[number] = back, checksum
        return False

    def _advance(self, number: int, by: int, checksum: int) -> bool:
        self._newest, self._count = number, self._count + by
        self._sent_at[number], self._checksums[number] = self._count, checksum
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
class LinkCounts:
    """Counts of all messages of one link, by system and component.

    Attributes:
        sequences: Counts of the most recent 512 senders, so that forged senders use bounded memory.
    """

    sequences: OrderedDict[tuple[int, int], Sequence] = field(default_factory=OrderedDict)
    _left: dict[int, Sequence] = field(default_factory=dict)

    @property
    def systems(self) -> set[int]:
        """Ids of all senders."""
        return {system for system, _ in self.sequences} | set(self._left)

    def add(self, system: int, component: int, number: int, checksum: int) -> bool:
        """Count a message; returns whether it is a duplicate."""
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


# -- one parser for files and streams -----------------------------------------------------------


@dataclass(slots=True)
class MessageParser:
    """Parser of the bytes of a link.

    A telemetry log is pushed frame by frame, a live link datagram by datagram. A frame must be
    complete in one push: no state is stored per sender.

    Attributes:
        link: Counts by sequence number.
        garbage: Number of bytes that belong to no message.
        wrong: Number of frames with wrong checksum or length.
        version_1: Number of messages of MAVLink 1.
        repeated: Number of duplicates, which are dropped.
    """

    link: LinkCounts = field(default_factory=LinkCounts)
    garbage: int = 0
    wrong: int = 0
    version_1: int = 0
    repeated: int = 0

    def push(
        self, content: bytes, accepts: Callable[[Message], bool] = lambda _: True
    ) -> Iterator[tuple[Message, bytes]]:
        """Messages of complete frames, with the frames; duplicates are dropped.

        Args:
            content: Bytes of complete frames.
            accepts: Whether a message belongs to the link; others are not counted.
        """
        for message, frame in self._taken_apart(content):
            if message.get_type() == BAD:
                self._count_bad(frame)
            elif accepts(message):
                sender = message.get_srcSystem(), message.get_srcComponent()
                if self.link.add(*sender, message.get_seq(), checksum_of(frame)):
                    self.repeated += 1
                    continue
                self.version_1 += frame[0] == dialect.PROTOCOL_MARKER_V1
                yield message, frame

    def _taken_apart(self, content: bytes) -> list[tuple[Message, bytes]]:
        found = unpacked(content)
        if found is None:
            reader = parser()
            found = [(m, bytes(m.get_msgbuf())) for m in reader.parse_buffer(content) or ()]
            self.garbage += reader.buf_len()
        return found

    def _count_bad(self, content: bytes) -> None:
        if content and content[0] in MARKERS:
            self.wrong += 1
        else:
            self.garbage += len(content)
