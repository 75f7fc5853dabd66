"""PX4 logs made to fell the reader, and clocks and signals that are not what they seem."""

import struct
import time
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import ArrayLike
from sample_logs import MOVING_S as T_S
from sample_logs import moving_topics, ulog, ulog_message

from twin.errors import LogError
from twin.logs import Flight, read_flight

Fields = dict[str, ArrayLike]
N = len(T_S)
DEFINITIONS = 16 + 3 + 40  # header and flags, after which formats may stand


def changed(topic: str, **fields: ArrayLike) -> bytes:
    """The log with fields of one topic replaced."""
    all_topics = moving_topics()
    all_topics[topic] = {**all_topics[topic], **fields}
    return ulog(all_topics, {"CA_ROTOR_COUNT": 4})


def stamped(topic: str, change: dict[int, int], blob: bytes | None = None) -> bytes:
    """The log with some stamps of a topic replaced where they stand, by sample."""
    out = bytearray(blob or changed("sensor_combined"))
    index = list(moving_topics()).index(topic)
    at, k = 16, 0
    while at < len(out):
        size, kind = struct.unpack_from("<HB", out, at)
        if kind == ord("D") and struct.unpack_from("<H", out, at + 3)[0] == index:
            if k in change:
                struct.pack_into("<Q", out, at + 5, change[k])
            k += 1
        at += 3 + size
    return bytes(out)


def own_stamps(topic: str) -> list[int]:
    return [
        int(s) for s in np.round(np.asarray(moving_topics()[topic]["t"]) * 1e6).astype(int) + 10**6
    ]


def read(folder: Path, blob: bytes) -> Flight:
    path = folder / "log.ulg"
    path.write_bytes(blob)
    flight = read_flight(path)
    assert np.all(np.diff(flight.table["time"]) > 0)
    return flight


def said(flight: Flight, where: str, text: str) -> int:
    """Count of warnings and errors at `where` whose message has `text`."""
    return sum(
        f.count
        for f in flight.findings
        if f.where == where and text in f.message and f.severity != "info"
    )


def test_a_sound_log_has_no_finding_but_what_it_lacks(tmp_path: Path) -> None:
    found = [f for f in read(tmp_path, changed("sensor_combined")).findings if f.severity != "info"]
    assert [(f.where, f.message.split(" in the log")[0]) for f in found] == [
        ("q", "no vehicle_attitude"),
        ("acc", "stands still from 0.00 to 8.00 s, all of its samples"),  # as it was written
    ]


@pytest.mark.parametrize("leaf", ["float x;", ""])
def test_formats_nested_fifty_deep_are_refused_at_once(tmp_path: Path, leaf: str) -> None:
    nest = [f"f{k}:f{k + 1} a;f{k + 1} b;" for k in range(50)]
    formats = b"".join(ulog_message(b"F", t.encode()) for t in [*nest, f"f50:{leaf}"])
    added = ulog_message(b"A", struct.pack("<BH", 0, 99) + b"f0")
    blob = changed("sensor_combined")
    start = time.process_time()
    with pytest.raises(LogError, match=r"format 'f\d+' has over 65535 fields"):
        read(tmp_path, blob[:DEFINITIONS] + formats + blob[DEFINITIONS:] + added)
    assert time.process_time() - start < 5.0


def test_a_format_within_itself_and_endless_subscriptions_are_refused(tmp_path: Path) -> None:
    blob = changed("sensor_combined")
    own = ulog_message(b"F", b"a:b x;") + ulog_message(b"F", b"b:a x;")
    added = ulog_message(b"A", struct.pack("<BH", 0, 99) + b"a")
    with pytest.raises(LogError, match="contains itself"):
        read(tmp_path, blob[:DEFINITIONS] + own + blob[DEFINITIONS:] + added)
    wide = ulog_message(b"F", b"a:uint8_t[60000] x;")
    many = b"".join(ulog_message(b"A", struct.pack("<BH", 0, 99 + k) + b"a") for k in range(40))
    with pytest.raises(LogError, match="subscriptions have over"):
        read(tmp_path, blob[:DEFINITIONS] + wide + blob[DEFINITIONS:] + many)


