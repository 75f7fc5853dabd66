"""Missing effects of a model, as a result to print, report and continue with; and as a folder of
files."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import isfinite, nan
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import UnsetType

from twin.component import unknown_name
from twin.effects import EFFECTS
from twin.errors import TwinError
from twin.explain import explanation as inner
from twin.explain.estimates import UNDETERMINED, estimates_alone, estimates_of
from twin.explain.explanation import Explanation
from twin.explain.inference.fit import INTERVAL
from twin.explain.inference.search import NO_CHECKPOINT, Checkpoint
from twin.explain.model.numbers import numbers_of, with_effects
from twin.explain.settings import DEFAULT, SearchSettings
from twin.formatting import (
    certainty,
    counted,
    joined,
    number,
    number_cells,
    percent,
    pretty_unit,
    readable,
    title,
)
from twin.logs import AnyFlight
from twin.residuals.channels import ChannelData
from twin.vehicle import Deviation, Vehicle

from . import vehicles
from .display import PageMixin, TextTable
from .explain_record import (
    CalibratedRecord,
    ChannelRecord,
    EffectRecord,
    ExplainRecord,
    RivalRecord,
    explain_record,
)
from .flights import opened_flights
from .headline import called, got_worse
from .output import OptionalSteps, write_json
from .record import Headline
from .wording import drive_sentence, hover_sentence

if TYPE_CHECKING:
    import arviz
    import pandas as pd

    from .series.files import Column, Series

Progress = Callable[[float], None]
SET_BY_PRIOR, SET_BY_CALIBRATION = "set by the prior", "set by the calibration"
"""Remarks on an undetermined number."""
CELLS = ("value", "unit", "95 % interval", "")
"""Headers of all columns but the first."""


@dataclass(frozen=True, repr=False)
class ExplainResult(PageMixin):
    """Result of flights for a model.

    Attributes:
        details: Everything that was found, with the hypotheses and their fits.
    """

    details: Explanation = field(repr=False)

    page = "uavtwin.report.explain"

    @cached_property
    def record(self) -> ExplainRecord:
        """Record of every number that is printed."""
        return explain_record(self.details)

    @property
    def verdict(self) -> str:
        """The verdict: named, nothing, unnamed, cannot_tell or unusable."""
        return self.details.verdict

    @property
    def headline(self) -> Headline:
        """The headline with the numbers in it."""
        return self.record.headline

    @property
    def sentence(self) -> str:
        """The headline in words."""
        return self.headline.text

    @property
    def hover(self) -> tuple[str, ...]:
        """Diagnosis of the original vehicle in the hover of each flight, a sentence each."""
        name, driven_by = self.details.vehicle.name, self.details.driven_by
        return tuple(
            f"{h.flight}: {hover_sentence(name, h, driven_by.get(h.flight, ''))}"
            for h in self.details.hovers
        )

    @property
    def drive(self) -> str:
        """Input of the twin, with the reason, in one sentence; "" where nothing was fitted."""
        return drive_sentence(self.details.driven_by)

    @property
    def got_worse(self) -> str:
        """The channel of the held-out flights with the largest increase; "" for none."""
        return got_worse(self.details)

    @property
    def shrinking(self) -> str:
        """Result of the held-out flights, in one sentence; "" where nothing is compared."""
        if self.details.shown is None or not self.record.gap:
            return ""
        clear = {n: g for n, g in self.record.gap.items() if g.shrink_ci95 and g.shrink_ci95[0] > 0}
        if not clear:
            return "On the held-out flights no channel improved significantly."
        name, best = max(clear.items(), key=lambda item: item[1].before / item[1].noise_floor)
        return (
            f"On the held-out flights the residual in {name} falls from {number(best.before)} to "
            f"{number(best.after)} {pretty_unit(best.unit)} rms; noise floor "
            f"{number(best.noise_floor)}."
        )

    @property
    def effects(self) -> tuple[str, ...]:
        """Effects that are listed, the most probable first; none where nothing is named."""
        return tuple(e.name for e in self.record.effects)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings, the most important first."""
        return self.details.warnings

    @cached_property
    def vehicle(self) -> vehicles.Vehicle:
        """The vehicle with the named effects on; the original one where none is named. Of a single
        flight, the constants of its day are included, each marked in its source."""
        return explained_vehicle(self.details)

    @cached_property
    def vehicle_today(self) -> vehicles.Vehicle | None:
        """The corrected vehicle with the day's constants of the last of several flights; None where
        none differs from its mean."""
        return vehicle_today(self.details)

    @property
    def vehicle_before(self) -> vehicles.Vehicle:
        """The original vehicle."""
        return vehicles.Vehicle.of(self.details.vehicle)

    def candidates(self) -> "pd.DataFrame":
        """A row per number of each listed effect, with its 95 % interval."""
        import pandas as pd

        rows = [
            {
                "effect": effect.name,
                "probability": effect.probability,
                "number": name,
                "value": p.value,
                "low": None if p.ci95 is None else p.ci95[0],
                "high": None if p.ci95 is None else p.ci95[1],
                "unit": p.unit,
            }
            for effect in self.record.effects
            for name, p in effect.parameters.items()
        ]
        columns = ["effect", "probability", "number", "value", "low", "high", "unit"]
        return pd.DataFrame(rows, columns=columns)

    def candidates_table(self) -> TextTable:
        """Effects with their numbers and their most probable rival, in words."""
        rows = []
        for effect in self.record.effects:
            first = next(iter(effect.rivals), None)
            rival = "" if first is None else f"{title(first.name)} {certainty(first.probability)}"
            for i, (name, p) in enumerate(effect.parameters.items()):
                head = (called(effect.name), certainty(effect.probability))
                value, unit, ends = number_cells(p.value, p.unit, p.ci95)
                rows.append(
                    (
                        *(head if i == 0 else ("", "")),
                        name,
                        value,
                        unit,
                        ", ".join(t for t in (ends, self.remark(p.prior_share)) if t),
                        rival if i == 0 else "",
                        alternatives(effect) if i == 0 else "",
                    )
                )
        header = ("effect", "certainty", "number", "value", "unit", "95 % interval", "rival")
        return TextTable((*header, "or instead"), tuple(rows))

    def remark(self, prior_share: float | None) -> str:
        """Remark on a number that the prior rather than the flights determines; "" for others."""
        if prior_share is None or prior_share <= UNDETERMINED:
            return ""
        return SET_BY_PRIOR if self.record.since is None else SET_BY_CALIBRATION

    def descriptions(self, effect: str) -> dict[str, str]:
        """Numbers of a listed effect, by name."""
        numbers = (e.number for e in estimates_of(self.details, effect))
        return {n.name: n.about.description for n in numbers}

    def calibrated_table(self) -> TextTable:
        """Uncertain numbers of the file that the flights have determined."""
        return self._unnamed("calibrated", self.record.calibrated)

    def doubtful_table(self) -> TextTable:
        """Numbers in the new vehicle file that are too uncertain for a name."""
        return self._unnamed("too doubtful for a name", self.record.doubtful)

    def _unnamed(self, first: str, effects: Iterable[CalibratedRecord]) -> TextTable:
        """Numbers of effects without a name.

        Args:
            first: Title of their column.
            effects: Effects whose numbers are listed.
        """
        rows = (
            (f"{c.effect}.{n}", *number_cells(p.value, p.unit, p.ci95), self.remark(p.prior_share))
            for c in effects
            for n, p in c.parameters.items()
            if p.no_effect is not None
        )
        return TextTable((first, *CELLS), tuple(rows))

    def days_table(self) -> TextTable:
        """Outliers of a flight."""
        rows = []
        for flight, own in self.record.per_flight.items():
            for name, day in own.items():
                (value, sd), unit = readable(day.unit, day.difference, day.sd)
                rows.append((flight, name, f"{value:+.3g}", unit, number(sd)))
        header = ("flight", "number", "difference", "unit", "standard deviation")
        return TextTable(header, tuple(rows))

    def further_tables(self) -> Iterable[TextTable]:
        """Last tables: uncertain numbers of the file, doubtful ones, and those of days."""
        tables = (self.calibrated_table(), self.doubtful_table(), self.days_table())
        return [table for table in tables if table.rows]

    def frame(self) -> "pd.DataFrame":
        """The gap of the held-out flights before and after: a row per channel."""
        import pandas as pd

        rms = ["before", "after", "on_its_day", "fit_mean", "noise_floor"]
        columns = ["channel", "unit", "n", *rms, "shrink"]
        rows = [
            {**{c: getattr(g, c) for c in columns[1:]}, "channel": name}
            | dict(zip(("shrink_low", "shrink_high"), g.shrink_ci95 or (nan, nan), strict=True))
            for name, g in self.record.gap.items()
        ]
        return pd.DataFrame(rows, columns=[*columns, "shrink_low", "shrink_high"])

    def gap_table(self) -> TextTable:
        """The gap of the held-out flights before and after, in words."""
        names = ("before", "after", "on its day")
        return TextTable(
            ("channel", "unit", "n", *names, "noise floor", "shrink, 95 %"),
            tuple(
                (
                    name,
                    g.unit,
                    str(g.n),
                    f"{g.before:.4g}",
                    f"{g.after:.4g}",
                    f"{g.on_its_day:.4g}",
                    f"{g.noise_floor:.4g}",
                    shrink_words(g),
                )
                for name, g in self.record.gap.items()
            ),
            unbroken=(0, 7),
        )

    def series(self) -> "tuple[Series, ...]":
        """Measured, twin and residual over time of each held-out flight, with and without named
        effects; none without held-out data."""
        compared_with = self.details.comparison
        if compared_with is None:
            return ()
        flights, after = compared_with.model.flights, compared_with.after
        each = zip(flights, compared_with.before, after, strict=True)
        return tuple(_series(self.details, f.flight.name, old, new) for f, old, new in each)

    def to_arviz(self, draws: int = 1000, seed: int = 0) -> "arviz.InferenceData":
        """Draws of the posterior and of the prior, for ArviZ: a variable per number,
        "effect.number", and `included`, whether an effect is in the candidate model drawn.

        Args:
            draws: Draws of each of the four chains; they are independent.
            seed: Seed of the draws.

        Raises:
            TwinError: ArviZ is not installed, or nothing was fitted.
        """
        from .inference_data import inference_data

        return inference_data(self.details, draws, seed)

    def findings(self) -> Iterable[str | TextTable]:
        """Headline, worse channels, input, hover, candidates, next manoeuvre, before and after,
        uncertain numbers."""
        yield self.sentence
        yield from filter(None, (self.got_worse, self.drive))
        yield from self.hover
        if self.effects:
            yield self.candidates_table()
        if self.details.next_manoeuvre is not None:
            yield f"Fly next: {self.details.next_manoeuvre.description}"
        if self.details.comparison is not None:
            yield self.gap_table()
        yield from self.further_tables()

    def brief(self) -> str:
        """Verdict, vehicle and flights."""
        what = f": {', '.join(self.effects)}" if self.effects else ""
        return (
            f"{type(self).__name__}: {self.verdict}{what}; {self.details.vehicle.name}, fitted on "
            f"{counted(self.details.flights, 'flight')}"
        )


