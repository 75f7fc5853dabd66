"""Times and numbers that no aircraft sends: nothing else is lost, nothing ends."""

import math
import struct
import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.logs import read_flight
from twin.logs.mavlink.decoder import MavlinkDecoder, Stamp, StampGate
from twin.logs.mavlink.encode import battery, heartbeat, imu
from twin.logs.mavlink.frames import (
    AUTOPILOT,
    LinkCounts,
    Message,
    dialect,
    frames,
    parser,
    stamped,
)

EPOCH_US = 1_700_000_000_000_000
STRAYS = (2**40, 2**52, 2**53, 2**62, 2**63, 2**64 - 1)
READING = dict.fromkeys(("acc_x", "acc_y", "acc_z", "gyro_x", "gyro_y", "gyro_z"), 0.1)


def reading(t_us: int) -> Message:
    found = imu(t_us, READING)
    assert found is not None
    return found


def written(path: Path, messages: list[Message], systems: int = 1) -> Path:
    """A telemetry log of some messages, 5 ms apart."""
    packer, found = parser(1, AUTOPILOT), []
    for k, message in enumerate(messages):
        packer.srcSystem = 1 + k % systems
        found.append(stamped(EPOCH_US + 5000 * k, message.pack(packer)))
        packer.seq = (packer.seq + 1) % 256
    path.write_bytes(b"".join(found))
    return path


@pytest.mark.parametrize("stray_us", STRAYS)
@pytest.mark.parametrize("at", [0, 1, 7, 399])
def test_one_stray_stamp_costs_one_message(tmp_path: Path, stray_us: int, at: int) -> None:
    """A message without a time behind it has the time of the aircraft; no row is lost."""
    messages = [reading(1_000_000 + 5000 * k) for k in range(400)]
    messages[at + 1 : at + 1] = [reading(stray_us), battery({"vbat_v": 12.0})]
    flight = read_flight(written(tmp_path / "x.tlog", [heartbeat(4), *messages]))
    np.testing.assert_allclose(flight.time_s, 0.005 * np.arange(400), atol=1e-9)
    t_s, volts = flight.signal(["vbat_v"])
    assert t_s == pytest.approx([0.005 * at], abs=1e-9) and volts[0] == pytest.approx(12.0)
    assert [f.count for f in flight.findings if f.where == "time"] == [1]


@pytest.mark.parametrize("stray_us", [2**40, 2**52])
def test_stray_stamps_at_the_begin_are_told_from_the_clock(tmp_path: Path, stray_us: int) -> None:
    strays = [reading(stray_us), battery({"vbat_v": 12.0})]
    messages = [reading(1_000_000 + 5000 * k) for k in range(400)]
    flight = read_flight(written(tmp_path / "x.tlog", [heartbeat(4), *strays, *messages]))
    np.testing.assert_allclose(flight.time_s, 0.005 * np.arange(400), atol=1e-9)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["SERVO1_FUNCTION", "MOT_PWM_MIN", "\x1b[31mNAN"])
def test_parameters_that_are_no_numbers(tmp_path: Path, name: str, value: float) -> None:
    """The outputs are those without the parameter; it is named."""
    told = dialect.MAVLink_param_value_message(name.encode(), value, 9, 1, 0)
    pulses = [1200, 1400, 1600, 1800, 0, 0, 0, 0]
    servos = [
        dialect.MAVLink_servo_output_raw_message(1_000_000 + 5000 * k, 0, *pulses)
        for k in range(200)
    ]
    readings = [reading(1_000_000 + 5000 * k) for k in range(200)]
    path = written(tmp_path / "x.tlog", [heartbeat(4), told, *readings, *servos])
    flight = read_flight(path)
    _, cmd = flight.signal([f"cmd_{i}" for i in range(1, 5)])
    np.testing.assert_allclose(cmd[0], [0.2, 0.4, 0.6, 0.8])
    assert any(f"{name} is NaN or infinite" in f.message for f in flight.findings)


FLOATS = st.sampled_from([math.nan, math.inf, -math.inf, 3e38, -3e38, 0.0, 1.0])
WHOLE = st.sampled_from([0, 1, 2**31, 2**32 - 1, 2**53, 2**63 - 1])


