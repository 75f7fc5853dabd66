"""Records of a diagnosis: events, lasting findings and a timeline.

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
"""Kind of an item of the timeline."""


class Severity(Struct, frozen=True, kw_only=True):
    """Size of an event, with its 90 % interval.

    Attributes:
        quantity: Quantity of the numbers: "thrust_lost", "added_mass_share", ...
        value: Posterior median.
        low: Lower end of the interval.
        high: Upper end of the interval.
        unit: Unit of the numbers, "1" for a share.
    """

    quantity: str
    value: float
    low: float
    high: float
    unit: str


class Candidate(Struct, frozen=True, kw_only=True):
    """A cause that competes with others.

    Attributes:
        cause: Name of the cause.
        rotor: Numbers of its rotors, from 1; null: of no rotor.
        probability: Probability of the cause, among all that compete.
    """

    cause: str
    rotor: tuple[int, ...] | None
    probability: float


class EvidenceSeries(Struct, frozen=True, kw_only=True):
    """A signal around an event, as drawn on a page.

    Attributes:
        name: Name of the signal.
        unit: Unit of the values.
        t_s: Times, s from the start of the log.
        measured: Measured values.
        expected: Expected values without the event, from data before it; null: not known.
    """

    name: str
    unit: str
    t_s: tuple[float, ...]
    measured: tuple[float, ...]
    expected: tuple[float, ...] | None = None


class Event(Struct, frozen=True, kw_only=True):
    """A fault, at an instant or during the whole flight.

    Attributes:
        cause: Name of the cause.
        rotor: Numbers of its rotors, from 1; null: of no rotor.
        sensor: Instrument: "gyro_x", "baro"; null: none.
        onset_s: Onset, s from the start of the log; null: it lasted throughout.
        severity: Size; null: not known.
        probability: Probability of this cause, among all that compete.
        alternatives: Other possible causes, the most probable first.
        consequence: Whether an earlier event explains it.
        text: Description of the event, a sentence.
        bench_check: Check on the bench; "": none.
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
    """An item on the time axis of the events.

    Attributes:
        kind: Kind of the item.
        t_s: Time, s from the start of the log.
        end_s: End, s from the start of the log; null: it is an instant.
        text: Description of the item.
    """

    kind: Kind
    t_s: float
    end_s: float | None = None
    text: str


class Amount(Struct, frozen=True, kw_only=True):
    """A size.

    Attributes:
        value: Value; null: no size is known that would have been detected.
        unit: Unit of the value, "1" for a share.
    """

    value: float | None
    unit: str


class NotVisible(Struct, frozen=True, kw_only=True):
    """A cause that the log would not show below a size.

    Attributes:
        cause: Name of the cause.
        smallest_detectable: Smallest size that would have been detected; for a rotor at half of the
            instants.
        reason: Reason why smaller ones are not visible.
        share: Share of the instants at which that size is detected, for a rotor that is detected at
            less than half of them; else null.
    """

    cause: str
    smallest_detectable: Amount
    reason: str
    share: float | None = None


class Diagnosis(Struct, frozen=True, kw_only=True):
    """Diagnosis of a flight.

    Attributes:
        flight: Name of the flight.
        verdict: Whether something was found, nothing was, or the log cannot tell.
        probability: Probability of the verdict; for `cannot_tell`, that there was a fault of a kind
            that the log can show.
        text: The result as a sentence.
        events: Events in order of time, first causes first; lasting ones come last.
        one_of_causes: Causes of one change that the flight does not separate; else empty.
        loss_of_control_s: Time of the loss of control, when tilt or rates exceeded all before;
            null: none.
        crash_s: Time of the impact after that, or after a cut of commands; null: none.
        timeline: Other items, in order of time.
        not_visible: Changes that the log would not have shown.
        airborne_s: Time in the air.
        notes: Notes on assumptions and missing signals.
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