def alternatives(effect: EffectRecord) -> str:
    """Alternatives to an effect, in words; "" for none."""
    parts = []
    for cause in effect.one_of:
        other, _, rotor = cause.partition(":")
        parts.append(f"{title(other)}{f' of rotor {rotor}' if rotor else ''}")
    return joined(parts, "or")


def why_lost(rival: RivalRecord, least: float) -> str:
    """Reason why another explanation was not chosen.

    Args:
        rival: The other one.
        least: Probability from which it is equally good.
    """
    if isinstance(rival.behind, UnsetType) or isinstance(rival.with_, UnsetType):
        return "does not resemble this residual"
    if rival.name == "nothing":
        return "explains none of the residual"
    if rival.probability >= least:
        return "explains the flights as well: not distinguishable here"
    partners = f"together with {joined([title(e) for e in rival.with_])} " * bool(rival.with_)
    return f"{partners}is less probable: log probability lower by {rival.behind:.1f}"


def shrink_words(gap: ChannelRecord) -> str:
    """Interval by which a gap shrank; a dash where it is not known, "" without one."""
    if gap.before == gap.after:
        return ""
    return "\N{EN DASH}" if gap.shrink_ci95 is None else " to ".join(map(percent, gap.shrink_ci95))


def _series(
    found: Explanation, flight: str, before: Sequence[ChannelData], after: Sequence[ChannelData]
) -> "Series":
    """Columns of one held-out flight."""
    from .series.files import EXPLAINED, TWIN, Series, compared  # Parquet is needed for files only

    columns: list[Column] = []
    for old, new in zip(before, after, strict=True):
        sides = {TWIN: old.measured - old.residual}
        if found.added is not None:
            sides[EXPLAINED] = new.measured - new.residual
        columns += compared(old.name, old.unit, old.t_s, old.measured, sides)
    effects = ", ".join(found.effects) if found.added is not None else ""
    facts = {"verb": "explain", "vehicle": found.vehicle.name, "effects": effects}
    return Series(flight, tuple(columns), facts)


