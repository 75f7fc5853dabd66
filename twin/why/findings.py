"""Findings of one finder on a flight; `diagnose.py` combines them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from .flight import FlightFrame
from .records import Candidate, Event, NotVisible, TimelineItem


@dataclass(frozen=True, slots=True)
class Findings:
    """Findings of one finder on a flight.

    Attributes:
        events: Events at an instant, or without onset where the state lasted throughout.
        timeline: Other items of the flight.
        one_of_causes: Causes that the flight does not separate; else empty.
        not_visible: Changes that the log would not have shown.
        nothing: Probability that there is no event of this finder's kind.
        notes: Notes on assumptions and missing signals.
        undecided: Whether an event is probable, but none of its causes can be named.
    """

    events: Sequence[Event] = ()
    timeline: Sequence[TimelineItem] = ()
    one_of_causes: Sequence[Candidate] = ()
    not_visible: Sequence[NotVisible] = ()
    nothing: float = 1.0
    notes: Sequence[str] = ()
    undecided: bool = False


Finder = Callable[[FlightFrame, Sequence[FlightFrame]], Findings]
"""Function of a flight and of normal flights of the same aircraft, of which there may be none."""
