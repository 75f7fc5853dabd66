"""A replayed flight heard over real sockets."""

import contextlib
import math
import signal
import socket
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from places import DATA, needs
from sample_logs import flown_table

from twin.errors import TwinError
from twin.logs import Flight, read_flight
from twin.logs.columns import POS
from twin.logs.mavlink.encode import messages_of
from twin.logs.mavlink.frames import AUTOPILOT, Message, dialect, parser
from twin.residuals.flight_gap import flight_gap
from twin.residuals.measured import signal_of
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from uavtwin.live.replay import MAX_SPEED, Faults, Replay
from uavtwin.live.session import LiveOptions, LiveSession
from uavtwin.live.status import LiveStatus
from uavtwin.sockets import Address

RECORDED = DATA / "rflysimdt" / "real_3.ulg"
needs_flights = needs(RECORDED.is_file(), "no recorded flights")
FLOAT32 = 2.0**-24


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_port:
        any_port.bind(("127.0.0.1", 0))
        return int(any_port.getsockname()[1])


class Listening:
    """A live session in a thread."""

    def __init__(self, vehicle: Vehicle, record: Path | None = None, **options: object) -> None:
        self.address = Address("127.0.0.1", free_port())
        given = replace(LiveOptions(self.address, record=record), **options)  # type: ignore[arg-type]
        self.session = LiveSession(vehicle, given)
        self._stop = threading.Event()
        self._told: LiveStatus | None = None
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        self._told = self.session.run(self._stop.is_set)

    def end(self) -> LiveStatus:
        time.sleep(0.3)
        self._stop.set()
        self._thread.join()
        assert self._told is not None
        return self._told


def play(flight: Flight, to: Address, speed: float = MAX_SPEED, **faults: float) -> None:
    aircraft = Replay(to, speed, Faults(**faults))  # type: ignore[arg-type]
    try:
        aircraft.play(flight)
    finally:
        aircraft.close()


def flown(rows: int = 800) -> Flight:
    return Flight("flown", flown_table().iloc[:rows])


@pytest.fixture(scope="module")
def copter() -> Vehicle:
    return load_vehicle("copter_default")


def check_residuals(folder: Path, vehicle: Vehicle, stem: str = "") -> pd.DataFrame:
    """Residuals told live are those of `gap` on the recording."""
    gap = flight_gap(read_flight(folder / f"flight{stem}.parquet"), vehicle)
    live = pd.read_parquet(folder / f"residuals{stem}.parquet")
    assert len(gap.channels) == 18
    for channel in gap.channels:
        there = (live["channel"] == channel.name) & (live["horizon_s"] == channel.horizon_s)
        rows = live[there]
        np.testing.assert_allclose(rows["time"], channel.t_s, rtol=0, atol=1e-12)
        np.testing.assert_allclose(rows["residual"], channel.residual, rtol=0, atol=1e-9)
        assert rows["phase"].tolist() == channel.phase.tolist()
    return live


@pytest.mark.slow
def test_a_flight_is_recorded_as_it_was_sent(copter: Vehicle, tmp_path: Path) -> None:
    """Table, raw log and residuals; nothing is lost on the loopback."""
    live = Listening(copter, tmp_path / "rec")
    play(flown(), live.address)
    status = live.end()
    assert status.link.lost == 0 and status.link.late == 0 and status.sections == 1
    assert status.waits_for == "" and status.sources["q"] == "ODOMETRY"
    assert set(status.missing) == {"vbat_v"}
    recorded, table = read_flight(tmp_path / "rec" / "flight.parquet"), flown_table().iloc[:800]
    np.testing.assert_allclose(recorded.table["time"], table["time"], atol=1e-9)
    for column in (c for c in table if c not in ("time", "phase")):
        np.testing.assert_allclose(
            recorded.table[column], table[column], rtol=3 * FLOAT32, atol=1e-30
        )
    raw = read_flight(tmp_path / "rec" / "raw.tlog")
    assert raw.table["acc_z"].tolist() == recorded.table["acc_z"].tolist()
    assert not (tmp_path / "rec" / "alarms.jsonl").read_text("utf-8")
    check_residuals(tmp_path / "rec", copter)


