"""Where numbers stand in a binary log, to read and to change them there."""

import random
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the samples of one topic, or the messages of one name, stand in a log.

    Attributes:
        at: Where each begins, shape (n,).
        fields: Distance of each field from there, and its type.
    """

    at: NDArray[np.int64]
    fields: dict[str, tuple[int, np.dtype[Any]]]

    def get(self, blob: bytes, field: str) -> NDArray[Any]:
        """Values of a field, shape (n,)."""
        offset, kind = self.fields[field]
        raw = np.frombuffer(blob, np.uint8)
        place = self.at[:, None] + offset + np.arange(kind.itemsize)
        return np.ascontiguousarray(raw[place]).view(kind)[:, 0]

    def put(self, blob: bytes, field: str, values: NDArray[Any]) -> bytes:
        """The log with other values of a field."""
        offset, kind = self.fields[field]
        raw = np.frombuffer(blob, np.uint8).copy()
        place = self.at[:, None] + offset + np.arange(kind.itemsize)
        with np.errstate(invalid="ignore", over="ignore"):
            new = np.ascontiguousarray(values.astype(kind)).view(np.uint8)
        raw[place] = new.reshape(len(self.at), -1)
        return raw.tobytes()

    def with_axis_fault(self, blob: bytes, name: str, given: dict[str, Any]) -> bytes:
        """The log with one axis negated, scaled or frozen."""
        values = self.get(blob, given["field"])
        values = axis_fault(values.astype(np.float64), name, given)
        return self.put(blob, given["field"], values)


AXIS_FAULTS = ("axis_sign", "axis_scale", "axis_freeze")


def draw_axis_fault(rng: random.Random, name: str) -> dict[str, Any]:
    """Arguments of a fault of one axis, besides which axis it is."""
    match name:
        case "axis_scale":
            return {"by": rng.choice((0.3, 3.0))}
        case "axis_freeze":
            return {"from": rng.uniform(0.0, 0.3)}
        case _:
            return {}


def axis_fault(values: NDArray[np.float64], name: str, given: dict[str, Any]) -> Any:
    """One axis of a sensor negated, scaled, or frozen to the end."""
    match name:
        case "axis_sign":
            return -values
        case "axis_scale":
            return given["by"] * values
        case _:
            out, first = values.copy(), int(given["from"] * len(values))
            out[first:] = out[first] if len(out) else 0.0
            return out
