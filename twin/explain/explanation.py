"""Find, name, add, show: from flights and a model to what the model lacks, and the proof of it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from ..effects import EFFECTS, RandomForce
from ..errors import LogError, ModelError
from ..flight.closed_loop import Mission, fly_missions
from ..formatting import joined
from ..logs import AnyFlight, Flight, Site
from ..representation import short_repr
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
    effect_of_balance,
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
"""Significant ones that a fitted number is given with."""
UNKNOWN_SITE = (
    "not known whether {} flew indoors or outdoors, taken for outdoors: say which by --indoor or "
    "--outdoor, in Python by indoors=True or False"
)  # warning; its gap is filled by names of flights
UNSTABLE = "the model with what was named does not fly {} in closed loop: {}"
"""Warning; mission, problem."""
REFUTED = "with it held-out flights are farther from the model in {}, and in forces as a whole"
"""Why an effect is not named; forces and moments."""
FARTHER = "flights that were held out are farther from the model with it than without"
"""Why names are taken back."""
WEAKER = (
    "no flight was held out: one block of time in {} of the same flights stands in for one, "
    "which is weaker, because what one flight has in common is in both parts"
)  # warning; one in how many blocks


@dataclass(frozen=True, slots=True)
class HeldOut:
    """A flight that took no part in the fit, or the spans of it that took none."""

    flight: str
    spans: tuple[Span, ...] | None = None


@dataclass(frozen=True, slots=True)
class Explanation:
    """What flights say about a model.

    Attributes:
        verdict: In a word.
        vehicle: The model as it stood.
        flights: Names of those that it was fitted on.
        reasons: Why nothing can be learnt, for the verdict "unusable".
        warnings: What to keep in mind, the worst first.
        naming: Hypotheses and their probabilities; None where nothing could be fitted.
        shown: Every effect that may be there, with the means of its numbers over all sets: what
            predicts best, and whose gap is shown; None: no effect that changes a mean.
        stochastic: Effects that change no mean, found beside it.
        values: Numbers of all these, "effect.number" -> value.
        comparison: Held-out flights before and after; None where nothing could be held out.
        attributions: Where each effect of `shown` acts.
        where: Places of disagreement.
        holdout: What took no part in the fit.
        missions: Closed-loop flights of the new model; none where no effect was added.
        refuted: Why names were taken back, to be read behind "but"; "": they were not.
        unnamed: Equations for what no effect explains.
        next_manoeuvre: What to fly to learn more.
        settings: What decided all this.
        since: Flights of the calibration since which it is asked what has changed; None: it is
            asked what the model lacks.
        recorded: All flights as they were read, stuck readings still in them.
        balance: What has changed in the balance of forces and moments since the calibration; None:
            that is not asked, or not shown by these flights.
        hovers: Diagnosis of the model as it stood in the hover of each of them that hovers.
        driven_by: What drives the model of each of them, and why.
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

    __repr__ = short_repr

    @property
    def effects(self) -> tuple[str, ...]:
        """All effects that `values` are of."""
        steady = () if self.shown is None else self.shown.effects
        return (*steady, *(u.effect for u in self.stochastic))

    @property
    def added(self) -> Vehicle | None:
        """The model with the effects that it lacks and the numbers that its file was unsure of;
        None where nothing is named and nothing was unsure, and where nothing has changed since a
        calibration. What it holds is no longer what flights calibrated."""
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
        """Missions that the new model does not fly."""
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
    """Say what a model lacks, and prove it.

    Args:
        flights: To fit on.
        holdout: To show the gap on; none: blocks of time of the flights are held out.
        vehicle: The model as it stands.
        seed: Of every bootstrap.
        progress: Called with the share done.
        missions: To fly with the new model; default: all.
        payloads: Known masses aboard, of flights of either kind.
        settings: The numbers that decide what is said.
        indoors: Whether all flights were within walls; None: as each flight says.
        since: Whether it is asked what has changed since the vehicle was calibrated, its numbers
            held as well as they are known; else everything that the model may lack.
        suggest: Whether to look for what to fly next.
        checkpoint: Keeps where the searches stand.

    Raises:
        ModelError: The vehicle holds no calibration to ask since.
    """
    calibrated = calibrated_on(vehicle) if since else None
    cut = [[part_read(sited(f, indoors), settings.usable) for f in s] for s in (flights, holdout)]
    read, away = ([f for f, _ in some] for some in cut)
    partly = [note for some in cut for _, note in some if note is not None]
    driven = [text for f in (*read, *away) for text in drive_warnings(f, vehicle)]
    stuck = [s for f in (*read, *away) for s in stuck_channels(f, settings.stochastic.stuck)]
    fit, held = ([without_stuck(f, stuck) for f in some] for some in (read, away))
    parts = _parts(fit, held, vehicle, payloads, settings)
    found = Explanation(
        "unusable",
        vehicle,
        tuple(f.name for f in parts.fit or flights),
        reasons=tuple(() if parts.fit else parts.unread),
        warnings=(*partly, *driven, *parts.warnings),
        holdout=parts.away,
        settings=settings,
        since=calibrated,
        recorded=(*read, *away),
    )
    if not parts.fit:
        return found
    try:
        channels = _balanced(parts.fit, vehicle, payloads) if since else None
        naming = name_effects(
            parts.fit,
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
        driven_by={f.name: driven_by(f, vehicle) for f in (*parts.fit, *parts.held)},
    )
    progress(0.65)
    found = _with_equations(found, seed)
    progress(0.75)
    found = _with_gap(found, parts.held, seed, payloads)
    found = _without_refuted(found, parts.held, seed, payloads)
    progress(0.85)
    if suggest and found.verdict in ("named", "cannot_tell"):
        found = replace(found, next_manoeuvre=next_manoeuvre(naming, vehicle))
    return _with_missions(found, missions, lambda done: progress(0.85 + 0.15 * done))


