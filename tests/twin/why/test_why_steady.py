"""What is there during the whole flight: patterns of the rotors, board, compass, battery."""

import numpy as np
import pandas as pd
import pytest

from twin.explain.balance import NOTHING, ROTORS, VIBRATION, Balance, Hypothesis
from twin.logs import Flight
from twin.logs.columns import ACC, MAG, POS, QUAT, VEL
from twin.vehicle.layouts import frame, frames_of
from twin.why.balance import findings_of
from twin.why.findings import Findings
from twin.why.flight import FlightFrame
from twin.why.steady import steady

LAYOUT = frame(frames_of(4)[0])


def hover(level: np.ndarray | None = None, seed: int = 0, **changed: np.ndarray) -> FlightFrame:
    """A hover at 10 m with these mean commands; columns may be changed."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 30.0, 0.02)
    height = 10.0 * np.clip((t - 3) / 3, 0, 1) * np.clip((29 - t) / 3, 0, 1)
    height = np.minimum(height, 10.0)
    commands = (np.full(4, 0.5) if level is None else level) * (1 + 0.004 * rng.standard_normal())
    flies = (t > 3) & (t < 29)
    table = {"time": t}
    for i, c in enumerate(commands):
        wiggle = c * (1 + 0.02 * rng.standard_normal(len(t)))
        table[f"cmd_{i + 1}"] = np.where(flies, wiggle, 0.0)
    table |= dict(zip(POS, (0 * t, 0 * t, -height), strict=True))
    table |= dict(zip(VEL, 0.1 * rng.standard_normal((3, len(t))), strict=True))
    table |= dict(zip(ACC, (0 * t, 0 * t, 0 * t - 9.81), strict=True))
    table |= dict(zip(QUAT, (0 * t + 1, 0 * t, 0 * t, 0 * t), strict=True))
    table |= dict(zip(MAG, (0 * t + 2e-5, 0 * t, 0 * t + 4.4e-5), strict=True))
    return FlightFrame.of(Flight(f"hover {seed}", pd.DataFrame(table | changed)))


def asked(change: np.ndarray) -> np.ndarray:
    return np.asarray(0.5 * np.exp(change))


NORMAL = [hover(seed=i) for i in range(1, 6)]


@pytest.mark.parametrize("rotor", [1, 2, 3, 4])
def test_a_weak_rotor_leads_against_normal_flights(rotor: int) -> None:
    """A rotor that needs 12 % more command gives 24 % less: thrust goes with the square."""
    found = steady(hover(asked(0.12 * np.eye(4)[rotor - 1])), NORMAL)
    assert found.nothing < 0.01
    named = [(e.cause, e.rotor) for e in found.events]
    if found.one_of_causes:  # only yaw parts a rotor from a load at its hub
        assert {c.cause for c in found.one_of_causes} == {"rotor_efficiency_loss", "payload_cg"}
        assert all(c.rotor == (rotor,) for c in found.one_of_causes)
    else:
        assert named == [("rotor_efficiency_loss", (rotor,))]
        severity = found.events[0].severity
        assert severity is not None and severity.low < 0.24 < severity.high


def test_a_normal_flight_that_is_not_used_is_named() -> None:
    grounded = hover(seed=9, **{f"pos_{a}": np.zeros(1500) for a in "xyz"})
    bare = Flight("bare", grounded.flight.table.drop(columns=[f"cmd_{i}" for i in range(1, 5)]))
    found = steady(hover(), [*NORMAL, FlightFrame.of(bare)])
    (note,) = [n for n in found.notes if "not used" in n]
    assert note.startswith("normal flight bare is not used")
    assert not any("not used" in n for n in steady(hover(), NORMAL).notes)


def test_a_small_change_that_has_no_name_is_undecided() -> None:
    found = steady(hover(asked(0.012 * np.eye(4)[1])), NORMAL)
    assert not found.events and not found.one_of_causes
    assert found.undecided == (found.nothing < 0.8)
    assert 0.1 < found.nothing < 0.95


def test_a_load_at_a_side_is_no_rotor() -> None:
    side = np.sign(LAYOUT.position[:, 1])
    found = steady(hover(asked(0.04 + 0.03 * side)), NORMAL)
    causes = {c.cause for c in found.one_of_causes} | {e.cause for e in found.events}
    assert causes & {"payload_cg", "cog_offset", "mass_offset"}
    assert found.nothing < 0.1


def test_no_load_is_said_that_the_motors_cannot_lift() -> None:
    """Normal flights at an eighth of the command, of another aircraft whose log does not say so:
    64 times the thrust."""
    lighter = [hover(np.full(4, 0.12), seed=i) for i in range(1, 4)]
    found = steady(hover(np.full(4, 0.96)), lighter)
    assert not found.events and not found.one_of_causes and found.undecided
    assert any("of this aircraft?" in note for note in found.notes)


def test_a_normal_flight_is_nothing() -> None:
    found = steady(hover(seed=9), NORMAL)
    assert not found.events and not found.one_of_causes and found.nothing > 0.5


def test_without_normal_flights_no_rotor_is_named_however_weak() -> None:
    found = steady(hover(asked(0.2 * np.eye(4)[2])))
    assert not found.events and not found.one_of_causes
    assert "rotor 3 is asked for" in found.notes[0] and "--reference" in found.notes[0]
    assert found.not_visible[0].smallest_detectable.value is None


def said_of(**probabilities: float) -> Findings:
    """Of a balance with these causes: rotors by their numbers."""
    causes = []
    for name, p in probabilities.items():
        kind, *numbers = name.split("_")
        cause = {"nothing": NOTHING, "vibration": VIBRATION}.get(kind, ROTORS)
        values, widths = ({"loss": v} if numbers else {} for v in (0.2, 0.01))
        causes.append(Hypothesis(cause, tuple(map(int, numbers)), p, values, widths))
    return findings_of(Balance(tuple(causes), {}, (0.0,) * 4, 0.8), "usually", "1")


def test_a_damaged_propeller_lists_each_rotor_that_it_may_be_of() -> None:
    found = said_of(vibration=0.5, rotors_3=0.3, rotors_4=0.16, nothing=0.04)
    told = [(c.cause, c.rotor, c.probability) for c in found.one_of_causes]
    assert told == [(VIBRATION, None, 0.5), (ROTORS, (3,), 0.3), (ROTORS, (4,), 0.16)]
    assert not found.events


def test_sets_of_rotors_exclude_each_other() -> None:
    found = said_of(rotors_1_2=0.48, rotors_3_4=0.48, nothing=0.04)
    told = [(c.rotor, c.probability) for c in found.one_of_causes]
    assert told == [((1, 2), 0.48), ((3, 4), 0.48)]
    assert not found.events


def test_a_rotor_has_all_that_speaks_for_it_and_is_no_alternative_to_itself() -> None:
    (event,) = said_of(rotors_3=0.85, rotors_3_4=0.11, nothing=0.04).events
    assert event.rotor == (3,)
    assert event.probability == pytest.approx(0.96)
    assert not event.alternatives
    (event,) = said_of(rotors_3=0.85, rotors_1_2=0.11, nothing=0.04).events
    assert [(c.rotor, c.probability) for c in event.alternatives] == [((1, 2), 0.11)]


def _leaning(angle: float, of_board: bool, turns: float) -> FlightFrame:
    """A hover whose specific force leans forward in the board, or north, while it turns."""
    t = np.arange(0.0, 30.0, 0.02)
    yaw = turns * 2 * np.pi * np.clip((t - 8) / 16, 0, 1)
    side = yaw if not of_board else 0 * t
    size = 9.81 * np.sin(angle)
    force = {ACC[0]: size * np.cos(side), ACC[1]: -size * np.sin(side)}
    attitude = dict(zip(QUAT, (np.cos(yaw / 2), 0 * t, 0 * t, np.sin(yaw / 2)), strict=True))
    force[ACC[2]] = 0 * t - 9.81 * np.cos(angle)
    return hover(None, 0, **force, **attitude)


def test_a_tilted_board_is_named_with_its_angle_once_the_aircraft_turns() -> None:
    angle = np.radians(9.0)
    (event,) = steady(_leaning(angle, of_board=True, turns=1.0)).events
    assert event.cause == "imu_tilt" and event.onset_s is None and event.severity is not None
    assert event.severity.value == pytest.approx(angle, rel=0.05)
    assert "forward" in event.text
    assert not steady(hover()).events


def test_a_wind_is_no_tilt() -> None:
    """It leans the force to one side of the earth; without a turn nobody knows."""
    for turns in (0.0, 1.0):
        assert not steady(_leaning(np.radians(6.0), of_board=False, turns=turns)).events


def test_a_disturbed_compass_and_a_weak_battery_are_named() -> None:
    t = np.arange(0.0, 30.0, 0.02)
    (event,) = steady(hover(**{MAG[2]: 4.4e-5 * (1 + 0.9 * np.sin(t))})).events
    assert event.cause == "mag_disturbance"
    amps = 20.0 + 5.0 * np.sin(t)
    weak, sound = (16.8 - ohm * amps for ohm in (0.2, 0.01))
    (event,) = steady(hover(vbat_v=weak, ibat_a=amps)).events
    assert event.cause == "battery_sag" and event.severity is not None
    assert event.severity.value == pytest.approx(0.2 * 24.8 / np.mean(weak), rel=0.05)
    found = steady(hover(vbat_v=sound, ibat_a=amps))
    assert not found.events and any("10" in n and "mOhm" in n for n in found.notes)
