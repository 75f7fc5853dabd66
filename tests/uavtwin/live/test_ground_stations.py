"""Ground stations of others hear the twin: MAVSDK's native library, MAVProxy (`make
ground-stations`)."""

import json
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
from places import needs_package
from sample_logs import flown_table

from twin.logs import Flight
from twin.logs.mavlink.frames import Frame, Message, dialect, frames, parser
from twin.vehicle_file import load_vehicle
from uavtwin.live.replay import Replay
from uavtwin.live.session import LiveOptions, LiveSession
from uavtwin.sockets import Address

TWIN, SECONDS = 9, 12.0
FLOAT32 = 2.0**-23
MAVSDK = """
import json, sys, time
from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.telemetry import Telemetry

station = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
station.add_any_connection(sys.argv[1])
system = station.first_autopilot(timeout_s=20.0)
heard = {"system": system.get_system_id() if system else None, "q": [], "ned": [], "imu": []}
if system:
    telemetry = Telemetry(system)
    telemetry.subscribe_attitude_quaternion(
        lambda q, _: heard["q"].append([q.timestamp_us, q.w, q.x, q.y, q.z])
    )
    telemetry.subscribe_position_velocity_ned(
        lambda m, _: heard["ned"].append(
            [m.position.north_m, m.position.east_m, m.position.down_m]
            + [m.velocity.north_m_s, m.velocity.east_m_s, m.velocity.down_m_s]
        )
    )
    telemetry.subscribe_imu(
        lambda m, _: heard["imu"].append(
            [m.timestamp_us]
            + [m.acceleration_frd.forward_m_s2, m.acceleration_frd.right_m_s2]
            + [m.acceleration_frd.down_m_s2, m.angular_velocity_frd.forward_rad_s]
            + [m.angular_velocity_frd.right_rad_s, m.angular_velocity_frd.down_rad_s]
        )
    )
    time.sleep(4.0)
json.dump(heard, open(sys.argv[2], "w"))
"""


@contextmanager
def published(to: Address) -> Iterator[dict[str, list[Message]]]:
    """A flight that is heard, and its twin sent to a station; what was sent, by kind."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_port:
        any_port.bind(("127.0.0.1", 0))
        listen = Address("127.0.0.1", any_port.getsockname()[1])
    options = LiveOptions(listen, publish=to, publish_system=TWIN)
    session = LiveSession(load_vehicle("copter_default"), options)
    publisher, sent = session._publisher, dict[str, list[Message]]()
    assert publisher is not None
    send: Callable[[Message], None] = publisher._send

    def noted(message: Message) -> None:
        send(message)
        sent.setdefault(message.get_type(), []).append(message)

    publisher._send = noted  # type: ignore[method-assign]
    over = threading.Event()
    listening = threading.Thread(target=session.run, args=(over.is_set,))
    aircraft = Replay(listen, 1.0)
    flight = Flight("flown", flown_table().iloc[: round(100 * 2 * SECONDS)])

    def play() -> None:
        with suppress(_OverError):
            aircraft.play(flight, end)

    def end(_: float) -> None:
        if over.is_set():
            raise _OverError

    playing = threading.Thread(target=play)
    listening.start()
    playing.start()
    try:
        yield sent
    finally:
        over.set()
        playing.join()
        listening.join()
        aircraft.close()


class _OverError(Exception):
    """The station has heard enough."""


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_port:
        any_port.bind(("127.0.0.1", 0))
        return int(any_port.getsockname()[1])


def known(rows: np.ndarray, sent: np.ndarray) -> None:
    """Each row that was heard is one that was sent, in float32."""
    off = [np.abs(sent - row).max(axis=1).min() for row in rows]
    assert max(off) <= FLOAT32 * max(1.0, float(np.abs(rows).max())), max(off)


@pytest.mark.slow
@needs_package("mavsdk")
def test_mavsdk_hears_the_twin(tmp_path: Path) -> None:
    port, report = free_port(), tmp_path / "heard.json"
    with published(Address("127.0.0.1", port)) as sent:
        subprocess.run(
            [sys.executable, "-c", MAVSDK, f"udpin://127.0.0.1:{port}", report],
            check=True,
            capture_output=True,
            timeout=900,
        )
    heard = json.loads(report.read_text())
    assert heard["system"] == TWIN
    assert min(len(heard[k]) for k in ("q", "ned", "imu")) > 20
    print({k: len(heard[k]) for k in ("q", "ned", "imu")})
    q = {m.time_boot_ms: (m.q1, m.q2, m.q3, m.q4) for m in sent["ATTITUDE_QUATERNION"]}
    for t_us, *row in heard["q"]:
        np.testing.assert_allclose(row, q[t_us // 1000], rtol=0, atol=FLOAT32)
    ned = [(m.x, m.y, m.z, m.vx, m.vy, m.vz) for m in sent["LOCAL_POSITION_NED"]]
    known(np.array(heard["ned"]), np.array(ned))
    imu = [(m.xacc, m.yacc, m.zacc, m.xgyro, m.ygyro, m.zgyro) for m in sent["HIGHRES_IMU"]]
    known(np.array(heard["imu"])[:, 1:], np.array(imu))


@pytest.mark.slow
@needs_package("MAVProxy")
def test_mavproxy_hears_the_twin(tmp_path: Path) -> None:
    """It goes online on the twin, and its own telemetry log holds what was sent."""
    port, log = free_port(), tmp_path / "mav.tlog"
    with published(Address("127.0.0.1", port)) as sent:
        station = subprocess.Popen(
            [
                *(sys.executable, Path(sys.executable).with_name("mavproxy.py")),
                f"--master=udpin:127.0.0.1:{port}",
                *("--daemon", "--state-basedir", tmp_path, "--logfile", log),
                *("--default-modules", "log"),
            ],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            text=True,
            cwd=tmp_path,
        )
        time.sleep(SECONDS)
        station.terminate()
        said, _ = station.communicate(timeout=300)
    assert f"online system {TWIN}" in said, said
    (tlog,) = tmp_path.rglob("mav.tlog")
    heard: dict[str, list[Message]] = {}
    reader = parser()
    for frame in frames(tlog.read_bytes()):
        if isinstance(frame, Frame) and frame.system == TWIN:
            for m in reader.parse_buffer(frame.content) or ():
                heard.setdefault(m.get_type(), []).append(m)
    assert len(heard["HEARTBEAT"]) > 3 and len(heard["LOCAL_POSITION_NED"]) > 50
    assert {m.type for m in heard["HEARTBEAT"]} == {dialect.MAV_TYPE_QUADROTOR}
    there = {m.time_boot_ms: m for m in sent["LOCAL_POSITION_NED"]}
    for m in heard["LOCAL_POSITION_NED"]:
        of = there[m.time_boot_ms]
        np.testing.assert_allclose((m.x, m.y, m.z), (of.x, of.y, of.z), rtol=FLOAT32)
