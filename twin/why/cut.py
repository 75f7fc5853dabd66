"""Commands that all drop to idle in the air: the body then does what they ask, so that no residual
shows it.

A failsafe, a kill switch, or a pilot. It is told from a landing by the free fall that follows: an
aircraft on the ground carries its weight.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from ..logs.stretches import stretches_where
from ..vehicle import GRAVITY_M_S2
from .causes import CAUSES, CUT
from .findings import Findings
from .flight import FlightFrame, lift
from .records import Candidate, Event, Severity

IDLE = 0.12
"""Share of the usual thrust by command below which every motor idles."""
FALLS_G, FALLS_S = 0.5, 0.15
"""Specific force of a body that falls, over gravity, and for how long: rotors run down for as much
of it as they need."""
DROPS_S = 0.3
"""In which commands drop from half the usual thrust: a slow descent is none."""
SURE = 0.85
"""Probability that commands and not the pilot's throttle did it: a judgement."""


def cut(flight: FlightFrame, references: Sequence[FlightFrame] = ()) -> Findings:
    """Cuts of all commands while the aircraft is in the air."""
    if flight.drive is None or "acc" not in flight.grid:
        return Findings()
    events = list(_events(flight))
    return Findings(events=events, nothing=(1 - SURE) ** len(events))


def _events(flight: FlightFrame) -> Iterator[Event]:
    """Within the flight: what falls is in the air."""
    if not flight.airborne:
        return
    raised = lift(flight.grid[flight.drive or ""])
    force = np.linalg.norm(flight.grid["acc"], axis=1) / GRAVITY_M_S2
    flown = [raised[p.start : p.flown].mean(axis=1) for p in flight.airborne]
    usual, start = float(np.median(np.concatenate(flown))), flight.airborne[0].start
    for a, z in stretches_where(raised[start:].max(axis=1) < IDLE * usual):
        first, last = start + a, start + z
        falls = force[first : last + flight.places(FALLS_S)] < FALLS_G
        if falls.sum() >= max(flight.places(FALLS_S), 1) and _drops(flight, first, usual):
            yield _event(flight, first, last)


def _drops(flight: FlightFrame, first: int, usual: float) -> bool:
    """Whether commands were at half of the usual thrust just before."""
    back = max(first - flight.places(DROPS_S) - 1, 0)
    before = lift(flight.grid[flight.drive or ""][back:first]).mean(axis=1)
    return bool(len(before) and before.max() > 0.5 * usual)


def _event(flight: FlightFrame, first: int, last: int) -> Event:
    signal = flight.signals[flight.drive or ""]
    edges = flight.edges_s
    near = (signal.t_s > edges[first] - flight.dt_s) & (signal.t_s <= edges[first + 1])
    t, level = signal.t_s[near], signal.values[near].max(axis=1)
    onset_s = float(t[np.argmax(level <= level.min() + 0.01)]) if len(t) else float(edges[first])
    step = 1 / signal.rate_hz
    length = float(edges[last] - onset_s)
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
