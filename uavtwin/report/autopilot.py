"""Records of the autopilot on pages: modes and events, setpoints, vibration, messages, parameters.

Modes are a band above every time axis, with failsafes, arming and messages as marks: a page
contains that strip once per flight, and page.js copies it to each figure. Vibration is a
spectrogram of the gyroscope or accelerometer, with the filters on board.
"""

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from twin.frames import to_euler
from twin.logs import AnyFlight
from twin.logs.autopilot import Autopilot, Message, Parameter, Sensor
from twin.logs.columns import ACC, GYRO, POS, QUAT, VEL, motor_columns
from twin.logs.samples import interpolated
from twin.representation import ShortRepr
from twin.residuals.gap import slow_part
from twin.residuals.measured import signal_of

from .drawing import Budget, Panels, Spans, thinned
from .page import BLACK, BLUE, GREY, ORANGE, Figure, Plot, embedded, plot

Array = NDArray[np.float64]
COLUMNS, ROWS = 180, 96
"""Largest number of pixels along time and frequency."""
SEGMENT_S = 1.28
"""Length of a segment, one per column: lines 1 Hz apart are distinct, a change of rotor speed is
followed."""
LEAST_RATE_HZ = 20.0
"""Lowest sample rate for vibration."""
_KNOWN = 0.7
"""Least share of available samples in a segment."""
_LOWEST, _HIGHEST = 5.0, 99.9
"""Percentiles of the power at the ends of the colour scale."""


@dataclass(frozen=True, slots=True)
class Spectrogram(ShortRepr):
    """Spectrogram of the three axes of a sensor together.

    Attributes:
        sensor: Sensor of the readings.
        start_s: Time of the left edge.
        end_s: Time of the right edge.
        rate_hz: Sample rate; the upper edge is half of it.
        power_db: Power spectral density, dB over 1 unit^2/Hz, shape (rows, columns), from 0 Hz up;
            NaN where samples are missing.
    """

    sensor: Sensor
    start_s: float
    end_s: float
    rate_hz: float
    power_db: Array

    @property
    def top_hz(self) -> float:
        """Half of the sampling rate."""
        return 0.5 * self.rate_hz

    def content(self, columns: int = COLUMNS) -> dict[str, object]:
        """Content for a page: a byte per cell, 0 where unknown, 1 to 255 from `low` to `high`.

        Args:
            columns: Largest number of columns; of neighbouring ones the largest is shown.
        """
        known = self.power_db[np.isfinite(self.power_db)]
        low, high = (float(v) for v in np.percentile(known, [_LOWEST, _HIGHEST]))
        high = max(high, low + 1.0)
        share = np.clip((self.power_db - low) / (high - low), 0.0, 1.0)
        if share.shape[1] > columns:
            starts = np.arange(columns) * share.shape[1] // columns
            share = np.fmax.reduceat(share, starts, axis=1)
        cells = np.where(np.isfinite(share), 1 + np.round(254 * np.nan_to_num(share)), 0)
        rows, columns = share.shape
        return {
            **{"start": self.start_s, "end": self.end_s, "top": self.top_hz},
            **{"rows": rows, "columns": columns, "low": round(low, 1), "high": round(high, 1)},
            "cells": b64encode(cells.astype(np.uint8).tobytes()).decode("ascii"),
        }


