"""Headline of a result: one rule for every verb.

A headline gives a number only where its 95 % interval excludes "no effect" and the flights
determine it more than the prior (`Estimate.determined`). A new model that cannot fly is reported
first. Of the effects that act on the flight, and of sensors with a far larger error than usual,
what is far larger than expected leads, then what has the largest certain share of a force or moment
channel, even where the cause only resembles it; other sensors and records follow. An effect with
undetermined numbers is named without them, and a further sentence reports that. `Headline.numbers`
lists the numbers in the text, so that a program can compare them.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING

from twin.effects import EFFECTS, FAMILIES
from twin.effects.parameters import UNMEASURED
from twin.explain.balance import LOAD, ROTORS, VIBRATION, Balance, Hypothesis
from twin.explain.estimates import (
    detectable,
    estimates_of,
    listed_effects,
    nothing_probability,
    probability_of,
    reported_count,
    stochastic_effect,
    unasked,
    undecided,
)
from twin.explain.explanation import Explanation
from twin.explain.inference.estimate import Estimate, fitted_estimates
from twin.explain.inference.fit import INTERVAL, Fit
from twin.explain.inference.priors import effect_of
from twin.explain.inference.selection import APART, Naming
from twin.explain.weather import WIND
from twin.formatting import certainty, joined, number, percent, pretty_unit, quantity, title

from .record import Headline
from .wording import blind, clause, said, said_numbers, undetectable, undetermined, unit_of

if TYPE_CHECKING:
    from twin.explain.calibration import Calibrated

MOST_NUMBERS = 3
"""Largest number of an effect's numbers in a headline; of several effects, one each."""
MOST_EFFECTS = 3
"""Largest number of effects with numbers; of sensors beside what acts on the flight, one more."""
STRIKING = 3.0
"""Prior deviations of a number from which its effect leads, a sensor as well."""
MOST_VARIED = 2
"""Largest number of effects that differ between flights, and of flights for each."""


def headline(found: Explanation) -> Headline:
    """The result of `explain`, after a report that the new model cannot fly."""
    said = _answer(found)
    return Headline(grounded(found) + said.text, said.numbers)


def grounded(found: Explanation) -> str:
    """Sentence on a new model that cannot fly, with a trailing blank; "": it flies, or there is
    none."""
    if not found.lost:
        return ""
    those = "these changes" if found.verdict == "named" else "the numbers of these flights"
    missions = joined([m.name for m in found.lost], "or")
    return f"The model with {those} does not fly {missions} in closed loop. "


def _answer(found: Explanation) -> Headline:
    naming = found.naming
    if naming is None or found.verdict == "unusable":
        return Headline(f"These flights cannot be used: {'; '.join(found.reasons)}")
    if found.refuted:
        candidates = joined(_candidates(found))
        return Headline(f"These flights point to {candidates}, but {found.refuted}.")
    if found.since is not None:
        since = _since(found, naming)
        text = f"Since the calibration on {joined(list(found.since))}: {since.text}"
        named = found.verdict == "named" and not WIND.isdisjoint(listed_effects(found))
        return Headline(text + ("" if named else wind(naming.days)), since.numbers)
    if found.verdict == "nothing":
        sure = certainty(nothing_probability(found) or 0.0)
        text = f"Nothing detectable is missing from the model, {sure} probability."
        text += _varied(naming)
        return Headline(text + blind(detectable(found), False, unasked(found)))
    if found.verdict == "named":
        return _named(found, naming)
    if found.verdict == "unnamed":
        return Headline(f"The cause of the residual is {_outside(found)}.{_varied(naming)}")
    tied = _candidates(found)
    if not tied and found.reasons:
        reasons = "; ".join(found.reasons)
        text = f"No effect is detectable, but something is missing: {reasons}.{_varied(naming)}"
        return Headline(text)
    if (none := nothing_probability(found) or 0.0) > 0.01:
        tied.append(f"none ({certainty(none)})")
    if naming.outside > naming.settings.least:
        tied.append(f"a cause outside the library of effects ({certainty(naming.outside)})")
    text = f"Several causes are consistent with these flights: {joined(tied, 'or')}."
    return Headline(text + _varied(naming))


