"""The gap report: one HTML file, claim first, figures second, numbers in a table.

The page embeds plotly.js once and fetches nothing. Figures are stored as JSON and drawn when
they come into view, so a page with many flights opens at once.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import plotly.graph_objects as go
from markupsafe import Markup
from numpy.typing import NDArray
from plotly.offline import get_plotlyjs
from plotly.subplots import make_subplots

from twin.residuals import (
    SLOW_HZ,
    UNKNOWN_PHASE,
    Channel,
    FlightGap,
    Ranked,
    Score,
    Summary,
    rank,
    spectrum,
    summaries,
    summarise,
)

Array = NDArray[np.float64]
Phases = Sequence[tuple[str, float, float]]

MAX_POINTS = 20_000
"""Samples of one trace above which the plot, never the numbers, is thinned."""

AGREEMENT = 0.1
"""Share of the signal below which the slow part of a residual is called agreement. With the noise
of the built-in flights alone it reaches 0.08."""

_MEASURED, _TWIN, _RESIDUAL = "#000000", "#1f5fd0", "#8a8f98"
_PHASE_TINT = {
    "ground": "#b9bec7",
    "takeoff": "#f2b84b",
    "hover": "#7bc6a4",
    "forward": "#86b6f0",
    "tour": "#86b6f0",
    "land": "#d9a3d0",
}
_GROUPS = (  # prefix of the channel name, title, axes
    ("acc_", "Specific force (accelerometer)", "body axes: x forward, y right, z down"),
    ("angacc_", "Angular acceleration", "body axes: x roll, y pitch, z yaw"),
    ("gyro_", "Body rates", "body axes: x roll, y pitch, z yaw"),
    ("vel_", "Velocity", "x north, y east, z down"),
    ("pos_", "Position", "x north, y east, z down"),
    ("att_", "Attitude", "x roll, y pitch, z yaw"),
    ("q_", "Attitude (quaternion)", "body to NED"),
    ("mag_", "Magnetic field", "body axes"),
    ("baro_", "Air pressure", ""),
    ("", "Other channels", ""),
)
_WORDS = {
    "acc_": "specific force",
    "angacc_": "angular acceleration",
    "gyro_": "body rate",
    "vel_": "velocity",
    "pos_": "position",
    "att_": "attitude",
    "mag_": "magnetic field",
    "baro_": "air pressure",
}
_BODY = {"x": "forward axis", "y": "right axis", "z": "down axis"}
_TURN = {"x": "roll", "y": "pitch", "z": "yaw"}
_EARTH = {"x": "north", "y": "east", "z": "down"}
_AXIS = {"acc_": _BODY, "angacc_": _TURN, "gyro_": _TURN, "vel_": _EARTH, "pos_": _EARTH,
         "att_": _TURN, "mag_": _BODY}  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Figure:
    """What the template needs of one figure."""

    id: str
    title: str
    axes: str
    mode: str
    note: str
    height: int
    json: Markup


def write_gap_report(gaps: Sequence[FlightGap], path: Path) -> None:
    """Write the report of one or more flights against their twin.

    The same gaps give the same bytes: identifiers are counted, no time is written.

    Args:
        gaps: One per flight.
        path: HTML file to write; an existing one is replaced.
    """
    pooled = summaries(gaps)
    places = rank(pooled)
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("cosim", "."),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(number=_number, percent=_percent, unit=_unit, words=describe)
    horizons = sorted({c.horizon_s for g in gaps for c in g.channels if c.horizon_s > 0})
    page = environment.get_template("report.html.j2").render(
        claim=claim(places),
        detail=_detail(places),
        places=places[:6],
        slow_hz=SLOW_HZ,
        horizons=horizons,
        teacher_forced=any(c.horizon_s == 0 for g in gaps for c in g.channels),
        pooled=pooled if len(gaps) > 1 else {},
        flights=[_flight(i, gap) for i, gap in enumerate(gaps)],
        plotlyjs=Markup(get_plotlyjs()),
    )
    path.write_text(page, encoding="utf-8")


def claim(places: Sequence[Ranked]) -> str:
    """The headline: the place where twin and flight disagree most, in one sentence.

    Args:
        places: Of `twin.residuals.rank`, the worst first.
    """
    if not places:
        return "There is nothing to compare: no channel has enough finite samples."
    worst = places[0]
    where = f"{worst.channel} ({describe(worst.channel)})"
    if worst.phase and worst.phase != UNKNOWN_PHASE:
        where += f" during {worst.phase}"
    size = f"{_number(worst.score.rms)} {_unit(worst.unit)} rms, {_percent(worst.score.share)}"
    if worst.weight < AGREEMENT:
        return (
            "Twin and flight agree: the slow part of the residual stays below "
            f"{_percent(AGREEMENT)} of the signal "
            f"in every channel and phase. The largest gap is in {where}: {size} of the signal."
        )
    return f"Twin and flight disagree most in {where}: {size} of the signal."


def describe(channel: str) -> str:
    """A channel's name in words: `acc_z` is the specific force on the down axis."""
    name = channel.split("@")[0]
    for prefix, words in _WORDS.items():
        if name.startswith(prefix):
            axis = _AXIS.get(prefix, {}).get(name.removeprefix(prefix), "")
            return f"{words}, {axis}" if axis else words
    return name.replace("_", " ")


