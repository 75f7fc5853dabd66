"""Model predictive control: from 2 m away to the setpoint, no slower than the cascade."""

import time

import numpy as np
import pytest
from numpy.typing import NDArray
from rig import Rig, in_air, vec

from twin.errors import ModelError
from twin.flight.closed_loop import fly
from twin.flight.control.lqr_cascade import controller
from twin.flight.control.nmpc import NODE_S, Nmpc
from twin.vehicle.file import load_vehicle

Array = NDArray[np.float64]
CRAZYFLIE = load_vehicle("crazyflie")
START = vec("pos", [2.0, 0.0, 0.0])
SECONDS, NEAR_M = 4.0, 0.1


@pytest.fixture(scope="module")
def predictive() -> Nmpc:
    return Nmpc(CRAZYFLIE)


def predicted_flight(control: Nmpc, rig: Rig) -> tuple[Array, Array, Array]:
    """States at 1 kHz, commands and solve times (s) at each node."""
    control.reset()
    x, states, commands, times = rig.state(START), [], [], []
    for _ in range(round(SECONDS / NODE_S)):
        began = time.perf_counter()
        commands.append(control.command(x, np.zeros(10)))
        times.append(time.perf_counter() - began)
        states.append(rig.fly(x, rig.commands(commands[-1]), NODE_S)[1:])
        x = states[-1][-1]
    return np.vstack(states), np.array(commands), np.array(times)


def settled_s(rig: Rig, states: Array) -> float:
    """When the distance from the origin stays below `NEAR_M`."""
    away = np.linalg.norm(rig.vector(states, "pos"), axis=1) >= NEAR_M
    return float((np.flatnonzero(away)[-1] + 1) * 1e-3)


@pytest.mark.slow
def test_settles_no_later_than_the_cascade(predictive: Nmpc) -> None:
    rig = in_air(CRAZYFLIE)
    states, commands, times = predicted_flight(predictive, rig)
    body = rig.component.with_starts(
        {"ground.enabled": 0.0, **{f"initial.{n}": v for n, v in START.items()}, "initial.pos_z": 0}
    )
    setpoints = np.tile([0.0] * 10 + [1.0], (round(SECONDS / 1e-3), 1))
    cascade = settled_s(rig, fly(body, controller(CRAZYFLIE), setpoints)[0])
    ours = settled_s(rig, states)
    low, mid, high = np.percentile(1e3 * times, [5, 50, 95])
    print(
        f"settled after {ours:.2f} s, cascade {cascade:.2f} s; "
        f"solve time {mid:.0f} ms, 90 % within {low:.0f} to {high:.0f} ms"
    )
    assert ours <= cascade
    assert np.linalg.norm(rig.vector(states[-1], "pos")) < 0.01
    assert commands.min() >= -1e-9  # bounds hold to the tolerance of the solver
    assert commands.max() <= 1.0 + 1e-9
    assert np.median(times) < 1.0


@pytest.mark.slow
def test_a_reset_forgets_the_past(predictive: Nmpc) -> None:
    rig = in_air(CRAZYFLIE)
    predictive.reset()
    first = predictive.command(rig.state(START), np.zeros(10))
    predictive.command(rig.state(pos_z=1.0), np.zeros(10))
    predictive.reset()
    np.testing.assert_array_equal(predictive.command(rig.state(START), np.zeros(10)), first)


def test_hover_stays_at_trim(predictive: Nmpc) -> None:
    rig = in_air(CRAZYFLIE)
    predictive.reset()
    command = predictive.command(rig.state(pos_z=0.0), np.zeros((21, 10)))
    np.testing.assert_allclose(command, rig.inputs()[:4], rtol=1e-4)


def test_a_state_that_is_no_number_is_refused(predictive: Nmpc) -> None:
    rig = in_air(CRAZYFLIE)
    with pytest.raises(ModelError, match="no plan from this state"):
        predictive.command(rig.state(vel_x=np.nan), np.zeros(10))


@pytest.mark.slow
def test_a_late_command_is_left_to_the_plant(predictive: Nmpc) -> None:
    late = Nmpc(CRAZYFLIE.with_effects({**CRAZYFLIE.effects, "command_delay": {"delay_s": 0.02}}))
    assert late.state_names == predictive.state_names
