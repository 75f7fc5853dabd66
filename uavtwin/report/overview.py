"""Overview of a flight before any model: track, motors, battery."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.frames import to_ned
from twin.logs import AnyFlight
from twin.logs.columns import POS, QUAT, motor_columns
from twin.logs.samples import interpolated
from twin.representation import ShortRepr
from twin.residuals.gap import Channel

from .autopilot import AutopilotView, autopilot_view
from .drawing import Budget, Panels, Spans, packed, spans_of, thinned
from .page import BLACK, BLUE, GREY, Figure, Plot, plot

Array = NDArray[np.float64]
BODIES = 14
"""Largest number of attitudes drawn along a track."""
HEIGHT_PX = 330
"""Height of a track, px."""
FLAT_M = 0.5
"""Least extent of a picture, m: a steadier hover is not enlarged further."""


@dataclass(frozen=True, slots=True)
class Track:
    """A curve in space.

    Attributes:
        name: Name in the legend.
        t_s: Times, s, shape (n,).
        position_m: Position north, east, down, shape (n, 3); NaN where unknown.
        colour: Colour of the curve.
        dash: Dash pattern as in plotly.js.
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

    The basic bundle of plotly.js has no 3D plots: the page rotates the curves itself, without
    perspective.

    Args:
        name: Prefix of the identifiers of the pictures.
        tracks: Curves; the first one is that of the body with the attitude.
        budget: Budget of the page.
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
    """Lowest and highest east, north and up, with the same least extent for all axes."""
    enu = _enu(known)
    low, high = enu.min(axis=0), enu.max(axis=0)
    middle, half = (low + high) / 2, np.maximum(high - low, FLAT_M) / 2
    return middle - half, middle + half


def _enu(position_m: Array) -> Array:
    """East, north and up from north, east and down."""
    enu: Array = position_m[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0])
    return enu


def _thinned(position_m: Array, points: int) -> Array:
    """Evenly selected points of a track, up to a number."""
    if len(position_m) <= points:
        return position_m
    return position_m[np.unique(np.linspace(0, len(position_m) - 1, points).astype(np.intp))]


_WORDS = ("north, m", "east, m", "up, m")
"""Titles of the axes of a track."""


def _flat(
    thin: Sequence[tuple[Track, Array]], low: Array, high: Array, across: int, along: int
) -> Figure:
    """Tracks in a plane; axes are north, east, up by number, with equal scales."""
    panels = Panels((HEIGHT_PX - 66,))
    order = (1, 0, 2)  # index of each axis in east, north, up
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
    """Tracks in space, east, north and up, for the script of the page."""
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
    """Numbers in the form of a page; None where unknown."""
    return [float(f"{v:.5g}") if np.isfinite(v) else None for v in values]


HELD = 1200
"""Approximate number of stored samples of a series: the resolution of two pixel columns."""
MOST_MOTORS = 12
"""Largest number of motors that are drawn."""
_MOTORS = (
    *(BLUE, "#d9622b", "#2f8f5b", "#8a4fbf", "#b58900", "#c23b66"),
    *("#3aa0a8", "#6b7280", "#5fb8c9", GREY, "#c3c7cd", BLACK),
)
"""A colour for each."""


@dataclass(frozen=True, slots=True)
class Overview(ShortRepr):
    """A flight for the top of a page, decimated to the resolution of a screen.

    Attributes:
        position: Times, s, shape (n,), and position, NED, m, shape (n, 3); None: not logged.
        attitude: Times, s, shape (m,), and quaternions body to NED, shape (m, 4); None: not logged.
        motors: Panels with one line per motor: title, then times and values of each.
        battery: Panels with one line: title, times, values.
        view: Records of its autopilot.
    """

    position: tuple[Array, Array] | None
    attitude: tuple[Array, Array] | None
    motors: tuple[tuple[str, tuple[tuple[Array, Array], ...]], ...]
    battery: tuple[tuple[str, Array, Array], ...]
    view: AutopilotView


