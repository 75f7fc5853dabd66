"""Drawing of figures: panels below each other, series decimated, a size budget per page.

Panels are written in the form of plotly.js: plotly's own objects would take ten times as long as
the rest of a report. A series has no more points than a screen can show, two bytes each; the budget
sets their number, so that a page does not exceed `PAGE_BYTES`.
"""

import json
import re
from base64 import b64decode, b64encode
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.logs.samples import runs
from twin.residuals.gap import slow_part

from .page import GREY, Figure, Plot

PAGE_BYTES = 1_500_000
"""Largest size of a page."""
FINEST, COARSEST = 700, 60
"""Largest and smallest number of pixel columns for a series across the whole page."""
MOST_PARTS = 6
"""Largest number of flights with figures on a page: with more, all would be drawn too coarsely."""


@dataclass(frozen=True, slots=True)
class Budget:
    """Resolution of all figures of a page.

    Attributes:
        columns: Number of pixel columns for a series across the whole page.
        parts: Number of the page's parts, such as flights, that are drawn.
    """

    columns: int = FINEST
    parts: int = 1

    @property
    def spectrum(self) -> int:
        """Number of pixel columns of a spectrum, a third of the page wide."""
        return max(45, min(90, self.columns // 2))

    @property
    def track(self) -> int:
        """Number of points of a track."""
        return max(120, min(500, self.columns))

    @property
    def cells(self) -> int:
        """Number of columns of a spectrogram."""
        return max(COARSEST, min(180, self.columns))


def fitted(draw: Callable[[Budget], str], parts: int = 1) -> str:
    """A page with the finest resolution within `PAGE_BYTES`.

    It is drawn with the finest resolution; if too large, with the coarsest, then with fewer parts,
    and last in between. A page with a single part that is too large even at the coarsest resolution
    is returned as it is.

    Args:
        draw: Draws the text of the page.
        parts: Number of parts; at most `MOST_PARTS` are drawn.
    """
    parts = min(parts, MOST_PARTS)
    finest = draw(Budget(FINEST, parts))
    if _bytes(finest) <= PAGE_BYTES:
        return finest
    coarsest = draw(Budget(COARSEST, parts))
    if _bytes(coarsest) > PAGE_BYTES:
        while _bytes(coarsest) > PAGE_BYTES and parts > 1:
            parts -= 1
            coarsest = draw(Budget(COARSEST, parts))
        return coarsest
    share = (PAGE_BYTES - _bytes(coarsest)) / (_bytes(finest) - _bytes(coarsest))
    # size grows about with the logarithm of the columns: more and more series are complete
    between = draw(Budget(int(COARSEST * (FINEST / COARSEST) ** share), parts))
    return between if _bytes(between) <= PAGE_BYTES else coarsest


def _bytes(page: str) -> int:
    return len(page.encode("utf-8"))


Array = NDArray[np.float64]

TREND_HZ = 2.0
"""Cut-off of the curve over a band where samples are faster than `DENSE_HZ`: below any rotor
frequency of the vehicles here, above the bandwidth of their tilt."""
DENSE_HZ = 20.0
"""Rate from which spectra are drawn and noise is a band."""
STEPS, COARSE_STEPS = 65_533, 500
"""Number of steps of two bytes, and least number of steps across the middle half of the values."""
_LARGEST = 3.4e38
"""Largest number of 32 bits."""
GAP_STEPS, GAP_S = 6, 0.2
"""Length of a gap, in typical steps and in s, from which a line is interrupted."""


def thinned(x: Array, y: Array, columns: int) -> tuple[Array, Array]:
    """The smallest and the largest value in each pixel column, at their positions.

    They give the same picture as all samples. The first of the unknown values of a column is
    included, so that gaps are preserved.

    Args:
        x: Positions, ascending, shape (n,).
        y: Values, NaN where unknown, shape (n,).
        columns: Number of pixel columns.
    """
    if len(x) <= 2 * columns:
        return x, y
    column = _column(x, columns)
    order = np.lexsort((y, column))  # unknown ones last within their column
    edges = np.flatnonzero(np.diff(column[order], prepend=-1, append=columns))
    unknown = np.isnan(y)
    known_in = np.bincount(column[~unknown], minlength=columns)[column[order[edges[:-1]]]]
    least, past = edges[:-1], edges[:-1] + known_in
    chosen = [order[least], order[np.maximum(past - 1, least)]]
    chosen.append(order[past[past < edges[1:]]])
    keep = np.unique(np.concatenate([[0, len(x) - 1], *chosen]))
    return x[keep], y[keep]


def _column(x: Array, columns: int) -> NDArray[np.intp]:
    """Pixel column of each value, ascending."""
    share = (x - x[0]) / max(float(x[-1] - x[0]), 1e-300)
    column: NDArray[np.intp] = np.minimum((share * columns).astype(np.intp), columns - 1)
    return column


@dataclass(frozen=True, slots=True)
class Drawn:
    """A series in drawn form.

    Attributes:
        t_s: Times of the curve, s, shape (n,).
        curve: Low-passed values where samples are dense, else the samples; NaN in gaps.
        band: Times and values of the outline of all samples, pieces separated by NaN; None: only
            the curve.
    """

    t_s: Array
    curve: Array
    band: tuple[Array, Array] | None = None


def drawn(t_s: Array, values: Array, columns: int, below_hz: float = TREND_HZ) -> Drawn:
    """A series as a low-passed curve over the band of its samples, or unchanged with few samples.

    Args:
        t_s: Times, s, ascending, shape (n,).
        values: Values, NaN where unknown, shape (n,).
        columns: Number of pixel columns.
        below_hz: Cut-off of the curve.
    """
    pieces = [(t_s[a:b], values[a:b]) for a, b in _pieces(t_s, values)]
    if not pieces:
        return Drawn(np.empty(0), np.empty(0))
    steps = np.concatenate([np.diff(t) for t, _ in pieces])
    dense = len(steps) > 2 * DENSE_HZ and float(np.median(steps)) < 1 / DENSE_HZ
    span = max(float(t_s[-1] - t_s[0]), 1e-300)
    curves, outlines = [], []
    for t, v in pieces:
        share = max(8, round(columns * float(t[-1] - t[0]) / span))
        slow = slow_part(t, v, below_hz) if dense else v
        curves.append(thinned(t, slow, share))
        if dense:
            outlines.append(_outline(t, v, share))
    t, curve = _chained(curves)
    return Drawn(t, curve, _chained(outlines) if dense else None)


def _pieces(t_s: Array, values: Array) -> list[tuple[int, int]]:
    """First row and end of each stretch without a gap."""
    if not len(t_s):
        return []
    steps = np.diff(t_s)
    usual = float(np.median(steps)) if len(steps) else 0.0
    known = np.isfinite(values)
    torn = (steps > max(GAP_STEPS * usual, GAP_S)) | (known[1:] != known[:-1])
    edges = [0, *(np.flatnonzero(torn) + 1).tolist(), len(t_s)]
    return [(a, b) for a, b in pairwise(edges) if known[a]]


def _outline(t_s: Array, values: Array, columns: int) -> tuple[Array, Array]:
    """Outline of all samples as a closed line: largest values forward, smallest values back."""
    column = _column(t_s, min(columns, max(1, len(t_s) // 4)))
    starts = np.flatnonzero(np.diff(column, prepend=-1))
    low, high = (f.reduceat(values, starts) for f in (np.minimum, np.maximum))
    t = np.append(t_s[starts[:-1]], t_s[-1]) if len(starts) > 1 else t_s[[0]]
    return np.concatenate([t, t[::-1]]), np.concatenate([high, low[::-1]])


def _chained(parts: list[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Consecutive parts, separated by an unknown value."""
    gap = np.array([np.nan])
    x = np.concatenate([p for part in parts for p in (part[0], gap)][:-1])
    y = np.concatenate([p for part in parts for p in (part[1], gap)][:-1])
    return x, y


def packed(values: Array, scale: str = "linear") -> dict[str, str | float]:
    """Numbers in the form of a page, NaN where unknown.

    Two bytes each: a number of 65,533 steps from the smallest to the largest value, 0 where
    unknown. On a logarithmic scale, and where outliers would make these steps too coarse, four
    bytes: single precision.

    Args:
        values: Values, shape (n,).
        scale: Scale of the axis along which they are drawn, as in plotly.js.
    """
    known = values[np.isfinite(values)]
    low, high = (float(f(known)) if len(known) else 0.0 for f in (np.min, np.max))
    low, step = (float(f"{v:.9g}") for v in (low, (high - low) / STEPS))
    spread = float(np.ptp(np.percentile(known, [25, 75]))) if len(known) else 0.0
    coarse = step * COARSE_STEPS > spread > 0.0
    if scale == "log" or coarse or not np.isfinite(step):
        single = np.clip(values, -_LARGEST, _LARGEST)
        return {"dtype": "f4", "bdata": _text(single.astype("<f4"))}
    share = (values - low) / step if step > 0.0 else np.where(np.isfinite(values), 0.0, np.nan)
    codes = np.where(np.isfinite(share), np.clip(np.rint(share), 0, STEPS) + 1.0, 0.0)
    return {"dtype": "u2", "bdata": _text(codes.astype("<u2")), "low": low, "step": step}


def _text(numbers: NDArray[np.generic]) -> str:
    return b64encode(np.ascontiguousarray(numbers).tobytes()).decode("ascii")


def unpacked(values: Mapping[str, Any]) -> Array:
    """Numbers written by `packed`, shape (n,)."""
    raw = b64decode(values["bdata"])
    if values["dtype"] == "f4":
        return np.frombuffer(raw, dtype="<f4").astype(np.float64)
    codes = np.frombuffer(raw, dtype="<u2").astype(np.float64)
    return np.where(codes > 0, values["low"] + (codes - 1.0) * values["step"], np.nan)


Axis = dict[str, Any]
Spans = Sequence[tuple[str, float, float]]
"""Name, start, end in s."""

GAP_PX, TOP_PX, BOTTOM_PX = 17, 22, 44
"""Distance between panels, above the first and below the last, px."""
PHASE_TINT = {
    "ground": "#b9bec7",
    "takeoff": "#f2b84b",
    "hover": "#7bc6a4",
    "forward": "#86b6f0",
    "tour": "#86b6f0",
    "land": "#d9a3d0",
}
"""Background of a phase of flight."""
OTHER_TINT = "#c9cdd4"
BAND_OPACITY = 0.3
"""Opacity of the band of all samples."""


@dataclass(slots=True)
class Panels:
    """A figure built panel by panel, from top to bottom.

    Attributes:
        heights_px: Heights of the panels.
        time: Group of figures with common time axes; "": the horizontal axis is not time.
        figure: Figure in the form of plotly.js.
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
        """Layout of the figure."""
        return dict.__getitem__(self.figure, "layout")

    def add(self, y_title: str, x: Axis | None = None, y: Axis | None = None) -> str:
        """Add a panel; returns the number of its axes as in plotly.js: "" for the first.

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
        """Add a curve.

        Args:
            axes: Number of the panel's axes.
            x: Horizontal values, shape (n,).
            y: Vertical values, shape (n,).
            name: Name in the legend above the figure.
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
        """Add a series over time: a low-passed curve over the band of samples where dense.

        Args:
            axes: Number of the panel's axes.
            t_s: Times, s, shape (n,).
            values: Values, shape (n,).
            name: Name in the legend.
            line: Colour, dash, width.
            columns: Number of available pixel columns.
            band: Whether the band is drawn.
            below_hz: Cut-off of the curve.
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
        """Add a grey band between two values across the panel."""
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
        """Set the displayed time span, with named spans of the flight as coloured background.

        Args:
            low_s: Start, s.
            high_s: End, s.
            spans: Phases of the flight.
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
                "name": f"{share:.4f}",  # omitted where it is wider than its share
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
        """Add an instant: a dotted line through all panels, with its text on hover."""
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


def spans_of(
    t_s: Array, values: NDArray[Any], name_of: Callable[[Any], str] = str
) -> list[tuple[str, float, float]]:
    """Spans of time with a constant value; those without a name are omitted.

    Args:
        t_s: Times, s, shape (n,).
        values: Values, shape (n,).
        name_of: Name of a value, "" for none.
    """
    ends = [(name_of(values[a]), a, min(b, len(t_s) - 1)) for a, b in runs(values)]
    return [(name, float(t_s[a]), float(t_s[b])) for name, a, b in ends if name]


def degenerate(figure: Plot) -> Iterator[str]:
    """Problems of a figure: no curve, a single point, no extent, overlapping panels.

    Args:
        figure: Figure in the form of a page.
    """
    content = json.loads(figure.json)
    data, layout = content["data"], content["layout"]
    if not data:
        yield "no curve"
    for trace in data:
        x, y = (unpacked(trace[k]) for k in "xy")
        known = np.isfinite(x) & np.isfinite(y)
        if known.sum() < 2:
            yield f"{trace.get('name')}: {known.sum()} points"
        elif np.ptp(x[known]) <= 0 and np.ptp(y[known]) <= 0:
            yield f"{trace.get('name')}: one dot"
    domains = sorted(v["domain"] for k, v in layout.items() if k.startswith("yaxis"))
    if any(high > low for (_, high), (low, _) in pairwise(domains)):
        yield "panels overlap"
    titles = [v["title"]["text"] for k, v in layout.items() if k.startswith("yaxis")]
    if not all(titles):
        yield "an axis without a title"