def _named(found: Explanation, naming: Naming) -> Headline:
    """Sentence on the named effects."""
    effects = [e for e in listed_effects(found) if e not in undecided(found)]
    lead = _acts_like(found, naming, effects)
    determined = {e: _determined_estimates(found, e) for e in effects}
    estimates = {e: own for e, (own, _) in determined.items()}
    shares = sure_shares(_shares(naming), estimates)
    first, later = leading(effects, shares, _determined(estimates), _striking(estimates))
    most = MOST_NUMBERS if len(first) == 1 else 1
    parts = [_phrase(found, e, estimates[e], most, flight=determined[e][1]) for e in first]
    apart = {e for e in first if determined[e][1]}
    text = (
        f"{lead}Missing from the model: {'; '.join(p.text for p in parts)}"
        f"{_sure(found, first)}{_varied(naming, apart)}{_which(naming)}{later}"
        f"{_what_else(found, effects)}"
        f"{_doubts(found, estimates)}{_undetectable(found, naming)}"
    )
    return Headline(text, tuple(n for p in parts for n in p.numbers))


def _determined_estimates(found: Explanation, effect: str) -> tuple[list[Estimate], str]:
    """Estimates of a listed effect for a headline, and of which flight they are; "": of all. One
    flight's are where only these determine a number: those of the largest change."""
    own, naming = estimates_of(found, effect), found.naming
    if naming is None or any(t.determined for t in own):
        return own, ""
    each = {
        f: naming.estimates(effect, reported_count(found), fit)
        for f, fit in naming.of_flights.items()
    }
    known = {f: [abs(t.change) for t in every if t.determined] for f, every in each.items()}
    flight = max(known, key=lambda f: max(known[f], default=0.0), default="")
    return (each[flight], flight) if known.get(flight) else (own, "")


def _undetectable(found: Explanation, naming: Naming) -> str:
    """`undetectable` for numbers that vehicle files seldom have and the text does not mention;
    uncertain numbers of this file are calibrated instead."""
    priors = naming.problem.priors
    said = {*listed_effects(found), *(r.effect for r in naming.resemblances), *priors.unsure}
    said |= {e for t in naming.standing.values() for e in t.effects}
    seldom_known = {effect_of(c) for c, odds in priors.odds.items() if odds >= UNMEASURED} - said
    smallest = {e: d for e, d in naming.detectable.items() if e in seldom_known}
    return undetectable(smallest, dict(zip(priors.names, priors.slab, strict=True)))


def varied(
    days: Mapping[str, Mapping[str, tuple[float, float]]],
    usual: Mapping[str, float],
    without: Collection[str],
) -> str:
    """Numbers of an aircraft that differ between flights by far more than usual, for outlying
    flights; with a leading blank, "" for none, and for one flight.

    Args:
        days: Flight -> "effect.number" -> difference from the others, and its deviation.
        usual: Standard deviation between flights, by "effect.number".
        without: Effects that are omitted.
    """
    apart: dict[str, dict[str, float]] = {}
    for flight, own in days.items():
        for name, (difference, _) in own.items():
            known = _of_aircraft(name) and name.partition(".")[0] not in without
            if known and abs(difference) > APART * usual[name]:
                apart.setdefault(name, {})[flight] = difference
    if not apart or len(days) < 2:
        return ""
    far = {n: max(map(abs, own.values())) / usual[n] for n, own in apart.items()}
    texts = []
    for name in sorted(far, key=lambda n: -far[n])[:MOST_VARIED]:
        effect, _, number_name = name.partition(".")
        unit = unit_of(effect, number_name)
        each = sorted(apart[name].items(), key=lambda item: -abs(item[1]))[:MOST_VARIED]
        where = [f"{'+' * (v > 0)}{quantity(v, unit)} in {f}" for f, v in each]
        texts.append(f"{title(effect)} ({joined(where)})")
    return f" Between these flights differs {joined(texts)}."


