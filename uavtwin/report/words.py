"""What was found about a model, in sentences that a pilot understands."""

from collections.abc import Mapping
from typing import Any

from twin.effects import EFFECTS
from twin.explain.estimates import (
    UNDETERMINED,
    calibrated_effects,
    estimates_of,
    stochastic_effect,
)
from twin.explain.explanation import Explanation
from twin.explain.holdout import ChannelGap
from twin.explain.settings import DEFAULT, InferenceSettings

from ..formatting import joined, number, number_cells, percent, pretty_unit, readable, title

SET_BY_PRIOR = "set by the prior"


def instead(found: Explanation, effect: str) -> str:
    """What else may stand in the place of an effect, in words; "" where nothing may."""
    if found.naming is None or stochastic_effect(found, effect) is not None:
        return ""
    parts = []
    for cause in found.naming.one_of(effect):
        other, _, rotor = cause.partition(":")
        parts.append(f"{title(other)}{f' of rotor {rotor}' if rotor else ''}")
    return joined(parts, "or")


def by_prior(found: Explanation, share: float | None) -> str:
    """Remark on a number that the prior rather than the flights sets; "" of others."""
    if share is None or share <= UNDETERMINED:
        return ""
    return SET_BY_PRIOR if found.since is None else "set by the calibration"


def calibrated_rows(found: Explanation) -> list[tuple[str, str, str, str, str]]:
    """Numbers that were in doubt, and that lack nothing beyond that: number, value, unit, interval,
    whether flights tell it."""
    return [
        (
            t.number.full,
            *number_cells(t.value, t.number.about.unit, t.ci95),
            by_prior(found, t.prior_share),
        )
        for e in calibrated_effects(found)
        for t in estimates_of(found, e)
        if not t.number.shape
    ]


def day_rows(found: Explanation) -> list[tuple[str, str, str, str, str]]:
    """What stands out of the day of a flight: flight, number, difference, unit, deviation."""
    if found.naming is None:
        return []
    units = {n.full: n.about.unit for n in found.naming.problem.model.numbers}
    rows = []
    for flight, own in found.naming.days.items():
        for name, pair in own.items():
            (value, sd), unit = readable(units[name], *pair)
            rows.append((flight, name, f"{value:+.3g}", unit, number(sd)))
    return rows


def meaning(effect: str) -> str:
    """What an effect is, in one line."""
    return EFFECTS[effect].meaning if effect in EFFECTS else ""


def why_lost(rival: Mapping[str, Any], settings: InferenceSettings = DEFAULT.inference) -> str:
    """Why another explanation, of `rivals`, was not chosen."""
    if rival["name"] == "nothing":
        return "leaves the whole gap open" if "behind" in rival else "does not look like this"
    if rival["probability"] >= settings.selection.least:
        return "explains the flights about as well: they cannot tell the two apart"
    partners = f"together with {joined([title(e) for e in rival['with']])} " * bool(rival["with"])
    return f"{partners}is less probable: log probability lower by {rival['behind']:.1f}"


def shrinking(found: Explanation) -> str:
    """What the held-out flights say, in one sentence."""
    if found.comparison is None or found.shown is None:
        return ""
    clear = [g for g in found.comparison.gaps if g.shrink_ci95[0] > 0]
    if not clear:
        return "On the held-out flights no channel got clearly better."
    best = max(clear, key=lambda g: g.before / g.noise_floor)
    floor = number(best.noise_floor)
    return (
        f"On the held-out flights the gap in {best.name} falls from {number(best.before)} to "
        f"{number(best.after)} {pretty_unit(best.unit)} rms; noise is {floor}."
    )


def shrink_words(gap: ChannelGap) -> str:
    """Interval by which a gap shrank; a dash where it is not known, nothing where none is."""
    if gap.before == gap.after:
        return ""
    low, high = gap.shrink_ci95
    return f"{percent(low)} to {percent(high)}" if low == low else "\N{EN DASH}"