@pytest.mark.slow
@needs_flights
def test_a_recorded_flight_over_the_wire(tmp_path: Path) -> None:
    """Live as offline to 1e-9; the recording as the log as far as float32 and the filters go."""
    vehicle = load_vehicle("feisi_x150")
    log = read_flight(RECORDED).between(0.0, 15.0)
    live = Listening(vehicle, tmp_path / "rec")
    play(log, live.address)
    status = live.end()
    assert status.link.lost == 0
    check_residuals(tmp_path / "rec", vehicle)
    recorded = read_flight(tmp_path / "rec" / "flight.parquet")
    for column in ("acc_x", "gyro_y", "pos_z", "q_w"):  # float32 in the log already
        a, b = log.signal([column]), recorded.signal([column])
        np.testing.assert_allclose(a[0], b[0], atol=1e-9)
        np.testing.assert_allclose(a[1], b[1], rtol=2 * FLOAT32)
    whole = flight_gap(
        replace(log, settled=recorded.settled, table=log.table.assign(phase=log.table["phase"])),
        vehicle,
    )
    first = next(c for c in whole.channels if c.name == "acc_z")
    again = next(c for c in flight_gap(recorded, vehicle).channels if c.name == "acc_z")
    np.testing.assert_allclose(again.residual, first.residual, atol=1e-4)


@pytest.mark.slow
@needs_flights
def test_faults_of_a_radio_link(tmp_path: Path) -> None:
    """5 % lost, 30 ms of jitter, 20 ppm of drift: what came is as it was sent, residuals are those
    of the recording, the clock is within its own bounds.

    Which datagrams are lost depends on when the clock is asked for, so one channel may change by a
    third; the middle of all may not.
    """
    vehicle = load_vehicle("feisi_x150")
    log = read_flight(RECORDED).between(4.0, 20.0)
    log = thinned(log)
    live = Listening(vehicle, tmp_path / "rec")
    aircraft = Replay(live.address, 1.0, Faults(0.05, 0.03, 20e-6, seed=3))
    aircraft.play(log)
    status = live.end()
    aircraft.close()
    assert status.clock is not None and status.clock.source == "TIMESYNC"
    share = status.link.lost / (status.link.lost + status.link.messages)
    assert 0.03 < share < 0.07 and status.link.reordered > 100
    at_us = round(1e6 * status.clock.aircraft_s)
    true_s = aircraft._due_s(at_us) - status.clock.aircraft_s
    off_s = abs(status.clock.offset_s - true_s)
    assert off_s <= status.clock.width_s + 2e-3  # 2 ms of the estimate itself: test_clock.py
    check_residuals(tmp_path / "rec", vehicle)
    recorded = read_flight(tmp_path / "rec" / "flight.parquet")
    for column in ("acc_x", "gyro_y", "pos_z", "q_w", "cmd_1"):
        (sent_s, sent), (came_s, came) = log.signal([column]), recorded.signal([column])
        came_s = came_s + 4.0  # time 0 is the whole second at which it begins
        at = np.searchsorted(sent_s, came_s - 1e-6)
        np.testing.assert_allclose(came_s, sent_s[at], rtol=0, atol=1e-6)
        np.testing.assert_allclose(came, sent[at], rtol=3 * FLOAT32, atol=1e-30)
        assert len(came_s) > 0.8 * len(sent_s)
    clean = flight_gap(replace(log, settled=recorded.settled), vehicle)
    rms = {c.name: math.sqrt(float(np.mean(c.residual**2))) for c in clean.channels}
    ratios = {name: status.rms[name] / clean_rms for name, clean_rms in rms.items()}
    print({name: round(ratio, 3) for name, ratio in ratios.items()}, status.link, status.clock)
    assert 0.95 < np.median(list(ratios.values())) < 1.05, ratios


