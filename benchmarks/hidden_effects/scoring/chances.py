"""Whether what is said to be sure to 80 % is so in 80 of 100 cases.

Every (case, effect) with a probability is one forecast; it has come true where the effect was
hidden. Names that are neither right nor wrong (`Outcome.excused`) are left out, and flights after
a calibration.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from .outcomes import Outcome

BINS = 10


@dataclass(frozen=True)
class Forecast:
    """How sure the program was of an effect, and whether it was hidden."""

    probability: float
    came_true: bool


def of_inclusion(outcomes: Sequence[Outcome]) -> list[Forecast]:
    """Of every candidate effect, named or not."""
    return [
        Forecast(p, name in o.hidden)
        for o in _without_since(outcomes)
        for name, p in (o.said.get("inclusion") or {}).items()
        if name not in o.excused
    ]


def of_names(outcomes: Sequence[Outcome]) -> list[Forecast]:
    """Of the effects that were named."""
    return [
        Forecast(e["probability"], e["name"] in o.hidden)
        for o in _without_since(outcomes)
        for e in o.said["effects"]
        if o.verdict == "named" and e["name"] not in o.excused
    ]


def _without_since(outcomes: Sequence[Outcome]) -> list[Outcome]:
    return [o for o in outcomes if o.kind != "since"]


def brier(forecasts: Sequence[Forecast]) -> float | None:
    """Mean square of probability minus outcome. Source: Brier, Monthly Weather Review 78 (1950)."""
    squares = [(f.probability - f.came_true) ** 2 for f in forecasts]
    return sum(squares) / len(squares) if squares else None


def reliability(forecasts: Sequence[Forecast]) -> list[dict[str, Any]]:
    """Mean probability and share that came true, by equally wide bins; empty ones left out."""
    bins: dict[int, list[Forecast]] = {}
    for f in forecasts:
        bins.setdefault(min(int(f.probability * BINS), BINS - 1), []).append(f)
    return [
        {
            "n": len(inside),
            "said": sum(f.probability for f in inside) / len(inside),
            "came_true": sum(f.came_true for f in inside),
        }
        for _, inside in sorted(bins.items())
    ]


def calibration_error(forecasts: Sequence[Forecast]) -> float | None:
    """Expected calibration error over the bins. Source: Naeini, Cooper & Hauskrecht, AAAI 2015."""
    off = [abs(b["said"] * b["n"] - b["came_true"]) for b in reliability(forecasts)]
    return sum(off) / len(forecasts) if forecasts else None
