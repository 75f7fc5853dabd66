"""The whole search: from flights and a vehicle to the missing effects, and their validation."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeVar

import numpy as np

from ..effects import EFFECTS, RandomForce
from ..errors import LogError, ModelError
from ..flight.closed_loop import Mission, fly_missions
from ..formatting import joined
from ..logs import AnyFlight, Flight, Site
from ..representation import ShortRepr
from ..residuals.flight_gap import HoverDiagnosis, diagnosis_of
from ..residuals.measured import clock_doubt
from ..residuals.teacher_forced import drive_warnings, driven_by
from ..vehicle import Vehicle
from .balance import (
    CAUSES,
    LOAD,
    VIBRATION,
    Balance,
    Normal,
    balance_of,
    changed_by,
    channels_of_balance,
    trim_of,
)
from .design import Suggestion, next_manoeuvre
from .holdout import (
    Attribution,
    Comparison,
    Place,
    Span,
    attribute_effect,
    compare_holdout,
    farther_by,
    held_out_spans,
    hidden,
    localize,
)
from .inference.adequacy import coherent
from .inference.fit import Fit
from .inference.priors import UNCALIBRATED
from .inference.search import NO_CHECKPOINT, Checkpoint
from .inference.selection import Naming, Resemblance, Verdict, name_effects
from .model.model import channel_names
from .model.numbers import Payloads, visible, with_effects
from .settings import DEFAULT, SearchSettings
from .stochastic.search import Stuck, find_stochastic, find_stuck, stuck_channels, without_stuck
from .stochastic.spectral import StochasticEffect
from .unnamed import Equation, Unnamed, explains_better, find_equations
from .usable import flown, part_read, usable_part, with_readings
from .weather import WIND, Wind, acting_of, hanging_of, uncertain, wind_of

DIGITS = 6
"""Significant digits of a fitted number."""
UNKNOWN_SITE = (
    "not known whether {} flew indoors or outdoors, taken for outdoors: say which by --indoor or "
    "--outdoor, in Python by indoors=True or False"
)  # warning; completed with names of flights
UNSTABLE = "the model with what was named does not fly {} in closed loop: {}"
"""Warning text, with mission and problem."""
REFUTED = "with it held-out flights are farther from the model in {}, and in forces as a whole"
"""Reason why an effect is not named; completed with forces and moments."""
FARTHER = "flights that were held out are farther from the model with it than without"
"""Reason why names are withdrawn."""
WEAKER = (
    "no flight was held out: one block of time in {} of the same flights stands in for one, "
    "which is weaker, because what one flight has in common is in both parts"
)  # warning; completed with one in how many blocks


@dataclass(frozen=True, slots=True)
class HeldOut:
    """A held-out flight, or held-out time spans of a flight."""

    flight: str
    spans: tuple[Span, ...] | None = None


@dataclass(frozen=True, slots=True)
class Explanation(ShortRepr):
    """Result of the search for what a model lacks.

    Attributes:
        verdict: Verdict, one of a fixed list of words.
        vehicle: Nominal model.
        flights: Names of the flights used in the fit.
        reasons: Reasons for the verdict "unusable", and for "cannot_tell" without a candidate.
        warnings: Warnings, the most severe first.
        naming: Candidate models and their probabilities; None where nothing could be fitted.
        shown: Model average: all effects that may be present, with their mean numbers over all
            candidate models; it predicts best, and its gap is shown; None: no effect with a mean.
        stochastic: Zero-mean effects that were found as well.
        values: Numbers of all these effects, "effect.number" -> value.
        comparison: Held-out flights before and after; None where nothing could be held out.
        attributions: Channels and phases in which each effect of `shown` acts.
        where: Channels and phases with the largest residuals.
        holdout: Held-out flights or time spans.
        missions: Closed-loop flights of the new model; empty where no effect was added.
        refuted: Reason why names were withdrawn, a text after "but"; "": they were not.
        unnamed: Equations for what no effect explains.
        next_manoeuvre: Suggested manoeuvre for the next flight.
        settings: Settings of the search.
        since: Flights of the calibration since which changes are searched; None: what the model
            lacks is searched.
        recorded: All flights as read, including stuck readings.
        balance: Change of the balance of forces and moments since the calibration; None: not
            searched, or not observable in these flights.
        hovers: Diagnosis of the nominal model in hover, for each flight with a hover.
        driven_by: Drive of the model in each flight, and the reason for it.
    """

    verdict: Verdict
    vehicle: Vehicle
    flights: tuple[str, ...]
    reasons: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    naming: Naming | None = None
    shown: Fit | None = None
    stochastic: tuple[StochasticEffect, ...] = ()
    values: Mapping[str, float] = field(default_factory=dict)
    comparison: Comparison | None = None
    attributions: tuple[Attribution, ...] = ()
    where: tuple[Place, ...] = ()
    holdout: tuple[HeldOut, ...] = ()
    missions: tuple[Mission, ...] = ()
    refuted: str = ""
    unnamed: tuple[Equation, ...] = ()
    next_manoeuvre: Suggestion | None = None
    settings: SearchSettings = DEFAULT
    since: tuple[str, ...] | None = None
    recorded: tuple[AnyFlight, ...] = ()
    hovers: tuple[HoverDiagnosis, ...] = ()
    balance: Balance | None = None
    driven_by: Mapping[str, str] = field(default_factory=dict)

    @property
    def effects(self) -> tuple[str, ...]:
        """All effects with `values`."""
        steady = () if self.shown is None else self.shown.effects
        return (*steady, *(u.effect for u in self.stochastic))

    @property
    def added(self) -> Vehicle | None:
        """The model with the missing effects and the fitted uncertain numbers; None where nothing
        is named and nothing was uncertain, and where nothing has changed since a calibration. Its
        numbers are no longer those of the calibration."""
        conclusive = ("named",) if self.since is not None else ("named", "nothing")
        if self.verdict not in conclusive or not self.effects:
            return None
        unsure = frozenset() if self.naming is None else self.naming.problem.priors.unsure
        if self.verdict == "nothing" and not {*self.effects} & unsure:
            return None
        made = with_effects(self.vehicle, self.effects, self.values)
        return replace(made, calibration=None)

    @property
    def lost(self) -> tuple[Mission, ...]:
        """Missions that the new model does not complete."""
        return tuple(m for m in self.missions if not m.stable)


def explain(
    flights: Sequence[AnyFlight],
    holdout: Sequence[AnyFlight],
    vehicle: Vehicle,
    seed: int = 0,
    progress: Callable[[float], None] = lambda _: None,
    missions: Sequence[str] | None = None,
    payloads: Payloads | None = None,
    settings: SearchSettings = DEFAULT,
    indoors: bool | None = None,
    since: bool = False,
    suggest: bool = True,
    checkpoint: Checkpoint = NO_CHECKPOINT,
) -> Explanation:
    """Find what a model lacks, and validate it.

    Args:
        flights: Flights for the fit.
        holdout: Held-out flights for the comparison; none: time blocks of the flights are held out.
        vehicle: Nominal model.
        seed: Random seed of every bootstrap.
        progress: Called with the share done, 0..1.
        missions: Missions to fly with the new model; default: all.
        payloads: Known payload masses of flights of either kind.
        settings: Settings that determine the result.
        indoors: Whether all flights were indoors; None: as each flight states.
        since: Whether to search changes since the vehicle's calibration, with its numbers and their
            covariance as prior; otherwise everything that the model may lack.
        suggest: Whether to suggest a manoeuvre for the next flight.
        checkpoint: Stores the progress of the searches.

    Raises:
        ModelError: The vehicle contains no calibration from which to search changes.
    """
    calibrated = calibrated_on(vehicle) if since else None
    cut = [[part_read(sited(f, indoors), settings.usable) for f in s] for s in (flights, holdout)]
    read, away = ([f for f, _ in some] for some in cut)
    partly = [note for some in cut for _, note in some if note is not None]
    driven = [text for f in (*read, *away) for text in drive_warnings(f, vehicle)]
    stuck = [s for f in (*read, *away) for s in stuck_channels(f, settings.stochastic.stuck)]
    fit, held = ([without_stuck(f, stuck) for f in some] for some in (read, away))
    fit, held, spared, unread, notes = _parts(fit, held, vehicle, payloads, settings)
    found = Explanation(
        "unusable",
        vehicle,
        tuple(f.name for f in fit or flights),
        reasons=tuple(() if fit else unread),
        warnings=(*partly, *driven, *notes),
        holdout=spared,
        settings=settings,
        since=calibrated,
        recorded=(*read, *away),
    )
    if not fit:
        return found
    try:
        channels = _balanced(fit, vehicle, payloads) if since else None
        naming = name_effects(
            fit,
            vehicle,
            seed,
            lambda done: progress(0.6 * done),
            payloads,
            settings.inference,
            since,
            CAUSES if channels else (),
            channels or (),
            checkpoint,
        )
    except LogError as error:
        return replace(found, reasons=(str(error),))
    names = [f.name for f in flights]
    wind = wind_of(naming.problem, naming.posterior) if since else None
    if channels is not None:
        found = _with_balance(found, naming, wind)
    found = _with_wind(found, naming, wind)
    found = _named(found, naming, [s for s in stuck if s.flight in names])
    found = replace(
        found,
        warnings=(*found.warnings, *_not_observable(naming), *_drifting(naming)),
        hovers=hovers_of(found.recorded, vehicle),
        driven_by={f.name: driven_by(f, vehicle) for f in (*fit, *held)},
    )
    progress(0.65)
    found = _with_equations(found, seed)
    progress(0.75)
    gap = partial(_with_gap, held=held, seed=seed, payloads=payloads)
    found = _without_refuted(gap(found), seed, gap)
    progress(0.85)
    if suggest and found.verdict in ("named", "cannot_tell"):
        found = replace(found, next_manoeuvre=next_manoeuvre(naming, vehicle))
    return _with_missions(found, missions, lambda done: progress(0.85 + 0.15 * done))


def _with_missions(
    found: Explanation, missions: Sequence[str] | None, progress: Callable[[float], None]
) -> Explanation:
    """The explanation with closed-loop flights of the new model in calm air, where there is one."""
    if found.added is None:
        return found
    own = {e: v for e, v in found.added.effects.items() if not EFFECTS[e].of_weather}
    calm = replace(found.added, effects=own)
    flying = replace(found, missions=fly_missions(calm, missions, progress))
    lost = [UNSTABLE.format(m.name, m.problem) for m in flying.lost]
    return replace(flying, warnings=(*lost, *found.warnings))


def calibrated_on(vehicle: Vehicle) -> tuple[str, ...]:
    """Names of the flights on which a vehicle was calibrated.

    Raises:
        ModelError: The vehicle contains no calibration.
    """
    if vehicle.calibration is None:
        raise ModelError(UNCALIBRATED.format(vehicle.name))
    return vehicle.calibration.flights


def _parts(
    flights: Sequence[Flight],
    holdout: Sequence[Flight],
    vehicle: Vehicle,
    payloads: Payloads | None,
    settings: SearchSettings,
) -> tuple[list[Flight], list[Flight], tuple[HeldOut, ...], list[str], list[str]]:
    """The usable flights; where none is held out, time blocks of each are.

    Returns:
        Flights for the fit; held-out flights; these or their spans, for the report; reasons why
        flights were not used in the fit; warnings.
    """
    (fit, reasons), (held, left_out) = (
        usable_of(some, vehicle, payloads, settings) for some in (flights, holdout)
    )
    if not fit:
        return [], [], (), reasons, []
    warnings = [f"left out: {reason}" for reason in reasons + left_out]
    if unknown := [f.name for f in (*fit, *held) if f.indoors is None]:
        warnings.append(UNKNOWN_SITE.format(", ".join(unknown)))
    if held:
        return fit, held, tuple(HeldOut(f.name) for f in held), [], warnings
    both = [(f, held_out_spans(f, settings.holdout)) for f in fit]
    (fit, unread), (held, none_left) = (
        with_readings([hidden(f, s, inside) for f, s in both], vehicle, payloads)
        for inside in (True, False)
    )
    warnings += [
        WEAKER.format(settings.holdout.spared_every),
        *(f"left out: {reason}" for reason in unread),
        *(f"left out of what is held out: {reason}" for reason in none_left),
    ]
    return fit, held, tuple(HeldOut(f.name, tuple(s)) for f, s in both), unread, warnings


_F = TypeVar("_F", bound=AnyFlight)


def sited(flight: _F, indoors: bool | None) -> _F:
    """The flight marked as indoors or outdoors; None: unchanged."""
    return flight if indoors is None else replace(flight, site=Site(indoors, "as told"))


def hovers_of(flights: Sequence[AnyFlight], vehicle: Vehicle) -> tuple[HoverDiagnosis, ...]:
    """Diagnosis of a vehicle's twin in hover, for each flight with a hover."""
    found = (diagnosis_of(f, vehicle) for f in flights)
    return tuple(h for h in found if h is not None)


