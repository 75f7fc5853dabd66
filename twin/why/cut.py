"""Motor cut in the air: all commands drop to idle; the body follows them, so no residual shows it.

Caused by a failsafe, a kill switch, a land detector or a pilot. It differs from a landing by its
height above the ground, and by the subsequent free fall: on the ground specific force is that of
the weight, and an aircraft that rebounds falls by a few centimetres.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from ..logs.samples import stretches_where
from .causes import CAUSES, CUT
from .findings import Findings
from .flight import CONTACT_M_S2, FlightFrame, lift
from .records import Candidate, Event, Severity, TimelineItem

IDLE = 0.12
"""Share of the normal thrust by command below which every motor idles."""
FALLS_M = 0.15
"""Least fall from rest by the specific force: that of a cut of 0.2 s. A hard landing that rebounds
shows 0.05 m (nanobench B5, which was used for this limit only)."""
HITS_S = 0.5
"""Time after a fall at half of gravity within which there is an impact: the air carries the
rest."""
DROPS_S = 0.3
"""Time in which commands drop from half the normal thrust: excludes a slow descent."""
SURE = 0.85
"""Probability that commands and not the pilot's throttle caused it: a judgement."""


def cut(flight: FlightFrame, references: Sequence[FlightFrame] = ()) -> Findings:
    """Findings on cuts of all commands in the air, and on the impact."""
    if flight.drive is None or "acc" not in flight.grid:
        return Findings()
    events, hits = [], []
    for first, last, end in _falls(flight):
        hit_s = _hit_s(flight, end, last)
        events.append(_event(flight, first, min(last, end), hit_s))
        if hit_s is not None and not any(p.crash for p in flight.airborne):
            hits.append(TimelineItem(kind="crash", t_s=hit_s, text="hits something"))
    return Findings(events=events, timeline=hits, nothing=(1 - SURE) ** len(events))


def _falls(flight: FlightFrame) -> Iterator[tuple[int, int, int]]:
    """First place of commands at idle, place behind the last, and place behind the fall."""
    if not flight.airborne:
        return
    raised = lift(flight.grid[flight.drive or ""])
    flown = [raised[p.start : p.flown].mean(axis=1) for p in flight.airborne]
    usual, start = float(np.median(np.concatenate(flown))), flight.airborne[0].start
    slack = flight.places(DROPS_S)
    for a, z in stretches_where(raised[start:].max(axis=1) < IDLE * usual):
        first, last = start + a, start + z
        fallen_m, _, end = flight.fall(first, last)
        airborne = any(p.start <= first <= p.end + slack for p in flight.airborne)
        if airborne and fallen_m > FALLS_M and _drops(flight, first, usual):
            yield first, last, end


def _hit_s(flight: FlightFrame, end: int, last: int) -> float | None:
    """Time of the impact at the end of a fall, s; None: there is none, or the motors run again."""
    force, edges = flight.signals["acc"], flight.edges_s
    near = (force.t_s >= edges[end] - HITS_S / 2) & (force.t_s <= edges[end] + HITS_S)
    near &= force.t_s < edges[last]
    hit = near & (np.linalg.norm(force.values, axis=1) > CONTACT_M_S2)
    return float(force.t_s[np.argmax(hit)]) if hit.any() else None


def _drops(flight: FlightFrame, first: int, usual: float) -> bool:
    """Whether commands were at half of the normal thrust just before."""
    back = max(first - flight.places(DROPS_S) - 1, 0)
    before = lift(flight.grid[flight.drive or ""][back:first]).mean(axis=1)
    return bool(len(before) and before.max() > 0.5 * usual)


def _event(flight: FlightFrame, first: int, last: int, hit_s: float | None) -> Event:
    """Event that lasts as long as the fall: until the motors run again, or an impact."""
    signal = flight.signals[flight.drive or ""]
    edges = flight.edges_s
    near = (signal.t_s > edges[first] - flight.dt_s) & (signal.t_s <= edges[first + 1])
    t, level = signal.t_s[near], signal.values[near].max(axis=1)
    onset_s = float(t[np.argmax(level <= level.min() + 0.01)]) if len(t) else float(edges[first])
    step = 1 / signal.rate_hz
    length = float(edges[last] if hit_s is None else hit_s) - onset_s
    size = Severity(
        quantity=CAUSES[CUT].quantity,
        value=length,
        low=max(length - flight.dt_s - step, 0.0),
        high=length + flight.dt_s + step,
        unit="s",
    )
    words = {"t": f"{onset_s:.2f}", "value": f"{length:.2f} s"}
    return Event(
        cause=CUT,
        onset_s=onset_s,
        severity=size,
        probability=SURE,
        alternatives=(Candidate(cause="pilot", rotor=None, probability=1 - SURE),),
        text=CAUSES[CUT].text.format(**words),
        bench_check=CAUSES[CUT].check,
    )