@pytest.mark.slow
def test_a_sender_that_begins_anew_begins_a_flight(copter: Vehicle, tmp_path: Path) -> None:
    live = Listening(copter, tmp_path / "rec")
    play(flown(700), live.address)
    time.sleep(2.5)  # until another port of the machine is taken for the same aircraft
    play(flown(500), live.address)
    status = live.end()
    assert status.sections == 2
    lengths = [len(read_flight(tmp_path / "rec" / f"flight{s}.parquet").table) for s in ("", "_2")]
    assert lengths[0] == 700 and 450 < lengths[1] <= 500
    check_residuals(tmp_path / "rec", copter)


@pytest.mark.slow
def test_two_senders_garbage_and_old_frames(copter: Vehicle, tmp_path: Path) -> None:
    """The first aircraft is taken, all else is counted and named, nothing of it is lost."""
    live = Listening(copter, tmp_path / "rec")
    noise = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    rng, stop = np.random.default_rng(1), threading.Event()
    other, stranger = parser(7, AUTOPILOT), parser(1, AUTOPILOT)

    def disturb() -> None:
        """Another aircraft, one that feigns to be the first, damaged frames, bytes, MAVLink 1."""
        k = 0
        while not stop.wait(0.002):
            k += 1
            (imu,) = messages_of(1000 * k, {"acc_x": 99.0, "acc_y": 0.0, "acc_z": 0.0}, 4)
            frame = bytearray(imu.pack(other))
            noise.sendto(bytes(frame), live.address.pair)
            frame[25] ^= 1
            noise.sendto(bytes(frame), live.address.pair)
            noise.sendto(imu.pack(stranger, force_mavlink1=True), live.address.pair)
            noise.sendto(rng.bytes(300), live.address.pair)

    aircraft = Replay(live.address, MAX_SPEED)
    disturber = threading.Thread(target=disturb)
    try:
        aircraft.play(flown(50))
        disturber.start()
        aircraft.play(flown(600))
    finally:
        stop.set()
        disturber.join()
        noise.close()
        aircraft.close()
    status = live.end()
    assert status.link.system == 1 and status.link.lost == 0
    assert status.link.wrong > 50 and status.link.garbage > 1000
    assert any(who.startswith("system 7 at") for who in status.link.others)
    assert any(who.startswith("system 1 again, at") for who in status.link.others)
    table = read_flight(tmp_path / "rec" / "flight.parquet").table
    assert len(table) == 600 and float(table["acc_x"].max()) < 50.0


