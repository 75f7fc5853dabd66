"""`uavtwin hil` as it is called, and autopilots that do what they should not."""

import contextlib
import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli_rig import run

from twin.logs.mavlink.encode import Controls, heartbeat
from twin.logs.mavlink.frames import Message, parser
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from uavtwin.demo.autopilot import HOP, Pilot, StandIn
from uavtwin.demo.flights import WAYPOINTS
from uavtwin.hil.flying import FlyingTwin, flying_twin_of
from uavtwin.hil.session import HilOptions, HilSession, HilStatus
from uavtwin.sockets import Address

OPTIONS = HilOptions(Address("127.0.0.1", 0), speed=float("inf"), patience_s=60.0, start_s=60.0)
"""As patient as a busy machine asks for."""


@pytest.fixture(scope="module")
def copter() -> Vehicle:
    return load_vehicle("copter_default")


@pytest.fixture(scope="module")
def built(copter: Vehicle, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fmu")
    flying_twin_of(copter, folder).close()
    (fmu,) = folder.glob("*.fmu")
    return fmu


@pytest.fixture
def twin(built: Path) -> Iterator[FlyingTwin]:
    with closing(FlyingTwin(built, {}, ())) as flying:
        yield flying


def against(
    autopilot: Callable[[Address], object],
    copter: Vehicle,
    twin: FlyingTwin,
    options: HilOptions = OPTIONS,
) -> HilStatus:
    """A session with an autopilot in a thread; both come to an end."""
    session = HilSession(copter, twin, options)
    where = Address("127.0.0.1", session.link.port)
    thread = threading.Thread(target=autopilot, args=(where,))
    thread.start()
    began = time.monotonic()
    status = session.run(lambda: time.monotonic() - began > 300)
    thread.join(60)
    assert not thread.is_alive()
    return status


def quietly(stand_in: StandIn) -> Callable[[Address], None]:
    """What the simulator hangs up on is no error of the stand-in's."""

    def fly(where: Address) -> None:
        with contextlib.suppress(ConnectionError, TimeoutError):
            stand_in.fly(where)

    return fly


@pytest.mark.slow
def test_an_autopilot_that_goes_silent_ends_the_flight(copter: Vehicle, twin: FlyingTwin) -> None:
    def until_half_a_second(controls: Controls) -> Controls | None:
        return controls if controls.t_us < 500_000 else None

    silent = quietly(StandIn(Pilot(copter), answers=until_half_a_second))
    status = against(silent, copter, twin, replace(OPTIONS, patience_s=2.0))
    assert not status.fine and 0.49 < status.flight_s < 0.6
    assert "has not answered for 2.0 s" in status.ended and "of the flight" in status.ended


@pytest.mark.slow
def test_a_connection_that_is_lost_ends_the_flight(copter: Vehicle, twin: FlyingTwin) -> None:
    def hang_up(controls: Controls) -> Controls:
        if controls.t_us >= 400_000:
            raise TimeoutError
        return controls

    status = against(quietly(StandIn(Pilot(copter), answers=hang_up)), copter, twin)
    assert not status.fine and 0.39 < status.flight_s < 0.5
    assert "has closed the connection" in status.ended or "is lost" in status.ended


def test_an_autopilot_of_another_clock_is_told_so(copter: Vehicle, twin: FlyingTwin) -> None:
    """In lockstep an answer has the time of HIL_SENSOR; anything else would be guessed at."""

    def behind(controls: Controls) -> Controls:
        return replace(controls, t_us=controls.t_us // 2)

    options = replace(OPTIONS, patience_s=2.0)
    status = against(quietly(StandIn(Pilot(copter), answers=behind)), copter, twin, options)
    assert not status.fine
    assert "has not answered" in status.ended or "its clock is that of HIL_SENSOR" in status.ended


@pytest.mark.slow
def test_a_board_with_its_own_clock_is_flown_in_real_time(
    copter: Vehicle, twin: FlyingTwin
) -> None:
    def on_board(controls: Controls) -> Controls:
        return replace(controls, t_us=123, lockstep=False)

    options = replace(OPTIONS, duration_s=1.0)
    status = against(quietly(StandIn(Pilot(copter), answers=on_board)), copter, twin, options)
    assert status.fine and not status.lockstep and status.answers > 2
    assert status.wall_s >= 0.99


@pytest.mark.slow
def test_one_that_says_nothing_is_asked_whether_it_is_an_autopilot(
    copter: Vehicle, twin: FlyingTwin
) -> None:
    def listen(where: Address) -> None:
        with socket.create_connection(where.pair, timeout=60) as wire:
            wire.sendall(heartbeat(4).pack(parser(1, 1)))
            while wire.recv(65536):
                pass

    status = against(listen, copter, twin, replace(OPTIONS, start_s=1.0))
    assert not status.fine and "no HIL_ACTUATOR_CONTROLS within 1 s" in status.ended


def test_one_that_speaks_something_else_is_no_autopilot(copter: Vehicle, twin: FlyingTwin) -> None:
    rng = np.random.default_rng(0)

    def babble(where: Address) -> None:
        with (
            socket.create_connection(where.pair, timeout=60) as wire,
            contextlib.suppress(ConnectionError),
        ):
            while True:
                wire.sendall(bytes(rng.integers(0, 250, 4096, dtype=np.uint8)))

    status = against(babble, copter, twin)
    assert not status.fine and "it is no autopilot" in status.ended


@pytest.mark.slow
def test_one_that_reads_nothing_is_not_waited_for(copter: Vehicle, twin: FlyingTwin) -> None:
    """Its buffers fill; the simulator says so instead of standing still."""
    options, done = replace(OPTIONS, patience_s=0.5), threading.Event()
    session = HilSession(copter, twin, options)
    where = Address("127.0.0.1", session.link.port)

    def stuck() -> None:
        with socket.socket() as wire:
            wire.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            wire.connect(where.pair)
            wire.sendall(b"\x00")
            done.wait(60)

    thread = threading.Thread(target=stuck)
    thread.start()
    assert session.link.wait(lambda: False)
    with pytest.raises(Exception, match=r"has read nothing for 0\.5 s"):
        while True:
            session.link.send([heartbeat(4)] * 1000)
    done.set()
    thread.join()
    session.link.close()


@pytest.mark.slow
def test_garbage_and_a_second_autopilot_do_not_disturb_the_first(
    copter: Vehicle, twin: FlyingTwin
) -> None:
    stand_in, rng = StandIn(Pilot(copter)), np.random.default_rng(3)
    refused: list[bytes] = []

    def disturbed(where: Address) -> None:
        class Noisy(socket.socket):
            """Sends garbage and a damaged frame before every frame."""

            def sendall(self, data: bytes, flags: int = 0) -> None:  # type: ignore[override]
                broken = bytearray(data)
                broken[-1] ^= 0x55
                noise = bytes(rng.integers(0, 250, 20, dtype=np.uint8))
                super().sendall(noise + bytes(broken) + data, flags)

        with Noisy() as wire:
            wire.settimeout(60)
            wire.connect(where.pair)
            with socket.create_connection(where.pair, timeout=60) as second:
                time.sleep(0.1)
                threading.Thread(target=lambda: refused.append(second.recv(100))).start()
                stand_in._fly(wire)

    status = against(disturbed, copter, twin, replace(OPTIONS, duration_s=1.0))
    assert status.fine and status.lockstep, status
    assert status.link["refused"] == 1 and refused == [b""]
    assert status.link["garbage"] > 1000 and status.link["wrong"] > 100
    assert status.answers >= 249


def test_nobody_connects(copter: Vehicle, twin: FlyingTwin) -> None:
    session = HilSession(copter, twin, OPTIONS)
    began = time.monotonic()
    status = session.run(lambda: time.monotonic() - began > 0.3)
    assert not status.fine and status.ended == "ended before an autopilot connected"
    assert status.line() == "no autopilot has connected yet"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--listen", "udpin:127.0.0.1:4560"), "write tcpin:HOST:PORT, tcpin:127.0.0.1:4560"),
        pytest.param(
            *(("--listen", "tcpin:192.0.2.1:4560"), "cannot be listened at"), marks=pytest.mark.slow
        ),
        (("--rate", "300"), "1000 over a whole number"),
        (("--speed", "0"), "more than 0"),
        (("--speed", "quick"), "a number, or max"),
        (("--patience", "0"), "up to 3600 s"),
        (("--place", "91,0,0"), "LATITUDE,LONGITUDE,HEIGHT"),
        (("--effect", "magic"), "effect"),
        (("--model", "/nowhere/at/all"), "/nowhere/at/all"),
        (("--publish", "udpout:127.0.0.1:9"), "--hil --publish: listens to an aircraft"),
    ],
)
def test_hil_used_wrongly(
    arguments: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, err = run(capsys, "live", "--hil", "--vehicle", "copter_default", *arguments)
    assert code == 2 and said in err.replace("\n", " ")


def test_what_is_for_an_autopilot_needs_hil(capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = run(capsys, "live", "--vehicle", "copter_default", "--rate", "250")
    assert code == 2 and "live --rate: is for --hil" in err


@pytest.mark.slow
def test_a_demonstration_needs_neither_vehicle_nor_autopilot(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The stand-in flies every leg of its course and lands where it began."""
    with socket.socket() as any_port:
        any_port.bind(("127.0.0.1", 0))
        listen = f"tcpin:127.0.0.1:{any_port.getsockname()[1]}"
    code, out, _ = run(
        capsys, *("live", "--hil", "--demo", "--listen", listen, "--speed", "max", "--json")
    )
    status = json.loads(out)
    seconds = sum(leg[1] for leg in WAYPOINTS)
    assert code == 0 and status["lockstep"] and status["flight_s"] == seconds
    assert status["position_n"] == pytest.approx(WAYPOINTS[-1][2], abs=0.3)
    assert status["clipped"] == status["unknown"] == 0


@pytest.mark.slow
def test_a_demonstration_flies_at_any_place(capsys: pytest.CaptureFixture[str]) -> None:
    """300 km from the usual place and 100 m lower it hovers where it should."""
    with socket.socket() as any_port:
        any_port.bind(("127.0.0.1", 0))
        listen = f"tcpin:127.0.0.1:{any_port.getsockname()[1]}"
    code, out, _ = run(
        capsys,
        *("live", "--hil", "--demo", "--listen", listen, "--speed", "max", "--json"),
        *("--place", "47,8,400", "--duration", "8"),
    )
    hovers = WAYPOINTS[2][2]
    assert code == 0 and json.loads(out)["position_n"] == pytest.approx(hovers, abs=0.3)


@pytest.mark.slow
def test_the_verb_flies_an_autopilot(copter: Vehicle, capsys: pytest.CaptureFixture[str]) -> None:
    """By its former name, at a place, in wind; the flight ends with the autopilot's waypoints."""
    with socket.socket() as any_port:
        any_port.bind(("127.0.0.1", 0))
        port = any_port.getsockname()[1]
    heard: list[Message] = []
    stand_in = StandIn(Pilot(copter), on_message=heard.append)

    def connect() -> None:
        for _ in range(600):
            with contextlib.suppress(ConnectionRefusedError):
                return stand_in.fly(Address("127.0.0.1", port))
            time.sleep(0.05)
        return None

    autopilot = threading.Thread(target=connect)
    autopilot.start()
    seconds = sum(leg[1] for leg in HOP)
    code, out, err = run(
        capsys,
        *("hil", "--vehicle", "copter_default", "--listen", f"tcpin:127.0.0.1:{port}"),
        *("--speed", "max", "--duration", seconds, "--wind", "1,0,0", "--json"),
        *("--place", "48,11,500"),
    )
    autopilot.join()
    status = json.loads(out)
    assert code == 0 and status["ended"] == "the duration is over" and status["lockstep"]
    assert status["flight_s"] == seconds and status["armed_s"] == pytest.approx(
        seconds - 0.5, abs=0.1
    )
    assert status["position_n"] == pytest.approx([2.0, 1.0, -2.0], abs=0.4)
    assert "waiting for an autopilot" in err
    first = next(m for m in heard if m.get_type() == "HIL_SENSOR")
    assert np.array([first.xmag, first.zmag]) == pytest.approx(
        [0.211, 0.438], abs=0.01
    )  # that of the vehicle is of there
