"""Record of an explanation: the content of `explain.json`."""

from collections.abc import Iterable, Sequence
from math import isfinite
from typing import TYPE_CHECKING, Any, ClassVar

import msgspec
from msgspec import UNSET, UnsetType, field

from twin.explain.balance import Balance
from twin.explain.design import Suggestion
from twin.explain.estimates import (
    calibrated_effects,
    channels_and_phases,
    detectable,
    doubtful_effects,
    estimates_of,
    listed_effects,
    nothing_probability,
    probability_of,
    rivals,
    totals,
    undecided,
)
from twin.explain.explanation import Explanation
from twin.explain.holdout import ChannelGap, Place
from twin.explain.inference.selection import Naming
from twin.explain.unnamed import Equation
from twin.flight.closed_loop import Mission

from .gaps import HoverRecord, hover_record
from .headline import headline
from .record import Headline, Record, Section

if TYPE_CHECKING:
    from twin.flight.closed_loop import Mission


class ParameterRecord(Record, frozen=True, kw_only=True):
    """A number of an effect.

    Attributes:
        value: Estimate, in `unit`.
        unit: SI unit.
        ci95: 95 % interval; null: it has none.
        no_effect: Value in the model, or at the calibration, from which it differs; null for a
            shape.
        prior_share: Posterior over prior deviation; 1: the flights say nothing; null: no prior.
        tension: Prior deviations between the value and what was expected; null: no prior.
    """

    value: float
    unit: str
    ci95: tuple[float, float] | None
    no_effect: float | None
    prior_share: float | None
    tension: float | None


class RivalRecord(Record, frozen=True, kw_only=True):
    """Another explanation than an effect.

    Attributes:
        name: An effect, or `nothing`.
        probability: Probability that this is the cause.
        behind: Log probability below the best set with the effect, of the best one with the rival
            in its place; missing where only the probability is known.
        with: Effects that the rival is together with there; missing like `behind`.
    """

    name: str
    probability: float
    behind: float | UnsetType = UNSET
    with_: tuple[str, ...] | UnsetType = field(default=UNSET, name="with")


class EffectRecord(Record, frozen=True, kw_only=True):
    """An effect that may be missing.

    Attributes:
        name: Name of the effect.
        probability: Probability that the effect is missing, alone or with others.
        parameters: Numbers of the effect, by name.
        one_of: Other causes that are there where this one is not: effects, or the part of one that
            a rotor or a clock has, "effect:part".
        channels: Channels on which it acts, the clearest first.
        phases: Flight phases in which it acts on the first of `channels`.
        rivals: Other explanations, the most probable first; of an effect without a mean `nothing`.
    """

    name: str
    probability: float
    parameters: dict[str, ParameterRecord]
    one_of: tuple[str, ...]
    channels: tuple[str, ...]
    phases: tuple[str, ...]
    rivals: tuple[RivalRecord, ...]


class ResemblanceRecord(Record, frozen=True, kw_only=True):
    """An effect that something acts like.

    Attributes:
        name: Name of the effect.
        why: Why the effect is not named.
    """

    name: str
    why: str


class CalibratedRecord(Record, frozen=True, kw_only=True):
    """An effect whose correction is within the uncertainty of the vehicle file.

    Attributes:
        effect: Name of the effect.
        parameters: Numbers of the effect, by name.
    """

    effect: str
    parameters: dict[str, ParameterRecord]


class ChangeRecord(Record, frozen=True, kw_only=True):
    """A change that would be named.

    Attributes:
        value: Size of the change.
        unit: SI unit.
    """

    value: float
    unit: str


class NotVisibleRecord(Record, frozen=True, kw_only=True):
    """An effect that was looked for and has no name.

    Attributes:
        cause: The effect.
        number: Name of the number of the effect.
        smallest_detectable: Change that 95 of 100 such flights would show as named; null where it
            exceeds the range considered.
    """

    cause: str
    number: str
    smallest_detectable: ChangeRecord | None


class DayRecord(Record, frozen=True, kw_only=True):
    """Difference of one flight's number from that of the others.

    Attributes:
        difference: Number of this flight minus the one that all flights share.
        sd: Standard deviation of `difference`.
        unit: SI unit.
    """

    difference: float
    sd: float
    unit: str


class TermRecord(Record, frozen=True, kw_only=True):
    """A term of an equation.

    Attributes:
        product: Product of physical quantities, as text.
        coefficient: Coefficient of the product.
        unit: Unit of the coefficient.
    """

    product: str
    coefficient: float
    unit: str


