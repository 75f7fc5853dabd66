"""Telemetry logs: what was sent comes back, whatever is damaged between it."""

from pathlib import Path

import numpy as np
import pytest
from sample_logs import SAMPLES, flown_table

from twin.errors import LogError
from twin.logs import read_flight
from twin.logs.airframe import NO_MULTIROTOR
from twin.logs.mavlink.encode import heartbeat, landed, messages_of
from twin.logs.mavlink.frames import (
    AUTOPILOT,
    MOTORS,
    Frame,
    LinkCounts,
    Sequence,
    dialect,
    frames,
    parser,
    stamped,
)
from uavtwin.file_check import check_file

EPOCH_US = 1_700_000_000_000_000


def flown(system: int = 1, table_rows: int = 1000) -> list[bytes]:
    """Stamped frames of the first seconds of `flown_table`."""
    table, packer, found = flown_table().iloc[:table_rows], parser(system, AUTOPILOT), []
    columns = [c for c in table if c not in ("time", "phase")]
    for k, (t, *values) in enumerate(table[["time", *columns]].itertuples(index=False)):
        row, t_us = dict(zip(columns, values, strict=True)), round(1e6 * t)
        messages = [heartbeat(4), landed("hover")] if k % 100 == 0 else []
        for message in [*messages, *messages_of(t_us, row, 4)]:
            found.append(stamped(EPOCH_US + t_us, message.pack(packer)))
            packer.seq = (packer.seq + 1) % 256
    return found


@pytest.mark.slow
def test_a_flight_comes_back(tmp_path: Path) -> None:
    path = tmp_path / "flown.tlog"
    path.write_bytes(b"".join(flown()))
    flight, table = read_flight(path), flown_table().iloc[:1000]
    assert flight.facts["format"] == "MAVLink telemetry log"
    assert flight.facts["source q"] == "ODOMETRY"
    assert len(flight.table) == len(table)
    np.testing.assert_allclose(flight.table["time"], table["time"], atol=1e-9)
    for column in (c for c in table if c not in ("time", "phase")):
        np.testing.assert_allclose(flight.table[column], table[column], rtol=1e-6, atol=1e-6)
    assert set(flight.table["phase"]) <= {"hover", "forward", ""}


def test_damage_costs_what_is_damaged(tmp_path: Path) -> None:
    """Garbage between frames, a flipped bit in one, the end cut off."""
    told = flown(table_rows=300)
    damaged = bytearray(told[100])
    damaged[30] ^= 1
    blob = b"".join([*told[:50], b"\xfdgarbage" * 3, *told[50:100], bytes(damaged), *told[101:]])
    path = tmp_path / "damaged.tlog"
    path.write_bytes(blob[:-5])
    flight = read_flight(path)
    said = {f.message: f.count for f in flight.findings}
    assert said["frames whose checksum is wrong"] == 1
    assert 24 <= said["bytes that are no stamped MAVLink frame"] < 24 + 2 * 300
    assert len(flight.table) > 295


def test_lost_and_doubled_messages_are_counted(tmp_path: Path) -> None:
    told = flown(table_rows=300)
    del told[500:510]
    path = tmp_path / "lost.tlog"
    path.write_bytes(b"".join([*told[:200], *told[190:]]))
    flight = read_flight(path)
    said = {(f.where, f.message.partition(",")[0]): f.count for f in flight.findings}
    assert said["link", "messages lost on the way"] == 10
    assert said["file", "messages that came twice"] == 10


def test_the_aircraft_is_told_from_others(tmp_path: Path) -> None:
    """A ground station beside it says nothing; a second aircraft is named."""
    station, packer = [], parser(255, 190)
    for k in range(3):
        packer.seq = k
        station.append(
            stamped(EPOCH_US, dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(packer))
        )
    path = tmp_path / "two.tlog"
    path.write_bytes(b"".join([*station, *flown(7, 400), *flown(9, 200)]))
    flight = read_flight(path)
    assert flight.facts["aircraft"] == "MAVLink system 7"
    assert [f.where for f in flight.findings if "system 9" in f.message] == ["aircraft"]


def test_a_log_without_a_signal_says_what_to_ask_for(tmp_path: Path) -> None:
    path = tmp_path / "quiet.tlog"
    beat = heartbeat(4).pack(parser(1, AUTOPILOT))
    path.write_bytes(b"".join(stamped(EPOCH_US + k, beat) for k in range(5)))
    with pytest.raises(LogError, match=r"system 1 none holds a signal.*SET_MESSAGE_INTERVAL"):
        read_flight(path)