@pytest.mark.slow
def test_killed_it_leaves_all_but_the_last_second(tmp_path: Path) -> None:
    """What came is there soon after, rows and messages, though nobody has ended the recording."""
    port, end_s = free_port(), float(flown_table()["time"].iloc[799])

    def there() -> bool:
        files = (tmp_path / "rec" / name for name in ("flight.arrows", "raw.tlog"))
        with contextlib.suppress(TwinError):  # half of a block is written
            return all(abs(read_flight(f).time_s[-1] - end_s) < 0.03 for f in files)
        return False

    code = "from uavtwin.cli.main import main; main()"
    arguments = ["live", "--vehicle", "copter_default", "--listen", f"udpin:127.0.0.1:{port}"]
    process = subprocess.Popen(
        [sys.executable, "-c", code, *arguments, "--out", str(tmp_path / "rec")],
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    try:
        for line in process.stderr:
            if "nothing heard" in line:
                break
        aircraft = Replay(Address("127.0.0.1", port), 1.0)
        aircraft.play(flown(800))
        aircraft.close()
        until = time.monotonic() + 60.0
        while time.monotonic() < until and not there():
            time.sleep(0.2)
    finally:
        process.send_signal(signal.SIGKILL)
        process.communicate()
    assert there()
    with pytest.raises(TwinError, match=r"cut off.*uavtwin convert"):
        LiveSession(
            load_vehicle("copter_default"),
            LiveOptions(Address("127.0.0.1", free_port()), record=tmp_path / "rec"),
        )


ASKED = 12
"""Times that it asks for the aircraft's time, within which it would have said all else."""


@pytest.mark.slow
def test_nothing_is_commanded_unless_asked_for(copter: Vehicle) -> None:
    """What goes back to the aircraft: questions for its time, and rates where they are wanted."""
    heard: dict[bool, set[str]] = {}
    for wanted in (False, True):
        live = Listening(copter, request_rates=wanted)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as aircraft:
            aircraft.settimeout(0.05)
            packer, reader, kinds = parser(1, AUTOPILOT), parser(), list[str]()
            until = time.monotonic() + 60.0
            while time.monotonic() < until and kinds.count("TIMESYNC") < ASKED:
                beat = dialect.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3)
                aircraft.sendto(beat.pack(packer), live.address.pair)
                packer.seq = (packer.seq + 1) % 256
                try:
                    datagram = aircraft.recv(1000)
                except TimeoutError:
                    continue
                kinds += [m.get_type() for m in reader.parse_buffer(datagram) or ()]
        live.end()
        heard[wanted] = set(kinds)
    assert heard == {False: {"TIMESYNC"}, True: {"TIMESYNC", "COMMAND_LONG"}}


def test_a_port_that_is_taken_is_told(copter: Vehicle) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        where = Address("127.0.0.1", taken.getsockname()[1])
        with pytest.raises(TwinError, match="Choose another port"):
            LiveSession(copter, LiveOptions(where))


@pytest.mark.slow
@needs_flights
def test_the_twin_is_an_aircraft_of_its_own() -> None:
    """Its own system, fifty times a second, near the aircraft."""
    vehicle, log = load_vehicle("feisi_x150"), thinned(read_flight(RECORDED).between(6.0, 12.0))
    heard: dict[str, list[Message]] = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind(("127.0.0.1", 0))
        station.settimeout(0.1)
        to = Address("127.0.0.1", station.getsockname()[1])
        live = Listening(vehicle, publish=to, publish_system=9)
        player = threading.Thread(target=play, args=(log, live.address, 1.0))
        player.start()
        reader = parser()
        while player.is_alive():
            with contextlib.suppress(TimeoutError):
                for message in reader.parse_buffer(station.recv(1000)) or ():
                    heard.setdefault(message.get_type(), []).append(message)
        status = live.end()
    assert {m.get_srcSystem() for several in heard.values() for m in several} == {9}
    assert {"HEARTBEAT", "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED", "HIGHRES_IMU"} == set(heard)
    assert len(heard["HIGHRES_IMU"]) > 20
    last = {kind: several[-1] for kind, several in heard.items()}
    position = last["LOCAL_POSITION_NED"]
    t_s = 1e-3 * position.time_boot_ms - 10.0
    flown_at = signal_of(log, POS).at(np.array([t_s - 0.1]))[0]
    assert np.linalg.norm((position.x, position.y, position.z) - flown_at) < 1.5
    acc = np.array([m.zacc for m in heard["HIGHRES_IMU"]])
    assert -16.0 < acc.mean() < -5.0
    assert math.isfinite(status.published_age_p99_s)
    print(f"age p99 {1e3 * status.published_age_p99_s:.1f} ms, busy {status.busy:.0%}")


def thinned(flight: Flight) -> Flight:
    """Commands at 95 Hz: what is measured is the link, not the machine."""
    table = flight.table.copy()
    told_at = np.flatnonzero(table["cmd_1"].notna())
    left_out = np.setdiff1d(told_at, told_at[::7])
    table.loc[left_out, [f"cmd_{i}" for i in range(1, 5)]] = np.nan
    return replace(flight, table=table)
