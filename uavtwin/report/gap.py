"""The gap report: one HTML file, claim first, figures second, numbers in a table.

The page embeds plotly.js once and fetches nothing. Figures are stored once, packed, and drawn when
they come into view, so a page with many flights opens at once.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twin.logs.columns import POS
from twin.residuals.channels import BAND_HZ
from twin.residuals.gap import (
    UNKNOWN_PHASE,
    Channel,
    FlightGap,
    Ranked,
    Summary,
    rank,
    summaries,
    summarise,
)
from twin.residuals.spectra import SLOW_HZ

from .autopilot import told_content
from .drawing import Budget, Spans, fitted
from .figures import channel_figures, number, percent, pretty_unit
from .hover import hover_sentence
from .kinds import Kind, describe, grouped, mode
from .laid_over import laid_over
from .overview import Overview, overview_plots
from .page import Plot, plot, render

FULLY_TOLD = 5
"""Of more flights, fewer messages and parameters of each are listed."""
MOST_LISTED = 200
"""Rows of the table of flights."""
AGREEMENT = 0.1
"""Share of the signal below which the slow part of a residual is called agreement. With the noise
of the built-in flights alone it reaches 0.08."""


@dataclass(frozen=True, slots=True)
class _Figure:
    """What the template needs of one figure."""

    title: str
    axes: str
    mode: str
    note: str
    time: Plot
    spectra: Plot | None


def write_gap_report(
    gaps: Sequence[FlightGap], path: Path, overviews: Sequence[Overview] = ()
) -> None:
    """Write the report of one or more flights against their twin.

    The same gaps give the same bytes: identifiers are counted, no time is written. Of more flights
    than a page has room for, those are drawn whose twin is furthest off; all are listed.

    Args:
        gaps: One per flight.
        path: HTML file to write; an existing one is replaced.
        overviews: What each flight was; none: pages begin with the gap.
    """
    scored = _Scored(
        tuple(gaps),
        tuple(overviews) or (None,) * len(gaps),
        summaries(gaps),
        tuple(tuple(summarise(c) for c in g.channels) for g in gaps),
    )
    path.write_text(fitted(scored.page, len(gaps)), encoding="utf-8")


@dataclass(frozen=True, slots=True)
class _Scored:
    """Flights with what does not depend on how they are drawn.

    Attributes:
        gaps: One per flight.
        overviews: One per flight; None: not kept.
        pooled: Every channel over all flights.
        summed: Every channel of each flight.
    """

    gaps: tuple[FlightGap, ...]
    overviews: tuple[Overview | None, ...]
    pooled: Mapping[str, Summary]
    summed: tuple[tuple[Summary, ...], ...]

    def page(self, budget: Budget) -> str:
        """Text of the page."""
        gaps, places = self.gaps, rank(self.pooled)
        drawn = self._furthest_off(budget.parts)
        horizons = sorted({c.horizon_s for g in gaps for c in g.channels if c.horizon_s > 0})
        share = min(1.0, FULLY_TOLD / max(len(drawn), 1))
        return render(
            "report.html.j2",
            {"number": number, "percent": percent, "unit": pretty_unit, "words": describe},
            claim=claim(places),
            detail=_detail(places),
            hover=[_hover(gaps[i], f"{gaps[i].flight}: ") for i in drawn if gaps[i].hover],
            places=places[:6],
            slow_hz=SLOW_HZ,
            band_hz=BAND_HZ,
            horizons=horizons,
            teacher_forced=any(c.horizon_s == 0 for g in gaps for c in g.channels),
            pooled=self.pooled if len(gaps) > 1 else {},
            count=len(gaps),
            columns=budget.columns
            if any(len(c.t_s) > 2 * budget.columns for g in gaps for c in g.channels)
            else 0,
            listed=self._listed(drawn) if len(drawn) < len(gaps) else [],
            over=laid_over([gaps[i] for i in drawn], [self.overviews[i] for i in drawn], budget)
            if len(drawn) > 1
            else None,
            flights=[self._flight(i, budget, share) for i in drawn],
        )

    def _furthest_off(self, most: int) -> list[int]:
        """Flights that are drawn, in the order in which they were given."""
        if len(self.gaps) <= most:
            return list(range(len(self.gaps)))
        places = [rank({s.name: s for s in summed})[:1] for summed in self.summed]
        worst = sorted(
            range(len(places)), key=lambda i: -max([p.weight for p in places[i]], default=-1.0)
        )
        return sorted(worst[:most])

    def _listed(self, drawn: Sequence[int]) -> list[dict[str, Any]]:
        """Rows of the table of flights, those that are drawn first."""
        others = [i for i in range(len(self.gaps)) if i not in drawn]
        return [
            {
                "id": f"flight{i}" if i in drawn else "",
                "name": self.gaps[i].flight,
                "duration_s": self.gaps[i].duration_s,
                "claim": claim(rank({s.name: s for s in self.summed[i]})),
                "hover": _hover(self.gaps[i]) if self.gaps[i].hover else "",
            }
            for i in [*drawn, *others][:MOST_LISTED]
        ]

    def _flight(self, index: int, budget: Budget, share: float) -> dict[str, Any]:
        """Figures and tables of one flight, as the template reads them."""
        gap, shown, summed = self.gaps[index], self.overviews[index], self.summed[index]
        name, phases = f"flight{index}", gap.phases
        ends = [c for c in gap.channels if c.name in POS and c.horizon_s > 0]
        track: list[Plot] = []
        logged = told = None
        if shown is not None:
            track, logged = overview_plots(name, shown, phases, budget, ends)
            told = told_content(name, shown.told, phases, budget, share)
        return {
            "track": track,
            "logged": logged,
            "told": told,
            "id": name,
            "name": gap.flight,
            "vehicle": gap.vehicle,
            "duration_s": gap.duration_s,
            "phases": phases,
            "claim": claim(rank({s.name: s for s in summed})),
            "figures": [
                _figure(name, kind, members, phases, budget)
                for kind, members in grouped(gap.channels)
            ],
            "rows": _rows(summed),
            "facts": gap.facts,
            "warnings": gap.warnings,
        }


def _hover(gap: FlightGap, before: str = "") -> str:
    """What the hover of a flight says of the twin."""
    return before + hover_sentence(gap.vehicle, gap.hover) if gap.hover else ""


def claim(places: Sequence[Ranked]) -> str:
    """The headline: the place where twin and flight disagree most, in one sentence.

    Args:
        places: Of `twin.residuals.gap.rank`, the worst first.
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
    return f"Twin and flight disagree most in {where}: {size} of the signal."


