"""Every effect of the library, planted at its start value on a flight that has every column: it has
a slope, and explains itself better than any other does that is large enough for a name. On this
flight no two look alike.

Commands are recorded at 200 Hz and held: they come 2.5 ms late, which a small `flapping_moment`
takes up, since no delay is negative. It is a tenth of what is worth a name.

Clocks that are apart explain every delay of the aircraft: which of the two it is, priors alone say,
and no single flight.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from search_rigs.hypotheses import fit_set
from search_rigs.hypotheses import problem_of as problem_about

from twin.effects import EFFECTS, Equation, Shift
from twin.explain.design.manoeuvres import Manoeuvre, plan
from twin.explain.design.rehearsal import rehearse
from twin.explain.inference.beliefs import effect_of
from twin.explain.inference.fit import worth_a_name
from twin.explain.inference.refit import Problem
from twin.explain.inference.selection import days_of
from twin.explain.model.flight import FlightModel
from twin.explain.model.model import Model, candidates
from twin.explain.model.numbers import Number, columns_of, numbers_of, numbers_of_logs
from twin.explain.model.prediction import Physics
from twin.logs import Flight
from twin.logs.columns import COLUMNS
from twin.physics.airframe import airframe
from twin.vehicle.file import load_vehicle

Array = NDArray[np.float64]
CRAZYFLIE = load_vehicle("crazyflie")
VEHICLE = replace(CRAZYFLIE, drag_linear_n_s_m=0.25 * CRAZYFLIE.mass_kg * np.ones(3))
"""With a battery, whose current couples into the compass, and with a drag that feels the wind."""
VOLTAGE = 0.92
"""Of a charged battery: what depends on the voltage shows."""
NOISE = {
    "acc": 0.05,
    "gyro": 0.003,
    "mag": 1e-7,
    "baro": 1.0,
    "pos": 1e-3,
    "vel": 5e-3,
    "q": 3e-4,
}
TRIED = 3
"""Rivals that are fitted: those that gain most by the first, linear look."""
PLANTED = {
    "rotor_efficiency_loss": {"loss_1": 0.1},
    "cog_offset": {"x_m": 0.02 * CRAZYFLIE.arm_m},
    "battery_sag": {"slope": 0.8},
    "clock_offset": {"accelerometer_s": -0.04},
    "pose_smoothing": {"attitude_s2": 9e-4},
}
"""Numbers where the start values are no effect at all, or too much for this flight."""


DAILY = ("steady_wind", "cog_offset", "accel_bias", "heading_offset", "baro_bias")
"""Effects that differ from day to day, by the constant that they are: one flight alone says that
they are there on its day, and nothing of the aircraft."""
LEAST = 5.0
"""Nats by which an effect explains itself."""


def shaken(t: Array) -> Array:
    """To and fro, up and down, the nose left and right, and a while close to the ground."""
    ramp = np.sin(np.pi * np.clip(t / 16.0, 0, 1)) ** 2
    dip = np.exp(-(((t - 11.0) / 1.5) ** 4))
    wave = 2 * np.pi * t
    return np.column_stack(
        [
            ramp * (0.7 * np.sin(0.25 * wave) + 0.15 * np.sin(0.9 * wave)),
            ramp * (0.6 * np.cos(0.21 * wave) + 0.15 * np.sin(0.8 * wave)),
            ramp * 0.25 * np.sin(0.4 * wave) * (1 - dip) + 0.3 * dip,
            ramp * (1.0 * np.sin(0.2 * wave) + 0.5 * np.sin(0.7 * wave)),
        ]
    )


@cache
def blank() -> Flight:
    """A flight that has every column at 200 Hz, but for rotor speeds."""
    names = [
        c.name.replace("{i}", str(i))
        for c in COLUMNS
        for i in (range(1, 5) if c.per_motor else (0,))
        if c.name not in ("time", "phase") and not c.name.startswith("rotor_")
    ]
    time = np.arange(400) / 200
    return Flight("blank", pd.DataFrame({"time": time} | dict.fromkeys(names, VEHICLE.voltage_v)))


def flown(effect: str) -> Flight:
    """The vehicle with an effect, recorded with noise."""
    numbers = EFFECTS[effect].starts(VEHICLE) | PLANTED.get(effect, {})
    plant = VEHICLE.with_effects({effect: numbers})
    rich = plan(VEHICLE, [Manoeuvre("rich", "", 16.0, shaken)])
    flight = rehearse(rich, VEHICLE, plant, [blank()], VOLTAGE)
    table, rng = flight.table, np.random.default_rng(7)
    for column in table:
        size = NOISE.get(str(column).rpartition("_")[0])
        if size:
            table[column] += size * rng.standard_normal(len(table))
    assert table["time"].iloc[-1] > 15, f"{effect}: lost at {table['time'].iloc[-1]:.1f} s"
    return flight


@cache
def library() -> tuple[Physics, tuple[Number, ...], tuple[str, ...], tuple[str, ...]]:
    """Prediction, numbers, effects in the equations, and all effects that change a mean."""
    effects = candidates([blank()])
    numbers = (*numbers_of_logs(effects, VEHICLE), *numbers_of(effects, VEHICLE))
    standing = tuple(e.name for e in effects if isinstance(e.seen_as, Equation))
    body = airframe(VEHICLE, "command", standing)
    physics = Physics(body, VEHICLE, standing, numbers)
    return physics, numbers, standing, tuple(e.name for e in effects)


def problem_of(flight: Flight) -> Problem:
    physics, numbers, standing, names = library()
    made = FlightModel(flight, VEHICLE, physics, standing, numbers)
    return problem_about(Model(VEHICLE, names, numbers, (made,)))


def likely(problem: Problem) -> list[str]:
    """Single effects by what they gain where the model as it stands is linear, the best first."""
    judge, gains = problem.judge(problem.rest), {}
    for e in problem.model.effects:
        causes = [c for c in problem.beliefs.causes if effect_of(c) == e]
        gains[e] = judge.best(causes, 1.0).evidence
    return sorted(gains, key=lambda e: -gains[e])


def test_the_flight_shows_every_effect_that_changes_a_mean() -> None:
    _, _, _, names = library()
    assert {*names} == {e.name for e in candidates([blank()])}
    others = {type(EFFECTS[e].seen_as).__name__ for e in EFFECTS if e not in names}
    assert others == {"NoiseFloor", "Lines", "RandomForce", "Repeats"}  # see test_unsteady


@pytest.mark.slow
@pytest.mark.parametrize("effect", [e.name for e in candidates([blank()]) if e.name not in DAILY])
def test_an_effect_is_the_best_single_explanation_of_itself(effect: str) -> None:
    problem = problem_of(flown(effect))
    own = columns_of(problem.model.numbers, [effect])
    (rows,) = problem.model.channels(own)
    assert any(np.any(c.slopes) for c in rows), f"{effect}: slope 0"
    of_clocks = isinstance(EFFECTS[effect].seen_as, Shift) and EFFECTS[effect].of_vehicle
    rivals = [e for e in likely(problem) if EFFECTS[e].of_vehicle or not of_clocks]
    fits = {e: fit_set(problem, [e]) for e in {*rivals[:TRIED], effect}}
    named = [e for e, f in fits.items() if e in worth_a_name(f)]
    best = max(named, key=lambda e: fits[e].gain, default=None)
    gains = {e: round(f.gain, 1) for e, f in sorted(fits.items(), key=lambda f: -f[1].gain)}
    assert fits[effect].gain > LEAST, f"{effect} explains nothing of itself: {gains}"
    assert best == effect, gains


@pytest.mark.slow
@pytest.mark.parametrize("effect", DAILY)
def test_a_constant_of_the_day_is_told_of_its_flight(effect: str) -> None:
    problem = problem_of(flown(effect))
    (told,) = days_of(problem, problem.start((), 1.0).best).values()
    numbers = EFFECTS[effect].starts(VEHICLE) | PLANTED.get(effect, {})
    known = {f"{effect}.{p.name}": p for p in EFFECTS[effect].parameters}
    planted = {n for n, p in known.items() if numbers[p.name] != p.neutral}
    assert planted & {*told}, told
    for name in planted & {*told}:
        value, sd = told[name]
        assert value == pytest.approx(numbers[name.partition(".")[2]], abs=4 * sd), name