def _with_missions(
    found: Explanation, missions: Sequence[str] | None, progress: Callable[[float], None]
) -> Explanation:
    """The same with flights of the new model in closed loop and calm air, where there is one."""
    if found.added is None:
        return found
    own = {e: v for e, v in found.added.effects.items() if not EFFECTS[e].of_weather}
    calm = replace(found.added, effects=own)
    flying = replace(found, missions=fly_missions(calm, missions, progress))
    lost = [UNSTABLE.format(m.name, m.problem) for m in flying.lost]
    return replace(flying, warnings=(*lost, *found.warnings))


def calibrated_on(vehicle: Vehicle) -> tuple[str, ...]:
    """Names of the flights that told a vehicle's numbers.

    Raises:
        ModelError: The vehicle holds no calibration.
    """
    if vehicle.calibration is None:
        raise ModelError(UNCALIBRATED.format(vehicle.name))
    return vehicle.calibration.flights


@dataclass(frozen=True, slots=True)
class _Parts:
    """What is fitted, and what is held out.

    Attributes:
        fit: Flights to fit on; none: they are of no use.
        held: Flights held out.
        away: The same, for the report.
        unread: Why flights to fit on were left out.
        warnings: What to keep in mind.
    """

    fit: list[Flight]
    held: list[Flight] = field(default_factory=list)
    away: tuple[HeldOut, ...] = ()
    unread: Sequence[str] = ()
    warnings: Sequence[str] = ()


def _parts(
    flights: Sequence[Flight],
    holdout: Sequence[Flight],
    vehicle: Vehicle,
    payloads: Payloads | None,
    settings: SearchSettings,
) -> _Parts:
    """The usable flights; where none is held out, blocks of time of each are."""
    (fit, reasons), (held, left_out) = (
        usable_of(some, vehicle, payloads, settings) for some in (flights, holdout)
    )
    if not fit:
        return _Parts([], unread=reasons)
    warnings = [f"left out: {reason}" for reason in reasons + left_out]
    if unknown := [f.name for f in (*fit, *held) if f.indoors is None]:
        warnings.append(UNKNOWN_SITE.format(", ".join(unknown)))
    if held:
        return _Parts(fit, held, tuple(HeldOut(f.name) for f in held), warnings=warnings)
    spans = [held_out_spans(f, settings.holdout) for f in fit]
    both = list(zip(fit, spans, strict=True))
    (fit, unread), (held, none_left) = (
        with_readings([hidden(f, s, inside) for f, s in both], vehicle, payloads)
        for inside in (True, False)
    )
    warnings += [
        WEAKER.format(settings.holdout.spared_every),
        *(f"left out: {reason}" for reason in unread),
        *(f"left out of what is held out: {reason}" for reason in none_left),
    ]
    return _Parts(fit, held, tuple(HeldOut(f.name, tuple(s)) for f, s in both), unread, warnings)