def _of_aircraft(name: str) -> bool:
    """Whether a number, "effect.number", is of the aircraft; else of a log or the weather."""
    effect, _, own = name.partition(".")
    about = EFFECTS[effect]
    return not about.of_weather and any(own.startswith(p.name) for p in about.parameters)


def _varied(naming: Naming, named: Collection[str] = ()) -> str:
    """`varied` without effects that are told, and those that the cause only resembles."""
    usual = dict(zip(naming.problem.priors.names, naming.problem.usual, strict=True))
    return varied(naming.days, usual, {*named, *(r.effect for r in naming.resemblances)})


def _which(naming: Naming) -> str:
    """Undetermined part of a family of effects whose presence is certain; with a leading blank."""
    parts = [
        (t.family.name, joined([title(e) for e in t.effects if e != effect]))
        for effect, t in naming.standing.items()
    ]
    return "".join(f" How much of the {a} is {b}, these flights do not tell." for a, b in parts)


def _shares(naming: Naming) -> dict[str, tuple[float, str]]:
    """Largest share of a force or moment channel and that channel, by effect; an effect that
    represents its family has the share of the family."""
    none = (0.0, "")
    whole = {
        e: max(naming.shares.get(m, none) for m in t.effects) for e, t in naming.standing.items()
    }
    return {**naming.shares, **whole}


def leading(
    effects: Sequence[str],
    shares: Mapping[str, tuple[float, str]],
    determined: Collection[str],
    striking: Collection[str] = (),
) -> tuple[list[str], str]:
    """Leading effects of a headline, and a sentence on the others, with a leading blank.

    Those that act on the flight, and sensors with an unusually large error, come first: what is
    far larger than expected, then by the certain share of a force or moment channel. The first
    leads, and the others follow if their numbers are determined.

    Args:
        effects: Named effects.
        shares: Largest share and its channel, by effect.
        determined: Effects with a number that a headline may give.
        striking: Named effects with a number far from its prior.
    """

    def large(effect: str) -> bool:
        return effect in striking and EFFECTS[effect].of_vehicle

    share = {e: round(shares.get(e, (0.0, ""))[0], 3) for e in effects}
    leads = [e for e in effects if EFFECTS[e].in_the_air or large(e)]
    order = sorted(effects, key=lambda e: (e not in leads, not large(e), -share[e]))
    alike = order[: len(leads)] or order
    known = [alike[0], *(e for e in alike[1:] if e in determined)]
    air = [e for e in known if EFFECTS[e].in_the_air][:MOST_EFFECTS]
    sensors = [e for e in known if not EFFECTS[e].in_the_air][: 1 if air else MOST_EFFECTS]
    first = [e for e in known if e in {*air, *sensors}]
    later = [e for e in order if e not in first]
    return first, f" Further: {joined([title(e) for e in later])}." if later else ""


def sure_shares(
    shares: Mapping[str, tuple[float, str]], estimates: Mapping[str, Sequence[Estimate]]
) -> dict[str, tuple[float, str]]:
    """Certain shares of a force or moment channel by effect: from the most significant number at
    the end of its interval nearest to no effect. One that may be zero has no certain share.

    Args:
        shares: Largest share and its channel, by effect.
        estimates: Numbers of each effect; an effect without numbers keeps all of its share.
    """
    least = {e: max((_nearest(t) for t in own), default=1.0) for e, own in estimates.items()}
    return {e: (least.get(e, 1.0) ** 2 * size, channel) for e, (size, channel) in shares.items()}


def _nearest(estimate: Estimate) -> float:
    """Nearest end of the interval of a change over the change; 0 where it may be zero."""
    low, high = estimate.ci95 or (0.0, 0.0)
    if not estimate.determined or estimate.no_effect is None:
        return 0.0
    return min(abs(low - estimate.no_effect), abs(high - estimate.no_effect)) / abs(estimate.change)


