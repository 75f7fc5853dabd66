"""Tables of the page beyond rms: what rotations agree on, bands, constants, what is wished for."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from twin.effects.air import LINEAR_DRAG

from .agreement import Agreement, Case, Number, agreements, alike_of, numbers_of
from .measure import NAMES, about_mean, above
from .scenarios import Scenario

MICRO = {"T": ("µT", 1e6)}
"""Units that are shown in millionths."""


def in_shown_unit(value: float, unit: str) -> tuple[float, str]:
    """A value in the unit that people read, and that unit."""
    name, factor = MICRO.get(unit, (unit, 1.0))
    return factor * value, name


def figure(value: float) -> str:
    """Three significant digits; no exponent where a person would write none."""
    return f"{value:.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:.3g}"


def interval(value: float, ci95: tuple[float, float] | None, unit: str, mark: str = "") -> str:
    """A number with its interval, in the unit that people read."""
    text = f"{figure(in_shown_unit(value, unit)[0])}{mark}"
    if ci95 is None:
        return text
    low, high = (figure(in_shown_unit(end, unit)[0]) for end in ci95)
    return f"{text} ({low} to {high})"


def section(title: str) -> list[str]:
    """A heading below that of a scenario."""
    return ["", f"### {title}", ""]


def table(head: Sequence[str], lines: Iterable[Sequence[str]]) -> list[str]:
    """A Markdown table."""
    content = [
        f"| {' | '.join(c.replace('|', '&#124;') for c in line)} |" for line in (head, *lines)
    ]
    return [content[0], "|" + "---|" * len(head), *content[1:]]


CORRECTIONS = {
    "none": "none",
    "effects": "effects",
    "fit_mean": "fit mean",
    "own_mean": "own mean",
    "floor": "floor",
}
TURNING = "gyro_rate_"
DRAG = LINEAR_DRAG.weights
"""Numbers that are a drag linear in the speed, and what makes them one in 1/s."""
TOLD = (*((full, k, "1/s") for full, k in DRAG.items()), ("motor_lag.tau_s", 1000.0, "ms"))
"""Numbers told rotation by rotation, by what they are multiplied, and their unit then."""
CLOCKS = "clocks of the pose by flight, ms"
RETURNED = "Drag, lag, clocks, missions, and angular acceleration about its mean"
"""Heading of the table that the short page shows, too."""


# -- which numbers agree --------------------------------------------------------------------


def agree(scenario: Scenario, cases: Sequence[Case]) -> list[str]:
    """Which numbers agree over the rotations, how many of them pass, and what acts like what."""
    found = {a.full: a for a in agreements(cases)}
    holdouts = [c["holdout"] for c in cases]
    lines = []
    for full in dict.fromkeys([*scenario.expected, *found]):
        a = found.get(full, Agreement(full, {}))
        unit = in_shown_unit(1.0, next((n.unit for n in a.by.values()), "-"))[1]
        right = scenario.expected.get(full)
        wanted = [] if not scenario.expected else ["-" if right is None else f"{right:g}"]
        facts = (
            _yes(a.same_sign),
            _yes(a.overlap),
            *map(_listed, (a.edges, a.undetermined)),
        )
        cells = [_number(a.by.get(h)) for h in holdouts]
        lines.append((f"`{full}`", unit, *wanted, *cells, *facts, _passed(a)))
    head = (
        *("number", "unit"),
        *(["wanted"] if scenario.expected else []),
        *(f"without {h}" for h in holdouts),
        *("same sign", "intervals overlap", "at edge", "mostly prior", "passes"),
    )
    shown = table(head, lines) if lines else ["No rotation gives a number."]
    every = list(found.values())
    return [*section("Which numbers agree"), *shown, "", *_summary(every), *_alike(cases)]


def _listed(holdouts: Sequence[str]) -> str:
    return ", ".join(holdouts) or "no"


def _passed(a: Agreement) -> str:
    if not a.by:
        return "never given"
    return ("yes" if a.passes else "no") if a.compared else "one rotation"


def _yes(answer: bool | None) -> str:
    return {True: "yes", False: "no", None: "-"}[answer]


def _number(number: Number | None) -> str:
    if number is None:
        return "-"
    mark = "" if number.edge is None else "*"
    return interval(number.value, number.ci95, number.unit, mark)


def passing(every: Sequence[Agreement]) -> tuple[int, int, int]:
    """How many numbers pass, how many were compared, how many one rotation alone gives."""
    compared = [a for a in every if a.compared]
    return sum(a.passes for a in compared), len(compared), len(every) - len(compared)


def _summary(every: Sequence[Agreement]) -> list[str]:
    good, compared, alone = passing(every)
    lean = sum(a.passes and bool(a.undetermined) for a in every)
    by_effect: dict[str, list[Agreement]] = {}
    for a in every:
        by_effect.setdefault(a.full.partition(".")[0], []).append(a)
    whole = [f"`{e}`" for e, own in by_effect.items() if all(a.passes for a in own)]
    return [
        f"- Of {compared} numbers that more than one rotation gives, {good} pass, {lean} of them "
        f"mostly by their prior; {alone} are given by one rotation alone.",
        f"- Effects all of whose numbers pass: {len(whole)} of {len(by_effect)} named or listed in "
        f"any rotation: {', '.join(whole) or 'none'}.",
    ]


def _alike(cases: Sequence[Case]) -> list[str]:
    """What something acts like, in each rotation."""
    lines = [
        f"- {c['holdout']} held out: something acts like `{effect}`: {why}"
        for c in cases
        for effect, why in alike_of(c).items()
    ]
    return lines or ["- Nothing merely acts like an effect."]


# -- bands and constants of a held-out flight -----------------------------------------------


def by_band(case: Case) -> list[str]:
    """Angular acceleration of one held-out flight by band."""
    lines = [
        (
            f"`{row['name']}`",
            band,
            *(_shown(row["bands"].get(k), i) for k in CORRECTIONS),
        )
        for row in _turning(case)
        for i, band in enumerate((*NAMES, "**> 0.8 Hz**"))
    ]
    if not lines:
        return []
    head = ("channel, rad/s²", "band", *CORRECTIONS.values())
    return ["", "By band:", "", *table(head, lines)]


def _shown(bands: Sequence[float] | None, i: int) -> str:
    """Rms of a band; of all but the slowest for the line after the last."""
    if bands is None:
        return "-"
    return figure(bands[i] if i < len(bands) else above(bands))


def _turning(case: Case) -> list[Mapping[str, Any]]:
    return [r for r in case["channels"] if r["name"].startswith(TURNING)]


def constants(case: Case) -> list[str]:
    """Mean of every channel of one held-out flight, and what is left about it."""
    shown = {k: v for k, v in CORRECTIONS.items() if k != "own_mean"}
    lines = []
    for row in case["channels"]:
        unit = in_shown_unit(1.0, row["unit"])[1]
        means = [_scaled(row["mean"].get(k), row["unit"]) for k in shown]
        left = [_scaled(v, row["unit"]) for v in (row["own_mean"], _about(row, "effects"))]
        lines.append((f"`{row['name']}`", unit, *means, *left))
    if not lines:
        return []
    heads = [f"mean, {name}" for name in shown.values()]
    head = ("channel", "unit", *heads, "rms about own mean, none", "the same, effects")
    return ["", "Constants:", "", *table(head, lines)]


def _about(row: Mapping[str, Any], correction: str) -> float:
    return about_mean(row[correction], row["mean"][correction])


def _scaled(value: float | None, unit: str) -> str:
    return "-" if value is None else figure(in_shown_unit(value, unit)[0])


# -- what is wished for ---------------------------------------------------------------------


def wishes(scenario: Scenario, cases: Sequence[Case]) -> list[str]:
    """Drag, lag, clocks, missions and angular acceleration about its mean, where a scenario has a
    goal for that."""
    goal = scenario.turning_goal_rad_s2
    if goal is None:
        return []
    axes = [f"{TURNING}{a}" for a in "xyz"]
    lines = []
    for case in cases:
        rows = {r["name"]: r for r in _turning(case)}
        said = [_left(rows[a], goal) if a in rows else "-" for a in axes]
        rule = case["braking"]
        drag = figure(drag_1_s(case)), "-" if rule is None else figure(rule)
        parts = [_told(case, full, k, unit) for full, k, unit in TOLD]
        lines.append((case["holdout"], *drag, *parts, _clocks(case), _flown(case), *said))
    head = (
        *("held out", "drag, 1/s", "by least squares"),
        *(f"`{full.partition('.')[0]}`, if there" for full, _, _ in TOLD),
        *(CLOCKS, "missions flown"),
        *(f"`{a}`, rad/s²" for a in axes),
    )
    text = (
        f"Drag: {' and '.join(f'{k:.3g} times `{full}`' for full, k in DRAG.items())} together, "
        f"means over all sets; beside it the trivial rule, least squares of specific force on "
        f"velocity. Lag: on top of the file's. Angular acceleration: rms about its mean with the "
        f"effects, and without; wished for: at most {goal:g} rad/s²; *: more."
    )
    return [*section(RETURNED), text, "", *table(head, lines)]


def drag_1_s(case: Case) -> float:
    """Drag linear in the speed that predicts best, 1/s, at the rotor speed of hover."""
    return float(sum(k * case["predicted"].get(full, 0.0) for full, k in DRAG.items()))


def _left(row: Mapping[str, Any], goal: float) -> str:
    """What effects leave about the mean, a star where that is more than the goal, and what there
    is without them."""
    left = _about(row, "effects")
    return f"{figure(left)}{'' if left <= goal else '*'} of {figure(row['own_mean'])}"


def _told(case: Case, full: str, k: float, unit: str) -> str:
    """A number where its effect is there, its interval and the probability of the effect."""
    effect = full.partition(".")[0]
    number = numbers_of(case, {effect}).get(full)
    if number is None:
        return "-"
    ci95 = None if number.ci95 is None else (k * number.ci95[0], k * number.ci95[1])
    chance = case["said"].get("inclusion", {}).get(effect, 0)
    return f"{interval(k * number.value, ci95, unit)}, probability {chance:.2f}"


def _clocks(case: Case) -> str:
    """Of each flight that was fitted, ms; "0" where none stands out."""
    days = case["said"].get("per_flight", {}).values()
    own = (d.get("clock_offset.pose_s", {}).get("difference", 0.0) for d in days)
    return ", ".join(f"{1000 * v:+.0f}" if v else "0" for v in own) or "-"


def _flown(case: Case) -> str:
    """How many of the missions the corrected twin flies."""
    loop = case["said"].get("closed_loop")
    if loop is None:
        return "-"
    flown = [m["stable"] for m in loop["missions"].values()]
    return f"{sum(flown)} of {len(flown)}"
