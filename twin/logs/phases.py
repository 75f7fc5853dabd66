"""Phases of a flight from what every autopilot logs: landed or not, and the velocity."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .flight import Array

Span = tuple[str, float, float]
"""Name of a phase, its start and its end in s; the end belongs to the next span."""

_CLIMB_M_S = 0.3
_CRUISE_M_S = 1.0
_STEP_S = 0.5


def label_phases(t_s: Array, spans: Sequence[Span]) -> NDArray[np.object_]:
    """Phase of each time, "" outside all spans; later spans win.

    Args:
        t_s: Times, s, shape (n,).
        spans: In the order in which they are laid over each other.
    """
    phase = np.full(len(t_s), "", dtype=object)
    for name, start, end in spans:
        phase[(t_s >= start) & (t_s < end)] = name
    return phase


def ground_spans(t_s: Array, landed: NDArray[np.bool_]) -> list[Span]:
    """Spans on the ground, from a land detector.

    Args:
        t_s: When it spoke, s, shape (n,); what it says first also holds before, and what it says
            last from then on.
        landed: What it said, shape (n,).
    """
    edges = np.append(t_s, np.inf)
    spans = [
        ("ground", float(a), float(b))
        for a, b, down in zip(edges[:-1], edges[1:], landed, strict=True)
        if down
    ]
    if spans and landed[0]:
        spans[0] = ("ground", -np.inf, spans[0][2])
    return spans


def motion_spans(t_s: Array, velocity_n: Array, ground: list[Span]) -> list[Span]:
    """Phases of half a second each from how the vehicle moves.

    Faster than 1 m/s over ground is `forward`, else it is `hover`; climbing by more than 0.3 m/s
    next to a time on the ground is `takeoff`, sinking so before one is `land`.

    Args:
        t_s: Times of the velocity, s, shape (n,).
        velocity_n: NED, m/s, shape (n, 3).
        ground: From `ground_spans`; without any, nothing tells takeoff from landing.

    Returns:
        The phases flown, then `ground`; `ground` alone where it or the velocity is missing.
    """
    if not ground or len(t_s) < 2:
        return ground
    edges = np.arange(t_s[0], t_s[-1] + _STEP_S, _STEP_S)
    here = [(t_s >= a) & (t_s < a + _STEP_S) for a in edges]
    means = np.array(
        [velocity_n[k].mean(axis=0) if np.any(k) else np.full(3, np.nan) for k in here]
    )
    horizontal, down = np.hypot(means[:, 0], means[:, 1]), means[:, 2]
    kind = np.full(len(edges), "hover", dtype=object)
    kind[horizontal > _CRUISE_M_S] = "forward"
    kind[~np.isfinite(down)] = ""
    on_ground = label_phases(edges, ground) == "ground"
    _spread(kind, on_ground, down < -_CLIMB_M_S, "takeoff", after=True)
    _spread(kind, on_ground, down > _CLIMB_M_S, "land", after=False)
    flown: list[Span] = [
        (str(k), float(a), float(a + _STEP_S)) for k, a in zip(kind, edges, strict=True) if k
    ]
    return [*flown, *ground]


def _spread(
    kind: NDArray[np.object_],
    on_ground: NDArray[np.bool_],
    moving: NDArray[np.bool_],
    name: str,
    after: bool,
) -> None:
    """Name the vertical motion next to a time on the ground; `after` it, or before it."""
    order = range(len(kind)) if after else range(len(kind) - 1, -1, -1)
    state = "air"
    for i in order:
        if on_ground[i]:
            state = "ground"
        elif state == "ground":  # lift-off may begin slower than the threshold
            state = "moving" if moving[i] else "ground"
            kind[i] = name
        elif state == "moving":
            if moving[i]:
                kind[i] = name
            else:
                state = "air"
