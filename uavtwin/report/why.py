"""Page of `uavtwin why`: the result, the event line, a card per event, the next steps."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.formatting import certainty, pretty_unit
from twin.logs.columns import GYRO
from twin.why.flight import FlightFrame
from twin.why.records import Event, EvidenceSeries
from twin.why.rules import parted_outputs

from ..diagnosis import (
    WhyRecord,
    WhyResult,
    cause_in_words,
    least_in_words,
    listed_alternatives,
    of_the_body,
    size_in_words,
)
from .drawing import Budget, Panels, fitted
from .page import BLACK, BLUE, GREY, ORANGE, Plot, plot, render

Array = NDArray[np.float64]
LANE_PX, ROW_PX = 150, 96
"""Height of the event line, and of a panel below it, px."""
MOST_CARDS = 12
"""Largest number of events with a card; consequences come after causes."""
LONGEST_TITLE = 20
"""Largest number of characters of a title next to a panel."""
MOST_SIGNALS = 3
"""Largest number of signals on a card."""
BEFORE_S, AFTER_S = 6.0, 4.0
"""Times before and after an event for signals that its finder does not provide."""
APART = 0.06
"""Least distance of two marks through all panels, as a share of the flight; diamonds show every
event."""
QUOTED_S = 2.0
"""Time before and after an onset within which the autopilot is quoted on its card."""
LANES = ("autopilot", "motors", "ground", "consequence", "cause")
"""Rows of the event line, from the bottom."""
_LANE_OF = {
    **dict.fromkeys(("mode", "failsafe", "message", "note"), "autopilot"),
    "actuator_limit": "motors",
    **dict.fromkeys(("takeoff", "landing", "contact"), "ground"),
    **dict.fromkeys(("loss_of_control", "crash"), "cause"),
}
_LANE_COLOURS = {
    "autopilot": GREY,
    "motors": "#b58900",
    "ground": "#2f8f5b",
    "consequence": "#8a4fbf",
    "cause": "#c23b66",
}
ROTOR_COLOURS = (BLUE, ORANGE, "#2f8f5b", "#8a4fbf", "#b58900", "#c23b66", "#3aa0a8", BLACK)
"""Colours of commands; those of further rotors repeat."""


@dataclass(frozen=True, slots=True)
class _Card:
    """Content of an event for the template."""

    title: str
    when: str
    event: Event
    size: str
    others: str
    quoted: str
    figure: Plot | None


def page_text(result: WhyResult) -> str:
    """The page of a result."""
    frame = None if result.recorded is None else FlightFrame.of(result.recorded)
    return fitted(lambda budget: _page(result.record, frame, budget))


def _page(record: WhyRecord, frame: FlightFrame | None, budget: Budget) -> str:
    events = sorted(record.events, key=lambda e: e.consequence)[:MOST_CARDS]
    causes = [e for e in record.events if not e.consequence]
    return render(
        "why.html.j2",
        {"words": cause_in_words, "least": least_in_words},
        record=record,
        hidden=list(filter(of_the_body, record.not_visible)),
        line=_line(record, frame, budget),
        cards=[_card(k, e, record, frame, budget) for k, e in enumerate(events)],
        left_out=len(record.events) - len(events),
        rule=_rule(frame),
        checks=list(dict.fromkeys(e.bench_check for e in causes if e.bench_check)),
        next_steps=list(_next_steps(record, frame)),
    )


# -- the event line -----------------------------------------------------------------------------


def _line(record: WhyRecord, frame: FlightFrame | None, budget: Budget) -> Plot | None:
    """Events and other items over the whole flight, with height, rotation and commands."""
    marks = [*_marks(record)]
    rows = [] if frame is None else [*_overview(frame)]
    if not marks and not rows:
        return None
    panels = Panels((LANE_PX,) + (ROW_PX,) * len(rows), "why")
    ticks = {"tickmode": "array", "tickvals": list(range(len(LANES))), "ticktext": list(LANES)}
    axes = panels.add("events", y={**ticks, "range": [-0.6, len(LANES) - 0.4], "nticks": 0})
    for lane, colour in _LANE_COLOURS.items():
        _lane(panels, axes, lane, colour, [m for m in marks if m[0] == lane])
    for title, curves in rows:
        axes = panels.add(title)
        for name, colour, t, values in curves:
            line = {"color": colour, "width": 1.5}
            panels.series(axes, t, values, name, line, budget.columns, band=False)
    first = min([m[1] for m in marks], default=0.0) if frame is None else float(frame.edges_s[0])
    last = max([m[1] for m in marks], default=1.0) if frame is None else float(frame.edges_s[-1])
    panels.look(first, max(last, first + 1.0), _airborne(frame))
    marked = -np.inf
    for lane, t_s, text in sorted(marks, key=lambda m: m[1]):
        if lane == "cause" and t_s - marked > APART * (last - first):
            marked = t_s
            panels.mark(t_s, text)
    return plot("why-line", "Event line of the flight", panels.figure)


def _lane(
    panels: Panels, axes: str, lane: str, colour: str, marks: Sequence[tuple[str, float, str]]
) -> None:
    if not marks:
        return
    t = np.array([m[1] for m in marks])
    panels.line(
        axes,
        t,
        np.full(len(t), float(LANES.index(lane))),
        lane,
        {"color": colour},
        mode="markers",
        marker={"color": colour, "size": 10, "symbol": "diamond"},
        text=[m[2] for m in marks],
        hovertemplate="%{text} at %{x:.2f} s<extra></extra>",
    )


def _marks(record: WhyRecord) -> Iterator[tuple[str, float, str]]:
    """Lane, time and words of everything with an instant."""
    for event in record.events:
        if event.onset_s is not None:
            lane = "consequence" if event.consequence else "cause"
            yield lane, event.onset_s, event.text or cause_in_words(event)
    for item in record.timeline:
        yield _LANE_OF[item.kind], item.t_s, item.text


def _airborne(frame: FlightFrame | None) -> list[tuple[str, float, float]]:
    if frame is None:
        return []
    t = frame.edges_s
    return [("in the air", float(t[p.start]), float(t[p.end])) for p in frame.airborne]


Curve = tuple[str, str, Array, Array]
"""Name, colour, times, values."""


def _overview(frame: FlightFrame) -> Iterator[tuple[str, list[Curve]]]:
    """Height, rotation and commands of the whole flight, as far as they are logged."""
    t = frame.t_s
    if "pos" in frame.grid:
        yield "height, m", [("height", BLACK, t, -frame.grid["pos"][:, 2])]
    if "gyro" in frame.grid:
        turning = np.linalg.norm(frame.grid["gyro"], axis=1)
        yield "turning, rad/s", [("turning", BLACK, t, turning)]
    if frame.drive is not None:
        yield _drive(frame.drive), _rotors(frame, t[0], t[-1])


def _drive(name: str) -> str:
    """Title of the commands, 0 to 1, or of the speeds of the rotors."""
    return "command, 0 to 1" if name == "command" else name.replace("_", " ")


def _rotors(frame: FlightFrame, start_s: float, end_s: float) -> list[Curve]:
    """Logged commands."""
    assert frame.drive is not None
    signal = frame.signals[frame.drive]
    near = (signal.t_s >= start_s) & (signal.t_s <= end_s)
    return [
        (f"rotor {i + 1}", ROTOR_COLOURS[i % len(ROTOR_COLOURS)], signal.t_s[near], c[near])
        for i, c in enumerate(signal.values.T)
    ]


# -- a card per event ---------------------------------------------------------------------------


def _card(
    k: int, event: Event, record: WhyRecord, frame: FlightFrame | None, budget: Budget
) -> _Card:
    when = "all the time" if event.onset_s is None else f"{event.onset_s:.2f} s"
    others = " or ".join(
        f"{cause_in_words(c)} ({certainty(c.probability)})" for c in listed_alternatives(event)
    )
    quoted = ", ".join(
        f"{i.text} at {i.t_s:.2f} s"
        for i in record.timeline
        if event.onset_s is not None
        and i.kind in ("message", "mode", "failsafe")
        and abs(i.t_s - event.onset_s) <= QUOTED_S
    )
    size, figure = size_in_words(event), _figure(k, event, frame, budget)
    return _Card(cause_in_words(event), when, event, size, others, quoted, figure)


def _figure(k: int, event: Event, frame: FlightFrame | None, budget: Budget) -> Plot | None:
    """Three signals with the evidence: those of the finder, then commands and motion."""
    over_time = event.onset_s is not None
    rows: list[tuple[str, list[Curve]]] = [_given(s) for s in event.evidence[:MOST_SIGNALS]]
    if over_time and frame is not None and event.onset_s is not None:
        start, end = event.onset_s - BEFORE_S, event.onset_s + AFTER_S
        ends = [t for s in event.evidence for t in s.t_s] or [start, end]
        rows += [*_around(frame, min(ends), max(ends))][: MOST_SIGNALS - len(rows)]
    if not rows:
        return None
    panels = Panels((ROW_PX + 20,) * len(rows), f"event{k}" if over_time else "")
    for title, curves in rows:
        axes = panels.add(title)
        for name, colour, t, values in curves:
            dash = "dash" if name == "expected" else "solid"
            line = {"color": colour, "width": 1.6, "dash": dash}
            panels.series(axes, t, values, name, line, budget.columns, band=False, below_hz=np.inf)
    if event.onset_s is not None:
        times = np.concatenate([t for _, curves in rows for _, _, t, _ in curves])
        panels.look(float(times.min()), float(times.max()), ())
        panels.mark(event.onset_s, "onset")
    label = f"Signals about: {event.text or cause_in_words(event)}"
    return plot(f"event-{k}", label, panels.figure)


def _given(series: EvidenceSeries) -> tuple[str, list[Curve]]:
    t, unit = np.array(series.t_s), pretty_unit(series.unit)
    curves: list[Curve] = [("measured", BLACK, t, np.array(series.measured))]
    if series.expected is not None:
        curves.append(("expected", BLUE, t, np.array(series.expected)))
    return next(t for t in _titles(series.name, unit) if len(t) <= LONGEST_TITLE), curves


def _titles(name: str, unit: str) -> Iterator[str]:
    """A title, and shorter ones that are still distinct between panels."""
    short = name
    yield f"{name}, {unit}"
    for word, abbreviated in (("angular acceleration", "ang. acc."), ("specific force", "force")):
        short = short.replace(word, abbreviated)
    yield f"{short}, {unit}"
    yield short
    yield f"…{short[1 - LONGEST_TITLE :]}"


def _around(frame: FlightFrame, start: float, end: float) -> Iterator[tuple[str, list[Curve]]]:
    """Commands, body rates and specific force within a span."""
    if frame.drive is not None:
        yield _drive(frame.drive), _rotors(frame, start, end)
    for name, title, columns in (
        ("gyro", "body rate, rad/s", GYRO),
        ("acc", "specific force, m/s²", ("acc_x", "acc_y", "acc_z")),
    ):
        if name in frame.grid:
            near = (frame.t_s >= start) & (frame.t_s <= end)
            each = zip(columns, (BLUE, ORANGE, BLACK), frame.grid[name][near].T, strict=True)
            yield title, [(column, colour, frame.t_s[near], v) for column, colour, v in each]


# -- words --------------------------------------------------------------------------------------


def _rule(frame: FlightFrame | None) -> str:
    """The simple rule, and its result for the flight."""
    read = None if frame is None else parted_outputs(frame)
    if read is None or read.t_s is None:
        return ""
    return (
        "Where outputs part by 150 µs, it takes the highest for the failed rotor, in most normal "
        f"flights too: here rotor {read.rotor}, at {read.t_s:.2f} s."
    )


def _next_steps(record: WhyRecord, frame: FlightFrame | None) -> Iterator[str]:
    """Steps to take after reading the page."""
    if any(e.consequence is False and e.probability >= 0.5 for e in record.events):
        yield "Do not fly again before the checks below are done."
    if record.one_of_causes:
        yield "The flight does not tell these causes apart: check each."
    if frame is not None and frame.rate_hz("command") < 40.0:
        yield (
            "Log the motor outputs faster next time: from 40 Hz on a loss of thrust is measured, "
            "not only seen (PX4: SDLOG_PROFILE bit 4, ArduPilot: LOG_BITMASK fast attitude)."
        )
    if "--reference" in " ".join(record.notes):
        yield (
            "Compare with normal flights of this aircraft, on the command line: "
            "uavtwin why LOG --reference GOOD."
        )
    if record.verdict == "cannot_tell" and record.loss_of_control_s is None:
        yield "Log the motor commands, from 40 Hz on: what is not judged is not known to be sound."
    elif record.verdict == "cannot_tell":
        yield "Ask the pilot what was seen, and look at the wreck: the log does not decide."