class EquationRecord(Record, frozen=True, kw_only=True):
    """An equation for what no effect explains.

    Attributes:
        channel: Channel of the residual that the equation gives.
        unit: Unit of the residual.
        expression: The equation as text.
        share: Share of residual power explained out of sample, in the equation's frequency band.
        terms: The terms as numbers.
    """

    channel: str
    unit: str
    expression: str
    share: float
    terms: tuple[TermRecord, ...]


class DependenceRecord(Record, frozen=True, kw_only=True):
    """A quantity that a residual depends on.

    Attributes:
        quantity: Name of the quantity.
        share: Share of residual power explained by a curve over the quantity.
    """

    quantity: str
    share: float


class PlaceRecord(Record, frozen=True, kw_only=True):
    """A place of disagreement.

    Attributes:
        channel: Name of the channel.
        phase: Flight phase, "" where unknown.
        unit: Unit of `rms`.
        n: Samples.
        rms: Rms of the residual of the unchanged model.
        over_floor: `rms` over the noise floor of the channel.
        explained: Share of the power that the named effects take.
        band_hz: Frequency band with most of the power.
        goes_with: Quantity that the residual depends on most; null: none.
    """

    channel: str
    phase: str
    unit: str
    n: int
    rms: float
    over_floor: float
    explained: float
    band_hz: tuple[float, float]
    goes_with: DependenceRecord | None


class ChannelRecord(Record, frozen=True, kw_only=True):
    """A channel of the held-out flights.

    Attributes:
        unit: Unit of `before` and `after`.
        before: Rms with the model as it stood.
        after: Rms with the effects added.
        on_its_day: Rms with these and the constants of these days.
        fit_mean: `before` about the mean that the residual has in the flights fitted; null where
            they lack the channel.
        noise_floor: Least rms that any model of the library leaves.
        shrink: Share of the rms that is gone.
        shrink_ci95: 95 % interval of `shrink`; null where there is too little time for one.
        closed: Share of what stood above the noise floor that is gone.
        n: Samples.
    """

    unit: str
    before: float
    after: float
    on_its_day: float
    fit_mean: float | None
    noise_floor: float
    shrink: float
    shrink_ci95: tuple[float, float] | None
    closed: float
    n: int

    @property
    def worse(self) -> bool:
        """Whether the gap grew, beyond doubt."""
        return self.shrink_ci95 is not None and self.shrink_ci95[1] < 0


class HeldOutRecord(Record, frozen=True, kw_only=True):
    """A flight that took no part in the fit.

    Attributes:
        flight: Name of the flight.
        spans_s: Parts of it that took no part; null: all of it.
    """

    flight: str
    spans_s: tuple[tuple[float, float], ...] | None


class MissionRecord(Record, frozen=True, kw_only=True):
    """A mission in closed loop.

    Attributes:
        stable: Whether it was flown to its end, upright and near its setpoints.
        worst_m: Largest distance from the setpoint; null where it could not be flown.
        problem: Why it is not stable; null where it is.
    """

    stable: bool
    worst_m: float
    problem: str | None


class ClosedLoopRecord(Record, frozen=True, kw_only=True):
    """Flights of the new model.

    Attributes:
        stable: Whether all missions are stable.
        worst_tracking_m: Largest distance from the setpoint of all.
        missions: Result of each mission, by name.
    """

    stable: bool
    worst_tracking_m: float | None
    missions: dict[str, MissionRecord]


class SettingsRecord(Record, frozen=True, kw_only=True):
    """The numbers that decide.

    Attributes:
        hash: Hash of all settings, 12 digits.
        changed: Settings that differ from their defaults, by name.
    """

    hash: str
    changed: dict[str, Any]


class OneOfRecord(Record, frozen=True, kw_only=True):
    """One of some causes that flights cannot tell apart.

    Attributes:
        cause: Name of the effect.
        rotor: Rotors that it is of, from 1; null: none in particular.
        probability: Probability of the cause with any rotor; of these rotors where rotors alone
            compete.
    """

    cause: str
    rotor: tuple[int, ...] | None
    probability: float


class TotalRecord(Record, frozen=True, kw_only=True):
    """Sum over the effects of a family.

    Attributes:
        name: Name of the family.
        effects: Effects of the family that may be present, the more probable first.
        probability: Probability that one effect of the family is present.
        value: Size of the sum of the family, in `unit`.
        unit: Unit for display.
        ci95: 95 % interval.
    """

    name: str
    effects: tuple[str, ...]
    probability: float
    value: float
    unit: str
    ci95: tuple[float, float]