def _detail(places: Sequence[Ranked]) -> str:
    """What a pilot should make of the headline: can a model mend it?"""
    if not places or not places[0].score.rms > 0:
        return ""
    score = places[0].score
    slow = min(1.0, (score.slow_rms / score.rms) ** 2)
    text = (
        f"{_percent(slow)} of the power of that residual lies below {SLOW_HZ:g} Hz, where a model "
        "of the flight can mend it; the rest is vibration and noise. "
    )
    if math.isfinite(score.rms_ci95[0]):
        low, high = score.rms_ci95
        text += f"95 % interval of the rms: {_number(low)} to {_number(high)}. "
    text += f"n = {score.n}."
    later = next((p for p in places if p.horizon_s > 0), None)
    if later and places[0].horizon_s == 0:
        text += (
            f" Restarted from the measured state, the twin is off by {_number(later.score.rms)} "
            f"{_unit(later.unit)} rms in {describe(later.channel)} after {later.horizon_s:g} s."
        )
    return text


def _flight(index: int, gap: FlightGap) -> dict[str, Any]:
    """Figures and tables of one flight, as the template reads them."""
    figures = []
    for key, (title, axes, channels) in _grouped(gap.channels).items():
        figure, note = channel_figure(channels, gap.phases)
        figures.append(
            _Figure(
                id=f"flight{index}-{key}",
                title=title,
                axes=axes,
                mode=_mode(channels[0].horizon_s),
                note=note,
                height=int(figure.layout.height),
                json=_embed(figure),
            )
        )
    summed = [summarise(c) for c in gap.channels]
    spans = [(float(c.t_s[0]), float(c.t_s[-1])) for c in gap.channels if len(c.t_s)]
    return {
        "id": f"flight{index}",
        "name": gap.flight,
        "vehicle": gap.vehicle,
        "duration_s": max(e for _, e in spans) - min(s for s, _ in spans) if spans else 0.0,
        "phases": gap.phases,
        "claim": claim(rank({s.name: s for s in summed})),
        "figures": figures,
        "rows": _rows(summed),
        "facts": gap.facts,
        "warnings": gap.warnings,
    }


def _grouped(channels: Sequence[Channel]) -> dict[str, tuple[str, str, list[Channel]]]:
    """Channels that share a figure: same quantity, same horizon; in the order of `_GROUPS`."""
    found: dict[tuple[int, float], list[Channel]] = {}
    for channel in channels:
        kind = next(i for i, g in enumerate(_GROUPS) if channel.name.startswith(g[0]))
        found.setdefault((kind, channel.horizon_s), []).append(channel)
    result = {}
    for (kind, horizon_s), members in sorted(found.items(), key=lambda item: item[0]):
        prefix, title, axes = _GROUPS[kind]
        key = f"{prefix.rstrip('_') or 'other'}-{round(horizon_s * 1000)}ms"
        result[key] = (title, axes, members)
    return result


def _mode(horizon_s: float) -> str:
    return "teacher-forced" if horizon_s == 0 else f"short horizon, {horizon_s:g} s"


