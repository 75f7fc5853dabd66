"""What a flight was, before any model: where it went, what its motors and its battery did."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from twin.logs import AnyFlight
from twin.logs.columns import POS, QUAT, motor_columns
from twin.representation import short_repr
from twin.residuals.gap import Channel

from .autopilot import AutopilotView, autopilot_view
from .drawing import Budget, Panels, Spans, thinned
from .page import BLACK, BLUE, GREY, Plot, plot
from .track import Track, track_plots

Array = NDArray[np.float64]
HELD = 1200
"""Samples of a series that are held, about: what two columns of pixels can show."""
MOST_MOTORS = 12
_MOTORS = (
    *(BLUE, "#d9622b", "#2f8f5b", "#8a4fbf", "#b58900", "#c23b66"),
    *("#3aa0a8", "#6b7280", "#5fb8c9", GREY, "#c3c7cd", BLACK),
)


@dataclass(frozen=True, slots=True)
class Overview:
    """A flight as the top of a page shows it, thinned to what a screen shows.

    Attributes:
        position: Times, s, shape (n,), and position, NED, m, shape (n, 3); None: not logged.
        attitude: Times, s, shape (m,), and quaternions body to NED, shape (m, 4); None.
        motors: Panels of one line per motor: title, then times and values of each.
        battery: Panels of one line: title, times, values.
        told: What its autopilot says.
    """

    position: tuple[Array, Array] | None
    attitude: tuple[Array, Array] | None
    motors: tuple[tuple[str, tuple[tuple[Array, Array], ...]], ...]
    battery: tuple[tuple[str, Array, Array], ...]
    view: AutopilotView

    __repr__ = short_repr


def overview(flight: AnyFlight) -> Overview:
    """What a flight was.

    Args:
        flight: As read, or left in its file.
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
    changes = np.flatnonzero(codes[1:] != codes[:-1]) + 1
    rows = np.concatenate([[0], changes, [len(codes) - 1]]) if len(codes) else np.empty(0, int)
    t = flight.time_s
    return [
        (str(names[codes[a]]), float(t[a]), float(t[b]))
        for a, b in pairwise(rows.tolist())
        if str(names[codes[a]])
    ]


def _line(flight: AnyFlight, column: str) -> tuple[Array, Array]:
    t, values = flight.signal([column])
    return thinned(t, values[:, 0], HELD // 2)


def _vector(flight: AnyFlight, columns: Sequence[str]) -> tuple[Array, Array] | None:
    """Times and values of a vector, evenly thinned; None where it is not logged."""
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
        name: Begins the identifiers, and is the group of the time axes.
        shown: The flight.
        phases: Drawn as coloured background.
        budget: Of the page.
        ends: Channels north, east and down of the position of a twin that restarts from the
            measured state again and again, at the end of each stretch.

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
    """Strokes from where the flight was to where the twin would have been after its short horizon:
    each begins at the measured place of the restart."""
    begin = ends[0].t_s - ends[0].horizon_s
    start = np.column_stack([np.interp(begin, t_s, position_m[:, k]) for k in range(3)])
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