class ExplainRecord(Section, frozen=True, kw_only=True):
    """Result of the search for what a model lacks.

    Attributes:
        verdict: `named`, `nothing`, `unnamed`, `cannot_tell` or `unusable`.
        headline: The sentence on top.
        reasons: For `unusable`, why the flights cannot be used; for `cannot_tell` without a
            candidate, where the model leaves something.
        warnings: Warnings to the reader.
        flights: Names of the fitted flights.
        since: Calibration flights, with `--since`: the result is what has changed since then;
            null: the result is what the model lacks.
        vehicle: Name of the model.
        nothing_probability: Probability that no effect which changes a mean is missing.
        one_of_causes: Causes that these flights cannot tell apart; one of them is present.
        outside_probability: Probability that the cause lies outside the library, though the best
            set gives it a name.
        effects: For `named` and `cannot_tell`, the most probable first.
        undecided: Members of `effects`, for `named`, in whose place another effect may be.
        totals: Sums over families of effects. Where several of a family may be present, the first
            represents the family in `effects`, with this probability and figure.
        inclusion: Probability that an effect is present and large enough to be named, by effect;
            without the test of its law (`outside_probability`).
        acts_like: Effects that resemble the cause and are not named.
        calibrated: Effects whose numbers agree with the file within the uncertainty that it states.
        doubtful: Effects of the new vehicle file that are not probable enough for a name; each
            number is its mean over all sets of effects.
        driven_by: What drives the twin, and why, by flight.
        hover: Hover of each flight that hovers.
        not_visible: Effects without a name.
        per_flight: Numbers that differ from their mean in one flight: flight, then "effect.number".
            One that the headline gives for a flight is here and not in `headline.numbers`.
        unnamed: Equations for what no effect explains.
        where: Channels and phases in which model and flights disagree, the largest first.
        gap: Held-out flights before and after, by channel.
        holdout: Flights and parts of flights that took no part in the fit.
        closed_loop: Flights of the new model; null where nothing was named.
        next_manoeuvre: Manoeuvre that would tell most; null: none.
        settings: Settings of the search.
    """

    section = "explain.json"
    digits: ClassVar[int | None] = 6
    verdict: str
    headline: Headline
    reasons: tuple[str, ...]
    warnings: tuple[str, ...]
    flights: tuple[str, ...]
    since: tuple[str, ...] | None
    vehicle: str
    nothing_probability: float | None
    one_of_causes: tuple[OneOfRecord, ...]
    outside_probability: float | None
    effects: tuple[EffectRecord, ...]
    undecided: tuple[str, ...]
    totals: tuple[TotalRecord, ...]
    inclusion: dict[str, float]
    acts_like: tuple[ResemblanceRecord, ...]
    calibrated: tuple[CalibratedRecord, ...]
    doubtful: tuple[CalibratedRecord, ...]
    driven_by: dict[str, str]
    hover: tuple[HoverRecord, ...]
    not_visible: tuple[NotVisibleRecord, ...]
    per_flight: dict[str, dict[str, DayRecord]]
    unnamed: tuple[EquationRecord, ...]
    where: tuple[PlaceRecord, ...]
    gap: dict[str, ChannelRecord]
    holdout: tuple[HeldOutRecord, ...]
    closed_loop: ClosedLoopRecord | None
    next_manoeuvre: Suggestion | None
    settings: SettingsRecord


def explain_record(found: Explanation) -> ExplainRecord:
    """Everything that was found, in numbers."""
    naming, compared = found.naming, found.comparison
    return ExplainRecord(
        verdict=found.verdict,
        headline=headline(found),
        reasons=tuple(found.reasons),
        warnings=tuple(found.warnings),
        flights=found.flights,
        since=found.since,
        vehicle=found.vehicle.name,
        nothing_probability=nothing_probability(found),
        one_of_causes=() if found.balance is None else _one_of(found.balance),
        outside_probability=None if naming is None else naming.outside,
        effects=tuple(_effect(found, e) for e in listed_effects(found)),
        undecided=undecided(found),
        totals=tuple(
            TotalRecord(
                name=t.family.name,
                effects=t.effects,
                probability=t.probability,
                value=t.value,
                unit=t.family.unit,
                ci95=t.ci95,
            )
            for t in totals(found)
        ),
        inclusion={} if naming is None else dict(naming.inclusion),
        acts_like=tuple(
            ResemblanceRecord(name=r.effect, why=r.why)
            for r in (() if naming is None else naming.resemblances)
        ),
        calibrated=_untold(found, calibrated_effects(found)),
        doubtful=_untold(found, doubtful_effects(found)),
        driven_by=dict(found.driven_by),
        hover=tuple(map(hover_record, found.hovers)),
        not_visible=tuple(_not_visible(found)),
        per_flight={} if naming is None else _per_flight(naming),
        unnamed=tuple(map(_equation, found.unnamed)),
        where=tuple(map(_place, found.where)),
        gap={g.name: _channel(g) for g in (() if compared is None else compared.gaps)},
        holdout=tuple(HeldOutRecord(flight=h.flight, spans_s=h.spans) for h in found.holdout),
        closed_loop=_closed_loop(found.missions) if found.missions else None,
        next_manoeuvre=found.next_manoeuvre,
        settings=SettingsRecord(hash=found.settings.hash, changed=dict(found.settings.changed)),
    )