def channel_figure(channels: Sequence[Channel], phases: Phases) -> tuple[go.Figure, str]:
    """Measured, twin and residual over time, and their spectra, one pair of rows per channel.

    Args:
        channels: Of one quantity and horizon.
        phases: Spans (name, start s, end s), drawn as coloured background.

    Returns:
        The figure and a note on what it leaves out ("" if nothing).
    """
    spectra = [
        tuple(spectrum(c.t_s, x) for x in (c.measured, c.simulated, c.residual)) for c in channels
    ]
    dense = any(s[0].rate_hz >= 20 for s in spectra)
    n = len(channels)
    heights, gap_px, pad_px = (165, 96), 14, 20
    specs: list[list[Any]] = []
    for _ in channels:
        specs += [[{}, {"rowspan": 2}], [{}, None]] if dense else [[{}], [{}]]
    plot_px = n * sum(heights) + (2 * n - 1) * (gap_px + pad_px) // 2
    figure = make_subplots(
        rows=2 * n,
        cols=2 if dense else 1,
        specs=specs,
        row_heights=list(heights) * n,
        column_widths=[0.74, 0.26] if dense else None,
        vertical_spacing=min(0.5 / n, gap_px / plot_px * 1.6),
        horizontal_spacing=0.085,
    )
    notes = []
    for i, (channel, three) in enumerate(zip(channels, spectra, strict=True)):
        thinned = _add_time_rows(figure, channel, 2 * i + 1, first=i == 0)
        if thinned > 1:
            notes.append(f"{channel.name}: 1 in {thinned} of {len(channel.t_s)} samples drawn")
        if dense:
            _add_spectra(figure, channel, three, 2 * i + 1, last=i == n - 1)
    if dense:
        rates = sorted({round(s[0].rate_hz) for s in spectra if math.isfinite(s[0].rate_hz)})
        notes.append(
            "spectra: Welch, samples resampled on their median rate "
            f"({', '.join(f'{r} Hz' for r in rates)})"
        )
    _style(figure, plot_px, columns=2 if dense else 1)
    _add_phases(figure, channels, phases)
    return figure, "; ".join(notes)


def _add_time_rows(figure: go.Figure, channel: Channel, row: int, first: bool) -> int:
    """Measured over twin, and the residual below; returns the thinning step."""
    step = max(1, math.ceil(len(channel.t_s) / MAX_POINTS))
    t_s = channel.t_s[::step].astype(np.float32)
    sparse = len(channel.t_s) < 300
    residual = channel.residual
    widths = {"nominal twin": 1.8, "measured": 1.2}
    for y, name, color, dash, at in (
        (channel.measured, "measured", _MEASURED, "solid", row),
        (channel.simulated, "nominal twin", _TWIN, "dash", row),
        (residual, "residual (measured - twin)", _RESIDUAL, "solid", row + 1),
    ):
        figure.add_trace(
            go.Scatter(
                x=t_s,
                y=y[::step].astype(np.float32),
                name=name,
                legendgroup=name,
                showlegend=first,
                mode="lines+markers" if sparse else "lines",
                marker={"size": 4},
                line={"color": color, "width": widths.get(name, 1), "dash": dash},
                hovertemplate="%{y:.4g} at %{x:.2f} s<extra>" + name + "</extra>",
            ),
            row=at,
            col=1,
        )
    unit, label = escape(_unit(channel.unit)), escape(channel.name)
    figure.update_yaxes(title_text=f"{label}, {unit}", row=row, col=1)
    figure.update_yaxes(title_text=f"residual, {unit}", row=row + 1, col=1)
    finite = residual[np.isfinite(residual)]
    if len(finite) >= 20:  # 95 % of the residuals lie in the band
        low, high = np.percentile(finite, [2.5, 97.5])
        figure.add_hrect(
            y0=float(low),
            y1=float(high),
            fillcolor=_RESIDUAL,
            opacity=0.22,
            line_width=0,
            row=row + 1,
            col=1,
        )
    return step


def _add_spectra(
    figure: go.Figure, channel: Channel, three: Sequence[Any], row: int, last: bool
) -> None:
    """Power spectral densities of measured, twin and residual, log-log."""
    styles = (
        ("measured", _MEASURED, "solid"),
        ("nominal twin", _TWIN, "dash"),
        ("residual (measured - twin)", _RESIDUAL, "solid"),
    )
    top = 0.0
    for density, (name, color, dash) in zip(three, styles, strict=True):
        keep = density.f_hz > 0
        psd = density.psd[keep]
        top = max(top, float(psd.max(initial=0.0)))
        figure.add_trace(
            go.Scatter(
                x=density.f_hz[keep].astype(np.float32),
                y=np.where(psd > 0, psd, np.nan).astype(np.float32),
                legendgroup=name,
                showlegend=False,
                mode="lines",
                line={"color": color, "width": 1.3, "dash": dash},
                hovertemplate="%{y:.3g} at %{x:.3g} Hz<extra>" + name + "</extra>",
            ),
            row=row,
            col=2,
        )
    figure.update_xaxes(
        type="log", row=row, col=2, title_text="frequency, Hz" if last else None, dtick=1
    )
    unit = escape(_unit(channel.unit))
    figure.update_yaxes(
        type="log",
        row=row,
        col=2,
        title_text=f"PSD, ({unit})²/Hz",
        exponentformat="power",
        nticks=6,
        # what lies nine decades below the peak is rounding, not flight
        range=[math.log10(top) - 9, math.log10(top) + 0.5] if _spread(three) > 9 else None,
    )


