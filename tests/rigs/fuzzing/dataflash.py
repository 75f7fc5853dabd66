"""ArduPilot DataFlash logs: stamps, fields, whole messages and definitions changed where they
stand."""

import random
import struct
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from log_rigs.dataflash_rig import MARK, dataflash
from numpy.typing import NDArray
from sample_logs import FLOWN_PARAMS, SAMPLES, flown_messages

from .engine import Seen, Step
from .flights import ABSURD, apply_bytes, draw_bytes, read, recorded
from .layout import AXIS_FAULTS, Layout, draw_axis_fault

_TYPES = {
    **{"b": "i1", "B": "u1", "M": "u1", "h": "<i2", "H": "<u2", "c": "<i2", "C": "<u2"},
    **{"i": "<i4", "I": "<u4", "e": "<i4", "E": "<u4", "L": "<i4", "q": "<i8", "Q": "<u8"},
    **{"g": "<f2", "f": "<f4", "d": "<f8", "n": "S4", "N": "S16", "Z": "S64", "a": "S64"},
}
SENSED = {
    "IMU": ("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"),
    "XKQ": ("Q1", "Q2", "Q3", "Q4"),
    "XKF1": ("VN", "VE", "VD", "PN", "PE", "PD"),
}
"""Signals of the table that always move a little."""
AXES = {"IMU": SENSED["IMU"], "XKF1": ("VN", "VE", "VD")}
STEADY = (*SENSED, "RCOU", "BAT", "BARO", "MAG")
_FMT = 0x80
_FMT_SIZE = 89


@dataclass(frozen=True, slots=True)
class Messages(Layout):
    """The same of messages of `size` bytes."""

    size: int


@lru_cache(12)
def layout(blob: bytes) -> dict[str, Messages]:
    """By name, as far as the log is sound."""
    defined: dict[int, tuple[str, dict[str, tuple[int, np.dtype[Any]]], int]] = {
        _FMT: ("FMT", {"Length": (1, np.dtype("u1"))}, _FMT_SIZE)
    }
    places: dict[int, list[int]] = {}
    at = 0
    while at + 3 <= len(blob) and blob.startswith(MARK, at) and blob[at + 2] in defined:
        number = blob[at + 2]
        size = defined[number][2]
        if at + size > len(blob):
            break
        places.setdefault(number, []).append(at + 3)
        if number == _FMT:
            told, _, *texts = struct.unpack_from("<BB4s16s64s", blob, at + 3)
            name, letters, columns = (t.rstrip(b"\0").decode("ascii", "replace") for t in texts)
            if told != _FMT and set(letters) <= set(_TYPES):
                kinds = [np.dtype(_TYPES[k]) for k in letters]
                starts = np.cumsum([0, *(k.itemsize for k in kinds)]).tolist()
                fields = dict(
                    zip(columns.split(","), zip(starts, kinds, strict=False), strict=False)
                )
                defined[told] = (name, fields, 3 + starts[-1])
        at += size
    return {
        defined[n][0]: Messages(np.array(p, dtype=np.int64), defined[n][1], defined[n][2])
        for n, p in places.items()
        if len(p) > 9
    }


def _flown() -> dict[str, Any]:
    """The flown flight, its motors off in its first and last second."""
    messages = dict(flown_messages())
    outputs = messages["RCOU"]
    t = np.asarray(outputs["t"])
    off = (t < 1.0) | (t > 29.0)
    messages["RCOU"] = {k: v if k == "t" else np.where(off, 1000, v) for k, v in outputs.items()}
    return messages