def _determined(estimates: Mapping[str, Sequence[Estimate]]) -> set[str]:
    """Effects with a number for a headline, and those without any number."""
    return {e for e, own in estimates.items() if not own or any(t.determined for t in own)}


def _striking(estimates: Mapping[str, Sequence[Estimate]]) -> set[str]:
    """Effects with a number for a headline that is far larger than expected."""
    return {
        e
        for e, own in estimates.items()
        if any(t.determined and (t.tension or 0.0) > STRIKING for t in own)
    }


def _acts_like(found: Explanation, naming: Naming, named: Sequence[str]) -> str:
    """Sentence on a cause with a larger share of a force or moment channel than all named effects,
    although it only resembles an effect; with a trailing blank, "" for none."""
    share = {r.effect: naming.shares.get(r.effect, (0.0, "")) for r in naming.resemblances}
    if not share:
        return ""
    effect = max(share, key=lambda e: share[e][0])
    size, channel = share[effect]
    shares = _shares(naming)
    if size <= max((shares.get(e, (0.0, ""))[0] for e in named), default=0.0):
        return ""
    why = next(r.why for r in naming.resemblances if r.effect == effect)
    return (
        f"{title(effect).capitalize()} would explain {percent(size)} of the residual in {channel}, "
        f"but is not named: {why}. "
    )


def _phrase(
    found: Explanation, effect: str, estimates: Sequence[Estimate], most: int, flight: str = ""
) -> Headline:
    """An effect with its numbers for a headline; `flight`: the only one that they are of."""
    stochastic = stochastic_effect(found, effect)
    if stochastic is None:
        size = sizes(effect, estimates, most)
        if flight:
            return Headline(amount(effect, f"{size.text} in {flight}, and changes between flights"))
        return Headline(amount(effect, size.text), size.numbers)
    given = [t for t in estimates if t.determined or t.number.shape][:most]
    texts = [f"{t.number.name} = {quantity(t.value, t.number.about.unit)}" for t in given]
    where = f"{title(effect)} in {', '.join(stochastic.channels)}"
    numbers = tuple(t.number.full for t in given)
    return Headline(where + (f": {joined(texts)}" if texts else ""), numbers)


def amount(effect: str, size: str) -> str:
    """An effect and its size: a number follows the name, a clause is in brackets."""
    if not size or not size[0].isalpha():
        return f"{called(effect)} {size}".rstrip()
    return f"{called(effect)} ({size.removeprefix('it is ')})"


def called(effect: str) -> str:
    """An effect by the name of its family, if any, and its own."""
    family = next((f for f in FAMILIES if effect in f.effects), None)
    if family is None or effect == family.first:
        return title(effect)
    return f"{family.name} by {title(effect)}"


def sizes(effect: str, estimates: Sequence[Estimate], most: int, since: bool = False) -> Headline:
    """Size of an effect by its determined numbers: a clause where there is one and the vehicle
    lacks the effect, else the most significant numbers, each with unit and meaning.

    Args:
        effect: Identifier.
        estimates: Numbers of the effect.
        most: Largest number of numbers without a clause.
        since: Whether it is a change since a calibration.
    """
    known = {t.number.name: t for t in estimates if t.determined}
    change = said_numbers(effect, {k: t.change for k, t in known.items()})
    known = {k: known[k] for k in change}
    new = since or all(t.no_effect == t.number.about.neutral for t in known.values())
    full = tuple(t.number.full for t in known.values())
    if new and (words := clause(effect, change, since)):
        return Headline(words, full)
    clearest = sorted(known.values(), key=lambda t: -abs(t.change) / _width(t))[:most]
    return Headline(joined([_number(t) for t in clearest]), tuple(t.number.full for t in clearest))


