"""What is said of a flight: events, steady findings and a timeline, as records.

The keys `verdict`, `probability`, `events`, `one_of_causes`, `loss_of_control_s`, `crash_s` and
`not_visible` are the form in which labelled flights are scored.
"""

from typing import Literal

from msgspec import Struct

Verdict = Literal["nothing_found", "found", "cannot_tell"]
Kind = Literal[
    "takeoff",
    "landing",
    "mode",
    "failsafe",
    "message",
    "contact",
    "actuator_limit",
    "loss_of_control",
    "crash",
    "note",
]
"""Of an item of the timeline."""


class Severity(Struct, frozen=True, kw_only=True):
    """How much, with its 90 % interval.

    Attributes:
        quantity: What the number is: "thrust_lost", "added_mass_share", ...
        value: Posterior median.
        low: Lower end of the interval.
        high: Upper end.
        unit: Of the numbers, "1" for a share.
    """

    quantity: str
    value: float
    low: float
    high: float
    unit: str


class Candidate(Struct, frozen=True, kw_only=True):
    """A cause that competes with others.

    Attributes:
        cause: Its name.
        rotor: Numbers of its rotors from 1; null: of no rotor.
        probability: Of it, among all that compete.
    """

    cause: str
    rotor: tuple[int, ...] | None
    probability: float


class EvidenceSeries(Struct, frozen=True, kw_only=True):
    """A signal about an event, as a page draws it.

    Attributes:
        name: What the numbers are.
        unit: Of the values.
        t_s: Times, s from the start of the log.
        measured: Values.
        expected: What they were without the event, by what came before it; null: not known.
    """

    name: str
    unit: str
    t_s: tuple[float, ...]
    measured: tuple[float, ...]
    expected: tuple[float, ...] | None = None


class Event(Struct, frozen=True, kw_only=True):
    """Something that went wrong, at an instant or during the whole flight.

    Attributes:
        cause: Its name.
        rotor: Numbers of its rotors from 1; null: of no rotor.
        sensor: Of which instrument: "gyro_x", "baro"; null: of none.
        onset_s: From the start of the log; null: it was there all the time.
        severity: How much; null: not known.
        probability: Of this cause, among all that compete.
        alternatives: What else it could be, the most probable first.
        consequence: Whether something that began earlier explains it.
        text: What happened, as a sentence.
        bench_check: What to check on the bench; "": nothing.
        evidence: Signals that show it.
    """

    cause: str
    rotor: tuple[int, ...] | None = None
    sensor: str | None = None
    onset_s: float | None = None
    severity: Severity | None = None
    probability: float
    alternatives: tuple[Candidate, ...] = ()
    consequence: bool = False
    text: str = ""
    bench_check: str = ""
    evidence: tuple[EvidenceSeries, ...] = ()


class TimelineItem(Struct, frozen=True, kw_only=True):
    """Something that happened, on the time axis of the events.

    Attributes:
        kind: Of what kind.
        t_s: When, s from the start of the log.
        end_s: Its end; null: it is an instant.
        text: What.
    """

    kind: Kind
    t_s: float
    end_s: float | None = None
    text: str


class Amount(Struct, frozen=True, kw_only=True):
    """A size.

    Attributes:
        value: Null: no size is known that would have been detected.
        unit: Of the value, "1" for a share.
    """

    value: float | None
    unit: str


class NotVisible(Struct, frozen=True, kw_only=True):
    """A cause that the log would not show below a size.

    Attributes:
        cause: Its name.
        smallest_detectable: Size that would have been found; of a rotor at half of the instants.
        reason: Why smaller ones do not show.
        share: Of the instants at which that size shows, of a rotor that shows at less than half of
            them; else null.
    """

    cause: str
    smallest_detectable: Amount
    reason: str
    share: float | None = None


class Diagnosis(Struct, frozen=True, kw_only=True):
    """Why a flight went wrong.

    Attributes:
        flight: Its name.
        verdict: Whether something was found, nothing was, or the log cannot tell.
        probability: Of the verdict; of `cannot_tell`, that something went wrong that the log can
            show.
        text: The answer as a sentence.
        events: First causes first, in order of time; what was there all the time comes last.
        one_of_causes: Causes of one change that the flight does not tell apart; else empty.
        loss_of_control_s: When tilt or rates left all that was flown; null: they did not.
        crash_s: When it hit something after that, or after a cut of commands; null: it did not.
        timeline: What happened besides, in order of time.
        not_visible: What the log would not have shown.
        airborne_s: Time in the air.
        notes: What was assumed, and what the log lacks.
    """

    flight: str
    verdict: Verdict
    probability: float
    text: str
    events: tuple[Event, ...]
    one_of_causes: tuple[Candidate, ...]
    loss_of_control_s: float | None
    crash_s: float | None
    timeline: tuple[TimelineItem, ...]
    not_visible: tuple[NotVisible, ...]
    airborne_s: float
    notes: tuple[str, ...]