class DataFlash:
    """The kind."""

    file = "input.bin"
    visible = frozenset(
        {"stamp_add", "stamp_times", "gap", "freeze", "absurd", "back", "cut", "redefine", "unit"}
        | {*AXIS_FAULTS}
    )

    def bases(self) -> dict[str, bytes]:
        """Written ones, binary and text, and what was recorded."""
        return {
            "rest": SAMPLES["ArduPilot DataFlash"](),
            "flown": dataflash(_flown(), FLOWN_PARAMS),
            "text": dataflash(_flown(), FLOWN_PARAMS, text=True),
            **recorded("quiver_pt1/*81.BIN", "quiver_pt1/*92.BIN"),  # the shortest
        }

    def draw(self, rng: random.Random, blob: bytes) -> Step:
        """Half of them know the format."""
        topics = layout(blob)
        steady = [t for t in STEADY if t in topics]
        moving = [t for t in SENSED if t in topics and "XKQ" in topics]
        if rng.random() < 0.35 or len(steady) < 2:  # one alone contradicts nothing
            return _within_messages(draw_bytes(rng, blob), blob)
        names = ["stamp_add", "stamp_times", "gap", "absurd", "back", "redefine", "unit"]
        name = rng.choice(
            [*names, "any_field", "length", *(["freeze", *AXIS_FAULTS] if moving else [])]
        )
        given: dict[str, Any] = {"topic": rng.choice(steady)}
        match name:
            case "stamp_add":
                given["by_us"] = int(1e6 * rng.choice((3600.0, 12 * 86400.0, 2.0**62 / 1e6)))
                given["from"] = rng.choice((0.0, 0.5))
            case "stamp_times":
                given["by"] = rng.choice((1000, 10, 3))
            case "gap":
                given |= {"at": rng.uniform(0.4, 0.6), "lasting_s": rng.choice((0.4, 1.0, 5.0))}
            case "axis_sign" | "axis_scale" | "axis_freeze":
                topic = rng.choice([t for t in AXES if t in topics])
                field, place = rng.choice(AXES[topic]), topics[topic]
                given = {"topic": topic, "field": field}
                if not {field, "TimeUS"} <= place.fields.keys():
                    return draw_bytes(rng, blob)
                quantity = {"G": "gyro", "A": "acc", "V": "vel"}[field[0]]
                t_s = 1e-6 * place.get(blob, "TimeUS").astype(np.float64)
                values = place.get(blob, field).astype(np.float64)
                given |= draw_axis_fault(rng, name, quantity, t_s, values)
            case "freeze":
                given = {"topic": rng.choice(moving), "from": rng.uniform(0.2, 0.4)}
            case "absurd":
                topic = rng.choice(moving or ["IMU"])
                given = {
                    "topic": topic,
                    "field": rng.choice(SENSED[topic]),
                    "to": repr(rng.choice([v for v in ABSURD if not abs(v) < 1e9])),
                    "from": rng.choice((0.0, 0.3)),
                }
            case "back":
                given |= {"at": rng.uniform(0.4, 0.6), "steps": rng.choice((1, 3, 30))}
            case "redefine":
                given |= {
                    "at": rng.uniform(0.3, 0.9),
                    "letters": rng.choice(("Q", "QB", "Qf", "QZZZZZ")),
                }
            case "unit":
                given |= {"with": rng.choice("vAPGm")}
            case "length":
                given |= {"to": rng.choice((0, 3, 255))}
            case _:
                topic = rng.choice(sorted(topics))
                given = {
                    "topic": topic,
                    "field": rng.choice(sorted(topics[topic].fields)),
                    "to": repr(rng.choice(ABSURD)),
                    "from": rng.choice((0.0, 0.5, 0.99)),
                }
        return name, given

    def apply(self, blob: bytes, step: Step) -> bytes:
        """As drawn; what an earlier change took away is left."""
        name, given = step
        if "topic" not in given:
            return apply_bytes(blob, step)
        place = layout(blob).get(given["topic"])
        if place is None or ("TimeUS" not in place.fields and name not in ("any_field", "length")):
            return blob
        match name:
            case "redefine" | "length":
                return _redefined(blob, place, given)
            case "unit":
                return _with_unit(blob, place, given["with"])
            case "axis_sign" | "axis_scale" | "axis_freeze":
                if given["field"] not in place.fields:
                    return blob
                return place.with_axis_fault(blob, name, given)
            case "freeze":
                return _frozen(blob, place, given["from"])
            case "any_field" | "absurd":
                if given["field"] not in place.fields:
                    return blob
                values = place.get(blob, given["field"])
                if values.dtype.kind == "S":
                    values[int(given["from"] * len(values)) :] = given["to"].encode()
                else:
                    values = values.astype(np.float64)
                    values[int(given["from"] * len(values)) :] = float(given["to"])
                return place.put(blob, given["field"], values)
            case _:
                return _stamped(blob, place, name, given)

    def read(self, path: Path) -> Seen:
        """As a flight."""
        return read(path)