def _width(estimate: Estimate) -> float:
    low, high = estimate.ci95 or (0.0, 0.0)
    return max(high - low, 1e-300)


def _number(estimate: Estimate) -> str:
    """A number with unit and meaning, and with the value in the file."""
    about, name = estimate.number.about, estimate.number.name
    index = name.removeprefix(about.name).lstrip("_")
    which = f" of rotor {index}" if about.per_rotor else ""
    text = f"{quantity(estimate.value, about.unit)} ({about.description}{which}"
    if estimate.no_effect != about.neutral and estimate.no_effect is not None:
        text += f"; {quantity(estimate.no_effect, about.unit)} in the vehicle file"
    return f"{text})"


def _candidates(found: Explanation, without: Collection[str] = ()) -> list[str]:
    """Listed effects without some, each with its probability."""
    listed = [e for e in listed_effects(found) if e not in without]
    return [f"{title(e)} ({certainty(probability_of(found, e))})" for e in listed]


def _sure(found: Explanation, effects: Sequence[str]) -> str:
    """Probability of names, between a comma and a stop: of several the smallest one."""
    least = certainty(min(probability_of(found, e) for e in effects))
    if len(effects) == 1:
        return f", {least} probability."
    return f", {least} probability or more each."


def _outside(found: Explanation) -> str:
    """Text on a cause without a name."""
    if found.unnamed:
        first = found.unnamed[0]
        return (
            f"not in the library of effects: in {first.channel}, {first.expression} explains "
            f"{100 * first.share:.0f} % of the residual"
        )
    alike = [] if found.naming is None else [r.effect for r in found.naming.resemblances]
    if found.naming is not None:
        shares = found.naming.shares
        alike.sort(key=lambda e: -shares.get(e, (0.0, ""))[0])
    like = f", but resembles {joined([title(e) for e in alike], 'or')}" if alike else ""
    return f"not in the library of effects{like}"


def _since(found: Explanation, naming: Naming) -> Headline:
    """Change since the calibration, a clause with a final stop."""
    if found.verdict == "nothing":
        sure = certainty(nothing_probability(found) or 0.0)
        text = f"no change is detectable, {sure} probability.{_varied(naming)}"
        return Headline(text + blind(detectable(found), True, unasked(found)))
    if found.verdict == "unnamed":
        return Headline(f"the cause of the change is {_outside(found)}.{_varied(naming)}")
    if found.verdict == "named":
        effects = [e for e in listed_effects(found) if e not in undecided(found)]
        determined = {e: _determined_estimates(found, e) for e in effects}
        estimates = {e: own for e, (own, _) in determined.items()}
        shares = sure_shares(_shares(naming), estimates)
        first, later = leading(effects, shares, _determined(estimates), _striking(estimates))
        parts = [
            _phrase(found, e, estimates[e], 1)
            if (own := stochastic_effect(found, e)) is not None and not own.before
            else _change(naming, e, *determined[e])
            for e in first
        ]
        apart = {e for e in first if determined[e][1]}
        text = (
            f"{joined([p.text for p in parts])}{_sure(found, first)}{_varied(naming, apart)}{later}"
            f"{_what_else(found, effects)}{_doubts(found, estimates)}"
        )
        return Headline(text, tuple(n for p in parts for n in p.numbers))
    if found.balance is not None and (found.balance.one_of or naming.verdict == "nothing"):
        return Headline(_of_balance(found.balance) + _varied(naming))
    tied, numbers = [], []
    for fit, p in zip(naming.fitted, naming.probabilities, strict=True):
        if p >= naming.settings.least:
            parts = [_change(naming, e, _fitted(naming, fit, e)) for e in fit.effects]
            text = joined([part.text for part in parts]) or "nothing has changed"
            tied.append(f"{text} ({certainty(p)})")
            numbers += [n for part in parts for n in part.numbers]
    if naming.outside > naming.settings.least:
        tied.append(f"a cause outside the library of effects ({certainty(naming.outside)})")
    head = "several causes are" if len(tied) > 1 else "one cause is"
    text = f"{head} consistent with these flights: {joined(tied, 'or')}.{_varied(naming)}"
    return Headline(text, tuple(dict.fromkeys(numbers)))


