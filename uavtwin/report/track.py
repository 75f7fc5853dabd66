"""Where something flew: from above, from the side, and in space with its attitude."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.frames import to_ned

from .drawing import Budget, Panels, packed
from .page import Figure, Plot, plot

Array = NDArray[np.float64]
BODIES = 14
"""Attitudes that are drawn along a track."""
HEIGHT_PX = 330
FLAT_M = 0.5
"""Least extent of a picture: what hovers better than that is not enlarged further."""


@dataclass(frozen=True, slots=True)
class Track:
    """A curve in space.

    Attributes:
        name: In the key.
        t_s: Times, s, shape (n,).
        position_m: North, east, down, shape (n, 3); NaN where unknown.
        colour: Of the curve.
        dash: As plotly.js writes it.
    """

    name: str
    t_s: Array
    position_m: Array
    colour: str
    dash: str = "solid"


def track_plots(
    name: str,
    tracks: Sequence[Track],
    budget: Budget,
    attitude: tuple[Array, Array] | None = None,
) -> list[Plot]:
    """Three pictures of tracks.

    The basic bundle of plotly.js draws no third dimension: the page turns the curves itself,
    without perspective.

    Args:
        name: Begins the identifiers of the pictures.
        tracks: Curves; the first one is that of what has the attitude.
        budget: Of the page.
        attitude: Times, s, shape (m,), and quaternions body to NED, shape (m, 4); None: not known.
    """
    thin = [(t, _thinned(t.position_m, budget.track)) for t in tracks]
    known = np.concatenate([p[np.isfinite(p).all(axis=1)] for _, p in thin])
    if len(known) < 2:
        return []
    low, high = _box(known)
    words = " and ".join(t.name for t in tracks)
    return [
        plot(f"{name}-above", f"Track from above: {words}", _flat(thin, low, high, 1, 0)),
        plot(f"{name}-side", f"Track from the south: {words}", _flat(thin, low, high, 1, 2)),
        plot(
            f"{name}-space",
            f"Track in space: {words}; arrow keys turn it",
            _scene(tracks[0], thin, low, high, attitude),
            scene=True,
        ),
    ]


def _box(known: Array) -> tuple[Array, Array]:
    """Lowest and highest east, north and up, one extent for all axes being the least."""
    enu = _enu(known)
    low, high = enu.min(axis=0), enu.max(axis=0)
    middle, half = (low + high) / 2, np.maximum(high - low, FLAT_M) / 2
    return middle - half, middle + half


def _enu(position_m: Array) -> Array:
    """East, north and up of north, east and down."""
    enu: Array = position_m[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0])
    return enu


def _thinned(position_m: Array, points: int) -> Array:
    """At most so many points of a track, evenly along it."""
    if len(position_m) <= points:
        return position_m
    return position_m[np.unique(np.linspace(0, len(position_m) - 1, points).astype(np.intp))]


_WORDS = ("north, m", "east, m", "up, m")


def _flat(
    thin: Sequence[tuple[Track, Array]], low: Array, high: Array, across: int, along: int
) -> Figure:
    """Tracks in a plane; axes are north, east, up by number, of equal scale."""
    panels = Panels((HEIGHT_PX - 66,))
    order = (1, 0, 2)  # where each axis is within east, north, up
    edges = [[float(v[order[k]]) for v in (low, high)] for k in (across, along)]
    margin = 0.06 * max(e[1] - e[0] for e in edges)
    spans = [[e[0] - margin, e[1] + margin] for e in edges]
    axes = panels.add(
        _WORDS[along],
        {"title": {"text": _WORDS[across]}, "range": spans[0], "nticks": 6},
        {"range": spans[1], "scaleanchor": "x", "scaleratio": 1},
    )
    for track, position in thin:
        enu = _enu(position)
        line = {"color": track.colour, "width": 1.6, "dash": track.dash}
        x, y = enu[:, order[across]], enu[:, order[along]]
        panels.line(axes, x, y, track.name, line)
    first = _enu(thin[0][1])
    start = first[np.flatnonzero(np.isfinite(first).all(axis=1))[:1]]
    if len(start):
        point = (start[0, order[across]], start[0, order[along]])
        panels.figure["data"].append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": "start",
                "x": packed(np.array([point[0]])),
                "y": packed(np.array([point[1]])),
                "marker": {"size": 9, "color": "#2f8f5b", "symbol": "circle-open"},
                "hoverinfo": "name",
            }
        )
    return panels.figure


def _scene(
    body: Track,
    thin: Sequence[tuple[Track, Array]],
    low: Array,
    high: Array,
    attitude: tuple[Array, Array] | None,
) -> dict[str, Any]:
    """Tracks in space, east, north and up, as the script of the page draws them."""
    extent = high - low
    return {
        "height": HEIGHT_PX,
        "low": _short(low),
        "high": _short(high),
        "span": [f"{float(v):.3g} m" for v in extent],
        "lines": [
            {
                "name": t.name,
                "colour": t.colour,
                "dash": "" if t.dash == "solid" else t.dash,
                "points": [_short(p) for p in _enu(position)],
            }
            for t, position in thin
        ],
        "bodies": [] if attitude is None else _bodies(body, *attitude, size=extent.max() / 18),
    }


def _bodies(track: Track, t_s: Array, q_nb: Array, size: float) -> list[list[list[float | None]]]:
    """Crosses of an airframe along a track, with a line up from each and a longer arm ahead."""
    known = np.isfinite(track.position_m).all(axis=1)
    if known.sum() < 2 or len(t_s) < 2:
        return []
    t, position = track.t_s[known], track.position_m[known]
    begin, end = max(t[0], t_s[0]), min(t[-1], t_s[-1])
    found = []
    for at in np.linspace(begin, end, BODIES):
        centre = np.array([np.interp(at, t, position[:, k]) for k in range(3)])
        q = q_nb[int(np.argmin(np.abs(t_s - at)))]
        if not np.isfinite(q).all():
            continue
        strokes = ([1.6, 0, 0], [-1, 0, 0]), ([0, 1, 0], [0, -1, 0]), ([0, 0, 0], [0, 0, -0.8])
        lines: list[list[float | None]] = []
        for stroke in strokes:
            ends = centre + size * np.array([to_ned(q.tolist(), end) for end in stroke])
            lines += [*[_short(p) for p in _enu(ends)], [None]]
        found.append(lines)
    return found


def _short(values: Array) -> list[float | None]:
    """Numbers as a page holds them; None where unknown."""
    return [float(f"{v:.5g}") if np.isfinite(v) else None for v in values]
