"""Diagnosis from the findings of all finders: the first event is the cause."""

from collections.abc import Iterator, Sequence
from math import prod

import numpy as np
from msgspec.structs import replace

from ..errors import LogError
from ..formatting import certainty, joined
from ..logs import Flight
from ..vehicle import Vehicle
from .causes import AIR, CAUSES, CUT
from .cut import cut
from .findings import Finder, Findings
from .flight import FlightFrame, of_vehicle
from .motion import moved
from .records import Candidate, Diagnosis, Event, NotVisible, TimelineItem, Verdict
from .sensors import sensors
from .steady import lasting, steady
from .timeline import timeline
from .vibration import vibration

NAMED = 0.5
"""Probability from which an event is reported: below it another cause, or none, is more
probable."""
CONSEQUENCE_S = 15.0
"""Time for which a push or the loss of a rotor disturbs sensors and estimator."""
BEFORE_S = 0.5
"""Lead of an onset that a finder of sensors may report too early."""


BIASED, TOGETHER_S = ("accel_bias", "accel_scale"), 1.0
"""Causes with which specific force and change of velocity disagree; a force across the thrust
within that time of them is spurious."""


def control(flight: FlightFrame, references: Sequence[FlightFrame] = ()) -> Findings:
    """Finding on a loss of control, and the impact after it."""
    items = []
    for part in flight.airborne:
        if part.lost is not None:
            items.append(_item(flight, part.lost, "loss_of_control", "control is lost"))
        if part.crash is not None:
            items.append(_item(flight, part.crash, "crash", "hits something"))
    return Findings(timeline=items)


def _item(flight: FlightFrame, place: int, kind: str, text: str) -> TimelineItem:
    return TimelineItem(kind=kind, t_s=float(flight.t_s[place]), text=text)  # type: ignore[arg-type]


FINDERS: tuple[Finder, ...] = (control, cut, moved, sensors, timeline, steady, vibration)
"""All finders; their order does not matter."""


def diagnose(
    flight: Flight,
    references: Sequence[Flight] = (),
    finders: Sequence[Finder] = FINDERS,
    since: Vehicle | None = None,
) -> Diagnosis:
    """Why a flight went wrong.

    Args:
        flight: Flight from any log.
        references: Normal flights of the same aircraft.
        finders: Finders to run.
        since: Vehicle file of an earlier time, whose calibration is the reference instead of normal
            flights; None: there is none.

    Raises:
        LogError: A log is too short, or has no motion, or a normal flight is of another aircraft.
    """
    compared = None
    if since is not None:
        from .since import SinceCalibration  # imports `explain`, half a second

        compared, flight = SinceCalibration(since), of_vehicle(flight, since)
        finders = [lasting if find is steady else find for find in finders]
    frame = FlightFrame.of(flight)
    normal = [FlightFrame.of(r) for r in references]
    for each in normal:
        check_same_aircraft(frame, each)
    found = [find(frame, normal) for find in finders]
    if compared is not None:
        sudden = [e.onset_s for f in found for e in f.events if e.onset_s is not None]
        found.append(compared.changed(frame, min(sudden, default=np.inf)))
    events = in_order([e for f in found for e in f.events])
    if compared is not None:
        events = compared.sized(events)
    timeline = sorted((i for f in found for i in f.timeline), key=lambda i: i.t_s)
    one_of = next((tuple(f.one_of_causes) for f in found if f.one_of_causes), ())
    nothing = prod(f.nothing for f in found)
    lost = next((i.t_s for i in timeline if i.kind == "loss_of_control"), None)
    crash = next((i.t_s for i in timeline if i.kind == "crash"), None)
    airborne_s = sum(p.end - p.start for p in frame.airborne) * frame.dt_s
    hidden, partly = _apart(events, [v for f in found for v in f.not_visible])
    never = tuple(_never_visible(hidden))
    verdict, probability = _verdict(
        events,
        one_of,
        nothing,
        lost=lost is not None,
        decided=airborne_s > 0 and not never and not any(f.undecided for f in found),
    )
    return Diagnosis(
        flight=flight.name,
        verdict=verdict,
        probability=probability,
        text=_sentence(verdict, probability, events, one_of, lost, airborne_s, hidden),
        events=events,
        one_of_causes=one_of,
        loss_of_control_s=lost,
        crash_s=crash,
        timeline=tuple(timeline),
        not_visible=hidden,
        airborne_s=airborne_s,
        notes=tuple(dict.fromkeys([*frame.notes, *(n for f in found for n in f.notes), *partly])),
    )


