"""An autopilot's closed loop over the socket is the same loop in process."""

import threading
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from twin.errors import TwinError
from twin.frames import AXES
from twin.logs.mavlink.encode import Controls, controls_of, hil_controls
from twin.logs.mavlink.frames import Message, parser
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from uavtwin.demo.autopilot import (
    HOP,
    Pilot,
    StandIn,
    flown_meanwhile,
    motion_of,
)
from uavtwin.hil.flying import FlyingTwin, TwinState, flying_twin_of
from uavtwin.hil.session import PLACE, HilOptions, HilSession
from uavtwin.sockets import Address

Array = NDArray[np.float64]
ANY_PORT = Address("127.0.0.1", 0)
PERIOD_US = 4000  # between two HIL_SENSOR
ROUNDED_M = 0.0056
"""HIL_STATE_QUATERNION tells 1e-7 degrees: 11 mm northwards, rounded to half of it."""
STEPS = round(1e6 * sum(leg[1] for leg in HOP) / PERIOD_US)


@pytest.fixture(scope="module")
def copter() -> Vehicle:
    return load_vehicle("copter_default")


@pytest.fixture
def twin(copter: Vehicle, tmp_path: Path) -> Iterator[FlyingTwin]:
    with closing(flying_twin_of(copter, tmp_path)) as flying:
        yield flying


def wired(message: Message) -> Message:
    (read,) = parser().parse_buffer(message.pack(parser(1, 1)))
    return read


def in_process(vehicle: Vehicle, twin: FlyingTwin, rounded: bool) -> tuple[Array, Array]:
    """Positions and commands of the loop without a socket.

    Args:
        vehicle: That flies.
        twin: At its start.
        rounded: Whether motion and commands are those of messages, or float64 throughout.
    """
    pilot, simulator = Pilot(vehicle), HilSession(vehicle, twin, HilOptions(ANY_PORT))
    controls: Controls | None = None
    places, commands = [], []
    for k in range(1, STEPS + 1):
        commands.append(simulator.commands(controls))
        flown = twin.fly(commands[-1], k * PERIOD_US / 1e6)
        motion = true_motion(flown)
        if rounded:
            sent = {m.get_type(): wired(m) for m in simulator.messages(k, flown)}
            motion = motion_of(sent["HIL_STATE_QUATERNION"])
        controls = pilot.controls(k * PERIOD_US, motion)
        if rounded:
            controls = controls_of(wired(hil_controls(controls)))
        places.append(flown["pos"])
    simulator.link.close()
    return np.array(places), np.array(commands)


def true_motion(flown: TwinState) -> dict[str, float]:
    vectors = {n: flown[n] for n in ("pos", "vel", "omega")}
    status = {
        f"{n}_{a}": v for n, values in vectors.items() for a, v in zip(AXES, values, strict=True)
    }
    return status | dict(zip(("q_w", "q_x", "q_y", "q_z"), flown["q"], strict=True))


class Watched(FlyingTwin):
    """Notes where it has been and on what."""

    places: list[list[float]]
    commands: list[list[float]]

    def fly(self, commands: object, until_s: float) -> TwinState:
        flown = super().fly(commands, until_s)  # type: ignore[arg-type]
        self.places.append(flown["pos"])
        self.commands.append(list(commands))  # type: ignore[call-overload]
        return flown


def over_the_socket(vehicle: Vehicle, folder: Path) -> tuple[Array, Array, list[Message]]:
    with closing(flying_twin_of(vehicle, folder)) as twin:
        twin.__class__ = Watched
        assert isinstance(twin, Watched)
        twin.places, twin.commands = [], []
        options = HilOptions(ANY_PORT, speed=float("inf"), duration_s=STEPS * PERIOD_US / 1e6)
        session, heard = HilSession(vehicle, twin, options), list[Message]()
        stand_in = StandIn(Pilot(vehicle), on_message=heard.append)
        where = Address("127.0.0.1", session.link.port)
        autopilot = threading.Thread(target=stand_in.fly, args=(where,))
        autopilot.start()
        status = session.run()
        autopilot.join()
        assert status.fine and status.ended == "the duration is over" and status.lockstep
        assert status.clipped == status.unknown == 0 and status.answers >= STEPS - 1
        return np.array(twin.places), np.array(twin.commands), heard


@pytest.mark.slow
def test_the_loop_through_the_socket_is_the_loop_in_process(
    copter: Vehicle, twin: FlyingTwin, tmp_path: Path
) -> None:
    """With the same messages in memory: to the last bit. Without any: what they round off.

    A position is rounded by 6 mm; what is rounded changes from step to step, and the loop, which
    is far slower, feels its mean (measured: 0.9 mm off at most).
    """
    (tmp_path / "wire").mkdir()
    (tmp_path / "exact").mkdir()
    places, commands, heard = over_the_socket(copter, tmp_path / "wire")
    assert np.linalg.norm(places[-1] - (2.0, 1.0, -2.0 - copter.leg_height_m)) < 0.3
    same_places, same_commands = in_process(copter, twin, rounded=True)
    np.testing.assert_array_equal(places, same_places)
    np.testing.assert_array_equal(commands, same_commands)
    with closing(flying_twin_of(copter, tmp_path / "exact")) as again:
        exact, _ = in_process(copter, again, rounded=False)
    off_m = np.linalg.norm(places - exact, axis=1)
    print(
        f"off by at most {1e3 * off_m.max():.1f} mm, rms {1e3 * np.sqrt(np.mean(off_m**2)):.1f} mm"
    )
    assert 0.0 < off_m.max() < ROUNDED_M
    check_rates(heard)


