"""Figures of the gap report: a quantity over time, its residual and their spectra.

They are written as plotly.js reads them; building them with plotly's own objects takes ten times as
long as all the rest of a report.
"""

import json
import math
from base64 import b64encode
from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from twin.residuals.gap import Array, Channel
from twin.residuals.spectra import Spectrum, spectrum

if TYPE_CHECKING:
    import plotly.graph_objects as go

Phases = Sequence[tuple[str, float, float]]
Figure = dict[str, Any]
"""`data` and `layout` as plotly.js reads them."""
Axis = dict[str, Any]

MAX_POINTS = 20_000
"""Samples of one trace above which the plot, never the numbers, is thinned."""

_HEIGHTS_PX, _GAP_PX = (165, 96), 17
"""Signal and residual of a channel, and what is between two rows."""
_TIME_SHARE, _BESIDE = 0.677, 0.085
"""Width of what is drawn over time beside spectra, and between both."""
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


def channel_figure(channels: Sequence[Channel], phases: Phases) -> tuple[Figure, str]:
    """Measured, twin and residual over time, and their spectra, one pair of rows per channel.

    Args:
        channels: Of one quantity and horizon.
        phases: Spans (name, start s, end s), drawn as coloured background.

    Returns:
        The figure and a note on what it leaves out ("" if nothing).
    """
    spectra = [[spectrum(c.wide.t_s, x) for x in _three(c.wide)] for c in channels]
    dense = any(s[0].rate_hz >= 20 for s in spectra)
    heights_px = _HEIGHTS_PX * len(channels)
    plot_px = sum(heights_px) + (len(heights_px) - 1) * _GAP_PX
    rows = _domains(heights_px, plot_px)
    figure: Figure = {"data": [], "layout": _layout(plot_px)}
    notes = []
    for i, (channel, three) in enumerate(zip(channels, spectra, strict=True)):
        last = i == len(channels) - 1
        thinned = _add_time_rows(figure, channel, rows[2 * i : 2 * i + 2], dense, i == 0, last)
        if thinned > 1:
            notes.append(f"{channel.name}: 1 in {thinned} of {len(channel.t_s)} samples drawn")
        if dense:
            whole = [rows[2 * i + 1][0], rows[2 * i][1]]
            _add_spectra(figure, channel, three, whole, last)
    if dense:
        rates = sorted({round(s[0].rate_hz) for s in spectra if math.isfinite(s[0].rate_hz)})
        notes.append(
            "spectra: Welch, samples resampled on their median rate "
            f"({', '.join(f'{r} Hz' for r in rates)})"
        )
    _add_phases(figure, channels, phases)
    return figure, "; ".join(notes)


def _three(channel: Channel) -> tuple[Array, Array, Array]:
    """What `_LINES` draws."""
    return channel.measured, channel.simulated, channel.residual


def _domains(heights_px: Sequence[int], plot_px: int) -> list[list[float]]:
    """Lower and upper end of each row from top to bottom, as shares of the plot."""
    tops = [1 - (sum(heights_px[:k]) + k * _GAP_PX) / plot_px for k in range(len(heights_px))]
    return [[max(t - h / plot_px, 0.0), t] for t, h in zip(tops, heights_px, strict=True)]


def _layout(plot_px: int) -> dict[str, Any]:
    return {
        "height": plot_px + 116,
        "margin": {"l": 78, "r": 16, "t": 64, "b": 46},
        "font": {"family": "system-ui, 'Segoe UI', sans-serif", "size": 12, "color": "#222"},
        "legend": {"orientation": "h", "x": 0, "y": 1, "yref": "container", "yanchor": "top"},
        "hovermode": "closest",
        "hoverlabel": {"align": "left"},
        "paper_bgcolor": "#ffffff",
        "plot_bgcolor": "#ffffff",
        "shapes": [],
        "annotations": [],
    }


def _add_axes(
    figure: Figure, x_domain: Sequence[float], y_domain: Sequence[float], x: Axis, y: Axis
) -> str:
    """Add a pair of axes; returns its number as plotly.js writes it: "" for the first."""
    layout = figure["layout"]
    count = 1 + sum(key.startswith("xaxis") for key in layout)
    number = "" if count == 1 else str(count)
    common = {"showline": True, "linecolor": "#c8ccd2", "gridcolor": "#eceef1", "automargin": True}
    layout[f"xaxis{number}"] = {
        **common,
        "ticks": "outside",
        "tickcolor": "#c8ccd2",
        "zerolinecolor": "#eceef1",
        "anchor": f"y{number}",
        "domain": list(x_domain),
        **x,
    }
    layout[f"yaxis{number}"] = {
        **common,
        "zerolinecolor": "#d5d8dd",
        "anchor": f"x{number}",
        "domain": list(y_domain),
        **y,
    }
    return number


def _add_lines(
    figure: Figure, axes: str, x: Array, y: Array, line: Mapping[str, Any], **more: Any
) -> None:
    """Add a trace to a pair of axes."""
    figure["data"].append(
        {
            "type": "scatter",
            "mode": "lines",
            "x": _packed(x),
            "y": _packed(y),
            "xaxis": f"x{axes}",
            "yaxis": f"y{axes}",
            "line": dict(line),
            **more,
        }
    )