def _not_observable(naming: Naming) -> list[str]:
    """Warning that some effects are not part of the model with this drive; empty where all are."""
    hidden = ", ".join(naming.problem.model.unobservable)
    why = "where measured rotor speeds drive the model, which leave no command to look at"
    return [f"not visible {why}: {hidden}"] if hidden else []


def _drifting(naming: Naming) -> list[str]:
    """Warning for each flight in which the clocks of attitude and gyroscope drift apart."""
    found = []
    for flight in naming.problem.model.flights:
        motion = flight.aligned.motion
        if motion.rates_measured and motion.attitude is not None and motion.rates is not None:
            doubts = clock_doubt(motion.attitude, motion.rates)
            found += [f"{flight.flight.name}: {text}" for text in doubts]
    return found


def usable_of(
    flights: Sequence[Flight], vehicle: Vehicle, payloads: Payloads | None, settings: SearchSettings
) -> tuple[list[Flight], list[str]]:
    """Usable parts of flights, and a text for each omitted part or flight."""
    found = [usable_part(f, flown(f, vehicle, payloads), settings.usable) for f in flights]
    fit, unread = with_readings([part for part, _, no in found if not no], vehicle, payloads)
    return fit, [text for _, less, no in found for text in (no or less)] + unread


def _named(found: Explanation, naming: Naming, stuck: Sequence[Stuck]) -> Explanation:
    """The explanation with the effects that were found, and their numbers."""
    shown, settings = naming.shown if naming.shown.effects else None, found.settings.stochastic
    model, steady = naming.whitened.model, naming.shown.values
    every = (*find_stuck(stuck, settings), *find_stochastic(model, steady, settings))
    stochastic = (*found.stochastic, *_beyond(found, every))
    naming = replace(naming, further=len(stochastic))
    return _as_named(replace(found, stochastic=stochastic, shown=shown), naming)


