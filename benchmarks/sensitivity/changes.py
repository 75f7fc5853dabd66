"""How the answers of one variant differ from those with the default settings."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.hidden_effects.measures import Outcome

from .variants import Variant

SMALL = 0.01
"""A probability that moves by less has not changed."""


@dataclass(frozen=True)
class Change:
    """One variant against the default, over all cases.

    Attributes:
        variant: What was changed.
        cases: How many were asked.
        verdicts: In how many the verdict is another one.
        names: In how many the named effects are others.
        probability: Largest change of the probability of an effect, or of nothing.
        right: How many are right, and how many were.
        errors: How many gave no answer.
    """

    variant: Variant
    cases: int
    verdicts: int
    names: int
    probability: float
    right: tuple[int, int]
    errors: int

    @property
    def matters(self) -> bool:
        """Whether anything is said differently."""
        return bool(self.verdicts or self.names or self.probability >= SMALL)

    @property
    def rank(self) -> tuple[float, ...]:
        """Large for what changes much."""
        return self.verdicts, self.names, self.probability


def change(variant: Variant, usual: Sequence[Outcome], now: Sequence[Outcome]) -> Change:
    """Compare answers about the same cases, in the same order."""
    pairs = list(zip(usual, now, strict=True))
    return Change(
        variant,
        len(pairs),
        sum(a.verdict != b.verdict for a, b in pairs),
        sum(set(a.named) != set(b.named) for a, b in pairs),
        max((_moved(a.said, b.said) for a, b in pairs), default=0.0),
        (sum(b.right for b in now), sum(a.right for a in usual)),
        sum(b.verdict == "error" for b in now),
    )


def _moved(usual: Mapping[str, Any], now: Mapping[str, Any]) -> float:
    """Largest change of a probability."""
    a, b = _probabilities(usual), _probabilities(now)
    return max((abs(a.get(k, 0.0) - b.get(k, 0.0)) for k in {*a, *b}), default=0.0)


def _probabilities(said: Mapping[str, Any]) -> dict[str, float]:
    """Of what is told about; effects that are not listed count as impossible."""
    found = {str(e["name"]): float(e["probability"]) for e in said["effects"]}
    if said.get("nothing_probability") is not None:
        found["nothing"] = float(said["nothing_probability"])
    return found