def check_same_aircraft(frame: FlightFrame, normal: FlightFrame) -> None:
    """Refuse a normal flight of another aircraft; facts in only one of both logs are not compared.

    Raises:
        LogError: Autopilot, frame or number of rotors differ.
    """
    own, other = aircraft_stated(frame), aircraft_stated(normal)
    differ = [what for what in own if what in other and own[what] != other[what]]
    if differ:
        raise LogError(
            f"{normal.flight.name}: unusable reference of {frame.flight.name}, another aircraft: "
            + "; ".join(f"{what} {other[what]} instead of {own[what]}" for what in differ)
            + ". Give normal flights of the same aircraft, or none."
        )


def aircraft_stated(frame: FlightFrame) -> dict[str, str]:
    """Facts of the aircraft in a log, by name; without the release of the firmware."""
    facts = frame.flight.facts
    named = ("aircraft", "airframe", "hardware")
    stated = {what: str(facts[what]) for what in named if facts.get(what)}
    if facts.get("firmware"):
        stated["autopilot"] = str(facts["firmware"]).split()[0]
    if frame.drive is not None:
        stated["number of rotors"] = str(frame.grid[frame.drive].shape[1])
    return stated


def _apart(
    events: Sequence[Event], hidden: Sequence[NotVisible]
) -> tuple[tuple[NotVisible, ...], list[str]]:
    """Changes that the log would not have shown, without causes that it shows at some size; these
    become notes."""
    shown = {e.cause for e in events}
    partly = [v for v in hidden if v.cause in shown and v.smallest_detectable.value is None]
    notes = [f"another {v.cause.replace('_', ' ')} would not show: {v.reason}" for v in partly]
    return tuple(v for v in hidden if v not in partly), notes


def _never_visible(hidden: Sequence[NotVisible]) -> Iterator[NotVisible]:
    """Causes that move the body and would not be visible at any size."""
    return (v for v in hidden if v.cause in CAUSES and v.smallest_detectable.value is None)


def _what_is_not_shown(never: Sequence[NotVisible]) -> str:
    """Text on causes that would not be visible, and the reason."""
    causes = [v.cause.replace("_", " ") for v in never]
    if 2 * len(causes) > len(CAUSES):
        return f"rotors, mass, forces are not judged, since {never[0].reason}"
    return f"{joined([*dict.fromkeys(causes)], 'or')} would not show, since {never[0].reason}"


def in_order(events: Sequence[Event]) -> tuple[Event, ...]:
    """Probable events by time, those without onset last; instrument events after a cause that moves
    the body are consequences, and so are body events after a cut of commands, or with a faulty
    accelerometer."""
    likely = [e for e in events if e.probability >= NAMED]
    biased = [e.onset_s for e in likely if e.cause in BIASED and e.onset_s is not None]

    def misread(event: Event) -> bool:
        """Whether only the accelerometer shows a force: velocity does not change with it."""
        if event.onset_s is None or event.cause not in AIR:
            return False
        return any(abs(event.onset_s - t) <= TOGETHER_S for t in biased)

    moved = [
        (e.cause, e.onset_s)
        for e in likely
        if e.cause in CAUSES and e.onset_s is not None and not misread(e)
    ]

    def follows(event: Event) -> bool:
        """Whether it begins with, or soon after, what moved the body or cut the commands."""
        if event.onset_s is None or event.cause == CUT:
            return False
        known = [t for cause, t in moved if event.cause not in CAUSES or cause == CUT]
        return any(-BEFORE_S <= event.onset_s - t <= CONSEQUENCE_S for t in known)

    marked = [replace(e, consequence=e.consequence or misread(e) or follows(e)) for e in likely]
    return tuple(sorted(marked, key=lambda e: float("inf") if e.onset_s is None else e.onset_s))