def _one_of(balance: Balance) -> tuple[OneOfRecord, ...]:
    return tuple(
        OneOfRecord(cause=h.cause, rotor=h.rotors or None, probability=h.probability)
        for h in balance.one_of
    )


def _effect(found: Explanation, effect: str) -> EffectRecord:
    channels, phases = channels_and_phases(found, effect)
    return EffectRecord(
        name=effect,
        probability=probability_of(found, effect),
        parameters=_parameters(found, effect),
        one_of=() if found.naming is None else tuple(found.naming.one_of(effect)),
        channels=tuple(channels),
        phases=tuple(phases),
        rivals=msgspec.convert(rivals(found, effect), tuple[RivalRecord, ...]),
    )


def _parameters(found: Explanation, effect: str) -> dict[str, ParameterRecord]:
    return {
        e.number.name: ParameterRecord(
            value=e.value,
            unit=e.number.about.unit,
            ci95=e.ci95,
            no_effect=e.no_effect,
            prior_share=e.prior_share,
            tension=e.tension,
        )
        for e in estimates_of(found, effect)
    }


def _untold(found: Explanation, effects: Iterable[str]) -> tuple[CalibratedRecord, ...]:
    """Numbers of effects that have no name."""
    return tuple(CalibratedRecord(effect=e, parameters=_parameters(found, e)) for e in effects)


def _not_visible(found: Explanation) -> list[NotVisibleRecord]:
    """Effects that are not named, and the smallest change that these flights would show."""
    named = listed_effects(found)
    return [
        NotVisibleRecord(
            cause=effect,
            number=d.number.partition(".")[2],
            smallest_detectable=None
            if d.value is None
            else ChangeRecord(value=d.value, unit=d.unit),
        )
        for effect, d in detectable(found).items()
        if effect not in named
    ]


def _per_flight(naming: Naming) -> dict[str, dict[str, DayRecord]]:
    """Outliers of each flight."""
    units = {n.full: n.about.unit for n in naming.problem.model.numbers}
    return {
        flight: {
            name: DayRecord(difference=value, sd=sd, unit=units[name])
            for name, (value, sd) in own.items()
        }
        for flight, own in naming.days.items()
    }


def _equation(equation: Equation) -> EquationRecord:
    return EquationRecord(
        channel=equation.channel,
        unit=equation.unit,
        expression=equation.expression,
        share=equation.share,
        terms=tuple(
            TermRecord(product=product, coefficient=value, unit=unit)
            for product, value, unit in equation.terms
        ),
    )


def _place(place: Place) -> PlaceRecord:
    own = {name: getattr(place, name) for name in PlaceRecord.__struct_fields__}
    with_ = place.goes_with
    dependence = None if with_ is None else DependenceRecord(quantity=with_[0], share=with_[1])
    return PlaceRecord(**(own | {"goes_with": dependence}))


def _channel(gap: ChannelGap) -> ChannelRecord:
    own = {name: getattr(gap, name) for name in ChannelRecord.__struct_fields__}
    known = isfinite(gap.shrink_ci95[0])
    return ChannelRecord(**(own | {"shrink_ci95": gap.shrink_ci95 if known else None}))


def _closed_loop(missions: "Sequence[Mission]") -> ClosedLoopRecord:
    flown = [m.worst_m for m in missions if isfinite(m.worst_m)]
    return ClosedLoopRecord(
        stable=all(m.stable for m in missions),
        worst_tracking_m=max(flown, default=None),
        missions={
            m.name: MissionRecord(stable=m.stable, worst_m=m.worst_m, problem=m.problem or None)
            for m in missions
        },
    )
