"""What was found about a model, in sentences that a pilot understands."""

from collections.abc import Mapping, Sequence
from typing import Any

from twin.effects import EFFECTS
from twin.explain.estimates import (
    UNTOLD,
    beside_mean,
    calibrated_effects,
    estimates_of,
    listed_effects,
    may_be_none,
    nothing_probability,
    probability_of,
    undecided,
)
from twin.explain.explanation import Explanation
from twin.explain.holdout import ChannelGap
from twin.explain.inference.fit import Fit
from twin.explain.inference.selection import Naming
from twin.explain.model.numbers import Number
from twin.explain.settings import DEFAULT, InferenceSettings
from twin.vehicle import Vehicle

from .figures import pretty_unit
from .gap import number, percent
from .spoken import clause, joined, said

TOLD_BY_PRIOR = "told by the prior"

MOST_NUMBERS = 3
"""Numbers of an effect that the sentence on top gives; of several effects, one each."""
MOST_EFFECTS = 3
"""Effects that it gives numbers of."""
CLEAR, SMALL = 1.5, 0.05
"""It gives those that differ from no effect by more than so many half widths of their intervals,
and by more than this share of the largest number of their unit."""


def claim(found: Explanation) -> str:
    """The answer in one sentence."""
    naming = found.naming
    if naming is None or found.verdict == "unusable":
        return f"These flights cannot be used: {'; '.join(found.reasons)}"
    if found.refuted:
        return f"These flights point to {joined(_candidates(found))}, but {found.refuted}."
    if found.since is not None:
        return f"Since the calibration on {joined(list(found.since))}: {_since(found, naming)}"
    if found.verdict == "nothing":
        sure = certainty(nothing_probability(naming))
        return f"The model lacks nothing that these flights can show ({sure} sure)."
    if found.verdict == "named":
        effects = [e for e in listed_effects(found) if e not in undecided(found)]
        first, later = headline(effects)
        most = MOST_NUMBERS if len(first) == 1 else 1
        parts = [f"{title(e)}{_sizes(found, e, most)}" for e in first]
        return (
            f"The model lacks {'; '.join(parts)} {_sure(found, first)}{later}"
            f"{_what_else(found, effects)}{_doubts(found, effects)}"
        )
    if found.verdict == "unnamed":
        return f"The model lacks something {_outside(found)}."
    tied = _candidates(found)
    if nothing_probability(naming) > 0.01:
        tied.append(f"nothing at all ({certainty(nothing_probability(naming))})")
    if naming.outside > naming.settings.least:
        tied.append(f"something not in the library of effects ({certainty(naming.outside)})")
    return f"These flights cannot tell what the model lacks: {joined(tied, 'or')}."


def _candidates(found: Explanation) -> list[str]:
    """Effects that are told about, each with its probability."""
    return [f"{title(e)} ({certainty(probability_of(found, e))})" for e in listed_effects(found)]


def _sure(found: Explanation, effects: Sequence[str]) -> str:
    """How sure names are, in brackets and with a stop: of several the least sure one counts."""
    least = certainty(min(probability_of(found, e) for e in effects))
    return f"({least} sure)." if len(effects) == 1 else f"(each {least} sure or more)."


def _outside(found: Explanation) -> str:
    """What is known of something without a name; begins with a relative clause."""
    if found.unnamed:
        first = found.unnamed[0]
        return (
            f"that is not in the library of effects: in {first.channel} it is {first.expression}, "
            f"{100 * first.share:.0f} % of the gap there"
        )
    alike = [] if found.naming is None else [title(r.effect) for r in found.naming.resemblances]
    like = f" It acts like {joined(alike, 'or')}" if alike else ""
    return f"that is not in the library of effects.{like}".rstrip(".")


