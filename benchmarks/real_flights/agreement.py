"""What several rotations of the same flights say together, and what speaks against each effect."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

UNDETERMINED = 0.7
"""Posterior over prior deviation from which on a number is the prior's more than the flights'."""
Case = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Number:
    """One number in one rotation.

    Attributes:
        value: In its unit.
        unit: Of the value.
        ci95: Interval; None: it has none.
        edge: Prior range, where the number is at the end of it.
        neutral: Value at which the effect vanishes; None: a shape.
        prior_share: Posterior over prior deviation; None: not known.
    """

    value: float
    unit: str
    ci95: tuple[float, float] | None
    edge: tuple[float, float] | None = None
    neutral: float | None = None
    prior_share: float | None = None

    @property
    def side(self) -> int:
        """Side of its neutral value that its whole interval is on, 1 or -1; 0: not known."""
        if self.neutral is None or self.ci95 is None:
            return 0
        low, high = self.ci95
        return int(low > self.neutral) - int(high < self.neutral)


@dataclass(frozen=True, slots=True)
class Agreement:
    """One number over the rotations that name its effect.

    Attributes:
        full: "effect.number".
        by: Held-out flight of each rotation -> the number.
    """

    full: str
    by: Mapping[str, Number]

    @property
    def same_sign(self) -> bool | None:
        """Whether all are on one side of the neutral value; None: fewer than two are on any."""
        sides = [n.side for n in self.by.values() if n.side]
        return len(set(sides)) == 1 if len(sides) > 1 else None

    @property
    def overlap(self) -> bool | None:
        """Whether each two intervals overlap; None: fewer than two are known."""
        known = [n.ci95 for n in self.by.values() if n.ci95 is not None]
        pairs = combinations(known, 2)
        return all(a[0] <= b[1] and b[0] <= a[1] for a, b in pairs) if len(known) > 1 else None

    @property
    def edges(self) -> tuple[str, ...]:
        """Held-out flights of the rotations in which it is at the edge of its range."""
        return tuple(f for f, n in self.by.items() if n.edge is not None)

    @property
    def undetermined(self) -> tuple[str, ...]:
        """The same where the prior says more of it than the flights."""
        return tuple(f for f, n in self.by.items() if (n.prior_share or 0.0) > UNDETERMINED)

    @property
    def compared(self) -> bool:
        """Whether more than one rotation gives it."""
        return len(self.by) > 1

    @property
    def passes(self) -> bool:
        """Whether rotations agree on it, and nothing else speaks against it."""
        apart = self.same_sign is False or self.overlap is False
        return self.compared and not (apart or self.edges)


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


def alike_of(case: Case) -> dict[str, str]:
    """Effects that something acts like in a rotation, and why they are not believed."""
    return {r["name"]: r["why"] for r in case["said"].get("acts_like", [])}


def numbers_of(case: Case, effects: Collection[str] | None = None) -> dict[str, Number]:
    """Numbers of a rotation, "effect.number": of effects that it names or lists as candidates.

    Args:
        case: The rotation.
        effects: Other effects whose numbers are asked for.
    """
    wanted = effects_of(case) if effects is None else effects
    return {
        full: Number(
            n["value"],
            n["unit"],
            None if n["ci95"] is None else (n["ci95"][0], n["ci95"][1]),
            None if n["edge"] is None else (n["edge"][0], n["edge"][1]),
            n["neutral"],
            n["prior_share"],
        )
        for full, n in case["numbers"].items()
        if full.partition(".")[0] in wanted
    }


def agreements(cases: Sequence[Case]) -> list[Agreement]:
    """Every number that a rotation names, in the order of its first mention."""
    each = {c["holdout"]: numbers_of(c) for c in cases}
    every = dict.fromkeys(full for numbers in each.values() for full in numbers)
    return [
        Agreement(full, {f: numbers[full] for f, numbers in each.items() if full in numbers})
        for full in every
    ]


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
    missing = [c["holdout"] for c in cases if c not in by and effect not in alike_of(c)]
    if missing:
        yield f"not named with {_and(missing)} held out"
    ties = [c["holdout"] for c in by if c["said"]["verdict"] != "named"]
    if ties:
        yield f"only a candidate with {_and(ties)} held out"
    alike = [c["holdout"] for c in cases if effect in alike_of(c)]
    if alike:
        yield f"something only acts like it with {_and(alike)} held out"
    yield from _against_numbers(effect, by)
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
        if Agreement(full, {c["holdout"]: n for c, n in own}).overlap is False:
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