def _as_named(found: Explanation, naming: Naming, alike: Sequence[Resemblance] = ()) -> Explanation:
    """The explanation with the result of a search, and `alike` added to its resemblances; where an
    effect is named, resembled ones are removed from those shown."""
    new = alike or naming.resemblances
    naming = replace(naming, resemblances=(*naming.resemblances, *alike))
    verdict = _verdict(naming, found.balance, found.stochastic)
    reasons: tuple[str, ...] = ()
    if verdict == "nothing" and found.since is None and naming.unexplained:
        verdict = "cannot_tell"  # something acts on the aircraft, but it is unknown what
        where = joined(list(naming.unexplained))
        reasons = (f"the model leaves more in {where} than sensor and pose do of each other",)
    shown, gone = found.shown, {r.effect for r in naming.resemblances if verdict == "named"}
    if shown is not None and gone:
        shown = replace(shown, effects=tuple(e for e in shown.effects if e not in gone))
    steady = {} if shown is None else shown.values
    exact = dict(steady) | {k: v for u in found.stochastic for k, v in u.values.items()}
    exact = {k: v for k, v in exact.items() if k.partition(".")[0] not in gone}
    return replace(
        found,
        verdict=verdict,
        reasons=reasons,
        naming=naming,
        shown=shown,
        values={k: float(f"{v:.{DIGITS}g}") for k, v in exact.items()},
        warnings=(*(f"something acts like {r.effect}: {r.why}" for r in new), *found.warnings),
    )


