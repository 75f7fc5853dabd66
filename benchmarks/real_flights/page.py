"""All tables of the rotations: what was named, gaps of the held-out flights, what to believe."""

from collections.abc import Mapping, Sequence
from typing import Any

from .agreement import Case, agreements, alike_of, effects_of, judge, numbers_of
from .details import (
    agree,
    by_band,
    constants,
    figure,
    in_shown_unit,
    passing,
    section,
    table,
    wishes,
)
from .scenarios import Scenario

COLUMNS = {
    "none": "none",
    "effects": "effects",
    "fit_mean": "fit mean",
    "own_mean": "own mean",
    "last_20_ms": "last, 20 ms",
    "last_500_ms": "last, 0.5 s",
    "floor": "floor",
}


def details(found: Sequence[tuple[Scenario, Sequence[Case]]]) -> str:
    """Every table, in Markdown, from the rotations of each scenario."""
    parts = overview(found)
    for scenario, cases in found:
        parts += ["", f"## {scenario.title}", "", scenario.about, *rotations(cases)]
        parts += agree(scenario, cases)
        parts += believe(scenario, cases)
        parts += wishes(scenario, cases)
        for case in cases:
            parts += [*gap(case), *by_band(case), *constants(case)]
    return "\n".join(parts) + "\n"


def state(found: Sequence[tuple[Scenario, Sequence[Case]]]) -> str:
    """What a run was measured by, in a sentence."""
    every = [c for _, cases in found for c in cases]
    states = ", ".join(sorted({c["twin"] for c in every}))
    chosen = ", ".join(sorted({c["said"].get("settings", {}).get("hash", "-") for c in every}))
    return f"Hash of the sources of `twin/`: {states}; of the settings: {chosen}."


def overview(found: Sequence[tuple[Scenario, Sequence[Case]]]) -> list[str]:
    """All scenarios in a table."""
    lines = []
    for scenario, cases in found:
        judged = judge(cases)
        always = [f"`{j.effect}`" for j in judged if len(j.named) == len(cases)]
        stand = [f"`{j.effect}`" for j in judged if not j.against]
        verdicts = [c["said"]["verdict"] for c in cases]
        verdict_counts = ", ".join(f"{verdicts.count(v)} {v}" for v in dict.fromkeys(verdicts))
        good, compared, _ = passing(agreements(cases))
        numbers = f"{good} of {compared}" if compared else "-"
        alike = dict.fromkeys(f"`{e}`" for c in cases for e in alike_of(c))
        lists = (", ".join(names) or "-" for names in (always, stand, alike))
        lines.append((scenario.title, verdict_counts, *lists, numbers))
    head = (
        *("scenario", "verdicts", "in every rotation", "nothing speaks against"),
        *("something acts like", "numbers that pass"),
    )
    return ["## Overview", "", *table(head, lines)]


def rotations(cases: Sequence[Case]) -> list[str]:
    """What each rotation says."""
    lines, remarks = [], []
    for case in cases:
        said = case["said"]
        effects = [f"`{e}` {p:.2f}" for e, p in effects_of(case).items()]
        nothing = said.get("nothing_probability")
        lines.append(
            (
                case["holdout"],
                said["verdict"],
                ", ".join(effects) or "-",
                ", ".join(f"`{e}`" for e in alike_of(case)) or "-",
                "-" if nothing is None else f"{nothing:.2f}",
                "; ".join(_equation(u) for u in said.get("unnamed", [])) or "-",
            )
        )
        remarks += [f"- {case['holdout']} held out: {r}" for r in _remarks(said)]
    head = (
        *("held out", "verdict", "effects, probability", "something acts like"),
        *("nothing", "equations beyond them"),
    )
    return ["", *table(head, lines), *(["", *remarks] if remarks else [])]


def _equation(unnamed: Mapping[str, Any]) -> str:
    return f"`{unnamed['expression']}` ({100 * unnamed['share']:.0f} %)"


def _remarks(said: Mapping[str, Any]) -> list[str]:
    """What `explain` warns of, except for what the tables show."""
    lines = [said["error"]] if "error" in said else list(said["reasons"])
    lines += [w for w in said.get("warnings", []) if not w.startswith("something acts like")]
    if said.get("next_manoeuvre"):
        lines.append(f"to fly next: {said['next_manoeuvre']['description']}")
    return lines


