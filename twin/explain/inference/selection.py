"""Name what a model lacks: one effect, some, none, or a tie that the flights cannot break."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ...effects import EFFECTS, Shift
from ...logs import Flight
from ...representation import short_repr
from ...vehicle import Vehicle
from ..model.model import candidates, model_of
from ..model.payload import Payloads
from ..settings import DEFAULT, InferenceSettings, SelectionSettings
from .adequacy import credible, misfits
from .fit import Fit, Problem
from .pool import Pool, dominated, grow, log_prior, pool_of, worth_a_name
from .search import Hypothesis, weights

Array = NDArray[np.float64]
Verdict = Literal["named", "nothing", "unnamed", "cannot_tell", "unusable"]
IMPOSSIBLE = 1e6
"""Log odds against what is ruled out: more than any flight can tell."""


@dataclass(frozen=True, slots=True)
class Naming:
    """What the flights say about a model.

    Attributes:
        fitted: Hypotheses at their best, most probable first, `nothing` among them.
        probabilities: Of each.
        shares: Largest share of the power of a channel that each explains.
        credible: Of the effects of likely hypotheses, the probability that their cause is of the
            library at all, see `misfit`.
        problem: What they were fitted against.
        settings: From when on a name is given.
    """

    fitted: tuple[Fit, ...]
    probabilities: tuple[float, ...]
    shares: tuple[float, ...]
    credible: Mapping[str, float]
    problem: Problem
    settings: SelectionSettings = DEFAULT.inference.selection

    __repr__ = short_repr

    @property
    def best(self) -> Fit:
        """The most probable hypothesis."""
        return self.fitted[0]

    @property
    def likely(self) -> tuple[Fit, ...]:
        """Hypotheses that are candidates, the most probable first."""
        pairs = zip(self.fitted, self.probabilities, strict=True)
        return tuple(f for f, p in pairs if p >= self.settings.least)

    def probability_of(self, effect: str) -> float:
        """That an effect is missing, alone or with others."""
        return self.together([effect])

    @property
    def verdict(self) -> Verdict:
        """In a word: something is named where one effect is sure, whatever else is not."""
        if not self.best.effects:
            return "nothing" if self.probabilities[0] >= self.settings.sure else "cannot_tell"
        return "cannot_tell" if self.undecided == self.best.effects else "named"

    @property
    def undecided(self) -> tuple[str, ...]:
        """Effects of the most probable hypothesis that are not sure."""
        return tuple(e for e in self.best.effects if not self._is_sure(e))

    def _is_sure(self, effect: str) -> bool:
        believable = self.credible[effect]
        if believable < self.settings.credible:
            return False
        return self.together([effect]) >= self.settings.sure * believable

    @property
    def sure(self) -> bool:
        """Whether there is nothing left to tell apart."""
        return self.verdict != "cannot_tell" and not self.undecided

    def together(self, effects: Collection[str]) -> float:
        """That some effects are missing, all of them, and each cause is of the library."""
        pairs = zip(self.fitted, self.probabilities, strict=True)
        among = float(sum(p for f, p in pairs if set(effects) <= set(f.effects)))
        return among * math.prod(self.credible.get(e, 1.0) for e in effects)

    @property
    def outside(self) -> float:
        """That a cause is none of the library, though the best hypothesis gives it a name."""
        return 1 - math.prod(self.credible[e] for e in self.best.effects)


def name_effects(
    flights: Sequence[Flight],
    vehicle: Vehicle,
    seed: int = 0,
    progress: Callable[[float], None] = lambda _: None,
    payloads: Payloads | None = None,
    settings: InferenceSettings = DEFAULT.inference,
) -> Naming:
    """Fit every effect that the flights can show, alone and together.

    Args:
        flights: To fit on.
        vehicle: The model as it stands.
        seed: Of the bootstrap.
        progress: Called with the share done.
        payloads: Known masses aboard.
        settings: Noise, prices, rules.
    """
    model = model_of(
        flights, vehicle, candidates(flights), lambda done: progress(0.2 * done), payloads
    )
    problem = Problem.of(model, settings.likelihood)
    pool = pool_of(problem, lambda done: progress(0.2 + 0.7 * done), settings)
    chance = _weighed(pool, seed)
    fitted = pool.fitted
    order = np.argsort(-chance)
    ranked = tuple(fitted[i] for i in order)
    probabilities = tuple(float(chance[i]) for i in order)
    least = settings.selection.least
    likely = [f for f, p in zip(ranked, probabilities, strict=True) if p >= least] or [ranked[0]]
    return Naming(
        ranked,
        probabilities,
        tuple(share(f, problem.nothing()) for f in ranked),
        _credible(pool, likely),
        problem,
        settings.selection,
    )


def _weighed(pool: Pool, seed: int) -> Array:
    """Probabilities of what competes; what is likely is held against the rules first."""
    settings = pool.settings
    out: dict[tuple[str, ...], bool] = {}
    while True:
        fitted = pool.fitted
        allowed = [f for f in fitted if not out.get(f.effects)]
        ruled_out = [out.get(f.effects, False) or dominated(f, allowed, settings) for f in fitted]
        prior = np.array([log_prior(f, settings.prior) for f in fitted])
        prior -= IMPOSSIBLE * np.array(ruled_out)
        competing = [Hypothesis(f.effects, f.gains) for f in fitted]
        chance = weights(competing, prior, seed, settings.likelihood)
        checked = settings.selection.checked
        likely = [fitted[i] for i in np.argsort(-chance) if chance[i] >= checked]
        new = next((f for f in likely if f.effects not in out), None)
        if new is None:
            return _without_trifles(fitted, chance)
        pool.add(worth_a_name(new))
        out[new.effects] = (
            _spoils(new, pool.problem, settings.selection)
            or not _material(pool, new)
            or _hangs(pool, new)
        )


def _without_trifles(fitted: Sequence[Fit], chance: Array) -> Array:
    """Probabilities given to the names alone: a delay below a sample may stand in a hypothesis, so
    that nothing else has to stand in for it."""
    place = {f.effects: i for i, f in enumerate(fitted)}
    given = np.zeros_like(chance)
    for f, p in zip(fitted, chance, strict=True):
        given[place.get(worth_a_name(f), place[f.effects])] += p
    return given


def _hangs(pool: Pool, fitted: Fit) -> bool:
    """Whether one of several effects is not credible; then the others compete without it.

    A name must not hang on one beside it that leaves what it should explain.
    """
    believable = {e: p for e, p in _credible(pool, [fitted]).items() if e in worth_a_name(fitted)}
    least = pool.settings.selection.credible
    if len(believable) < 2 or min(believable.values()) >= least:
        return False
    worst = min(believable, key=lambda e: believable[e])
    rest = pool.add(pool.without(fitted, worst).effects)
    if len(fitted.effects) > pool.settings.pool.most:
        grow(pool, rest, worst)
    return True


def _credible(pool: Pool, likely: Sequence[Fit]) -> dict[str, float]:
    """Of each effect, in the most probable hypothesis with it, what `misfit.credible` says."""
    model, settings = pool.problem.model, pool.settings.adequacy
    found: dict[str, float] = {}
    for fitted in likely:
        without = {e: pool.without(fitted, e) for e in fitted.effects}
        left = misfits(model, fitted, without, settings)
        found = {e: credible(m, settings) for e, m in left.items()} | found
    return found


def _spoils(fitted: Fit, problem: Problem, settings: SelectionSettings) -> bool:
    """Whether a channel is left clearly worse than without any effect.

    White noise hardly counts what is slow: an offset that a hypothesis brings in.
    """
    return bool(np.any(fitted.raw > settings.spoilt * problem.raw))


def _material(pool: Pool, fitted: Fit) -> bool:
    """Whether each effect of a hypothesis is large enough to speak of, and adds to the others.

    Every log has its delays below a sample: they are allowed, but no names.
    """
    names = worth_a_name(fitted)
    trifles = (EFFECTS[e] for e in fitted.effects if e not in names)
    if not all(isinstance(e.seen_as, Shift) for e in trifles):
        return False
    least = pool.settings.selection.smallest_share
    return all(share(fitted, pool.without(fitted, e)) >= least for e in names)


def share(fitted: Fit, beyond: Fit) -> float:
    """Largest share of the power of a channel, as the noise model weighs it, that is explained.

    Args:
        fitted: What explains.
        beyond: What has explained some of it already.
    """
    return float(np.max(1 - fitted.left / np.maximum(beyond.left, 1e-300)))
