"""Which part of a flight carries the weight."""

import numpy as np
import pandas as pd
import pytest

from twin.draft import hover_of
from twin.logs import Flight


def flight(seconds: float = 20.0, **columns: object) -> Flight:
    """Four equal commands, 0.4 from 5 s to 15 s and 0 else, at 100 Hz."""
    t = 0.01 * np.arange(round(100 * seconds))
    table = pd.DataFrame({"time": t})
    flown = (t >= 5.0) & (t < 15.0)
    for i in range(1, 5):
        table[f"cmd_{i}"] = np.where(flown, 0.4, 0.0)
    table["phase"] = np.where(flown, "hover", "ground")
    return Flight("made", table.assign(**columns))


def test_the_phase_is_asked_first() -> None:
    found = hover_of(flight())
    assert found is not None
    assert found.hovers
    assert found.level == pytest.approx(0.4)
    assert found.each == pytest.approx((0.4,) * 4)
    assert found.seconds == pytest.approx(10.0, abs=0.05)
    assert "phase hover" in found.where


def test_a_tilted_hover_needs_more_thrust_than_its_weight() -> None:
    """Rolled by 0.3 rad all the while: the thrust over the weight is 1 / cos."""
    half = 0.15
    q = {"q_w": np.cos(half), "q_x": np.sin(half), "q_y": 0.0, "q_z": 0.0}
    found = hover_of(flight(**q))
    assert found is not None
    assert found.load == pytest.approx(1 / np.cos(0.3), rel=1e-6)


def test_without_the_phase_slow_flight_in_the_air_is_taken() -> None:
    made = flight()
    table = made.table.assign(phase="", vel_x=0.0, vel_y=0.0, vel_z=0.0)
    table.loc[(table.time > 4.9) & (table.time < 9), "vel_x"] = 3.0
    found = hover_of(Flight("made", table))
    assert found is not None
    assert found.hovers
    assert found.t_s.min() > 8.5
    assert found.seconds == pytest.approx(6.0, abs=0.2)


def test_what_never_hovers_is_weighed_by_its_accelerometer() -> None:
    """Always at 3 m/s; the rotors push with 1.1 times the weight."""
    made = flight()
    phase = np.where(made.table.phase == "hover", "forward", "ground")
    columns = {"acc_x": 0.0, "acc_y": 0.0, "acc_z": -1.1 * 9.80665, "phase": phase}
    found = hover_of(Flight("made", made.table.assign(**columns)))
    assert found is not None
    assert not found.hovers
    assert found.load == pytest.approx(1.1)
    assert "never hovers" in found.where


def test_a_hop_is_no_hover_and_a_flight_without_motors_none() -> None:
    made = flight()
    hop = made.table.assign(
        phase=np.where(made.table.time < 6.5, made.table.phase, "ground"),
    )
    assert hover_of(Flight("made", hop)) is None
    assert hover_of(Flight("made", made.table.drop(columns="cmd_2"))) is None


def test_signals_that_are_never_sampled_together_tell_nothing() -> None:
    """Each motor has samples, and each axis of the attitude, no two at a time."""
    made = flight()
    row = np.arange(len(made.table)) % 4
    apart = {f"cmd_{i + 1}": np.where(row == i, 0.4, np.nan) for i in range(4)}
    assert hover_of(Flight("made", made.table.assign(**apart))) is None
    q = {f"q_{a}": np.where(row == i, 0.5, np.nan) for i, a in enumerate("wxyz")}
    found = hover_of(Flight("made", made.table.assign(**q)))
    assert found is not None
    assert found.load == 1.0