def explain(
    flights: AnyFlight | Sequence[AnyFlight],
    holdout: AnyFlight | Sequence[AnyFlight],
    vehicle: Vehicle | None = None,
    *,
    since: Vehicle | None = None,
    payloads: Mapping[str, float] | None = None,
    seed: int = 0,
    missions: Sequence[str] | None = None,
    settings: SearchSettings = DEFAULT,
    indoors: bool | None = None,
    progress: Progress = lambda _: None,
    checkpoint: Checkpoint = NO_CHECKPOINT,
) -> ExplainResult:
    """Name the physical effect that a vehicle lacks, add it, and show that the gap shrinks.

    Args:
        flights: Flights to fit.
        holdout: Flights that take no part in the fit and show the gap; none (`[]`): blocks of time
            of the others are used instead, which is weaker evidence.
        vehicle: The model to be examined.
        since: Calibrated vehicle in place of `vehicle`, to find changes since then: its numbers
            have their calibrated uncertainty.
        payloads: Known mass aboard by the name of a flight, kg.
        seed: Seed of every bootstrap.
        missions: Missions flown with the new model at the end; default: all.
        settings: Settings of the search, `docs/reference/settings.md`.
        indoors: Whether all flights were within walls; default: as each flight says, outdoors
            where it does not.
        progress: Called with the completed share, 0..1.
        checkpoint: Stores the state of the search, such as
            `uavtwin.explain_journal.ExplainJournal`.

    Raises:
        TwinError: An argument is no flight or no vehicle, a flight is both fitted and held out, a
            payload belongs to no flight, or `since` has no calibration.
    """
    fit, away = opened_flights(flights, "explain"), opened_flights(holdout, "explain")
    if (vehicle is None) == (since is None):
        raise TwinError(
            f"explain: {'neither a vehicle nor since' if since is None else 'a vehicle and since'} "
            f"given. Give a vehicle to ask what it lacks, or since=VEHICLE, one that `calibrate` "
            f"made, to ask what has changed since then."
        )
    model = vehicles.checked_vehicle(vehicle if since is None else since, "explain")
    if since is not None:
        check_calibrated(model)
    _check_apart(fit, away)
    payloads = dict(payloads or {})
    check_payloads(payloads, [f.name for f in (*fit, *away)])
    found = inner.explain(
        fit,
        away,
        model,
        seed,
        progress,
        missions=missions,
        payloads=payloads,
        settings=settings,
        indoors=indoors,
        since=since is not None,
        checkpoint=checkpoint,
    )
    return ExplainResult(found)