def overview(flight: AnyFlight) -> Overview:
    """Overview of a flight.

    Args:
        flight: Flight in memory, or in its file.
    """
    motors = []
    for stem, words in (("cmd", "motor command, 0 to 1"), ("rotor", "rotor speed, rad/s")):
        names = [c for c in motor_columns(stem, MOST_MOTORS) if flight.has(c)]
        lines = tuple(_line(flight, name) for name in names)
        if lines:
            motors.append((words, lines))
    battery = [
        (words, *_line(flight, name))
        for name, words in (("vbat_v", "battery, V"), ("ibat_a", "current, A"))
        if flight.has(name)
    ]
    return Overview(
        _vector(flight, POS),
        _vector(flight, QUAT),
        tuple(motors),
        tuple(battery),
        autopilot_view(flight),
    )


def flight_spans(flight: AnyFlight) -> Spans:
    """Phases of a flight, as its table has them."""
    codes, names = flight.phase_codes
    return spans_of(flight.time_s, codes, lambda code: str(names[code]))


def _line(flight: AnyFlight, column: str) -> tuple[Array, Array]:
    t, values = flight.signal([column])
    return thinned(t, values[:, 0], HELD // 2)


def _vector(flight: AnyFlight, columns: Sequence[str]) -> tuple[Array, Array] | None:
    """Times and values of a vector, evenly decimated; None where it is not logged."""
    if not flight.has(*columns):
        return None
    t, values = flight.signal(columns)
    every = max(1, -(-len(t) // HELD))
    return t[::every], values[::every]


def overview_plots(
    name: str,
    shown: Overview,
    phases: Spans,
    budget: Budget,
    ends: Sequence[Channel] = (),
) -> tuple[list[Plot], Plot | None]:
    """The tracks, and motors and battery over time.

    Args:
        name: Prefix of the identifiers, and group of the time axes.
        shown: Overview of the flight.
        phases: Phases drawn as coloured background.
        budget: Budget of the page.
        ends: Channels north, east and down of the position of a twin that restarts repeatedly from
            the measured state, at the end of each stretch.

    Returns:
        The pictures of the track, and the figure over time; none and None where nothing is logged.
    """
    tracks = []
    if shown.position is not None:
        t, position = shown.position
        tracks.append(Track("measured", t, position, BLACK))
        if len(ends) == 3 and len(ends[0].t_s):
            tracks.append(_restarted(t, position, ends))
    pictures = track_plots(name, tracks, budget, shown.attitude) if tracks else []
    return pictures, _over_time(name, shown, phases, budget)


def _restarted(t_s: Array, position_m: Array, ends: Sequence[Channel]) -> Track:
    """Strokes from the measured position at each restart to that of the twin after its short
    horizon."""
    begin = ends[0].t_s - ends[0].horizon_s
    start = interpolated(begin, t_s, position_m)
    end = np.column_stack([c.simulated for c in ends])
    none = np.full_like(start, np.nan)
    strokes = np.stack([start, end, none], axis=1).reshape(-1, 3)
    label = f"twin, restarted every {ends[0].horizon_s:g} s"
    return Track(label, np.repeat(ends[0].t_s, 3), strokes, BLUE)


def _over_time(name: str, shown: Overview, phases: Spans, budget: Budget) -> Plot | None:
    """Motors and battery."""
    count = len(shown.motors) + len(shown.battery)
    if count == 0:
        return None
    panels = Panels((130,) * count, name)
    times = []
    for words, lines in shown.motors:
        axes = panels.add(words)
        for i, (t, values) in enumerate(lines):
            line = {"color": _MOTORS[i], "width": 1.2}
            label = f"motor {i + 1}"
            panels.line(axes, *thinned(t, values, budget.columns), label, line, legendgroup=label)
            times.append(t)
    for words, t, values in shown.battery:
        axes = panels.add(words)
        label, line = words.partition(",")[0], {"color": GREY, "width": 1.4}
        panels.line(axes, *thinned(t, values, budget.columns), label, line)
        times.append(t)
    panels.look(min(float(t[0]) for t in times), max(float(t[-1]) for t in times), phases)
    label = "Motor commands, rotor speeds and battery over time, as logged"
    return plot(f"{name}-logged", label, panels.figure)
