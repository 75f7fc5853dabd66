"""A live flight beside what else a network brings: a flood, and aircraft of the older protocol."""

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from sample_logs import flown_table

from benchmarks.live_load.flood import FLOODS, flooding
from twin.logs import Flight, read_flight
from twin.logs.mavlink.encode import attitude, heartbeat, imu, local_position
from twin.logs.mavlink.frames import AUTOPILOT, Message, dialect, parser
from twin.vehicle_file import load_vehicle
from uavtwin.live.datagrams import Receiver
from uavtwin.live.replay import MAX_SPEED, Replay
from uavtwin.live.session import LiveOptions, LiveSession
from uavtwin.live.status import LiveStatus
from uavtwin.sockets import Address

ROWS = 1200


def free_address() -> Address:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_port:
        any_port.bind(("127.0.0.1", 0))
        return Address("127.0.0.1", any_port.getsockname()[1])


@contextmanager
def heard(record: Path | None = None) -> Iterator[tuple[Address, list[LiveStatus]]]:
    """A session in a thread, and what it told at its end."""
    options = LiveOptions(free_address(), record=record)
    session, status = LiveSession(load_vehicle("copter_default"), options), list[LiveStatus]()
    stop = threading.Event()
    thread = threading.Thread(target=lambda: status.append(session.run(stop.is_set)))
    thread.start()
    try:
        yield options.listen, status
        time.sleep(0.3)
    finally:
        stop.set()
        thread.join(60)
    assert status


def play(to: Address, table: Flight) -> None:
    aircraft = Replay(to, MAX_SPEED)
    try:
        aircraft.play(table)
    finally:
        aircraft.close()


@pytest.mark.slow
@pytest.mark.parametrize("kind", FLOODS)
def test_a_megabyte_a_second_beside_the_aircraft(kind: str, tmp_path: Path) -> None:
    """Nothing of the aircraft is lost, and the residuals are those without the flood."""
    flight = Flight("flown", flown_table().iloc[:ROWS])
    with heard() as (where, quiet):
        play(where, flight)
    with heard(tmp_path / "rec") as (where, loud):
        aircraft = Replay(where, MAX_SPEED)
        aircraft.play(Flight("flown", flown_table().iloc[:2]))  # it is the one that is heard first
        with flooding(where, kind, 1e6) as flood:
            aircraft.play(Flight("flown", flown_table().iloc[2:ROWS]))
            while (sent := flood.sent_bytes()) < 1e5:  # a quick machine has flown before
                time.sleep(0.01)
        aircraft.close()
    status = loud[0]
    assert status.link.lost == 0 and status.link.late == 0
    table = read_flight(tmp_path / "rec" / "flight.parquet").table
    assert len(table) == ROWS and float(np.abs(table["acc_x"]).max()) < 50.0
    for name, rms in quiet[0].rms.items():
        assert status.rms[name] == pytest.approx(rms, rel=1e-6), name
    strange = status.link.garbage + 80 * (status.link.wrong + sum(status.link.others.values()))
    assert strange > 0.75 * sent


def test_random_bytes_are_no_aircraft() -> None:
    """A frame of a kind that nobody knows has no checksum that could be tested."""
    receiver, sender = Receiver(), ("127.0.0.1", 1)
    unknown = bytes([0xFD, 1, 0, 0, 0, 21, 1, 0xFF, 0xFF, 0x70, 5, 1, 2])
    assert not list(receiver.messages(unknown, sender)) and receiver.system is None
    beat = bytes(heartbeat(4).pack(parser(3, AUTOPILOT)))
    assert len(list(receiver.messages(beat, sender))) == 1 and receiver.system == 3


@pytest.mark.slow
def test_an_aircraft_that_begins_anew_is_heard_through_a_flood() -> None:
    """It sends from another port of its machine; what floods has not been silent meanwhile."""
    with heard() as (where, status):
        play(where, Flight("flown", flown_table().iloc[:50]))
        with flooding(where, "valid", 2e5):
            time.sleep(2.5)
            play(where, Flight("flown", flown_table().iloc[:400]))
    assert status[0].sections == 2 or status[0].flight_s > 3.5


def of_the_older_protocol(row: dict[str, float], t_us: int) -> list[Message]:
    """What MAVLink 1 has numbers for: below 256."""
    q, omega = ([row[f"{n}_{a}"] for a in axes] for n, axes in (("q", "wxyz"), ("gyro", "xyz")))
    pos, vel = ([row[f"{n}_{a}"] for a in "xyz"] for n in ("pos", "vel"))
    pulses = [round(1000 + 1000 * row[f"cmd_{i}"]) for i in range(1, 5)]
    found = [
        imu(t_us, row),
        attitude(t_us, q, omega),
        local_position(t_us, pos, vel),
        dialect.MAVLink_servo_output_raw_message(t_us, 0, *pulses, 0, 0, 0, 0),
    ]
    return [m for m in found if m is not None]


@pytest.mark.slow
def test_an_aircraft_that_speaks_mavlink_1(tmp_path: Path) -> None:
    """It is read and counted; the twin flies on its pulses, and residuals are told."""
    table = flown_table().iloc[:800].drop(columns="phase")
    packer = parser(1, AUTOPILOT)
    with (
        heard(tmp_path / "rec") as (where, status),
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as aircraft,
    ):
        for k, row in enumerate(table.to_dict("records")):
            t_us = 10_000_000 + round(1e6 * row["time"])
            messages = of_the_older_protocol({str(n): v for n, v in row.items()}, t_us)
            for message in [heartbeat(4), *messages] if k % 100 == 0 else messages:
                frame = message.pack(packer, force_mavlink1=True)
                aircraft.sendto(frame, where.pair)
                packer.seq = (packer.seq + 1) % 256
            time.sleep(0.001)
    (live,) = status
    assert live.link.version_1 == live.link.messages == 4 * 800 + 8 and live.link.lost == 0
    assert live.sources["cmd"] == "SERVO_OUTPUT_RAW" and live.sources["q"] == "ATTITUDE_QUATERNION"
    assert {"acc_z", "gyro_x", "vel_x"} <= set(live.rms)
    recorded = read_flight(tmp_path / "rec" / "flight.parquet")
    _, commands = recorded.signal(["cmd_1"])
    np.testing.assert_allclose(commands[:, 0], table["cmd_1"], atol=6e-4)  # whole us of a pulse


@pytest.mark.slow
def test_the_flood_is_what_it_says() -> None:
    """A sender of its own, no faster than asked for, that ends with its block."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sink:
        sink.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8 << 20)
        sink.bind(("127.0.0.1", 0))
        sink.settimeout(5.0)
        began = time.monotonic()
        with flooding(Address("127.0.0.1", sink.getsockname()[1]), "valid", 1e6) as flood:
            reader = parser()
            came = reader.parse_buffer(sink.recv(65536)) or ()
            time.sleep(1.0)
            sent = flood.sent_bytes()
            since_start_s = time.monotonic() - began
        assert {m.get_type() for m in came} == {"HIGHRES_IMU"}
        assert 0 < sent < 1e6 * since_start_s
    assert not flood.process.is_alive()
