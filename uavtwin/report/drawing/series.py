"""Series as a page holds them: no more points than a screen can show, two bytes each."""

from base64 import b64decode, b64encode
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.residuals.spectra import slow_part

Array = NDArray[np.float64]

TREND_HZ = 2.0
"""Low-pass of the curve that is drawn over a band where samples come faster than `DENSE_HZ`: slower
than any rotor of the vehicles here turns, as fast as one of them tilts into another direction."""
DENSE_HZ = 20.0
STEPS, COARSE_STEPS = 65_533, 500
"""Of two bytes, and how many the middle half of the values spans at least."""
_LARGEST = 3.4e38
GAP_STEPS, GAP_S = 6, 0.2
"""A line ends where samples are missing for longer than so many usual steps and than this."""


def thinned(x: Array, y: Array, columns: int) -> tuple[Array, Array]:
    """The least and the largest value in each of so many columns of pixels, where they are.

    What is drawn of them is what would be drawn of all samples. The first of the unknown values of
    a column is kept too, so that a gap stays a gap.

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
    kept = [order[least], order[np.maximum(past - 1, least)]]
    kept.append(order[past[past < edges[1:]]])
    keep = np.unique(np.concatenate([[0, len(x) - 1], *kept]))
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
