"""PX4 ULogs: stamps, fields and whole messages of a topic changed where they stand."""

import random
import re
import struct
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sample_logs import SAMPLES, moving_topics, ulog, ulog_message

from .engine import Seen, Step
from .flights import ABSURD, apply_bytes, draw_bytes, read, recorded
from .layout import AXIS_FAULTS, Layout, draw_axis_fault

_TYPES = {
    **{f"{u}int{n}_t": f"<{u[:1] or 'i'}{n // 8}" for u in ("", "u") for n in (8, 16, 32, 64)},
    **{"float": "<f4", "double": "<f8", "bool": "|b1", "char": "|u1"},
}
STEADY = (
    "actuator_controls_0",
    "actuator_motors",
    "actuator_outputs",
    "battery_status",
    "sensor_combined",
    "vehicle_attitude",
    "vehicle_local_position",
    "vehicle_rates_setpoint",
)
SENSED = {
    "sensor_combined": ("gyro_rad[0]", "gyro_rad[1]", "gyro_rad[2]", "accelerometer_m_s2[2]"),
    "vehicle_attitude": ("q[0]", "q[1]", "q[2]", "q[3]"),
    "vehicle_local_position": ("x", "y", "z", "vx", "vy", "vz"),
}
"""Signals of the table that always move a little."""
AXES = {
    "sensor_combined": tuple(
        f"{s}[{k}]" for s in ("gyro_rad", "accelerometer_m_s2") for k in range(3)
    ),
    "vehicle_local_position": ("vx", "vy", "vz"),
}
INPUTS = {
    **SENSED,
    "actuator_controls_0": ("control[0]", "control[3]"),
    "actuator_motors": ("control[1]",),
    "vehicle_rates_setpoint": ("roll", "thrust_body[2]"),
}


@lru_cache(12)
def layout(blob: bytes) -> dict[str, Layout]:
    """By topic; nested formats are left out."""
    formats: dict[str, list[str]] = {}
    topic: dict[int, str] = {}
    places: dict[int, list[int]] = {}
    at = 16
    while at + 3 <= len(blob):
        size, kind = struct.unpack_from("<HB", blob, at)
        body = blob[at + 3 : at + 3 + size]
        if kind == ord("F"):
            name, _, fields = body.decode("utf-8", "ignore").partition(":")
            formats[name] = [f for f in fields.split(";") if f]
        elif kind == ord("A") and size > 3 and body[0] == 0:
            topic[struct.unpack_from("<H", body, 1)[0]] = body[3:].decode("utf-8", "ignore")
        elif kind == ord("D") and len(body) == size >= 2:
            places.setdefault(struct.unpack_from("<H", body)[0], []).append(at + 5)
        at += 3 + size
    found = {}
    for number, name in topic.items():
        columns: dict[str, tuple[int, np.dtype[Any]]] = {}
        offset = 0
        for field in formats.get(name, []):
            kind_of, _, label = field.partition(" ")
            written = re.fullmatch(r"(\w+)(?:\[(\d{1,3})\])?", kind_of)
            if written is None or written[1] not in _TYPES:
                break  # nested, or damaged by an earlier change
            element, count = np.dtype(_TYPES[written[1]]), written[2]
            for k in range(int(count or 1)):
                columns[f"{label}[{k}]" if count else label] = (offset, element)
                offset += element.itemsize
        if "timestamp" in columns and len(places.get(number, ())) > 9:
            found[name] = Layout(np.array(places[number], dtype=np.int64), columns)
    return found


