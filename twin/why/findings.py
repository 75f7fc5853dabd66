"""What one finder says of a flight; `diagnose.py` puts them together."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from .flight import FlightFrame
from .records import Candidate, Event, NotVisible, TimelineItem


@dataclass(frozen=True, slots=True)
class Findings:
    """What one finder says of a flight.

    Attributes:
        events: At an instant, or without onset where it was there all the time.
        timeline: What happened besides.
        one_of_causes: Causes that the flight does not tell apart; else empty.
        not_visible: What the log would not have shown.
        nothing: Probability that there is nothing of what it looks for.
        notes: What was assumed, and what the log lacks.
        undecided: Whether something is probable, but nothing that has a name.
    """

    events: Sequence[Event] = ()
    timeline: Sequence[TimelineItem] = ()
    one_of_causes: Sequence[Candidate] = ()
    not_visible: Sequence[NotVisible] = ()
    nothing: float = 1.0
    notes: Sequence[str] = ()
    undecided: bool = False


Finder = Callable[[FlightFrame, Sequence[FlightFrame]], Findings]
"""Takes a flight and normal flights of the same aircraft, of which there may be none."""
