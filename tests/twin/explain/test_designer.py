"""The designer of experiments: its manoeuvres, what they separate, and that they do."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from search_rigs.hypotheses import fit_set
from search_rigs.library import library

from twin.explain import design
from twin.explain.design import (
    ENOUGH_NAT,
    Held,
    Suggestion,
    lead,
    next_manoeuvre,
    suggestions,
)
from twin.explain.inference.fit import fit_of
from twin.explain.inference.selection import Naming, name_effects
from twin.explain.inference.whitening import Block
from twin.explain.model.numbers import carrying, with_effects
from twin.explain.settings import DEFAULT
from twin.flight.closed_loop import STEP_S
from twin.flight.manoeuvres import hover_height_m, manoeuvres, plan, rehearse
from twin.logs import Flight
from twin.logs.columns import POS, VEL
from twin.vehicle import Vehicle
from twin.vehicle_file import builtin_vehicles, load_vehicle
from uavtwin.demo.flights import (
    ACC_NOISE_M_S2,
    ATT_NOISE,
    GYRO_NOISE_RAD_S,
    POS_NOISE_M,
    VEL_NOISE_M_S,
    Waypoints,
    fly,
)

COPTER, FEISI = load_vehicle("copter_default"), load_vehicle("feisi_x150")
HOVER: Waypoints = (
    ("ground", 1.0, (0.0, 0.0, 0.0)),
    ("takeoff", 3.0, (0.0, 0.0, -1.5)),
    ("hover", 4.0, (0.0, 0.0, -1.5)),
)
FEW = (
    "mass_offset",
    "thrust_scale",
    "rotor_efficiency_loss",
    "thrust_curve",
    "accel_bias",
    "accel_scale",
    "inertia_error",
    "rotor_drag",
)
"""Candidates of the search here: all of them take four times as long."""
PLANTS = {
    "mass_offset": replace(COPTER, mass_kg=1.1 * COPTER.mass_kg),
    "thrust_scale": replace(
        COPTER,
        rotors=replace(COPTER.rotors, thrust_n=tuple(0.9 * c for c in COPTER.rotors.thrust_n)),
    ),
}
"""By their own numbers, not by the effects."""


def hovering(vehicle: Vehicle, plant: Vehicle) -> Flight:
    return fly(vehicle, plant, seed=1, name="hover", waypoints=HOVER)


def flown(name: str, vehicle: Vehicle, plant: Vehicle, like: Flight) -> Flight:
    """A manoeuvre with the noise of the flights before it."""
    chosen = [m for m in manoeuvres(vehicle) if m.name == name]
    flight = rehearse(plan(vehicle, chosen), vehicle, plant, [like])
    rng, table = np.random.default_rng(2), flight.table.copy()
    for stem, noise in (
        ("acc", ACC_NOISE_M_S2),
        ("gyro", GYRO_NOISE_RAD_S),
        ("pos", POS_NOISE_M),
        ("vel", VEL_NOISE_M_S),
        ("q", ATT_NOISE),
    ):
        columns = [c for c in table if c.startswith(f"{stem}_")]
        table[columns] += noise * rng.standard_normal((len(table), len(columns)))
    return replace(flight, name=name, table=table)


def tie(flight: Flight, vehicle: Vehicle, names: Sequence[str]) -> Naming:
    """Single effects fitted to a flight and declared equally probable."""
    with library(names):
        naming = name_effects([flight], vehicle)
    fitted = tuple(fit_set(naming.problem, [e]) for e in names)
    even = (1 / len(names),) * len(names)
    return replace(naming, fitted=fitted, probabilities=even)


# -- manoeuvres -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", builtin_vehicles())
def test_manoeuvres_start_and_end_at_rest_in_the_hover(name: str) -> None:
    for m in manoeuvres(load_vehicle(name)):
        where = m.move(np.array([0.0, 1e-3, m.duration_s - 1e-3, m.duration_s]))
        where[:, 3] = np.sin(where[:, 3] / 2)  # a whole turn is none
        assert np.abs(where).max() < 1e-6, m.name


def test_small_vehicles_fly_at_half_the_size() -> None:
    small, large = (
        {m.name: m for m in manoeuvres(load_vehicle(v))} for v in ("crazyflie", "copter_default")
    )
    t = np.linspace(0, 60, 6001)
    for name in ("vertical_steps", "forward_legs", "doublets"):
        ways = [np.abs(m[name].move(t)[:, :3]).max() for m in (small, large)]
        assert ways[0] == pytest.approx(ways[1] / 2)


def test_a_plan_strings_manoeuvres_together_at_whole_blocks() -> None:
    flight = plan(COPTER, manoeuvres(COPTER))
    spans = list(flight.spans.values())
    assert [a for a, _ in spans[1:]] == [b for _, b in spans[:-1]]
    assert np.all(np.array(spans) % DEFAULT.inference.likelihood.block_s == 0)
    assert len(flight.setpoints) == len(flight.phases)
    for first, last in spans:
        for t in (first, last - STEP_S):
            row = flight.setpoints[round(t / STEP_S)]
            assert row[2] == pytest.approx(-COPTER.leg_height_m - hover_height_m(COPTER))
            assert row[3:9] == pytest.approx(0, abs=0.05)


@pytest.mark.long
@pytest.mark.parametrize("name", ["crazyflie", "feisi_x150"])  # copter_default is flown below
def test_every_manoeuvre_can_be_flown(name: str) -> None:
    vehicle = load_vehicle(name)
    like = hovering(vehicle, vehicle)
    whole = plan(vehicle, manoeuvres(vehicle))
    flight = rehearse(whole, vehicle, vehicle, [like])
    assert len(flight.table) == pytest.approx(len(whole.phases) / 5, abs=1)  # never lost
    commands = flight.table[[c for c in flight.table if c.startswith("cmd_")]].dropna()
    assert commands[flight.table["phase"] == "tour"].max(axis=None) < 0.95


# -- rehearsal ------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_late_command_is_recorded_early() -> None:
    like = hovering(FEISI, FEISI)
    steps = plan(FEISI, [m for m in manoeuvres(FEISI) if m.name == "vertical_steps"])
    late = with_effects(FEISI, ["command_delay"], {"command_delay.delay_s": 0.05})
    now, early = (rehearse(steps, FEISI, p, [like]).table for p in (FEISI, late))
    rows = round(0.05 * 200)
    np.testing.assert_allclose(early["cmd_1"][:-rows], now["cmd_1"][rows:])
    np.testing.assert_allclose(early["acc_z"], now["acc_z"])


@pytest.mark.slow
def test_a_record_has_the_columns_and_rates_of_the_flights_and_ends_where_it_is_lost() -> None:
    like = hovering(FEISI, FEISI)
    like = replace(like, table=like.table.drop(columns=["vel_x", "vel_y", "vel_z"]))
    crossed = 0.005 - FEISI.rotors.position_m * [1, 1, 0]
    torn = replace(FEISI, rotors=replace(FEISI.rotors, position_m=crossed))
    steps = plan(FEISI, manoeuvres(FEISI)[:1])
    good, lost = (rehearse(steps, FEISI, p, [like]).table for p in (FEISI, torn))
    assert set(good) == set(like.table)
    assert good["pos_x"].notna().mean() == pytest.approx(0.5, abs=0.01)
    assert len(lost) < len(good) / 2


# -- separation -----------------------------------------------------------------------------


def test_the_lead_is_what_no_number_can_follow() -> None:
    """Slopes (1, 0), prediction (3, 4): free, 4^2 / 2 is left; held by 1, 3^2 / 4 more."""
    block = Block(np.array([[1.0]]), np.array([3.0]), 25.0)
    wide = {"low": np.array([-10.0]), "high": np.array([10.0])}
    assert lead([block], Held(np.array([[1e-12]]), **wide)) == pytest.approx(8.0)
    assert lead([block], Held(np.array([[1.0]]), **wide)) == pytest.approx(8 + 9 / 4)
    bound = Held(np.array([[1e-12]]), np.array([-10.0]), np.array([1.0]))
    assert lead([block], bound) == pytest.approx(8 + 2.0)
    nearly = np.array([[1.0, 0.999], [0.999, 1.0]])
    corner = Held(1e-12 * np.eye(2), np.array([-10.0, 0.0]), np.array([10.0, 10.0]))
    two = Block(nearly, np.array([3.0, 2.0]), 25.0)  # the second alone would go down to -299
    assert lead([two], corner) == pytest.approx(8.0)
    nothing = Held(np.zeros((0, 0)), np.zeros(0), np.zeros(0))
    assert lead([Block(np.zeros((0, 0)), np.zeros(0), 25.0)], nothing) == 12.5
    assert lead([], nothing) == 0.0


@pytest.mark.slow
def test_a_number_that_a_suggested_flight_does_not_tell_counts_as_it_is_held() -> None:
    """The clock of a position, where none is recorded."""
    flight = hovering(COPTER, PLANTS["thrust_scale"])
    with library(["thrust_scale", "clock_offset"]):
        naming = name_effects([flight], COPTER)
    other = fit_set(naming.problem, ["thrust_scale"])
    other = replace(other, values={**other.values, "clock_offset.pose_s": 0.02})
    numbers = [n.full for n in naming.whitened.model.numbers if n.full in other.values]
    unplaced = replace(flight, table=flight.table.drop(columns=[*POS, *VEL]))
    blocks = design._parting(naming, unplaced, COPTER, naming.nothing, other)
    gram = np.sum([b.gram for b in blocks.values()], axis=0)
    clock, scale = (numbers.index(n) for n in sorted(numbers))
    assert gram[scale, scale] > 0
    assert not np.any(gram[clock])


@pytest.mark.slow
def test_wind_and_tilted_rotors_part_when_the_nose_turns() -> None:
    windy = with_effects(
        FEISI, ["steady_wind"], {"steady_wind.north_m_s": 2.0, "steady_wind.east_m_s": 1.0}
    )
    naming = tie(hovering(FEISI, windy), FEISI, ["steady_wind", "thrust_tilt"])
    ranked = suggestions(naming, FEISI, ["hover", "yaw_steps", "four_headings"])
    assert ranked[0].manoeuvre == "four_headings"
    assert ranked[-1].manoeuvre == "hover"


@pytest.mark.long
def test_weak_rotors_and_a_weak_battery_part_at_another_voltage() -> None:
    vehicle = replace(COPTER, battery=load_vehicle("crazyflie").battery)
    flight = hovering(vehicle, PLANTS["thrust_scale"])
    flight = replace(flight, table=flight.table.assign(vbat_v=3.4))
    naming = tie(flight, vehicle, ["thrust_scale", "battery_sag"])
    ranked = suggestions(naming, vehicle, ["hover", "vertical_steps", "other_voltage"])
    assert ranked[0].manoeuvre == "other_voltage"
    assert ranked[0].separation > 10 * ranked[1].separation


@pytest.mark.slow
@pytest.mark.parametrize(
    "truth",
    [*list(PLANTS)[:1], *(pytest.param(p, marks=pytest.mark.long) for p in list(PLANTS)[1:])],
)
def test_a_known_payload_separates_extra_mass_from_weak_rotors(truth: str) -> None:
    """Force over mass: unknown mass counts for less once a known one is aboard, lost thrust does
    not. With 10 % of each and half the mass aboard they part by 3 % of the weight."""
    naming = tie(hovering(COPTER, PLANTS[truth]), COPTER, list(PLANTS))
    ranked = suggestions(naming, COPTER, ["hover", "payload_swap"])
    assert ranked[0].manoeuvre == "payload_swap"
    assert ranked[0].separation > max(ENOUGH_NAT, 10 * ranked[1].separation)
    (swap,) = (m for m in manoeuvres(COPTER) if m.name == "payload_swap")
    old = hovering(COPTER, PLANTS[truth])
    loaded, plant = (carrying(v, swap.payload_kg) for v in (COPTER, PLANTS[truth]))
    new = flown("payload_swap", loaded, plant, old)
    with library(list(PLANTS)):
        after = name_effects([old, new], COPTER, payloads={new.name: swap.payload_kg})
    assert after.verdict == "named"
    assert after.best.effects == (truth,)


# -- the whole ------------------------------------------------------------------------------


@pytest.mark.long
def test_the_suggested_flight_separates_and_one_ranked_low_does_not() -> None:
    """Extra mass and weak rotors are the same in hover; what turns the vehicle tells them apart.

    The two are declared the leading explanations: in 8 s of hover three rows of the slowest band
    may look like an accelerometer's scale by chance, and its set would lead.
    """
    so_far = {truth: hovering(COPTER, plant) for truth, plant in PLANTS.items()}
    with library(FEW):
        assert name_effects([so_far["mass_offset"]], COPTER).verdict == "cannot_tell"
    ranked = suggestions(tie(so_far["mass_offset"], COPTER, list(PLANTS)), COPTER)
    best = ranked[0]
    assert best.separates == tuple((truth,) for truth in PLANTS)
    assert best.separation > 1000.0

    def named(suggestion: Suggestion, truth: str) -> Naming:
        """Truth planted, old flight and the suggested one."""
        old = so_far[truth]
        new = flown(suggestion.manoeuvre, COPTER, PLANTS[truth], old)
        with library(FEW):
            return name_effects([old, new], COPTER)

    for truth, other in (tuple(PLANTS), tuple(PLANTS)[::-1]):
        after = named(best, truth)
        assert after.probability_of(truth) > 0.8
        assert after.probability_of(other) < 0.1
    low = next(s for s in ranked[::-1] if s.manoeuvre != "hover")
    assert low.separation < 5.0
    still = named(low, "mass_offset")
    assert still.verdict == "cannot_tell"
    assert still.probability_of("thrust_scale") > 0.2


@pytest.mark.slow
def test_one_weak_rotor_is_told_from_another_cause_by_a_flight() -> None:
    """A set may hold one rotor's number without those of the others."""
    weak = COPTER.with_effects({"rotor_efficiency_loss": {"loss_3": 0.1}})
    names = ["rotor_efficiency_loss", "cog_offset"]
    naming = tie(hovering(COPTER, weak), COPTER, names)
    state = naming.problem.start(["rotor_efficiency_loss:3"], 1.0)
    best = state.best
    one = fit_of(naming.problem, state.effects, best.x, best.deviations(), 0.0)
    (found,) = suggestions(
        replace(naming, fitted=(one, naming.fitted[1])), COPTER, ["vertical_steps"]
    )
    assert found.separates == (("rotor_efficiency_loss",), ("cog_offset",))
    assert np.isfinite(found.separation)