class ULogs:
    """The kind."""

    file = "input.ulg"
    visible = frozenset(
        {"stamp_add", "stamp_times", "sample_time", "window", "gap", "ends", "freeze", "absurd"}
        | {"back", *AXIS_FAULTS}
    )

    def bases(self) -> dict[str, bytes]:
        """Written ones, and what was recorded."""
        return {
            "rest": SAMPLES["PX4 ULog"](),
            "moving": ulog(moving_topics(), {"CA_ROTOR_COUNT": 4}),
            **recorded("rflysimdt/*.ulg"),
        }

    def draw(self, rng: random.Random, blob: bytes) -> Step:
        """Half of them know the format."""
        topics = layout(blob)
        if rng.random() < 0.35 or len(topics) < 2:  # one alone contradicts nothing
            return draw_bytes(rng, blob)
        moving = [t for t in SENSED if t in topics and "vehicle_attitude" in topics]
        names = [
            "stamp_add",
            "stamp_times",
            "sample_time",
            "window",
            "gap",
            "ends",
            "absurd",
            "back",
        ]
        name = rng.choice(
            [*names, "any_field", "nest", *(["freeze", *AXIS_FAULTS] if moving else [])]
        )
        if name == "nest":
            return name, {"depth": rng.choice((2, 20, 50)), "width": rng.choice((1, 2, 300))}
        topic = rng.choice([t for t in STEADY if t in topics] or sorted(topics))
        given: dict[str, Any] = {"topic": topic}
        match name:
            case "stamp_add":
                big = rng.choice((0.2, 3600.0, 12 * 86400.0, 2.0**62 / 1e6))
                given |= {"by_us": int(big * 1e6), "from": rng.choice((0.0, 0.0, 0.5))}
                if given["from"] and big < 1.0:
                    given["from"] = 0.0
            case "stamp_times":
                given |= {"by": rng.choice((1000, 10, 3))}
            case "sample_time":
                sampled = [t for t in topics if "timestamp_sample" in topics[t].fields]
                sampled = [t for t in sampled if t in STEADY]
                if not sampled:
                    return draw_bytes(rng, blob)
                given = {"topic": rng.choice(sampled), "to": rng.choice((0, 2**40, 2**64 - 1))}
            case "window":
                given = {
                    "topic": "sensor_combined",
                    "field": rng.choice(
                        (
                            "gyro_integral_dt",
                            "accelerometer_integral_dt",
                            "accelerometer_timestamp_relative",
                        )
                    ),
                    "to": rng.choice((2**31 - 2, 10**6, 90_000)),
                }
                if given["field"] not in topics.get("sensor_combined", Layout(_NONE, {})).fields:
                    return draw_bytes(rng, blob)
            case "gap":
                given |= {"at": rng.uniform(0.2, 0.7), "lasting_s": rng.choice((0.4, 1.0, 5.0))}
            case "ends":
                given |= {"at": rng.uniform(0.2, 0.9)}
            case "freeze":
                given = {"topic": rng.choice(moving), "from": rng.uniform(0.2, 0.4)}
            case "axis_sign" | "axis_scale" | "axis_freeze":
                topic = rng.choice([t for t in AXES if t in topics] or moving)
                fields = [f for f in AXES.get(topic, ()) if f in topics[topic].fields]
                if not fields:
                    return draw_bytes(rng, blob)
                field, place = rng.choice(fields), topics[topic]
                quantity = "vel" if field[0] == "v" else "gyro" if field[0] == "g" else "acc"
                t_s = 1e-6 * place.get(blob, "timestamp").astype(np.float64)
                values = place.get(blob, field).astype(np.float64)
                given = {"topic": topic, "field": field}
                given |= draw_axis_fault(rng, name, quantity, t_s, values)
            case "absurd":
                used = [t for t in INPUTS if t in topics and {*INPUTS[t]} & {*topics[t].fields}]
                if not used:
                    return draw_bytes(rng, blob)
                topic = rng.choice(used)
                given = {
                    "topic": topic,
                    "field": rng.choice([f for f in INPUTS[topic] if f in topics[topic].fields]),
                    "to": repr(rng.choice([v for v in ABSURD if not abs(v) < 1e9])),
                    "from": rng.choice((0.0, 0.3)),
                }
            case "back":
                given |= {"at": rng.uniform(0.1, 0.9), "steps": rng.choice((1, 3, 30))}
            case "any_field":
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
        if name == "nest":
            return _nested(blob, given["depth"], given["width"])
        if "topic" not in given:
            return apply_bytes(blob, step)
        place = layout(blob).get(given["topic"])
        if place is None:
            return blob
        n = len(place.at)
        stamp = place.get(blob, "timestamp")
        first = int(given.get("from", 0.0) * n)
        match name:
            case "stamp_add":
                stamp[first:] += np.uint64(given["by_us"])
            case "stamp_times":
                stamp *= np.uint64(given["by"])
            case "back":
                k = max(int(given["at"] * n), 1)
                stamp[k] = stamp[max(k - given["steps"], 0)]
            case "gap":
                begin = stamp[int(given["at"] * n)]
                inside = (stamp >= begin) & (stamp < begin + np.uint64(given["lasting_s"] * 1e6))
                return _without(blob, place.at[inside])
            case "ends":
                return _without(blob, place.at[int(given["at"] * n) :])
            case "axis_sign" | "axis_scale" | "axis_freeze":
                return place.with_axis_fault(blob, name, given)
            case "sample_time":
                return place.put(blob, "timestamp_sample", np.full(n, given["to"], np.uint64))
            case "freeze":
                for field in place.fields:
                    if not field.startswith("timestamp"):
                        values = place.get(blob, field).copy()
                        values[first : first + n * 2 // 3] = values[first]
                        blob = place.put(blob, field, values)
                return blob
            case _:
                values = place.get(blob, given["field"]).astype(np.float64)
                values[first:] = float(given["to"])
                return place.put(blob, given["field"], values)
        return place.put(blob, "timestamp", stamp)

    def read(self, path: Path) -> Seen:
        """As a flight."""
        return read(path)


_NONE = np.zeros(0, dtype=np.int64)


def _without(blob: bytes, at: NDArray[np.int64]) -> bytes:
    """The log without the messages whose content begins there."""
    out, last = [], 0
    for place in at.tolist():
        size = struct.unpack_from("<H", blob, place - 5)[0]
        out.append(blob[last : place - 5])
        last = place - 2 + size
    return b"".join([*out, blob[last:]])


def _nested(blob: bytes, depth: int, width: int) -> bytes:
    """Formats within formats, and a subscription to the outermost."""
    inner = [f"n{k}:" + f"n{k + 1} a;" * width for k in range(depth)]
    formats = b"".join(ulog_message(b"F", t.encode()) for t in [*inner, f"n{depth}:float x;"])
    added = ulog_message(b"A", struct.pack("<BH", 0, 999) + b"n0")
    return blob[:59] + formats + blob[59:] + added


KIND = ULogs()
