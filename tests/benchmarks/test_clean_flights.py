"""Clean flights: what counts as false, and the table."""

import numpy as np
import pandas as pd
import pytest
from why_rig import ONSET_S, sound

from benchmarks.clean_flights import SIMULATED, Answer, is_there, page, sets_in
from benchmarks.sudden_faults.built_in import Planted
from twin.flight.closed_loop import SETPOINTS, STEP_S
from twin.logs import Flight
from twin.logs.columns import POS
from twin.why.causes import CUT, ROTOR
from twin.why.records import Event


def test_a_gust_counts_where_it_is_planted() -> None:
    """Eight metres per second within a second; five seconds before there is turbulence alone."""
    planted = Planted("gust", 8.0, 1, 50.0)
    begins_s = planted.planned().begins_s
    assert sets_in(planted, [begins_s - 5.0, begins_s - 0.5, begins_s]).tolist() == [
        False,
        True,
        True,
    ]


@pytest.mark.parametrize("seed", [1, 2])
def test_a_gust_that_is_named_at_random_seldom_counts(seed: int) -> None:
    """A second about each planted onset, one each ten seconds, and a hundredth of the rest."""
    planted = Planted("", 1.0, seed, 50.0)
    plan = planted.planned()
    every = np.arange(2.0, len(plan.setpoints) * STEP_S - 2.0, 0.1)
    counted = sets_in(planted, every.tolist())
    assert sets_in(planted, plan.gusts_s).all() and len(plan.gusts_s) > 10
    assert 0.1 < counted.mean() < 0.25


def test_commands_are_cut_where_the_mission_stops_the_motors_in_the_air() -> None:
    """It goes by time: an aircraft that comes late is above its landing place still."""
    planted = Planted("", 1.0, 2, 50.0)
    armed = planted.planned().setpoints[:, SETPOINTS.index("armed")] > 0
    stops_s = STEP_S * float(np.flatnonzero(armed[:-1] & ~armed[1:])[0] + 1)
    t = np.arange(0.0, STEP_S * len(armed), 0.02)

    def counts(cause: str, at_s: float, height_m: float) -> bool:
        columns = dict(zip(POS, (0 * t, 0 * t, 0 * t - height_m), strict=True))
        flight = Flight("late", pd.DataFrame({"time": t} | columns))
        event = Event(cause=cause, onset_s=at_s, probability=0.9, text="", bench_check="")
        return is_there(event, planted, flight)

    assert counts(CUT, stops_s, 3.0)
    assert not counts(CUT, stops_s, 0.05)
    assert not counts(CUT, stops_s - 2.0, 3.0)
    assert not counts(ROTOR, stops_s, 3.0)


def test_an_event_of_an_instrument_is_false_and_a_sound_flight_has_none() -> None:
    table = sound()
    clean = Answer.of(Flight("sound", pd.DataFrame(table)), "sound", "clean")
    table["gyro_y"] = table["gyro_y"] + 0.1 * (table["time"] >= ONSET_S)
    off = Answer.of(Flight("off", pd.DataFrame(table)), "off", "clean")
    assert clean.false == () and len(off.false) == 1 and "gyro_bias" in off.false[0]
    rows = page([clean, off]).splitlines()
    assert rows[2].startswith("| clean | 2 | 0.03 | 1 | 0 | 0 |")
    assert "off: gyro_bias" in rows[-1] and SIMULATED not in page([clean, off])
