"""Logs of a Crazyflie's uSD card: stamps, values and definitions changed where they stand, with and
without a checksum that goes along."""

import random
import struct
import zlib
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from log_rigs.crazyflie_rig import flown_kinds, usd_log
from sample_logs import SAMPLES, flown_table

from ..engine import Seen, Step
from ..flights import ABSURD, apply_bytes, draw_bytes, read
from ..layout import Layout

_TIME = "#"
_TYPES = {"H": "<u2", "h": "<i2", "f": "<f4", "d": "<f8", "I": "<u4", "Q": "<u8"}
_SENSED = {
    "fixedFrequency": ("acc.x", "acc.y", "acc.z", "gyro.x", "gyro.y", "gyro.z"),
    "estimate": ("stateEstimate.x", "stateEstimate.vy", "stateEstimate.qx"),
}
"""Signals of the table that always move a little."""


@lru_cache(12)
def layout(blob: bytes) -> dict[str, Layout]:
    """Events by the name of their kind, as far as the log is sound."""
    kinds: dict[int, tuple[str, dict[str, tuple[int, np.dtype[Any]]], int]] = {}
    try:
        _, version, count = struct.unpack_from("<BHH", blob)
        at = 5
        for _ in range(min(count, 20)):
            (number,) = struct.unpack_from("<H", blob, at)
            end = blob.index(0, at + 2)
            name = blob[at + 2 : end].decode()
            (several,) = struct.unpack_from("<H", blob, end + 1)
            at = end + 3
            stamp = np.dtype("<u4" if version == 1 else "<u8")
            fields = {_TIME: (2, stamp)}
            size = 2 + stamp.itemsize
            for _ in range(min(several, 100)):
                end = blob.index(0, at)
                text = blob[at:end].decode()
                letter = np.dtype(_TYPES[text[-2]])
                fields[text[:-3]] = (size, letter)
                size, at = size + letter.itemsize, end + 1
            kinds[number] = (name, fields, size)
    except (struct.error, ValueError, KeyError, IndexError, UnicodeDecodeError):
        return {}
    places: dict[int, list[int]] = {}
    while at + 2 <= len(blob) and (number := struct.unpack_from("<H", blob, at)[0]) in kinds:
        if at + kinds[number][2] > len(blob):
            break
        places.setdefault(number, []).append(at)
        at += kinds[number][2]
    return {
        kinds[n][0]: Layout(np.array(p, dtype=np.int64), kinds[n][1]) for n, p in places.items()
    }


def _sealed(blob: bytes) -> bytes:
    """With the checksum of what it holds now."""
    return blob[:-4] + struct.pack("<I", zlib.crc32(blob[:-4]))


class Crazyflie:
    """The kind."""

    file = "log00"
    visible = frozenset({"stamp_add", "freeze", "absurd", "cut"})

    def bases(self) -> dict[str, bytes]:
        """Written ones of both versions."""
        table = flown_table()
        return {
            "rest": SAMPLES["Crazyflie uSD log, version 2"](),
            "flown": usd_log(flown_kinds(table)),
            "first": usd_log(flown_kinds(table, angles=True), version=1),
        }

    def draw(self, rng: random.Random, blob: bytes) -> Step:
        """Half of them know the format."""
        there = [k for k in _SENSED if k in layout(blob) and "estimate" in layout(blob)]
        if rng.random() < 0.4 or not there:
            return draw_bytes(rng, blob)
        kind = rng.choice(there)
        fields = [f for f in _SENSED[kind] if f in layout(blob)[kind].fields]
        given: dict[str, Any] = {"kind": kind, "from": rng.choice((0.0, 0.3, 0.5))}
        name = rng.choice(("stamp_add", "freeze", "absurd", "any_field", "letter"))
        match name:
            case "stamp_add":
                given["by"] = rng.choice((3_600_000_000, 12 * 86_400_000_000))
            case "freeze":
                given["from"] = rng.uniform(0.2, 0.4)
            case "absurd":
                value = rng.choice([v for v in ABSURD if not abs(v) < 1e9])
                given |= {"field": rng.choice(fields), "to": repr(value)}
            case "any_field":
                field = rng.choice(sorted(layout(blob)[kind].fields))
                given |= {"field": field, "to": repr(rng.choice(ABSURD))}
            case _:
                given["to"] = rng.choice("bBhHiIQqefd?sPxn")
        return name, given

    def apply(self, blob: bytes, step: Step) -> bytes:
        """As drawn; what an earlier change took away is left."""
        name, given = step
        if "kind" not in given:
            return apply_bytes(blob, step)
        if (place := layout(blob).get(given["kind"])) is None:
            return blob
        first = int(given["from"] * len(place.at))
        match name:
            case "letter":
                return _sealed(blob.replace(b"(f)", f"({given['to']})".encode(), 1))
            case "stamp_add":
                stamp = place.get(blob, _TIME).astype(np.uint64)
                stamp[first:] += np.uint64(given["by"])
                return _sealed(place.put(blob, _TIME, stamp))
            case "freeze":
                for field in [f for f in place.fields if f != _TIME]:
                    values = place.get(blob, field).copy()
                    values[first : first + len(values) * 2 // 3] = values[first]
                    blob = place.put(blob, field, values)
                return _sealed(blob)
            case _:
                if given["field"] not in place.fields:
                    return blob
                values = place.get(blob, given["field"]).astype(np.float64)
                values[first:] = float(given["to"])
                return _sealed(place.put(blob, given["field"], values))

    def read(self, path: Path) -> Seen:
        """As a flight."""
        return read(path)


KIND = Crazyflie()