def _beyond(found: Explanation, every: Sequence[StochasticEffect]) -> list[StochasticEffect]:
    """The zero-mean effects that are present; since a calibration with vibration, the balance
    decides whether it has increased."""
    known = found.vehicle.calibration
    judged = found.balance is not None and known is not None and VIBRATION in known.means
    return [u for u in every if u.log_odds > 0 and not (judged and u.effect == VIBRATION)]


def _verdict(
    naming: Naming, balance: Balance | None, stochastic: Sequence[StochasticEffect]
) -> Verdict:
    """Verdict from the search, the balance and the zero-mean effects."""
    verdict = naming.verdict
    shakes = stochastic and (balance is None or verdict in ("nothing", "unnamed"))
    if shakes or any(u.before for u in stochastic):
        return "named"
    if balance is None or verdict == "named":
        return verdict
    if verdict == "nothing" and balance.nothing < balance.sure:
        return "cannot_tell"
    return "cannot_tell" if balance.one_of else verdict


def _balanced(
    flights: Sequence[Flight], vehicle: Vehicle, payloads: Payloads | None
) -> tuple[str, ...] | None:
    """Channels of the balance that all flights have, as of `channels_of_balance`."""
    if not all(visible(EFFECTS[e], flights) for e in CAUSES):
        return None
    every = [set(channel_names(f, flown(f, vehicle, payloads))) for f in flights]
    return channels_of_balance(set.intersection(*every))


