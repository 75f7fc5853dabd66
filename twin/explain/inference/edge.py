"""Numbers that a fit has driven to the edge of what is considered, or of what is possible."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from ...effects import EFFECTS, Limit
from ...vehicle import Vehicle
from ..model.numbers import Number

EDGE = 1e-6
"""Share of a limit's terms that a fit at the limit may be away from it."""


def edges(
    numbers: Sequence[Number], values: Mapping[str, float], vehicle: Vehicle
) -> Iterator[tuple[str, str]]:
    """Effects at an edge, and which: a hint that another effect is meant.

    Args:
        numbers: That were fitted.
        values: Of these, "effect.number" -> value.
        vehicle: The model as it stands.
    """
    for n in numbers:
        value = values[n.full]
        at = np.isclose(value, n.about.prior, rtol=EDGE, atol=0)
        if np.any(at) and value != n.about.neutral:
            yield (
                n.effect,
                f"{n.full} = {value:.4g} is at the edge of the range that is considered, "
                f"{n.about.prior[0]:g} to {n.about.prior[1]:g}: perhaps another effect is meant",
            )
    for effect in dict.fromkeys(n.effect for n in numbers):
        for limit in EFFECTS[effect].limits(vehicle):
            if _on_edge(effect, limit, values):
                yield (
                    effect,
                    f"{effect} is at the edge of what is possible: {limit.meaning}; another "
                    f"effect may be meant",
                )


def _on_edge(effect: str, limit: Limit, values: Mapping[str, float]) -> bool:
    """Whether numbers use up what a limit leaves them."""
    parts = [w * values[f"{effect}.{k}"] for k, w in limit.weights.items()]
    return sum(parts) <= EDGE * sum(map(abs, parts))
