"""Parts of a live session that fail: the recording goes on, the error is reported once."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sample_logs import flown_table

from twin.errors import LogError
from twin.logs import Flight, read_flight
from twin.logs.mavlink.encode import heartbeat
from twin.logs.mavlink.frames import AUTOPILOT, dialect, parser
from twin.residuals.gap import Channel
from twin.residuals.stream import Stream
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from twin.why.watch import Alarm, Watch
from uavtwin.live.datagrams import MORE_OTHERS, Datagram, Receiver
from uavtwin.live.replay import played
from uavtwin.live.session import LiveOptions, LiveSession
from uavtwin.live.status import LiveStatus
from uavtwin.live.worker import ERRORS, FaultIsolation, Lift, Part, Worker
from uavtwin.sockets import Address
from uavtwin.wording import misfit


@pytest.fixture(scope="module")
def copter() -> Vehicle:
    return load_vehicle("copter_default")


def datagrams(rows: int = 600) -> list[bytes]:
    """Frames of the first seconds of `flown_table`."""
    packer, found = parser(1, AUTOPILOT), []
    for _, messages in played(Flight("flown", flown_table().iloc[:rows])):
        for message in messages:
            found.append(bytes(message.pack(packer)))
            packer.seq = (packer.seq + 1) % 256
    return found


def heard(
    vehicle: Vehicle, folder: Path, sent: list[bytes], **given: Any
) -> tuple[LiveStatus, Flight]:
    """What a session knows at the end of some datagrams, and what it recorded."""
    options = LiveOptions(Address("127.0.0.1", 0), record=folder)
    session = LiveSession(vehicle, options, **given)
    for k, datagram in enumerate(sent):
        session.take(Datagram(datagram, ("127.0.0.1", 1), 0.001 * k, 10**15 + 1000 * k))
        if k % 50 == 0:
            session.hand_over()
    status = session.end()
    return status, read_flight(folder / "flight.parquet")


class Failing(Watch):
    """Fails at its second evaluation."""

    calls = 0

    def evaluate(self) -> tuple[Alarm, ...]:
        self.calls += 1
        if self.calls == 2:
            raise ZeroDivisionError("as planted")
        return ()


class FailingPage:
    """A page of which everything fails."""

    def __getattr__(self, name: str) -> Any:
        def fail(*_: object) -> None:
            raise RuntimeError("as planted")

        return fail


@pytest.mark.slow
def test_an_error_of_alarms_or_page_ends_no_recording(copter: Vehicle, tmp_path: Path) -> None:
    watch = Failing()
    status, flight = heard(
        copter, tmp_path / "r", datagrams(), watch=lambda: watch, page=FailingPage()
    )
    assert len(flight.table) == 600 and status.waits_for == ""
    assert "alarms failed: ZeroDivisionError: as planted" in status.errors
    assert "the page failed: RuntimeError: as planted" in status.errors
    assert watch.calls == 2 and len(status.errors) == 2
    assert "ZeroDivisionError" in (tmp_path / "r" / ERRORS).read_text("utf-8")
    (noted,) = [f for f in flight.findings if f.where == "alarms"]
    assert noted.severity == "error" and noted.count == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("where", "name", "part"),
    [
        (Stream, "push", "the grid of the twin"),
        (Stream, "advance", "the twin"),
        (Stream, "lacks", "the grid of the twin"),
        (Worker, "_publish", "the flight section"),
    ],
)
def test_an_error_of_the_twin_ends_no_recording(
    copter: Vehicle,
    tmp_path: Path,
    where: type,
    name: str,
    part: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise FloatingPointError("as planted")

    monkeypatch.setattr(where, name, fail)
    status, flight = heard(copter, tmp_path / "r", datagrams())
    assert len(flight.table) == 600
    assert status.errors == (f"{part} failed: FloatingPointError: as planted",)


@pytest.mark.slow
def test_a_full_disk_ends_neither_twin_nor_the_other_files(
    copter: Vehicle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The raw log fails after 1000 messages: the table is whole."""
    count = [0]

    def fill(*_: object) -> None:
        count[0] += 1
        if count[0] > 1000:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr("uavtwin.live.recording.RawLog.add", fill)
    status, flight = heard(copter, tmp_path / "r", datagrams())
    assert len(flight.table) == 600 and status.waits_for == "" and status.rms
    assert status.errors == ("raw.tlog failed: OSError: [Errno 28] No space left on device",)
    assert count == [1001]


