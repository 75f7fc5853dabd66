"""Phases of a flight: takeoff, hover, forward, tour, land, ground."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..flight import Array
from .log import Px4Log

Span = tuple[str, float, float]

_MARKER = 183
_BEGIN, _END = 666, 777
_MODES = {(2, 3): "takeoff", (2, 6): "hover", (2, 7): "land"}
_NOT_A_PHASE = {(2, 1)}  # prepares the offboard mode before takeoff
_CLIMB_M_S = 0.3
_CRUISE_M_S = 1.0
_SEAM_S = 0.1


def label(t_s: Array, spans: Sequence[Span]) -> NDArray[np.object_]:
    """Phase of each time, "" outside all spans; later spans win.

    Args:
        t_s: Times, s, shape (n,).
        spans: (name, start s, end s); the end belongs to the next span.
    """
    phase = np.full(len(t_s), "", dtype=object)
    for name, start, end in spans:
        phase[(t_s >= start) & (t_s < end)] = name
    return phase


def from_px4_phases(log: Px4Log) -> list[Span]:
    """Phases of a PX4 log: markers of the test script, else landed state, speed and climb rate."""
    ground = _ground(log)
    marked = _marked(log)
    if marked:
        log.note("info", "phase", "from the markers (vehicle_command 183) of the test script")
        start, end = marked[0][1], marked[-1][2]
        before = [(n, a, min(b, start)) for n, a, b in ground if a < start]
        after = [(n, max(a, end), b) for n, a, b in ground if b > end]
        return [*before, *marked, *after]
    moved = _from_motion(log, ground)
    if moved:
        log.note("info", "phase", "from landed state, speed and climb rate; no markers in the log")
    return moved


def _marked(log: Px4Log) -> list[Span]:
    """Spans between the begin and end markers of the RflySim test scripts."""
    topic = log.topic("vehicle_command", 0, "command", "param1", "param2", "param7")
    if topic is None:
        return []
    spans: list[Span] = []
    begun: dict[tuple[int, int], float] = {}
    for t, command, p1, p2, p7 in zip(
        topic.t_s,
        topic.data["command"],
        *(topic.data[f"param{k}"].tolist() for k in (1, 2, 7)),
        strict=True,
    ):
        if command != _MARKER or p7 not in (_BEGIN, _END):
            continue
        mode = (int(p1), int(p2))
        if mode in _NOT_A_PHASE:
            continue
        if mode not in _MODES:
            log.note("warning", "phase", f"marker of an unknown mode {mode} at {t:.2f} s")
        elif p7 == _BEGIN:
            begun[mode] = float(t)
        elif mode in begun:
            spans.append((_MODES[mode], begun.pop(mode), float(t)))
    for mode, t in begun.items():
        log.note("warning", "phase", f"{_MODES[mode]} begins at {t:.2f} s and has no end marker")
        spans.append((_MODES[mode], t, np.inf))
    spans.sort(key=lambda s: s[1])
    for k, (name, start, end) in enumerate(spans[:-1]):
        follows = spans[k + 1][1]
        if 0.0 < follows - end < _SEAM_S:
            spans[k] = (name, start, follows)
    return spans


def _ground(log: Px4Log) -> list[Span]:
    """Spans on the ground, from the land detector."""
    topic = log.topic("vehicle_land_detected", 0, "landed")
    if topic is None:
        return []
    landed = topic.data["landed"].astype(bool)
    edges = np.append(topic.t_s, np.inf)
    spans = [
        ("ground", float(a), float(b))
        for a, b, down in zip(edges[:-1], edges[1:], landed, strict=True)
        if down
    ]
    if spans and landed[0]:
        spans[0] = ("ground", -np.inf, spans[0][2])
    return spans


def _from_motion(log: Px4Log, ground: list[Span]) -> list[Span]:
    """Spans from how the vehicle moves; steps of 0.5 s."""
    topic = log.topic("vehicle_local_position", 0, "vx", "vy", "vz")
    if topic is None or not ground or len(topic.t_s) < 2:
        return ground
    velocity = topic.columns(("vx", "vy", "vz"))
    edges = np.arange(topic.t_s[0], topic.t_s[-1] + 0.5, 0.5)
    means = np.array(
        [
            velocity[(topic.t_s >= a) & (topic.t_s < a + 0.5)].mean(axis=0)
            if np.any((topic.t_s >= a) & (topic.t_s < a + 0.5))
            else np.full(3, np.nan)
            for a in edges
        ]
    )
    horizontal, down = np.hypot(means[:, 0], means[:, 1]), means[:, 2]
    kind = np.full(len(edges), "hover", dtype=object)
    kind[horizontal > _CRUISE_M_S] = "forward"
    kind[~np.isfinite(down)] = ""
    on_ground = label(edges, ground) == "ground"
    _spread(kind, on_ground, down < -_CLIMB_M_S, "takeoff", after=True)
    _spread(kind, on_ground, down > _CLIMB_M_S, "land", after=False)
    flown: list[Span] = [
        (str(k), float(a), float(a + 0.5)) for k, a in zip(kind, edges, strict=True) if k
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
