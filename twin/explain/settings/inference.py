"""Which effects, with which probabilities: noise model, prices, hypotheses, rules, belief."""

from dataclasses import dataclass, field

from ...representation import short_repr
from .group import Group, setting


@dataclass(frozen=True, slots=True)
class LikelihoodSettings(Group):
    """Of `twin.explain.inference.whitening`: noise of a channel, for equations and designs."""

    order: int = setting(
        15, "samples", "order of the autoregression that is the noise of a channel", "made up"
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


@dataclass(frozen=True, slots=True)
class EvidenceSettings(Group):
    """Of `twin.explain.inference.evidence`: what is known of noise before a flight is looked at."""

    level: float = setting(
        2.0, "degrees of freedom", "with which the noise level of a band is known", "made up"
    )
    samples: float = setting(
        250.0,
        "samples",
        "that a channel of one flight counts as, however fast it was logged",
        "chosen on: RflySimDT real flights and NanoBench; 100 and 600 keep the names",
    )
    rough: float = setting(
        0.02,
        "share",
        "of the amplitude of a band that no law explains, being inexact",
        "chosen on: RflySimDT real flights and NanoBench",
        1.0,
    )
    coherent: float = setting(
        0.7,
        "1",
        "squared coherence of predicted and measured angular acceleration from which on a band "
        "votes",
        "chosen on: slow flights of small quadrotors, once; not tuned",
        1.0,
    )
    trim_force: float = setting(
        0.01,
        "share",
        "of gravity: constant specific force that a day brings",
        "chosen on: RflySimDT real flights; three times as much loses the centre of mass",
    )
    trim_turn: float = setting(
        0.0025,
        "share",
        "of the weight at the arm: constant moment about x and y that a day brings",
        "chosen on: RflySimDT real flights; three times as much loses the centre of mass",
    )
    trim_yaw: float = setting(0.3, "share", "of that, about z", "chosen on: RflySimDT real flights")
    trim_pose: float = setting(
        0.005,
        "share",
        "of gravity, and of 0.4 rad/s: constants between pose and IMU that a day brings",
        "made up: 0.3 degrees of levelling, 0.1 deg/s",
    )
    trim_other: float = setting(
        0.02, "share", "of the size of a sensor: constant of it that a day brings", "made up"
    )


@dataclass(frozen=True, slots=True)
class SelectionSettings(Group):
    """Of `twin.explain.inference.selection`: rules, and from when on a name is given."""

    sure: float = setting(0.8, "probability", "from which on a name is given", "made up", 1.0)
    moved: float = setting(
        3.0,
        "1",
        "factor on the odds of an effect from which on flights speak for it",
        "made up: evidence that is worth more than a bare mention, Kass & Raftery, J. Am. Stat. "
        "Assoc. 90 (1995)",
    )
    tension: float = setting(
        3.0,
        "sd",
        "by which a number may be away from what is expected of it; beyond, something else acts "
        "like its effect",
        "made up: one in 370 of right names",
    )
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
    variance_per_effect: float = setting(
        1.0,
        "variances",
        "of a number that each reported effect adds to it: no law is exact, and what one of "
        "them gets wrong the numbers of the others make up for",
        "chosen on: half of the cases of benchmarks/hidden_effects as in life "
        "(docs/results/hidden_effects.md); 0.5 is too few there, 1.5 and 2 do as well",
    )


@dataclass(frozen=True, slots=True)
class AdequacySettings(Group):
    """Of `twin.explain.inference.adequacy`: how far a name can be believed."""

    law: float = setting(
        1 / 7,
        "share",
        "deviation of a law of the right name from nature's, of what it explains",
        "made up; right names leave 0.14 or less in 25 of 26 cases "
        "(docs/results/hidden_effects.md)",
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
    most: int = setting(
        4, "effects", "of a model that lacks more, what one law leaves is not to be told", "made up"
    )


@dataclass(frozen=True, slots=True)
class InferenceSettings(Group):
    """Of `twin.explain.inference`."""

    likelihood: LikelihoodSettings = field(default_factory=LikelihoodSettings)
    evidence: EvidenceSettings = field(default_factory=EvidenceSettings)
    selection: SelectionSettings = field(default_factory=SelectionSettings)
    adequacy: AdequacySettings = field(default_factory=AdequacySettings)

    __repr__ = short_repr
