"""Datagrams taken apart in one go say what pymavlink says of them, or nothing."""

import struct
from typing import Any

import numpy as np
import pytest

from twin.logs.mavlink.decoder import USED, MavlinkDecoder
from twin.logs.mavlink.encode import heartbeat, messages_of
from twin.logs.mavlink.frames import AUTOPILOT, BAD, Message, dialect, parser, unpacked

NUMBERS = sorted(k for k, v in dialect.mavlink_map.items() if "s" not in v.unpacker.format)


def frame_of(kind: int, payload: bytes, seq: int = 7) -> bytes:
    """A frame as it is sent: zeros at its end are not."""
    about = dialect.mavlink_map[kind]
    payload = payload.rstrip(b"\0") or b"\0"
    head = bytes([len(payload), 0, 0, seq, 3, AUTOPILOT]) + kind.to_bytes(3, "little")
    checksum = dialect.x25crc(head + payload + bytes([about.crc_extra])).crc
    return bytes([dialect.PROTOCOL_MARKER_V2]) + head + payload + struct.pack("<H", checksum)


def content(message: Message) -> tuple[Any, ...]:
    """All that a message says; NaN as text."""
    names = dialect.mavlink_map[dialect.__dict__[f"MAVLINK_MSG_ID_{message.get_type()}"]].fieldnames
    fields = [getattr(message, name) for name in names]
    told = [list(f) if isinstance(f, tuple | list) else f for f in fields]
    head = message.get_type(), message.get_seq(), message.get_srcSystem()
    return (*head, message.get_srcComponent(), repr(told))


def by_pymavlink(datagram: bytes) -> list[Message]:
    return list(parser().parse_buffer(datagram) or ())


@pytest.mark.parametrize("zeros", [False, True])
def test_every_kind_made_of_numbers(zeros: bool) -> None:
    rng = np.random.default_rng(3)
    for kind in NUMBERS:
        size = dialect.mavlink_map[kind].unpacker.size
        payload = rng.bytes(size // 2) + bytes(size - size // 2) if zeros else rng.bytes(size)
        frame = frame_of(kind, payload)
        found, (wanted,) = unpacked(frame), by_pymavlink(frame)
        assert found is not None and [f for _, f in found] == [frame]
        assert content(found[0][0]) == content(wanted)


def test_nearly_all_that_is_read_is_made_of_numbers() -> None:
    text = {dialect.mavlink_map[k].msgname for k in USED - set(NUMBERS)}
    assert text == {"PARAM_VALUE", "DEBUG_FLOAT_ARRAY"}


def test_what_is_not_for_here_is_left_alone() -> None:
    packer = parser(3, AUTOPILOT)
    beat = bytes(heartbeat(4).pack(packer))
    text = bytes(dialect.MAVLink_statustext_message(6, b"ready").pack(packer))
    older = bytes(heartbeat(4).pack(packer, force_mavlink1=True))
    unknown = beat[:7] + bytes([0xFF, 0xFF, 0x70]) + beat[10:]
    signed = beat[:2] + bytes([dialect.MAVLINK_IFLAG_SIGNED]) + beat[3:]
    for other in (text, older, unknown, signed, b"\0", beat[:-1], beat[:5]):
        assert unpacked(other) is None and unpacked(beat + other) is None
    assert unpacked(b"") == []


def test_of_damage_it_says_nothing_else() -> None:
    """Bytes of some datagrams are changed, lost or added: a message is pymavlink's or none."""
    rng, packer = np.random.default_rng(4), parser(3, AUTOPILOT)
    row = {"acc_x": 1.0, "acc_y": 2.0, "acc_z": -9.8, "gyro_x": 0.1, "gyro_y": 0.0, "gyro_z": 0.2}
    row |= {f"cmd_{i}": 0.1 * i for i in range(1, 5)}
    whole = b"".join(bytes(m.pack(packer)) for m in [heartbeat(4), *messages_of(5000, row, 4)])
    taken = 0
    for _ in range(3000):
        datagram = bytearray(whole)
        at = int(rng.integers(len(datagram)))
        match rng.integers(4):
            case 0:
                datagram[at] = int(rng.integers(256))
            case 1:
                del datagram[at:]
            case 2:
                datagram[at:at] = rng.bytes(2)
            case _:
                datagram += rng.bytes(int(rng.integers(3)))
        found = unpacked(bytes(datagram))
        if found is not None:
            taken += 1
            wanted = by_pymavlink(bytes(datagram))
            assert [content(m) for m, _ in found] == [content(m) for m in wanted]
            assert BAD not in {m.get_type() for m in wanted}
    assert taken > 100


def test_the_decoder_reads_both_alike() -> None:
    packer, two = parser(3, AUTOPILOT), (MavlinkDecoder(4), MavlinkDecoder(4))
    row = {f"q_{a}": v for a, v in zip("wxyz", (0.6, 0.0, 0.8, 0.0), strict=True)}
    row |= {f"{s}_{a}": 0.5 for s in ("pos", "vel", "acc", "gyro", "mag") for a in "xyz"}
    row |= {"vbat_v": 15.2, "ibat_a": 3.0, "baro_pa": 1e5}
    row |= {f"{s}_{i}": 0.3 for s in ("cmd", "rotor") for i in range(1, 5)}
    datagram = b"".join(bytes(m.pack(packer)) for m in [heartbeat(4), *messages_of(5000, row, 4)])
    frames = [bytes(m.get_msgbuf()) for m in by_pymavlink(datagram)]
    quick = [m for f in frames for m, _ in unpacked(f) or ()]
    slow = [m for f in frames if unpacked(f) is not None for m in by_pymavlink(f)]
    assert len(quick) > 4
    told = [
        [s for m in each for s in d.samples(m)] for d, each in zip(two, (quick, slow), strict=True)
    ]
    assert told[0] == told[1] and {s.group for s in told[0]} > {"acc", "q", "cmd", "vel", "vbat_v"}
    assert two[0].autopilot == two[1].autopilot and two[0].kinds == two[1].kinds