def check_rates(messages: list[Message]) -> None:
    """250 Hz of HIL_SENSOR, with magnetometer and barometer at 50, the receiver at 10."""
    heard: dict[str, list[Message]] = {}
    for message in messages:
        heard.setdefault(message.get_type(), []).append(message)
    times = np.array([m.time_usec for m in heard["HIL_SENSOR"]])
    assert len(times) == STEPS and np.all(np.diff(times) == PERIOD_US)
    updated = [m.fields_updated for m in heard["HIL_SENSOR"]]
    assert sum(bool(u & 0x1000) for u in updated) == pytest.approx(STEPS / 5, abs=1)
    assert all(u & 0x3F == 0x3F for u in updated)
    assert len(heard["HIL_GPS"]) == pytest.approx(STEPS / 25, abs=1)
    assert len(heard["HEARTBEAT"]) == pytest.approx(STEPS / 250, abs=1)
    assert len(heard["HIL_STATE_QUATERNION"]) == STEPS


@pytest.mark.parametrize("period_us", [1000, 20000])
def test_the_controller_runs_by_the_times_of_the_messages(copter: Vehicle, period_us: int) -> None:
    """Its states after half a second away from its setpoints are the same at any rate."""
    still = {f"{n}_{a}": 0.0 for n in ("pos", "vel", "omega") for a in AXES}
    still |= {"q_w": 1.0, "q_x": 0.0, "q_y": 0.0, "q_z": 0.0}
    hover, off = (("hover", 3.0, (0.0, 0.0, 0.0)),), {"pos_x": 0.2}
    pilot, whole = (Pilot(copter, hover) for _ in range(2))
    for t_us in range(period_us, 500_001, period_us):
        pilot.controls(t_us, still | off)
    for t_us in (period_us, 500_000):
        whole.controls(t_us, still | off)
    assert pilot._run.x == pytest.approx(whole._run.x, rel=1e-3, abs=1e-6)
    assert np.abs(pilot._run.x).max() > 0.01


@pytest.mark.slow
def test_what_fails_in_the_stand_in_is_raised(copter: Vehicle, twin: FlyingTwin) -> None:
    class Failing(Pilot):
        """Fails after a while."""

        def controls(self, t_us: int, motion: dict[str, float]) -> Controls:
            if t_us > 100_000:
                raise ArithmeticError("no controls")
            return super().controls(t_us, motion)

    session = HilSession(copter, twin, HilOptions(ANY_PORT, speed=float("inf"), duration_s=1.0))
    where = Address("127.0.0.1", session.link.port)
    with (
        pytest.raises(ArithmeticError, match="no controls"),
        flown_meanwhile(Failing(copter), where, PLACE),
    ):
        status = session.run()
    assert not status.fine and status.flight_s < 0.2


@pytest.mark.slow
def test_effects_of_the_vehicle_fly(copter: Vehicle, tmp_path: Path) -> None:
    """A rotor that gives 15 % less thrust has to be asked for more."""
    loss = {f"loss_{i}": 0.15 * (i == 2) for i in range(1, 5)} | {"torque_share": 1.0}
    damaged = copter.with_effects({"rotor_efficiency_loss": loss})
    held = {}
    for name, vehicle in (("whole", copter), ("damaged", damaged)):
        (tmp_path / name).mkdir()
        with closing(flying_twin_of(vehicle, tmp_path / name)) as flying:
            _, commands = in_process(copter, flying, rounded=False)
        held[name] = commands[-250:].mean(axis=0)
    more = held["damaged"] / held["whole"]
    assert more.argmax() == 1 and more[1] > 1.05


@pytest.mark.slow
def test_motors_that_are_not_armed_stand_still(copter: Vehicle, twin: FlyingTwin) -> None:
    session = HilSession(copter, twin, HilOptions(ANY_PORT))
    asked = (0.5, float("nan"), 1.2, -0.1)
    assert session.commands(None) == [0.0] * 4
    assert session.commands(Controls(1, asked, False, True)) == [0.0] * 4
    assert session.commands(Controls(1, asked, True, True)) == [0.5, 0.0, 1.0, 0.0]
    status = session.known()
    assert (status.clipped, status.unknown) == (2, 1)
    session.link.close()


def test_a_vehicle_known_by_rotor_speed_is_refused(copter: Vehicle, tmp_path: Path) -> None:
    spun = replace(copter, rotors=replace(copter.rotors, speed_rad_s=()))
    with pytest.raises(TwinError, match="an autopilot gives motor commands"):
        flying_twin_of(spun, tmp_path)
