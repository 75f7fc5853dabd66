"""The numbers of one aircraft, estimated from normal flights: a result to print and to save."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

from twin.effects import EFFECTS, advice_of
from twin.effects.wording import ADVICE
from twin.errors import TwinError
from twin.explain.calibration import Calibrated
from twin.explain.calibration import calibrate as fitted
from twin.explain.estimates import UNDETERMINED
from twin.explain.explanation import UNKNOWN_SITE, hovers_of, sited, usable_of
from twin.explain.inference.estimate import Estimate
from twin.explain.inference.fit import INTERVAL
from twin.explain.model.numbers import Number
from twin.explain.settings import DEFAULT, SearchSettings
from twin.formatting import counted, joined, number, number_cells, readable
from twin.logs import Flight
from twin.residuals.flight_gap import HoverDiagnosis
from twin.residuals.teacher_forced import drive_warnings
from twin.vehicle import Deviation, Vehicle

from . import vehicles
from .display import DisplayMixin, TextTable
from .explanation import SET_BY_PRIOR, check_payloads
from .flights import checked_flights
from .gaps import HoverRecord, hover_record
from .headline import calibrated_headline
from .record import Headline, Record
from .wording import hover_sentence

if TYPE_CHECKING:
    import pandas as pd

DAYS = 3
"""Number of flights from which day-to-day variation is estimated."""


class NumberRecord(Record, frozen=True, kw_only=True):
    """A number of the aircraft.

    Attributes:
        name: "effect.number".
        value: Estimate, in `unit`.
        unit: SI unit.
        ci95: 95 % interval; null: it has none.
        no_effect: Value where the effect is absent.
        before: Value in the draft.
        prior_share: Posterior over prior deviation; 1: the flights say nothing.
        determined: Whether the flights rather than the prior set it.
    """

    name: str
    value: float
    unit: str
    ci95: tuple[float, float] | None
    no_effect: float | None
    before: float
    prior_share: float | None
    determined: bool


class DifferenceRecord(Record, frozen=True, kw_only=True):
    """A number of one flight that differs from that of the others.

    Attributes:
        difference: Number of this flight minus the one that all flights share.
        sd: Standard deviation of `difference`.
    """

    difference: float
    sd: float


class DaysRecord(Record, frozen=True, kw_only=True):
    """Day-to-day variation.

    Attributes:
        determined: Whether there were flights enough to estimate it.
        sd: Standard deviation between flights, by number.
        per_flight: Numbers that differ from their mean in one flight: flight, then number.
    """

    determined: bool
    sd: dict[str, float]
    per_flight: dict[str, dict[str, DifferenceRecord]]


class CalibrateRecord(Record, frozen=True, kw_only=True):
    """Result of normal flights for the numbers of an aircraft.

    Attributes:
        headline: The sentence on top.
        vehicle: Name of the draft.
        flights: Names of the fitted flights.
        warnings: Warnings to the reader, among them flights that were left out.
        hover: Hover of each flight that hovers, by the draft.
        numbers: Fitted numbers, the most important first.
        undetermined: Numbers that these flights do not determine.
        days: Variation between days.
        fly_next: Flights that would determine them.
    """

    headline: Headline
    vehicle: str
    flights: tuple[str, ...]
    warnings: tuple[str, ...]
    hover: tuple[HoverRecord, ...]
    numbers: tuple[NumberRecord, ...]
    undetermined: tuple[str, ...]
    days: DaysRecord
    fly_next: tuple[str, ...]


Progress = Callable[[float], None]


@dataclass(frozen=True, repr=False)
class CalibrateResult(DisplayMixin):
    """Result of normal flights for the numbers of an aircraft.

    Attributes:
        details: Everything that was fitted.
        draft: Vehicle before the calibration.
        warnings: Warnings, the most important first.
        hovers: Diagnosis of the draft in the hover of each flight that hovers.
    """

    details: Calibrated = field(repr=False)
    draft: vehicles.Vehicle
    warnings: tuple[str, ...] = ()
    hovers: tuple[HoverDiagnosis, ...] = ()

    @property
    def flights(self) -> tuple[str, ...]:
        """Names of the flights that were fitted."""
        assert self.details.vehicle.calibration is not None
        return self.details.vehicle.calibration.flights

    @cached_property
    def vehicle(self) -> vehicles.Vehicle:
        """The vehicle with the numbers of this aircraft and their joint uncertainty."""
        return calibrated_vehicle(self.details, self.draft)

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Numbers that these flights do not determine, "effect.number"."""
        return self.details.undetermined

    @cached_property
    def headline(self) -> Headline:
        """Text on how many numbers these flights determine, and the effects with most of them."""
        known = [n for n in self._numbers() if n.full not in self.undetermined]
        lead = (
            f"{counted(self.flights, 'flight')} of {self.draft.name} "
            f"{'determines' if len(self.flights) == 1 else 'determine'} {len(known)} of its numbers"
        )
        return calibrated_headline(self.details, lead)

    @property
    def sentence(self) -> str:
        """The headline in words."""
        return self.headline.text

    @property
    def _estimates(self) -> Mapping[str, Estimate]:
        return self.details.estimates

    def _numbers(self) -> list[Number]:
        """Numbers in order of importance: the aircraft, its sensors, its records; within each the
        largest relevant differences first, undetermined ones last."""
        fit = self.details.fit
        own = [n for n in fit.numbers if not n.shape]

        def size(n: Number) -> float:
            return abs(self._estimates[n.full].change) / n.about.smallest

        most = {n.effect: max(size(m) for m in own if m.effect == n.effect) for n in own}
        undetermined = {
            e: all(m.full in self.undetermined for m in own if m.effect == e) for e in most
        }
        return sorted(
            own, key=lambda n: (_room(n.effect), undetermined[n.effect], -most[n.effect], n.effect)
        )

    def frame(self) -> "pd.DataFrame":
        """A row per number, with its 95 % interval."""
        import pandas as pd

        return pd.DataFrame(self.json()["numbers"])

    def numbers_table(self) -> TextTable:
        """The numbers of this aircraft, in words; undetermined ones are marked."""
        meaning = {n.full: n.about.description for n in self._numbers()}
        rows = (
            (
                n.name,
                *number_cells(n.value, n.unit, n.ci95),
                "" if n.determined else SET_BY_PRIOR,
                meaning[n.name],
            )
            for n in self.record.numbers
        )
        return TextTable(("number", "value", "unit", "95 % interval", "", "meaning"), tuple(rows))

    def days_table(self) -> TextTable:
        """Variation of each number between flights, and outliers with their flight."""
        known = self.details.vehicle.calibration
        assert known is not None
        units = {n.full: n.about.unit for n in self.details.problem.model.numbers}
        rows = []
        for name, sd in known.days.items():
            days = {f: own[name][0] for f, own in self.details.days.items() if name in own}
            (shown, *values), unit = readable(units[name], sd, *days.values())
            out = [f"{flight} {v:+.3g}" for flight, v in zip(days, values, strict=True)]
            rows.append((name, number(shown), unit, ", ".join(out)))
        header = ("between flights", "standard deviation", "unit", "stands out")
        return TextTable(header, tuple(rows))

    def fly_next(self) -> tuple[str, ...]:
        """Flights that would determine the undetermined numbers."""
        needed = [advice_of(name) for name in self.undetermined]
        found = [f"{a.topic}: {a.fly}" for a in ADVICE if a in needed]
        if len(self.flights) < DAYS:
            found.append(f"days: {DAYS} flights or more, on different days")
        return tuple(found)

    def undetermined_words(self) -> str:
        """Undetermined numbers, by effect."""
        effects = dict.fromkeys(name.partition(".")[0] for name in self.undetermined)
        return joined([e.replace("_", " ") for e in effects])

    @cached_property
    def record(self) -> CalibrateRecord:
        """Record of every number that is printed."""
        known = self.details.vehicle.calibration
        assert known is not None
        return CalibrateRecord(
            headline=self.headline,
            vehicle=self.draft.name,
            flights=self.flights,
            warnings=self.warnings,
            hover=tuple(map(hover_record, self.hovers)),
            numbers=tuple(map(self._number, self._numbers())),
            undetermined=self.undetermined,
            days=DaysRecord(
                determined=len(self.flights) >= DAYS,
                sd=dict(known.days),
                per_flight={
                    flight: {n: DifferenceRecord(difference=v, sd=sd) for n, (v, sd) in own.items()}
                    for flight, own in self.details.days.items()
                },
            ),
            fly_next=self.fly_next(),
        )

    def _number(self, n: Number) -> NumberRecord:
        estimate = self._estimates[n.full]
        return NumberRecord(
            name=n.full,
            value=estimate.value,
            unit=n.about.unit,
            ci95=estimate.ci95,
            no_effect=estimate.no_effect,
            before=n.now,
            prior_share=estimate.prior_share,
            determined=n.full not in self.undetermined,
        )

    def findings(self) -> Iterable[str | TextTable]:
        """Sentence, hover, numbers, undetermined numbers, days, flights to fly next."""
        yield self.sentence
        for h in self.hovers:
            yield f"{h.flight}: {hover_sentence(self.draft.name, h)}"
        yield self.numbers_table()
        if self.undetermined:
            yield (
                f"These flights do not determine numbers of {self.undetermined_words()}: they "
                f"stand as expected, or as the file has them."
            )
        days = self.days_table()
        if len(self.flights) < DAYS:
            yield (
                f"{counted(self.flights, 'flight')}: how much days differ stands as is usual; "
                f"{DAYS} flights or more determine it."
            )
        elif days.rows:
            yield days
        if self.fly_next():
            yield "Fly next, for\n" + "\n".join(f"  {line}" for line in self.fly_next())

    def brief(self) -> str:
        """Vehicle, flights, and the number of fitted numbers."""
        return (
            f"{type(self).__name__}: {self.draft.name}, {counted(self.flights, 'flight')}, "
            f"{counted(self._numbers(), 'number')}"
        )