def check_calibrated(vehicle: Vehicle) -> None:
    """Refuse a vehicle without calibration.

    Raises:
        TwinError: It has none.
    """
    inner.calibrated_on(vehicle)


def _check_apart(fit: Sequence[AnyFlight], away: Sequence[AnyFlight]) -> None:
    """Refuse a flight that is both fitted and held out."""
    if not fit:
        raise TwinError("explain: no flight to fit on.")
    files = {f.source.resolve() for f in fit if f.source is not None}
    for flight in away:
        read_from_same = flight.source is not None and flight.source.resolve() in files
        if read_from_same or any(flight is f for f in fit):
            raise TwinError(f"{flight.name}: is a flight of the fit; hold out others.")


def check_payloads(payloads: Mapping[str, float], flights: Sequence[str]) -> None:
    """Refuse a payload of no flight, and one that is no mass.

    Args:
        payloads: Known mass aboard by flight, kg.
        flights: Names of the flights.

    Raises:
        TwinError: There is one.
    """
    for name, mass_kg in payloads.items():
        if name not in flights:
            raise TwinError(unknown_name("payload", "flight", name, flights))
        if not (isfinite(mass_kg) and mass_kg >= 0):
            raise TwinError(f"payload of {name} = {mass_kg:g} kg: must be finite, 0 or more.")


def explained_vehicle(found: Explanation) -> vehicles.Vehicle:
    """The vehicle with the named effects, each number with source and sd; else the original one.

    The file of a model that cannot fly has a comment on that at the top.
    """
    if found.added is None:
        return vehicles.Vehicle.of(found.vehicle)
    flights, sources = " and ".join(found.flights), dict(found.vehicle.sources)
    deviations = dict(found.vehicle.deviations)
    for effect in found.effects:
        certainties = {e.number.name: e.ci95 for e in estimates_alone(found, effect)}
        for name, value in found.added.effects.get(effect, {}).items():
            key, ci95 = f"effects.{effect}.{name}", certainties.get(name)
            sources[key] = f"uavtwin explain, {flights}, {_certainty(ci95)}"
            deviations.pop(key, None)
            if (sd := _deviation(ci95)) > 0:
                deviations[key] = Deviation.of([sd], [value])
    made = replace(vehicles.Vehicle.of(found.added), sources=sources, deviations=deviations)
    made = made.marked(_grounded(found)) if found.lost or made.grounded else made
    if len(found.flights) > 1:
        return made
    return _on_day(found, made, found.flights[0]) or made


