"""Figures of the gap report: a quantity over time, its residual and their spectra."""

import json
import math
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np
import plotly.graph_objects as go
from markupsafe import Markup
from plotly.subplots import make_subplots

from twin.residuals.gap import Array, Channel
from twin.residuals.spectra import Spectrum, spectrum

Phases = Sequence[tuple[str, float, float]]

MAX_POINTS = 20_000
"""Samples of one trace above which the plot, never the numbers, is thinned."""

_GREY = "#8a8f98"
_LINES = (  # name, colour, dash, width over time
    ("measured", "#000000", "solid", 1.2),
    ("nominal twin", "#1f5fd0", "dash", 1.8),
    ("residual (measured - twin)", _GREY, "solid", 1),
)
_PHASE_TINT = {
    "ground": "#b9bec7",
    "takeoff": "#f2b84b",
    "hover": "#7bc6a4",
    "forward": "#86b6f0",
    "tour": "#86b6f0",
    "land": "#d9a3d0",
}


def channel_figure(channels: Sequence[Channel], phases: Phases) -> tuple[go.Figure, str]:
    """Measured, twin and residual over time, and their spectra, one pair of rows per channel.

    Args:
        channels: Of one quantity and horizon.
        phases: Spans (name, start s, end s), drawn as coloured background.

    Returns:
        The figure and a note on what it leaves out ("" if nothing).
    """
    spectra = [[spectrum(c.wide.t_s, x) for x in _three(c.wide)] for c in channels]
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
    _style(figure, plot_px, rows=2 * n)
    _add_phases(figure, channels, phases)
    return figure, "; ".join(notes)


def _three(channel: Channel) -> tuple[Array, Array, Array]:
    """What `_LINES` draws."""
    return channel.measured, channel.simulated, channel.residual


def _add_time_rows(figure: go.Figure, channel: Channel, row: int, first: bool) -> int:
    """Measured over twin, and the residual below; returns the thinning step."""
    step = max(1, math.ceil(len(channel.t_s) / MAX_POINTS))
    t_s = channel.t_s[::step].astype(np.float32)
    sparse = len(channel.t_s) < 300
    for i, (y, (name, color, dash, width)) in enumerate(zip(_three(channel), _LINES, strict=True)):
        figure.add_trace(
            go.Scatter(
                x=t_s,
                y=y[::step].astype(np.float32),
                name=name,
                legendgroup=name,
                showlegend=first,
                mode="lines+markers" if sparse else "lines",
                marker={"size": 4},
                line={"color": color, "width": width, "dash": dash},
                hovertemplate="%{y:.4g} at %{x:.2f} s<extra>" + name + "</extra>",
            ),
            row=row + (i == 2),
            col=1,
        )
    unit, label = escape(pretty_unit(channel.unit)), escape(channel.name)
    figure.update_yaxes(title_text=f"{label}, {unit}", row=row, col=1)
    figure.update_yaxes(title_text=f"residual, {unit}", row=row + 1, col=1)
    finite = channel.residual[np.isfinite(channel.residual)]
    if len(finite) >= 20:  # 95 % of the residuals lie in the band
        low, high = np.percentile(finite, [2.5, 97.5])
        figure.add_hrect(
            y0=float(low),
            y1=float(high),
            fillcolor=_GREY,
            opacity=0.22,
            line_width=0,
            row=row + 1,
            col=1,
        )
    return step


def _add_spectra(
    figure: go.Figure, channel: Channel, three: Sequence[Spectrum], row: int, last: bool
) -> None:
    """Power spectral densities of measured, twin and residual, log-log."""
    top = 0.0
    for density, (name, color, dash, _) in zip(three, _LINES, strict=True):
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
    unit = escape(pretty_unit(channel.unit))
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


def _spread(three: Sequence[Spectrum]) -> float:
    """Decades between the largest and the smallest positive density."""
    positive = np.concatenate([s.psd[(s.f_hz > 0) & (s.psd > 0)] for s in three])
    return float(np.log10(positive.max() / positive.min())) if len(positive) else 0.0


def _style(figure: go.Figure, plot_px: int, rows: int) -> None:
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
    for row in range(1, rows + 1):
        figure.update_xaxes(
            matches="x",
            showticklabels=row == rows,
            row=row,
            col=1,
            title_text="time, s" if row == rows else None,
        )


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
            type="rect",
            xref="x",
            yref="paper",
            x0=start,
            x1=end,
            y0=0,
            y1=1,
            fillcolor=tint,
            opacity=0.16,
            line_width=0,
            layer="below",
        )
        if (end - start) / (high - low) > 0.03:
            figure.add_annotation(
                x=(start + end) / 2,
                xref="x",
                y=1,
                yref="paper",
                yanchor="bottom",
                yshift=1,
                text=escape(name),
                showarrow=False,
                font={"size": 11, "color": "#555"},
                bgcolor="rgba(255,255,255,0.7)",
            )


def embedded(figure: go.Figure) -> Markup:
    """The figure as JSON that may stand inside a script element."""
    text = json.dumps(json.loads(figure.to_json()), sort_keys=True, separators=(",", ":"))
    safe = text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
    return Markup(safe)


def pretty_unit(unit: str) -> str:
    """A unit as printed: `m/s2` is m/s²."""
    return unit.replace("^", "").replace("s2", "s²").replace("m2", "m²")
