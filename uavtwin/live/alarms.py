"""What a live flight asks whoever keeps evidence: what is wrong, since when, how probable it is.

`twin.explain.running.RunningEvidence` is meant; a flight without evidence raises no alarms.
"""

from typing import Any, Protocol

from twin.effects import EFFECTS
from twin.explain.running.alarms import Alarm, Verdict
from twin.residuals.running.table import Rows

from ..report.spoken import clause


class Evidence(Protocol):
    """Evidence that is kept while a flight goes on; a new flight has new evidence."""

    def update(self, rows: Rows) -> Verdict:
        """Take new rows of the flight table, later than all before."""
        ...


def sentence(alarm: Alarm) -> str:
    """What an alarm says to people: what has changed, since when, and how sure that is."""
    name = _words(alarm.effect)
    change = {n.name: n.value for n in alarm.numbers}
    if said := clause(alarm.effect, change, since=True):
        details = [name]
    else:
        said, details = f"{name}, {EFFECTS[alarm.effect].meaning}", []
    details += [f"{alarm.probability:.0%}", *map(str, alarm.numbers)]
    text = f"since {alarm.since_s:.1f} s: {said} ({', '.join(details)})"
    if alarm.others:
        known = " or ".join(f"{_words(e)} ({p:.0%})" for e, p in alarm.others.items())
        text += f"; cannot be told from {known}"
    if alarm.closed_s is not None:
        text += f"; over since {alarm.closed_s:.1f} s"
    return text


def _words(effect: str) -> str:
    return effect.replace("_", " ")


def alarm_json(alarm: Alarm, section: int) -> dict[str, Any]:
    """A line of `alarms.jsonl`."""
    return {
        "section": section,
        "effect": alarm.effect,
        "since_s": alarm.since_s,
        "raised_s": alarm.raised_s,
        "closed_s": alarm.closed_s,
        "probability": alarm.probability,
        "text": sentence(alarm),
    }
