"""What counts as named right, and where the numbers of recorded flights come from."""

import numpy as np
import pytest

from benchmarks.live_alarms.flights import (
    SIZES,
    Case,
    aircraft,
    numbers,
    numbers_without,
    with_numbers,
)
from benchmarks.live_alarms.page import outcome, page
from twin.effects import BEGINNINGS, EFFECTS
from twin.explain.running.hypotheses import MONITORED_EFFECTS
from twin.vehicle_file import load_vehicle


def alarm(raised_s: float, *names: str) -> dict[str, object]:
    history = [[raised_s + k, n] for k, n in enumerate(names)]
    return {"raised_s": raised_s, "effect": names[0], "since_s": raised_s - 1, "names": history}


def row(*alarms: dict[str, object]) -> dict[str, object]:
    return {
        "name": "mass_offset_medium_1000",
        "effect": "mass_offset",
        "magnitude": "medium",
        "aircraft": "crazyflie",
        "begins_s": 25.0,
        "seconds": 30.0,
        "cost_s": 0.05,
        "alarms": [*alarms],
    }


def test_a_name_that_comes_later_counts_from_then_on() -> None:
    found = outcome(row(alarm(20.0, "motor_lag"), alarm(27.0, "steady_wind", "mass_offset")))
    assert (found.right, found.at_once, found.false, found.further) == (True, False, 1, 0)
    assert found.delay_s == 3.0


def test_another_name_by_the_end_is_wrong() -> None:
    found = outcome(row(alarm(27.0, "mass_offset", "steady_wind")))
    assert not found.right
    assert found.name == "steady_wind"
    assert np.isinf(found.delay_s)
    assert not outcome(row()).right


def test_page_counts() -> None:
    text = page([row(alarm(27.0, "mass_offset")), row()])
    assert "| named right, medium | 90 % | 1 of 2 (50%) |" in text
    assert "| 3 s | more than half are not named |" in text
    assert "| `mass_offset` | medium | crazyflie | 1000 | nothing within 15 s |" in text


@pytest.mark.parametrize("effect", SIZES)
def test_every_case_has_the_numbers_of_its_effect(effect: str) -> None:
    assert effect in BEGINNINGS
    assert effect in MONITORED_EFFECTS
    vehicle = aircraft("copter_default")
    size = SIZES[effect][1]
    drawn = numbers(effect, size, vehicle, Case(effect, "medium", 1000).rng)
    assert drawn.keys() <= EFFECTS[effect].starts(vehicle).keys()


def test_recorded_flights_are_held_against_what_the_others_tell() -> None:
    numbers = numbers_without("RflySimDT, real flights")
    assert [*numbers] == ["real_1", "real_2", "real_3"]
    found = numbers["real_1"]
    assert found["mag_hard_iron.x_t"] == pytest.approx(-79e-6, rel=0.05)
    assert "command_delay.delay_s" not in found
    vehicle = with_numbers(load_vehicle("feisi_x150"), found)
    assert 1.4 < vehicle.effects["thrust_scale"]["scale"] == found["thrust_scale.scale"]
    losses = {f"loss_{i}" for i in range(1, 5)}
    untold = {n for n in losses if f"rotor_efficiency_loss.{n}" not in found}
    assert untold and all(vehicle.effects["rotor_efficiency_loss"][n] == 0 for n in untold)
    assert not {"vibration", "pose_smoothing"} & vehicle.effects.keys()
