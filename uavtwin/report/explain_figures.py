"""Figures of the explain page: what convinces, and the held-out flights before and after."""

from collections.abc import Sequence
from html import escape

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from twin.explain.attribution import Attribution
from twin.residuals.channels import ChannelData

from .figures import pretty_unit

Array = NDArray[np.float64]
Flights = Sequence[Sequence[ChannelData]]
MAX_POINTS = 4000
"""Samples of one trace above which the plot is thinned."""
MOST_CHANNELS = 3
_BLACK, _BLUE, _ORANGE, _GREY = "#000000", "#1f5fd0", "#e07b1a", "#8a8f98"
_BEFORE, _AFTER = "model as it stood", "model with the effect"


def evidence_figure(acts: Attribution, with_all: Flights) -> go.Figure:
    """Residual without and with an effect against what the effect predicts, on held-out flights.

    Args:
        acts: Where the effect acts.
        with_all: Channels of each flight with every added effect.
    """
    names = acts.channels[:MOST_CHANNELS]
    figure = make_subplots(rows=1, cols=len(names), horizontal_spacing=0.09)
    for column, name in enumerate(names, start=1):
        without, complete = (_pooled(flights, name) for flights in (acts.without, with_all))
        predicted = without - complete
        unit = escape(pretty_unit(_of(with_all, name)[0].unit))
        for residual, label, colour in ((without, _BEFORE, _BLUE), (complete, _AFTER, _ORANGE)):
            figure.add_trace(
                go.Scattergl(
                    x=_thin(predicted),
                    y=_thin(residual),
                    name=label,
                    mode="markers",
                    marker={"size": 4, "color": colour, "opacity": 0.45},
                    legendgroup=label,
                    showlegend=column == 1,
                    hovertemplate="%{y:.3g} where it predicts %{x:.3g}<extra></extra>",
                ),
                row=1,
                col=column,
            )
        ends = np.array([predicted.min(), predicted.max()])
        figure.add_trace(
            go.Scatter(
                x=ends,
                y=ends,
                mode="lines",
                name="what the effect predicts",
                line={"color": _BLACK, "width": 1},
                showlegend=column == 1,
            ),
            row=1,
            col=column,
        )
        title = f"{escape(name)} by {escape(acts.effect.replace('_', ' '))}, {unit}"
        figure.update_xaxes(title_text=title, row=1, col=column)
        figure.update_yaxes(title_text=f"residual, {unit}", row=1, col=column)
    return _styled(figure, 380)


def before_after_figure(
    name: str, before: Sequence[ChannelData], after: Sequence[ChannelData], flights: Sequence[str]
) -> go.Figure:
    """Measured, both models and both residuals over time, one pair of rows per held-out flight.

    Args:
        name: Of the channel.
        before: The channel of each flight with the model as it stood.
        after: The same with the effects added.
        flights: Their names.
    """
    rows = 2 * len(before)
    figure = make_subplots(rows=rows, cols=1, vertical_spacing=min(0.07, 0.5 / rows))
    for i, (old, new, flight) in enumerate(zip(before, after, flights, strict=True)):
        t = _broken(old, old.t_s)
        first = i == 0
        top = (
            (old.measured, "measured", _BLACK, "solid"),
            (old.measured - old.residual, _BEFORE, _BLUE, "dash"),
            (new.measured - new.residual, _AFTER, _ORANGE, "solid"),
        )
        bottom = (
            (old.residual, f"residual, {_BEFORE}", _GREY, "solid"),
            (new.residual, f"residual, {_AFTER}", _ORANGE, "solid"),
        )
        for row, traces in ((2 * i + 1, top), (2 * i + 2, bottom)):
            for values, label, colour, dash in traces:
                figure.add_trace(
                    go.Scatter(
                        x=_thin(t),
                        y=_thin(_broken(old, values)),
                        name=label,
                        mode="lines",
                        line={"color": colour, "width": 1.3, "dash": dash},
                        legendgroup=label,
                        showlegend=first,
                        hovertemplate="%{y:.4g} at %{x:.2f} s<extra>" + label + "</extra>",
                    ),
                    row=row,
                    col=1,
                )
        unit, label = escape(pretty_unit(old.unit)), escape(f"{name}, {flight}")
        figure.update_yaxes(title_text=f"{label}, {unit}", row=2 * i + 1, col=1)
        figure.update_yaxes(title_text=f"residual, {unit}", row=2 * i + 2, col=1)
        figure.update_xaxes(matches=f"x{2 * i + 1}" if i else "x", row=2 * i + 2, col=1)
    figure.update_xaxes(title_text="time, s", row=rows, col=1)
    return _styled(figure, 80 + 165 * rows)


def _of(flights: Flights, name: str) -> list[ChannelData]:
    return [c for flight in flights for c in flight if c.name == name]


def _pooled(flights: Flights, name: str) -> Array:
    return np.concatenate([c.residual for c in _of(flights, name)])


def _broken(channel: ChannelData, values: Array) -> Array:
    """Values with a NaN before every new piece of flight, so that no line bridges a gap."""
    starts = np.flatnonzero(np.diff(channel.piece)) + 1
    return np.insert(values, starts, np.nan)


def _thin(values: Array) -> NDArray[np.float32]:
    return values[:: max(1, -(-len(values) // MAX_POINTS))].astype(np.float32)


def _styled(figure: go.Figure, height: int) -> go.Figure:
    figure.update_layout(
        template="plotly_white",
        height=height,
        margin={"l": 76, "r": 18, "t": 34, "b": 46},
        font={"size": 12},
        legend={
            "orientation": "h",
            "y": 1.0,
            "yanchor": "bottom",
            "x": 0,
            "itemsizing": "constant",
        },
    )
    return figure