def calibrate(
    flights: Flight | Sequence[Flight],
    vehicle: Vehicle,
    *,
    payloads: Mapping[str, float] | None = None,
    settings: SearchSettings = DEFAULT,
    indoors: bool | None = None,
    progress: Progress = lambda _: None,
) -> CalibrateResult:
    """Fit the numbers of an aircraft to normal flights, all of them jointly.

    Args:
        flights: Flights without a fault of the aircraft. With three or more, day-to-day variation
            is estimated too.
        vehicle: Draft of the vehicle: the prior of each number has its `sd`, or that of its
            source's wording.
        payloads: Known mass aboard by the name of a flight, kg.
        settings: Settings of the search, `docs/reference/settings.md`.
        indoors: Whether all flights were within walls; default: as each flight says, outdoors
            where it does not.
        progress: Called with the completed share, 0..1.

    Raises:
        TwinError: An argument is no flight or no vehicle, a payload belongs to no flight, or no
            flight can be used.
    """
    several = checked_flights(flights, "calibrate")
    draft = vehicles.checked_vehicle(vehicle, "calibrate")
    if not several:
        raise TwinError("calibrate: no flight to calibrate on.")
    names = [f.name for f in several]
    for name in (n for n in dict.fromkeys(names) if names.count(n) > 1):
        raise TwinError(f"{name}: two flights have this name; give each flight once.")
    payloads = dict(payloads or {})
    check_payloads(payloads, names)
    several = tuple(sited(f, indoors) for f in several)
    fit, reasons = usable_of(several, draft, payloads, settings)
    if not fit:
        raise TwinError(f"calibrate: none of the flights can be used: {'; '.join(reasons)}")
    warnings = [f"left out: {reason}" for reason in reasons]
    warnings += [text for f in fit for text in drive_warnings(f, draft)]
    if unknown := [f.name for f in fit if f.indoors is None]:
        warnings.append(UNKNOWN_SITE.format(", ".join(unknown)))
    if draft.calibration is not None:
        again = [n for n in draft.calibration.flights if n in {f.name for f in fit}]
        warnings.append(
            f"{draft.name} was calibrated before, on {', '.join(draft.calibration.flights)}: its "
            f"numbers are believed as far as those flights determined them"
            + (f", so {', '.join(again)} count twice; calibrate the draft instead" if again else "")
        )
    found = fitted(fit, draft, progress, payloads, settings.inference)
    return CalibrateResult(found, draft, tuple(warnings), hovers_of(fit, draft))


