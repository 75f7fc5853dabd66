"""The strip on top of every time axis of a flight: modes as a band, failsafes, arming, messages.

A page holds it once per flight, and page.js lays it over each figure of the flight's time axes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from markupsafe import Markup

from twin.logs.autopilot import Autopilot, Message

from ..page import embedded

HEIGHT_PX = 18
MOST_BANDS = 100
"""Modes and failsafes that are drawn, of each."""
PLACES = 90
"""Marks along a strip, at most; messages nearer to each other share one."""
_TOLD = 6
"""Messages that one mark tells."""


@dataclass(frozen=True, slots=True)
class Strip:
    """What a template needs of it.

    Attributes:
        group: Of the figures whose time axes move together.
        json: `modes` and `failsafes` as name, begin, end; `marks` as time, kind and text.
    """

    group: str
    json: Markup


def strip(group: str, told: Autopilot | None, end_s: float) -> Strip | None:
    """The strip of a flight; None where its log tells nothing of that.

    Args:
        group: Of its figures.
        told: What its autopilot says.
        end_s: End of the record, s.
    """
    if told is None or not end_s > 0.0:
        return None
    modes, failsafes = (
        [[escape(s.name), s.start_s, s.end_s] for s in several]
        for several in (told.mode_stretches(end_s), told.failsafes)
    )
    marks: list[list[object]] = []
    for each in told.armed:
        marks.append([each.start_s, "armed", "armed"])
        if each.end_s < end_s:
            marks.append([each.end_s, "disarmed", "disarmed"])
    marks = [*_messages(told.messages, end_s), *marks[: 2 * MOST_BANDS]]
    if not (modes or failsafes or marks):
        return None
    content = {"modes": modes[:MOST_BANDS], "failsafes": failsafes[:MOST_BANDS], "marks": marks}
    return Strip(group, embedded({"height": HEIGHT_PX, **content}))


def _messages(messages: Sequence[Message], end_s: float) -> list[list[object]]:
    """A mark for those that lie near each other, grave where one of them is."""
    places: dict[int, list[Message]] = {}
    for each in messages:
        if 0.0 <= each.t_s <= end_s:
            places.setdefault(int(each.t_s / end_s * PLACES), []).append(each)
    marks: list[list[object]] = []
    for several in places.values():
        graver = sorted(several, key=lambda m: not m.grave)[:_TOLD]
        lines = [
            escape(f"{m.level}: {m.text}" if m.level else m.text)
            for m in several
            if any(m is g for g in graver)
        ]
        if len(several) > _TOLD:
            lines.append(f"and {len(several) - _TOLD} more")
        t_s = next((m.t_s for m in several if m.grave), several[0].t_s)
        grave = any(m.grave for m in several)
        marks.append([t_s, "grave" if grave else "said", "<br>".join(lines)])
    return marks
