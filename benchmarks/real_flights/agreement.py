"""What several rotations of the same flights say together, and what speaks against each effect."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

ONE_FLIGHT = 0.9
"""Share of what an effect adds from which on it rests on one flight."""
Case = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Number:
    """One number in one rotation.

    Attributes:
        value: In its unit.
        unit: Of the value.
        ci95: Interval; None for a shape.
        edge: Prior range, where the number is at the end of it.
    """

    value: float
    unit: str
    ci95: tuple[float, float] | None
    edge: tuple[float, float] | None


@dataclass(frozen=True, slots=True)
class Judgement:
    """One effect over all rotations.

    Attributes:
        effect: Identifier.
        named: Held-out flights of the rotations that name it.
        against: Facts that speak against it, in words.
    """

    effect: str
    named: tuple[str, ...]
    against: tuple[str, ...]


def effects_of(case: Case) -> dict[str, float]:
    """Effects of a rotation with their probabilities."""
    return {e["name"]: e["probability"] for e in case["said"].get("effects", [])}


def numbers_of(case: Case) -> dict[str, Number]:
    """Numbers of a rotation, "effect.number"."""
    found = {}
    for effect in case["said"].get("effects", []):
        for name, p in effect["parameters"].items():
            full = f"{effect['name']}.{name}"
            ci95, edge = p["ci95"], case["at_edge"].get(full)
            found[full] = Number(p["value"], p["unit"], ci95 and tuple(ci95), edge and tuple(edge))
    return found


def agreement(numbers: Sequence[Number]) -> str:
    """How far the same number of several rotations agrees."""
    known = [(n.value, n.ci95) for n in numbers if n.ci95 is not None]
    if len(numbers) < 2:
        return "one rotation only"
    if len(known) < 2:
        return "no interval"
    pairs = list(combinations(known, 2))
    if all(_inside(a, cb) and _inside(b, ca) for (a, ca), (b, cb) in pairs):
        return "yes"
    if all(ca[0] <= cb[1] and cb[0] <= ca[1] for (_, ca), (_, cb) in pairs):
        return "intervals overlap"
    return "no"


def _inside(value: float, interval: tuple[float, float]) -> bool:
    return interval[0] <= value <= interval[1]


def judge(cases: Sequence[Case]) -> list[Judgement]:
    """Every effect that a rotation names, those that most name first."""
    named: dict[str, list[Case]] = {}
    for case in cases:
        for effect in effects_of(case):
            named.setdefault(effect, []).append(case)
    judgements = [
        Judgement(
            effect,
            tuple(c["holdout"] for c in by),
            tuple(_against(effect, by, cases)),
        )
        for effect, by in named.items()
    ]
    return sorted(judgements, key=lambda j: (-len(j.named), len(j.against), j.effect))


def _against(effect: str, by: Sequence[Case], cases: Sequence[Case]) -> Iterator[str]:
    missing = [c["holdout"] for c in cases if c not in by]
    if missing:
        yield f"not named with {_and(missing)} held out"
    ties = [c["holdout"] for c in by if c["said"]["verdict"] != "named"]
    if ties:
        yield f"only a candidate with {_and(ties)} held out"
    yield from _against_numbers(effect, by)
    for case in by:
        added = case["by_flight"].get(effect, {})
        total = sum(max(a, 0.0) for a in added.values())
        for flight, gain in added.items():
            if len(added) > 1 and total > 0 and gain > ONE_FLIGHT * total:
                yield (
                    f"rests on {flight} with {case['holdout']} held out: "
                    f"{100 * gain / total:.0f} % of what it adds"
                )
    yield from _against_gap(effect, by)


def _against_numbers(effect: str, by: Sequence[Case]) -> Iterator[str]:
    each = [numbers_of(c) for c in by]
    for full in dict.fromkeys(k for numbers in each for k in numbers):
        if not full.startswith(f"{effect}."):
            continue
        own = [(c, n[full]) for c, n in zip(by, each, strict=True) if full in n]
        edges = [c["holdout"] for c, n in own if n.edge is not None]
        if edges:
            always = len(edges) == len(by) > 1
            where = "every time" if always else f"with {_and(edges)} held out"
            yield f"`{full}` at the edge of its range {where}"
        if agreement([n for _, n in own]) == "no":
            values = " and ".join(f"{n.value:.3g}" for _, n in own)
            yield f"`{full}` differs between rotations, beyond the intervals: {values}"


def _against_gap(effect: str, by: Sequence[Case]) -> Iterator[str]:
    """Whether the channels on which the effect acts shrink, more than by a constant."""
    unproven, constant = [], []
    for case in by:
        said = next(e for e in case["said"]["effects"] if e["name"] == effect)
        own = [c for c in case["channels"] if c["name"] in said["channels"]]
        if not own:
            continue
        better = [c for c in own if (c["shrink_ci95"][0] or 0.0) > 0]
        if not better:
            unproven.append(case["holdout"])
        elif all(c["fit_mean"] is not None and c["fit_mean"] <= c["effects"] for c in better):
            constant.append(case["holdout"])
    if unproven:
        yield f"no channel that it acts on shrinks beyond doubt on {_and(unproven)}"
    if constant:
        yield f"a constant does as well on {_and(constant)}"


def _and(names: Sequence[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