def _with_wind(found: Explanation, naming: Naming, wind: Wind | None) -> Explanation:
    """The explanation with a wind that is certainly stronger than usual, where the search
    attributed it to day-to-day variation."""
    if wind is None or wind.stronger < naming.settings.sure or not WIND.isdisjoint(naming.named):
        return found
    effect = next(iter(wind.change)).partition(".")[0]
    blows = changed_by(effect, wind.change, wind.stronger, found.vehicle, ())
    return replace(found, stochastic=(*found.stochastic, blows))


def _with_balance(found: Explanation, naming: Naming, wind: Wind | None) -> Explanation:
    """The explanation with the change of the balance of forces and moments."""
    model = naming.problem.model
    others = acting_of(naming.shown, naming.named)
    if wind is not None and wind.stronger >= 0.5:
        others |= wind.values
    trim = trim_of(model, {n: value for n, (value, _) in others.items()})
    if trim is None:
        return found
    indoors = all(f.flight.indoors for f in model.flights)
    normal = Normal.of(trim, found.vehicle, indoors)
    if others:
        calm = not any(n.partition(".")[0] in WIND for n in others)
        doubt = uncertain(model, trim.channels, others) + calm * normal.disturbed
        normal = replace(normal, disturbed=doubt)
    balance = balance_of(trim, normal, naming.settings.sure)
    if balance.probability_of(LOAD) >= 0.5 and all(n.partition(".")[0] in WIND for n in others):
        balance = replace(balance, hanging=hanging_of(naming, balance.best(LOAD)))
    if (named := balance.named) is None:
        return replace(found, balance=balance)
    change = {n: (named.values[n], sd) for n, sd in named.deviations.items()}
    effect = changed_by(named.cause, change, named.probability, found.vehicle, trim.channels)
    return replace(found, balance=balance, stochastic=(effect,))


def _with_equations(found: Explanation, seed: int) -> Explanation:
    """The explanation with equations, where they explain more than any effect of the library.

    Since a calibration, equations never overrule a named effect, the verdict that nothing has
    changed, or a change of the balance; they must exceed what the calibration flights had, and
    contain no mean. None is sought for a model that lacks many effects at once.
    """
    naming = found.naming
    assert naming is not None
    if found.since is not None and _answers(found, naming):
        return found
    if len(naming.best.effects) > found.settings.inference.adequacy.most:
        return found
    if any(isinstance(EFFECTS[u.effect].observable_as, RandomForce) for u in found.stochastic):
        return found  # a random force has no equation
    whitened, settings = naming.whitened, found.settings.unnamed
    stands = _stands(naming)
    noise, names = naming.problem.noise, naming.problem.rest.channels
    mute = frozenset(names[c] for c in noise.mute)
    alone = find_equations(whitened, stands, seed, settings, mute, means=found.since is None)
    if alone is None or not explains_better(whitened, naming.likely, alone, settings, stands):
        return found
    if found.since is not None and not _new(found, naming, stands, alone):
        return found
    return replace(
        found,
        verdict="unnamed",
        reasons=(),
        shown=None,
        stochastic=(),
        values={},
        unnamed=alone.equations,
    )


def _answers(found: Explanation, naming: Naming) -> bool:
    """Whether a search or a balance decides what has changed since a calibration, or that nothing
    has."""
    if "named" in (found.verdict, naming.verdict) or naming.verdict == "nothing":
        return True
    return found.balance is not None and found.balance.changed >= found.balance.sure


def _new(found: Explanation, naming: Naming, stands: Fit, alone: Unnamed) -> bool:
    """Whether at least half of the power of an equation exceeds what calibration flights had."""
    known, settings = found.vehicle.calibration, found.settings.inference.adequacy
    usual = {} if known is None else known.left
    model = naming.problem.model
    every = zip(*stands.on_its_days(model).channels([], stands.values), strict=True)
    power = {own[0].name: coherent(own, settings)[0] for own in every}
    return any(
        power[e.channel] - usual.get(e.channel, 0.0) ** 2 > 0.5 * e.rms**2 for e in alone.equations
    )


