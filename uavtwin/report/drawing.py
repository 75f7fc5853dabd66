"""How figures of pages are drawn: panels one below the other, series thinned, a budget per page.

Panels are written as plotly.js reads them: building them with plotly's own objects takes ten times
as long as all the rest of a report. A series holds no more points than a screen can show, two bytes
each, and the budget says how many, so that a page does not weigh more than `PAGE_BYTES`.
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
"""A page may weigh."""
FINEST, COARSEST = 700, 60
"""Most and fewest columns of pixels of a series that is as wide as the page."""
MOST_PARTS = 6
"""Flights whose figures are on a page at most: of more, all would be drawn too coarsely."""


@dataclass(frozen=True, slots=True)
class Budget:
    """How finely the figures of a page are drawn: one for all that it shows.

    Attributes:
        columns: Of pixels, of a series that is as wide as the page.
        parts: How many of the page's parts, flights say, are drawn at all.
    """

    columns: int = FINEST
    parts: int = 1

    @property
    def spectrum(self) -> int:
        """Columns of pixels of a spectrum, a third of the page wide."""
        return max(45, min(90, self.columns // 2))

    @property
    def track(self) -> int:
        """Points of a track."""
        return max(120, min(500, self.columns))

    @property
    def cells(self) -> int:
        """Columns of a spectrogram."""
        return max(COARSEST, min(180, self.columns))


def fitted(draw: Callable[[Budget], str], parts: int = 1) -> str:
    """A page drawn as finely as `PAGE_BYTES` allow.

    It is drawn at its finest; where that is too much, at its coarsest, with fewer parts where even
    that is too much, and last in between. A page whose only part is too large as coarse as can be
    is returned nonetheless.

    Args:
        draw: Text of the page.
        parts: That there are; at most `MOST_PARTS` are drawn.
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
    # bytes grow with the logarithm of the columns, about: more and more series are drawn whole
    between = draw(Budget(int(COARSEST * (FINEST / COARSEST) ** share), parts))
    return between if _bytes(between) <= PAGE_BYTES else coarsest


def _bytes(page: str) -> int:
    return len(page.encode("utf-8"))


Array = NDArray[np.float64]

TREND_HZ = 2.0
"""Low-pass of the curve that is drawn over a band where samples come faster than `DENSE_HZ`: slower
than any rotor of the vehicles here turns, as fast as one of them tilts into another direction."""
DENSE_HZ = 20.0
"""Rate from which on spectra are drawn and noise is a band."""
STEPS, COARSE_STEPS = 65_533, 500
"""Of two bytes, and how many the middle half of the values spans at least."""
_LARGEST = 3.4e38
"""Of a number of 32 bits."""
GAP_STEPS, GAP_S = 6, 0.2
"""A line ends where samples are missing for longer than so many usual steps and than this."""


def thinned(x: Array, y: Array, columns: int) -> tuple[Array, Array]:
    """The least and the largest value in each of so many columns of pixels, where they are.

    What is drawn of them is what would be drawn of all samples. The first of the unknown values of
    a column is there too, so that a gap stays a gap.

    Args:
        x: Ascending, shape (n,).
        y: NaN where unknown, shape (n,).
        columns: How many.
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
    """Column of pixels of each value, ascending."""
    share = (x - x[0]) / max(float(x[-1] - x[0]), 1e-300)
    column: NDArray[np.intp] = np.minimum((share * columns).astype(np.intp), columns - 1)
    return column


@dataclass(frozen=True, slots=True)
class Drawn:
    """A series as it is drawn.

    Attributes:
        t_s: Of the curve, s, shape (n,).
        curve: Slow part where samples are dense, else the samples; NaN in gaps.
        band: Times and values of the outline of all samples, pieces apart by NaN; None: the curve
            is all.
    """

    t_s: Array
    curve: Array
    band: tuple[Array, Array] | None = None


def drawn(t_s: Array, values: Array, columns: int, below_hz: float = TREND_HZ) -> Drawn:
    """A series as a slow curve over the band of its samples, or as it is where it has few.

    Args:
        t_s: Times, s, ascending, shape (n,).
        values: NaN where unknown, shape (n,).
        columns: Columns of pixels.
        below_hz: Low-pass of the curve.
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
    """First row and end of each stretch that has no gap."""
    if not len(t_s):
        return []
    steps = np.diff(t_s)
    usual = float(np.median(steps)) if len(steps) else 0.0
    known = np.isfinite(values)
    torn = (steps > max(GAP_STEPS * usual, GAP_S)) | (known[1:] != known[:-1])
    edges = [0, *(np.flatnonzero(torn) + 1).tolist(), len(t_s)]
    return [(a, b) for a, b in pairwise(edges) if known[a]]


def _outline(t_s: Array, values: Array, columns: int) -> tuple[Array, Array]:
    """Largest values of the columns there, least ones back: a closed line around all samples."""
    column = _column(t_s, min(columns, max(1, len(t_s) // 4)))
    starts = np.flatnonzero(np.diff(column, prepend=-1))
    low, high = (f.reduceat(values, starts) for f in (np.minimum, np.maximum))
    t = np.append(t_s[starts[:-1]], t_s[-1]) if len(starts) > 1 else t_s[[0]]
    return np.concatenate([t, t[::-1]]), np.concatenate([high, low[::-1]])


def _chained(parts: list[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Parts one after the other, an unknown value between each two."""
    gap = np.array([np.nan])
    x = np.concatenate([p for part in parts for p in (part[0], gap)][:-1])
    y = np.concatenate([p for part in parts for p in (part[1], gap)][:-1])
    return x, y


def packed(values: Array, scale: str = "linear") -> dict[str, str | float]:
    """Numbers as a page holds them, NaN where unknown.

    Two bytes each: one and so many of 65,533 steps from the least to the largest, 0 where unknown.
    On a logarithmic scale, and where far-off values make these steps coarse for all others, four:
    single precision.

    Args:
        values: Shape (n,).
        scale: Of the axis along which they are drawn, as plotly.js has it.
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
    """Numbers that `packed` wrote, shape (n,)."""
    raw = b64decode(values["bdata"])
    if values["dtype"] == "f4":
        return np.frombuffer(raw, dtype="<f4").astype(np.float64)
    codes = np.frombuffer(raw, dtype="<u2").astype(np.float64)
    return np.where(codes > 0, values["low"] + (codes - 1.0) * values["step"], np.nan)


Axis = dict[str, Any]
Spans = Sequence[tuple[str, float, float]]
"""Name, start, end in s."""

GAP_PX, TOP_PX, BOTTOM_PX = 17, 22, 44
"""Between panels, above the first and below the last."""
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
"""Of the band that holds all samples."""


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


def spans_of(
    t_s: Array, values: NDArray[Any], name_of: Callable[[Any], str] = str
) -> list[tuple[str, float, float]]:
    """Spans of time in which a value stays the same; those without a name are left out.

    Args:
        t_s: Times, s, shape (n,).
        values: Shape (n,).
        name_of: Name of a value, "" of none.
    """
    ends = [(name_of(values[a]), a, min(b, len(t_s) - 1)) for a, b in runs(values)]
    return [(name, float(t_s[a]), float(t_s[b])) for name, a, b in ends if name]


def degenerate(figure: Plot) -> Iterator[str]:
    """What is wrong with a figure: no curve, a single point, no extent, panels that overlap.

    Args:
        figure: As a page holds it.
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