@pytest.mark.slow
@given(st.data())
def test_any_content_of_a_message_becomes_finite_samples(data: st.DataObject) -> None:
    """Whatever a frame of a kind that is read holds, samples are finite or counted."""
    kinds = [k for k in dialect.mavlink_map.values() if k.msgname in _READ_KINDS]
    kind = data.draw(st.sampled_from(kinds))
    values = []
    for letters, length in zip(_letters(kind), kind.lengths, strict=True):
        one = FLOATS if letters in "fd" else WHOLE
        top = 2 ** (8 * struct.calcsize(letters)) if letters not in "fds" else 0
        drawn = [data.draw(one) for _ in range(max(length, 1))]
        if letters.islower() and letters not in "fd":
            drawn = [int(v) % (top // 2) for v in drawn]
        elif letters not in "fd":
            drawn = [int(v) % top for v in drawn]
        values += drawn
    decoder = MavlinkDecoder(4)
    content = _packed(kind, values)
    (message,) = parser().parse_buffer(content) or (None,)
    samples = [s for _ in range(3) for s in decoder.samples(message)]
    assert all(math.isfinite(v) for s in samples for v in s.values)
    assert all(0 <= s.t_us < 2**53 for s in samples)
    assert all(map(math.isfinite, decoder.parameters.values()))


_READ_KINDS = {
    "HEARTBEAT": 1,
    "HIGHRES_IMU": 1,
    "ODOMETRY": 1,
    "ATTITUDE": 1,
    "ATTITUDE_QUATERNION": 1,
    "LOCAL_POSITION_NED": 1,
    "VICON_POSITION_ESTIMATE": 1,
    "ACTUATOR_OUTPUT_STATUS": 1,
    "SERVO_OUTPUT_RAW": 1,
    "SCALED_PRESSURE": 1,
    "SCALED_IMU": 1,
    "RAW_IMU": 1,
    "ESC_TELEMETRY_1_TO_4": 1,
    "BATTERY_STATUS": 1,
    "SYS_STATUS": 1,
    "EXTENDED_SYS_STATE": 1,
}


def _letters(kind: type) -> str:
    """Letters of `struct`, one per field on the wire."""
    found, digits = "", ""
    for c in kind.unpacker.format.lstrip("<"):  # type: ignore[attr-defined]
        if c.isdigit():
            digits += c
        else:
            found, digits = found + c, ""
    return found


def _packed(kind: type, values: list[float]) -> bytes:
    """A frame with these values in the order of the wire."""
    payload: bytes = kind.unpacker.pack(*values)  # type: ignore[attr-defined]
    number = kind.id  # type: ignore[attr-defined]
    head = struct.pack("<BBBBBBHB", len(payload), 0, 0, 0, 1, 1, number % 65536, number >> 16)
    checksum = dialect.x25crc(head + payload + bytes([kind.crc_extra]))  # type: ignore[attr-defined]
    return b"\xfd" + head + payload + struct.pack("<H", checksum.crc)


def test_a_clock_that_begins_anew_loses_no_sample() -> None:
    """Samples wait until it is clear that the clock began anew; two clocks do not swap."""
    decoder, found, verdicts = MavlinkDecoder(4), 0, []
    for t_us in (*range(90_000_000, 90_500_000, 5000), *range(1_000_000, 1_500_000, 5000)):
        found += len(decoder.samples(reading(t_us)))
        verdicts.append(decoder.stamp)
    assert found == 2 * 200 and verdicts.count(Stamp.RESTART) == 1 and decoder.strays == 0
    beside = MavlinkDecoder(4)
    for k in range(1000):
        beside.samples(reading(1_000_000 + 5000 * k))
        if k % 2:
            beside.samples(reading(EPOCH_US + 5000 * k))
    assert beside.newest_us == 1_000_000 + 5000 * 999 and beside.strays == 500


@given(st.lists(st.integers(0, 2**64 - 1), min_size=1, max_size=200))
def test_random_stamps_move_no_clock(times: list[int]) -> None:
    """Of stamps that agree with nothing not one is taken once the clock is known."""
    gate = StampGate()
    for k in range(10):
        gate.add(10_000_000 + k)
    for t_us in times:
        if not gate.near(t_us):
            assert gate.add(t_us) in (Stamp.STRAY, Stamp.IMPOSSIBLE)
        gate.add(10_000_010)
    assert gate.newest_us == 10_000_010


@pytest.mark.slow
def test_forged_senders_take_bounded_memory() -> None:
    """The aircraft is followed all the while, its counts are whole."""
    link = LinkCounts()
    tracemalloc.start()
    try:
        for k in range(65_000):
            link.add(k // 250 % 250 + 2, k % 250, 0, 0)
            if k % 100 == 0:
                link.add(1, 1, k // 100 % 256, k)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 10e6
    assert link.of(1).received == 650 and link.of(1).lost == 0
    assert sum(link.of(s).received for s in link.systems) == 65_650


@pytest.mark.slow
def test_garbage_is_skipped_in_time() -> None:
    """20 MB at 2 MB/s or more: zeros, noise, and what looks like a stamp."""
    rng = np.random.default_rng(0)
    beginning = struct.pack(">Q", EPOCH_US) + b"\xfd"
    for blob in (bytes(20_000_000), rng.bytes(20_000_000), beginning * 200_000):
        begin = time.process_time()
        assert sum(f for f in frames(blob) if isinstance(f, int)) >= len(blob) - 300
        assert time.process_time() - begin < 10.0


@pytest.mark.slow
def test_many_small_messages_of_many_systems(tmp_path: Path) -> None:
    """20,000 messages of 200 systems: 100 bytes each in the log, and less than a kB in memory."""
    many = [reading(1_000_000 + 1000 * k) for k in range(2000)] * 10
    path = written(tmp_path / "many.tlog", many, systems=200)
    tracemalloc.start()
    try:
        flight = read_flight(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 15e6
    assert sum("left out" in f.message for f in flight.findings) < 15
