"""What to fly next: the manoeuvre in which two explanations, alike so far, part the most.

Each of the two is taken for the truth in turn: the twin with its effects flies every manoeuvre in
closed loop. The other one, with its numbers free to move as far as the flights so far allow, then
predicts the same readings. What is left between the predictions, in the whitened metric of the
search, is the log likelihood by which the truth will lead on average; noise adds nothing to that,
so none is drawn. Both predictions are those of `FlightModel`, so what the grid costs in accuracy
cancels.

Source: discrimination between rival models, Hunter & Reiner, Technometrics 7 (1965); Atkinson &
Fedorov, Biometrika 62 (1975).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...effects import EFFECTS
from ...errors import TwinError
from ...logs import Flight
from ...representation import short_repr
from ...residuals.channels import ChannelData
from ...vehicle import Vehicle
from ..inference.evidence import Factored, best_inside
from ..inference.fit import Fit
from ..inference.selection import Naming
from ..inference.whitening import Block, blocks_of
from ..model.model import Model, model_of
from ..model.numbers import Number, columns_of, with_effects
from ..model.payload import carrying
from ..settings import DEFAULT, DesignSettings
from .manoeuvres import Manoeuvre, manoeuvres, plan
from .rehearsal import rehearse, volts_of

Array = NDArray[np.float64]
SHAPE_STEP = 0.03
"""Relative step by which a shape is moved for its slope."""


@dataclass(frozen=True, slots=True)
class Suggestion:
    """A manoeuvre that separates two sets of effects.

    Attributes:
        manoeuvre: Identifier.
        description: What a pilot can follow.
        separates: The two sets, the more probable first; an empty one: nothing is missing.
        separation: Log likelihood by which the true one is expected to lead, mean over both.
        present: The same in the flights so far.
    """

    manoeuvre: str
    description: str
    separates: tuple[tuple[str, ...], tuple[str, ...]]
    separation: float
    present: float

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class Held:
    """What holds the numbers of an explanation near their values.

    Attributes:
        precision: Of flights so far and priors, shape (k, k).
        low: Largest steps down, shape (k,).
        high: Largest steps up, shape (k,).
    """

    precision: Array
    low: Array
    high: Array


def next_manoeuvre(
    naming: Naming,
    vehicle: Vehicle,
    seed: int = 0,
    progress: Callable[[float], None] = lambda _: None,
    settings: DesignSettings = DEFAULT.design,
) -> Suggestion | None:
    """The manoeuvre that separates the two leading explanations best.

    Args:
        naming: What the flights so far say.
        vehicle: The model as it stands.
        seed: Not used: nothing is drawn.
        progress: Called with the share done.
        settings: Sizes of manoeuvres, and what is enough.

    Returns:
        None where the name is sure, or where no manoeuvre of the list would help.
    """
    if naming.sure:
        return None
    best = suggestions(naming, vehicle, progress=progress, settings=settings)[0]
    return best if best.separation >= settings.enough else None


def suggestions(
    naming: Naming,
    vehicle: Vehicle,
    among: Sequence[str] | None = None,
    progress: Callable[[float], None] = lambda _: None,
    settings: DesignSettings = DEFAULT.design,
) -> list[Suggestion]:
    """What each manoeuvre separates of the two leading explanations, the best first.

    Args:
        naming: What the flights so far say.
        vehicle: The model as it stands.
        among: Names of manoeuvres that can be flown there; default: all.
        progress: Called with the share done.
        settings: Sizes of manoeuvres.
    """
    block_s = naming.whitened.settings.block_s
    rivals, flights = naming.fitted[:2], _flights(naming)
    listed = [m for m in _flyable(naming, vehicle, settings) if among is None or m.name in among]
    leads = {m.name: 0.0 for m in listed}
    held = [_held(naming, f) for f in rivals]
    rounds = [(i, *k) for i in (0, 1) for k in sorted({(m.voltage, m.payload_kg) for m in listed})]
    for n, (i, voltage, payload_kg) in enumerate(rounds):
        progress((n + 0.3) / (len(rounds) + 0.3))
        loaded = carrying(vehicle, payload_kg)
        chosen = [m for m in listed if (m.voltage, m.payload_kg) == (voltage, payload_kg)]
        flown = plan(loaded, chosen, settings, block_s)
        plant = with_effects(loaded, rivals[i].effects, rivals[i].values)
        try:
            flight = rehearse(flown, loaded, plant, flights, voltage)
            blocks = _parting(naming, flight, loaded, rivals[i], rivals[1 - i])
        except TwinError:  # numbers with which nothing flies: nobody can fly it either
            continue
        for name, (first, last) in flown.spans.items():
            if last <= flight.table["time"].iloc[-1]:
                inside = [b for (_, k), b in blocks.items() if first <= k * block_s < last]
                leads[name] += lead(inside, held[1 - i]) / 2
    pair, present = (rivals[0].effects, rivals[1].effects), _present(naming, *rivals)
    found = [Suggestion(m.name, m.description, pair, leads[m.name], present) for m in listed]
    return sorted(found, key=lambda s: -s.separation)


# -- what is left between two explanations --------------------------------------------------


def _parting(
    naming: Naming, flight: Flight, vehicle: Vehicle, truth: Fit, other: Fit
) -> dict[tuple[int, int], Block]:
    """What one explanation predicts for a flight beyond another, by blocks of time."""
    union = {*truth.effects, *other.effects}
    model = model_of([flight], vehicle, [e for e in EFFECTS.values() if e.name in union])
    noise = dict(zip(_names(naming.whitened.model), naming.whitened.noise, strict=True))
    true = {c.name: c.residual for c in model.channels([], truth.values)[0]}
    rows = [
        replace(c, residual=c.residual - true[c.name])
        for c in _answers(model, other)[0]
        if c.name in noise
    ]
    even = [replace(noise[c.name], weights=(np.ones(len(c.t_s)),)) for c in rows]
    return blocks_of([rows], even, naming.whitened.settings) if rows else {}


def lead(blocks: Sequence[Block], held: Held) -> float:
    """Log likelihood by which an explanation falls behind, its numbers moved to their best.

    Args:
        blocks: Slopes of the explanation, and what is predicted beyond it.
        held: What its numbers cost to move.
    """
    if not blocks:
        return 0.0
    total = sum(blocks[1:], blocks[0])
    if not total.pull.size:
        return 0.5 * total.power
    gram = total.gram + held.precision
    best = best_inside(Factored.of(gram), total.pull, held.low, held.high)
    return float(0.5 * (total.power - 2 * total.pull @ best + best @ gram @ best))


def _held(naming: Naming, fitted: Fit) -> Held:
    """How far the flights so far, and the priors, let the numbers of an explanation move."""
    whitened = naming.whitened
    answers = _answers(whitened.model, fitted)
    blocks = blocks_of(answers, whitened.noise, whitened.settings).values()
    numbers = _numbers(whitened.model, fitted)
    at = {n.full: n.now for n in numbers} | dict(fitted.values)  # of some rotors, maybe
    prior = np.diag([1 / n.sd**2 for n in numbers])
    return Held(
        np.sum([b.gram for b in blocks], axis=0) + prior,
        np.array([n.about.bounds[0] - at[n.full] for n in numbers]),
        np.array([n.about.bounds[1] - at[n.full] for n in numbers]),
    )


def _present(naming: Naming, a: Fit, b: Fit) -> float:
    """Log likelihood by which the truth leads in the flights so far: both are at their best."""
    whitened, model = naming.whitened, naming.whitened.model
    ours, theirs = model.channels([], a.values), model.channels([], b.values)
    rows = [
        [replace(x, residual=x.residual - y.residual) for x, y in zip(f, g, strict=True)]
        for f, g in zip(ours, theirs, strict=True)
    ]
    blocks = blocks_of(rows, whitened.noise, whitened.settings).values()
    return 0.5 * sum(block.power for block in blocks)


def _answers(model: Model, fitted: Fit) -> list[list[ChannelData]]:
    """Channels of an explanation at its values, with slopes by its numbers and its shapes."""
    at = dict(fitted.values)
    own = columns_of(model.numbers, fitted.effects)
    flights = model.channels([i for i in own if model.numbers[i].full in at], at)
    for shape in (n.full for n in _numbers(model, fitted) if n.shape):
        step = SHAPE_STEP * at[shape]
        moved = model.channels([], {**at, shape: at[shape] + step})
        flights = [
            [
                replace(c, slopes=np.column_stack([c.slopes, (c.residual - d.residual) / step]))
                for c, d in zip(now, then, strict=True)
            ]
            for now, then in zip(flights, moved, strict=True)
        ]
    return flights


def _numbers(model: Model, fitted: Fit) -> list[Number]:
    """Numbers of an explanation in the order of the model, then its shapes."""
    own = [n for n in model.numbers if n.effect in fitted.effects and n.full in fitted.values]
    return sorted(own, key=lambda n: n.shape)


def _names(model: Model) -> list[str]:
    return [c.name for c in model.channels([])[0]]


# -- flying ---------------------------------------------------------------------------------


def _flyable(naming: Naming, vehicle: Vehicle, settings: DesignSettings) -> list[Manoeuvre]:
    """Manoeuvres that can be told from another: the battery only where its voltage counts."""
    flights = _flights(naming)
    charged = volts_of(flights, vehicle) >= vehicle.voltage_v
    listed = manoeuvres(vehicle, charged, settings)
    effects = {e for f in naming.fitted[:2] for e in f.effects} | {*vehicle.effects}
    voltage_matters = vehicle.rotors.reference_voltage_v is not None
    voltage_matters = voltage_matters or any("vbat" in EFFECTS[e].needs for e in effects)
    if voltage_matters and all(f.has("vbat_v") for f in flights):
        return list(listed)
    return [m for m in listed if m.voltage == 1]


def _flights(naming: Naming) -> list[Flight]:
    return [m.flight for m in naming.whitened.model.flights]
