"""The paper's figures 5 to 12, of trainings that are done, and the page of all of them.

Each figure can be saved as PNG or SVG by its buttons. Error of a channel: measured residual minus
what a system said of it, over the spread of the training residual. Flight 3, which no training saw.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from learning.data.channels import CHANNELS, GROUPS, PHASE_CODES, UNITS
from learning.data.flights import ResidualFlight
from learning.evaluation import rms
from uavtwin.report.page import plot, render

from .missions import MISSIONS, CorrectedMission
from .trainings import GAUSS_T, MODALITIES, rows_of, units

Array = NDArray[np.float64]
BINS = 80
ALL_BUT = 0.002
"""Share of the samples that lies beyond the ends of a histogram's axis."""
BEST = 4
"""Systems whose reconstruction is drawn."""


@dataclass(frozen=True, slots=True)
class FlightCorrections:
    """What systems said of a flight.

    Attributes:
        flight: That was held out.
        unit: Of each channel, the spread of the training residual, shape (15,).
        by_system: Correction of each, shape (n, 15).
    """

    flight: ResidualFlight
    unit: Array
    by_system: Mapping[str, Array]

    @classmethod
    def of(
        cls, flights: Sequence[ResidualFlight], by_system: Mapping[str, Array]
    ) -> "FlightCorrections":
        """Of the last flight, which the others taught."""
        *trained, held = flights
        return cls(held, units(MODALITIES[0], trained, flights)["standardised"], by_system)

    def errors(self) -> dict[str, Array]:
        """Of each system, the best first, standardised, shape (n, 15)."""
        left = {n: (self.flight.residual - c) / self.unit for n, c in self.by_system.items()}
        return dict(sorted(left.items(), key=lambda named: rms(named[1].ravel())))

    def best(self) -> list[str]:
        """Names of the best systems."""
        return list(self.errors())[:BEST]


Figures = Mapping[str, tuple[str, go.Figure]]
"""By their names, each with its title."""


def figures_page(figures: Figures) -> str:
    """One page that needs nothing else."""
    drawn = [(title, plot(name, title, figure)) for name, (title, figure) in figures.items()]
    return render("paper_figures.html.j2", {}, Path(__file__).parent, figures=drawn)


def comparison(flights: Sequence[ResidualFlight], by_system: Mapping[str, Array]) -> Figures:
    """Figures 5 to 8.

    Args:
        flights: Of the paper's tables; the last was held out.
        by_system: What each system said of it, shape (n, 15).
    """
    said = FlightCorrections.of(flights, by_system)
    best = f"Figure 6: reconstruction of flight 3, {BEST} best systems"
    return {
        "readings": ("Figure 5: distributions of what sensors and twin read", readings(flights)),
        "residuals": ("Figure 5: distributions of the residual", residuals(flights)),
        "reconstructions": (best, reconstructions(said)),
        "errors": ("Figure 7: distribution of the error", error_distributions(said)),
        "moments": ("Figure 8: mean and variance of the error", error_moments(said)),
    }


def readings(flights: Sequence[ResidualFlight]) -> go.Figure:
    """Density of what sensors and twin read in all flights."""
    virtual = np.concatenate([f.virtual for f in flights])
    measured = virtual + np.concatenate([f.residual for f in flights])
    return _densities({"measured": measured, "simulated": virtual})


def residuals(flights: Sequence[ResidualFlight]) -> go.Figure:
    """Density of the residual in all flights, by phase."""
    whole = np.concatenate([f.residual for f in flights])
    phase = np.concatenate([f.phase for f in flights])
    return _densities({name: whole[phase == PHASE_CODES[name]] for name in MODALITIES})