def _add_time_rows(
    figure: Figure,
    channel: Channel,
    rows: Sequence[Sequence[float]],
    dense: bool,
    first: bool,
    last: bool,
) -> int:
    """Measured over twin, and the residual below; returns the thinning step."""
    unit, label = escape(pretty_unit(channel.unit)), escape(channel.name)
    x_domain = [0.0, _TIME_SHARE] if dense else [0.0, 1.0]
    axes = []
    for row, what in zip(rows, (label, "residual"), strict=True):
        bottom = last and row is rows[1]
        time: Axis = {"showticklabels": bottom}
        if not first or row is rows[1]:
            time["matches"] = "x"
        if bottom:
            time["title"] = {"text": "time, s"}
        axes.append(_add_axes(figure, x_domain, row, time, {"title": _title(f"{what}, {unit}")}))
    step = max(1, math.ceil(len(channel.t_s) / MAX_POINTS))
    for i, (y, (name, color, dash, width)) in enumerate(zip(_three(channel), _LINES, strict=True)):
        _add_lines(
            figure,
            axes[i == 2],
            channel.t_s[::step],
            y[::step],
            {"color": color, "width": width, "dash": dash},
            name=name,
            legendgroup=name,
            showlegend=first,
            mode="lines+markers" if len(channel.t_s) < 300 else "lines",
            marker={"size": 4},
            hovertemplate="%{y:.4g} at %{x:.2f} s<extra>" + name + "</extra>",
        )
    finite = channel.residual[np.isfinite(channel.residual)]
    if len(finite) >= 20:  # 95 % of the residuals lie in the band
        low, high = np.percentile(finite, [2.5, 97.5])
        figure["layout"]["shapes"].append(
            {
                "type": "rect",
                "xref": f"x{axes[1]} domain",
                "yref": f"y{axes[1]}",
                "x0": 0,
                "x1": 1,
                "y0": float(low),
                "y1": float(high),
                "fillcolor": _GREY,
                "opacity": 0.22,
                "line": {"width": 0},
            }
        )
    return step


def _add_spectra(
    figure: Figure,
    channel: Channel,
    three: Sequence[Spectrum],
    y_domain: Sequence[float],
    last: bool,
) -> None:
    """Power spectral densities of measured, twin and residual, log-log."""
    top = max(float(s.psd[s.f_hz > 0].max(initial=0.0)) for s in three)
    unit = escape(pretty_unit(channel.unit))
    frequency: Axis = {"type": "log", "dtick": 1}
    if last:
        frequency["title"] = {"text": "frequency, Hz"}
    density: Axis = {
        "type": "log",
        "title": _title(f"PSD, ({unit})²/Hz"),
        "exponentformat": "power",
        "nticks": 6,
    }
    if _spread(three) > 9:  # what lies nine decades below the peak is rounding, not flight
        density["range"] = [math.log10(top) - 9, math.log10(top) + 0.5]
    axes = _add_axes(figure, [_TIME_SHARE + _BESIDE, 1.0], y_domain, frequency, density)
    for s, (name, color, dash, _) in zip(three, _LINES, strict=True):
        keep = s.f_hz > 0
        _add_lines(
            figure,
            axes,
            s.f_hz[keep],
            np.where(s.psd[keep] > 0, s.psd[keep], np.nan),
            {"color": color, "width": 1.3, "dash": dash},
            legendgroup=name,
            showlegend=False,
            hovertemplate="%{y:.3g} at %{x:.3g} Hz<extra>" + name + "</extra>",
        )


def _spread(three: Sequence[Spectrum]) -> float:
    """Decades between the largest and the smallest positive density."""
    positive = np.concatenate([s.psd[(s.f_hz > 0) & (s.psd > 0)] for s in three])
    return float(np.log10(positive.max() / positive.min())) if len(positive) else 0.0


def _title(text: str) -> dict[str, Any]:
    """Title of a vertical axis."""
    return {"text": text, "font": {"size": 11.5}, "standoff": 8}


def _packed(values: Array) -> dict[str, str]:
    """Numbers as plotly.js reads them in single precision, four bytes each."""
    raw = np.ascontiguousarray(values, dtype="<f4").tobytes()
    return {"dtype": "f4", "bdata": b64encode(raw).decode("ascii")}


def _add_phases(figure: Figure, channels: Sequence[Channel], phases: Phases) -> None:
    """Coloured background over the time column, name on top."""
    ends = [(float(c.t_s[0]), float(c.t_s[-1])) for c in channels if len(c.t_s)]
    if not ends:
        return
    low, high = min(e[0] for e in ends), max(e[1] for e in ends)
    layout = figure["layout"]
    for axis in layout.values():
        if axis is layout["xaxis"] or (isinstance(axis, dict) and axis.get("matches") == "x"):
            axis["range"] = [low, high]
    for name, start, end in phases:
        start, end = max(start, low), min(end, high)
        if end <= start:
            continue
        layout["shapes"].append(
            {
                "type": "rect",
                "xref": "x",
                "yref": "paper",
                "x0": start,
                "x1": end,
                "y0": 0,
                "y1": 1,
                "fillcolor": _PHASE_TINT.get(name, "#c9cdd4"),
                "opacity": 0.16,
                "line": {"width": 0},
                "layer": "below",
            }
        )
        if (end - start) / (high - low) > 0.03:
            layout["annotations"].append(
                {
                    "x": (start + end) / 2,
                    "xref": "x",
                    "y": 1,
                    "yref": "paper",
                    "yanchor": "bottom",
                    "yshift": 1,
                    "text": escape(name),
                    "showarrow": False,
                    "font": {"size": 11, "color": "#555"},
                    "bgcolor": "rgba(255,255,255,0.7)",
                }
            )


def embedded(figure: "Figure | go.Figure") -> Markup:
    """The figure as JSON that may stand inside a script element."""
    plain = figure if isinstance(figure, dict) else json.loads(figure.to_json())
    text = json.dumps(plain, sort_keys=True, separators=(",", ":"))
    safe = text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
    return Markup(safe)


def pretty_unit(unit: str) -> str:
    """A unit as printed: `m/s2` is m/s²."""
    return unit.replace("^", "").replace("s2", "s²").replace("m2", "m²")
