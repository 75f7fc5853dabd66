"""How what was found is shown: gap of held-out flights, where effects act, where a gap is left."""

from dataclasses import dataclass

from .group import Group, setting


@dataclass(frozen=True, slots=True)
class HoldoutSettings(Group):
    """Of `twin.explain.holdout` and `twin.explain.holdout`."""

    spared_s: float = setting(
        4.0, "s", "block of time that is held out where no flight is", "made up"
    )
    spared_every: int = setting(3, "blocks", "one in so many is held out", "made up")
    block_s: float = setting(
        1.0, "s", "blocks of time that the bootstrap of the shrink draws", "made up"
    )
    fewest_blocks: int = setting(5, "blocks", "with fewer the shrink has no interval", "made up")


@dataclass(frozen=True, slots=True)
class AttributionSettings(Group):
    """Of `twin.explain.localization`."""

    least_share: float = setting(
        0.1,
        "share",
        "of the power of a channel's residual that an effect explains where it acts",
        "made up",
        1.0,
    )
    strong: float = setting(
        0.5,
        "share",
        "of its strength in the strongest phase that an effect has where it acts",
        "made up",
        1.0,
    )


@dataclass(frozen=True, slots=True)
class LocalizationSettings(Group):
    """Of `twin.explain.localization`."""

    above_floor: float = setting(
        1.2,
        "1",
        "a residual over its noise floor by less is noise",
        "made up: 1.1 at first; why it was changed is not recorded",
    )
    fewest: int = setting(25, "samples", "that a phase has to have", "made up")
    bins: int = setting(10, "1", "of the curve of a residual over a quantity", "made up")
    telling: float = setting(
        0.2,
        "share",
        "of a residual that a quantity must account for to be worth telling",
        "made up",
        1.0,
    )