def reconstructions(said: FlightCorrections) -> go.Figure:
    """Residual and what the best systems say of it, a panel per sensor."""
    figure = make_subplots(rows=len(SHOWN), cols=1, shared_xaxes=True, vertical_spacing=0.03)
    best = said.best()
    every = max(1, -(-len(said.flight.t_s) // MAX_POINTS))
    size = printed_units()
    for row, name in enumerate(SHOWN, start=1):
        c = CHANNELS.index(name)
        lines = {"residual": said.flight.residual, **{n: said.by_system[n] for n in best}}
        for k, (line, values) in enumerate(lines.items()):
            figure.add_scatter(
                x=thin(said.flight.t_s, every),
                y=thin(values[:, c] / size[c], every),
                name=line,
                legendgroup=line,
                showlegend=row == 1,
                mode="lines",
                line={"color": "#000000" if k == 0 else COLOURS[k - 1], "width": 1.2},
                row=row,
                col=1,
            )
        figure.update_yaxes(title_text=f"{name}, {unit_of(c)}", row=row, col=1)
    figure.update_xaxes(title_text="takeoff, then hover; time, s", row=len(SHOWN), col=1)
    return styled(figure, 170 * len(SHOWN))


def error_distributions(said: FlightCorrections) -> go.Figure:
    """Density of the error of each system, all channels together."""
    figure, errors = go.Figure(), said.errors()
    edge = max(float(np.quantile(np.abs(e), 1 - ALL_BUT)) for e in errors.values())
    for (name, error), colour in zip(errors.items(), colours(len(errors)), strict=True):
        density, edges = np.histogram(error, BINS, (-edge, edge), density=True)
        figure.add_scatter(
            x=thin((edges[1:] + edges[:-1]) / 2),
            y=thin(np.where(density > 0, density, np.nan)),
            name=name,
            mode="lines",
            line={"color": colour, "width": 1.5, "shape": "hvh"},
        )
    figure.update_xaxes(title_text="error, standardised")
    figure.update_yaxes(title_text="density", type="log")
    return styled(figure, 480)


def error_moments(said: FlightCorrections) -> go.Figure:
    """Size of the mean error and its variance, mean over the channels, by phase."""
    errors = said.errors()
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.06)
    for phase, colour in zip(MODALITIES, COLOURS, strict=False):
        here = rows_of(said.flight, phase)
        moments = (
            [np.abs(e[here].mean(axis=0)).mean() for e in errors.values()],
            [e[here].var(axis=0).mean() for e in errors.values()],
        )
        for row, values in enumerate(moments, start=1):
            figure.add_bar(
                x=list(errors),
                y=thin(values),
                name=phase,
                marker_color=colour,
                showlegend=row == 1,
                row=row,
                col=1,
            )
    for row, title in enumerate(("size of the mean", "variance"), start=1):
        figure.update_yaxes(title_text=title, type="log", row=row, col=1)
    return styled(figure, 560)


def by_share(found: Sequence[Mapping[str, Any]]) -> go.Figure:
    """Mean square error of each variant over the share of the data that taught it, by phase.

    Args:
        found: Rows as of `comparison.rows_of`, each at several shares.
    """
    names = list(dict.fromkeys(f["row"] for f in found))
    figure = make_subplots(rows=1, cols=2, subplot_titles=MODALITIES, shared_yaxes=True)
    for name, colour in zip(names, colours(len(names)), strict=True):
        own = sorted((f for f in found if f["row"] == name), key=lambda f: f["share"])
        for column, phase in enumerate(MODALITIES, start=1):
            figure.add_scatter(
                x=thin([100 * f["share"] for f in own]),
                y=thin([f["scores"][phase]["standardised"]["mse"][0] for f in own]),
                name=name,
                legendgroup=name,
                showlegend=column == 1,
                mode="lines+markers",
                line={"color": colour, "width": 1.5},
                row=1,
                col=column,
            )
    figure.update_xaxes(title_text="of the data, %")
    figure.update_yaxes(title_text="mean square error, standardised", type="log", row=1, col=1)
    figure.update_yaxes(type="log", row=1, col=2)
    return styled(figure, 520)


def _densities(lines: Mapping[str, Array]) -> go.Figure:
    """A panel per channel, a line per name."""
    axes, size = 3, printed_units()
    figure = make_subplots(rows=len(GROUPS), cols=axes, vertical_spacing=0.07)
    for c, channel in enumerate(CHANNELS):
        row, column = c // axes + 1, c % axes + 1
        every = np.concatenate([values[:, c] for values in lines.values()]) / size[c]
        low, high = np.quantile(every, [ALL_BUT / 2, 1 - ALL_BUT / 2])
        for (name, values), colour in zip(lines.items(), COLOURS, strict=False):
            ends = (low, high) if high > low else (low - 1, low + 1)
            density, edges = np.histogram(values[:, c] / size[c], BINS, ends, density=True)
            figure.add_scatter(
                x=thin((edges[1:] + edges[:-1]) / 2),
                y=thin(density),
                name=name,
                legendgroup=name,
                showlegend=c == 0,
                mode="lines",
                line={"color": colour, "width": 1.2, "shape": "hvh"},
                row=row,
                col=column,
            )
        figure.update_xaxes(title_text=f"{channel}, {unit_of(c)}", row=row, col=column)
    return styled(figure, 190 * len(GROUPS))


# ----------------------------------------------------------------------------------------
# The paper's figures 9 to 11: four missions, measured, simulated and corrected.

POINTS = 700
"""Of a line in one of many small panels."""
DRAWN_CHANNEL = "acc_x"
"""Whose residual figure 11 shows in time."""

Missions = Mapping[str, CorrectedMission]
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
                    sensor_means(np.abs(error.mean(axis=0))),
                    sensor_means(_spread_error(flown, error)),
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
            y=thin([rms(left[n].ravel()) for n in names]),
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
    before, after = (np.sqrt(sensor_means((e**2).mean(axis=0))) for e in (whole, left))
    return np.asarray(100 * (1 - after / before))


def sensor_means(values: Array) -> Array:
    """Mean over the channels of each sensor, shape (sensors,), of values by channel."""
    return np.array([values[columns].mean() for columns in GROUPS.values()])


def _spread_error(flown: CorrectedMission, error: Array) -> Array:
    """How far the standard deviation is from the measured one, standardised, shape (15,)."""
    measured = (flown.virtual + flown.residual) / flown.unit
    return np.asarray(np.abs(measured.std(axis=0) - (measured - error).std(axis=0)))


def _titled(flown: CorrectedMission) -> str:
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


# ----------------------------------------------------------------------------------------
# What the figures of the paper share: colours, channels that stand for their sensors, units.

COLOURS = (
    *("#1f5fd0", "#e07b1a", "#2f8f5b", "#8a4fbf", "#c23b66", "#5fb8c9", "#b58900", "#8a8f98"),
    *("#7a5230", "#d98cb3", "#3f3f3f", "#9bbf3b", "#4b6f9e", "#e3b23c", "#6b8e7f", "#b04a2f"),
)
SHOWN = ("gyro_x", "acc_x", "mag_x", "pos_x", "vel_x")
"""Channels that are drawn over time, one of each sensor."""


def colours(count: int) -> list[str]:
    """So many, over again where there are not enough."""
    return [COLOURS[i % len(COLOURS)] for i in range(count)]


def printed_units() -> NDArray[np.float64]:
    """SI units in one of those that are printed, shape (15,)."""
    return np.array([GAUSS_T if unit == "T" else 1.0 for unit in UNITS])


def unit_of(channel: int) -> str:
    """As printed."""
    return "gauss" if UNITS[channel] == "T" else UNITS[channel]


# ----------------------------------------------------------------------------------------
# How the figures of the paper look.

MAX_POINTS = 4000
"""Samples of one trace above which the plot, never the numbers, is thinned."""


def thin(values: NDArray[np.float64] | Sequence[float], every: int = 1) -> list[float]:
    """Every `every`-th value, with six digits: what a page holds of it."""
    return [float(f"{v:.6g}") for v in np.asarray(values, dtype=np.float64)[::every]]


def styled(figure: go.Figure, height: int) -> go.Figure:
    """The figure with the margins of all pages, height in pixels."""
    figure.update_layout(height=height, margin={"l": 76, "r": 20, "t": 24, "b": 44})
    return figure
