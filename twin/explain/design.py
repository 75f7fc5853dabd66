"""Experiment design: the manoeuvre that best discriminates between two explanations.

Each of the two explanations in turn is assumed true. The twin with its effects flies every
manoeuvre in closed loop; the other explanation, with its numbers free within their posterior,
predicts the same readings. The difference of the predictions, both by `FlightModel` and without
noise, in the whitened metric of the search, is the expected log likelihood ratio.

Source: discrimination between rival models, Hunter & Reiner, Technometrics 7 (1965); Atkinson &
Fedorov, Biometrika 62 (1975).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..effects import EFFECTS
from ..errors import TwinError
from ..flight.manoeuvres import Manoeuvre, manoeuvres, plan, rehearse, volts_of
from ..logs import Flight
from ..representation import ShortRepr
from ..residuals.channels import GRID_HZ, Array
from ..vehicle import Vehicle
from .inference.evidence import Factored, best_inside
from .inference.fit import Fit
from .inference.selection import Naming
from .inference.whitening import Block, blocks_of
from .model.model import Model, model_of
from .model.numbers import carrying, with_effects

ENOUGH_NAT = 5.0
"""Expected log likelihood ratio, nats, below which a manoeuvre does not discriminate: odds of 150
to 1."""


@dataclass(frozen=True, slots=True)
class Suggestion(ShortRepr):
    """Suggested manoeuvre that discriminates between two sets of effects.

    Attributes:
        manoeuvre: Identifier.
        description: Instruction for the pilot.
        separates: The two sets, the more probable first; an empty one: no effect is missing.
        separation: Expected log likelihood ratio in favour of the true one, nats, mean over both.
    """

    manoeuvre: str
    description: str
    separates: tuple[tuple[str, ...], tuple[str, ...]]
    separation: float


@dataclass(frozen=True, slots=True)
class Held:
    """Constraints on the numbers of an explanation: precision by the given flights and priors,
    shape (k, k); largest changes down and up, shape (k,)."""

    precision: Array
    low: Array
    high: Array


def next_manoeuvre(naming: Naming, vehicle: Vehicle) -> Suggestion | None:
    """The manoeuvre that best discriminates between two explanations, see `_rivals`; None where the
    name is certain, where there is one explanation only, or where no manoeuvre helps."""
    if len(naming.fitted) < 2 or not (naming.verdict == "cannot_tell" or naming.undecided):
        return None
    best = suggestions(naming, vehicle)[0]
    return best if best.separation >= ENOUGH_NAT else None


def suggestions(
    naming: Naming, vehicle: Vehicle, among: Sequence[str] | None = None
) -> list[Suggestion]:
    """Discrimination between two explanations, see `_rivals`, by each manoeuvre, or by each of
    `among`, the best first."""
    block_s = naming.whitened.settings.block_s
    rivals, flights = _rivals(naming), [m.flight for m in naming.whitened.model.flights]
    listed = [m for m in _flyable(rivals, flights, vehicle) if among is None or m.name in among]
    leads = {m.name: 0.0 for m in listed}
    held = [_held(naming, f) for f in rivals]
    rounds = [(i, *k) for i in (0, 1) for k in sorted({(m.voltage, m.payload_kg) for m in listed})]
    for i, voltage, payload_kg in rounds:
        loaded = carrying(vehicle, payload_kg)
        chosen = [m for m in listed if (m.voltage, m.payload_kg) == (voltage, payload_kg)]
        flown = plan(loaded, chosen, block_s)
        plant = with_effects(loaded, rivals[i].effects, rivals[i].values)
        try:
            flight = rehearse(flown, loaded, plant, flights, voltage, GRID_HZ)
            blocks = _parting(naming, flight, loaded, rivals[i], rivals[1 - i])
        except TwinError:  # numbers with which the twin cannot fly
            continue
        for name, (first, last) in flown.spans.items():
            if last <= flight.table["time"].iloc[-1]:
                inside = [b for (_, k), b in blocks.items() if first <= k * block_s < last]
                leads[name] += lead(inside, held[1 - i]) / 2
    pair = (rivals[0].effects, rivals[1].effects)
    found = [Suggestion(m.name, m.description, pair, leads[m.name]) for m in listed]
    return sorted(found, key=lambda s: -s.separation)


# -- what is left between two explanations --------------------------------------------------


def _rivals(naming: Naming) -> tuple[Fit, Fit]:
    """The leading explanation, and the most probable of those that only add to it, or of those that
    lack something of it, whichever are more probable together: not always the second of all."""
    first, *others = zip(naming.fitted, naming.probabilities, strict=True)
    more = [o for o in others if {*o[0].effects} > {*first[0].effects}]
    less = [o for o in others if not {*o[0].effects} > {*first[0].effects}]
    second = max(filter(None, (more, less)), key=lambda sets: sum(p for _, p in sets))[0]
    return first[0], second[0]


def _parting(
    naming: Naming, flight: Flight, vehicle: Vehicle, truth: Fit, other: Fit
) -> dict[tuple[int, int], Block]:
    """Difference between the predictions of two explanations for a flight, by blocks of time."""
    union = {*truth.effects, *other.effects}
    model = model_of([flight], vehicle, [e for e in EFFECTS.values() if e.name in union])
    known_model = naming.whitened.model
    known = known_model.channels([])[0]
    noise = {c.name: n for c, n in zip(known, naming.whitened.noise, strict=True)}
    true = {c.name: c.residual for c in model.channels([], truth.values)[0]}
    place = {n.full: i for i, n in enumerate(model.numbers)}
    names = [known_model.numbers[i].full for i in _columns(known_model, other)]
    there = np.array([n in place for n in names])  # others this flight does not tell
    rows = [
        replace(c, residual=c.residual - true[c.name], slopes=c.slopes @ np.eye(len(there))[there])
        for c in model.channels([place[n] for n in names if n in place], other.values)[0]
        if c.name in noise
    ]
    even = [replace(noise[c.name], weights=(np.ones(len(c.t_s)),)) for c in rows]
    return blocks_of([rows], even, naming.whitened.settings) if rows else {}


def lead(blocks: Sequence[Block], held: Held) -> float:
    """Log likelihood by which an explanation falls behind, with its numbers refitted."""
    if not blocks:
        return 0.0
    total = sum(blocks[1:], blocks[0])
    if not total.pull.size:
        return 0.5 * total.power
    gram = total.gram + held.precision
    best = best_inside(Factored.of(gram), total.pull, held.low, held.high)
    return float(0.5 * (total.power - 2 * total.pull @ best + best @ gram @ best))


def _held(naming: Naming, fitted: Fit) -> Held:
    """Posterior constraints on the numbers of an explanation by the given flights and priors."""
    whitened = naming.whitened
    own, at = _columns(whitened.model, fitted), fitted.values
    answers = whitened.model.channels(own, at)
    blocks = blocks_of(answers, whitened.noise, whitened.settings).values()
    numbers = [whitened.model.numbers[i] for i in own]
    prior = np.diag([(4 / np.ptp(n.about.bounds)) ** 2 for n in numbers])
    return Held(
        np.sum([b.gram for b in blocks], axis=0) + prior,
        np.array([n.about.bounds[0] - at[n.full] for n in numbers]),
        np.array([n.about.bounds[1] - at[n.full] for n in numbers]),
    )


def _columns(model: Model, fitted: Fit) -> list[int]:
    """Indices of the numbers of an explanation, including shape parameters."""
    return [i for i, n in enumerate(model.numbers) if n.full in fitted.values]


# -- flying ---------------------------------------------------------------------------------


def _flyable(rivals: Sequence[Fit], flights: Sequence[Flight], vehicle: Vehicle) -> list[Manoeuvre]:
    """Manoeuvres that differ from each other for this vehicle: the battery ones only where its
    voltage matters."""
    charged = volts_of(flights, vehicle) >= vehicle.voltage_v
    listed = manoeuvres(vehicle, charged)
    effects = {e for f in rivals for e in f.effects} | {*vehicle.effects}
    voltage_matters = vehicle.rotors.reference_voltage_v is not None
    voltage_matters = voltage_matters or any("vbat" in EFFECTS[e].needs for e in effects)
    if voltage_matters and all(f.has("vbat_v") for f in flights):
        return list(listed)
    return [m for m in listed if m.voltage == 1]