def _of_balance(balance: Balance) -> str:
    """Possible changes in the balance, where it is one of several: first the position, then the
    causes."""
    tied = {h.cause for h in balance.one_of}
    each = [f"{_in_words(h)} ({certainty(h.probability)})" for h in balance.one_of]
    if LOAD in tied and ROTORS not in tied:
        return f"{joined(each, 'or')}. These flights cannot tell which."
    if tied and LOAD not in tied:
        return (
            f"a propeller is damaged ({certainty(balance.damaged)}): {joined(each, 'or')}. "
            f"These flights cannot tell which."
        )
    rotors, load = balance.best(ROTORS), balance.best(LOAD)
    causes = [
        (_in_words(rotors), balance.damaged),
        (_in_words(load), balance.probability_of(LOAD)),
    ]
    ranked = [f"{text} ({certainty(p)})" for text, p in sorted(causes, key=lambda c: -c[1])]
    if balance.one_of:
        more = joined(
            [f"rotor {i} must give {percent(balance.more[i - 1])}" for i in rotors.rotors]
        )
        return (
            f"{more} more thrust than at calibration: {joined(ranked, 'or')}. These flights cannot "
            f"tell which."
        )
    none = f"nothing has changed ({certainty(balance.nothing)})"
    return f"either {joined([none, *ranked], 'or')}: these flights cannot tell."


def _in_words(hypothesis: Hypothesis) -> str:
    """A cause, with its size."""
    if hypothesis.cause == VIBRATION:
        return "one vibrates and none has lost thrust"
    return said(hypothesis.cause, _by_number(hypothesis), since=True)


def _by_number(hypothesis: Hypothesis) -> dict[str, float]:
    """Changes with the numbers' own names."""
    return {n.partition(".")[2]: v for n, v in hypothesis.values.items()}


def _fitted(naming: Naming, fit: Fit, effect: str) -> list[Estimate]:
    """Numbers of an effect in one of several hypotheses."""
    return fitted_estimates(fit, naming.problem.priors, effect)


def _change(
    naming: Naming, effect: str, estimates: Sequence[Estimate], flight: str = ""
) -> Headline:
    """Clause on the change of an effect since the calibration, with alternative rotors; `flight`:
    as of `_phrase`."""
    change = {t.number.name: t.change for t in estimates if t.determined}
    if not change:
        return Headline(f"{title(effect)} has changed")
    numbers = said_numbers(effect, change)
    own = [t for t in estimates if t.number.name in numbers]
    words = said(effect, change, since=True) + _within(own)
    rotors = {c.partition(":")[2] for c in naming.one_of(effect) if c.startswith(f"{effect}:")}
    named = {r for r in rotors if f"rotor {r} " in words}
    if len(rotors) > 1 and named:
        words += f" (or another one of rotors {joined(sorted(rotors), 'and')})"
    if flight:
        return Headline(f"{words} in {flight}, and changes between flights")
    return Headline(words, tuple(f"{effect}.{name}" for name in numbers))


def _within(estimates: Sequence[Estimate]) -> str:
    """Half of the 95 % interval of a change that is one number with a unit, or a wind; with a
    leading blank, "" for any other."""
    units = {t.number.about.unit for t in estimates}
    weather = all(EFFECTS[t.number.effect].of_weather for t in estimates)
    if len(units) != 1 or "1" in units or not (weather or len(estimates) == 1):
        return ""
    size = math.hypot(*(t.change for t in estimates))
    half = math.hypot(*(t.change / size * _width(t) / 2 for t in estimates))
    return f" (± {quantity(float(f'{half:.2g}'), units.pop())})"


