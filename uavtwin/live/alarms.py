"""What a live flight asks whoever keeps evidence: what is wrong, since when, how probable it is.

`twin.explain.running.RunningEvidence` is meant; a flight without evidence raises no alarms.
"""

from collections.abc import Sequence
from typing import Any, Protocol

import pandas as pd


class Alarm(Protocol):
    """Something that has begun in flight."""

    @property
    def effect(self) -> str:
        """Identifier of the effect library."""
        ...

    @property
    def since_s(self) -> float:
        """When it began, s of the flight."""
        ...

    @property
    def raised_s(self) -> float:
        """When it was told."""
        ...

    @property
    def closed_s(self) -> float | None:
        """When it ended; None: it goes on."""
        ...

    @property
    def probability(self) -> float:
        """0..1."""
        ...

    @property
    def sentence(self) -> str:
        """For a pilot."""
        ...


class Verdict(Protocol):
    """What is new."""

    @property
    def opened(self) -> Sequence[Alarm]:
        """Alarms raised since the last one."""
        ...

    @property
    def closed(self) -> Sequence[Alarm]:
        """Alarms that ended since the last one."""
        ...


class Evidence(Protocol):
    """Evidence that is kept while a flight goes on; a new flight has new evidence."""

    def update(self, rows: pd.DataFrame) -> Verdict:
        """Take new rows of the flight table, later than all before."""
        ...


def alarm_json(alarm: Alarm, section: int) -> dict[str, Any]:
    """A line of `alarms.jsonl`."""
    return {
        "section": section,
        "effect": alarm.effect,
        "since_s": alarm.since_s,
        "raised_s": alarm.raised_s,
        "closed_s": alarm.closed_s,
        "probability": alarm.probability,
        "text": alarm.sentence,
    }
