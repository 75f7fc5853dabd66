"""Which firmware wrote a log, on which board, of which frame."""

import re
from dataclasses import dataclass

from .file.history import FRAMES
from .log import ArduPilotLog

OTHERS = re.compile(r"(?:Ardu|APM:)(Plane|Rover|Sub)|AntennaTracker|Blimp")
"""Firmware that flies no multirotor, but for quadplanes."""
_FIRMWARE = re.compile(r"Ardu|APM:|AntennaTracker|Blimp")
_FRAME = re.compile(r"Frame: (\w+)")


@dataclass(frozen=True, slots=True)
class Frame:
    """The frame that a log names.

    Attributes:
        kind: FRAME_CLASS, 0 where the log has none.
        form: FRAME_TYPE.
        source: Where it is named.
    """

    kind: int
    form: int
    source: str


def frame_of(log: ArduPilotLog) -> Frame:
    """FRAME_CLASS and FRAME_TYPE, of quadplanes with `Q_`; up to Copter 3.4 the frame of which the
    firmware is (message `Frame: QUAD`) and FRAME."""
    for stem in ("", "Q_"):
        if f"{stem}FRAME_CLASS" in log.params:
            kind, form = (log.params.get(f"{stem}FRAME_{k}", 1.0) for k in ("CLASS", "TYPE"))
            return Frame(int(kind), int(form), f"{stem}FRAME_CLASS and {stem}FRAME_TYPE of the log")
    form = int(log.params.get("FRAME_TYPE", log.params.get("FRAME", 1.0)))
    for text in log.texts("MSG", "Message"):
        if (found := _FRAME.match(text)) and found[1] in FRAMES:
            return Frame(
                FRAMES[found[1]], form, f"FRAME {form} and the message '{text}' of the log"
            )
    return Frame(0, form, "")


def firmware(log: ArduPilotLog) -> str:
    """What the log says of its firmware, "" where it says nothing."""
    texts = log.texts("VER", "FWS") + log.texts("MSG", "Message")
    return next((t for t in texts if _FIRMWARE.match(t) and re.search(r"[Vv]\d|solo-", t)), "")


def board(log: ArduPilotLog) -> str:
    """The message of a board and its serial number: a name, three words of eight hex digits."""
    for told in log.texts("MSG", "Message"):
        words = told.split()
        if len(words) == 4 and all(len(w) == 8 and _is_hex(w) for w in words[1:]):
            return told
    return ""


def _is_hex(word: str) -> bool:
    return all(c in "0123456789ABCDEFabcdef" for c in word)