_F = TypeVar("_F", bound=AnyFlight)


def sited(flight: _F, indoors: bool | None) -> _F:
    """The flight indoors or outdoors, as somebody says; None: as it says itself."""
    return flight if indoors is None else replace(flight, site=Site(indoors, "as told"))


def hovers_of(flights: Sequence[AnyFlight], vehicle: Vehicle) -> tuple[HoverDiagnosis, ...]:
    """Diagnosis of a vehicle's twin in the hover of each flight that hovers."""
    found = (diagnosis_of(f, vehicle) for f in flights)
    return tuple(h for h in found if h is not None)


def _not_observable(naming: Naming) -> list[str]:
    """A line where effects have no place in what drives the model."""
    unobservable = naming.problem.model.unobservable
    if not unobservable:
        return []
    return [
        f"not visible where measured rotor speeds drive the model, which leave no command to look "
        f"at: {', '.join(unobservable)}"
    ]


def _drifting(naming: Naming) -> list[str]:
    """A line for each flight whose attitude and gyroscope have clocks that drift apart."""
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
    """Parts of flights fit for the search, and what is left out of them, whole flights included."""
    found = [usable_part(f, flown(f, vehicle, payloads), settings.usable) for f in flights]
    fit, unread = with_readings([part for part, _, no in found if not no], vehicle, payloads)
    return fit, [text for _, less, no in found for text in (no or less)] + unread


def _named(found: Explanation, naming: Naming, stuck: Sequence[Stuck]) -> Explanation:
    """The same with the effects that were found, and their numbers."""
    shown, settings = naming.shown if naming.shown.effects else None, found.settings.stochastic
    model, steady = naming.whitened.model, naming.shown.values
    every = (*find_stuck(stuck, settings), *find_stochastic(model, steady, settings))
    stochastic = (*found.stochastic, *_beyond(found, every))
    naming = replace(naming, further=len(stochastic))
    return _as_named(replace(found, stochastic=stochastic, shown=shown), naming)


def _as_named(found: Explanation, naming: Naming, alike: Sequence[Resemblance] = ()) -> Explanation:
    """The same with what a search says of the effects that are shown, but for those that something
    acts like, some more among them: beside a name no vehicle carries them."""
    new = alike or naming.resemblances
    naming = replace(naming, resemblances=(*naming.resemblances, *alike))
    verdict = _verdict(naming, found.balance, found.stochastic)
    if verdict == "nothing" and found.since is None and naming.unexplained:
        verdict = "cannot_tell"  # something moves the aircraft, whatever it is
    shown, gone = found.shown, {r.effect for r in naming.resemblances if verdict == "named"}
    if shown is not None and gone:
        shown = replace(shown, effects=tuple(e for e in shown.effects if e not in gone))
    steady = {} if shown is None else shown.values
    exact = dict(steady) | {k: v for u in found.stochastic for k, v in u.values.items()}
    exact = {k: v for k, v in exact.items() if k.partition(".")[0] not in gone}
    return replace(
        found,
        verdict=verdict,
        naming=naming,
        shown=shown,
        values={k: float(f"{v:.{DIGITS}g}") for k, v in exact.items()},
        warnings=(*(f"something acts like {r.effect}: {r.why}" for r in new), *found.warnings),
    )


def _beyond(found: Explanation, every: Sequence[StochasticEffect]) -> list[StochasticEffect]:
    """Those that are there; since a calibration whose flights shook as well, whether more shakes
    now is told by the balance."""
    known = found.vehicle.calibration
    judged = found.balance is not None and known is not None and VIBRATION in known.means
    return [u for u in every if u.log_odds > 0 and not (judged and u.effect == VIBRATION)]


def _verdict(
    naming: Naming, balance: Balance | None, stochastic: Sequence[StochasticEffect]
) -> Verdict:
    """Of the search, of the balance, and of what was found beside them."""
    verdict = naming.verdict
    shakes = stochastic and (balance is None or verdict in ("nothing", "unnamed"))
    if shakes or any(u.before for u in stochastic):
        return "named"
    if balance is None or verdict == "named":
        return verdict
    if verdict == "nothing" and not balance.quiet:
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
    """The same with a wind that is surely stronger than usual, where the search took it for the
    day's."""
    if wind is None or wind.stronger < naming.settings.sure or not WIND.isdisjoint(naming.named):
        return found
    effect = next(iter(wind.change)).partition(".")[0]
    blows = changed_by(effect, wind.change, wind.stronger, found.vehicle, ())
    return replace(found, stochastic=(*found.stochastic, blows))


