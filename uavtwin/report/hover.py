"""The diagnosis of a twin in hover, in sentences: the same in every verb."""

import math
from collections.abc import Sequence

from twin.residuals.hover import HoverDiagnosis, Mean

from .spoken import joined

LEAST_M, LEAST_RAD, LEAST_LOSS = 5e-4, math.radians(0.5), 0.02
"""A centre of mass, an angle, a loss below these is not said."""


def hover_sentence(vehicle: str, hover: HoverDiagnosis) -> str:
    """The weight that a twin carries at the logged commands, where its centre of mass seems to be,
    and how its thrust leans; what is within two standard errors of zero is left out."""
    text = (
        f"At the logged commands {vehicle} carries {100 * hover.carried.value:.0f} % of its weight"
    )
    off = _parts(
        (
            (hover.back_m, "further back", "further forward"),
            (hover.right_m, "further to the right", "further to the left"),
        ),
        1e3,
        LEAST_M,
        " mm",
    )
    if off:
        text += f", and turns as if the centre of mass were {joined(off)}"
        if (weak := hover.weakest) is not None and weak.loss.value >= LEAST_LOSS:
            text += f", or as if rotor {weak.rotor} gave {_size(weak.loss, 100, ' %')} less thrust"
    leans = _parts(
        (
            (hover.lean_forward_rad, "forward", "back"),
            (hover.lean_right_rad, "to the right", "to the left"),
        ),
        180 / math.pi,
        LEAST_RAD,
        "°",
    )
    if leans:
        text += f"; the thrust leans {joined(leans)} of where the twin's points"
    return f"{text}."


def _parts(
    means: Sequence[tuple[Mean | None, str, str]], factor: float, least: float, unit: str
) -> list[str]:
    """Each mean that differs from zero, with its direction."""
    return [
        f"{_size(mean, factor, unit)} {forth if mean.value > 0 else back}"
        for mean, forth, back in means
        if mean is not None and mean.clear and abs(mean.value) >= least
    ]


def _size(mean: Mean, factor: float, unit: str) -> str:
    """A mean with twice its standard error."""
    return f"{factor * abs(mean.value):.1f} ± {factor * 2 * mean.sd:.1f}{unit}"
