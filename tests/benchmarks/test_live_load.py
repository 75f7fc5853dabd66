"""The benchmark of what a live flight bears: its flight, its measurements, its page."""

import numpy as np
import pytest

from benchmarks.live_load.page import page
from benchmarks.live_load.runs import aircraft_at_once, long_flight
from twin.vehicle_file import load_vehicle

BESIDE = {"load_before": 1.0, "measured": "2026-11-26"}
"""What stands beside each measurement."""


@pytest.mark.slow
def test_a_long_flight_goes_on_without_a_break() -> None:
    flight = long_flight(load_vehicle("copter_default"), 130.0)
    t, position = flight.signal(["pos_x", "pos_y", "pos_z"])
    assert flight.time_s[-1] >= 130.0
    np.testing.assert_allclose(np.diff(flight.time_s), 0.005, atol=1e-6)
    jumps = np.linalg.norm(np.diff(position, axis=0), axis=1)
    assert jumps.max() < 0.5, t[int(jumps.argmax())]
    assert set(flight.table["phase"][t.searchsorted(20.0) :]) == {"forward", "hover"}


@pytest.mark.slow
def test_two_aircraft_at_once() -> None:
    told = aircraft_at_once(2, 14.0, alarms=False)
    assert told["lost"] == 0 and told["alarms"] == 0
    assert 0.0 < told["cpu_per_second"] < 1.0
    assert told["cpu_share"] > 0.0 and told["most_behind_s"] < 14.0
    text = page({"many_02_bare": {**told, **BESIDE}})
    row = f"| 2 | no | {told['wall_s']:.0f} s | {100 * told['cpu_share']:.0f} % |"
    assert row in text and "Not measured." in text and "1 s: not measured." in text


@pytest.mark.parametrize(
    ("late", "behind_s", "said"), [(0, 0.2, "reached"), (1, 0.2, "not"), (0, 9.0, "not")]
)
def test_the_page_says_whether_the_goal_is_reached(late: int, behind_s: float, said: str) -> None:
    told = {"aircraft": 10, "alarms_kept": True, "seconds": 25.0, "wall_s": 26.0, "cpu_share": 0.6}
    told |= {"cpu_per_second": 0.04, "lost": 0, "late": late, "most_behind_s": behind_s}
    text = page({"many_10_alarms": {**told, **BESIDE}})
    assert f"more than 1 s: {said}" in text and "Measured on 2026-11-26." in text
