"""The gap between flights and their twin, as a result to print, tabulate and report."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.logs import AnyFlight
from twin.residuals.flight_gap import DEFAULT_HORIZON_S, flight_gap
from twin.residuals.gap import FlightGap, gap_json, rank, summaries
from twin.vehicle import Vehicle

from .display import DisplayMixin, TextTable
from .flights import opened_flights
from .formatting import counted
from .output import output_file
from .report.gap import claim, write_gap_report
from .report.headline import Headline
from .report.overview import Overview, overview
from .series.files import TWIN, Column, Series, compared
from .vehicles import checked_vehicle
from .wording import hover_sentence

if TYPE_CHECKING:
    import pandas as pd

Progress = Callable[[float], None]
WHOLE = "whole flight"
"""In the column of phases: all samples."""


@dataclass(frozen=True, slots=True, repr=False)
class GapResult(DisplayMixin):
    """How far a vehicle's twin is from flights.

    Attributes:
        flights: Residuals, one per flight.
        overviews: What each flight was, for the top of the page; none: not kept.
    """

    flights: tuple[FlightGap, ...]
    overviews: tuple[Overview, ...] = ()

    @property
    def claim(self) -> str:
        """Where twin and flights disagree most, in one sentence."""
        return claim(rank(summaries(self.flights)))

    @property
    def headline(self) -> Headline:
        """The claim, which gives no fitted number."""
        return Headline(self.claim)

    @property
    def hover(self) -> tuple[str, ...]:
        """What the hover of each flight says of the twin, a sentence each."""
        return tuple(
            f"{g.flight}: {hover_sentence(g.vehicle, g.hover)}" for g in self.flights if g.hover
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to keep in mind, each with its flight."""
        return tuple(f"{g.flight}: {w}" for g in self.flights for w in g.warnings)

    def table(self) -> TextTable:
        """A row per channel, all flights together."""
        header = ("channel", "unit", "horizon s", "n", "rms", "mean", "share of signal")
        return TextTable(
            header,
            tuple(
                (
                    name,
                    s.unit,
                    f"{s.horizon_s:g}",
                    str(s.total.n),
                    f"{s.total.rms:.4g}",
                    f"{s.total.mean:.4g}",
                    f"{100 * s.total.share:.0f} %",
                )
                for name, s in summaries(self.flights).items()
            ),
        )

    def frame(self) -> "pd.DataFrame":
        """A row per channel and phase, all flights together; `whole flight` is every phase."""
        import pandas as pd

        return pd.DataFrame(
            [
                {
                    "channel": name,
                    "phase": phase,
                    "unit": s.unit,
                    "horizon_s": s.horizon_s,
                    "n": score.n,
                    "rms": score.rms,
                    "rms_low": score.rms_ci95[0],
                    "rms_high": score.rms_ci95[1],
                    "mean": score.mean,
                    "share": score.share,
                    "slow_rms": score.slow_rms,
                }
                for name, s in summaries(self.flights).items()
                for phase, score in {WHOLE: s.total, **s.by_phase}.items()
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

    def series(self) -> tuple[Series, ...]:
        """Measured, twin and residual of each flight over time, as the numbers are made of them."""
        return tuple(_series(gap) for gap in self.flights)

    def json(self) -> dict[str, Any]:
        """The content of `gap.json`."""
        return {"headline": self.headline.json(), **gap_json(self.flights)}

    def report(self, path: str | Path) -> Path:
        """Write the page, one HTML file that opens offline; returns its path."""
        with output_file(Path(path)) as file:
            write_gap_report(self.flights, file, self.overviews)
        return Path(path)

    def sections(self) -> Iterable[str | TextTable]:
        """Claim, table, warnings."""
        yield self.claim
        yield from self.hover
        yield self.table()
        if self.warnings:
            yield "\n".join(self.warnings)

    def brief(self) -> str:
        """How many flights and channels, against which vehicle."""
        vehicles = ", ".join(dict.fromkeys(g.vehicle for g in self.flights))
        channels = {c.name for g in self.flights for c in g.channels}
        return (
            f"{type(self).__name__}: {counted(self.flights, 'flight')} against {vehicles}, "
            f"{counted(tuple(channels), 'channel')}"
        )


def _series(gap: FlightGap) -> Series:
    """Columns of one flight."""
    columns: list[Column] = []
    for c in gap.channels:
        how = f"{c.horizon_s:g} s after a restart from it" if c.horizon_s else "at it"
        about = f"twin: from the measured state, {how}"
        columns += compared(c.name, c.unit, c.t_s, c.measured, {TWIN: c.simulated}, about)
    return Series(gap.flight, tuple(columns), {"verb": "gap", "vehicle": gap.vehicle}, gap.origin)


def gap(
    flights: AnyFlight | Sequence[AnyFlight],
    vehicle: Vehicle,
    *,
    horizon_s: float = DEFAULT_HORIZON_S,
    progress: Progress = lambda _: None,
) -> GapResult:
    """Fly the twin on the commands of real flights and measure where the two disagree.

    Args:
        flights: One or several.
        vehicle: Whose twin flies.
        horizon_s: Short horizon: the twin restarts from the measured state that often; a multiple
            of 1 ms, at least 10 ms.
        progress: Called with the share done, 0..1.

    Raises:
        LogError: A flight cannot be compared with this vehicle.
        TwinError: An argument is no flight or no vehicle.
    """
    several, model = opened_flights(flights, "gap"), checked_vehicle(vehicle, "gap")
    gaps = []
    for i, flight in enumerate(several):

        def share(done: float, i: int = i) -> None:
            progress((i + done) / len(several))

        gaps.append(flight_gap(flight, model, horizon_s, share))
    return GapResult(tuple(gaps), tuple(overview(f) for f in several))
