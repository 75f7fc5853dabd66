"""What the autopilot says of a flight, as pages show it: what it was asked for against what it did,
vibration with the filters on board, and its words."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.frames import to_euler
from twin.logs import AnyFlight
from twin.logs.autopilot import Autopilot, Message, Parameter
from twin.logs.columns import GYRO, POS, QUAT, VEL, motor_columns
from twin.representation import short_repr
from twin.residuals.spectra import slow_part

from .drawing.budget import Budget
from .drawing.panels import Panels, Spans
from .drawing.series import thinned
from .drawing.spectrogram import Spectrogram, spectrogram
from .drawing.strip import Strip, strip
from .page import BLACK, BLUE, GREY, ORANGE, Figure, Plot, plot

Array = NDArray[np.float64]
MOST_MESSAGES = 200
MOST_PARAMETERS = 300
"""Rows of a page, of all its flights together at most five times as many."""
FLOWN, ASKED = "measured", "setpoint"
_HELD = 260
"""Columns of pixels of a series: two figures stand side by side."""
_ROW_PX = 100
_SPECTROGRAM_PX = 250
_FOLLOWED = (
    (POS, "Position", "m", ("north", "east", "down")),
    (VEL, "Velocity", "m/s", ("north", "east", "down")),
    (QUAT, "Attitude", "°", ("roll", "pitch", "yaw")),
    (GYRO, "Body rate", "rad/s", ("roll", "pitch", "yaw")),
)


@dataclass(frozen=True, slots=True)
class Followed:
    """Setpoint and flight of one quantity, thinned to what a screen shows.

    Attributes:
        words: What it is.
        unit: Of both.
        axes: Name, then times and values of the flight, then those of the setpoint, per axis.
    """

    words: str
    unit: str
    axes: tuple[tuple[str, tuple[Array, Array], tuple[Array, Array]], ...]

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class Told:
    """What a page tells of an autopilot.

    Attributes:
        autopilot: What it says; None: nothing.
        end_s: End of the record, s.
        followed: Setpoints against the flight.
        vibration: Spectrogram; None: too few samples.
        rotors: Times, s, and frequency of each rotor, Hz.
    """

    autopilot: Autopilot | None
    end_s: float
    followed: tuple[Followed, ...]
    vibration: Spectrogram | None
    rotors: tuple[tuple[Array, Array], ...]

    __repr__ = short_repr


def told_of(flight: AnyFlight) -> Told:
    """What a page tells of a flight's autopilot.

    Args:
        flight: As read, or left in its file.
    """
    followed = [_followed(flight, *each) for each in _FOLLOWED]
    names = [c for c in motor_columns("rotor", 12) if flight.has(c)]
    rotors = []
    for name in names:
        t, speed = flight.signal([name])
        rotors.append(thinned(t, speed[:, 0] / (2.0 * np.pi), _HELD // 4))
    return Told(
        flight.autopilot,
        float(flight.time_s[-1]) if len(flight.time_s) else 0.0,
        tuple(f for f in followed if f is not None),
        spectrogram(flight),
        tuple(rotors),
    )


def _followed(
    flight: AnyFlight, columns: tuple[str, ...], words: str, unit: str, names: Sequence[str]
) -> Followed | None:
    """None where the setpoint or the signal is missing."""
    asked = None if flight.autopilot is None else flight.autopilot.setpoint(columns)
    if asked is None or not flight.has(*columns):
        return None
    t, flown = flight.signal(columns)
    wanted = asked.values
    if columns == QUAT:
        flown = np.unwrap(to_euler(flown.T).T, axis=0)
        near = np.column_stack([np.interp(asked.t_s, t, angle) for angle in flown.T])
        wanted = near + _wrapped(to_euler(wanted.T).T - near)
        flown, wanted = np.degrees(flown), np.degrees(wanted)
    axes = []
    for k, name in enumerate(names):
        if not np.isfinite(wanted[:, k]).any():
            continue
        slow = slow_part(t, flown[:, k]) if columns == GYRO else flown[:, k]
        pair = thinned(t, slow, _HELD), thinned(asked.t_s, wanted[:, k], _HELD)
        axes.append((name, *pair))
    return Followed(words, unit, tuple(axes)) if axes else None


def _wrapped(angle: Array) -> Array:
    """To between half a turn back and half a turn on."""
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)


def told_content(
    name: str, told: Told, phases: Spans, budget: Budget, share: float = 1.0
) -> dict[str, Any]:
    """What the template `autopilot.html.j2` shows of a flight.

    Args:
        name: Begins the identifiers, and is the group of the time axes.
        told: Of the flight.
        phases: Drawn as coloured background.
        budget: Of the page.
        share: Of the rows that a page has room for.
    """
    said = told.autopilot or Autopilot()
    words: Strip | None = strip(name, told.autopilot, told.end_s)
    return {
        "strip": words,
        "followed": [_followed_plot(name, f, phases, budget) for f in told.followed],
        "spectrogram": None
        if told.vibration is None
        else _vibration_plot(name, told, phases, budget),
        "spectrogram_note": _vibration_note(told),
        "modes": said.mode_stretches(told.end_s)[:MOST_MESSAGES],
        "armed": said.armed[:MOST_MESSAGES],
        "failsafes": said.failsafes[:MOST_MESSAGES],
        "messages": _first(said.messages, round(share * MOST_MESSAGES)),
        "messages_count": len(said.messages),
        "parameters": _listed(said.parameters, round(share * MOST_PARAMETERS)),
        "parameters_count": len(said.parameters),
    }


def _first(messages: Sequence[Message], most: int) -> list[Message]:
    """The grave ones, then others, as many as there is room for, in order of time."""
    order = sorted(messages, key=lambda m: not m.grave)[:most]
    return sorted(order, key=lambda m: m.t_s)


def _listed(parameters: Sequence[Parameter], most: int) -> list[tuple[str, str, str]]:
    """Name, value and default as printed."""
    return [(p.name, f"{p.value:.7g}", f"{p.default:.7g}") for p in parameters[:most]]


def _followed_plot(name: str, shown: Followed, phases: Spans, budget: Budget) -> Plot:
    panels = Panels((_ROW_PX,) * len(shown.axes), name)
    times = []
    for axis, flown, asked in shown.axes:
        number = panels.add(f"{axis}, {shown.unit}")
        for (t, values), label, colour, dash in (
            (flown, FLOWN, BLACK, "solid"),
            (asked, ASKED, BLUE, "dash"),
        ):
            line = {"color": colour, "width": 1.5, "dash": dash}
            panels.line(number, *thinned(t, values, budget.columns), label, line)
        times.append(flown[0])
    panels.look(min(float(t[0]) for t in times), max(float(t[-1]) for t in times), phases)
    label = f"{shown.words}: setpoint and flight over time"
    return plot(f"{name}-setpoint-{shown.words}", label, panels.figure)


def _vibration_plot(name: str, told: Told, phases: Spans, budget: Budget) -> Plot:
    """Power over time and frequency; rotors and filters as lines on it."""
    assert told.vibration is not None
    shown = told.vibration
    panels = Panels((_SPECTROGRAM_PX,), name)
    axes = panels.add("frequency, Hz", y={"range": [0, shown.top_hz]})
    panels.layout["meta"]["spectrogram"] = shown.content(budget.cells)
    ends = np.array([shown.start_s, shown.end_s])
    for i, (t, hz) in enumerate(told.rotors):
        if np.nanmin(hz, initial=np.inf) < shown.top_hz:
            _line(panels, axes, (t, hz), f"rotor {i + 1}", {"color": ORANGE, "width": 1.2})
    for each in told.autopilot.filters if told.autopilot else ():
        if each.sensor == shown.sensor and each.frequency_hz < shown.top_hz:
            label = f"{each.kind} {each.frequency_hz:g} Hz ({each.source})"
            dash = "dash" if each.kind == "low-pass" else "dot"
            line = {"color": GREY, "width": 1.8, "dash": dash}
            _line(panels, axes, (ends, np.full(2, each.frequency_hz)), label, line)
    panels.look(shown.start_s, shown.end_s, phases)
    words = "gyroscope" if shown.sensor == "gyro" else "accelerometer"
    label = f"Spectrogram of the {words}: power over time and frequency"
    return plot(f"{name}-spectrogram", label, panels.figure)


def _line(
    panels: Panels, axes: str, curve: tuple[Array, Array], label: str, line: dict[str, Any]
) -> None:
    panels.line(
        axes,
        *curve,
        label,
        line,
        hovertemplate="%{y:.3g} Hz at %{x:.2f} s<extra></extra>",
    )


def _vibration_note(told: Told) -> str:
    """How to read the spectrogram, and what lies beyond it."""
    shown = told.vibration
    if shown is None:
        return ""
    content: Figure = shown.content()
    unit = "(rad/s)²/Hz" if shown.sensor == "gyro" else "(m/s²)²/Hz"
    text = (
        "Power of the three axes together: from the colour of the page, "
        f"{content['low']:.0f} dB, to the strongest, {content['high']:.0f} dB over 1 {unit}; "
        f"samples at {shown.rate_hz:.0f} Hz show up to {shown.top_hz:.0f} Hz."
    )
    speeds = [hz[np.isfinite(hz) & (hz > 0.0)] for _, hz in told.rotors]
    middle = [float(np.median(hz)) for hz in speeds if len(hz)]
    if middle and max(middle) > shown.top_hz:
        turn = f"{min(middle):.0f} to {max(middle):.0f} Hz"
        text += f" Rotors turn at {turn} (medians); what lies above the upper edge is folded down."
    filters = told.autopilot.filters if told.autopilot else ()
    beyond = [f for f in filters if f.sensor == shown.sensor and f.frequency_hz >= shown.top_hz]
    if beyond:
        listed = ", ".join(f"{f.kind} {f.frequency_hz:g} Hz ({f.source})" for f in beyond)
        text += f" Filters above that: {listed}."
    return text
