"""Other items on the time axis of the events: from the autopilot's records and from the motion.

Take-off and landing, motors at a limit, contact, a record that ends in the air, and the autopilot's
own records: arming, modes, failsafes, resets of its estimator, messages.
"""

import re
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ..formatting import number
from ..logs.autopilot import Autopilot, Message, Reset
from ..logs.samples import stretches_where
from .findings import Findings
from .flight import CONTACT_M_S2, Airborne, FlightFrame, lift
from .records import TimelineItem

UPPER_STOP, LOWER_STOP = 0.985, 0.01
"""Commands from which a motor is at its limit; rounding of a log is 1 % at most."""
STOP_S = 0.2
"""Shortest time at a limit: a controller's transient is shorter."""
JOINED_S = 0.5
"""Largest gap between two stretches that are shown as one."""
MOST_STOPS = 12
"""Largest number of items for each motor."""
MOST_MESSAGES = 60
"""Largest number on the time axis, and of resets of the estimator; `report` lists all messages."""
REPEATED_S = 10.0
"""Time within which a repeated message, reset or contact is shown once."""
MARGIN_S = 2.0
"""Time before take-off and after landing, for messages; before the end of a flight, for
touchdown."""
LAND_DETECTOR = re.compile(r"(Takeoff|Landing) detected")
"""Messages of PX4's land detector, src/modules/commander/Commander.cpp: not severe, but they show
the autopilot's ground state."""
SILENT_S = 1.0
"""Time without a sample of any signal: a gap of the logger."""
CUT_VOLTAGE = 0.75
"""Share of the flight's median voltage below which a board browns out, if its record ends there."""


def timeline(flight: FlightFrame, references: Sequence[FlightFrame] = ()) -> Findings:
    """Items of the timeline apart from the events."""
    items: list[TimelineItem] = []
    for part in flight.airborne:
        items += [*_in_the_air(flight, part), *_stops(flight, part), *_contacts(flight, part)]
    items += _gaps(flight)
    if flight.flight.autopilot is not None:
        items += _said(flight, flight.flight.autopilot)
    return Findings(timeline=sorted(items, key=lambda i: i.t_s))


# -- by the motion ------------------------------------------------------------------------------


def _in_the_air(flight: FlightFrame, part: Airborne) -> Iterator[TimelineItem]:
    """Take-off, and the end of the flight."""
    begin, end = float(flight.t_s[part.start]), float(flight.t_s[part.end - 1])
    if part.start > flight.places(SILENT_S):
        yield TimelineItem(kind="takeoff", t_s=begin, text="clear of the ground")
    else:
        yield TimelineItem(kind="note", t_s=begin, text="the record begins in the air")
    if _lands(flight, part):
        yield TimelineItem(kind="landing", t_s=end, text="near the ground again")
    elif _cut_off(flight, part) and part.crash is None:
        yield TimelineItem(kind="note", t_s=end, text=_ends_in_the_air(flight))


def _lands(flight: FlightFrame, part: Airborne) -> bool:
    """Whether it lands under control."""
    return not _cut_off(flight, part) and part.lost is None and not part.falls


def _cut_off(flight: FlightFrame, part: Airborne) -> bool:
    """Whether the record ends in the air."""
    return part.end >= len(flight.t_s) - flight.places(SILENT_S)


def _ends_in_the_air(flight: FlightFrame) -> str:
    text = "the record ends in the air: the power, or the recording, was cut"
    if "vbat" in flight.grid:
        volts = flight.grid["vbat"][:, 0]
        last, usual = float(volts[-max(flight.places(0.3), 1) :].min()), float(np.median(volts))
        if usual > 2.0 and last < CUT_VOLTAGE * usual:
            return f"{text}; the voltage falls to {number(last)} V, a brown-out"
    return text


def _stops(flight: FlightFrame, part: Airborne) -> Iterator[TimelineItem]:
    """Motors at a limit, by their logged commands."""
    if flight.drive != "command":
        return
    command = flight.signals["command"]
    start, end = flight.t_s[part.start], flight.t_s[part.flown - 1]
    inside = (command.t_s >= start) & (command.t_s <= end)
    t, c = command.t_s[inside], command.values[inside]
    for i, own in enumerate(c.T):
        for which, on in (("upper", own > UPPER_STOP), ("lower", own < LOWER_STOP)):
            for a, b in _long(t, on)[:MOST_STOPS]:
                text = f"motor {i + 1} at its {which} stop"
                yield TimelineItem(kind="actuator_limit", t_s=float(a), end_s=float(b), text=text)


