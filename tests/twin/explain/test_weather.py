"""Wind and the balance: a wind that is known names no rotor and no load."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from twin.effects import EFFECTS
from twin.explain import explanation
from twin.explain.balance import (
    BALANCED,
    CAUSES,
    ROPE,
    Balance,
    Hypothesis,
    Normal,
    balance_of,
    trim_of,
)
from twin.explain.explanation import Explanation
from twin.explain.inference.adequacy import coherent, misfits
from twin.explain.inference.estimate import fitted_estimates
from twin.explain.inference.fit import INTERVAL, Fit, Problem
from twin.explain.inference.posterior import Posterior
from twin.explain.inference.priors import priors_since
from twin.explain.inference.selection import Naming, since_problem
from twin.explain.model.model import Model, model_of
from twin.explain.stochastic.spectral import StochasticEffect
from twin.explain.weather import (
    OF_AIR,
    STRONG,
    Wind,
    acting_of,
    hanging_of,
    uncertain,
    wind_of,
)
from twin.logs import Flight
from twin.vehicle import Calibration, Vehicle
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import Waypoints, fly

Array = NDArray[np.float64]
COPTER = load_vehicle("copter_default")
LEGS: Waypoints = (
    ("takeoff", 2.0, (0.0, 0.0, -1.5)),
    ("forward", 2.0, (2.0, 0.0, -1.5)),
    ("forward", 2.0, (0.0, 0.0, -1.5)),
)
DRAG = {"k_xy_1_s": 0.4, "k_z_1_s": 0.0, "spin_share": 1.0}
FILE = COPTER.with_effects({"rotor_drag": {**DRAG, "height_m": 0.0}})
PLANT = COPTER.with_effects({"rotor_drag": {**DRAG, "height_m": 0.03}})
"""Its drag attacks higher than the file says, which no flight in calm air shows in a mean."""
WIND = "steady_wind"
AIR_M_S = 6.0
BLOWS = {f"{WIND}.north_m_s": (AIR_M_S, 0.4), f"{WIND}.east_m_s": (0.0, 0.4)}


def flown(air_m_s: float, seed: int, plant: Vehicle = PLANT) -> Flight:
    """To and fro in a wind from the south."""
    wind = {WIND: {"north_m_s": air_m_s, "east_m_s": 0.0, "down_m_s": 0.0}} if air_m_s else {}
    flying = plant.with_effects({**plant.effects, **wind})
    return fly(COPTER, flying, seed, f"{air_m_s:g}", LEGS)


def modelled(vehicle: Vehicle, flights: list[Flight]) -> Model:
    return model_of(flights, vehicle, [EFFECTS[e] for e in (*CAUSES, WIND, *OF_AIR)])


@cache
def calibrated() -> Vehicle:
    """The file with the balance of three calm flights, and what they said of the drag."""
    trim = trim_of(modelled(FILE, [flown(0.0, seed) for seed in (1, 2, 3)]), slopes=False)
    assert trim is not None
    known = ("rotor_drag.height_m",), np.array([[0.02**2]])
    return replace(
        FILE, calibration=Calibration(("a", "b", "c"), *known, {}, {}, {}, *trim.by_name())
    )


@cache
def windy() -> Model:
    return modelled(calibrated(), [flown(AIR_M_S, 7)])


def judged(model: Model, wind: dict[str, tuple[float, float]], wide: bool) -> Balance:
    trim = trim_of(model, {n: v for n, (v, _) in wind.items()})
    assert trim is not None
    normal = Normal.of(trim, calibrated(), indoors=True)
    if wide:
        normal = replace(normal, disturbed=uncertain(model, trim.channels, wind))
    return balance_of(trim, normal, 0.8)


@pytest.mark.slow
def test_a_wind_that_is_known_names_no_rotor_and_no_load() -> None:
    deaf, half, told = (
        judged(windy(), *how) for how in (({}, False), (BLOWS, False), (BLOWS, True))
    )
    assert deaf.changed > 0.8  # a wind that is taken for none is a rotor, or a load
    assert half.changed > 0.8  # and so is a drag that attacks elsewhere than the file says
    assert told.nothing > 0.8


@pytest.mark.slow
def test_a_load_shows_in_a_wind_that_is_known() -> None:
    heavy = replace(PLANT, mass_kg=2.0 * PLANT.mass_kg)
    wind = {WIND: {"north_m_s": AIR_M_S, "east_m_s": 0.0, "down_m_s": 0.0}}
    flying = heavy.with_effects({**heavy.effects, **wind})
    flight = fly(replace(COPTER, mass_kg=heavy.mass_kg), flying, 7, "loaded", LEGS)
    named = judged(modelled(calibrated(), [flight]), BLOWS, True).named
    assert named is not None
    assert named.cause == "payload_cg"
    mass, sd = (v["payload_cg.mass_kg"] for v in (named.values, named.deviations))
    assert mass == pytest.approx(PLANT.mass_kg, rel=0.3)
    assert 0.05 * PLANT.mass_kg < sd < 0.3 * PLANT.mass_kg  # what a wind lifts is not known


@pytest.mark.slow
def test_a_load_on_a_rope_that_is_known_is_no_payload_as_well() -> None:
    hung = {"mass_kg": 0.3 * PLANT.mass_kg, "length_m": 0.5}
    flying = PLANT.with_effects({**PLANT.effects, "slung_load": hung})
    payload = replace(flying, mass_kg=1.5 * PLANT.mass_kg)
    effects = [EFFECTS[e] for e in (*CAUSES, WIND, *OF_AIR, "slung_load")]
    swinging, both = (
        model_of(
            [fly(replace(COPTER, mass_kg=v.mass_kg), v, 7, "hung", LEGS)], calibrated(), effects
        )
        for v in (flying, payload)
    )
    rope = {f"slung_load.{n}": (v, 0.05 * v) for n, v in hung.items()}
    assert judged(swinging, {}, False).probability_of("payload_cg") > 0.8
    told = judged(swinging, rope, True)
    assert told.nothing > 0.8
    named = judged(both, rope, True).named
    assert named is not None
    assert named.cause == "payload_cg"
    assert named.values["payload_cg.mass_kg"] == pytest.approx(0.5 * PLANT.mass_kg, rel=0.3)


@pytest.mark.slow
def test_only_what_the_wind_changes_is_uncertain() -> None:
    calm = {n: (0.0, 1e-6) for n in BLOWS}
    trim = trim_of(windy())
    assert trim is not None
    still, windier = (uncertain(windy(), trim.channels, w) for w in (calm, BLOWS))
    assert np.all(np.abs(still) < 1e-6 * np.abs(windier).max())
    pitch = trim.channels.index("gyro_rate_y")
    drag = DRAG["k_xy_1_s"] * AIR_M_S * PLANT.mass_kg / PLANT.inertia_kg_m2[1, 1]
    assert "slung_load" not in OF_AIR  # may be there or not, and is no doubt about the air
    assert windier[pitch, pitch] > (0.9 * 0.02 * drag) ** 2  # height of the drag, 20 mm


def test_the_wind_of_a_search_has_its_deviation() -> None:
    number = next(n for n in windy().numbers if n.full == f"{WIND}.north_m_s")
    fit = Fit((WIND,), {number.full: 4.0}, (number,), np.array([0.6 * INTERVAL]), 0.0)
    ((value, sd),) = acting_of(fit, ()).values()
    assert value == 4.0
    assert sd == pytest.approx(0.6)


def test_a_load_on_a_rope_acts_where_it_is_named() -> None:
    number = replace(next(n for n in windy().numbers if n.shape), effect="slung_load")
    fit = Fit(("slung_load",), {number.full: 0.5}, (number,), np.array([0.1]), 0.0)
    assert not acting_of(fit, ())
    assert set(acting_of(fit, ("slung_load",))) == {number.full}


USUAL_M_S = 1.0


def blown(*sets: tuple[float, float, float]) -> Wind:
    """Wind of one flight, of sets with a probability, a change to the north, and a day's."""
    names = (f"{WIND}.north_m_s", f"{WIND}.east_m_s")
    priors = SimpleNamespace(names=names, days=np.array([0, 1]), now=np.array([0.5, 0.0]))
    known = SimpleNamespace(days=dict.fromkeys(names, USUAL_M_S))
    vehicle = SimpleNamespace(calibration=known)
    problem = SimpleNamespace(
        priors=priors, model=SimpleNamespace(vehicle=vehicle, flights=("one",))
    )
    each = [
        SimpleNamespace(
            probability=p,
            best=SimpleNamespace(
                x=np.array([change, 0.0, day, 0.0]),
                variance=lambda row: 0.01 if row[0] == row[2] == 1 or row[1] == row[3] == 1 else 99,
            ),
        )
        for p, change, day in sets
    ]
    found = wind_of(cast(Problem, problem), cast(Posterior, SimpleNamespace(sets=each)))
    assert found is not None
    return found


