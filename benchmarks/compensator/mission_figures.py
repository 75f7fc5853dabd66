"""The paper's figures 9 to 11: four missions, measured, simulated and corrected."""

from collections.abc import Mapping, Sequence

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from learning.data.channels import CHANNELS, GROUPS
from learning.evaluation.metrics import rmse

from .missions import MISSIONS, Flown
from .palette import COLOURS, SHOWN, printed_units, unit_of
from .style import styled, thin

Array = NDArray[np.float64]
POINTS = 700
"""Of a line in one of many small panels."""
DRAWN_CHANNEL = "acc_x"
"""Whose residual figure 11 shows in time."""

Missions = Mapping[str, Flown]
"""By their names."""


def timelines(missions: Missions, system: str) -> go.Figure:
    """Figure 9: what sensors, twin and corrected twin read; a row per channel, a column each.

    Args:
        missions: All four.
        system: Whose correction is drawn.
    """
    figure = make_subplots(
        rows=len(SHOWN),
        cols=len(MISSIONS),
        column_titles=[_titled(missions[m]) for m in MISSIONS],
        horizontal_spacing=0.05,
        vertical_spacing=0.035,
    )
    size = printed_units()
    for column, mission in enumerate(MISSIONS, start=1):
        flown = missions[mission]
        measured = flown.virtual + flown.residual
        lines = {
            "simulated": (flown.virtual, COLOURS[0], 1.2),
            "measured": (measured, "#000000", 1.6),
            "corrected": (flown.virtual + flown.by_system[system], COLOURS[1], 1.0),
        }
        for row, channel in enumerate(SHOWN, start=1):
            c = CHANNELS.index(channel)
            for name, (values, colour, width) in lines.items():
                figure.add_scatter(
                    **_line(flown.t_s, values[:, c] / size[c], name, colour),
                    line_width=width,
                    showlegend=row == column == 1,
                    row=row,
                    col=column,
                )
            if column == 1:
                figure.update_yaxes(title_text=f"{channel}, {unit_of(c)}", row=row, col=1)
        figure.update_xaxes(title_text="s", row=len(SHOWN), col=column)
    return styled(figure, 190 * len(SHOWN))


def improvements(by_system: Mapping[str, tuple[Missions, str]]) -> go.Figure:
    """Figure 10: what is removed of each sensor's rms, and how far mean and spread are off.

    Args:
        by_system: Missions, and whose correction of them is meant, by what is written.
    """
    titles = ("removed of the rms, %", "error of the mean", "error of the standard deviation")
    figure = make_subplots(
        rows=len(titles),
        cols=len(MISSIONS),
        column_titles=[_titled(next(iter(by_system.values()))[0][m]) for m in MISSIONS],
        shared_xaxes=True,
        horizontal_spacing=0.05,
        vertical_spacing=0.05,
    )
    for k, (name, (missions, system)) in enumerate(by_system.items()):
        for column, mission in enumerate(MISSIONS, start=1):
            flown = missions[mission]
            left, whole = flown.left()[system], flown.residual / flown.unit
            bars = {"corrected": (left, COLOURS[k], name)}
            if k == 0:
                bars = {"simulated": (whole, COLOURS[7], "simulated"), **bars}
            for what, (error, colour, label) in bars.items():
                values = (
                    None if what == "simulated" else removed(whole, error),
                    by_sensor(np.abs(error.mean(axis=0))),
                    by_sensor(_spread_error(flown, error)),
                )
                for row, heights in enumerate(values, start=1):
                    if heights is not None:
                        figure.add_bar(
                            x=list(GROUPS),
                            y=thin(heights),
                            name=label,
                            legendgroup=label,
                            showlegend=column == 1 and row == 2,
                            marker_color=colour,
                            row=row,
                            col=column,
                        )
    for row, title in enumerate(titles, start=1):
        figure.update_yaxes(title_text=title, row=row, col=1)
        figure.update_yaxes(type="linear" if row == 1 else "log", row=row)
    return styled(figure, 720)


def best_systems(missions: Missions, names: Sequence[str]) -> go.Figure:
    """Figure 11: what the best systems leave of each mission, and how they follow one channel.

    Args:
        missions: All four.
        names: Of the systems.
    """
    figure = make_subplots(
        rows=2,
        cols=len(MISSIONS),
        column_titles=[_titled(missions[m]) for m in MISSIONS],
        horizontal_spacing=0.05,
        vertical_spacing=0.1,
    )
    c, size = CHANNELS.index(DRAWN_CHANNEL), printed_units()
    for column, mission in enumerate(MISSIONS, start=1):
        flown = missions[mission]
        left = flown.left()
        figure.add_bar(
            x=list(names),
            y=thin([rmse(left[n].ravel()) for n in names]),
            marker_color=list(COLOURS[: len(names)]),
            showlegend=False,
            row=1,
            col=column,
        )
        lines = {"residual": flown.residual, **{n: flown.by_system[n] for n in names}}
        for k, (name, values) in enumerate(lines.items()):
            colour = "#000000" if k == 0 else COLOURS[k - 1]
            figure.add_scatter(
                **_line(flown.t_s, values[:, c] / size[c], name, colour),
                line_width=1.2,
                showlegend=column == 1,
                row=2,
                col=column,
            )
        figure.update_xaxes(title_text="s", row=2, col=column)
    figure.update_yaxes(type="log", row=1)
    figure.update_yaxes(title_text="rms left, standardised", row=1, col=1)
    figure.update_yaxes(title_text=f"{DRAWN_CHANNEL}, {unit_of(c)}", row=2, col=1)
    return styled(figure, 620)


def removed(whole: Array, left: Array) -> Array:
    """Of the rms of each sensor, percent, shape (sensors,).

    Args:
        whole: Residual, standardised, shape (n, 15).
        left: What is left of it.
    """
    before, after = (np.sqrt(by_sensor((e**2).mean(axis=0))) for e in (whole, left))
    return np.asarray(100 * (1 - after / before))


def by_sensor(values: Array) -> Array:
    """Mean over the channels of each sensor, shape (sensors,), of values by channel."""
    return np.array([values[columns].mean() for columns in GROUPS.values()])


def _spread_error(flown: Flown, error: Array) -> Array:
    """How far the standard deviation is from the measured one, standardised, shape (15,)."""
    measured = (flown.virtual + flown.residual) / flown.unit
    return np.asarray(np.abs(measured.std(axis=0) - (measured - error).std(axis=0)))


def _titled(flown: Flown) -> str:
    return f"{flown.name} ({flown.aircraft})"


def _line(t_s: Array, values: Array, name: str, colour: str) -> dict[str, object]:
    every = max(1, -(-len(t_s) // POINTS))
    return {
        "x": thin(t_s, every),
        "y": thin(values, every),
        "name": name,
        "legendgroup": name,
        "mode": "lines",
        "line_color": colour,
    }
