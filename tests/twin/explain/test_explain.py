"""Around the search: flights fit for it, hold-out by time, the gap shown, the vehicle file."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from search_rigs.library import library

from twin.effects import EFFECTS
from twin.errors import ModelError
from twin.explain.estimates import listed_effects
from twin.explain.explanation import explain
from twin.explain.holdout import (
    ChannelGap,
    Comparison,
    attribute_effect,
    compare_holdout,
    held_out_spans,
    hidden,
    localize,
)
from twin.explain.model.model import model_of
from twin.explain.model.numbers import with_effects
from twin.explain.settings import DEFAULT
from twin.explain.usable import usable_part
from twin.flight.closed_loop import fly_missions
from twin.logs import Flight
from twin.residuals.channels import GRID_HZ
from twin.vehicle import Vehicle
from twin.vehicle_file import builtin_vehicles, load_vehicle, parse_vehicle, vehicle_text
from twin.vehicle_file.write import Written, with_effect_sections
from uavtwin.demo.flights import Waypoints, fly
from uavtwin.headline import headline

COPTER = load_vehicle("copter_default")
LEGS: Waypoints = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 2.0, (0.0, 0.0, -1.5)),
    ("forward", 2.0, (3.0, 1.0, -1.5)),
    ("forward", 2.0, (0.0, -2.0, -2.0)),
    ("hover", 1.5, (0.0, -2.0, -2.0)),
)
DRAG_1_S = 0.5
VALUES = {"rotor_drag.k_xy_1_s": DRAG_1_S, "rotor_drag.k_z_1_s": 0.0}


def dragged(vehicle: Vehicle) -> Vehicle:
    """The vehicle with rotor drag, by its own drag numbers and not by the effect."""
    drag = vehicle.drag_linear_n_s_m + DRAG_1_S * vehicle.mass_kg * np.array([1.0, 1.0, 0.0])
    return replace(vehicle, drag_linear_n_s_m=drag)


@pytest.fixture(scope="module")
def flight() -> Flight:
    """Eight seconds with rotor drag that the twin lacks."""
    return fly(COPTER, dragged(COPTER), seed=1, name="dragged", waypoints=LEGS)


@pytest.fixture(scope="module")
def shown(flight: Flight) -> Comparison:
    """Before and after the true effect is added."""
    return compare_holdout([flight], COPTER, ["rotor_drag"], VALUES)


# -- showing --------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_true_effect_closes_the_gap_to_the_noise_floor(shown: Comparison) -> None:
    gaps = {g.name: g for g in shown.gaps}
    for name in ("acc_x", "acc_y"):
        gap = gaps[name]
        assert gap.before > 10 * gap.noise_floor
        assert gap.after < 1.5 * gap.noise_floor  # drag of the body, not of turning rotors
        assert gap.closed > 0.97
        assert 0.5 < gap.shrink_ci95[0] < gap.shrink < gap.shrink_ci95[1] < 1
    assert gaps["pose_gyro_z"].shrink == 0.0  # drag is not felt there
    assert np.isnan(gaps["pose_gyro_z"].closed)
    assert not shown.warnings


@pytest.mark.slow
def test_a_constant_of_the_day_is_set_apart_and_nothing_else() -> None:
    plant = with_effects(dragged(COPTER), ["accel_bias"], {"accel_bias.x_m_s2": 0.12})
    flown = fly(COPTER, plant, seed=2, name="biased", waypoints=LEGS)
    with_drag, without = (
        {g.name: g for g in compare_holdout([flown], COPTER, effects, values).gaps}["acc_x"]
        for effects, values in ((["rotor_drag"], VALUES), ([], {}))
    )
    assert with_drag.after > 4 * with_drag.noise_floor
    assert with_drag.on_its_day < 2 * with_drag.noise_floor  # drag of the body, not of rotors
    assert without.on_its_day > 3 * without.noise_floor  # drag is no constant


@pytest.mark.slow
def test_the_mean_of_the_flights_that_were_fitted_is_a_baseline(flight: Flight) -> None:
    plain = compare_holdout([flight], COPTER, [], {}, means={"acc_x": 0.3})
    gaps = {g.name: g for g in plain.gaps}
    residual = next(c.residual for c in plain.before[0] if c.name == "acc_x")
    assert gaps["acc_x"].fit_mean == pytest.approx(np.sqrt(np.mean((residual - 0.3) ** 2)))
    assert gaps["acc_y"].fit_mean is None


@pytest.mark.slow
def test_a_wrong_number_makes_channels_worse_and_that_is_said_first(flight: Flight) -> None:
    wrong = compare_holdout([flight], COPTER, ["mass_offset"], {"mass_offset.mass_kg": 0.2})
    assert wrong.gaps[0].name == "acc_z"
    assert wrong.gaps[0].worse
    assert wrong.warnings[0].startswith("acc_z got worse")


def test_the_interval_of_the_shrink_is_that_of_the_blocks() -> None:
    gap = ChannelGap(
        name="acc_x",
        unit="m/s²",
        n=100,
        before=2.0,
        after=0.5,
        on_its_day=0.5,
        fit_mean=None,
        noise_floor=0.4,
        shrink_ci95=(0.7, 0.8),
    )
    assert gap.shrink == pytest.approx(0.75)
    assert gap.closed == pytest.approx(1.5 / 1.6)
    assert not gap.worse


@pytest.mark.slow
def test_an_effect_acts_where_it_is_felt(shown: Comparison) -> None:
    acts = attribute_effect("rotor_drag", shown.model, VALUES, shown.after)
    assert set(acts.channels) == {"acc_x", "acc_y"}
    assert acts.phases[0] == "forward"


@pytest.mark.slow
def test_places_name_channel_phase_and_what_the_residual_goes_with(shown: Comparison) -> None:
    found = localize(shown.model, VALUES, shown.floors)
    first = next(p for p in found if p.channel == "acc_x")
    assert first.phase == "forward"
    assert first.explained > 0.99
    assert first.goes_with is not None
    assert first.goes_with[0] == "forward speed"
    assert found == sorted(found, key=lambda p: -p.over_floor)


# -- split ----------------------------------------------------------------------------------


def test_time_blocks_share_no_reading_and_lose_none(flight: Flight) -> None:
    spans = held_out_spans(flight)
    assert spans == [(DEFAULT.holdout.spared_s, flight.table["time"].iloc[-1])]
    fit, held = (hidden(flight, spans, inside) for inside in (True, False))
    for column in ("acc_x", "gyro_z"):
        a, b, whole = (f.table[column].notna() for f in (fit, held, flight))
        assert not (a & b).any()
        assert a.any()
        assert ((a | b) == whole)[:-1].all()
    pose_and_commands = ["pos_x", "q_w", "vel_z", "cmd_1"]
    assert fit.table[pose_and_commands].equals(flight.table[pose_and_commands])


# -- usable ---------------------------------------------------------------------------------

Change = Callable[[pd.DataFrame], Any]


def negated(column: str) -> Change:
    return lambda t: -t[column]


SPOILT: dict[str, tuple[dict[str, Change], str]] = {
    "conjugated": ({f"q_{a}": negated(f"q_{a}") for a in "xyz"}, "do not turn together"),
    "upward": ({"acc_z": negated("acc_z")}, "check the axes"),
    "altitude": ({"pos_z": negated("pos_z")}, "vel_z is not the rate"),
    "east-north": (
        {"vel_x": lambda t: t["vel_y"], "vel_y": lambda t: -t["vel_x"]},
        "not the rate of change",
    ),
}


def test_a_good_flight_is_usable(flight: Flight) -> None:
    assert usable_part(flight, COPTER)[2] == []


@pytest.mark.slow
@pytest.mark.parametrize("kind", SPOILT)
def test_a_spoilt_flight_is_told_by_its_reason(flight: Flight, kind: str) -> None:
    changes, word = SPOILT[kind]
    table = flight.table.copy()
    known = {c: table[c].notna() for c in changes}
    for column, values in {c: change(flight.table) for c, change in changes.items()}.items():
        table[column] = pd.Series(values, index=table.index).where(known[column])
    reasons = usable_part(replace(flight, table=table), COPTER)[2]
    assert any(word in reason for reason in reasons), reasons
    assert all(reason.startswith("dragged: ") for reason in reasons)


PARTLY: dict[str, tuple[dict[str, Change], str, float, float]] = {
    "hit": (
        {"acc_x": lambda t: np.where(t["time"].between(7, 7.1), 200, t["acc_x"])},
        "from 6.0 s on",
        0.0,
        6.0,
    ),
    "bump": (
        {"acc_x": lambda t: np.where(t["time"].between(2.5, 2.6), 200, t["acc_x"])},
        "up to 3.",
        3.6,
        np.inf,
    ),
    "upside down": (
        {
            "q_w": lambda t: t["q_w"].where(t["time"] < 7, 0),
            "q_x": lambda t: t["q_x"].where(t["time"] < 7, 1),
        },
        "upside down at 7.0 s",
        0.0,
        6.0,
    ),
    "lies on its side": (
        {
            "q_w": lambda t: t["q_w"].where(t["time"] < 7, np.sqrt(0.7)),
            "q_x": lambda t: t["q_x"].where(t["time"] < 7, np.sqrt(0.3)),
        },
        "lies on its side",
        0.0,
        6.0,
    ),
}
"""What happens, what is said of it, and the part that is used."""


def spoilt(flight: Flight, changes: dict[str, Change]) -> Flight:
    table = flight.table.copy()
    for column, change in changes.items():
        known = table[column].notna()
        values = change(flight.table)
        table[column] = pd.Series(values, index=table.index).where(known)
    return replace(flight, table=table)


@pytest.mark.slow
@pytest.mark.parametrize("kind", PARTLY)
def test_seconds_are_left_out_and_not_the_flight(flight: Flight, kind: str) -> None:
    changes, word, first, last = PARTLY[kind]
    part, left_out, reasons = usable_part(spoilt(flight, changes), COPTER)
    assert reasons == []
    (said,) = left_out
    assert word in said, said
    assert part.time_s[0] == pytest.approx(max(first, flight.time_s[0]), abs=0.05)
    assert part.time_s[-1] == pytest.approx(min(last, flight.time_s[-1]), abs=0.05)


@pytest.mark.slow
def test_a_motor_at_its_limit_hides_torque_and_thrust_alone(flight: Flight) -> None:
    """For two seconds; what is read across the thrust counts all the time."""
    at_limit = {"cmd_1": lambda t: np.where(t["time"].between(4, 6), 1.0, t["cmd_1"])}
    saturated = spoilt(flight, at_limit)
    part, (said,), reasons = usable_part(saturated, COPTER)
    assert reasons == [] and part is saturated
    assert "gyro_rate and acc_z" in said
    by_name = {
        c.name: c for c in model_of([saturated], COPTER, [EFFECTS["rotor_drag"]]).channels([])[0]
    }
    whole = {c.name: c for c in model_of([flight], COPTER, [EFFECTS["rotor_drag"]]).channels([])[0]}
    np.testing.assert_array_equal(by_name["acc_x"].t_s, whole["acc_x"].t_s)
    for name in ("acc_z", "gyro_rate_x"):
        assert len(by_name[name].t_s) < len(whole[name].t_s)
        assert not np.any(np.abs(by_name[name].t_s - 5) < 1 - 1 / GRID_HZ)


@pytest.mark.slow
def test_what_is_left_has_to_be_long_enough(flight: Flight) -> None:
    hit = {"acc_x": lambda t: np.where(t["time"] % 3 < 0.1, 200, t["acc_x"])}
    (reason,) = usable_part(spoilt(flight, hit), COPTER)[2]
    assert "s in the air" in reason and "hits something" in reason


@pytest.mark.slow
def test_too_short_and_never_airborne(flight: Flight) -> None:
    (short,) = usable_part(replace(flight, table=flight.table[flight.table.time < 3]), COPTER)[2]
    assert "s in the air" in short
    (never,) = usable_part(replace(flight, table=flight.table[flight.table.time < 0.4]), COPTER)[2]
    assert "never airborne" in never


@pytest.mark.parametrize("late_s", [-0.15, 0.3])
def test_a_late_attitude_is_an_effect_and_no_reason(flight: Flight, late_s: float) -> None:
    table = flight.table.copy()
    q = [f"q_{a}" for a in "wxyz"]
    table[q] = table[q].shift(round(late_s * 200)).bfill(limit=200).where(table[q].notna())
    assert usable_part(replace(flight, table=table), COPTER)[2] == []


# -- vehicle file ---------------------------------------------------------------------------


@pytest.mark.parametrize("name", builtin_vehicles())
def test_written_effects_come_back_and_nothing_else_changes(name: str) -> None:
    vehicle, (text, file) = load_vehicle(name), vehicle_text(name)
    wanted = {
        e: {k: 1.01 * v + 1e-7 for k, v in effect.starts(vehicle).items()}
        for e, effect in EFFECTS.items()
        if effect.of_vehicle
    }
    written = {
        e: {k: Written(v, "a test") for k, v in numbers.items()} for e, numbers in wanted.items()
    }
    new = with_effect_sections(text, vehicle, written)
    assert new.startswith(text.rstrip("\n"))
    again = parse_vehicle(new, file)
    assert again.effects == wanted
    assert again.sources["effects.rotor_drag.k_xy_1_s"] == "a test"
    assert parse_vehicle(new, file).mass_kg == vehicle.mass_kg
    assert with_effect_sections(new, vehicle, written) == new


OLD = "k_xy_1_s = { value = 0.3, unit = '1/s', source = 'old' }"


@pytest.mark.parametrize(
    ("head", "tail"),
    [
        ("", f"\n[effects.rotor_drag] # mine\n{OLD}\n\n[effects.mass_offset] # keep me\n"),
        ("", f"\n[effects]\nmass_offset = {{}} # keep me\n\n[effects.rotor_drag]\n{OLD}"),
        (f"effects = {{ mass_offset = {{}}, rotor_drag = {{ {OLD} }} }} # keep me\n", ""),
        (f"# keep me\neffects.mass_offset = {{}}\neffects.rotor_drag.{OLD}\n", ""),
    ],
)
def test_a_section_is_replaced_and_the_others_are_kept(head: str, tail: str) -> None:
    text = head + vehicle_text("crazyflie")[0] + tail
    vehicle = parse_vehicle(text, "mine.toml")
    numbers = {"k_xy_1_s": Written(0.39, "new"), "k_z_1_s": Written(0.1, "new")}
    new = parse_vehicle(
        with_effect_sections(text, vehicle, {"rotor_drag": numbers}), "mine.toml"
    ).effects
    assert new["rotor_drag"] == EFFECTS["rotor_drag"].starts(vehicle) | {
        "k_xy_1_s": 0.39,
        "k_z_1_s": 0.1,
    }
    assert set(new) == {"rotor_drag", "mass_offset"}


def test_comments_stay() -> None:
    text = "# on top\n" + vehicle_text("crazyflie")[0] + "\n[effects.mass_offset] # keep me\n"
    vehicle = parse_vehicle(text, "mine.toml")
    new = with_effect_sections(text, vehicle, {"rotor_drag": {"k_xy_1_s": Written(0.39, "new")}})
    for comment in ("# on top", "# keep me"):
        assert comment in new


def test_vehicle_text_names_the_file_that_is_not_there() -> None:
    with pytest.raises(ModelError, match=r"copter_defalt.*copter_default"):
        vehicle_text("copter_defalt")


# -- flying ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_vehicle_flies_with_an_effect_and_not_without_thrust() -> None:
    good = with_effects(COPTER, ["rotor_drag"], VALUES)
    (mission,) = fly_missions(good, ["takeoff"])
    assert mission.stable
    assert mission.worst_m < 0.1
    weak = with_effects(COPTER, ["thrust_scale"], {"thrust_scale.scale": 0.2})
    (mission,) = fly_missions(weak, ["takeoff"])
    assert not mission.stable
    assert mission.problem


# -- taking back ----------------------------------------------------------------------------


@pytest.mark.slow
def test_a_name_that_held_out_flights_gainsay_is_taken_back() -> None:
    weak = COPTER.with_effects({"thrust_scale": {"scale": 0.85}})
    seen = fly(COPTER, weak, 1, "weak", LEGS)
    for other, verdict in ((weak, "named"), (COPTER, "cannot_tell")):
        held = fly(COPTER, other, 2, "held", LEGS)
        with library(("thrust_scale", "thrust_curve", "rotor_drag", "accel_bias", "accel_scale")):
            found = explain([seen], [held], COPTER, missions=(), suggest=False)
        assert listed_effects(found)[0] == "thrust_scale"
        assert found.verdict == verdict
        assert (found.added is None) == bool(found.refuted) == (verdict == "cannot_tell")
        assert (found.refuted in found.warnings) == bool(found.refuted)
        assert headline(found).text.startswith("These flights point to") == bool(found.refuted)