def test_a_wind_is_as_strong_of_the_day_as_of_a_change() -> None:
    for sets in ([(1.0, 0.0, 4.0)], [(1.0, 4.0, 0.0)], [(0.4, 0.0, 4.0), (0.6, 3.0, 1.0)]):
        found = blown(*sets)
        assert found.stronger == pytest.approx(1.0)
        assert found.change[f"{WIND}.north_m_s"] == pytest.approx((4.0, 0.1))
        assert found.values[f"{WIND}.north_m_s"] == pytest.approx((4.5, 0.1))


def test_a_wind_as_on_any_day_is_no_change() -> None:
    assert blown((1.0, 0.0, 1.5)).stronger < 1e-3
    assert blown((1.0, 0.0, STRONG * USUAL_M_S)).stronger == pytest.approx(0.5)
    assert blown((0.7, 0.0, 4.0), (0.3, 0.0, 1.0)).stronger == pytest.approx(0.7)


@pytest.mark.parametrize(
    ("stronger", "searched", "named"), [(0.9, (), True), (0.7, (), False), (0.9, (WIND,), False)]
)
def test_a_strong_wind_is_named_once(
    stronger: float, searched: tuple[str, ...], named: bool
) -> None:
    naming = SimpleNamespace(settings=SimpleNamespace(sure=0.8), named=searched)
    change = {f"{WIND}.north_m_s": (4.0, 0.2)}
    found = explanation._with_wind(
        Explanation("nothing", FILE, ("one",)), cast(Naming, naming), Wind(change, {}, stronger)
    )
    assert bool(found.stochastic) == named
    if named:
        (wind,) = found.stochastic
        assert wind.values[f"{WIND}.north_m_s"] == 4.0
        assert wind.probability == pytest.approx(0.9)


