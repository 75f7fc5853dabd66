"""The gap between flights and their twin, as a result to print, tabulate and report."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import isfinite
from typing import TYPE_CHECKING, Any

from twin.errors import LogError
from twin.formatting import counted, joined, number, percent, pretty_unit
from twin.logs import AnyFlight, Flight
from twin.logs.autopilot import Interval
from twin.residuals.flight_gap import DEFAULT_HORIZON_S, HoverDiagnosis, flight_gap
from twin.residuals.gap import (
    UNKNOWN_PHASE,
    FlightGap,
    Ranked,
    Score,
    band_rows,
    rank,
    summaries,
    weighs,
)
from twin.vehicle import Vehicle
from twin.why.flight import FlightFrame

from .display import PageMixin, TextTable
from .flights import opened_flights
from .record import Headline, Record, Section
from .vehicles import checked_vehicle
from .wording import describe, drive_sentence, hover_sentence, misfit, weightless

if TYPE_CHECKING:
    import pandas as pd

    from .series.files import Column, Series

Progress = Callable[[float], None]
WHOLE = "whole flight"
"""Label of all samples in the column of phases."""
MOST_PLACES = 10
"""Number of ranked places in `gap.json`."""
MOST_NAMED = 3
"""Number of flights that the headline names."""
AGREEMENT = 0.1
"""Share of the signal below which the slow part of a residual is called agreement. With the noise
of the built-in flights alone it reaches 0.08."""


class HoverErrors(Record, frozen=True, kw_only=True):
    """Standard errors of a diagnosis in hover.

    Attributes:
        carried, back_m, right_m, lean_forward_rad, lean_right_rad: Standard error of each.
    """

    carried: float
    back_m: float | None
    right_m: float | None
    lean_forward_rad: float | None
    lean_right_rad: float | None


class WeakRotorRecord(Record, frozen=True, kw_only=True):
    """A rotor that gives less thrust.

    Attributes:
        rotor: Number, from 1 on.
        loss: Share of its thrust.
        sd: Standard error of the loss.
    """

    rotor: int
    loss: float
    sd: float


class HoverRecord(Section, frozen=True, kw_only=True):
    """A twin at the motor commands of a hover.

    Attributes:
        flight: Name of the flight.
        seconds: Length of the hover.
        carried: Thrust of the twin at the logged commands over what the flight shows.
        back_m: Distance by which the centre of mass would have to move back for the mean moment of
            the twin about pitch to vanish as that of the flight does; null: no body rates.
        right_m: The same to the right, for the moment about roll.
        lean_forward_rad: Angle by which the thrust of the flight leans forward of that of the twin,
            of the rotors or of the board with the accelerometer.
        lean_right_rad: The same angle to the right.
        sd: Standard errors.
        split: Command of each motor, or else its speed, over the mean of all motors, minus 1.
        weakest: The single rotor that would do what `back_m` and `right_m` do; null: none would.
    """

    section = "diagnosis in hover"
    flight: str
    seconds: float
    carried: float
    back_m: float | None
    right_m: float | None
    lean_forward_rad: float | None
    lean_right_rad: float | None
    sd: HoverErrors
    split: tuple[float, ...]
    weakest: WeakRotorRecord | None


def hover_record(found: HoverDiagnosis) -> HoverRecord:
    """A diagnosis as numbers: of each mean its value, and its standard error in `sd`."""
    means = {name: getattr(found, name) for name in HoverErrors.__struct_fields__}
    weak = found.weakest
    return HoverRecord(
        flight=found.flight,
        seconds=found.seconds,
        split=found.split,
        weakest=None
        if weak is None
        else WeakRotorRecord(rotor=weak.rotor, loss=weak.loss.value, sd=weak.loss.sd),
        sd=HoverErrors(**{name: mean and mean.sd for name, mean in means.items()}),
        **{name: mean and mean.value for name, mean in means.items()},
    )


class GapFlight(Record, frozen=True, kw_only=True):
    """A flight that was compared with its twin.

    Attributes:
        name: Name of the flight.
        vehicle: Name of the vehicle.
        duration_s: Length of what was compared.
        n: Samples compared.
        phases: Phases of the flight.
        facts: Facts that the log states, as text.
        hover: Null where it does not hover.
        driven_by: What drives the twin; if not logged rotor speeds, why.
    """

    name: str
    vehicle: str
    duration_s: float
    n: int
    phases: tuple[Interval, ...]
    facts: dict[str, str]
    hover: HoverRecord | None
    driven_by: str


class ScoreRecord(Record, frozen=True, kw_only=True):
    """Residuals of some samples in numbers.

    Attributes:
        n: Samples.
        rms: Rms of the residual, in the unit of the channel.
        mean: Mean of the residual.
        share: `rms` over the rms of the measured signal about its mean.
        slow_rms: Rms of the residual below 10 Hz.
        rms_ci95: 95 % interval of `rms`.
    """

    n: int
    rms: float
    mean: float
    share: float
    slow_rms: float
    rms_ci95: tuple[float, float]


class BandRecord(Record, frozen=True, kw_only=True):
    """A frequency band.

    Attributes:
        from_hz: Lower edge.
        to_hz: Upper edge; null: half the sample rate.
        measured_rms: Rms of the measured signal in the band.
        residual_rms: Rms of the residual in the band.
    """

    from_hz: float
    to_hz: float
    measured_rms: float
    residual_rms: float


class GapChannel(ScoreRecord, frozen=True, kw_only=True):
    """A channel of all flights together.

    Attributes:
        unit: Unit of all numbers here.
        horizon_s: Time since the twin was restarted from the measured state; 0: teacher-forced.
        bands: Rms by frequency band.
        by_phase: Statistics by flight phase.
    """

    unit: str
    horizon_s: float
    bands: tuple[BandRecord, ...]
    by_phase: dict[str, ScoreRecord]


class GapPlace(ScoreRecord, frozen=True, kw_only=True):
    """A place where twin and flights disagree.

    Attributes:
        channel: Name of the channel.
        phase: Flight phase.
        unit: Unit of all numbers here.
    """

    channel: str
    phase: str
    unit: str


class GapRecord(Section, frozen=True, kw_only=True):
    """The gap between flights and their twin.

    Attributes:
        headline: The sentence on top; its `numbers` are empty.
        flights: The flights that were compared.
        channels: All flights together, by channel.
        worst: Ranked places, the worst first.
        warnings: Warnings to the reader.
    """

    section = "gap.json"
    headline: Headline
    flights: tuple[GapFlight, ...]
    channels: dict[str, GapChannel]
    worst: tuple[GapPlace, ...]
    warnings: tuple[str, ...]


def gap_record(gaps: Sequence[FlightGap]) -> GapRecord:
    """The gap of flights in numbers."""
    pooled, bands = summaries(gaps), band_rows(gaps)
    warnings = [f"{g.flight}: {w}" if len(gaps) > 1 else w for g in gaps for w in g.warnings]
    for key, s in pooled.items():
        if s.total.dropped:
            warnings.append(f"{key}: {s.total.dropped} samples are not finite and were left out")
        if s.total.n == 0:
            warnings.append(f"{key}: no sample at which both flight and twin are finite")
        elif not isfinite(s.total.share):
            warnings.append(f"{key}: the measured signal is flat, it has no share of it")
    places = rank(pooled)
    return GapRecord(
        headline=Headline(unfit(gaps) + claim(places)),
        flights=tuple(map(_flight, gaps)),
        channels={
            key: GapChannel(
                unit=s.unit,
                horizon_s=s.horizon_s,
                bands=tuple(
                    BandRecord(**band) for band in bands.get((s.name, s.unit, s.horizon_s), ())
                ),
                by_phase={p: ScoreRecord(**_scores(score)) for p, score in s.by_phase.items()},
                **_scores(s.total),
            )
            for key, s in pooled.items()
        },
        worst=tuple(
            GapPlace(channel=p.channel, phase=p.phase, unit=p.unit, **_scores(p.score))
            for p in places[:MOST_PLACES]
        ),
        warnings=tuple(warnings),
    )


def unfit(gaps: Sequence[FlightGap]) -> str:
    """Text on a vehicle file that does not fit, or an implausible accelerometer, from the first
    flight that shows it, with a trailing blank; "" where there is none. Of several flights the
    ones concerned are named."""
    doubted = [g for g in gaps if _doubt(g)]
    if not doubted:
        return ""
    fit = len(gaps) - len(doubted)
    same = [g for g in doubted if (g.carried is None) == (doubted[0].carried is None)]
    text = _doubt(doubted[0], fit if fit > len(doubted) else 0)
    if len(gaps) == 1:
        return f"{text} "
    names = [g.flight for g in same]
    if len(names) > MOST_NAMED:
        names = [*names[:MOST_NAMED], f"{len(names) - MOST_NAMED} more"]
    return f"{len(same)} of {len(gaps)} flights, {joined(names)}: {text} "


def _doubt(gap: FlightGap, others: int = 0) -> str:
    """Text on a vehicle file that does not fit a flight, or on its accelerometer; "": none."""
    if gap.carried is None and isfinite(gap.acc_z) and not weighs(gap.acc_z):
        return weightless(gap.acc_z, gap.vehicle)
    return misfit(gap.carried, gap.vehicle, others)


def claim(places: Sequence[Ranked]) -> str:
    """The headline: the place where twin and flight disagree most, in one sentence.

    Args:
        places: Ranked places from `twin.residuals.gap.rank`, the worst first.
    """
    if not places:
        return "There is nothing to compare: no channel has enough finite samples."
    worst = places[0]
    where = f"{worst.channel} ({describe(worst.channel)})"
    if worst.phase and worst.phase != UNKNOWN_PHASE:
        where += f" during {worst.phase}"
    size = f"{number(worst.score.rms)} {pretty_unit(worst.unit)} rms, {percent(worst.score.share)}"
    if worst.weight < AGREEMENT:
        return (
            "Twin and flight agree: the slow part of the residual stays below "
            f"{percent(AGREEMENT)} of the signal "
            f"in every channel and phase. The largest gap is in {where}: {size} of the signal."
        )
    return f"Twin and flight disagree most in {where}: {size} of the signal.{_steeper(places)}"


_STEEPER = 2.0
"""A second channel is named when its residual, relative to its own signal, is this many times that
of the worst channel: axes of a vector are ranked by their largest signal. Made up."""


def _steeper(places: Sequence[Ranked]) -> str:
    """Sentence on the channel whose residual is the largest share of its own signal; "" where that
    is the worst channel, or hardly larger."""

    def own(place: Ranked) -> float:
        """Slow part of the residual over the signal of the channel itself."""
        return place.score.slow_rms * place.score.share / place.score.rms if place.score.rms else 0

    worst = places[0]
    most = max((p for p in places if p.horizon_s == worst.horizon_s), key=own)
    if most.channel == worst.channel or own(most) < _STEEPER * max(own(worst), AGREEMENT):
        return ""
    size = f"{number(most.score.rms)} {pretty_unit(most.unit)} rms, {percent(most.score.share)}"
    return f" Next to its own small signal, {most.channel} is further off: {size}."


def _scores(score: Score) -> dict[str, Any]:
    """Fields of a score."""
    return {name: getattr(score, name) for name in ScoreRecord.__struct_fields__}


def _flight(gap: FlightGap) -> GapFlight:
    return GapFlight(
        name=gap.flight,
        vehicle=gap.vehicle,
        duration_s=gap.duration_s,
        n=sum(len(c.t_s) for c in gap.channels),
        phases=tuple(Interval(n, a, b) for n, a, b in gap.phases),
        facts=dict(gap.facts),
        hover=None if gap.hover is None else hover_record(gap.hover),
        driven_by=gap.driven_by,
    )


@dataclass(frozen=True, repr=False)
class GapResult(PageMixin):
    """Gap between flights and a vehicle's twin.

    Attributes:
        flights: Residuals, one per flight.
        recorded: Flights as read, for the top of the page; none: not known.
    """

    flights: tuple[FlightGap, ...]
    recorded: tuple[AnyFlight, ...] = ()

    page = "uavtwin.report.gap"

    @cached_property
    def record(self) -> GapRecord:
        """Record of every number that is printed."""
        return gap_record(self.flights)

    @property
    def headline(self) -> Headline:
        """The main result, without fitted numbers."""
        return self.record.headline

    @property
    def claim(self) -> str:
        """The place where twin and flights disagree most, in one sentence."""
        return self.headline.text

    @property
    def drive(self) -> str:
        """Input of the twin, with the reason, in one sentence."""
        return drive_sentence({g.flight: g.driven_by for g in self.flights})

    @property
    def hover(self) -> tuple[str, ...]:
        """Sentences on the twin from the hover of each flight."""
        return tuple(
            f"{g.flight}: {hover_sentence(g.vehicle, g.hover, g.driven_by)}"
            for g in self.flights
            if g.hover
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings, each with its flight."""
        return tuple(f"{g.flight}: {w}" for g in self.flights for w in g.warnings)

    def table(self) -> TextTable:
        """A row per channel, all flights together."""
        header = ("channel", "unit", "horizon s", "n", "rms", "mean", "share of signal")
        return TextTable(
            header,
            tuple(
                (
                    name,
                    c.unit,
                    f"{c.horizon_s:g}",
                    str(c.n),
                    f"{c.rms:.4g}",
                    f"{c.mean:.4g}",
                    f"{100 * c.share:.0f} %",
                )
                for name, c in self.record.channels.items()
            ),
        )

    def frame(self) -> "pd.DataFrame":
        """A row per channel and phase, all flights together; `whole flight` is every phase."""
        import pandas as pd

        scores: list[tuple[str, str, GapChannel, GapChannel | ScoreRecord]] = []
        for name, c in self.record.channels.items():
            scores.append((name, WHOLE, c, c))
            scores += [(name, phase, c, score) for phase, score in c.by_phase.items()]
        return pd.DataFrame(
            [
                {
                    "channel": name,
                    "phase": phase,
                    "unit": c.unit,
                    "horizon_s": c.horizon_s,
                    "n": score.n,
                    "rms": score.rms,
                    "rms_low": score.rms_ci95[0],
                    "rms_high": score.rms_ci95[1],
                    "mean": score.mean,
                    "share": score.share,
                    "slow_rms": score.slow_rms,
                }
                for name, phase, c, score in scores
            ]
        )

    def residuals(self) -> "pd.DataFrame":
        """Every sample: flight, channel, horizon, time, phase, measured, simulated, residual."""
        import pandas as pd

        return pd.concat(
            [
                pd.DataFrame(
                    {
                        "flight": gap.flight,
                        "channel": c.name,
                        "unit": c.unit,
                        "horizon_s": c.horizon_s,
                        "time": c.t_s,
                        "phase": c.phase,
                        "measured": c.measured,
                        "simulated": c.simulated,
                        "residual": c.residual,
                    }
                )
                for gap in self.flights
                for c in gap.channels
            ],
            ignore_index=True,
        )

    def series(self) -> "tuple[Series, ...]":
        """Measured, twin and residual of each flight over time, as used for the numbers."""
        return tuple(_series(gap) for gap in self.flights)

    def findings(self) -> Iterable[str | TextTable]:
        """Main result, input, hover, table, and agreement of rebuilt commands with logged ones."""
        yield self.claim
        if self.drive:
            yield self.drive
        yield from self.hover
        if self.record.worst:
            yield self.table()
        for g in self.flights:
            if "commands_match" in g.facts:
                yield f"{g.flight}: commands {g.facts['commands_match']}"

    def brief(self) -> str:
        """Number of flights and channels, and the vehicle."""
        vehicles = ", ".join(dict.fromkeys(g.vehicle for g in self.flights))
        channels = {c.name for g in self.flights for c in g.channels}
        return (
            f"{type(self).__name__}: {counted(self.flights, 'flight')} against {vehicles}, "
            f"{counted(tuple(channels), 'channel')}"
        )