def spectrogram(flight: AnyFlight) -> Spectrogram | None:
    """Spectrogram of the gyroscope, or of the accelerometer if that is missing or half as fast.

    Each column is a segment of `SEGMENT_S` about its middle: Hann window, mean removed, samples
    resampled at their median rate. Of a long flight segments are far apart, so that a column is a
    sample of it.

    Args:
        flight: Flight in memory, or in its file.

    Returns:
        None where neither has `LEAST_RATE_HZ` for ten segments.
    """
    sensors: tuple[tuple[Sensor, tuple[str, ...]], ...] = (("gyro", GYRO), ("acc", ACC))
    found = [
        (name, signal_of(flight, columns)) for name, columns in sensors if flight.has(*columns)
    ]
    found = [(name, s) for name, s in found if s.rate_hz >= LEAST_RATE_HZ]
    if not found:
        return None
    sensor, signal = found[0]
    if len(found) > 1 and found[1][1].rate_hz > 2.0 * signal.rate_hz:
        sensor, signal = found[1]
    rate_hz = signal.rate_hz
    start_s, end_s = float(flight.time_s[0]), float(flight.time_s[-1])
    n = max(16, round(SEGMENT_S * rate_hz))
    length_s = n / rate_hz
    if end_s - start_s < 10.0 * length_s:
        return None
    columns = min(COLUMNS, int((end_s - start_s) / (0.25 * length_s)))
    edges = np.linspace(start_s, end_s, columns + 1)
    window = np.hanning(n)
    scale = 2.0 / (rate_hz * float((window**2).sum()))
    power = np.full((n // 2, columns), np.nan)
    for k, middle in enumerate((edges[1:] + edges[:-1]) / 2.0):
        first = min(max(middle - 0.5 * length_s, start_s), end_s - length_s)
        near = signal.between(first, first + length_s)
        if len(near.t_s) < _KNOWN * n:
            continue
        grid = first + np.arange(n) / rate_hz
        total = np.zeros(n // 2)
        for axis in near.values.T:
            values = np.interp(grid, near.t_s, axis)
            spectrum = np.fft.rfft(window * (values - values.mean()))
            total += scale * np.abs(spectrum[1 : n // 2 + 1]) ** 2
        power[:, k] = total
    if not np.isfinite(power).any():
        return None
    with np.errstate(divide="ignore"):
        power_db = 10.0 * np.log10(np.maximum(_pooled(power), 1e-30))
    return Spectrogram(sensor, start_s, end_s, rate_hz, power_db)


def _pooled(power: Array) -> Array:
    """The largest of neighbouring frequencies, so that lines are preserved."""
    every = -(-len(power) // ROWS)
    starts = np.arange(0, len(power), every)
    return np.asarray(np.maximum.reduceat(power, starts, axis=0))


HEIGHT_PX = 18
"""Height of the strip, px."""
MOST_BANDS = 100
"""Largest number of modes and of failsafes that are drawn."""
PLACES = 90
"""Largest number of marks along a strip; messages nearer to each other share one."""
_MOST_LINES = 6
"""Largest number of messages in one mark."""


@dataclass(frozen=True, slots=True)
class Strip:
    """Content of the strip for a template.

    Attributes:
        group: Group of the figures with common time axes.
        json: `modes` and `failsafes` as name, start, end; `marks` as time, kind and text.
    """

    group: str
    json: Markup


def strip(group: str, autopilot: Autopilot | None, end_s: float) -> Strip | None:
    """The strip of a flight; None where its log has no such records.

    Args:
        group: Group of its figures.
        autopilot: Records of the autopilot.
        end_s: End of the record, s.
    """
    if autopilot is None or not end_s > 0.0:
        return None
    modes, failsafes = (
        [[escape(s.name), s.start_s, s.end_s] for s in several]
        for several in (autopilot.mode_stretches(end_s), autopilot.failsafes)
    )
    marks: list[list[object]] = []
    for each in autopilot.armed:
        marks.append([each.start_s, "armed", "armed"])
        if each.end_s < end_s:
            marks.append([each.end_s, "disarmed", "disarmed"])
    marks = [*_messages(autopilot.messages, end_s), *marks[: 2 * MOST_BANDS]]
    if not (modes or failsafes or marks):
        return None
    content = {"modes": modes[:MOST_BANDS], "failsafes": failsafes[:MOST_BANDS], "marks": marks}
    return Strip(group, embedded({"height": HEIGHT_PX, **content}))


def _messages(messages: Sequence[Message], end_s: float) -> list[list[object]]:
    """A mark for neighbouring messages, severe where one of them is."""
    places: dict[int, list[Message]] = {}
    for each in messages:
        if 0.0 <= each.t_s <= end_s:
            places.setdefault(int(each.t_s / end_s * PLACES), []).append(each)
    marks: list[list[object]] = []
    for several in places.values():
        graver = sorted(several, key=lambda m: not m.grave)[:_MOST_LINES]
        lines = [
            escape(f"{m.level}: {m.text}" if m.level else m.text)
            for m in several
            if any(m is g for g in graver)
        ]
        if len(several) > _MOST_LINES:
            lines.append(f"and {len(several) - _MOST_LINES} more")
        t_s = next((m.t_s for m in several if m.grave), several[0].t_s)
        grave = any(m.grave for m in several)
        marks.append([t_s, "grave" if grave else "said", "<br>".join(lines)])
    return marks


MOST_MESSAGES = 200
"""Largest number of rows in a flight's table of messages."""
MOST_PARAMETERS = 300
"""Largest number of rows per flight in the table of parameters; five times as many for all flights
of a page."""
FLOWN, SETPOINT = "measured", "setpoint"
"""Names of the curves."""
_HELD = 260
"""Columns of pixels of a series: two figures side by side."""
_ROW_PX = 100
"""Height of a panel, px."""
_SPECTROGRAM_PX = 250
"""Height of the spectrogram, px."""
_FOLLOWED = (
    (POS, "Position", "m", ("north", "east", "down")),
    (VEL, "Velocity", "m/s", ("north", "east", "down")),
    (QUAT, "Attitude", "°", ("roll", "pitch", "yaw")),
    (GYRO, "Body rate", "rad/s", ("roll", "pitch", "yaw")),
)
"""Columns, name, unit and axes of the quantities that have setpoints."""


@dataclass(frozen=True, slots=True)
class Followed(ShortRepr):
    """Setpoint and flight of one quantity, decimated to the resolution of a screen.

    Attributes:
        words: Name of the quantity.
        unit: Unit of both.
        axes: Name, then times and values of the flight, then those of the setpoint, for each axis.
    """

    words: str
    unit: str
    axes: tuple[tuple[str, tuple[Array, Array], tuple[Array, Array]], ...]


@dataclass(frozen=True, slots=True)
class AutopilotView(ShortRepr):
    """Content of a page on the autopilot.

    Attributes:
        autopilot: Records of the autopilot; None: none.
        end_s: End of the record, s.
        followed: Setpoints with the measured quantities.
        vibration: Spectrogram; None: too few samples.
        rotors: Times, s, and frequency of each rotor, Hz.
    """

    autopilot: Autopilot | None
    end_s: float
    followed: tuple[Followed, ...]
    vibration: Spectrogram | None
    rotors: tuple[tuple[Array, Array], ...]


def autopilot_view(flight: AnyFlight) -> AutopilotView:
    """The autopilot of a flight, as content of a page.

    Args:
        flight: Flight in memory, or in its file.
    """
    followed = [_followed(flight, *each) for each in _FOLLOWED]
    names = [c for c in motor_columns("rotor", 12) if flight.has(c)]
    rotors = []
    for name in names:
        t, speed = flight.signal([name])
        rotors.append(thinned(t, speed[:, 0] / (2.0 * np.pi), _HELD // 4))
    return AutopilotView(
        flight.autopilot,
        float(flight.time_s[-1]) if len(flight.time_s) else 0.0,
        tuple(f for f in followed if f is not None),
        spectrogram(flight),
        tuple(rotors),
    )


def _followed(
    flight: AnyFlight, columns: tuple[str, ...], words: str, unit: str, names: Sequence[str]
) -> Followed | None:
    """Setpoint and flight of one quantity; None where either is missing."""
    setpoint = None if flight.autopilot is None else flight.autopilot.setpoint(columns)
    if setpoint is None or not flight.has(*columns):
        return None
    t, flown = flight.signal(columns)
    wanted = setpoint.values
    if columns == QUAT:
        flown = np.unwrap(to_euler(flown.T).T, axis=0)
        near = interpolated(setpoint.t_s, t, flown)
        wanted = near + _wrapped(to_euler(wanted.T).T - near)
        flown, wanted = np.degrees(flown), np.degrees(wanted)
    axes = []
    for k, name in enumerate(names):
        if not np.isfinite(wanted[:, k]).any():
            continue
        slow = slow_part(t, flown[:, k]) if columns == GYRO else flown[:, k]
        pair = thinned(t, slow, _HELD), thinned(setpoint.t_s, wanted[:, k], _HELD)
        axes.append((name, *pair))
    return Followed(words, unit, tuple(axes)) if axes else None


def _wrapped(angle: Array) -> Array:
    """Angle wrapped to half a turn in either direction."""
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)


def autopilot_content(
    name: str, view: AutopilotView, phases: Spans, budget: Budget, share: float = 1.0
) -> dict[str, Any]:
    """Values of the template `autopilot.html.j2` for a flight.

    Args:
        name: Prefix of the identifiers, and group of the time axes.
        view: Content for the flight.
        phases: Phases drawn as coloured background.
        budget: Budget of the page.
        share: Share of the page's rows for this flight.
    """
    said = view.autopilot or Autopilot()
    words: Strip | None = strip(name, view.autopilot, view.end_s)
    return {
        "strip": words,
        "followed": [_followed_plot(name, f, phases, budget) for f in view.followed],
        "spectrogram": None
        if view.vibration is None
        else _vibration_plot(name, view, phases, budget),
        "spectrogram_note": _vibration_note(view),
        "modes": said.mode_stretches(view.end_s)[:MOST_MESSAGES],
        "armed": said.armed[:MOST_MESSAGES],
        "failsafes": said.failsafes[:MOST_MESSAGES],
        "messages": _first(said.messages, round(share * MOST_MESSAGES)),
        "messages_count": len(said.messages),
        "parameters": _listed(said.parameters, round(share * MOST_PARAMETERS)),
        "parameters_count": len(said.parameters),
    }


def _first(messages: Sequence[Message], most: int) -> list[Message]:
    """Severe messages, then others, up to a number, in order of time."""
    order = sorted(messages, key=lambda m: not m.grave)[:most]
    return sorted(order, key=lambda m: m.t_s)


def _listed(parameters: Sequence[Parameter], most: int) -> list[tuple[str, str, str]]:
    """Name, value and default as printed."""
    return [(p.name, f"{p.value:.7g}", f"{p.default:.7g}") for p in parameters[:most]]


def _followed_plot(name: str, shown: Followed, phases: Spans, budget: Budget) -> Plot:
    panels = Panels((_ROW_PX,) * len(shown.axes), name)
    times = []
    for axis, flown, setpoint in shown.axes:
        number = panels.add(f"{axis}, {shown.unit}")
        for (t, values), label, colour, dash in (
            (flown, FLOWN, BLACK, "solid"),
            (setpoint, SETPOINT, BLUE, "dash"),
        ):
            line = {"color": colour, "width": 1.5, "dash": dash}
            panels.line(number, *thinned(t, values, budget.columns), label, line)
        times.append(flown[0])
    panels.look(min(float(t[0]) for t in times), max(float(t[-1]) for t in times), phases)
    label = f"{shown.words}: setpoint and flight over time"
    return plot(f"{name}-setpoint-{shown.words}", label, panels.figure)


def _vibration_plot(name: str, view: AutopilotView, phases: Spans, budget: Budget) -> Plot:
    """Power over time and frequency; with rotors and filters as lines."""
    assert view.vibration is not None
    shown = view.vibration
    panels = Panels((_SPECTROGRAM_PX,), name)
    axes = panels.add("frequency, Hz", y={"range": [0, shown.top_hz]})
    panels.layout["meta"]["spectrogram"] = shown.content(budget.cells)
    ends = np.array([shown.start_s, shown.end_s])
    for i, (t, hz) in enumerate(view.rotors):
        if np.nanmin(hz, initial=np.inf) < shown.top_hz:
            _line(panels, axes, (t, hz), f"rotor {i + 1}", {"color": ORANGE, "width": 1.2})
    for each in view.autopilot.filters if view.autopilot else ():
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


def _vibration_note(view: AutopilotView) -> str:
    """Explanation of the spectrogram, and of data outside of it."""
    shown = view.vibration
    if shown is None:
        return ""
    content: Figure = shown.content()
    unit = "(rad/s)²/Hz" if shown.sensor == "gyro" else "(m/s²)²/Hz"
    text = (
        "Power of the three axes together: from the colour of the page, "
        f"{content['low']:.0f} dB, to the strongest, {content['high']:.0f} dB over 1 {unit}; "
        f"samples at {shown.rate_hz:.0f} Hz show up to {shown.top_hz:.0f} Hz."
    )
    speeds = [hz[np.isfinite(hz) & (hz > 0.0)] for _, hz in view.rotors]
    middle = [float(np.median(hz)) for hz in speeds if len(hz)]
    if middle and max(middle) > shown.top_hz:
        turn = f"{min(middle):.0f} to {max(middle):.0f} Hz"
        text += f" Rotors turn at {turn} (medians); what lies above the upper edge is folded down."
    filters = view.autopilot.filters if view.autopilot else ()
    beyond = [f for f in filters if f.sensor == shown.sensor and f.frequency_hz >= shown.top_hz]
    if beyond:
        listed = ", ".join(f"{f.kind} {f.frequency_hz:g} Hz ({f.source})" for f in beyond)
        text += f" Filters above that: {listed}."
    return text