def test_a_header_stamp_beyond_any_clock(tmp_path: Path) -> None:
    blob = changed("sensor_combined")
    flight = read(tmp_path, blob[:8] + struct.pack("<Q", 2**64 - 5) + blob[16:])
    assert said(flight, "clock", "header's time stamp") == 1
    assert flight.table["time"].iloc[-1] == pytest.approx(8.0, abs=0.1)


def test_a_version_that_is_no_number_of_a_version(tmp_path: Path) -> None:
    for value in (b"float ver_sw_release", b"uint32_t ver_sw_release"):
        blob = changed("sensor_combined")
        key = b"uint32_t ver_sw_release"
        info = ulog_message(b"I", bytes([len(key)]) + key + struct.pack("<I", 0x010E00FF))
        assert info in blob
        other = ulog_message(b"I", bytes([len(value)]) + value + b"\0\0\xc0\x7f")
        assert read(tmp_path, blob.replace(info, other)).facts["firmware"].startswith("PX4")


def test_a_marker_without_a_mode(tmp_path: Path) -> None:
    all_topics = moving_topics()
    f4 = np.full(1, np.nan, dtype=np.float32)
    all_topics["vehicle_command"] = {
        "t": np.array([1.0]),
        "command": np.array([183], dtype=np.uint32),
        **{f"param{k}": f4 for k in (1, 2)},
        "param7": np.array([666], dtype=np.float32),
    }
    assert said(read(tmp_path, ulog(all_topics)), "phase", "whose mode is nan") == 1


@pytest.mark.parametrize("ahead_s", [3600, 12 * 86_400])
def test_a_clock_set_in_flight_keeps_the_longest_stretch(tmp_path: Path, ahead_s: int) -> None:
    blob = changed("sensor_combined")
    for topic in moving_topics():
        own = own_stamps(topic)
        first = next(k for k, s in enumerate(own) if s > 6_000_000)
        late = {k: own[k] + ahead_s * 10**6 for k in range(first, len(own))}
        blob = stamped(topic, late, blob)
    flight = read(tmp_path, blob)
    assert flight.table["time"].iloc[-1] < 8.0
    assert said(flight, "time", "was the clock set in flight") > 500


@pytest.mark.parametrize("topic", ["sensor_combined", "vehicle_local_position"])
@pytest.mark.parametrize("change", ["2^62 later", "times 1000", "half a day", "0.2 s late"])
def test_a_topic_on_a_clock_of_its_own(tmp_path: Path, topic: str, change: str) -> None:
    own = own_stamps(topic)
    new = {
        "2^62 later": [s + 2**62 for s in own],
        "times 1000": [1000 * s for s in own],
        "half a day": [s + 43_200 * 10**6 for s in own],
        "0.2 s late": [s + 200_000 for s in own],
    }[change]
    flight = read(tmp_path, stamped(topic, dict(enumerate(new))))
    assert said(flight, topic, "stamped") >= 1
    assert flight.table["time"].iloc[-1] < 9.0


@pytest.mark.parametrize("value", [0, 2**40, 2**64 - 1])
def test_sampling_times_that_are_none(tmp_path: Path, value: int) -> None:
    n = len(T_S[::12])
    blob = changed("vehicle_local_position", timestamp_sample=np.full(n, value, dtype=np.uint64))
    assert said(read(tmp_path, blob), "vehicle_local_position", "without a sampling time") == n


def test_sampling_times_that_are_late_or_to_come(tmp_path: Path) -> None:
    taken = np.round(T_S[::12] * 1e6).astype(np.int64) + 1_000_000
    late = changed("vehicle_local_position", timestamp_sample=(taken - 200_000).astype(np.uint64))
    assert said(read(tmp_path, late), "vehicle_local_position", "published 200 ms after") == 1
    early = changed("vehicle_local_position", timestamp_sample=(taken + 9000).astype(np.uint64))
    assert said(read(tmp_path, early), "vehicle_local_position", "before they were taken") > 100


