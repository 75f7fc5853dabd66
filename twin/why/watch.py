"""Live version of `why`: the last minute of a flight, evaluated each second, and its new events.

The finders are those for a log: the body's competition at the onsets of the last seconds,
instruments and vibration over the window. An event is an alarm when successive evaluations name it
with high probability, when the time after its onset equals that used in a log, or immediately on a
loss of control. Until it is settled its name may change; from then on the body is evaluated from
the event on, as in a log.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from msgspec import Struct, structs
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from ..errors import LogError
from ..logs.airframe import Airframe
from ..residuals.stream import LastRows, Rows
from ..vehicle import Vehicle
from .body import AFTER_LOSS_S, CURVES, Body
from .causes import BLOW, FINAL
from .competition import AFTER_S, APART_S, BEFORE_S, Competition
from .diagnose import in_order
from .flight import Airborne, FlightFrame, layout_of, misfit
from .motion import LEAST_S, event_of
from .records import Event
from .sensors import LANDING_S, OF_ESTIMATE, part_events
from .vibration import vibration

PERIOD_S = 1.0
"""Time between two evaluations, s."""
WINDOW_S = BEFORE_S + AFTER_S + 4.0
"""Length of flight in memory: data for weighing an onset, and some evaluations."""
RECENT_S = AFTER_S + 3.0
"""Time before the present in which onsets are considered."""
SCREENED_S = 30.0
"""Length of flight for the screening of onsets: those near their level are evaluated again."""
CURVE_S = 20.0
"""Time after which the likely curves of thrust are chosen again."""
Find = Callable[[FlightFrame, Airborne], Sequence[Event]]
"""Function for events of the present part of a flight."""
FINDERS: tuple[tuple[Find, float], ...] = (
    (lambda flown, part: part_events(flown, part)[1], 2.0),
    (lambda flown, _: vibration(flown).events, 10.0),
)
"""Finders of instruments and vibration, and the time between two of their evaluations, s."""
CLEAR, LEAST_AGREEING = 0.9, 2
"""Probability, and successive evaluations, from which a name is reported before it is settled."""
NEAR_S = 1.0
"""Largest distance of onsets of one event in two evaluations."""
IDLE_S = 5.0
"""Time after the last moment in the air from which the search stops."""
CLIMBS_M, TURNS_RAD_S, AGO_S = 0.4, 0.03, 2.0
"""Change of height, and mean body rate, that show that an aircraft is in the air; their time
span."""
PASSING = (BLOW, *OF_ESTIMATE, "mag_disturbance", "baro_disturbance")
"""Causes that have ended by the time they are settled."""
FIT_S = 20.0
"""Time in the air after which the rotors of a vehicle file are checked."""


GROUNDED = "On the ground nothing is looked for: alarms begin after take-off."
"""Text until height and attitude change, and after a landing."""


class Alarm(Struct, frozen=True, kw_only=True):
    """An event that is reported during flight.

    Attributes:
        event: Event with cause, rotor or sensor, onset, size and probability.
        raised_s: Time of the alarm, on the clock of the flight.
        known_s: Earliest possible time of the alarm: at the first of the successive evaluations
            that found it.
        closed_s: Time at which it ended, or was withdrawn; null: still active.
    """

    event: Event
    raised_s: float
    known_s: float
    closed_s: float | None = None


@dataclass(slots=True)
class Case:
    """State of one event over successive evaluations.

    Attributes:
        event: Event in the last evaluation.
        agreeing: Successive evaluations under this name; 0: no longer found.
        since_s: Time of the first of them.
        missed: Successive evaluations that did not find it.
        alarm: Alarm that was reported for it.
        settled: Whether its name is final.
        seen_s: Time of the last evaluation that found it.
    """

    event: Event | None = None
    agreeing: int = 0
    since_s: float = -np.inf
    missed: int = 0
    alarm: Alarm | None = None
    settled: bool = False
    seen_s: float = -np.inf

    def see(self, event: Event | None, now_s: float) -> None:
        """Take the result of an evaluation."""
        if event is None:
            self.agreeing, self.missed = 0, self.missed + 1
            return
        self.missed = 0
        if not (self.agreeing and self.event is not None and _same(event, self.event)):
            self.agreeing, self.since_s = 0, now_s
        self.agreeing, self.event, self.seen_s = self.agreeing + 1, event, now_s

    def news(self, now_s: float, settles_s: float, at_once: bool = False) -> Iterator[Alarm]:
        """New or changed alarms of this event.

        Args:
            now_s: Time of the evaluation.
            settles_s: Time after its onset at which it is settled.
            at_once: Whether one evaluation is enough.
        """
        event, old = self.event, self.alarm
        if event is None or self.settled:
            return
        old_enough = event.onset_s is None or now_s - event.onset_s >= settles_s
        gone = self.missed >= LEAST_AGREEING and old_enough
        if old is not None and (
            not _same(event, old.event) if self.agreeing else gone
        ):  # it is another event, or none
            yield structs.replace(old, closed_s=now_s)
            self.alarm = old = None
        surely = at_once or (
            self.agreeing >= LEAST_AGREEING and (old_enough or event.probability >= CLEAR)
        )
        if old is None and self.agreeing and surely:
            self.alarm = Alarm(event=event, raised_s=now_s, known_s=self.since_s)
            yield self.alarm
        self.settled = gone or (old_enough and self.agreeing > 0 and self.alarm is not None)
        if self.settled and self.alarm is not None:
            over_s = now_s if event.cause in PASSING else None
            self.alarm = structs.replace(self.alarm, event=event, closed_s=over_s)
            yield self.alarm


def _same(a: Event, b: Event) -> bool:
    """Whether two evaluations found one event."""
    if (a.cause, a.rotor, a.sensor) != (b.cause, b.rotor, b.sensor):
        return False
    return a.onset_s is None or b.onset_s is None or abs(a.onset_s - b.onset_s) <= NEAR_S


class Watch:
    """Evaluation of `why` on a live flight.

    Attributes:
        misfit: Reason why the rotors of the vehicle file are not those of the aircraft, in which
            case no event of the body is reported; "": they are, or it is not known yet.
        rests: Reason why the search is off or partial; "": it is on.
    """

    def __init__(self, vehicle: Vehicle | None = None) -> None:
        """Set up without rows.

        Args:
            vehicle: Vehicle with positions and directions of its rotors; None: the usual frame that
                explains the flight best.
        """
        layout = None if vehicle is None else layout_of(vehicle)
        self._rows = LastRows("live", airframe=None if layout is None else Airframe(layout=layout))
        self._body = _BodyWatch()
        self._others: dict[Find, dict[str, Case]] = {find: {} for find, _ in FINDERS}
        self._evaluated_s = dict.fromkeys(self._others, -np.inf)
        self._fit_open = layout is not None
        self._took_off_s: float | None = None
        self._until_s = -np.inf
        self.misfit, self.rests = "", GROUNDED

    def push(self, rows: Rows) -> None:
        """Append rows of the flight table, NaN where a signal has no sample."""
        self._rows.append(rows)

    def evaluate(self) -> tuple[Alarm, ...]:
        """Alarms that are new, have changed, or have ended, since the last evaluation."""
        if not len(self._rows):
            return ()
        now_s = self._rows.last_s
        self._rows.forget(now_s - WINDOW_S, {})
        try:
            flown = FlightFrame.of(self._rows.flight())
        except LogError:  # too short, or no motion yet
            return ()
        part = self._part(flown, now_s)
        self.rests = GROUNDED if part is None else _rests(flown, part)
        if part is None:
            return ()
        self._judge_rotors(flown, part)
        body = () if self.misfit else tuple(self._body.evaluate(flown, part, now_s))
        if self._body.unanswered and not self.rests:
            self.rests = f"Alarms are of instruments alone: {self._body.unanswered}."
        return (*body, *self._evaluate_others(flown, part, now_s))

    def _part(self, flown: FlightFrame, now_s: float) -> Airborne | None:
        """The present part of the flight, from its take-off; None: on the ground.

        A motor that idles on the ground has a command similar to hover while nothing else was
        flown: take-off is where height and attitude change.
        """
        parts = flown.airborne
        if not parts or now_s - flown.t_s[parts[-1].end - 1] > IDLE_S:
            self._took_off_s = None
            return None
        part = parts[-1]
        begins_s = float(flown.t_s[part.start])
        if part.start > 0 and self._took_off_s is not None and begins_s > self._until_s:
            self._took_off_s = None
        self._until_s = float(flown.t_s[part.end - 1])
        if self._took_off_s is None:
            self._body = _BodyWatch()
            off = np.flatnonzero(_moves(flown, part))
            if not len(off):
                return None
            self._took_off_s = float(flown.t_s[part.start + off[0]])
        start = max(part.start, int(np.searchsorted(flown.t_s, self._took_off_s)))
        return replace(part, start=start)

    def _evaluate_others(self, flown: FlightFrame, part: Airborne, now_s: float) -> Iterator[Alarm]:
        """Alarms of instruments and vibration, each once in a flight of `WINDOW_S`."""
        for find, every_s in FINDERS:
            if now_s - self._evaluated_s[find] < every_s - PERIOD_S / 2:
                continue
            self._evaluated_s[find] = now_s
            cases = self._others[find]
            events = self._causes(find(flown, part))
            seen = {e.sensor or e.cause: e for e in events}
            for key in dict.fromkeys([*cases, *seen]):
                case = cases.setdefault(key, Case())
                case.see(seen.get(key), now_s)
                yield from case.news(now_s, AFTER_S + LANDING_S)
                if now_s - case.seen_s > WINDOW_S or (case.settled and case.alarm is None):
                    del cases[key]

    def _causes(self, events: Sequence[Event]) -> list[Event]:
        """Probable causes that the motion of the body does not explain."""
        return [
            e
            for e in in_order([*self._body.seen, *events])
            if not e.consequence and e not in self._body.seen
        ]

    def _judge_rotors(self, flown: FlightFrame, part: Airborne) -> None:
        """Check once whether the body rotates as the rotors of the vehicle file predict."""
        if self._fit_open and (part.flown - part.start) * flown.dt_s >= FIT_S:
            self._fit_open, why = False, misfit(flown)
            self.misfit = f"{why} Nothing is said of rotors." if why else ""


def _rests(flown: FlightFrame, part: Airborne) -> str:
    """Reason why a part in the air is not fully analysed."""
    if {"gyro", "acc"} - flown.grid.keys() or flown.drive is None or flown.layout is None:
        return (
            "Alarms are of instruments alone: IMU, motor commands or order of rotors are missing."
        )
    left_s = LEAST_S - (part.flown - part.start) * flown.dt_s
    if left_s > 0:
        return (
            f"Alarms of rotors, mass and gusts begin in {left_s:.0f} s: what is usual is learned."
        )
    return ""


def _moves(flown: FlightFrame, part: Airborne) -> NDArray[np.bool_]:
    """Mask of times that are certainly in the air: climbing, or higher than before and rotating."""
    rows, back = slice(part.start, part.end), flown.places(AGO_S)
    turns = np.zeros(part.end - part.start, dtype=np.bool_)
    if "gyro" in flown.grid:
        turning = np.linalg.norm(flown.grid["gyro"], axis=1)
        turns = uniform_filter1d(turning, max(back, 1))[rows] > TURNS_RAD_S
    if "pos" not in flown.grid:
        return turns
    height = flown.grid["pos"][rows, 2]
    before = height[np.maximum(np.arange(len(height)) - back, 0)]
    climbs = np.abs(height - before) > CLIMBS_M
    return np.asarray(climbs | (turns & (np.abs(height - height[0]) > CLIMBS_M)))


@dataclass(slots=True)
class _BodyWatch:
    """Events of the body, from a take-off on.

    Attributes:
        case: State of the newest event.
        said: Earlier events.
        from_s: Time from which the flight is evaluated: after the last event, s.
        over: Whether the body has changed for good, or control was lost.
        curves: Curves of thrust, the most probable first: onsets are screened with the first one.
        chosen_s: Time at which they were chosen, s.
        unanswered: Reason why the search is off, as `Body.unanswered`.
    """

    case: Case = field(default_factory=Case)
    said: list[Event] = field(default_factory=list)
    from_s: float = -np.inf
    over: bool = False
    curves: tuple[tuple[float, float], ...] = CURVES
    chosen_s: float = -np.inf
    unanswered: str = ""

    @property
    def seen(self) -> list[Event]:
        """Reported events, and the newest."""
        return self.said + ([] if self.case.event is None else [self.case.event])

    def evaluate(self, flown: FlightFrame, part: Airborne, now_s: float) -> Iterator[Alarm]:
        """New alarms."""
        missing = {"gyro", "acc"} - flown.grid.keys()
        short = (part.flown - part.start) * flown.dt_s < LEAST_S
        if self.over or missing or flown.drive is None or flown.layout is None or short:
            return
        self.case.see(self._event(flown, part, now_s), now_s)
        lost = part.lost is not None
        ended = lost and _has_tumbled(flown, part)
        yield from self.case.news(now_s, 0.0 if ended else AFTER_S, at_once=lost)
        if self.case.settled:
            self._settle(self.case)
            self.case = Case()
        self.over |= ended

    def _settle(self, case: Case) -> None:
        """After an event the body has changed for good, or is evaluated from there on."""
        if case.alarm is None or case.event is None or case.event.onset_s is None:
            return
        self.said.append(case.event)
        self.from_s = case.event.onset_s + APART_S[1]
        self.over |= case.event.cause in FINAL

    def _event(self, flown: FlightFrame, part: Airborne, now_s: float) -> Event | None:
        """The strongest onset of the last seconds."""
        body = _body_of(flown, part)
        low, since = (int(np.searchsorted(body.t_s, t)) for t in (self.from_s, now_s - RECENT_S))
        if now_s - self.chosen_s > CURVE_S:
            self.curves, self.chosen_s = tuple(law.curve for law in body.laws), now_s
        body = replace(body, curves=self.curves)
        self.unanswered = body.unanswered
        if self.unanswered:
            return None
        if part.lost is not None:
            onset = Competition(body).strongest(low, len(body), since)
        else:
            late = replace(part, start=max(part.start, part.end - flown.places(SCREENED_S)))
            short = replace(_body_of(flown, late), curves=self.curves[:1])
            behind = short.start - body.start
            first = max(low - behind, 0), len(short), since - behind
            place = next(Competition(short).peaks(*first), None)
            if place is None:
                return None
            onset = Competition(body).onset_at(place + behind, low, len(body), since)
        return None if onset is None else event_of(body, onset)


def _has_tumbled(flown: FlightFrame, part: Airborne) -> bool:
    """Whether all data on a loss of control are available."""
    assert part.lost is not None
    return part.crash is not None or len(flown.t_s) - part.lost > flown.places(AFTER_LOSS_S)


def _body_of(flown: FlightFrame, part: Airborne) -> Body:
    """Body as from `Body.of`, but with a part that does not end with the window."""
    body = Body.of(flown, part)
    start = part.start if part.start == 0 else body.start
    end = part.end if part.end == len(flown.t_s) and part.lost is None else body.end
    last = end - start if part.lost is None else body.last + body.start - start
    return Body(flown, start, end, last, body.lost)
