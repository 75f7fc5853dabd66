"""A flight in which a rotor gets weak, and the same flight in which it does not."""

from collections.abc import Sequence
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from rig import plain

from twin.errors import LogError, ModelError
from twin.explain.running.alarms import Verdict
from twin.explain.running.evidence import RunningEvidence
from twin.flight.simulate_flight import Later, Recorder, Stream, simulate_flight
from twin.logs import Flight
from twin.logs.columns import ACC, GYRO, POS, QUAT, VEL, motor_columns
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import setpoints_along

Array = NDArray[np.float64]
VEHICLE = plain(drag_linear_n_s_m=0.3 * np.ones(3))
BEGINS_S = 17.0
WAYPOINTS = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 2.0, (0.0, 0.0, -1.0)),
    ("hover", 6.0, (0.0, 0.0, -1.0)),
    ("forward", 5.0, (3.0, 1.0, -1.5)),
    ("forward", 5.0, (0.0, -1.0, -1.0)),
    ("hover", 4.0, (0.0, -1.0, -1.0)),
)
RECORDER = Recorder(
    (
        Stream(motor_columns("cmd", 4), 0.005),
        Stream(ACC, 0.005, 0.05),
        Stream(GYRO, 0.005, 0.003),
        Stream(POS, 0.01, 0.002),
        Stream(VEL, 0.01, 0.01),
        Stream(QUAT, 0.01, 0.0005),
    ),
    200.0,
    200.0,
    seed=2,
)
LOST = {"loss_1": 0.0, "loss_2": 0.12, "loss_3": 0.0, "loss_4": 0.0, "torque_share": 1.0}


@cache
def flown(effect: str = "") -> Flight:
    setpoints, phases = setpoints_along(VEHICLE, WAYPOINTS)
    numbers = {"rotor_efficiency_loss": LOST, "stuck_sensor": {"channel": 2.0, "time_s": 0.0}}
    later = Later({effect: numbers[effect]}, BEGINS_S) if effect else None
    return simulate_flight(setpoints, phases, VEHICLE, VEHICLE, RECORDER, later=later)


def verdicts(flight: Flight, edges: Sequence[float]) -> list[Verdict]:
    """Verdicts of a flight that comes in portions."""
    evidence, columns, found = RunningEvidence(VEHICLE), flight.columns, []
    rows = np.searchsorted(flight.time_s, [*edges, np.inf])
    for a, b in pairwise(rows):
        found.append(evidence.update({c: v[a:b] for c, v in columns.items()}))
    return found


SECONDS = tuple(np.arange(0.0, 23.0))


@pytest.mark.slow
def test_a_rotor_that_gets_weak_is_named() -> None:
    found = verdicts(flown("rotor_efficiency_loss"), SECONDS)
    opened = [(v.t_s, a) for v in found for a in v.opened]
    assert [a.effect for _, a in opened] == ["rotor_efficiency_loss"]
    assert BEGINS_S < opened[0][0] < BEGINS_S + 3.0
    (alarm,) = found[-1].alarms
    assert alarm.since_s == pytest.approx(BEGINS_S, abs=0.5)
    (told,) = alarm.numbers
    assert told.name == "loss_2"
    assert abs(told.value - 0.12) < 4 * told.sd < 0.04
    assert alarm.probability > 0.99


@pytest.mark.slow
def test_nothing_is_said_of_nothing() -> None:
    found = verdicts(flown(), SECONDS)
    assert not any(v.opened for v in found)
    assert found[-1].nothing > 0.9
    assert not found[-1].learning
    assert found[3].learning


@pytest.mark.slow
def test_a_reading_that_stands_still_is_named_alone() -> None:
    found = verdicts(flown("stuck_sensor"), SECONDS)
    assert [a.effect for v in found for a in v.opened] == ["stuck_sensor"]
    (alarm,) = found[-1].alarms
    assert {n.name: n.value for n in alarm.numbers}["channel"] == 2


@pytest.mark.slow
def test_portions_do_not_matter() -> None:
    """To rounding: the zero-phase low-pass of the body rates begins at other rows of the window."""
    flight = flown("rotor_efficiency_loss")
    rng = np.random.default_rng(6)
    cut = tuple(np.sort(np.concatenate([[0.0], rng.uniform(0.0, 22.5, 40)])))
    a, b = verdicts(flight, SECONDS)[-1], verdicts(flight, cut)[-1]
    assert a.t_s == b.t_s
    assert a.effects == pytest.approx(b.effects, abs=1e-6)
    assert [x.since_s for x in a.alarms] == [x.since_s for x in b.alarms]
    for x, y in zip(a.alarms, b.alarms, strict=True):
        mine, other = ([n.value for n in z.numbers] for z in (x, y))
        np.testing.assert_allclose(mine, other, rtol=1e-6)
        assert x.raised_s == y.raised_s


def test_rows_come_once_and_in_order() -> None:
    evidence = RunningEvidence(VEHICLE)
    rows = {"time": np.array([0.0, 0.1]), "acc_x": np.array([0.0, 1.0])}
    evidence.update(rows)
    with pytest.raises(LogError, match=r"0 s comes after 0\.1 s.*new clock"):
        evidence.update(rows)


def test_what_does_not_begin_is_refused() -> None:
    with pytest.raises(ModelError, match="rotor_dragg"):
        RunningEvidence(load_vehicle("crazyflie"), effects=["rotor_dragg"])
    with pytest.raises(ModelError, match=r"ground_effect.*nothing is known of how it begins"):
        RunningEvidence(load_vehicle("crazyflie"), effects=["ground_effect"])


def test_a_vehicle_without_a_motor_command_is_named() -> None:
    t = np.arange(2200) / 200.0
    rows = {"time": t, "acc_x": t, "acc_y": t, "acc_z": t}
    with pytest.raises(LogError, match="cmd_1"):
        RunningEvidence(load_vehicle("copter_default")).update(rows)