def _long(t: NDArray[np.float64], on: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Stretches of time in which a condition is true for long enough, near ones joined."""
    return [(t[a], t[b]) for a, b in _joined(t, on) if t[b] - t[a] >= STOP_S]


def _joined(
    t: NDArray[np.float64], on: NDArray[np.bool_], apart_s: float = JOINED_S
) -> list[tuple[int, int]]:
    """First and last places where a condition is true; stretches within `apart_s` are joined."""
    joined: list[tuple[int, int]] = []
    for a, b in stretches_where(on):
        end = min(b, len(t) - 1)
        if joined and t[a] - t[joined[-1][1]] < apart_s:
            joined[-1] = joined[-1][0], end
        else:
            joined.append((a, end))
    return joined


def _contacts(flight: FlightFrame, part: Airborne) -> Iterator[TimelineItem]:
    """Specific forces beyond those of the rotors: contact, after which the flight continues."""
    if "acc" not in flight.grid:
        return
    rows = slice(part.start, part.flown)
    force = np.linalg.norm(flight.grid["acc"][rows], axis=1)
    if flight.drive is not None:
        raised = lift(flight.grid[flight.drive][rows]).mean(axis=1)
        force = force / np.maximum(raised / max(float(np.median(raised)), 1e-9), 1.0)
    t_s, hit = flight.t_s[rows], force > CONTACT_M_S2
    landed = t_s > (t_s[-1] - MARGIN_S if _lands(flight, part) else np.inf)
    for one, on in (("shock", hit & ~landed), ("touchdown", hit & landed)):
        for a, b in _joined(t_s, on, REPEATED_S):
            count, most = len(stretches_where(on[a : b + 1])), a + int(force[a : b + 1].argmax())
            size = f"of {number(float(force[most]))} m/s²"
            yield TimelineItem(
                kind="contact",
                t_s=float(t_s[a]),
                end_s=float(t_s[b]) if count > 1 else None,
                text=f"{one} {size}"
                if count == 1
                else f"{count} {one}s, the hardest {size} at {t_s[most]:.2f} s",
            )


def _gaps(flight: FlightFrame) -> Iterator[TimelineItem]:
    """Times without a sample of any signal."""
    t = flight.flight.time_s
    for k in np.flatnonzero(np.diff(t) > SILENT_S):
        text = f"nothing is logged for {number(float(t[k + 1] - t[k]))} s"
        yield TimelineItem(kind="note", t_s=float(t[k]), end_s=float(t[k + 1]), text=text)


# -- by the autopilot's word --------------------------------------------------------------------


def _said(flight: FlightFrame, autopilot: Autopilot) -> Iterator[TimelineItem]:
    """Modes, failsafes, resets of the estimator, arming and messages."""
    for mode in autopilot.modes:
        yield TimelineItem(kind="mode", t_s=mode.start_s, text=f"mode {mode.name}")
    for failsafe in autopilot.failsafes:
        times = {"t_s": failsafe.start_s, "end_s": failsafe.end_s}
        yield TimelineItem(kind="failsafe", **times, text=failsafe.name)
    yield from _resets(autopilot.resets)
    yield from _arming(flight, autopilot)
    yield from _messages(flight, autopilot.messages)


def _resets(resets: Sequence[Reset]) -> list[TimelineItem]:
    """Resets of the estimator; successive ones of one kind are one item."""
    rows: list[list[Reset]] = []
    for reset in sorted(resets, key=lambda r: (r.of, r.t_s)):
        last = rows[-1][-1] if rows else reset
        if not rows or reset.of != last.of or reset.t_s - last.t_s >= REPEATED_S:
            rows.append([])
        rows[-1].append(reset)
    shown = sorted(rows, key=lambda row: row[0].t_s)[:MOST_MESSAGES]
    return [
        TimelineItem(
            kind="note",
            t_s=row[0].t_s,
            end_s=row[-1].t_s if len(row) > 1 else None,
            text=f"the estimator resets its {row[0].of}"
            + (f" {len(row)} times" if len(row) > 1 else ""),
        )
        for row in shown
    ]


def _arming(flight: FlightFrame, autopilot: Autopilot) -> Iterator[TimelineItem]:
    last = float(flight.t_s[-1])
    for stretch in autopilot.armed:
        if stretch.start_s > 0:
            yield TimelineItem(kind="note", t_s=stretch.start_s, text="motors are armed")
        if stretch.end_s < last - SILENT_S:
            flies = any(
                flight.t_s[p.start] < stretch.end_s < flight.t_s[p.end - 1] - SILENT_S
                for p in flight.airborne
            )
            text = "motors are disarmed" + (" in the air" if flies else "")
            yield TimelineItem(kind="note", t_s=stretch.end_s, text=text)


def _messages(flight: FlightFrame, messages: Sequence[Message]) -> Iterator[TimelineItem]:
    """Severe messages, those without a level, take-off and landing, during the flight; repetitions
    are limited."""
    spans = [(flight.t_s[p.start], flight.t_s[p.end - 1]) for p in flight.airborne]
    shown: dict[str, float] = {}
    for message in messages:
        near = any(a - MARGIN_S <= message.t_s <= b + MARGIN_S for a, b in spans)
        repeated = message.t_s - shown.get(message.text, -np.inf) < REPEATED_S
        worth = message.grave or not message.level or LAND_DETECTOR.search(message.text)
        if near and worth and not repeated:
            shown[message.text] = message.t_s
            yield TimelineItem(kind="message", t_s=message.t_s, text=f'"{message.text}"')
            if len(shown) == MOST_MESSAGES:
                return
