"""The balance of forces and moments: planted causes, probabilities that are true, units."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm

from twin.explain import balance, explanation
from twin.explain.balance import (
    BALANCED,
    DAY,
    LOAD,
    LOG_ODDS,
    NOTHING,
    ROTORS,
    SESSION,
    SIZES,
    VIBRATION,
    Balance,
    Hypothesis,
    Normal,
    Trim,
    balance_of,
    channels_of_balance,
)
from twin.explain.explanation import Explanation
from twin.explain.inference.fit import INTERVAL
from twin.explain.inference.selection import Naming, Verdict
from twin.explain.stochastic.spectral import StochasticEffect
from twin.vehicle import Calibration
from twin.vehicle.vehicle import Vehicle
from twin.vehicle_file import load_vehicle

Array = NDArray[np.float64]
SURE = 0.8
COPTER = load_vehicle("copter_default")
N = COPTER.rotors.count
G = 9.80665


def slopes_of(vehicle: Vehicle) -> tuple[tuple[str, ...], Array]:
    """Slopes of a rigid body in hover, written down by hand: thrust, and moments over inertia."""
    weight, (ix, iy, iz) = vehicle.mass_kg * G, np.diag(vehicle.inertia_kg_m2)
    per_thrust = 0.016
    names, columns = [], []
    turns = (1, 1, -1, -1)
    for i, (x, y, _) in enumerate(vehicle.rotors.position_m):
        share = weight / N
        names.append(f"{ROTORS}.loss_{i + 1}")
        moments = (share * y / ix, -share * x / iy, turns[i] * per_thrust * share / iz)
        columns.append((share / vehicle.mass_kg, *moments))
    names += [f"{LOAD}.mass_kg", *(f"{LOAD}.moment_{a}_kg_m" for a in "xyz")]
    columns += [(G / vehicle.mass_kg, 0, 0, 0), (0, 0, -G / iy, 0), (0, G / ix, 0, 0), (0,) * 4]
    return tuple(names), np.array(columns, dtype=np.float64).T


NAMES, SLOPES = slopes_of(COPTER)
UNIT = np.array(
    [
        G,
        COPTER.mass_kg * G * COPTER.arm_m / COPTER.inertia_kg_m2[0, 0],
        COPTER.mass_kg * G * COPTER.arm_m / COPTER.inertia_kg_m2[1, 1],
        np.abs(SLOPES[3, :N]).sum(),
    ]
)
FLIGHTS = ("one", "two", "three")


def calibrated(scale: Array | float = 1.0, vibration: bool = False) -> Vehicle:
    """The aircraft after three flights, whose days differ as the table says."""
    means = dict.fromkeys(BALANCED, 0.0)
    scatter = dict(zip(BALANCED, (DAY * UNIT * scale).tolist(), strict=True))
    if vibration:
        means[VIBRATION] = -1.0
    known = Calibration(FLIGHTS, (), np.zeros((0, 0)), {}, {}, means=means, scatter=scatter)
    return replace(COPTER, calibration=known)


def judged(change: Array, scale: Array | float = 1.0, shaken: float | None = None) -> Balance:
    """What is said of a change of the means, in units of the table."""
    vibration = np.zeros(0) if shaken is None else np.array([shaken - 1.0])
    scaled = SLOPES * np.reshape(scale, (-1, 1)) if np.ndim(scale) else SLOPES * scale
    trim = Trim(BALANCED, (change * scale)[None], scaled, NAMES, vibration)
    return balance_of(trim, Normal.of(trim, calibrated(scale, shaken is not None), True), SURE)


def of(name: str, value: float) -> Array:
    return SLOPES[:, NAMES.index(name)] * value


# -- planted ----------------------------------------------------------------------------------


@pytest.mark.parametrize("rotor", range(1, N + 1))
def test_a_weak_rotor_is_found_with_its_loss(rotor: int) -> None:
    found = judged(of(f"{ROTORS}.loss_{rotor}", 0.25))
    best = found.best(ROTORS)
    assert best.rotors == (rotor,)
    assert found.changed > 0.99
    assert best.values[f"{ROTORS}.loss_{rotor}"] == pytest.approx(0.25, abs=0.03)
    assert int(np.argmax(found.more)) == rotor - 1
    told = found.named or found.one_of[0]
    assert told.cause == ROTORS or {h.cause for h in found.one_of} == {ROTORS, LOAD}


@pytest.mark.slow
def test_no_name_where_every_interval_contains_no_change() -> None:
    found = judged(of(f"{LOAD}.mass_kg", 0.3 * COPTER.mass_kg))
    assert found.named is not None and found.named.clear
    wide = {n: 100 * sd for n, sd in found.named.deviations.items()}
    others = found.hypotheses[1:]
    vague = replace(found, hypotheses=(replace(found.named, deviations=wide), *others))
    assert vague.probability_of(LOAD) == found.probability_of(LOAD)
    assert (vague.named, vague.one_of) == (None, ())


def test_a_load_in_the_middle_is_a_load() -> None:
    found = judged(of(f"{LOAD}.mass_kg", 0.3 * COPTER.mass_kg))
    assert found.named is not None
    assert found.named.cause == LOAD
    mass = found.named.values[f"{LOAD}.mass_kg"]
    assert mass == pytest.approx(0.3 * COPTER.mass_kg, rel=0.2)


@pytest.mark.parametrize(
    ("nothing", "rotor", "load", "told"),
    [
        (0.05, 0.02, 0.93, {LOAD}),
        (0.12, 0.03, 0.85, {LOAD}),
        (0.12, 0.85, 0.03, {ROTORS}),
        (0.00, 0.06, 0.94, {LOAD, ROTORS}),
        (0.05, 0.05, 0.90, {LOAD, ROTORS}),
        (0.19, 0.02, 0.79, {LOAD, ROTORS}),  # that something has changed is sure, no cause is
        (0.22, 0.01, 0.77, set()),
    ],
)
def test_a_name_has_other_causes_for_rivals_and_not_that_nothing_has_changed(
    nothing: float, rotor: float, load: float, told: set[str]
) -> None:
    found = judged(of(f"{LOAD}.mass_kg", 0.12 * COPTER.mass_kg))
    chances = {NOTHING: nothing, ROTORS: rotor, LOAD: load}
    clear = (replace(found.best(c), probability=p, values={}) for c, p in chances.items())
    found = replace(found, hypotheses=tuple(clear))
    named = () if found.named is None else (found.named,)
    assert {h.cause for h in (*named, *found.one_of)} == told
    assert bool(named) == (len(told) == 1)


def test_a_load_in_the_middle_is_named_as_soon_as_it_is_sure() -> None:
    """No rotor does the same, however near nothing is."""
    found = judged(of(f"{LOAD}.mass_kg", 0.12 * COPTER.mass_kg))
    assert found.named is not None
    assert SURE <= found.named.probability < balance.ALONE
    mass, sd = (v[f"{LOAD}.mass_kg"] for v in (found.named.values, found.named.deviations))
    assert mass == pytest.approx(0.12 * COPTER.mass_kg, abs=INTERVAL * sd)


def test_a_load_at_a_hub_without_yaw_is_this_or_that() -> None:
    x, y, _ = COPTER.rotors.position_m[0]
    kg = 0.08 * COPTER.mass_kg
    parts = {"mass_kg": kg, "moment_x_kg_m": kg * x, "moment_y_kg_m": kg * y}
    found = judged(np.sum([of(f"{LOAD}.{k}", v) for k, v in parts.items()], axis=0))
    assert {h.cause for h in found.one_of} == {ROTORS, LOAD}
    assert found.probability_of(LOAD) > 0.3


def test_nothing_has_changed_where_nothing_has() -> None:
    found = judged(np.zeros(4))
    assert found.hypotheses[0].cause == NOTHING
    assert found.nothing > SURE
    assert found.named is None
    assert not found.one_of


def test_yaw_alone_is_what_a_session_brings() -> None:
    found = judged(np.array([0.0, 0.0, 0.0, 0.07 * UNIT[3]]))
    assert found.hypotheses[0].cause == NOTHING


@pytest.mark.slow
def test_shaking_speaks_for_a_rotor_and_stillness_for_neither() -> None:
    change = of(f"{ROTORS}.loss_2", 0.15)
    quiet, unknown, shaken = (judged(change, shaken=s) for s in (0.0, None, 0.9))
    assert quiet.damaged < unknown.damaged < shaken.damaged
    assert judged(np.zeros(4), shaken=1.2).damaged > 0.5


@pytest.mark.parametrize("fall", [-1.0, -2.0, -4.0])
def test_less_vibration_is_no_damage(fall: float) -> None:
    changed, same = (judged(np.zeros(4), shaken=s) for s in (fall, 0.0))
    assert changed.probability_of(VIBRATION) == same.probability_of(VIBRATION) < 0.05
    assert changed.nothing == same.nothing


def octorotor() -> tuple[Trim, Normal]:
    """Nothing but slopes, of an octorotor whose neighbours turn both ways, in shares of weight,
    arm and reaction torque; three flights before."""
    angles = np.deg2rad(22.5 + 45 * np.arange(8))
    x, y, turns = np.cos(angles), np.sin(angles), np.array([1, 1, -1, -1] * 2)
    losses = np.array([np.ones(8), y, -x, turns]) / 8
    loads = np.array([(1, 0, 0, 0), (0, 0, -1, 0), (0, 1, 0, 0), (0,) * 4], dtype=np.float64).T
    names = (*(f"{ROTORS}.loss_{i + 1}" for i in range(8)), *NAMES[N:])
    trim = Trim(BALANCED, np.zeros((1, 4)), np.hstack([losses, loads]), names, np.zeros(1))
    scatter = dict(zip(BALANCED, DAY.tolist(), strict=True))
    means = dict.fromkeys(BALANCED, 0.0) | {VIBRATION: -1.0}
    hubs = np.column_stack([x, y, np.zeros(8)])
    return trim, Normal(3, means, scatter, 1.0, 1.0, hubs, np.zeros((4, 4)))


@pytest.mark.parametrize(("read", "left"), [(True, ["stuck"]), (False, [VIBRATION, "stuck"])])
def test_vibration_that_the_calibration_had_is_no_change(read: bool, left: list[str]) -> None:
    """Every aircraft shakes: the balance tells whether this one shakes more than before."""
    every = [StochasticEffect(e, o, {}, {}, (), 1.0) for e, o in ((VIBRATION, 9), ("stuck", 5))]
    every += [StochasticEffect("gust", -1.0, {}, {}, (), 1.0)]
    vehicle = calibrated(vibration=read)
    found = Explanation(
        "nothing", vehicle, ("one",), since=FLIGHTS, balance=judged(np.zeros(4), shaken=0.0)
    )
    assert [u.effect for u in explanation._beyond(found, every)] == left
    asked = replace(found, since=None, balance=None)
    assert [u.effect for u in explanation._beyond(asked, every)] == [VIBRATION, "stuck"]


@pytest.mark.slow
@pytest.mark.parametrize(("loss", "told"), [(0.06, False), (0.4, True)])
def test_a_propeller_that_shakes_is_that_of_a_rotor_only_where_the_means_tell_which(
    loss: float, told: bool
) -> None:
    """Damage is sure by the shaking alone; of eight rotors a small loss does not tell which."""
    trim, normal = octorotor()
    change = trim.slopes[:, 2] * loss
    found = balance_of(replace(trim, means=change[None], vibration=np.array([0.5])), normal, SURE)
    assert found.damaged > balance.ALONE
    if told:
        assert found.named is not None
        assert found.named.rotors == (3,)
        assert found.named.probability == found.lost_by(3) >= SURE
        return
    assert found.named is None
    assert max(map(found.lost_by, range(1, 9))) < SURE
    assert {h.cause for h in found.one_of} <= {ROTORS, VIBRATION}
    chances = [h.probability for h in found.one_of]
    assert chances == sorted(chances, reverse=True)
    assert all(h in found.hypotheses for h in found.one_of) and sum(chances) <= 1


@pytest.mark.parametrize("share", [0.2, 0.7, 1.0, 1.5])
def test_a_heavy_load_is_told_in_full(share: float) -> None:
    named = judged(of(f"{LOAD}.mass_kg", share * COPTER.mass_kg)).named
    assert named is not None
    assert named.cause == LOAD
    assert named.values[f"{LOAD}.mass_kg"] == pytest.approx(share * COPTER.mass_kg, rel=0.08)


@pytest.mark.parametrize("loss", [0.3, 0.6, 0.9])
def test_a_rotor_that_hardly_lifts_is_no_load(loss: float) -> None:
    found = judged(of(f"{ROTORS}.loss_2", loss))
    best = found.best(ROTORS)
    assert found.probability_of(ROTORS) > 0.8
    assert best.values[f"{ROTORS}.loss_2"] == pytest.approx(loss, abs=0.04)


# -- mathematics ------------------------------------------------------------------------------


@pytest.mark.slow
def test_evidence_of_one_rotor_is_the_integral_over_its_loss(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With days as the table says, one size: density of a rotor over that of nothing."""
    monkeypatch.setattr(balance, "FACTORS", np.array([1.0]))
    monkeypatch.setattr(balance, "SIZES", ((*SIZES[1][:2], 1.0),))
    change = of(f"{ROTORS}.loss_1", 0.07) + 0.3 * DAY * UNIT
    noise = np.diag((DAY * UNIT) ** 2 * (1 + 1 / 3) + (SESSION * UNIT) ** 2)
    mean, sd, _ = SIZES[1]

    def density(loss: float) -> float:
        left = change - of(f"{ROTORS}.loss_1", loss)
        return float(multivariate_normal(cov=noise).pdf(left) * norm.pdf(loss, mean, sd))

    top = quad(density, mean - 8 * sd, mean + 8 * sd, epsabs=0)[0]
    ratio = top / multivariate_normal(cov=noise).pdf(change) * np.exp(LOG_ODDS) / N
    found = judged(change)
    one = next(h for h in found.hypotheses if h.rotors == (1,))
    assert one.probability / found.nothing == pytest.approx(ratio, rel=1e-6)