def _since(found: Explanation, naming: Naming) -> str:
    """What has changed since the calibration, a clause that ends in a stop."""
    if found.verdict == "nothing":
        sure = certainty(nothing_probability(naming))
        return f"nothing has changed that these flights can show ({sure} sure)."
    if found.verdict == "unnamed":
        return f"something has changed {_outside(found)}."
    if found.verdict == "named":
        effects = [e for e in listed_effects(found) if e not in undecided(found)]
        first, later = headline(effects)
        parts = [
            f"{title(e)}{_sizes(found, e, 1)}"
            if beside_mean(found, e) is not None
            else _change(found, naming.told, e)
            for e in first
        ]
        return (
            f"{joined(parts)} {_sure(found, first)}{later}{_what_else(found, effects)}"
            f"{_doubts(found, effects)}"
        )
    tied = []
    for fit, p in zip(naming.fitted, naming.probabilities, strict=True):
        if p >= naming.settings.least:
            parts = [_change(found, fit, e) for e in fit.effects]
            tied.append(f"{joined(parts) or 'nothing has changed'} ({certainty(p)})")
    if naming.outside > naming.settings.least:
        tied.append(f"something not in the library has changed ({certainty(naming.outside)})")
    return (
        f"either {joined(tied, 'or')}: these flights cannot tell."
        if len(tied) > 1
        else (f"it may be that {joined(tied)}: these flights cannot tell.")
    )


def _change(found: Explanation, fitted: Fit, effect: str) -> str:
    """How an effect has changed since the calibration, and which rotors it may be as well."""
    naming = found.naming
    assert naming is not None
    b = naming.problem.beliefs
    then = {n: float(v) for n, v in zip(b.names, b.now + b.held, strict=True)}
    own = [n for n in fitted.numbers if n.effect == effect and not n.shape]
    change = {n.name: fitted.values[n.full] - then.get(n.full, n.now) for n in own}
    words = said(effect, change, since=True)
    rotors = {c.partition(":")[2] for c in naming.one_of(effect) if c.startswith(f"{effect}:")}
    named = {r for r in rotors if f"rotor {r} " in words}
    if len(rotors) > 1 and named:
        words += f" (or another one of rotors {joined(sorted(rotors), 'and')})"
    return words


def instead(found: Explanation, effect: str) -> str:
    """What else may stand in the place of an effect, in words; "" where nothing may."""
    if found.naming is None or beside_mean(found, effect) is not None:
        return ""
    parts = []
    for cause in found.naming.one_of(effect):
        other, _, rotor = cause.partition(":")
        parts.append(f"{title(other)}{f' of rotor {rotor}' if rotor else ''}")
    return joined(parts, "or")


def by_prior(found: Explanation, share: float | None) -> str:
    """What is said beside a number of which flights say little; "" of others."""
    if share is None or share <= UNTOLD:
        return ""
    return TOLD_BY_PRIOR if found.since is None else "told by the calibration"


