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


_WINDOW_S = 0.5
_LEAST = {"gyro": 2e-3, "acc": 0.05, "vel": 0.02}
"""Integral over a window, in rad, m/s and m, below which nothing contradicts its size: the noise
of an attitude (0.1 deg), gravity under a tilt that is known to 0.6 deg (0.1 m/s^2), noise of a
position (2 cm)."""
_LEAST_AGAINST = _LEAST | {"vel": 3e-3}
"""The same of the sign: noise hides how large a motion is, and does not turn it."""


def draw_axis_fault(
    rng: random.Random, name: str, quantity: str, t_s: NDArray[Any], values: NDArray[Any]
) -> dict[str, Any]:
    """Arguments of a fault of one axis, besides which axis it is.

    Args:
        rng: Of the draw.
        name: Of `AXIS_FAULTS`.
        quantity: "gyro", "acc" or "vel".
        t_s: Times of its samples, s, shape (n,).
        values: Of the axis, rad/s, m/s^2 or m/s, shape (n,).

    Returns:
        With `still` where the axis moves so little that no finding is possible. A frozen axis lacks
        its noise, too: there a finding is always possible.
    """
    match name:
        case "axis_scale":
            given: dict[str, Any] = {"by": rng.choice((0.3, 3.0))}
            least = _LEAST
        case "axis_freeze":
            return {"from": rng.uniform(0.0, 0.3)}
        case _:
            given, least = {}, _LEAST_AGAINST
    return given | ({"still": True} if motion(t_s, values) < least[quantity] else {})


def motion(t_s: NDArray[Any], values: NDArray[Any]) -> float:
    """Integral over half a second that a fifth of these windows exceed, from their median.

    NaN where the samples, shape (n,), last less than two windows.
    """
    there = np.isfinite(values) & np.isfinite(t_s)
    order = np.argsort(t_s[there], kind="stable")
    t_s, values = t_s[there][order], values[there][order]
    if len(t_s) < 2 or not 2 * _WINDOW_S < t_s[-1] - t_s[0] < 1e5:  # damaged by an earlier change
        return float("nan")
    area = np.append(0.0, np.cumsum(np.diff(t_s) * (values[1:] + values[:-1]) / 2))
    windows = np.diff(np.interp(np.arange(t_s[0], t_s[-1], _WINDOW_S), t_s, area))
    return float(np.quantile(np.abs(windows - np.median(windows)), 0.8))


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
