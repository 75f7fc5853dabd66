"""Panels one below the other, as plotly.js reads them.

Building them with plotly's own objects takes ten times as long as all the rest of a report.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..page import GREY, Figure
from .series import TREND_HZ, Drawn, drawn, packed

Array = NDArray[np.float64]
Axis = dict[str, Any]
Spans = Sequence[tuple[str, float, float]]
"""Name, start, end in s."""

GAP_PX, TOP_PX, BOTTOM_PX = 17, 22, 44
PHASE_TINT = {
    "ground": "#b9bec7",
    "takeoff": "#f2b84b",
    "hover": "#7bc6a4",
    "forward": "#86b6f0",
    "tour": "#86b6f0",
    "land": "#d9a3d0",
}
OTHER_TINT = "#c9cdd4"
BAND_OPACITY = 0.3


@dataclass(slots=True)
class Panels:
    """A figure that grows panel by panel, from top to bottom.

    Attributes:
        heights_px: Of the panels.
        time: Group of figures whose time axes move together; "": the horizontal axis is no time.
        figure: As plotly.js reads it.
    """

    heights_px: Sequence[int]
    time: str = ""
    figure: Figure = field(default_factory=dict)
    _added: int = 0

    def __post_init__(self) -> None:
        self.figure = {
            "data": [],
            "layout": {
                "height": self._plot_px + TOP_PX + BOTTOM_PX,
                "margin": {"t": TOP_PX, "b": BOTTOM_PX},
                "hovermode": "closest",
                "shapes": [],
                "annotations": [],
                **({"meta": {"time": self.time}} if self.time else {}),
            },
        }

    @property
    def _plot_px(self) -> int:
        return sum(self.heights_px) + (len(self.heights_px) - 1) * GAP_PX

    @property
    def layout(self) -> dict[str, Any]:
        """Of the figure."""
        return dict.__getitem__(self.figure, "layout")

    def add(self, y_title: str, x: Axis | None = None, y: Axis | None = None) -> str:
        """The next panel; returns the number of its axes as plotly.js writes it: "" for the first.

        Args:
            y_title: Title of the vertical axis; text is escaped.
            x: Further attributes of the horizontal axis.
            y: Further attributes of the vertical axis.
        """
        k = self._added
        self._added += 1
        number = "" if k == 0 else str(k + 1)
        top = 1 - (sum(self.heights_px[:k]) + k * GAP_PX) / self._plot_px
        low = top - self.heights_px[k] / self._plot_px
        last = k == len(self.heights_px) - 1
        along: Axis = {"anchor": f"y{number}", "domain": [0.0, 1.0]}
        if self.time:
            along |= {"showticklabels": last, **({"matches": "x"} if k else {})}
        if last and self.time:
            along["title"] = {"text": "time, s"}
        self.layout[f"xaxis{number}"] = {"ticks": "outside", **along, **(x or {})}
        self.layout[f"yaxis{number}"] = {
            "anchor": f"x{number}",
            "domain": [max(low, 0.0), min(top, 1.0)],
            "title": {"text": escape(y_title)},
            "nticks": 6,
            **(y or {}),
        }
        return number

    def line(
        self,
        axes: str,
        x: Array,
        y: Array,
        name: str,
        line: Mapping[str, Any],
        **more: Any,
    ) -> None:
        """A curve.

        Args:
            axes: Number of the panel's axes.
            x: Shape (n,).
            y: Shape (n,).
            name: In the key above the figure.
            line: Colour, dash, width.
            more: Further attributes.
        """
        hover = "%{y:.4g} at %{x:.2f} s" if self.time else "%{y:.3g} at %{x:.3g}"
        self.figure["data"].append(
            {
                "type": "scatter",
                "mode": "lines",
                "x": packed(x, self.layout[f"xaxis{axes}"].get("type", "linear")),
                "y": packed(y, self.layout[f"yaxis{axes}"].get("type", "linear")),
                "xaxis": f"x{axes}",
                "yaxis": f"y{axes}",
                "name": name,
                "line": dict(line),
                "hovertemplate": f"{hover}<extra>{escape(name)}</extra>",
                **more,
            }
        )

    def series(
        self,
        axes: str,
        t_s: Array,
        values: Array,
        name: str,
        line: Mapping[str, Any],
        columns: int,
        band: bool = True,
        below_hz: float = TREND_HZ,
    ) -> Drawn:
        """A series over time: its slow part over the band of all samples where they are dense.

        Args:
            axes: Number of the panel's axes.
            t_s: Times, s, shape (n,).
            values: Shape (n,).
            name: In the key.
            line: Colour, dash, width.
            columns: Columns of pixels it may take.
            band: Whether the band is drawn.
            below_hz: Low-pass of the curve.
        """
        shown = drawn(t_s, values, columns, below_hz)
        if shown.band is not None and band:
            self.line(
                axes,
                *shown.band,
                name=f"{name}, all samples",
                line={"width": 0},
                fill="toself",
                fillcolor=line["color"],
                opacity=BAND_OPACITY,
                hoverinfo="skip",
                legendgroup=name,
                showlegend=False,
            )
        few = len(shown.t_s) < 150
        mark = {"mode": "lines+markers", "marker": {"size": 4}} if few else {}
        self.line(axes, shown.t_s, shown.curve, name, line, **mark)
        return shown

    def area(self, axes: str, low: float, high: float) -> None:
        """A grey band between two values over the whole panel."""
        self.layout["shapes"].append(
            {
                "type": "rect",
                "xref": f"x{axes} domain",
                "yref": f"y{axes}",
                **{"x0": 0, "x1": 1, "y0": low, "y1": high},
                "fillcolor": GREY,
                "opacity": 0.16,
                "line": {"width": 0},
                "layer": "below",
            }
        )

    def look(self, low_s: float, high_s: float, spans: Spans) -> None:
        """The span of time that is shown, and spans of the flight as tinted background, names on
        top.

        Args:
            low_s: Start, s.
            high_s: End, s.
            spans: Of the flight.
        """
        if not high_s > low_s:
            return
        for key, axis in self.layout.items():
            if re.fullmatch(r"xaxis\d*", key):
                axis["range"] = [low_s, high_s]
        for name, start, end in spans:
            start, end = max(start, low_s), min(end, high_s)
            if end > start:
                self._span(name, start, end, (end - start) / (high_s - low_s))

    def _span(self, name: str, start: float, end: float, share: float) -> None:
        self.layout["shapes"].append(
            {
                "type": "rect",
                "xref": "x",
                "yref": "paper",
                **{"x0": start, "x1": end, "y0": 0, "y1": 1},
                "fillcolor": PHASE_TINT.get(name, OTHER_TINT),
                "opacity": 0.16,
                "line": {"width": 0},
                "layer": "below",
            }
        )
        self.layout["annotations"].append(
            {
                "name": f"{share:.4f}",  # where it is wider than its share it is not drawn
                "x": (start + end) / 2,
                "xref": "x",
                "y": 1,
                "yref": "paper",
                "yanchor": "bottom",
                "text": escape(name),
                "showarrow": False,
            }
        )

    def mark(self, t_s: float, text: str) -> None:
        """An instant: a dotted line through all panels; its text when pointed at."""
        self.layout["shapes"].append(
            {
                "type": "line",
                "xref": "x",
                "yref": "paper",
                **{"x0": t_s, "x1": t_s, "y0": 0, "y1": 1},
                "line": {"color": "#c23b66", "width": 1, "dash": "dot"},
                "layer": "below",
            }
        )
        self.layout["annotations"].append(
            {
                "x": t_s,
                "xref": "x",
                "y": 0,
                "yref": "paper",
                "yanchor": "bottom",
                "text": "\N{BLACK UP-POINTING TRIANGLE}",
                "hovertext": escape(text),
                "showarrow": False,
            }
        )


def spans_of(t_s: Array, names: NDArray[np.str_]) -> list[tuple[str, float, float]]:
    """Spans of time in which a name stays the same; those without a name are left out.

    Args:
        t_s: Times, s, shape (n,).
        names: Shape (n,), "" where there is none.
    """
    edges = [0, *(np.flatnonzero(names[1:] != names[:-1]) + 1).tolist(), len(t_s)]
    return [
        (str(names[a]), float(t_s[a]), float(t_s[min(b, len(t_s) - 1)]))
        for a, b in pairwise(edges)
        if str(names[a])
    ]