def calibrated_rows(found: Explanation) -> list[tuple[str, str, str, str, str]]:
    """Numbers that were in doubt, and that lack nothing beyond that: number, value, unit, interval,
    whether flights tell it."""
    return [
        (
            t.number.full,
            number(t.value),
            _unit(t.number).strip(),
            interval(t.ci95),
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
    units = {n.full: _unit(n).strip() for n in found.naming.problem.model.numbers}
    return [
        (flight, name, f"{value:+.3g}", units[name], number(sd))
        for flight, own in found.naming.days.items()
        for name, (value, sd) in own.items()
    ]


def _what_else(found: Explanation, sure: list[str]) -> str:
    """What is there beside the sure effects, where something is; begins with a blank."""
    if not undecided(found):
        return ""
    assert found.naming is not None
    least = found.naming.settings.least
    every = {e for f in found.naming.fitted for e in f.effects} - set(sure)
    chance = {e: probability_of(found, e) for e in sorted(every)}
    likely = sorted((e for e in chance if chance[e] >= least), key=lambda e: -chance[e])
    tied = joined([f"{title(e)} ({certainty(chance[e])})" for e in likely], "or")
    return f" Beside that, these flights cannot tell what it lacks: {tied}."


def headline(effects: Sequence[str]) -> tuple[list[str], str]:
    """Effects that lead, those that change the flight before those of sensors and record; and a
    sentence about the others, which begins with a blank."""
    in_order = sorted(effects, key=lambda e: not EFFECTS[e].in_the_air)
    first, later = in_order[:MOST_EFFECTS], in_order[MOST_EFFECTS:]
    if EFFECTS[first[0]].in_the_air:
        later += [e for e in first if not EFFECTS[e].in_the_air]
        first = [e for e in first if EFFECTS[e].in_the_air]
    return first, f" Further: {joined([title(e) for e in later])}." if later else ""


def _doubts(found: Explanation, named: Sequence[str]) -> str:
    """What speaks against a name or its numbers all the same; begins with a blank."""
    said = ""
    if vague := [title(e) for e in named if may_be_none(found, e)]:
        verb = "is" if len(vague) == 1 else "are"
        said += f" These flights do not tell how large {joined(vague)} {verb}, if not next to none."
    if lost := [m.name for m in found.missions if not m.stable]:
        said += f" The model with it does not fly {joined(lost)} in closed loop."
    return said


def title(effect: str) -> str:
    """Name of an effect in words."""
    return effect.replace("_", " ")


def meaning(effect: str) -> str:
    """What an effect is, in one line."""
    return EFFECTS[effect].meaning if effect in EFFECTS else ""


def _sizes(found: Explanation, effect: str, most: int) -> str:
    """What an effect amounts to, with a colon before it; nothing where it has no numbers."""
    beside = beside_mean(found, effect)
    if beside is None:
        assert found.naming is not None
        return f": {sizes(found.naming.told, effect, found.vehicle, most)}"
    texts = [
        f"{t.number.name} = {number(t.value)}{_unit(t.number)}" for t in estimates_of(found, effect)
    ]
    return f" in {', '.join(beside.channels)}" + (f": {joined(texts[:most])}" if texts else "")


def _unit(of: Number) -> str:
    """Unit behind a value."""
    return "" if of.about.unit == "1" else f" {pretty_unit(of.about.unit)}"


def sizes(fitted: Fit, effect: str, vehicle: Vehicle, most: int = MOST_NUMBERS) -> str:
    """What an effect amounts to by its numbers that stand out: a clause where there is one and the
    vehicle has nothing of it, else `most` of the numbers, each with unit and meaning."""
    clear = _standing_out(fitted, effect)
    moved = [n for n in clear if not n.shape]
    change = {n.name: fitted.values[n.full] - n.now for n in moved}
    new = all(n.now == n.about.neutral for n in moved)
    if new and (words := clause(effect, change, since=False)):
        return words
    texts = []
    for n in clear[:most]:
        index = n.name.removeprefix(n.about.name).lstrip("_")
        which = f" of rotor {index}" if n.about.per_rotor else ""
        value = number(fitted.values[n.full])
        texts.append(f"{value}{_unit(n)} ({n.about.description}{which})")
    return joined(texts)


def _standing_out(fitted: Fit, effect: str) -> list[Number]:
    """The numbers of an effect that differ from none, or all; the clearest first."""
    own = [n for n in fitted.numbers if n.effect == effect]
    width = {n.full: float(w) for n, w in zip(fitted.numbers, fitted.half_widths, strict=True)}
    away = {n.full: abs(fitted.values[n.full] - n.now) for n in own}
    largest = {
        u: max(away[n.full] for n in own if n.about.unit == u) for u in {n.about.unit for n in own}
    }
    clear = [
        n for n in own if away[n.full] > max(CLEAR * width[n.full], SMALL * largest[n.about.unit])
    ]
    return sorted(clear or own, key=lambda n: -away[n.full] / max(width[n.full], 1e-300))


def certainty(probability: float) -> str:
    """A probability as people say it: never all, never nothing."""
    if probability > 0.99:
        return "99 %" if probability < 0.995 else "more than 99 %"
    return "less than 1 %" if probability < 0.01 else f"{100 * probability:.0f} %"


def interval(ci95: tuple[float, float] | None) -> str:
    """95 % interval of a number; a dash where there is none."""
    return "\N{EN DASH}" if ci95 is None else " to ".join(map(number, ci95))


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
