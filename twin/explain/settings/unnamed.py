"""When an equation takes the place of a name."""

from dataclasses import dataclass

from .group import Group, setting


@dataclass(frozen=True, slots=True)
class UnnamedSettings(Group):
    """Of `twin.explain.unnamed`."""

    most_terms: int = setting(4, "terms", "of an equation at most", "made up")
    folds: int = setting(5, "1", "parts of the time that are left out in turn", "made up")
    per_term: float = setting(
        6.0,
        "nat",
        "log prior odds against one more term",
        "made up: one of a hundred and more, and its coefficient",
    )
    most_of_it: float = setting(
        0.97,
        "share",
        "of what the best equation gains; the shortest one that gains that much is taken",
        "made up",
        1.0,
    )
    own_noise_s: float = setting(
        0.03,
        "s",
        "by which turning rates are late where they stand for a gyroscope channel: the noise of "
        "the reading, low-passed to both sides, is not in them any more",
        "made up",
    )
    tones_hz: tuple[float, float] = setting(
        (0.3, 10.0), "Hz", "where a steady shaking is looked for", "made up", 25.0
    )
    in_band: float = setting(
        0.95, "share", "of the power of an equation that its band holds", "made up", 1.0
    )
    least_share: float = setting(
        0.5,
        "share",
        "of what is there; an equation that explains less explains nothing",
        "made up",
        1.0,
    )
    enough: float = setting(
        20.0,
        "nat",
        "log likelihood below which equations say nothing: many products are tried in many "
        "channels",
        "made up",
    )
    covers: float = setting(
        0.4,
        "share",
        "of what an equation explains; an effect that covers it is an imperfect law of the right "
        "cause: laws of nature are finer than those of a library, and equations more pliable",
        "chosen on: large hidden effects, where with 0.7 a gust and an induced inflow, which "
        "covers 0.45, got equations (docs/results/hidden_effects.md)",
        1.0,
    )
