"""Which firmware wrote a log, on which board."""

import re

from .log import ArduPilotLog

OTHERS = re.compile(r"Ardu(Plane|Rover|Sub)|AntennaTracker|Blimp")
"""Firmware that flies no multirotor, but for quadplanes."""


def firmware(log: ArduPilotLog) -> str:
    """What the log says of its firmware, "" where it says nothing."""
    told = [t for t in log.texts("VER", "FWS") + log.texts("MSG", "Message") if "V" in t]
    named = [t for t in told if t.startswith("Ardu") or OTHERS.match(t)]
    return named[0] if named else ""


def board(log: ArduPilotLog) -> str:
    """The message of a board and its serial number: a name, three words of eight hex digits."""
    for told in log.texts("MSG", "Message"):
        words = told.split()
        if len(words) == 4 and all(len(w) == 8 and _is_hex(w) for w in words[1:]):
            return told
    return ""


def _is_hex(word: str) -> bool:
    return all(c in "0123456789ABCDEFabcdef" for c in word)