@pytest.mark.slow
@settings(max_examples=8, deadline=None)
@given(st.lists(st.floats(0.2, 5.0), min_size=4, max_size=4))
def test_units_and_inertia_are_no_evidence(scale: list[float]) -> None:
    change = of(f"{ROTORS}.loss_3", 0.12) + 0.5 * DAY * UNIT
    plain, scaled = judged(change), judged(change, np.array(scale))
    assert scaled.nothing == pytest.approx(plain.nothing, rel=1e-9)
    assert scaled.probability_of(LOAD) == pytest.approx(plain.probability_of(LOAD), rel=1e-9)
    assert scaled.more == pytest.approx(plain.more)


@pytest.mark.parametrize("row", [0, 3])
def test_a_channel_that_is_missing_is_one_of_which_nothing_is_known(
    monkeypatch: pytest.MonkeyPatch, row: int
) -> None:
    change = of(f"{ROTORS}.loss_3", 0.12) + 0.5 * DAY * UNIT
    kept = [k for k in range(4) if k != row]
    channels = tuple(BALANCED[k] for k in kept)
    less = Trim(channels, change[None, kept], SLOPES[kept], NAMES, np.zeros(0))
    found = balance_of(less, Normal.of(less, calibrated(), True), SURE)
    monkeypatch.setattr(balance, "SESSION", np.where(np.arange(4) == row, 1e4, SESSION))
    known = calibrated().calibration
    assert known is not None
    blind = replace(known, scatter={c: v for c, v in known.scatter.items() if c in channels})
    whole = Trim(BALANCED, change[None], SLOPES, NAMES, np.zeros(0))
    expected = balance_of(whole, Normal.of(whole, replace(COPTER, calibration=blind), True), SURE)
    for cause in (NOTHING, ROTORS, LOAD):
        assert found.probability_of(cause) == pytest.approx(
            expected.probability_of(cause), rel=1e-4
        )
    assert found.probability_of(NOTHING) != pytest.approx(judged(change).nothing, rel=1e-2)


