"""Which effects, with which probabilities: noise model, prices, hypotheses, rules, belief."""

from dataclasses import dataclass, field

from ...representation import short_repr
from .group import Group, setting


@dataclass(frozen=True, slots=True)
class LikelihoodSettings(Group):
    """Of `twin.explain.inference.likelihood`: noise of a channel, and how far laws are believed."""

    order: int = setting(
        15, "samples", "order of the autoregression that is the noise of a channel", "made up"
    )
    rounds: int = setting(
        3,
        "1",
        "fits of all numbers and of the noise in turn, after a first one with white noise",
        "made up",
    )
    block_s: float = setting(
        2.0, "s", "blocks of time that are left out of a fit, and drawn in the bootstrap", "made up"
    )
    huber: float = setting(
        4.0,
        "sd",
        "innovations beyond so many standard deviations weigh less: a bump, a lost packet",
        "made up; the weight itself is that of Huber, Ann. Math. Stat. 35 (1964)",
    )
    roughness: float = setting(
        1e-3,
        "share",
        "of the unexplained power that is added as white noise, as no model is exact: without it "
        "a smooth residual would count as known to many more digits than it is",
        "made up",
        1.0,
    )
    exact: float = setting(
        100.0,
        "nat",
        "log likelihood in a channel from which on the law of an effect shows that it is not "
        "exact: two percent more of it are worth two, as if the law were right to a seventh",
        "made up; the form is that of Miller & Dunson, J. Am. Stat. Assoc. 114 (2019)",
    )


@dataclass(frozen=True, slots=True)
class PriorSettings(Group):
    """Prices of a hypothesis, in log odds."""

    per_effect: float = setting(
        6.0,
        "nat",
        "log prior odds against one more effect",
        "made up: one of forty effects, and seldom more than one at once",
    )
    per_number: float = setting(
        1.5, "nat", "log prior odds against one more number that the flights tell", "made up"
    )
    per_edge: float = setting(
        100.0,
        "nat",
        "log prior odds against an effect at the edge of its range",
        "made up: as much as one channel tells that a law which is not exact explains",
    )


@dataclass(frozen=True, slots=True)
class PoolSettings(Group):
    """Of `twin.explain.inference.pool`: which hypotheses get to compete."""

    most: int = setting(
        3,
        "effects",
        "searched for in all their combinations, and in each of compass, barometer and the rest",
        "made up",
    )
    width: int = setting(
        12,
        "hypotheses",
        "of one size out of which those of the next size grow, in the first search",
        "made up",
    )
    singles: int = setting(
        8,
        "hypotheses",
        "of one effect that are fitted at their own best",
        "made up: 6 at first; why it was changed is not recorded",
    )
    pairs: int = setting(
        6,
        "hypotheses",
        "of two effects that are fitted at their own best",
        "made up: 5, then 4 at first; why it was changed is not recorded",
    )
    triples: int = setting(
        3,
        "hypotheses",
        "of three effects that are fitted at their own best",
        "made up: 3, then 2 at first; why it was changed is not recorded",
    )
    grown: int = setting(
        3, "hypotheses", "of one more effect that are tried after the best of a size", "made up"
    )
    rounds: int = setting(
        3, "1", "times at most that the best is grown and its effects are exchanged", "made up"
    )
    alike: float = setting(
        10.0, "nat", "log likelihood up to which an effect resembles another", "made up"
    )
    exchanged: int = setting(
        2, "effects", "that resemble one are tried in its place; tried when a set grows", "made up"
    )


@dataclass(frozen=True, slots=True)
class SelectionSettings(Group):
    """Of `twin.explain.inference.selection`: rules, and from when on a name is given."""

    smallest_share: float = setting(
        0.03,
        "share",
        "of the power of every channel; an effect that takes less is none to speak of",
        "made up",
        1.0,
    )
    sure: float = setting(0.8, "probability", "from which on a name is given", "made up", 1.0)
    credible: float = setting(
        0.5,
        "probability",
        "that the cause is of the library at all, from which on a name is given",
        "made up",
        1.0,
    )
    least: float = setting(
        0.05,
        "probability",
        "below which a hypothesis or an effect is no candidate",
        "made up",
        1.0,
    )
    checked: float = setting(
        0.02,
        "probability",
        "from which on a hypothesis is held against the rules",
        "made up",
        1.0,
    )
    spoilt: float = setting(
        1.5,
        "1",
        "times the power that a channel has without any effect: then it is spoilt",
        "made up",
    )


@dataclass(frozen=True, slots=True)
class AdequacySettings(Group):
    """Of `twin.explain.inference.adequacy`: how far a name can be believed."""

    law: float = setting(
        1 / 7,
        "share",
        "deviation of a law of the right name from nature's, of what it explains",
        "made up: the same as `inference.likelihood.exact`, sqrt(2 / 100); right names leave 0.14 "
        "or less in 25 of 26 cases (docs/results/hidden_effects.md)",
        1.0,
    )
    outside: float = setting(
        0.1, "probability", "prior, that a cause is none of the library", "made up", 1.0
    )
    chance: float = setting(2.0, "sd", "by which what is left has to stand out of noise", "made up")
    memory: float = setting(
        2.0,
        "periods",
        "of the highest frequency of a channel, in which its noise is forgotten",
        "made up",
    )


@dataclass(frozen=True, slots=True)
class InferenceSettings(Group):
    """Of `twin.explain.inference`."""

    likelihood: LikelihoodSettings = field(default_factory=LikelihoodSettings)
    prior: PriorSettings = field(default_factory=PriorSettings)
    pool: PoolSettings = field(default_factory=PoolSettings)
    selection: SelectionSettings = field(default_factory=SelectionSettings)
    adequacy: AdequacySettings = field(default_factory=AdequacySettings)

    __repr__ = short_repr
