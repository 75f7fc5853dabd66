"""Phases of a PX4 log: the markers of the test script, else how the vehicle moves."""

import numpy as np

from ..phases import Span, ground_spans, motion_spans
from .log import Px4Log

_MARKER = 183
_BEGIN, _END = 666, 777
_MODES = {(2, 3): "takeoff", (2, 6): "hover", (2, 7): "land"}
_NOT_A_PHASE = {(2, 1)}  # prepares the offboard mode before takeoff
_SEAM_S = 0.1


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
        if not np.isfinite((p1, p2)).all():
            log.note("warning", "phase", f"marker at {t:.2f} s whose mode is {p1:g}, {p2:g}")
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
    return [] if topic is None else ground_spans(topic.t_s, topic.data["landed"].astype(bool))


def _from_motion(log: Px4Log, ground: list[Span]) -> list[Span]:
    """Spans from how the estimator says that the vehicle moves."""
    topic = log.topic("vehicle_local_position", 0, "vx", "vy", "vz")
    if topic is None:
        return ground
    return motion_spans(topic.t_s, topic.columns(("vx", "vy", "vz")), ground)