def test_a_place_needs_both_moments_of_the_tilt() -> None:
    pose = ["motion_acc_z", "motion_rate_x", "motion_rate_y", "motion_rate_z"]
    assert channels_of_balance(pose) == tuple(pose)
    assert channels_of_balance(pose[:3]) == tuple(pose[:3])
    assert channels_of_balance(pose[1:]) == tuple(pose[1:])
    for k in (1, 2):
        assert channels_of_balance(pose[:k] + pose[k + 1 :]) is None


@pytest.mark.slow
def test_probabilities_are_true_of_what_is_drawn_from_the_model() -> None:
    """300 changes of causes drawn by their odds: what is given 80 % is right in 80 %."""
    rng = np.random.default_rng(3)
    trim = Trim(BALANCED, np.zeros((1, 4)), SLOPES, NAMES, np.zeros(0))
    competition = balance._Competition(trim, Normal.of(trim, calibrated(), True))
    p, hit = [], []
    for _ in range(300):
        odds = np.exp([0.0, LOG_ODDS, LOG_ODDS])
        cause = rng.choice([NOTHING, ROTORS, LOAD], p=odds / odds.sum())
        mean, sd, _ = SIZES[rng.choice(len(SIZES), p=[p for *_, p in SIZES])]
        change = np.zeros(4)
        if cause == ROTORS:
            change = of(f"{ROTORS}.loss_{rng.integers(N) + 1}", rng.normal(mean, sd))
        elif cause == LOAD:
            kg = rng.normal(mean, sd) * COPTER.mass_kg / 2
            x, y, _ = COPTER.rotors.position_m[rng.integers(N)]
            parts = {"mass_kg": kg, "moment_x_kg_m": kg * x, "moment_y_kg_m": kg * y}
            change = np.sum([of(f"{LOAD}.{k}", v) for k, v in parts.items()], axis=0)
        spread = UNIT * np.hypot(DAY * np.sqrt(1 + 1 / 3), SESSION)
        chance = dict.fromkeys((NOTHING, ROTORS, LOAD), 0.0)
        for h in competition.weigh(change + spread * rng.standard_normal(4)):
            chance[h.cause] += h.probability
        first = max(chance, key=lambda c: chance[c])
        p.append(chance[first])
        hit.append(first == cause)
    assert np.mean(p) == pytest.approx(np.mean(hit), abs=0.08)


