"""What a live flight asks whoever keeps evidence: what is wrong, since when, how probable it is.

`twin.explain.running.RunningEvidence` is meant; a flight without evidence raises no alarms.
"""

from typing import Any, Protocol

import pandas as pd

from twin.explain.running.alarms import Alarm, Verdict


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