def believe(scenario: Scenario, cases: Sequence[Case]) -> list[str]:
    """What speaks for and against each effect."""
    lines = [
        (
            f"`{j.effect}`",
            f"{len(j.named)} of {len(cases)}",
            "; ".join(j.against) or "nothing speaks against it",
        )
        for j in judge(cases)
    ]
    lines += _wanted(scenario, cases)
    text = section("What to believe")
    if lines:
        text += table(("effect", "rotations", "against it"), lines)
    else:
        text.append("No rotation names an effect.")
    return [*text, "", *_hits(scenario, cases), *_gap_in_words(cases)]


def _hits(scenario: Scenario, cases: Sequence[Case]) -> list[str]:
    """How near the numbers are that were made wrong on purpose."""
    lines = []
    for full, right in scenario.expected.items():
        own = [n[full] for n in map(numbers_of, cases) if full in n]
        if not own:
            continue
        inside = sum(n.ci95 is not None and n.ci95[0] <= right <= n.ci95[1] for n in own)
        off = max(abs(n.value / right - 1) for n in own)
        lines.append(
            f"- `{full}` was to be {right:g}: given by {len(own)} of {len(cases)} rotations, off "
            f"by {100 * off:.2g} % at most, inside the interval in {inside}."
        )
    return lines


def _wanted(scenario: Scenario, cases: Sequence[Case]) -> list[tuple[str, str, str]]:
    """Whether what was made wrong is found: a line where it is not named at all."""
    missed = {full.partition(".")[0] for full in scenario.expected}
    missed -= {e for c in cases for e in effects_of(c)}
    return [(f"`{e}`", f"0 of {len(cases)}", "made wrong on purpose, and missed") for e in missed]


def _gap_in_words(cases: Sequence[Case]) -> list[str]:
    """Where the effects help on every held-out flight, where a constant would, where they harm."""
    shown = [c for c in cases if c["channels"]]
    if not shown:
        return ["No gap could be shown."]
    names = [n for n in _names(shown[0]) if all(n in _names(c) for c in shown)]
    rows = {n: [next(r for r in c["channels"] if r["name"] == n) for c in shown] for n in names}
    helps = [n for n in names if all((r["shrink_ci95"][0] or 0) > 0 for r in rows[n])]
    beaten = [n for n in names if all(_constant_as_good(r) for r in rows[n])]
    worse = [n for n in names if any((r["shrink_ci95"][1] or 0) < 0 for r in rows[n])]
    most = max(names, key=lambda n: min(r["effects"] / max(r["floor"], 1e-30) for r in rows[n]))
    least = min(r["effects"] / max(r["floor"], 1e-30) for r in rows[most])
    return [
        f"- Shrinks beyond doubt on every held-out flight: {_listed(helps)}.",
        f"- Worse beyond doubt on at least one: {_listed(worse)}.",
        f"- The constant from the other flights does as well or better on every one: "
        f"{_listed(beaten)}.",
        f"- Farthest from its floor on every one: `{most}`, at least {least:.3g} times.",
    ]


def _names(case: Case) -> list[str]:
    return [c["name"] for c in case["channels"]]


def _constant_as_good(row: Mapping[str, Any]) -> bool:
    return row["fit_mean"] is not None and bool(row["fit_mean"] <= row["effects"])


def gap(case: Case) -> list[str]:
    """Channels of one held-out flight."""
    if not case["channels"]:
        return []
    lines = []
    for row in case["channels"]:
        factor, unit = in_shown_unit(1.0, row["unit"])
        values = ["-" if row[k] is None else figure(factor * row[k]) for k in COLUMNS]
        low, high = row["shrink_ci95"]
        shrink = "-" if low is None else f"{100 * low:.0f} to {100 * high:.0f} %"
        lines.append((f"`{row['name']}`", unit, str(row["n"]), *values, shrink))
    head = ("channel", "unit", "n", *COLUMNS.values(), "effects take")
    return [*section(f"Held out: {case['holdout']}"), *table(head, lines)]


def _listed(names: Sequence[str]) -> str:
    return ", ".join(f"`{n}`" for n in names) or "none"
