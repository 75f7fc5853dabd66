"""Which part of a flight carries the weight, and what it says of a twin."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from twin.draft.hover import Hover, hover_of
from twin.logs import Flight
from twin.residuals.flight_gap import HoverDiagnosis, Mean, diagnose, diagnosis_of
from twin.residuals.gap import Channel
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import Waypoints, fly
from uavtwin.wording import hover_sentence


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


HOVER: Waypoints = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 3.0, (0.0, 0.0, -1.5)),
    ("hover", 6.0, (0.0, 0.0, -1.5)),
)


def near(mean: Mean | None, value: float, least: float) -> bool:
    """Whether a mean is within three standard errors, or `least`, of what was planted."""
    assert mean is not None
    return abs(mean.value - value) <= max(3 * mean.sd, least)


@pytest.mark.slow
def test_weight_centre_of_mass_and_axis_come_back() -> None:
    """A plant of 1.2 times the mass, its centre 11 mm further back and 5 mm further to the left,
    whose thrust leans 2 degrees to the right."""
    vehicle = load_vehicle("copter_default")
    moved = {
        "cog_offset": {"x_m": -0.011, "y_m": -0.005, "z_m": 0.0},
        "thrust_tilt": {"x_rad": 0.0, "y_rad": np.radians(2)},
    }
    plant = vehicle.with_mass(1.2 * vehicle.mass_kg).with_effects(moved)
    found = diagnosis_of(fly(vehicle, plant, 1, waypoints=HOVER), vehicle)
    assert found is not None
    assert near(found.carried, 1.2, 0.01)
    assert near(found.back_m, 0.011, 1e-3)
    assert near(found.right_m, -0.005, 1e-3)
    assert near(found.lean_right_rad, np.radians(2), 2e-3)
    assert near(found.lean_forward_rad, 0.0, 2e-3)
    assert found.weakest is None
    text = hover_sentence("it", found)
    assert text.startswith("At the logged commands it carries 120 % of its weight, and turns as if")
    assert "mm further back and " in text
    assert "mm further to the left; the thrust leans " in text
    assert text.endswith("to the right of where the twin's points.")


@pytest.mark.slow
def test_a_weak_rotor_is_found_in_the_place_of_a_centre_of_mass() -> None:
    """Both are said: a hover cannot part them."""
    vehicle = load_vehicle("copter_default")
    losses = {f"loss_{i}": 0.15 * (i == 2) for i in range(1, 5)}
    plant = vehicle.with_effects({"rotor_efficiency_loss": losses | {"torque_share": 1.0}})
    found = diagnosis_of(fly(vehicle, plant, 1, waypoints=HOVER), vehicle)
    assert found is not None
    assert found.weakest is not None
    assert found.weakest.rotor == 2 == 1 + int(np.argmax(found.split))
    assert near(found.weakest.loss, 0.15, 0.01)
    x, y = vehicle.rotors.position_m[1, :2]
    assert found.back_m is not None and found.right_m is not None
    assert (found.back_m.value * -x > 0) and (found.right_m.value * y > 0)
    assert "or as if rotor 2 gave 1" in hover_sentence("it", found)


def test_a_diagnosis_needs_two_seconds_of_hover() -> None:
    """Made: the twin pushes with 0.8 of what is felt, and rolls where the flight does not."""
    vehicle, t = load_vehicle("copter_default"), np.arange(0.0, 10.0, 0.02)
    cmd = np.full((200, 4), 0.4) * [1.05, 0.95, 1.0, 1.0]
    hover = Hover("made", t[:200], cmd, None, 1.0, None, 4.0, True, "phase hover, 4 s")

    def channel(name: str, measured: float, simulated: float) -> Channel:
        flown, twin = np.full(len(t), measured), np.full(len(t), simulated)
        noise = 0.01 * np.sin(7 * t)
        return Channel(name, "1", 0.0, t, flown + noise, twin, np.full(len(t), "hover"))

    lift, roll = channel("acc_z", -9.8, -0.8 * 9.8), channel("gyro_rate_x", 0.0, 4.0)
    found = diagnose([lift, roll], vehicle, hover)
    assert found is not None
    assert found.carried.value == pytest.approx(0.8, rel=1e-3)
    assert found.carried.sd < 1e-3
    assert found.back_m is None
    assert found.weakest is None
    assert found.split == pytest.approx((0.05, -0.05, 0.0, 0.0))
    # x 1 / 0.8, moment over weight, by hand
    assert near(found.right_m, -0.0211 * 5.0 / (1.4 * 9.8), 1e-5)
    assert diagnose([lift], vehicle, replace(hover, hovers=False)) is None
    assert diagnose([lift], vehicle, replace(hover, t_s=t[:50])) is None
    assert diagnose([roll], vehicle, hover) is None
    assert diagnose([lift], vehicle, None) is None


def test_standard_errors_are_those_of_independent_blocks() -> None:
    """A slow disturbance counts for the seconds it lasts, not for its samples."""
    rng, t = np.random.default_rng(3), np.arange(0.0, 400.0, 0.02)
    vehicle = load_vehicle("copter_default")
    hover = Hover("made", t, np.full((len(t), 4), 0.4), None, 1.0, None, 400.0, True, "")
    slow = np.repeat(rng.normal(0, 0.3, 400), 50)
    flown, twin = -9.8 + slow, np.full(len(t), -9.8)
    phase = np.full(len(t), "hover")
    found = diagnose([Channel("acc_z", "1", 0.0, t, flown, twin, phase)], vehicle, hover)
    assert found is not None
    assert found.carried.sd == pytest.approx(0.3 / 9.8 / np.sqrt(400), rel=0.15)


def test_small_numbers_are_not_said() -> None:
    none = Mean(2e-4, 1e-5)
    made = HoverDiagnosis("a", "", 5.0, Mean(1.004, 0.01), none, none, none, none, (), None)
    assert hover_sentence("it", made) == "At the logged commands it carries 100 % of its weight."
    vague = replace(made, back_m=Mean(0.01, 0.006), lean_right_rad=Mean(0.1, 0.06))
    assert hover_sentence("it", vague) == hover_sentence("it", made)