THIS_OR_THAT = 2
"""Largest number of causes of one change that are reported as alternatives."""


def _verdict(
    events: Sequence[Event],
    one_of: Sequence[Candidate],
    nothing: float,
    *,
    lost: bool,
    decided: bool,
) -> tuple[Verdict, float]:
    """Verdict, and its probability."""
    causes = [e.probability for e in events if not e.consequence]
    if one_of:
        return ("found" if len(one_of) == THIS_OR_THAT or causes else "cannot_tell"), 1.0 - nothing
    if causes:
        return "found", max(causes)
    if lost or not decided:
        return "cannot_tell", 1.0 - nothing
    return "nothing_found", nothing


LIKELY = 0.8
"""Probability from which the verdict is that nothing went wrong, instead of probably nothing: a
judgement."""


ALSO = 0.1
"""Probability from which the sentence names another cause, too: a judgement."""


def _sentence(
    verdict: Verdict,
    probability: float,
    events: Sequence[Event],
    one_of: Sequence[Candidate],
    lost: float | None,
    airborne_s: float,
    hidden: Sequence[NotVisible],
) -> str:
    """The sentence at the top of the result."""
    return " ".join(_clauses(verdict, probability, events, one_of, lost, airborne_s, hidden))


def _clauses(
    verdict: Verdict,
    probability: float,
    events: Sequence[Event],
    one_of: Sequence[Candidate],
    lost: float | None,
    airborne_s: float,
    hidden: Sequence[NotVisible],
) -> Iterator[str]:
    never = tuple(_never_visible(hidden))
    first = next((e for e in events if not e.consequence), None)
    if airborne_s == 0:
        yield "The log holds no flight of five seconds or more."
    elif one_of:
        names = " or ".join(f"{_named(c)} ({certainty(c.probability)})" for c in one_of)
        yield f"Most probable: {names}."
    elif first is not None:
        yield f"{first.text} ({certainty(first.probability)}){_else(first)}."
    elif never and lost is None:
        yield f"Cannot tell: {_what_is_not_shown(never)}."
        yield f"{_nothing(1.0 - probability, ' else')}."
    elif verdict == "cannot_tell" and lost is None:
        yield "Something may have changed since the normal flights; this log cannot tell what."
    elif verdict == "nothing_found":
        yield f"{_nothing(probability)}."
    if lost is not None:
        yield f"Control is lost at {lost:.2f} s" + (
            "." if verdict == "found" else ", and this log does not show why."
        )


def _nothing(probability: float, more: str = "") -> str:
    """Sentence on how sure it is that nothing, or nothing else, went wrong."""
    nothing = "Nothing" if probability >= LIKELY else "Probably nothing"
    return f"{nothing}{more} went wrong that this log can show ({certainty(probability)})"


def _else(event: Event) -> str:
    """Text on the alternative cause, if that is probable."""
    if not event.alternatives or event.alternatives[0].probability < ALSO:
        return ""
    other = event.alternatives[0]
    return f", or {_named(other)} ({certainty(other.probability)})"


def _named(candidate: Candidate) -> str:
    """A cause in a sentence."""
    rotors = candidate.rotor or ()
    which = f" of rotor{'s' * (len(rotors) > 1)} {' and '.join(map(str, rotors))}" if rotors else ""
    return candidate.cause.replace("_", " ") + which
