"""Figures of the compensator's pages."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from twin.residuals.spectra import spectrum

from .figures import pretty_unit

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]
MAX_POINTS = 4000
"""Samples of one trace above which the plot, never the numbers, is thinned."""
_LINES = {  # colour, dash, width: the same in every report
    "measured": ("#000000", "solid", 1.2),
    "twin": ("#1f5fd0", "dash", 1.5),
    "explained twin": ("#2f8f5b", "dash", 1.5),
    "corrected twin": ("#e07b1a", "solid", 1.5),
}
_GREY = "#8a8f98"
_MODELS = (
    *("#8a8f98", "#c3c7cd", "#b58900", "#1f5fd0", "#2f8f5b"),
    *("#8a4fbf", "#c23b66", "#5fb8c9", "#e07b1a"),
)
"""Colours of twins that are compared, trivial ones first and the corrected one last."""
_LOSSES = {
    "reconstruction": "#1f5fd0",
    "quantiser": "#8a4fbf",
    "distribution": "#b58900",
    "validation": "#000000",
}


def curve_figure(curve: Sequence[Mapping[str, Any]], best_epoch: int) -> go.Figure:
    """Parts of the loss and the validation error over the epochs.

    Args:
        curve: One entry per epoch.
        best_epoch: The one whose weights were kept.
    """
    figure = go.Figure()
    names = dict.fromkeys(n for e in curve for n in e if n not in ("epoch", "learning_rate"))
    for name in names:
        points = [(e["epoch"], e[name]) for e in curve if e.get(name)]
        if not points:
            continue
        x, y = zip(*points, strict=True)
        mode = "lines+markers" if name == "validation" else "lines"
        line = {"color": _LOSSES.get(name), "width": 1.5}
        figure.add_scatter(x=x, y=y, name=name, mode=mode, line=line)
    figure.add_vline(x=best_epoch, line={"color": _GREY, "dash": "dot"}, annotation_text="kept")
    figure.update_xaxes(title_text="epoch")
    positive = all(e[n] > 0 for e in curve for n in names if e.get(n))
    scale = "log" if positive else "linear"  # scores of a critic may have either sign
    figure.update_yaxes(title_text="loss, standardised units", type=scale)
    return styled(figure, 380)


def correction_figure(
    name: str, unit: str, t_s: Array, lines: Mapping[str, Array], spread: Array
) -> go.Figure:
    """Measured, twin, explained twin and corrected twin over time, and what is left below.

    Args:
        name: Of the channel.
        unit: Of the channel.
        t_s: Times of the samples, shape (n,).
        lines: Some of `_LINES`, shape (n,) each; "measured" and "corrected twin" among them.
        spread: Predicted standard deviation of what is left, shape (n,).
    """
    every = max(1, -(-len(t_s) // MAX_POINTS))
    figure = make_subplots(
        rows=2, cols=1, shared_xaxes=True, row_heights=[0.62, 0.38], vertical_spacing=0.06
    )
    t = thin(t_s, every)
    for line, values in lines.items():
        colour, dash, width = _LINES[line]
        figure.add_scatter(
            x=t,
            y=thin(values, every),
            name=line,
            mode="lines",
            line={"color": colour, "dash": dash, "width": width},
            row=1,
            col=1,
        )
    for line in ("twin", "corrected twin"):
        left = lines["measured"] - lines[line]
        figure.add_scatter(
            x=t,
            y=thin(left, every),
            name=f"measured - {line}",
            mode="lines",
            line={"color": _LINES[line][0], "width": 1},
            row=2,
            col=1,
        )
    edge = thin(2 * spread, every)
    for sign, fill in ((1, None), (-1, "tonexty")):
        figure.add_scatter(
            x=t,
            y=[sign * e for e in edge],
            name="two predicted spreads",
            mode="lines",
            line={"width": 0},
            fill=fill,
            fillcolor="rgba(138,143,152,.22)",
            showlegend=sign < 0,
            hoverinfo="skip",
            row=2,
            col=1,
        )
    shown = escape(pretty_unit(unit))
    figure.update_yaxes(title_text=f"{escape(name)}, {shown}", row=1, col=1)
    figure.update_yaxes(title_text=f"left, {shown}", row=2, col=1)
    figure.update_xaxes(title_text="time, s", row=2, col=1)
    return styled(figure, 420)


def spectra_figure(
    title: str, names: Sequence[str], t_s: Array, lines: Mapping[str, Array]
) -> go.Figure:
    """Power spectra of several signals, a panel per channel.

    Args:
        title: Of the figure.
        names: Of the channels.
        t_s: Times of the samples, shape (n,).
        lines: By name, shape (n, channels).
    """
    figure = make_subplots(rows=1, cols=len(names), shared_yaxes=True, subplot_titles=list(names))
    for i in range(len(names)):
        for (line, values), colour in zip(lines.items(), ("#000000", "#e07b1a"), strict=True):
            found = spectrum(t_s, values[:, i])
            figure.add_scatter(
                x=found.f_hz[1:],
                y=np.where(found.psd[1:] > 0, found.psd[1:], np.nan),
                name=line,
                mode="lines",
                line={"color": colour, "width": 1.2},
                showlegend=i == 0,
                row=1,
                col=i + 1,
            )
    figure.update_xaxes(title_text="Hz", type="log")
    figure.update_yaxes(type="log")
    figure.update_layout(title_text=escape(title))
    return styled(figure, 320)


def anomaly_figure(t_s: Array, anomaly: Array) -> go.Figure:
    """Anomaly score over time, with the level above which it is an alarm."""
    every = max(1, -(-len(t_s) // MAX_POINTS))
    figure = go.Figure()
    figure.add_scatter(
        x=thin(t_s, every),
        y=thin(anomaly, every),
        mode="lines",
        line={"color": "#c23b66", "width": 1.2},
        name="anomaly score",
    )
    figure.add_hline(y=1, line={"color": _GREY, "dash": "dot"}, annotation_text="alarm")
    figure.update_xaxes(title_text="time, s")
    figure.update_yaxes(title_text="anomaly score", rangemode="tozero")
    return styled(figure, 260)


def horizons_figure(rows: "pd.DataFrame", quantities: Sequence[tuple[str, str]]) -> go.Figure:
    """How far twins are off over the time since they were left alone, a panel per quantity.

    Args:
        rows: `model`, `horizon_s` and a column per quantity.
        quantities: Names and units.
    """
    figure = make_subplots(rows=1, cols=len(quantities), horizontal_spacing=0.07)
    for k, (model, part) in enumerate(rows.groupby("model", sort=False)):
        colour = _MODELS[k % len(_MODELS)]
        for column, (quantity, _) in enumerate(quantities, start=1):
            figure.add_scatter(
                x=part["horizon_s"],
                y=part[quantity],
                name=str(model),
                legendgroup=str(model),
                showlegend=column == 1,
                mode="lines+markers",
                line={"color": colour, "width": 1.5},
                row=1,
                col=column,
            )
    for column, (quantity, unit) in enumerate(quantities, start=1):
        title = f"{escape(quantity)}, {escape(pretty_unit(unit))}"
        figure.update_yaxes(title_text=title, type="log", row=1, col=column)
        figure.update_xaxes(title_text="left alone for, s", type="log", row=1, col=column)
    return styled(figure, 420)


def thin(values: Array | Sequence[float], every: int = 1) -> list[float]:
    """Every `every`-th value, with six digits: what a page holds of it."""
    return [float(f"{v:.6g}") for v in np.asarray(values, dtype=np.float64)[::every]]


def styled(figure: go.Figure, height: int) -> go.Figure:
    """The figure in the style of all pages, height in pixels."""
    figure.update_layout(
        template="plotly_white",
        height=height,
        margin={"l": 76, "r": 20, "t": 24, "b": 44},
        font={"family": "system-ui, 'Segoe UI', sans-serif", "size": 12},
        legend={"orientation": "h", "y": 1.04, "yanchor": "bottom"},
    )
    return figure