def _stands(naming: Naming) -> Fit:
    """The model with corrections that get no name: uncertain numbers of the file, and effects that
    are present but too small to be named."""
    b = naming.problem.priors
    there = {c for c, p in naming.posterior.inclusion.items() if p >= 0.5}
    rows = zip(b.names, b.spike, b.cause, strict=True)
    known = [n for n, sd, cause in rows if sd > 0 or cause in there]
    named, shown = naming.best.effects, naming.shown
    values = {n: shown.values[n] for n in known if n in shown.values}
    values = {n: v for n, v in values.items() if n.partition(".")[0] not in named}
    return replace(naming.nothing, values=values, days=(naming.nothing if named else shown).days)


def _without_refuted(
    found: Explanation, seed: int, with_gap: Callable[[Explanation], Explanation]
) -> Explanation:
    """The explanation without effects that improve the fit but not the held-out flights; no effect
    with a mean is named where this holds for each of them, or for all together."""
    naming, compared, settings = found.naming, found.comparison, found.settings.holdout
    if naming is None or compared is None or found.verdict != "named":
        return found
    placed = {*naming.named, *naming.undecided} - {*naming.standing}
    own = {a.effect: a for a in found.attributions if a.effect in placed}
    refuted = {e: farther_by(a, compared.after, seed, settings) for e, a in own.items()}
    alike = [Resemblance(e, REFUTED.format(joined(c))) for e, c in refuted.items() if c]
    no_mean = any(u.effect not in CAUSES for u in found.stochastic)
    left = no_mean or not alike or {*naming.named} - {r.effect for r in alike}
    if alike and left:
        found = _taken_back(found, alike, with_gap)
    if left and not (found.comparison and found.comparison.worse):
        return found
    rest = [Resemblance(e, FARTHER) for e in own if not refuted[e]]
    if no_mean and rest:
        return _taken_back(found, rest, with_gap)
    warnings = (FARTHER, *found.warnings)
    return replace(found, verdict="cannot_tell", refuted=FARTHER, warnings=warnings)


def _taken_back(
    found: Explanation, alike: Sequence[Resemblance], with_gap: Callable[[Explanation], Explanation]
) -> Explanation:
    """The explanation without effects that the cause only resembles, and the gap without them."""
    naming, compared = found.naming, found.comparison
    assert naming is not None and compared is not None
    rest = tuple(w for w in found.warnings if w not in compared.warnings)
    return with_gap(_as_named(replace(found, warnings=rest), naming, alike))


def _with_gap(
    found: Explanation, held: Sequence[Flight], seed: int, payloads: Payloads | None
) -> Explanation:
    """The explanation with the gap of held-out flights and where effects act; since a calibration
    only where a change is named."""
    if found.since is not None and found.verdict != "named":
        return found
    effects = () if found.shown is None else found.shown.effects
    named = [u.effect for u in found.stochastic if u.before and u.effect not in effects]
    effects = (*effects, *named)
    assert found.naming is not None
    if not held:
        problem = "no gap can be shown: of what is held out, no reading is known for long enough"
        return replace(found, warnings=(*found.warnings, problem))
    settings, every = found.settings, zip(*found.naming.problem.model.channels([]), strict=True)
    means = {c[0].name: float(np.mean(np.concatenate([f.residual for f in c]))) for c in every}
    steady = {k: v for k, v in found.values.items() if k.partition(".")[0] in effects}
    try:
        comparison = compare_holdout(
            held,
            found.vehicle,
            effects,
            steady,
            seed,
            payloads,
            means,
            settings.holdout,
            settings.inference.evidence,
        )
    except LogError as error:
        problem = f"no gap can be shown on what is held out: {error}"
        return replace(found, warnings=(*found.warnings, problem))
    acts = [attribute_effect(e, comparison.model, steady, comparison.after) for e in effects]
    where = localize(found.naming.whitened.model, steady, comparison.floors)
    return replace(
        found,
        comparison=comparison,
        attributions=tuple(acts),
        where=tuple(where),
        warnings=(*comparison.warnings, *found.warnings),
    )
