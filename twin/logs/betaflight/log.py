"""A Blackbox file opened with care: which flight of it is read, and what of it is damaged."""

import re
from dataclasses import dataclass, field
from pathlib import Path

from ...errors import LogError
from ..clock import pauses
from ..flight import Finding, Noted
from .frames import RESUME, Damage, Recording, read_frames
from .header import Header, flights, read_header

_BETAFLIGHT = re.compile(r"(?:Betaflight|EmuFlight)\s*/?\s*(\d+)\.(\d+)")
_OTHERS = re.compile(r"INAV|Rotorflight|Baseflight|Cleanflight|Indiflight", re.IGNORECASE)
_LATEST = (2025, 12)
_FEWEST = 2


@dataclass(slots=True)
class BlackboxLog(Noted):
    """One flight of a file on its clock.

    Attributes:
        path: File.
        header: Its head.
        recording: Its frames.
        start_us: Time since the start of the firmware that counts as 0, us.
        findings: Grows while the log is read.
    """

    path: Path
    header: Header
    recording: Recording
    start_us: int
    findings: list[Finding] = field(default_factory=list)

    @property
    def firmware(self) -> str:
        """Name and version, "" where the head does not tell."""
        revision = self.header.settings.get("Firmware revision", "")
        return revision or self.header.settings.get("Firmware type", "")

    @property
    def version(self) -> tuple[int, int]:
        """Of Betaflight; that of the end of 2025 where the head does not tell."""
        found = _BETAFLIGHT.search(self.firmware)
        return (int(found[1]), int(found[2])) if found else _LATEST


def open_blackbox(path: Path, blob: bytes) -> tuple[BlackboxLog, str]:
    """Parse a Blackbox file; of several flights the longest is read, by its bytes.

    Args:
        path: File name, for messages.
        blob: Content of the file.

    Returns:
        The flight, and which one it is, "" where the file has no other.

    Raises:
        LogError: Nothing in it can be used.
    """
    parts = flights(blob)
    by_size = sorted(range(len(parts)), key=lambda k: parts[k][0] - parts[k][1])
    log, why, which = None, "", 0
    for which in by_size:
        begin, end = parts[which]
        try:
            log = _flight(path, blob[begin:end])
            break
        except ValueError as error:
            why = why or str(error)
    if log is None:
        many = f"none of the {len(parts)} flights" if len(parts) > 1 else "the flight"
        raise LogError(
            f"{path.name}: {many} of this Blackbox log can be read ({why}): it was cut or damaged. "
            "Copy it again from the flash chip or the card."
        )
    _check_firmware(log)
    _note_damage(log)
    if len(parts) == 1:
        return log, ""
    log.note(
        "warning",
        "log",
        f"the file holds {len(parts)} flights; the longest is read, number {which + 1}. Cut the "
        "file before each `H Product` to read another",
        len(parts) - 1,
    )
    return log, f"{which + 1} of {len(parts)}"


def _flight(path: Path, blob: bytes) -> BlackboxLog:
    """One flight.

    Raises:
        ValueError: Nothing in it can be used.
    """
    header = read_header(blob)
    recording = read_frames(header, blob[header.size :])
    if len(recording.main.t_us) < _FEWEST:
        raise ValueError(f"{len(recording.main.t_us)} frames in {len(blob)} bytes")
    log = BlackboxLog(path, header, recording, int(recording.main.t_us.min()))
    for letter, reason in header.unusable.items():
        message = f"the definition of {letter} frames makes no sense ({reason}); they are not read"
        log.note("error", "log", message)
    if header.damaged:
        log.note("error", "log", "damaged lines in the head, not used", header.damaged)
    return log


def _check_firmware(log: BlackboxLog) -> None:
    """Refuse what writes the same format in other units and axes."""
    firmware = log.firmware
    if not _BETAFLIGHT.search(firmware) and (other := _OTHERS.search(firmware)):
        raise LogError(
            f"{log.path.name}: a Blackbox log of {other.group()} ({firmware[:60]!r}): its units "
            "and axes are not Betaflight's and not known here. Convert it to a flight table (CSV), "
            "SI, FRD and NED."
        )
    if not _BETAFLIGHT.search(firmware):
        message = f"the head does not tell the firmware ({firmware[:60]!r}): taken for Betaflight"
        log.note("warning", "log", message)


def _note_damage(log: BlackboxLog) -> None:
    """Findings on what is missing."""
    damage: Damage = log.recording.damage
    if damage.lost:
        places = "place" if damage.places == 1 else "places"
        message = f"damaged: bytes in {damage.places} {places} of which nothing can be made"
        log.note("error", "log", message, damage.lost)
    if damage.unfounded:
        message = "frames not used, the whole frame that they build on was lost"
        log.note("error", "log", message, damage.unfounded)
    if damage.rejected:
        message = "frames not used, whose time or number jumps or runs backward"
        log.note("error", "log", message, damage.rejected)
    if damage.missing:
        log.note("warning", "log", "frames missing, by their numbers", damage.missing)
    if damage.cut:
        message = "cut short: bytes at the end that are no whole frame, not used"
        log.note("error", "log", message, damage.cut)
    if not damage.ended:
        message = (
            "it does not end as Betaflight ends a log: the battery was taken off before the motors "
            "were disarmed, the chip was full, or the file was cut"
        )
        log.note("warning", "log", message)
    if damage.behind:
        message = "bytes behind the end of the log, not read"
        log.note("warning", "log", message, damage.behind)
    if found := pauses(log.recording.main.t_us - log.start_us):
        resumed = sum(e.kind == RESUME for e in log.recording.events)
        why = f"; logging was paused by a switch {resumed} times" if resumed else ""
        log.note("warning", "time", found.told + why, found.count)
