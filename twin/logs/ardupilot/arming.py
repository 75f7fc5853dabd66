"""Which part of a log is a flight: the stretch in which the motors run, without a pause of a
minute."""

import numpy as np
from numpy.typing import NDArray

from .log import ArduPilotLog
from .outputs import logged_commands

Span = tuple[int, int]
"""Begin and end, us."""

_PAUSE_US = 60_000_000
ARMED, DISARMED, _AUTO_ARMED = 10, 11, 15
"""EV by number."""
_STILL_ON_US = 500_000
_SHOWN = 8


def armed_spans(log: ArduPilotLog) -> list[Span]:
    """When the motors were armed, on the clock of the log so far.

    By the outputs of the motors, which rest while disarmed; where the log has none, by its events.
    """
    commands = logged_commands(log, log.whole)
    if commands is not None and commands.running.any():
        return _spans(commands.t_us, commands.running)
    return _by_events(log)


def _spans(t_us: NDArray[np.int64], on: NDArray[np.bool_]) -> list[Span]:
    """Spans in which something is on, from samples of it."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], on.astype(np.int8), [0]])))
    pairs = edges.reshape(-1, 2)
    return [(int(t_us[a]), int(t_us[b - 1])) for a, b in pairs]


def _by_events(log: ArduPilotLog) -> list[Span]:
    """Spans by EV; armed before the first event where that disarms, to the end after the last."""
    events = log.whole("EV")
    ends = _ends(log)
    if events is None or ends is None:
        return []
    spans: list[Span] = []
    begin: int | None = None
    seen = False
    for t, kind in zip(events.t_us.tolist(), events.raw("Id").tolist(), strict=True):
        if kind in (ARMED, _AUTO_ARMED) and begin is None:
            begin = t
        elif kind == DISARMED and (begin is not None or not seen):
            spans.append((ends[0] if begin is None else begin, t))
            begin = None
        seen = seen or kind in (ARMED, _AUTO_ARMED, DISARMED)
    return [*spans, (begin, ends[1])] if begin is not None else spans


def _ends(log: ArduPilotLog) -> Span | None:
    """Begin and end of what is logged of the motion."""
    found = [t for n in ("IMU", "ATT", "XKF1", "NKF1", "EKF1") if (t := log.whole(n)) is not None]
    if not found:
        return None
    return min(int(t.t_us[0]) for t in found), max(int(t.t_us[-1]) for t in found)


def use_the_flight(log: ArduPilotLog) -> dict[str, str]:
    """Cut a log to its longest stretch of armed time without a pause of a minute.

    Returns:
        Facts on what is used.
    """
    spans, ends = armed_spans(log), _ends(log)
    if not spans:
        log.note("info", "log", "it tells no time in which the motors run: all of it is used")
        return {"clock": f"t = 0 is {log.start_us * 1e-6:.6f} s after boot, the start of the log"}
    stretches: list[list[Span]] = []
    for span in spans:
        if stretches and span[0] - stretches[-1][-1][1] <= _PAUSE_US:
            stretches[-1].append(span)
        else:
            stretches.append([span])
    used = max(stretches, key=lambda s: sum(b - a for a, b in s))
    begin, end = used[0][0], used[-1][1]
    each = [f"{(b - a) * 1e-6:.1f} s from {(a - begin) * 1e-6:.1f} s" for a, b in spans[:_SHOWN]]
    told = "; ".join(each) + (f" and {len(spans) - _SHOWN} more" if len(spans) > _SHOWN else "")
    if len(stretches) > 1:
        log.note(
            "warning",
            "log",
            f"motors run in {len(stretches)} stretches over a minute apart ({told}); the one with "
            "most of it is used. Split the log to use the others",
            len(stretches),
        )
    if ends is not None and ends[1] - end < _STILL_ON_US:
        log.note("error", "log", "it ends with the motors running: cut short?")
    if ends is not None and (left := (begin - ends[0]) + (ends[1] - end)) > _STILL_ON_US:
        log.note("info", "log", f"{left * 1e-6:.1f} s with the motors stopped are not used")
    log.cut_to(begin, end)
    return {
        "motors run": told,
        "clock": f"t = 0 is {log.start_us * 1e-6:.6f} s after boot, when the motors start",
    }