def hung(effects: tuple[str, ...], plant: Vehicle, kg: float) -> Hypothesis:
    """A load of a flight, of known mass, as one on a rope."""
    every = [EFFECTS[e] for e in (*CAUSES, WIND, *effects)]
    flight = fly(replace(COPTER, mass_kg=PLANT.mass_kg + kg), plant, 5, "load", LEGS)
    problem = since_problem(model_of([flight], calibrated(), every), apart=CAUSES, silent=BALANCED)
    first = SimpleNamespace(effects=(), best=problem.start((), 1.0).best)
    naming = SimpleNamespace(problem=problem, posterior=SimpleNamespace(sets=[first]))
    places = {f"payload_cg.moment_{a}_kg_m": 0.0 for a in "xyz"}
    values, widths = ({"payload_cg.mass_kg": m, **places} for m in (kg, 0.1 * kg))
    return hanging_of(cast(Naming, naming), Hypothesis("payload_cg", (), 1.0, values, widths))


@pytest.mark.slow
def test_a_load_hangs_as_far_as_its_swing_says_so() -> None:
    kg, rope_m = 0.25 * PLANT.mass_kg, 0.9
    rope = {"slung_load": {"mass_kg": kg, "length_m": rope_m}}
    swings = PLANT.with_effects({**PLANT.effects, **rope})
    fixed = replace(PLANT, mass_kg=PLANT.mass_kg + kg)
    blind = hung((), swings, kg)
    assert blind.probability == pytest.approx(1 / (1 + np.exp(-ROPE)))
    assert blind.values == {"slung_load.mass_kg": kg}
    found = hung(("slung_load",), swings, kg)
    assert found.probability > 0.95
    assert found.values["slung_load.length_m"] == pytest.approx(rope_m, rel=0.2)
    assert hung(("slung_load",), fixed, kg).probability < 0.05


def test_a_number_that_a_calibration_does_not_move_is_told_by_its_prior() -> None:
    """As the voltage in hover of `battery_sag`: part of an effect whose other numbers may move."""
    numbers = tuple(n for n in windy().numbers if n.effect == "rotor_drag")
    values, widths = {n.full: n.now for n in numbers}, np.zeros(len(numbers))
    priors = priors_since(windy())
    assert {*priors.slab[priors.of(["rotor_drag"])]} == {0.0, 0.02}
    found = fitted_estimates(
        Fit(("rotor_drag",), values, numbers, widths, 0.0), priors, "rotor_drag"
    )
    share = {e.number.name: e.prior_share for e in found}
    assert share.pop("height_m") == 0.0
    assert set(share.values()) == {1.0}
    assert {e.tension for e in found} == {0.0}


@pytest.mark.slow
def test_what_normal_flights_leave_is_no_fault_of_a_cause() -> None:
    number = next(n for n in windy().numbers if n.full == f"{WIND}.north_m_s")
    none = {WIND: Fit((), {}, (), np.zeros(0), 0.0)}

    def left(speed_m_s: float, usual: dict[str, float]) -> float:
        """Share that a wind leaves."""
        fit = Fit((WIND,), {number.full: speed_m_s}, (number,), np.zeros(1), 0.0)
        return misfits(windy(), fit, none, usual=usual)[WIND]

    half = left(0.5 * AIR_M_S, {})
    assert half > left(AIR_M_S, {})
    (flight,) = windy().channels([], {number.full: 0.5 * AIR_M_S})
    rms = {c.name: coherent([c])[0] ** 0.5 for c in flight}
    less = left(0.5 * AIR_M_S, {c: 0.6 * v for c, v in rms.items()})
    assert 0.5 * half < less < 0.8 * half  # noise that stands out by chance is taken off, too
    assert left(0.5 * AIR_M_S, rms) == 0.0


def test_missions_are_flown_in_calm_air(monkeypatch: pytest.MonkeyPatch) -> None:
    """A wind that the flights had is no fault of the model."""
    flying: list[Vehicle] = []

    def noted(vehicle: Vehicle, *_: object) -> tuple[()]:
        flying.append(vehicle)
        return ()

    monkeypatch.setattr(explanation, "fly_missions", noted)
    values = {f"{WIND}.{a}_m_s": v for a, v in (("north", 9.0), ("east", 0.0), ("down", 0.0))}
    wind = StochasticEffect(WIND, 5.0, values, {}, (), 1.0)
    found = Explanation("named", FILE, ("one",), stochastic=(wind,), values=values)
    assert found.added is not None and WIND in found.added.effects
    explanation._with_missions(found, None, lambda _: None)
    assert [set(v.effects) for v in flying] == [{"rotor_drag"}]