def _with_balance(found: Explanation, naming: Naming, wind: Wind | None) -> Explanation:
    """The same with what has changed in the balance of forces and moments."""
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
    if all(n.partition(".")[0] in WIND for n in others):
        balance = replace(balance, hanging=hanging_of(naming, balance.best(LOAD)))
    named = effect_of_balance(balance, found.vehicle, trim)
    return replace(found, balance=balance, stochastic=() if named is None else (named,))


def _with_equations(found: Explanation, seed: int) -> Explanation:
    """The same with equations, where they say more than any effect of the library.

    Since a calibration they never overrule a name, that nothing has changed, or a change of the
    balance of forces and moments, and are of more than the flights of the calibration had: what
    these had and no effect explains is no change. Nor are they of a mean, which is the balance's or
    the day's. A model that lacks many things at once is not asked for one: they would be written
    down together with the constants of days.
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
        found, verdict="unnamed", shown=None, stochastic=(), values={}, unnamed=alone.equations
    )


def _answers(found: Explanation, naming: Naming) -> bool:
    """Whether a search says what has changed since a calibration, or that nothing has, or a balance
    that something has, be it a rotor or a load: a load that changes the mean thrust changes it as
    an equation in the thrust does. A balance that is undecided says nothing."""
    if "named" in (found.verdict, naming.verdict) or naming.verdict == "nothing":
        return True
    return found.balance is not None and found.balance.changed >= found.balance.sure


def _new(found: Explanation, naming: Naming, stands: Fit, alone: Unnamed) -> bool:
    """Whether one of some equations is of more than the flights of the calibration had: half of its
    power, at least."""
    known, settings = found.vehicle.calibration, found.settings.inference.adequacy
    usual = {} if known is None else known.left
    model = naming.problem.model
    every = zip(*stands.on_its_days(model).channels([], stands.values), strict=True)
    power = {own[0].name: coherent(own, settings)[0] for own in every}
    return any(
        power[e.channel] - usual.get(e.channel, 0.0) ** 2 > 0.5 * e.rms**2 for e in alone.equations
    )


def _stands(naming: Naming) -> Fit:
    """The model with what puts it right without a name: numbers that the file was unsure of, and
    effects that are there and too small to be worth one."""
    b = naming.problem.priors
    there = {c for c, p in naming.posterior.inclusion.items() if p >= 0.5}
    rows = zip(b.names, b.spike, b.cause, strict=True)
    known = [n for n, sd, cause in rows if sd > 0 or cause in there]
    named, shown = naming.best.effects, naming.shown
    values = {n: shown.values[n] for n in known if n in shown.values}
    values = {n: v for n, v in values.items() if n.partition(".")[0] not in named}
    return replace(naming.nothing, values=values, days=(naming.nothing if named else shown).days)


def _without_refuted(
    found: Explanation, held: Sequence[Flight], seed: int, payloads: Payloads | None
) -> Explanation:
    """The same without effects by which the flights of the fit come nearer to the model, and
    held-out ones do not; nothing with a mean is named where these are all, or all together do the
    same."""
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
        found = _taken_back(found, alike, held, seed, payloads)
    if left and not (found.comparison and found.comparison.worse):
        return found
    rest = [Resemblance(e, FARTHER) for e in own if not refuted[e]]
    if no_mean and rest:
        return _taken_back(found, rest, held, seed, payloads)
    warnings = (FARTHER, *found.warnings)
    return replace(found, verdict="cannot_tell", refuted=FARTHER, warnings=warnings)


def _taken_back(
    found: Explanation,
    alike: Sequence[Resemblance],
    held: Sequence[Flight],
    seed: int,
    payloads: Payloads | None,
) -> Explanation:
    """The same with some effects that something only acts like, and the gap without them."""
    naming, compared = found.naming, found.comparison
    assert naming is not None and compared is not None
    rest = tuple(w for w in found.warnings if w not in compared.warnings)
    return _with_gap(_as_named(replace(found, warnings=rest), naming, alike), held, seed, payloads)


def _with_gap(
    found: Explanation, held: Sequence[Flight], seed: int, payloads: Payloads | None
) -> Explanation:
    """The same with the gap of held-out flights, where effects act, and where the gap is; since a
    calibration only where a change is named."""
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