@pytest.mark.parametrize("value", [2**31 - 1, -(2**31), 10**6, 90_000])
def test_acceleration_without_a_time_is_left_out(tmp_path: Path, value: int) -> None:
    blob = changed(
        "sensor_combined", accelerometer_timestamp_relative=np.full(N, value, dtype=np.int32)
    )
    flight = read(tmp_path, blob)
    assert not flight.has("acc_x")
    if value != 2**31 - 1:  # PX4's own sign for none
        assert said(flight, "acc", "accelerometer_timestamp_relative is beyond") == N


@pytest.mark.parametrize("field", ["gyro_integral_dt", "accelerometer_integral_dt"])
@pytest.mark.parametrize(("value", "text"), [(0, "0 to 0.1"), (2**32 - 1, "0 to"), (9000, "back")])
def test_averaging_times_that_cannot_be(tmp_path: Path, field: str, value: int, text: str) -> None:
    blob = changed("sensor_combined", **{field: np.full(N, value, dtype=np.uint32)})
    assert said(read(tmp_path, blob), "sensor_combined", text) >= N - 1


@pytest.mark.parametrize("topic", list(moving_topics()))
def test_a_gap_in_any_topic_is_counted(tmp_path: Path, topic: str) -> None:
    all_topics = moving_topics()
    t = np.asarray(all_topics[topic]["t"])
    kept = (t < 3.0) | (t > 3.3)
    all_topics[topic] = {k: np.asarray(v)[kept] for k, v in all_topics[topic].items()}
    assert said(read(tmp_path, ulog(all_topics)), topic, "gaps, the longest of 0.3") == 1


@pytest.mark.parametrize("topic", list(moving_topics()))
@pytest.mark.parametrize("last_s", [2.0, 7.5])
def test_a_topic_that_ends_early_is_told(tmp_path: Path, topic: str, last_s: float) -> None:
    all_topics = moving_topics()
    kept = np.asarray(all_topics[topic]["t"]) < last_s
    all_topics[topic] = {k: np.asarray(v)[kept] for k, v in all_topics[topic].items()}
    flight = read(tmp_path, ulog(all_topics))
    early = [f.where for f in flight.findings if "before the record does" in f.message]
    assert early == [topic]


def test_slow_topics_may_end_an_interval_before_the_record(tmp_path: Path) -> None:
    all_topics = moving_topics()
    fast = all_topics["vehicle_local_position"]
    all_topics["vehicle_local_position"] = {k: np.asarray(v)[::20] for k, v in fast.items()}
    assert said(read(tmp_path, ulog(all_topics)), "vehicle_local_position", "record does") == 0


@pytest.mark.parametrize("value", [-np.inf, 1e10])
def test_absurd_commands_are_told(tmp_path: Path, value: float) -> None:
    control = np.asarray(moving_topics()["actuator_motors"]["control"]).copy()
    control[700:703, 1] = value
    flight = read(tmp_path, changed("actuator_motors", control=control))
    assert said(flight, "cmd", "actuator_motors beyond 3 set to 0 or 1") == 3


def test_a_motor_that_stops_alone_is_told(tmp_path: Path) -> None:
    control = np.asarray(moving_topics()["actuator_motors"]["control"]).copy()
    control[700:900, 1] = np.nan
    flight = read(tmp_path, changed("actuator_motors", control=control))
    assert said(flight, "cmd", "while others have some, mean stopped") == 200


def test_a_motor_whose_commands_are_all_infinite_is_still_one(tmp_path: Path) -> None:
    control = np.asarray(moving_topics()["actuator_motors"]["control"]).copy()
    control[:, 1] = np.inf
    flight = read(tmp_path, changed("actuator_motors", control=control))
    assert said(flight, "cmd", "actuator_motors beyond 3 set to 0 or 1") == len(control)
    assert "cmd_4" in flight.table