def _series(gap: FlightGap) -> "Series":
    """Columns of one flight."""
    from .series.files import TWIN, Series, compared  # Parquet is needed for files only

    columns: list[Column] = []
    for c in gap.channels:
        how = f"{c.horizon_s:g} s after a restart from it" if c.horizon_s else "at it"
        about = f"twin: from the measured state, {how}"
        columns += compared(c.name, c.unit, c.t_s, c.measured, {TWIN: c.simulated}, about)
    return Series(gap.flight, tuple(columns), {"verb": "gap", "vehicle": gap.vehicle}, gap.origin)


LEAST_BEFORE_S = 5.0
"""Shortest part before a crash that is compared, s."""
LAST_S = 120.0
"""Length of the end of a flight, left in its file, that is searched for a crash: 40 MB at 1 kHz."""


def gap(
    flights: AnyFlight | Sequence[AnyFlight],
    vehicle: Vehicle,
    *,
    horizon_s: float = DEFAULT_HORIZON_S,
    progress: Progress = lambda _: None,
) -> GapResult:
    """Simulate the twin with the commands of real flights and measure the differences.

    Args:
        flights: One or several.
        vehicle: Vehicle of the twin.
        horizon_s: Short horizon, the interval at which the twin restarts from the measured state; a
            multiple of 1 ms, at least 10 ms.
        progress: Called with the completed share, 0..1.

    Raises:
        LogError: A flight cannot be compared with this vehicle.
        TwinError: An argument is no flight or no vehicle.
    """
    several, model = opened_flights(flights, "gap"), checked_vehicle(vehicle, "gap")
    gaps = []
    for i, flight in enumerate(several):

        def share(done: float, i: int = i) -> None:
            progress((i + done) / len(several))

        part, cut = _until_crash(flight)
        found = flight_gap(part, model, horizon_s, share)
        gaps.append(replace(found, warnings=(*found.warnings, cut)) if cut else found)
    return GapResult(tuple(gaps), several)


def _until_crash(flight: AnyFlight) -> tuple[AnyFlight, str]:
    """Part of a flight to compare, and a warning on a crash, "" without one: tumbling is
    uninformative on the twin, and would dominate the rest.

    A flight that stays in its file is compared to its end, and only its last part is searched.
    """
    start_s, end_s = float(flight.time_s[0]), float(flight.time_s[-1])
    try:
        held = flight if isinstance(flight, Flight) else flight.between(end_s - LAST_S, end_s)
        lost_s = FlightFrame.of(held).crash_begins_s
    except LogError:  # its motion is not known well enough
        return flight, ""
    if lost_s is None or lost_s - start_s < LEAST_BEFORE_S:
        return flight, ""
    if held is not flight:
        return flight, (
            f"compared to its end, though control seems lost at {lost_s:.2f} s: a table of this "
            f"length stays in its file. Cut it there: how it tumbles says little of the twin"
        )
    cut = f"compared until {lost_s:.2f} s: there control is lost, and then it hits something"
    return flight.between(start_s, lost_s), cut
