"""Wind and the balance: a wind that is known names no rotor and no load."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from twin.effects import EFFECTS
from twin.explain import explanation
from twin.explain.balance import CAUSES, Balance, Normal, balance_of, trim_of
from twin.explain.explanation import Explanation
from twin.explain.inference.estimate import fitted_estimates
from twin.explain.inference.fit import INTERVAL, Fit
from twin.explain.inference.priors import priors_since
from twin.explain.inference.selection import coherent, misfits
from twin.explain.model.model import Model, model_of
from twin.explain.stochastic.spectral import StochasticEffect
from twin.explain.weather import OF_AIR, acting_of, uncertain
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
    ((value, sd),) = acting_of(fit).values()
    assert value == 4.0
    assert sd == pytest.approx(0.6)


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