def calibrated_vehicle(found: Calibrated, draft: vehicles.Vehicle) -> vehicles.Vehicle:
    """The draft with the numbers of an aircraft, each with source and sd.

    An effect that the draft does not have, and that no flight determines, is omitted.
    """
    made, fit = vehicles.Vehicle.of(found.vehicle), found.fit
    flights = made.calibration.flights if made.calibration is not None else ()
    sources, deviations = dict(draft.sources), dict(draft.deviations)
    half = {n.full: float(w) for n, w in zip(fit.numbers, fit.half_widths, strict=True)}
    half |= {n: (t.ci95[1] - t.ci95[0]) / 2 for n, t in found.estimates.items() if t.ci95}
    effects = {k: dict(v) for k, v in made.effects.items()}
    for effect in (e for e in fit.effects if e in effects):
        own = [n for n in fit.numbers if n.effect == effect and n.name in effects[effect]]
        if effect not in draft.effects and not any(_says(n, found) for n in own):
            del effects[effect]
            continue
        for name, value in effects[effect].items():
            full, key = f"{effect}.{name}", f"effects.{effect}.{name}"
            known = half.get(full, 0.0) / INTERVAL
            sources[key] = f"uavtwin calibrate, {', '.join(flights)}"
            if found.prior_share.get(full, 1.0) > UNDETERMINED:
                sources[key] += ", not determined by them: as expected"
            deviations.pop(key, None)
            value = float(f"{value:.9g}")
            effects[effect][name] = value
            if known > 0:
                deviations[key] = Deviation.of([float(f"{known:.4g}")], [value])
    return replace(
        made,
        text=draft.text,
        effects=effects,
        sources=sources,
        deviations=deviations,
    )


def _says(n: Number, found: Calibrated) -> bool:
    """Whether flights determine a number, or it differs from its value without the effect."""
    away = abs(dict(found.fit.values)[n.full] - (n.about.neutral or 0.0))
    determined = found.prior_share.get(n.full, 1.0) <= UNDETERMINED
    return not n.shape and (determined or away > n.about.smallest)


def _room(effect: str) -> int:
    """Sort key of an effect: 0 the aircraft, 1 its sensors and its day, 2 its records."""
    about = EFFECTS[effect]
    if not about.of_vehicle:
        return 2
    return 0 if about.component == "airframe" and not about.of_weather else 1