@pytest.mark.slow
def test_a_table_that_cannot_be_written_leaves_the_raw_log(
    copter: Vehicle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("uavtwin.live.recording.TableStream.append", fail)
    with pytest.raises(LogError):
        heard(copter, tmp_path / "r", datagrams())  # there is no table to read
    raw = read_flight(tmp_path / "r" / "raw.tlog")
    assert len(raw.table) == 600


@pytest.mark.slow
@pytest.mark.parametrize("axis", ["gyro_x", "gyro_y", "gyro_z", "acc_x", "acc_z"])
def test_a_frozen_axis_ends_no_session(copter: Vehicle, tmp_path: Path, axis: str) -> None:
    table = flown_table().iloc[:3000].copy()
    table[axis] = 0.0
    packer, sent = parser(1, AUTOPILOT), []
    for _, messages in played(Flight("frozen", table)):
        for message in messages:
            sent.append(bytes(message.pack(packer)))
            packer.seq = (packer.seq + 1) % 256
    status, flight = heard(copter, tmp_path / "r", sent, watch=lambda: Watch(copter))
    assert not status.errors and len(flight.table) == 3000


@pytest.mark.slow
def test_hostile_numbers_and_times_cost_their_message(copter: Vehicle, tmp_path: Path) -> None:
    """Among the messages of a flight, the table stays what it was."""
    packer, sent = parser(1, AUTOPILOT), datagrams()
    strange = [
        dialect.MAVLink_param_value_message(b"SERVO1_FUNCTION", math.nan, 9, 1, 0),
        dialect.MAVLink_highres_imu_message(2**63, *[0.0] * 13, 0xFFFF),
        dialect.MAVLink_highres_imu_message(2**41, *[math.inf] * 13, 0xFFFF),
        dialect.MAVLink_battery_status_message(0, 0, 0, 0, [65535] * 10, -1, -1, -1, -1),
        dialect.MAVLink_timesync_message(2**63 - 1, 1),
        dialect.MAVLink_statustext_message(2, b"\x1b[2J\xff\xed\xa0\x80"),
        dialect.MAVLink_attitude_message(2**32 - 1, math.nan, 1e38, math.inf, 0, 0, 0),
    ]
    mixed = []
    for k, datagram in enumerate(sent):
        mixed.append(datagram)
        if k % 10 == 5:
            mixed.append(bytes(strange[k // 10 % len(strange)].pack(packer)))
    status, flight = heard(copter, tmp_path / "r", mixed)
    assert status.errors == () and status.sections == 1
    assert status.link.strays > 50
    assert status.clock is not None and abs(status.clock.offset_s) < 100
    table = flown_table().iloc[:600]
    np.testing.assert_allclose(flight.table["time"], table["time"], atol=1e-9)
    np.testing.assert_allclose(flight.table["gyro_y"], table["gyro_y"], rtol=2e-7, atol=1e-30)


@pytest.mark.slow
def test_a_stray_stamp_before_the_flight_begins_no_section(copter: Vehicle, tmp_path: Path) -> None:
    stray = dialect.MAVLink_highres_imu_message(2**41, *[0.0] * 13, 0xFFFF)
    status, flight = heard(
        copter, tmp_path / "r", [bytes(stray.pack(parser(1, AUTOPILOT))), *datagrams()]
    )
    assert status.sections == 1 and len(flight.table) == 600 and status.link.strays > 0


def test_strangers_make_no_receiver_deaf() -> None:
    """One byte each of 5,000 ports, then 5,000 other systems; the aircraft is heard."""
    receiver = Receiver()
    for port in range(5000):
        assert not list(receiver.messages(b"\xfd", ("127.0.0.1", 1 + port)))
    beat = bytes(heartbeat(4).pack(parser(3, AUTOPILOT)))
    assert len(list(receiver.messages(beat, ("127.0.0.1", 9000)))) == 1
    for port in range(5000):
        other = bytes(heartbeat(4).pack(parser(4 + port % 250, AUTOPILOT)))
        assert not list(receiver.messages(other, ("127.0.0.1", 10_000 + port)))
    assert len(receiver.others) <= 33 and sum(receiver.others.values()) == 5000
    assert receiver.others[MORE_OTHERS] > 4900 and receiver.parser.garbage == 5000


def test_a_single_frame_of_a_stranger_keeps_no_place() -> None:
    """What was heard first and is silent gives way to an aircraft; an aircraft that spoke stays."""
    receiver = Receiver()
    forged = bytes(heartbeat(4).pack(parser(9, AUTOPILOT)))
    list(receiver.messages(forged, ("127.0.0.1", 1)))
    receiver.silent = True
    packer = parser(1, AUTOPILOT)
    for k in range(20):
        packer.seq = k
        frame = bytes(heartbeat(4).pack(packer))
        assert len(list(receiver.messages(frame, ("127.0.0.1", 2)))) == 1
        receiver.silent = False
    receiver.silent = True
    assert not list(receiver.messages(forged, ("127.0.0.1", 1)))
    assert receiver.system == 1


def test_parts_report_once_and_rest_until_the_next_section(tmp_path: Path) -> None:
    parts, calls = FaultIsolation(tmp_path), [0]

    def fail() -> Mapping[str, int]:
        calls[0] += 1
        raise KeyError("x" * calls[0] if calls[0] > 4 else "x")

    for _ in range(3):
        assert parts.run(Part.TWIN, fail) is None
    parts.wake()
    parts.run(Part.TWIN, fail)
    assert calls == [2] and [f.count for f in parts.findings] == [2]
    for _ in range(200):
        parts.run(Part.PAGE, fail)
    assert calls == [202] and len(parts.findings) <= 52
    assert parts.run(Part.ALARMS, lambda: 3) == 3


@pytest.mark.parametrize(("carried", "fits"), [(1.05, True), (0.75, False), (1.3, False)])
def test_a_vehicle_file_that_carries_another_weight_is_said(carried: float, fits: bool) -> None:
    """After twenty seconds in the air, not before."""
    lift, rng = Lift(), np.random.default_rng(5)
    for start_s in range(25):
        t_s = start_s + np.arange(0.0, 1.0, 0.02)
        measured = -9.8 + rng.standard_normal(len(t_s))
        simulated = carried * -9.8 + rng.standard_normal(len(t_s))
        phase = np.full(len(t_s), "hover")
        found = lift.carried(Channel("acc_z", "m/s^2", 0.0, t_s, measured, simulated, phase))
        assert start_s == 19 or (found is None) == (start_s < 19)
    assert found == pytest.approx(carried, abs=0.05)
    assert (misfit(found, "mine") == "") == fits
