"""Betaflight Blackbox logs: the head changed line by line, frames taken out or doubled, and the
numbers of a flight changed and written again as the firmware would."""

import random
import re
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from log_rigs.blackbox_rig import Part, blackbox, flown_main, mode_event
from numpy.typing import NDArray
from sample_logs import SAMPLES, flown_table

from twin.logs.betaflight.frames import read_frames
from twin.logs.betaflight.header import flights, read_header

from ..engine import Seen, Step
from ..flights import apply_bytes, draw_bytes, read, recorded

_VALUES = ("0", "-1", "nan", "1e999", "4294967295", "99999999999999999999", "x", "", "0x7fc00000")
_SENSED = ("gyroADC[0]", "gyroADC[1]", "gyroADC[2]", "accSmooth[0]", "accSmooth[2]")
_HEAD_END = 4000
_FREEZES_US = 5e6
"""In less a signal that stands still for two thirds of the rest need not be told."""


@lru_cache(12)
def _main(blob: bytes) -> dict[str, NDArray[np.int64]]:
    """Main frames of a sound log by field, as far as this one is."""
    try:
        header = read_header(blob)
        recording = read_frames(header, blob[header.size :])
    except ValueError:
        return {}
    main = recording.main
    columns = dict(zip(main.names, main.values.T, strict=True))
    columns.pop("loopIteration", None)
    return {**columns, "time": main.t_us}


class Blackbox:
    """The kind."""

    file = "LOG00001.BFL"
    visible = frozenset({"stamp_add", "freeze", "absurd", "cut", "take_frames", "double_frames"})

    def bases(self) -> dict[str, bytes]:
        """Written ones: at rest, flown with all kinds of frames, and two flights."""
        table = flown_table()
        main = flown_main(table[:900])
        part = Part(
            main,
            slow=[(1, (1, 0, 0, 1, 1)), (500, (3, 0, 1, 0, 1))],
            events=[(500, mode_event(3, 1))],
            gps=[
                (
                    k,
                    (473_977_420, 85_455_940) if k == 0 else None,
                    (50, 12, k, k, 4300, 0, 0, 9, 9, 9),
                )
                for k in range(0, 900, 90)
            ],
        )
        sparse = Part(flown_main(table[:600]), {"P interval": "1/4"}, ended=False)
        return {
            "rest": SAMPLES["Betaflight Blackbox log"](),
            "flown": blackbox(part),
            "two": blackbox(sparse, part),
            **recorded("**/*.bbl", "**/*.BFL", "**/*.bfl"),
        }

    def draw(self, rng: random.Random, blob: bytes) -> Step:
        """Half of them know the format."""
        known = _main(blob) if len(flights(blob)) == 1 else {}
        if rng.random() < 0.4 or len(blob) < 100:
            return draw_bytes(rng, blob)
        name = rng.choice(("head", "head", "list", "marker", "take_frames", "double_frames"))
        if all(f in known for f in (*_SENSED, "motor[0]")) and rng.random() < 0.6:
            long = float(np.ptp(known["time"])) > _FREEZES_US
            name = rng.choice(("stamp_add", "absurd", "any_field", *(("freeze",) * long)))
        given: dict[str, Any] = {"from": rng.uniform(0.2, 0.5)}
        match name:
            case "head":
                given |= {"line": rng.randrange(60), "to": rng.choice(_VALUES)}
            case "list":
                given |= {"line": rng.randrange(16), "item": rng.randrange(40)}
                given["to"] = rng.choice((*_VALUES, *map(str, range(12))))
            case "marker":
                given["to"] = rng.choice("IPSGHE\0\xff")
            case "take_frames" | "double_frames":
                given["frames"] = rng.randrange(70, 300)
            case "stamp_add":
                given["by"] = rng.choice((-500_000, 5_000_000, 3_600_000_000))
            case "absurd":
                given |= {"field": rng.choice(_SENSED), "to": rng.choice((-32768, 32767, 2**30))}
            case "any_field":
                given["field"] = rng.choice(sorted(known))
                given["to"] = rng.choice((0, -1, 32767, 2**31 - 1, -(2**31)))
        return name, given

    def apply(self, blob: bytes, step: Step) -> bytes:
        """As drawn; what an earlier change took away is left."""
        name, given = step
        if "from" not in given:
            return apply_bytes(blob, step)
        if name in ("head", "list"):
            return _in_the_head(blob, name, given)
        if name in ("marker", "take_frames", "double_frames"):
            return _in_the_frames(blob, name, given)
        main = {n: v.copy() for n, v in _main(blob).items()}
        if not main or any(f not in main for f in (*_SENSED, given.get("field", "time"))):
            return blob
        first, n = int(given["from"] * len(main["time"])), len(main["time"])
        match name:
            case "stamp_add":
                main["time"][first:] += given["by"]
            case "freeze":
                for field in _SENSED:
                    main[field][first : first + n * 2 // 3] = main[field][first]
            case _:
                main[given["field"]][first:] = given["to"]
        settings = {k: v for k, v in read_header(blob).settings.items() if "Field" not in k}
        settings = {k: v for k, v in settings.items() if k not in ("Product", "Data version")}
        try:
            return blackbox(Part(main, settings))
        except (ValueError, KeyError, ZeroDivisionError):
            return blob  # nothing that the firmware could write

    def read(self, path: Path) -> Seen:
        """As a flight."""
        return read(path)


def _in_the_head(blob: bytes, name: str, given: dict[str, Any]) -> bytes:
    """A value of a line, or one of a list of them, replaced."""
    lines = [m for m in re.finditer(rb"H ([^:\n]+):([^\n]*)\n", blob[:_HEAD_END])]
    if name == "list":
        lines = [m for m in lines if m[1].startswith(b"Field")]
    if not lines:
        return blob
    line = lines[given["line"] % len(lines)]
    value: bytes = given["to"].encode()
    if name == "list":
        items = line[2].split(b",")
        items[given["item"] % len(items)] = value
        value = b",".join(items)
    return blob[: line.start(2)] + value + blob[line.end(2) :]


def _in_the_frames(blob: bytes, name: str, given: dict[str, Any]) -> bytes:
    """A byte made the begin of a frame; bytes of as many frames taken out or doubled."""
    begin = read_header(blob).size
    at = begin + int(given["from"] * (len(blob) - begin))
    if name == "marker":
        letter: bytes = given["to"].encode("latin-1")
        return blob[:at] + letter + blob[at + 1 :]
    size = given["frames"] * 20
    rest = blob[at : at + size]
    return blob[:at] + (rest + rest if name == "double_frames" else b"") + blob[at + size :]


KIND = Blackbox()
