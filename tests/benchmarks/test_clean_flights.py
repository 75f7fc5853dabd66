"""Clean flights: what counts as false, and the table."""

import pandas as pd
from why_rig import ONSET_S, sound

from benchmarks.clean_flights import SIMULATED, Answer, air_change_m_s, page
from benchmarks.sudden_faults.built_in import Planted
from twin.logs import Flight


def test_the_air_changes_where_a_gust_is_planted() -> None:
    """Eight metres per second within a second; five seconds before there is turbulence alone."""
    planted = Planted("gust", 8.0, 1, 50.0)
    begins_s = planted.planned().begins_s
    assert air_change_m_s(planted, begins_s) > 7.0
    assert air_change_m_s(planted, begins_s - 5.0) < 3.0


def test_an_event_of_an_instrument_is_false_and_a_sound_flight_has_none() -> None:
    table = sound()
    clean = Answer.of(Flight("sound", pd.DataFrame(table)), "sound", "clean")
    table["gyro_y"] = table["gyro_y"] + 0.1 * (table["time"] >= ONSET_S)
    off = Answer.of(Flight("off", pd.DataFrame(table)), "off", "clean")
    assert clean.false == () and len(off.false) == 1 and "gyro_bias" in off.false[0]
    rows = page([clean, off]).splitlines()
    assert rows[2].startswith("| clean | 2 | 0.03 | 1 | 0 | 0 |")
    assert "off: gyro_bias" in rows[-1] and SIMULATED not in page([clean, off])
