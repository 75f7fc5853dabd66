"""Order and sense of the rotors, told by how a flight turned."""

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

from twin.draft.hover import best_frame, same_shape, turning
from twin.logs import Flight
from twin.vehicle.layouts import FRAMES, frame


def turned_by(name: str, seconds: float = 20.0) -> Flight:
    """A flight whose body turns by the moments of a frame's rotors, in random doublets."""
    layout, t = frame(name), 0.01 * np.arange(round(100 * seconds))
    rng = np.random.default_rng(3)
    axes = lfilter([0.1], [1.0, -0.9], rng.standard_normal((len(t), 3)), axis=0)
    x, y, d = layout.position[:, 0], layout.position[:, 1], layout.direction
    effect = np.column_stack([-y, x, -0.2 * d])  # thrusts to moments, (n, 3)
    cmd = 0.5 + 0.1 * axes @ np.linalg.pinv(effect)
    rates = 0.01 * np.cumsum(40.0 * (cmd - 0.5) @ effect, axis=0)
    table = pd.DataFrame({"time": t, "phase": "hover"})
    for i in range(layout.count):
        table[f"cmd_{i + 1}"] = cmd[:, i]
    table[["gyro_x", "gyro_y", "gyro_z"]] = np.array(
        [np.interp(t - 0.03, t, rates[:, k]) for k in range(3)]
    ).T
    return Flight(name, table)


@pytest.mark.parametrize("name", sorted(set(FRAMES) - {"wide"}))
def test_a_flight_turns_like_its_own_frame(name: str) -> None:
    flight = turned_by(name)
    own = turning(flight, frame(name))
    assert own is not None
    assert min(own.roll, own.pitch, own.yaw) > 0.9
    found = best_frame(flight, frame(name).count)
    assert found is not None
    assert found[0] == name


def test_reversed_rotors_turn_the_other_way() -> None:
    told = turning(turned_by("x"), frame("h"))
    assert told is not None
    assert told.yaw < -0.9
    assert told.worst > 0.9


def test_nothing_is_told_without_rates_or_with_other_rotors() -> None:
    flight = turned_by("x")
    assert turning(Flight("f", flight.table.drop(columns="gyro_y")), frame("x")) is None
    assert turning(flight, frame("hex x")) is None
    noise = np.random.default_rng(0).standard_normal((len(flight.table), 3))
    columns = ["gyro_x", "gyro_y", "gyro_z"]
    blind = flight.table.assign(**dict(zip(columns, noise.T, strict=True)))
    assert best_frame(Flight("f", blind), 4) is None


def test_a_shape_takes_the_numbering_that_the_flights_turned_like() -> None:
    crazyflie = turned_by("crazyflie x")
    assert same_shape([crazyflie], "x") == "crazyflie x"
    assert same_shape([crazyflie], "crazyflie x") is None
    assert same_shape([crazyflie], "+") is None  # other places: not a numbering
    assert same_shape([crazyflie, turned_by("betaflight x")], "x") is None  # they disagree
    assert same_shape([turned_by("hex x")], "hex x") is None