def test_frames_of_both_protocols() -> None:
    packer = parser(1, AUTOPILOT)
    message = heartbeat(4)
    old, new = (message.pack(packer, force_mavlink1=v) for v in (True, False))
    found = [f for f in frames(stamped(EPOCH_US, old) + stamped(EPOCH_US + 1, new))]
    assert [(f.content, f.system, f.kind) for f in found if isinstance(f, Frame)] == [
        (bytes(old), 1, 0),
        (bytes(new), 1, 0),
    ]


def test_the_sample_is_a_telemetry_log() -> None:
    blob = SAMPLES["MAVLink telemetry log"]()
    assert all(isinstance(f, Frame) for f in frames(blob))


@pytest.mark.parametrize(
    ("numbers", "counts"),
    [
        ([0, 1, 2, 3], (4, 0, 0, 0, 0)),
        ([254, 255, 0, 1], (4, 0, 0, 0, 0)),
        ([0, 1, 4, 5], (4, 2, 0, 0, 0)),
        ([0, 2, 1, 3], (4, 0, 0, 1, 0)),
        ([0, 1, 1, 2, 0], (3, 0, 2, 0, 0)),
        ([5, 6, 106, 107], (4, 0, 0, 0, 1)),
        ([200, 201, 0, 1, 2], (5, 54, 0, 0, 0)),
        ([0, *range(1, 101), 0], (101, 0, 1, 0, 0)),
    ],
)
def test_sequence_numbers(numbers: list[int], counts: tuple[int, ...]) -> None:
    one = Sequence()
    for number in numbers:
        one.add(number, 10 * number)
    assert (one.received, one.lost, one.duplicates, one.reordered, one.jumps) == counts


def test_sums_over_components() -> None:
    link = LinkCounts()
    for component, number in ((1, 0), (1, 2), (2, 7), (2, 8)):
        link.add(3, component, number, 0)
    link.add(4, 1, 0, 0)
    assert (link.of(3).received, link.of(3).lost) == (4, 1)


def test_a_sender_that_begins_anew_repeats_no_message() -> None:
    """The same numbers, other content."""
    one = Sequence()
    assert not any(one.add(k, 1) for k in range(100)) and not any(one.add(k, 2) for k in range(100))
    assert one.received == 200 and one.duplicates == 0


def of_type(kind: int, frames_of: list[bytes], system: int) -> list[bytes]:
    """The same with another MAV_TYPE in the last heartbeat."""
    packer = parser(system, AUTOPILOT)
    beat = dialect.MAVLink_heartbeat_message(kind, 12, 0, 0, 4, 3).pack(packer)
    return [*frames_of, stamped(EPOCH_US + 30_000_000, beat)]


@pytest.mark.parametrize(
    ("kind", "text"),
    [(1, "fixed-wing"), (10, "rover"), (11, "boat"), (5, "antenna tracker"), (22, "VTOL")],
)
def test_what_is_no_multirotor_is_named_by_its_type(tmp_path: Path, kind: int, text: str) -> None:
    path = tmp_path / "other.tlog"
    path.write_bytes(b"".join(of_type(kind, flown(table_rows=300), 1)))
    report = check_file(path)
    assert any(f"no multirotor, MAV_TYPE is {kind}" in p and text in p for p in report.problems)
    assert not report.good_for


def test_a_multirotor_is_read_beside_a_tracker_that_says_more(tmp_path: Path) -> None:
    path = tmp_path / "two.tlog"
    tracker = of_type(5, flown(9, 600), 9)
    path.write_bytes(b"".join([*tracker, *flown(7, 200)]))
    flight = read_flight(path)
    assert flight.facts["aircraft"] == "MAVLink system 7"
    assert flight.airframe is not None and flight.airframe.no_multirotor == ""
    assert flight.airframe.rotors is not None and flight.airframe.rotors.value == 4


def test_a_tracker_alone_is_no_aircraft(tmp_path: Path) -> None:
    packer = parser(255, AUTOPILOT)
    beat = dialect.MAVLink_heartbeat_message(5, 8, 0, 0, 4, 3).pack(packer)
    path = tmp_path / "station.tlog"
    path.write_bytes(stamped(EPOCH_US, beat))
    with pytest.raises(LogError, match="It is none: MAV_TYPE is 5, an antenna tracker"):
        read_flight(path)


def test_every_type_of_the_dialect_is_sorted() -> None:
    """GENERIC and GENERIC_MULTIROTOR do not say how many motors there are."""
    kinds = {k for k in dialect.enums["MAV_TYPE"] if k != dialect.MAV_TYPE_ENUM_END}
    open_kinds = {dialect.MAV_TYPE_GENERIC, 43}
    assert not NO_MULTIROTOR.keys() & MOTORS.keys()
    assert kinds - NO_MULTIROTOR.keys() - MOTORS.keys() == open_kinds
