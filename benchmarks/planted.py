"""Every effect of the library, planted on a flight that shows it: for tests and for pictures.

Effects that change a mean are flown by our own airframe with the effect, along one flight that is
rich enough for all of them. The others come from the plants of the benchmark of hidden effects.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from twin.effects import EFFECTS, Equation, Repeats
from twin.errors import TwinError
from twin.explain.holdout import Attribution, attribute_effect
from twin.explain.model.model import FlightModel, Model, candidates, model_of
from twin.explain.model.numbers import Number, numbers_of, numbers_of_logs
from twin.explain.model.prediction import Physics
from twin.explain.stochastic.search import (
    find_stochastic,
    find_stuck,
    stuck_channels,
    without_stuck,
)
from twin.explain.stochastic.spectral import StochasticEffect
from twin.flight.manoeuvres import Manoeuvre, plan, rehearse
from twin.logs import Flight
from twin.logs.columns import COLUMNS
from twin.physics.airframe import airframe
from twin.residuals.channels import ChannelData
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle, parse_vehicle

from .hidden_effects.cases import Case
from .hidden_effects.produce import produce

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
PLANTED = {
    "rotor_efficiency_loss": {"loss_1": 0.1},
    "cog_offset": {"x_m": 0.02 * CRAZYFLIE.arm_m},
    "battery_sag": {"slope": 0.8},
    "clock_offset": {"accelerometer_s": -0.04},
    "pose_smoothing": {"attitude_s2": 9e-4},
}
"""Numbers where the start values are no effect at all, or too much for this flight."""


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


def planted_numbers(effect: str) -> dict[str, float]:
    """Numbers of an effect as it is planted."""
    return EFFECTS[effect].starts(VEHICLE) | PLANTED.get(effect, {})


def flown(effect: str) -> Flight:
    """The vehicle with an effect, recorded with noise."""
    numbers = planted_numbers(effect)
    plant = VEHICLE.with_effects({effect: numbers})
    rich = plan(VEHICLE, [Manoeuvre("rich", "", 16.0, shaken)])
    flight = rehearse(rich, VEHICLE, plant, [blank()], VOLTAGE)
    table, rng = flight.table, np.random.default_rng(7)
    for column in table:
        size = NOISE.get(str(column).rpartition("_")[0])
        if size:
            table[column] += size * rng.standard_normal(len(table))
    lost = float(table["time"].iloc[-1])
    if lost <= 15:
        raise TwinError(f"{effect}: the flight was lost at {lost:.1f} s.")
    return flight


@cache
def library() -> tuple[Physics, tuple[Number, ...], tuple[str, ...], tuple[str, ...]]:
    """Prediction, numbers, effects in the equations, and all effects that change a mean."""
    effects = candidates([blank()])
    numbers = (*numbers_of_logs(effects, VEHICLE), *numbers_of(effects, VEHICLE))
    standing = tuple(e.name for e in effects if isinstance(e.observable_as, Equation))
    body = airframe(VEHICLE, "command", standing)
    physics = Physics(body, VEHICLE, standing, numbers)
    return physics, numbers, standing, tuple(e.name for e in effects)


def model_of_library(flight: Flight) -> Model:
    """A flight against the vehicle, with all effects that change a mean."""
    physics, numbers, standing, names = library()
    made = FlightModel(flight, VEHICLE, physics, standing, numbers)
    return Model(VEHICLE, names, numbers, (made,))


@dataclass(frozen=True, slots=True)
class Shown:
    """A planted effect on its flight.

    Attributes:
        acts: Where it acts.
        model: The flight against the vehicle without it.
        with_it: Channels with it.
    """

    acts: Attribution
    model: Model
    with_it: Sequence[Sequence[ChannelData]]


def shown(effect: str, model: Model) -> Shown:
    """An effect that changes a mean, at the numbers that were planted.

    Args:
        effect: Identifier.
        model: Its flight against the vehicle, of `model_of_library(flown(effect))`.
    """
    values: Mapping[str, float] = {f"{effect}.{k}": v for k, v in planted_numbers(effect).items()}
    with_it = model.channels([], values)
    return Shown(attribute_effect(effect, model, values, with_it), model, with_it)


@dataclass(frozen=True, slots=True)
class Unsteady:
    """A planted effect that changes no mean, as it is found.

    Attributes:
        found: The effect.
        flight: As recorded.
        residuals: Its channels against the vehicle; none of a reading that stands still.
        vehicle: Without it.
    """

    found: StochasticEffect
    flight: Flight
    residuals: Sequence[ChannelData]
    vehicle: Vehicle


def unsteady(effect: str) -> Unsteady:
    """An effect that changes no mean, planted large in the benchmark's own plant."""
    case = Case("own", "single", (effect,), "large", "medium", 0)
    (made,) = produce([case])
    vehicle = parse_vehicle(made.vehicle, case.id)
    name, table = list(made.flights.items())[-1]
    flight = Flight(name, table)
    stuck = stuck_channels(flight)
    found = find_stuck(stuck)
    residuals: Sequence[ChannelData] = ()
    if not isinstance(EFFECTS[effect].observable_as, Repeats):
        model = model_of([without_stuck(flight, stuck)], vehicle, candidates([flight]))
        found, residuals = find_stochastic(model, {}), model.channels([])[0]
    own = next((u for u in found if u.effect == effect), None)
    if own is None:
        raise TwinError(f"{effect}: planted and not found in {name}.")
    return Unsteady(own, flight, residuals, vehicle)
