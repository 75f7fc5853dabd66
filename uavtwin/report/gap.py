"""The gap report: one HTML file with the main result, figures, and numbers in a table.

The page embeds plotly.js once and loads nothing else. Figures are stored once, packed, and drawn
when they become visible, so a page with many flights opens at once.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.formatting import number, percent, pretty_unit
from twin.logs.columns import POS
from twin.residuals.channels import BAND_HZ
from twin.residuals.gap import (
    SLOW_HZ,
    Channel,
    FlightGap,
    Ranked,
    Spectrum,
    Summary,
    rank,
    spectrum,
    summaries,
    summarise,
)

from ..gaps import GapResult, claim, unfit
from ..wording import KINDS, Kind, describe, drive_sentence, grouped, hover_sentence, mode
from .autopilot import autopilot_content
from .drawing import DENSE_HZ, GAP_PX, TREND_HZ, Axis, Budget, Panels, Spans, fitted, thinned
from .overview import Overview, overview, overview_plots
from .page import BLACK, BLUE, GREY, Figure, Plot, plot, render

FULL_DETAIL = 5
"""Number of flights up to which messages and parameters are listed in full."""
MOST_LISTED = 200
"""Largest number of rows of the table of flights."""


@dataclass(frozen=True, slots=True)
class _Figure:
    """Content of one figure for the template."""

    title: str
    axes: str
    mode: str
    note: str
    time: Plot
    spectra: Plot | None


def page_text(result: GapResult) -> str:
    """The page of a result."""
    return gap_page(result.flights, [overview(f) for f in result.recorded])


def gap_page(gaps: Sequence[FlightGap], overviews: Sequence[Overview] = ()) -> str:
    """The report of one or more flights against their twin.

    Equal gaps give equal bytes: identifiers are counted, no time is written. Of more flights than
    fit on a page, those with the largest residuals are drawn; all are listed.

    Args:
        gaps: One gap per flight.
        overviews: Overview of each flight; none: pages begin with the gap.
    """
    scored = _Scored(
        tuple(gaps),
        tuple(overviews) or (None,) * len(gaps),
        summaries(gaps),
        tuple(tuple(summarise(c) for c in g.channels) for g in gaps),
    )
    return fitted(scored.page, len(gaps))


@dataclass(frozen=True, slots=True)
class _Scored:
    """Flights with all content that does not depend on the resolution.

    Attributes:
        gaps: One gap per flight.
        overviews: One overview per flight; None: not known.
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
        share = min(1.0, FULL_DETAIL / max(len(drawn), 1))
        return render(
            "report.html.j2",
            {"words": describe},
            claim=unfit(gaps) + claim(places),
            detail=_detail(places),
            drive=drive_sentence({g.flight: g.driven_by for g in gaps}),
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
        """Flights that are drawn, in the given order."""
        if len(self.gaps) <= most:
            return list(range(len(self.gaps)))
        places = [rank({s.name: s for s in summed})[:1] for summed in self.summed]
        worst = sorted(
            range(len(places)), key=lambda i: -max([p.weight for p in places[i]], default=-1.0)
        )
        return sorted(worst[:most])

    def _listed(self, drawn: Sequence[int]) -> list[dict[str, Any]]:
        """Rows of the table of flights, drawn ones first."""
        others = [i for i in range(len(self.gaps)) if i not in drawn]
        return [
            {
                "id": f"flight{i}" if i in drawn else "",
                "name": self.gaps[i].flight,
                "duration_s": self.gaps[i].duration_s,
                "claim": unfit([self.gaps[i]]) + claim(rank({s.name: s for s in self.summed[i]})),
                "hover": _hover(self.gaps[i]) if self.gaps[i].hover else "",
            }
            for i in [*drawn, *others][:MOST_LISTED]
        ]

    def _flight(self, index: int, budget: Budget, share: float) -> dict[str, Any]:
        """Figures and tables of one flight, in the form of the template."""
        gap, shown, summed = self.gaps[index], self.overviews[index], self.summed[index]
        name, phases = f"flight{index}", gap.phases
        places = rank({s.name: s for s in summed})
        ends = [c for c in gap.channels if c.name in POS and c.horizon_s > 0]
        track: list[Plot] = []
        logged = view = None
        if shown is not None:
            track, logged = overview_plots(name, shown, phases, budget, ends)
            view = autopilot_content(name, shown.view, phases, budget, share)
        return {
            "track": track,
            "logged": logged,
            "view": view,
            "id": name,
            "name": gap.flight,
            "vehicle": gap.vehicle,
            "duration_s": gap.duration_s,
            "phases": phases,
            "claim": unfit([gap]) + claim(places),
            "figures": [
                _figure(name, kind, members, phases, budget)
                for kind, members in _furthest_first(grouped(gap.channels), places)
            ],
            "rows": _rows(summed),
            "facts": gap.facts,
            "warnings": gap.warnings,
        }


def _furthest_first(
    groups: Iterable[tuple[Kind, Sequence[Channel]]], places: Sequence[Ranked]
) -> list[tuple[Kind, Sequence[Channel]]]:
    """Groups of channels, that with the largest residual first."""
    worst = {(p.channel, p.horizon_s) for p in places[:1]}
    return sorted(groups, key=lambda g: not worst & {(c.name, c.horizon_s) for c in g[1]})


def _hover(gap: FlightGap, before: str = "") -> str:
    """Text on the twin from the hover of a flight."""
    return before + hover_sentence(gap.vehicle, gap.hover, gap.driven_by) if gap.hover else ""


def _detail(places: Sequence[Ranked]) -> str:
    """Text for a pilot on the headline: whether a model can reduce it."""
    if not places or not places[0].score.rms > 0:
        return ""
    score = places[0].score
    slow = min(1.0, (score.slow_rms / score.rms) ** 2)
    text = (
        f"{percent(slow)} of the power of that residual lies below {SLOW_HZ:g} Hz, the band of "
        "flight dynamics; the rest is vibration and noise. "
    )
    if math.isfinite(score.rms_ci95[0]):
        low, high = score.rms_ci95
        text += f"95 % interval of the rms: {number(low)} to {number(high)}. "
    text += f"n = {score.n}."
    later = next((p for p in places if p.horizon_s > 0), None)
    if later and places[0].horizon_s == 0:
        text += (
            f" {later.horizon_s:g} s prediction error: {number(later.score.rms)} "
            f"{pretty_unit(later.unit)} rms in {describe(later.channel)}."
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


Array = NDArray[np.float64]
Line = tuple[int, Array, Array]
"""Index of a flight among overlaid ones, times, s, and values, shape (n,)."""
GROUP = "laid-over"
"""Group of the time axes of overlaid flights."""
COLOURS = (BLUE, "#d9622b", "#2f8f5b", "#8a4fbf", "#b58900", "#c23b66")


@dataclass(frozen=True, slots=True)
class LaidOver:
    """Content of overlaid flights for the template.

    Attributes:
        zero: Time zero, in words.
        figures: Title, kind of comparison, and figure, for each quantity.
    """

    zero: str
    figures: tuple[tuple[str, str, Plot], ...]


def laid_over(
    gaps: Sequence[FlightGap], overviews: Sequence[Overview | None], budget: Budget
) -> LaidOver | None:
    """Measured and residual of every channel that two flights have in common; None without any.

    Args:
        gaps: Gaps of the flights; the first six are drawn.
        overviews: Overview of each flight; None: not known.
        budget: Budget of the page.
    """
    gaps, overviews = gaps[: len(COLOURS)], overviews[: len(COLOURS)]
    zero, begins = _begins(gaps, overviews)
    figures = []
    for kind, horizon_s, channels in _shared(gaps):
        panels = Panels((SIGNAL_PX, RESIDUAL_PX) * len(channels), GROUP)
        for name, of_flights in channels.items():
            unit = pretty_unit(next(iter(of_flights.values())).unit)
            for what, attribute in ((name, "measured"), ("residual", "residual")):
                lines = [
                    (i, c.t_s - begins[i], getattr(c, attribute)) for i, c in of_flights.items()
                ]
                _add(panels, f"{what}, {unit}", lines, gaps, budget)
        title = f"{kind.title}, {mode(horizon_s)}"
        name = f"over-{kind.prefix.rstrip('_') or 'other'}-{round(horizon_s * 1000)}ms"
        label = f"{title}, of {len(gaps)} flights: measured and residual over the time from {zero}"
        figures.append((kind.title, mode(horizon_s), plot(name, label, _looked(panels, zero))))
    battery = _battery(gaps, overviews, begins, budget)
    if battery is not None:
        label = f"Battery of {len(gaps)} flights over the time from {zero}"
        figure = plot("over-battery", label, _looked(battery, zero))
        figures.append(("Battery", "as logged", figure))
    return LaidOver(zero, tuple(figures)) if figures else None


def _begins(
    gaps: Sequence[FlightGap], overviews: Sequence[Overview | None]
) -> tuple[str, list[float]]:
    """Definition of time zero, the same for all flights, and its time in each, s."""
    lifted = [_lift_off_s(gap) for gap in gaps]
    if all(at is not None for at in lifted):
        return "take-off", [at for at in lifted if at is not None]
    armed = [
        min((s.start_s for s in o.view.autopilot.armed), default=None)
        if o is not None and o.view.autopilot is not None
        else None
        for o in overviews
    ]
    if armed and all(at is not None for at in armed):
        return "arming", [at for at in armed if at is not None]
    return "the start of the record", [0.0] * len(gaps)


def _lift_off_s(gap: FlightGap) -> float | None:
    """End of the first time on the ground; None where it is not in the record."""
    for (name, _, end_s), after in zip(gap.phases, gap.phases[1:], strict=False):
        if name == "ground" and after[0] != "ground":
            return end_s
    first = gap.phases[0] if gap.phases else ("", 0.0, 0.0)
    return first[1] if first[0] == "takeoff" else None


def _shared(
    gaps: Sequence[FlightGap],
) -> list[tuple[Kind, float, dict[str, dict[int, Channel]]]]:
    """Quantities in the order of a page: kind, horizon, and the channel of each flight by name;
    only those that two flights have in one unit."""
    found: dict[tuple[int, float], dict[str, dict[int, Channel]]] = {}
    for i, gap in enumerate(gaps):
        for kind, members in grouped(gap.channels):
            place = KINDS.index(kind), members[0].horizon_s
            by_name = found.setdefault(place, {})
            for c in members:
                of_flights = by_name.setdefault(c.name, {})
                if len(c.t_s) > 1 and all(c.unit == o.unit for o in of_flights.values()):
                    of_flights.setdefault(i, c)
    shared = []
    for (k, horizon_s), by_name in sorted(found.items(), key=lambda item: item[0]):
        several = {name: each for name, each in by_name.items() if len(each) > 1}
        if several:
            shared.append((KINDS[k], horizon_s, several))
    return shared


def _battery(
    gaps: Sequence[FlightGap],
    overviews: Sequence[Overview | None],
    begins: Sequence[float],
    budget: Budget,
) -> Panels | None:
    """Voltage and current of the flights that log them."""
    found: dict[str, list[Line]] = {}
    for i, shown in enumerate(overviews):
        for words, t_s, values in shown.battery if shown is not None else ():
            found.setdefault(words, []).append((i, t_s - begins[i], values))
    several: Mapping[str, list[Line]] = {w: lines for w, lines in found.items() if len(lines) > 1}
    if not several:
        return None
    panels = Panels((SIGNAL_PX,) * len(several), GROUP)
    for words, lines in several.items():
        _add(panels, words, lines, gaps, budget)
    return panels


def _add(
    panels: Panels, title: str, lines: Sequence[Line], gaps: Sequence[FlightGap], budget: Budget
) -> None:
    """Add a panel with a curve of each flight."""
    axes = panels.add(title)
    ends = [v for _, t_s, _ in lines for v in (float(t_s[0]), float(t_s[-1]))]
    before = panels.layout["xaxis"].get("range", ends)
    panels.look(min(*ends, *before), max(*ends, *before), ())
    for i, t_s, values in lines:
        line = {"color": COLOURS[i], "width": 1.5}
        name = gaps[i].flight
        panels.series(axes, t_s, values, name, line, budget.columns, band=False)


def _looked(panels: Panels, zero: str) -> Figure:
    """The figure over the time from `zero`; its legend is shared with the others."""
    panels.layout["meta"]["keys"] = GROUP
    last = max((k for k in panels.layout if k.startswith("xaxis")), key=lambda k: int(k[5:] or 1))
    panels.layout[last]["title"] = {"text": f"time from {zero}, s"}
    return panels.figure


MEASURED, TWIN, RESIDUAL = "measured", "nominal twin", "residual (measured - twin)"
"""Names of the curves."""
SIGNAL_PX, RESIDUAL_PX = 165, 96
"""Heights of the panels of a signal and of its residual."""
_LINES = (  # name, colour, dash, width over time
    (MEASURED, BLACK, "solid", 1.4),
    (TWIN, BLUE, "dash", 1.8),
    (RESIDUAL, GREY, "solid", 1.2),
)


def channel_figures(
    channels: Sequence[Channel], phases: Spans, time: str, budget: Budget
) -> tuple[Figure, Figure | None, str]:
    """Measured, twin and residual over time, one pair of panels per channel, and their spectra.

    Args:
        channels: Channels of one quantity and horizon.
        phases: Phases drawn as coloured background.
        time: Group of figures with common time axes.
        budget: Budget of the page.

    Returns:
        The figure over time; the spectra, one panel per channel, None with too few samples; and a
        note on data omitted from the figures ("" if none).
    """
    panels = Panels((SIGNAL_PX, RESIDUAL_PX) * len(channels), time)
    banded = False
    for channel in channels:
        banded |= _add_time(panels, channel, budget)
    ends = [(float(c.t_s[0]), float(c.t_s[-1])) for c in channels if len(c.t_s)]
    if ends:
        panels.look(min(e[0] for e in ends), max(e[1] for e in ends), phases)
    notes = []
    if banded:
        notes.append(f"curves: below {TREND_HZ:g} Hz; bands: all samples")
    spectra = [[spectrum(c.wide.t_s, x) for x in _three(c.wide)] for c in channels]
    if not any(s[0].rate_hz >= DENSE_HZ for s in spectra):
        return panels.figure, None, "; ".join(notes)
    rates = sorted({round(s[0].rate_hz) for s in spectra if math.isfinite(s[0].rate_hz)})
    notes.append(
        "spectra: Welch, samples resampled on their median rate "
        f"({', '.join(f'{r} Hz' for r in rates)})"
    )
    return panels.figure, _spectra_figure(channels, spectra, budget), "; ".join(notes)


def _three(channel: Channel) -> tuple[Array, Array, Array]:
    """Measured, twin and residual for `_LINES`."""
    return channel.measured, channel.simulated, channel.residual


def _add_time(panels: Panels, channel: Channel, budget: Budget) -> bool:
    """Add measured and twin, with the residual below; returns whether bands were drawn."""
    unit = pretty_unit(channel.unit)
    axes = [panels.add(f"{what}, {unit}") for what in (channel.name, "residual")]
    banded = False
    for i, (y, (name, color, dash, width)) in enumerate(zip(_three(channel), _LINES, strict=True)):
        line = {"color": color, "width": width, "dash": dash}
        shown = panels.series(axes[i == 2], channel.t_s, y, name, line, budget.columns)
        banded |= shown.band is not None
    finite = channel.residual[np.isfinite(channel.residual)]
    if len(finite) >= 20:  # 95 % of the residuals are in the band
        low, high = np.percentile(finite, [2.5, 97.5])
        panels.area(axes[1], float(low), float(high))
    return banded


def _spectra_figure(
    channels: Sequence[Channel], spectra: Sequence[Sequence[Spectrum]], budget: Budget
) -> Figure:
    """Power spectral densities of measured, twin and residual, log-log, next to the panels over
    time."""
    panels = Panels((SIGNAL_PX + RESIDUAL_PX + GAP_PX,) * len(channels))
    for i, (channel, three) in enumerate(zip(channels, spectra, strict=True)):
        top = max(float(s.psd[s.f_hz > 0].max(initial=0.0)) for s in three)
        frequency: Axis = {"type": "log", "dtick": 1}
        if i == len(channels) - 1:
            frequency["title"] = {"text": "frequency, Hz"}
        density: Axis = {"type": "log", "exponentformat": "power"}
        if top > 0 and _spread(three) > 9:  # nine decades below the peak is rounding
            density["range"] = [math.log10(top) - 9, math.log10(top) + 0.5]
        title = f"{channel.name}: PSD, ({pretty_unit(channel.unit)})²/Hz"
        axes = panels.add(title, frequency, density)
        for s, (name, color, dash, _) in zip(three, _LINES, strict=True):
            keep = (s.f_hz > 0) & (s.psd > 0)
            f, log_psd = thinned(np.log10(s.f_hz[keep]), np.log10(s.psd[keep]), budget.spectrum)
            panels.line(
                axes,
                10**f,
                10**log_psd,
                name,
                {"color": color, "width": 1.3, "dash": dash},
                hovertemplate="%{y:.3g} at %{x:.3g} Hz<extra>" + name + "</extra>",
            )
    return panels.figure


def _spread(three: Sequence[Spectrum]) -> float:
    """Decades between the largest and the smallest positive density."""
    positive = np.concatenate([s.psd[(s.f_hz > 0) & (s.psd > 0)] for s in three])
    return float(np.log10(positive.max() / positive.min())) if len(positive) else 0.0