def _spread(three: Sequence[Any]) -> float:
    """Decades between the largest and the smallest positive density."""
    positive = np.concatenate([s.psd[(s.f_hz > 0) & (s.psd > 0)] for s in three])
    return float(np.log10(positive.max() / positive.min())) if len(positive) else 0.0


def _style(figure: go.Figure, plot_px: int, columns: int) -> None:
    rows = sum(1 for t in figure.data if t.xaxis and t.name == "measured")
    figure.update_layout(
        template="plotly_white",
        height=plot_px + 116,
        margin={"l": 78, "r": 16, "t": 64, "b": 46},
        font={"family": "system-ui, 'Segoe UI', sans-serif", "size": 12, "color": "#222"},
        legend={"orientation": "h", "x": 0, "y": 1, "yref": "container", "yanchor": "top"},
        hovermode="closest",
        paper_bgcolor="#ffffff",
        plot_bgcolor="#ffffff",
    )
    figure.update_xaxes(
        showline=True,
        linecolor="#c8ccd2",
        gridcolor="#eceef1",
        ticks="outside",
        tickcolor="#c8ccd2",
    )
    figure.update_yaxes(
        showline=True,
        linecolor="#c8ccd2",
        gridcolor="#eceef1",
        zerolinecolor="#d5d8dd",
        title_font={"size": 11.5},
        title_standoff=8,
    )
    last = 2 * rows
    for row in range(1, last + 1):
        figure.update_xaxes(
            matches="x", showticklabels=row == last, row=row, col=1,
            title_text="time, s" if row == last else None,
        )  # fmt: skip


def _add_phases(figure: go.Figure, channels: Sequence[Channel], phases: Phases) -> None:
    """Coloured background over the time column, name on top."""
    ends = [(float(c.t_s[0]), float(c.t_s[-1])) for c in channels if len(c.t_s)]
    if not ends:
        return
    low, high = min(e[0] for e in ends), max(e[1] for e in ends)
    figure.update_xaxes(range=[low, high], selector={"matches": "x"})
    for name, start, end in phases:
        start, end = max(start, low), min(end, high)
        if end <= start:
            continue
        tint = _PHASE_TINT.get(name, "#c9cdd4")
        figure.add_shape(
            type="rect", xref="x", yref="paper", x0=start, x1=end, y0=0, y1=1,
            fillcolor=tint, opacity=0.16, line_width=0, layer="below",
        )  # fmt: skip
        if (end - start) / (high - low) > 0.03:
            figure.add_annotation(
                x=(start + end) / 2, xref="x", y=1, yref="paper", yanchor="bottom", yshift=1,
                text=escape(name), showarrow=False, font={"size": 11, "color": "#555"},
                bgcolor="rgba(255,255,255,0.7)",
            )  # fmt: skip


def _embed(figure: go.Figure) -> Markup:
    """The figure as JSON that may stand inside a script element."""
    text = json.dumps(json.loads(figure.to_json()), sort_keys=True, separators=(",", ":"))
    safe = text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
    return Markup(safe)


def _rows(summed: Sequence[Summary]) -> list[dict[str, Any]]:
    """Lines of the table: the whole channel, then its phases."""
    rows: list[dict[str, Any]] = []
    for s in summed:
        scores: Mapping[str, Score] = {"whole flight": s.total, **s.by_phase}
        for i, (phase, score) in enumerate(scores.items()):
            rows.append(
                {
                    "span": len(scores) if i == 0 else 0,
                    "name": s.name,
                    "unit": s.unit,
                    "mode": _mode(s.horizon_s),
                    "phase": phase,
                    "score": score,
                }
            )
    return rows


def _number(value: float) -> str:
    """Three significant figures; a dash where there is no number."""
    if not math.isfinite(value):
        return "\N{EN DASH}"
    if value != 0 and (abs(value) < 1e-3 or abs(value) >= 1e5):
        text = f"{value:.2e}"
    else:
        text = f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
    return text.replace("-", "\N{MINUS SIGN}")


def _percent(share: float) -> str:
    if not math.isfinite(share):
        return "\N{EN DASH}"
    return f"{100 * share:.2g} %" if share < 0.1 else f"{100 * share:.0f} %"


def _unit(unit: str) -> str:
    """A unit as printed: `m/s2` is m/s²."""
    return unit.replace("^", "").replace("s2", "s²").replace("m2", "m²")