def _detail(places: Sequence[Ranked]) -> str:
    """What a pilot should make of the headline: can a model mend it?"""
    if not places or not places[0].score.rms > 0:
        return ""
    score = places[0].score
    slow = min(1.0, (score.slow_rms / score.rms) ** 2)
    text = (
        f"{percent(slow)} of the power of that residual lies below {SLOW_HZ:g} Hz, where a model "
        "of the flight can mend it; the rest is vibration and noise. "
    )
    if math.isfinite(score.rms_ci95[0]):
        low, high = score.rms_ci95
        text += f"95 % interval of the rms: {number(low)} to {number(high)}. "
    text += f"n = {score.n}."
    later = next((p for p in places if p.horizon_s > 0), None)
    if later and places[0].horizon_s == 0:
        text += (
            f" Restarted from the measured state, the twin is off by {number(later.score.rms)} "
            f"{pretty_unit(later.unit)} rms in {describe(later.channel)} "
            f"after {later.horizon_s:g} s."
        )
    return text


def _figure(
    flight: str, kind: Kind, channels: Sequence[Channel], phases: Spans, budget: Budget
) -> _Figure:
    """The figures of the channels of one kind and horizon."""
    over_time, spectra, note = channel_figures(channels, phases, flight, budget)
    horizon_s = channels[0].horizon_s
    name = f"{flight}-{kind.prefix.rstrip('_') or 'other'}-{round(horizon_s * 1000)}ms"
    label = f"{kind.title}, {mode(horizon_s)}: measured, twin and residual"
    return _Figure(
        kind.title,
        kind.axes,
        mode(horizon_s),
        note,
        plot(name, f"{label} over time", over_time),
        None if spectra is None else plot(f"{name}-spectra", f"{label}, spectra", spectra),
    )


def _rows(summed: Sequence[Summary]) -> list[dict[str, Any]]:
    """Lines of the table: the whole channel, then its phases."""
    rows = []
    for s in summed:
        scores = {"whole flight": s.total, **s.by_phase}
        for phase, score in scores.items():
            rows.append(
                {
                    "span": len(scores) if score is s.total else 0,
                    "name": s.name,
                    "unit": s.unit,
                    "mode": mode(s.horizon_s),
                    "phase": phase,
                    "score": score,
                }
            )
    return rows