def _within_messages(step: Step, blob: bytes) -> Step:
    """A cut between two messages leaves a log that is whole: it is moved into the second."""
    name, given = step
    if name == "cut" and blob.startswith(MARK, given["at"]):
        return name, {"at": given["at"] + 1}
    return step


def _stamped(blob: bytes, place: Messages, name: str, given: dict[str, Any]) -> bytes:
    """Other times, or messages of a span taken out."""
    stamp = place.get(blob, "TimeUS")
    n = len(stamp)
    match name:
        case "stamp_add":
            stamp[int(given["from"] * n) :] += np.uint64(given["by_us"])
        case "stamp_times":
            stamp *= np.uint64(given["by"])
        case "back":
            k = max(int(given["at"] * n), 1)
            stamp[k] = stamp[max(k - given["steps"], 0)]
        case "gap":
            begin = stamp[int(given["at"] * n)]
            inside = (stamp >= begin) & (stamp < begin + np.uint64(given["lasting_s"] * 1e6))
            return _without(blob, place.at[inside], place.size)
    return place.put(blob, "TimeUS", stamp)


def _without(blob: bytes, at: NDArray[np.int64], size: int) -> bytes:
    """The log without the messages whose content begins there."""
    out, last = [], 0
    for begin in at.tolist():
        out.append(blob[last : begin - 3])
        last = begin - 3 + size
    return b"".join([*out, blob[last:]])


def _frozen(blob: bytes, place: Messages, since: float) -> bytes:
    """Two thirds of the messages with the values of the first of them."""
    n = len(place.at)
    first = int(since * n)
    for field in place.fields:
        if field not in ("TimeUS", "I", "C"):
            values = place.get(blob, field).copy()
            values[first : first + n * 2 // 3] = values[first]
            blob = place.put(blob, field, values)
    return blob


def _redefined(blob: bytes, place: Messages, given: dict[str, Any]) -> bytes:
    """Another definition of a kind amid its messages, or its own with another length."""
    number = blob[int(place.at[0]) - 1]
    at = blob.find(MARK + bytes([_FMT, number]))
    if at < 0:
        return blob
    if "to" in given:
        return blob[: at + 4] + bytes([given["to"]]) + blob[at + 5 :]
    letters = given["letters"]
    size = 3 + sum(np.dtype(_TYPES[k]).itemsize for k in letters)
    columns = ",".join(["TimeUS", "a", "b", "c", "d", "e"][: len(letters)])
    texts = (given["topic"].encode(), letters.encode(), columns.encode())
    made = MARK + bytes([_FMT]) + struct.pack("<BB4s16s64s", number, size % 256, *texts)
    middle = int(place.at[int(given["at"] * len(place.at))]) - 3
    return blob[:middle] + made + blob[middle:]


def _with_unit(blob: bytes, place: Messages, unit: str) -> bytes:
    """Every column of a kind in another unit by its FMTU."""
    number = blob[int(place.at[0]) - 1]
    units = layout(blob).get("FMTU")
    if units is None:
        return blob
    numbers, ids = units.get(blob, "FmtType"), units.get(blob, "UnitIds")
    for k in np.flatnonzero(numbers == number):
        ids[k] = ids[k][:2] + unit.encode() * max(len(ids[k]) - 2, 0)
    return units.put(blob, "UnitIds", ids)


KIND = DataFlash()
