"""The page: protocol, what was named, gaps of the held-out flights, what to believe."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from twin.residuals.channels import CHANNEL_HZ

from .agreement import Case, Number, agreement, effects_of, judge, numbers_of
from .scenarios import Scenario

HEAD = Path(__file__).with_name("protocol.md").read_text("utf-8")
MICRO = {"T": ("µT", 1e6)}
"""Units that are shown in millionths."""
COLUMNS = {
    "none": "none",
    "effects": "effects",
    "fit_mean": "fit mean",
    "own_mean": "own mean",
    "last_20_ms": "last, 20 ms",
    "last_500_ms": "last, 0.5 s",
    "floor": "floor",
}


def page(found: Sequence[tuple[Scenario, Sequence[Case]]]) -> str:
    """The whole document, from the rotations of each scenario."""
    parts = [HEAD.format(rate=CHANNEL_HZ), *overview(found)]
    for scenario, cases in found:
        parts += ["", f"## {scenario.title}", "", scenario.about, *rotations(cases)]
        parts += numbers(scenario, cases)
        parts += believe(scenario, cases)
        for case in cases:
            parts += gap(case)
    every = [c for _, cases in found for c in cases]
    states = ", ".join(sorted({c["twin"] for c in every}))
    minutes = sum(c["seconds"] for c in every) / 60
    parts += ["", f"State of `twin/`: {states}. Time spent: {minutes:.0f} minutes of one core."]
    return "\n".join(parts) + "\n"


def overview(found: Sequence[tuple[Scenario, Sequence[Case]]]) -> list[str]:
    """All scenarios in a table."""
    lines = []
    for scenario, cases in found:
        judged = judge(cases)
        always = [f"`{j.effect}`" for j in judged if len(j.named) == len(cases)]
        stand = [f"`{j.effect}`" for j in judged if not j.against]
        verdicts = [c["said"]["verdict"] for c in cases]
        told = ", ".join(f"{verdicts.count(v)} {v}" for v in dict.fromkeys(verdicts))
        lines.append((scenario.title, told, ", ".join(always) or "-", ", ".join(stand) or "-"))
    head = ("scenario", "verdicts", "in every rotation", "of these, nothing speaks against")
    return ["## Overview", "", *_table(head, lines)]


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
                "-" if nothing is None else f"{nothing:.2f}",
                "; ".join(_equation(u) for u in said.get("unnamed", [])) or "-",
            )
        )
        remarks += [f"- {case['holdout']} held out: {r}" for r in _remarks(said)]
    head = ("held out", "verdict", "effects, probability", "nothing", "equations beyond them")
    return ["", *_table(head, lines), *(["", *remarks] if remarks else [])]


def _equation(unnamed: Mapping[str, Any]) -> str:
    return f"`{unnamed['expression']}` ({100 * unnamed['share']:.0f} %)"


def _remarks(said: Mapping[str, Any]) -> list[str]:
    """What `explain` warns of, except for what the tables show."""
    lines = [said["error"]] if "error" in said else list(said["reasons"])
    lines += [w for w in said.get("warnings", []) if "edge of the range" not in w]
    if said.get("next_manoeuvre"):
        lines.append(f"to fly next: {said['next_manoeuvre']['description']}")
    return lines


def numbers(scenario: Scenario, cases: Sequence[Case]) -> list[str]:
    """Every number that a rotation gives."""
    each = [numbers_of(c) for c in cases]
    lines = []
    for full in dict.fromkeys([*scenario.expected, *(k for numbers in each for k in numbers)]):
        own = [n[full] for n in each if full in n]
        cells = [_number(n.get(full)) for n in each]
        right = scenario.expected.get(full)
        unit = MICRO.get(own[0].unit, (own[0].unit, 1.0))[0] if own else "-"
        truth = [] if not scenario.expected else ["-" if right is None else f"{right:g}"]
        agree = agreement(own) if own else "never given"
        lines.append((f"`{full}`", unit, *truth, *cells, agree))
    if not lines:
        return []
    wanted = ["wanted"] if scenario.expected else []
    head = ("number", "unit", *wanted, *(f"without {c['holdout']}" for c in cases), "agree")
    return ["", *_table(head, lines)]


def _number(number: Number | None) -> str:
    if number is None:
        return "-"
    _, factor = MICRO.get(number.unit, ("", 1.0))
    text = f"{_figure(factor * number.value)}{'' if number.edge is None else '*'}"
    if number.ci95 is None:
        return text
    low, high = (_figure(factor * end) for end in number.ci95)
    return f"{text} ({low} to {high})"


def _figure(value: float) -> str:
    """Three significant digits; no exponent where a person would write none."""
    return f"{value:.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:.3g}"


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
    text = ["", "### What to believe", ""]
    if lines:
        text += _table(("effect", "rotations", "against it"), lines)
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
        unit, factor = MICRO.get(row["unit"], (row["unit"], 1.0))
        values = ["-" if row[k] is None else _figure(factor * row[k]) for k in COLUMNS]
        low, high = row["shrink_ci95"]
        shrink = "-" if low is None else f"{100 * low:.0f} to {100 * high:.0f} %"
        lines.append((f"`{row['name']}`", unit, str(row["n"]), *values, shrink))
    head = ("channel", "unit", "n", *COLUMNS.values(), "effects take")
    return ["", f"### Held out: {case['holdout']}", "", *_table(head, lines)]


def _listed(names: Sequence[str]) -> str:
    return ", ".join(f"`{n}`" for n in names) or "none"


def _table(head: Sequence[str], lines: Iterable[Sequence[str]]) -> list[str]:
    """A Markdown table."""
    content = [
        f"| {' | '.join(c.replace('|', '&#124;') for c in line)} |" for line in (head, *lines)
    ]
    return [content[0], "|" + "---|" * len(head), *content[1:]]
