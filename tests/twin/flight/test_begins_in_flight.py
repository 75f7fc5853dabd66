"""Effects that begin in mid-flight: nothing before, all of it from then on."""

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from rig import plain

from twin.errors import ModelError
from twin.flight.closed_loop import STEP_S, fly, standing
from twin.flight.lqr import controller
from twin.flight.simulate_flight import Later, Recorder, Stream, simulate_flight
from twin.frames import to_ned
from twin.logs import Flight
from twin.logs.columns import ACC, GYRO, POS, QUAT, VEL
from twin.physics.airframe import airframe
from uavtwin.demo.flights import setpoints_along

Array = NDArray[np.float64]
VEHICLE = plain()
BEGINS_S = 4.0
UP = (("ground", 0.5, (0.0, 0.0, 0.0)), ("takeoff", 2.0, (0.0, 0.0, -1.0)))
WAYPOINTS = (*UP, ("hover", 3.5, (0.0, 0.0, -1.0)))
RECORDER = Recorder(
    (Stream(ACC, 0.005, 0.01), Stream(GYRO, 0.005, 0.001), Stream(POS, 0.01)), 200.0, 1000.0, seed=5
)


@cache
def flown(effect: str = "", **numbers: float) -> Flight:
    setpoints, phases = setpoints_along(VEHICLE, WAYPOINTS)
    later = Later({effect: numbers}, BEGINS_S) if effect else None
    return simulate_flight(setpoints, phases, VEHICLE, VEHICLE, RECORDER, later=later)


def apart(flight: Flight, column: str) -> tuple[Array, Array]:
    """What an effect adds to a column, before it begins and afterwards."""
    more = flight.table[column].to_numpy() - flown().table[column].to_numpy()
    before = flight.time_s < BEGINS_S
    return more[before & np.isfinite(more)], more[~before & np.isfinite(more)]


@pytest.mark.slow
def test_the_aircraft_changes_where_it_is() -> None:
    """A twentieth of the mass dropped: 5 % more specific force at once, and it climbs."""
    lighter = flown("mass_offset", mass_kg=-0.05 * VEHICLE.mass_kg)
    before, after = apart(lighter, "acc_z")
    assert np.all(before == 0)
    assert after[:3].mean() == pytest.approx(-9.81 * (1 / 0.95 - 1), rel=0.05)
    before, after = apart(lighter, "pos_z")
    assert np.all(before == 0)
    assert after[-1] < -0.005


@pytest.mark.slow
@pytest.mark.parametrize("begins", [False, True])
def test_the_pose_is_that_of_the_frame_wherever_the_centre_of_mass_is(begins: bool) -> None:
    """An IMU that sits where the vehicle file has the centre of mass reads the acceleration of that
    pose, and neither place jumps when the centre of mass does."""
    streams = tuple(Stream(c, 0.001) for c in (ACC, POS, VEL, QUAT))
    record = Recorder(streams, 1000.0, 1000.0)
    numbers = {"x_m": 0.02, "y_m": 0.01, "z_m": 0.0}
    plant = VEHICLE if begins else VEHICLE.with_effects({"cog_offset": numbers})
    later = Later({"cog_offset": numbers}, BEGINS_S) if begins else None
    way = (*UP, ("tour", 2.0, (1.5, -1.0, -1.0)))
    flight = simulate_flight(*setpoints_along(VEHICLE, way), VEHICLE, plant, record, later=later)
    pos, vel, q, acc = (flight.table[list(c)].to_numpy() for c in (POS, VEL, QUAT, ACC))
    speed, shown = (np.gradient(x, 0.001, axis=0)[1:-1] for x in (pos, vel))
    np.testing.assert_allclose(speed, vel[1:-1], atol=2e-3)
    force = np.stack(to_ned(list(q.T), list(acc.T)), axis=1)[1:-1]
    force[:, 2] += VEHICLE.gravity_m_s2
    since = flight.time_s[1:-1] > (BEGINS_S if begins else 2.0) + 0.01
    np.testing.assert_allclose(shown[since], force[since], atol=0.02)


@pytest.mark.slow
def test_a_sensor_changes_and_the_flight_does_not() -> None:
    biased = flown("accel_bias", x_m_s2=0.3, y_m_s2=0.0, z_m_s2=-0.2)
    before, after = apart(biased, "acc_x")
    assert np.all(before == 0)
    np.testing.assert_allclose(after, 0.3, atol=1e-9)
    assert np.all(np.hstack(apart(biased, "pos_z")) == 0)


@pytest.mark.slow
def test_a_reading_stands_still_noise_and_all() -> None:
    stuck = flown("stuck_sensor", channel=5.0, time_s=0.0)
    before, _ = apart(stuck, "gyro_y")
    assert np.all(before == 0)
    held = stuck.table["gyro_y"].to_numpy()[stuck.time_s >= BEGINS_S]
    assert len(np.unique(held)) == 1
    assert len(np.unique(stuck.table["gyro_x"].to_numpy()[stuck.time_s >= BEGINS_S])) > 100


@pytest.mark.slow
def test_a_course_that_stands_still_is_a_start_value() -> None:
    setpoints, _ = setpoints_along(VEHICLE, UP)
    body = airframe(VEHICLE, effects=["mass_offset"])
    body = body.with_starts(standing(body, VEHICLE))
    values = {"mass_offset.enabled": 1.0, "mass_offset.mass_kg": 0.1}
    courses = {k: np.full(len(setpoints), v) for k, v in values.items()}
    wind = {"wind_x": 1.5}
    control = controller(VEHICLE)
    held, _ = fly(body.with_starts(values), control, setpoints, wind)
    given, _ = fly(
        body, control, setpoints, None, courses | {"wind_x": np.full(len(setpoints), 1.5)}
    )
    np.testing.assert_allclose(given, held, atol=1e-12)
    assert STEP_S * len(setpoints) == 2.5


def test_a_misspelt_course_is_named() -> None:
    setpoints, _ = setpoints_along(VEHICLE, UP)
    with pytest.raises(ModelError, match="wind_w"):
        fly(airframe(VEHICLE), controller(VEHICLE), setpoints, None, {"wind_w": np.zeros(2500)})