def _grounded(found: Explanation) -> str:
    """Missions that the new model cannot fly, and the remedy, for the top of its file; "": it flies
    all."""
    if not found.lost:
        return ""
    missions: dict[str, list[str]] = {}
    for m in found.lost:
        missions.setdefault(" ".join(m.problem.split()), []).append(m.name)
    lost = joined([f"{joined(names)} ({problem})" for problem, names in missions.items()])
    return (
        f"{lost}; uavtwin explain, {' and '.join(found.flights)}. Take out an [effects.NAME] "
        f"section of this file, the least sure first, or explain with more flights. Once it flies, "
        f"delete this line."
    )


def vehicle_today(found: Explanation) -> vehicles.Vehicle | None:
    """The explained vehicle with the constants of the day of the last of several flights; None
    where nothing was added, or none differs."""
    if found.added is None or len(found.flights) < 2:
        return None
    return _on_day(found, explained_vehicle(found), found.flights[-1])


def _on_day(found: Explanation, vehicle: vehicles.Vehicle, flight: str) -> vehicles.Vehicle | None:
    """A vehicle with those outliers of a flight that an aircraft can have; None for none."""
    days = {} if found.naming is None else found.naming.days.get(flight, {})
    effects = dict.fromkeys(n.partition(".")[0] for n in days)
    own = {
        n.full: n.now + days[n.full][0]
        for n in numbers_of([EFFECTS[e] for e in effects if EFFECTS[e].of_vehicle], vehicle)
        if n.full in days
    }
    if not own:
        return None
    values = {n: float(f"{v:.{inner.DIGITS}g}") for n, v in own.items()}
    made = with_effects(vehicle, [e for e in effects if EFFECTS[e].of_vehicle], values)
    sources, deviations = dict(vehicle.sources), dict(vehicle.deviations)
    for name, value in values.items():
        key, (difference, sd) = f"effects.{name}", days[name]
        sources[key] = (
            f"uavtwin explain, of the day of {flight} alone: {difference:+.3g} there, "
            f"standard deviation {sd:.3g}"
        )
        deviations.pop(key, None)
        if sd > 0:
            deviations[key] = Deviation.of([float(f"{sd:.4g}")], [value])
    return replace(vehicles.Vehicle.of(made), sources=sources, deviations=deviations)


def _deviation(ci95: tuple[float, float] | None) -> float:
    """Standard deviation of a 95 % interval; 0 without one."""
    half = 0.0 if ci95 is None else (ci95[1] - ci95[0]) / 2
    return half / INTERVAL if isfinite(half) else 0.0


def _certainty(ci95: tuple[float, float] | None) -> str:
    return "no interval" if ci95 is None else "95 % interval {:.4g} to {:.4g}".format(*ci95)


def write_explanation(found: Explanation, folder: Path) -> list[str]:
    """Write page, JSON and, where an effect is named, vehicle files; returns names of the files."""
    result = ExplainResult(found)
    write_json(folder / "explain.json", result.json())
    result.draw(folder / "report.html")
    written = ["report.html", "explain.json"]
    if found.added is None:
        return written
    written.append(explained_vehicle(found).save(folder / "vehicle.toml").name)
    if (today := vehicle_today(found)) is not None:
        written.append(today.save(folder / "vehicle_today.toml").name)
    return written


def write_fmus(
    found: Explanation,
    folder: Path,
    steps: OptionalSteps,
    progress: Progress = lambda _: None,
) -> list[str]:
    """Build the components on which the named effects act; returns names of the files.

    Args:
        found: Result of `explain`.
        folder: Folder of the results.
        steps: Runs the build as an optional step: the compiler may fail, the disk may be full.
        progress: Called with the share done.
    """
    from .exports.parts import component  # builders of FMUs are not needed to explain
    from .exports.write import export_parts

    if found.added is None:
        return []
    vehicle = explained_vehicle(found)
    of_vehicle = (EFFECTS[e] for e in found.effects if EFFECTS[e].of_vehicle)
    names = sorted({e.component for e in of_vehicle})
    if not names:
        return []
    write = export_parts([component(n, vehicle) for n in names])
    rows = steps.run("FMUs", folder, lambda place: write(place, progress))
    return [row.file for row in rows or ()]
