"""Figures of the compensator's pages."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twin.formatting import pretty_unit

from .drawing import Budget, Panels, thinned
from .page import BLACK, BLUE, GREY, ORANGE, Figure

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]
_LINES = {  # colour, dash, width: the same in every report
    "measured": (BLACK, "solid", 1.2),
    "twin": (BLUE, "dash", 1.5),
    "explained twin": ("#2f8f5b", "dash", 1.5),
    "corrected twin": (ORANGE, "solid", 1.5),
}
_MODELS = (
    *(GREY, "#c3c7cd", "#b58900", BLUE, "#2f8f5b"),
    *("#8a4fbf", "#c23b66", "#5fb8c9", ORANGE),
)
"""Colours of compared twins, trivial ones first and the corrected one last."""
_LOSSES = {
    "reconstruction": BLUE,
    "quantiser": "#8a4fbf",
    "distribution": "#b58900",
    "validation": BLACK,
}  # colour of each curve


def curve_figure(curve: Sequence[Mapping[str, Any]], best_epoch: int) -> Figure:
    """Parts of the loss and the validation error over the epochs.

    Args:
        curve: One entry per epoch.
        best_epoch: Epoch whose weights are stored.
    """
    names = list(dict.fromkeys(n for e in curve for n in e if n not in ("epoch", "learning_rate")))
    positive = all(e[n] > 0 for e in curve for n in names if e.get(n))
    scale = "log" if positive else "linear"  # scores of a critic may have either sign
    panels = Panels((314,))
    axes = panels.add("loss, standardised units", {"title": {"text": "epoch"}}, {"type": scale})
    for name in names:
        points = [(e["epoch"], e[name]) for e in curve if e.get(name)]
        if not points:
            continue
        x, y = np.array(points, dtype=np.float64).T
        mode = "lines+markers" if name == "validation" or len(x) < 3 else "lines"
        colour = _LOSSES.get(name, GREY)
        panels.line(axes, x, y, name, {"color": colour, "width": 1.5}, mode=mode)
    marker = {"type": "line", "xref": "x", "yref": "paper", "x0": best_epoch, "x1": best_epoch}
    line = {"color": GREY, "dash": "dot", "width": 1.2}
    panels.layout["shapes"].append({**marker, "y0": 0, "y1": 1, "line": line})
    label = {"x": best_epoch, "xref": "x", "y": 1, "yref": "paper", "yanchor": "bottom"}
    panels.layout["annotations"].append({**label, "text": "stored", "showarrow": False})
    return panels.figure


def correction_figure(
    name: str,
    unit: str,
    t_s: Array,
    lines: Mapping[str, Array],
    spread: Array,
    time: str,
    budget: Budget,
) -> Figure:
    """Measured, twin, explained twin and corrected twin over time, with the residual below.

    Args:
        name: Name of the channel.
        unit: Unit of the channel.
        t_s: Times of the samples, shape (n,).
        lines: Curves by name in `_LINES`, shape (n,) each; "measured" and "corrected twin" among
            them.
        spread: Predicted standard deviation of the remaining residual, shape (n,).
        time: Group of figures with common time axes.
        budget: Budget of the page.
    """
    shown = pretty_unit(unit)
    panels = Panels((214, 126), time)
    axes = panels.add(f"{name}, {shown}")
    for line, values in lines.items():
        colour, dash, width = _LINES[line]
        style = {"color": colour, "dash": dash, "width": width}
        panels.series(axes, t_s, values, line, style, budget.columns)
    axes = panels.add(f"left, {shown}")
    t, edge = thinned(t_s, 2 * spread, budget.columns // 2)
    panels.line(
        axes,
        np.concatenate([t, t[::-1]]),
        np.concatenate([edge, -edge[::-1]]),
        "two predicted spreads",
        {"width": 0},
        fill="toself",
        fillcolor=GREY,
        opacity=0.3,
        hoverinfo="skip",
    )
    for line in ("twin", "corrected twin"):
        style = {"color": _LINES[line][0], "width": 1}
        left = lines["measured"] - lines[line]
        panels.series(axes, t_s, left, f"measured - {line}", style, budget.columns)
    panels.look(float(t_s[0]), float(t_s[-1]), ())
    return panels.figure


def anomaly_figure(t_s: Array, anomaly: Array, time: str, budget: Budget) -> Figure:
    """Anomaly score over time, with the level above which it is an alarm.

    Args:
        t_s: Times of the samples, shape (n,).
        anomaly: Anomaly score, shape (n,).
        time: Group of figures with common time axes.
        budget: Budget of the page.
    """
    panels = Panels((194,), time)
    axes = panels.add("anomaly score", None, {"rangemode": "tozero"})
    t, score = thinned(t_s, anomaly, budget.columns)
    panels.line(axes, t, score, "anomaly score", {"color": "#c23b66", "width": 1.2})
    ends = np.array([t_s[0], t_s[-1]], dtype=np.float64)
    panels.line(axes, ends, np.ones(2), "alarm", {"color": GREY, "width": 1.2, "dash": "dot"})
    panels.look(float(t_s[0]), float(t_s[-1]), ())
    return panels.figure


def horizons_figure(rows: "pd.DataFrame", quantities: Sequence[tuple[str, str]]) -> Figure:
    """Errors of twins over the time since their last given state, a panel per quantity.

    Args:
        rows: Table with `model`, `horizon_s` and a column per quantity.
        quantities: Quantities with names and units.
    """
    panels = Panels((190,) * len(quantities))
    for i, (quantity, unit) in enumerate(quantities):
        along: dict[str, Any] = {"type": "log"}
        if i == len(quantities) - 1:
            along["title"] = {"text": "left alone for, s"}
        title = f"{quantity}, {pretty_unit(unit)}"
        axes = panels.add(title, along, {"type": "log", "exponentformat": "power"})
        for k, (model, part) in enumerate(rows.groupby("model", sort=False)):
            panels.line(
                axes,
                part["horizon_s"].to_numpy(dtype=np.float64),
                part[quantity].to_numpy(dtype=np.float64),
                str(model),
                {"color": _MODELS[k % len(_MODELS)], "width": 1.5},
                mode="lines+markers",
                marker={"size": 5},
            )
    return panels.figure