@pytest.mark.slow
def test_the_smallest_change_is_where_nothing_is_no_longer_said() -> None:
    found = judged(np.zeros(4))
    for cause, most in ((ROTORS, 1.0), (LOAD, COPTER.mass_kg)):
        value = found.detectable[cause].value
        assert value is not None
        assert 0.02 * most < value < 0.5 * most
    loss = found.detectable[ROTORS].value
    assert loss is not None
    assert judged(of(f"{ROTORS}.loss_1", loss)).nothing < 1 - SURE


@pytest.mark.parametrize(
    ("chance", "named", "ways"),
    [
        (0.01, LOAD, []),
        (0.3, None, [LOAD, "hung"]),
        (0.6, None, ["hung", LOAD]),
        (0.97, "hung", []),
    ],
)
def test_a_load_is_fixed_or_hangs(chance: float, named: str | None, ways: list[str]) -> None:
    found = judged(of(f"{LOAD}.mass_kg", 0.3 * COPTER.mass_kg))
    assert found.named is not None and found.named.cause == LOAD
    hanging = Hypothesis("hung", (), chance, {"hung.mass_kg": 0.4}, {"hung.mass_kg": 0.02})
    asked = replace(found, hanging=hanging)
    assert (asked.named and asked.named.cause) == named
    assert [h.cause for h in asked.one_of] == ways
    both = sum(h.probability for h in asked.one_of)
    assert not ways or both == pytest.approx(found.named.probability)
    weak = replace(judged(of(f"{ROTORS}.loss_1", 0.4)), hanging=hanging)
    assert not {h.cause for h in weak.one_of} & {"hung"}