def _what_else(found: Explanation, sure: Sequence[str]) -> str:
    """Further present causes besides the certain effects; with a leading blank."""
    if not undecided(found):
        return ""
    assert found.naming is not None
    least = found.naming.settings.least
    placed = {r.effect for r in found.naming.resemblances} | {*sure}
    placed |= {e for t in found.naming.standing.values() for e in t.effects}
    every = {e for f in found.naming.fitted for e in f.effects} - placed
    chance = {e: probability_of(found, e) for e in sorted(every)}
    likely = sorted((e for e in chance if chance[e] >= least), key=lambda e: -chance[e])
    if not likely:
        return ""
    tied = joined([f"{title(e)} ({certainty(chance[e])})" for e in likely], "or")
    return f" Also possible: {tied}."


def _doubts(found: Explanation, estimates: Mapping[str, Sequence[Estimate]]) -> str:
    """Evidence against the numbers of named effects; with a leading blank."""
    known = _determined(estimates)
    none = [
        e
        for e, own in estimates.items()
        if e not in known and all(t.may_be_none for t in own if t.no_effect is not None)
    ]
    return undetermined(none, [e for e in estimates if e not in known and e not in none])


def calibrated_headline(found: "Calibrated", lead: str) -> Headline:
    """Headline of a calibration.

    Args:
        found: Result of the fit.
        lead: Main clause, without a stop.
    """
    own: dict[str, list[Estimate]] = {}
    for t in found.estimates.values():
        if EFFECTS[t.number.effect].of_vehicle and abs(t.change) > t.number.about.smallest:
            own.setdefault(t.number.effect, []).append(t)
    known = _determined(own)
    effects = [e for e in own if e in known]
    if not effects:
        return Headline(f"{lead}.")
    first, _ = leading(effects, sure_shares(found.shares, own), known)
    parts = [_calibrated(e, own[e]) for e in first]
    numbers = tuple(n for p in parts for n in p.numbers)
    return Headline(f"{lead}: {'; '.join(p.text for p in parts)}.", numbers)


def _calibrated(effect: str, estimates: Sequence[Estimate]) -> Headline:
    """An effect of the aircraft by its determined numbers, a clause with its own subject."""
    change = {t.number.name: t.change for t in estimates if t.determined}
    names = said_numbers(effect, change)
    size = clause(effect, change, since=False)
    words = amount(effect, size) if size else said(effect, change, since=False)
    return Headline(words, tuple(f"{effect}.{n}" for n in names))


def wind(days: Mapping[str, Mapping[str, tuple[float, float]]]) -> str:
    """The strongest outlying mean wind of a flight; with a leading blank, "" for none.

    Args:
        days: Flight -> "effect.number" -> difference from the calibration, and its deviation.
    """
    blown = {
        flight: [own[n] for n in own if n.partition(".")[0] in WIND] for flight, own in days.items()
    }
    speeds = {f: math.hypot(*(v for v, _ in parts)) for f, parts in blown.items() if parts}
    if not speeds:
        return ""
    flight = max(speeds, key=lambda f: speeds[f])
    speed = speeds[flight]
    sd = math.hypot(*(v / speed * sd for v, sd in blown[flight]))
    half = quantity(float(f"{INTERVAL * sd:.2g}"), "m/s")
    return f" The wind in {flight} was {quantity(float(f'{speed:.3g}'), 'm/s')} (± {half})."


def got_worse(found: Explanation) -> str:
    """The channel of the held-out flights with the largest increase, in one sentence; "" for
    none."""
    worse = [g for g in (found.comparison.gaps if found.comparison else ()) if g.worse]
    if not worse:
        return ""
    worst = max(worse, key=lambda g: g.after / g.before if g.before > 0 else 0.0)
    others = f", and in {len(worse) - 1} further" if len(worse) > 1 else ""
    return (
        f"On the held-out flights the residual in {worst.name} increases from "
        f"{number(worst.before)} to {number(worst.after)} {pretty_unit(worst.unit)} rms{others}."
    )