def test_one_explanation_alone_is_separated_from_nothing() -> None:
    """Something else is missing then: "cannot_tell" without a second one."""
    alone: Any = SimpleNamespace(
        fitted=(SimpleNamespace(effects=()),),
        probabilities=(1.0,),
        verdict="cannot_tell",
        undecided=(),
    )
    assert next_manoeuvre(alone, COPTER) is None


@pytest.mark.parametrize(
    ("sets", "probabilities", "second"),
    [
        (("a", "b", "ac", "ad"), (0.4, 0.25, 0.2, 0.15), "ac"),  # with more: 0.35 together
        (("a", "b", "ac", "ad"), (0.4, 0.35, 0.15, 0.1), "b"),
        (("a", "b", "c"), (1.0, 0.0, 0.0), "b"),
    ],
)
def test_rivals_are_of_the_likelier_kind(
    sets: tuple[str, ...], probabilities: tuple[float, ...], second: str
) -> None:
    fitted = [SimpleNamespace(effects=tuple(s)) for s in sets]
    naming: Any = SimpleNamespace(fitted=fitted, probabilities=probabilities)
    assert [f.effects for f in design._rivals(naming)] == [("a",), tuple(second)]


@pytest.mark.slow
def test_nothing_is_suggested_where_the_name_is_sure() -> None:
    naming = tie(hovering(COPTER, PLANTS["mass_offset"]), COPTER, ["mass_offset", "accel_bias"])
    assert next_manoeuvre(replace(naming, probabilities=(0.99, 0.01)), COPTER) is None