def test_nothing_is_said_as_surely_as_a_name() -> None:
    balance = judged(np.zeros(4))
    for nothing, quiet in ((balance.sure + 1e-9, True), (balance.sure - 1e-9, False)):
        chance = dict(zip((NOTHING, ROTORS, LOAD), (nothing, 1 - nothing, 0.0), strict=True))
        told = tuple(replace(balance.best(c), probability=p) for c, p in chance.items())
        found = replace(balance, hypotheses=told)
        assert (found.nothing >= found.sure) == quiet
        naming = cast(Naming, SimpleNamespace(verdict="nothing"))
        assert explanation._verdict(naming, found, ()) == ("nothing" if quiet else "cannot_tell")


# -- equations ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("verdict", "searched", "nothing", "asked"),
    [
        ("named", "cannot_tell", 0.0, False),  # a load, by the balance alone
        ("cannot_tell", "cannot_tell", 0.1, False),  # a rotor or a load
        ("cannot_tell", "cannot_tell", 1 - SURE - 1e-9, False),
        ("cannot_tell", "cannot_tell", 1 - SURE + 1e-9, True),  # undecided
        ("cannot_tell", "cannot_tell", 0.5, True),
        ("cannot_tell", "cannot_tell", SURE - 1e-9, True),
        ("nothing", "nothing", 0.9, False),
        ("cannot_tell", "cannot_tell", 0.9, True),
    ],
)
def test_equations_overrule_no_change_of_the_balance(
    monkeypatch: pytest.MonkeyPatch,
    verdict: Verdict,
    searched: Verdict,
    nothing: float,
    asked: bool,
) -> None:
    """A load that doubles the weight is an equation in the thrust as well."""
    seen: list[bool] = []
    monkeypatch.setattr(explanation, "_stands", lambda _: None)
    monkeypatch.setattr(explanation, "find_equations", lambda *_, **__: seen.append(True))
    rest = SimpleNamespace(channels=())
    problem = SimpleNamespace(noise=SimpleNamespace(mute=()), rest=rest)
    best = SimpleNamespace(effects=())
    naming = SimpleNamespace(verdict=searched, best=best, whitened=None, problem=problem)
    balance = replace(judged(np.zeros(4)), sure=SURE)
    found_by = dict(zip((NOTHING, ROTORS, LOAD), (nothing, *[(1 - nothing) / 2] * 2), strict=True))
    hypotheses = tuple(replace(balance.best(c), probability=p) for c, p in found_by.items())
    found = Explanation(
        verdict,
        COPTER,
        ("one",),
        naming=cast(Any, naming),
        since=FLIGHTS,
        balance=replace(balance, hypotheses=hypotheses),
    )
    assert explanation._with_equations(found, 0) is found
    assert bool(seen) == asked
