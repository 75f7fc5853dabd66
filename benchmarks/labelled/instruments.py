"""Faults of instruments that begin in simulated flights, and simulated flights without a fault.

Closed-loop flights of the built-in vehicles in wind, of `benchmarks.live_alarms`; the seeds are
others than those on which thresholds were looked at.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.live_alarms.flights import MAGNITUDES, Case, flown
from twin.logs import Flight
from twin.logs.columns import ACC, GYRO, MAG
from twin.why.flight import FlightFrame
from twin.why.records import Event
from twin.why.sensors import sensors

from .flights import NORMAL, Labelled

KINDS = ("gyro_bias", "accel_bias", "mag_hard_iron", "baro_bias", "stuck_sensor")
"""Faults, by the effect that begins."""
FIRST_SEED = 2000
"""Seeds below were looked at."""
NORMAL_S = 180.0
"""Length of a flight without a fault."""
SETTLED_S = 10.0
"""By which the rule of one line compares: the first such stretch in the air, and the last."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What is said of a fault.

    Attributes:
        kind: Of the fault.
        magnitude: Of the fault.
        named: Whether it was named, as the only cause.
        wrong: Whether something else was named.
        onset_s: Error of the onset; None: not named.
        rule: Whether the rule of one line names the instrument.
    """

    kind: str
    magnitude: str
    named: bool
    wrong: bool
    onset_s: float | None
    rule: bool


def faults(seeds: int) -> Iterator[Outcome]:
    """Each kind in three magnitudes, so many seeds each."""
    for kind in KINDS:
        for magnitude in MAGNITUDES[2:] if kind == "stuck_sensor" else MAGNITUDES:
            for seed in range(FIRST_SEED, FIRST_SEED + seeds):
                flight, begins_s = flown(Case(kind, magnitude, seed))
                yield _outcome(kind, magnitude, flight, begins_s)


def normal_flights(hours: float) -> Iterator[tuple[Labelled, Flight]]:
    """Flights in which nothing begins."""
    for seed in range(FIRST_SEED, FIRST_SEED + round(hours * 3600.0 / NORMAL_S)):
        flight, _ = flown(Case("", "none", seed, NORMAL_S))
        empty = dict.fromkeys(("repository", "commit", "path", "sha256", "licence"), "")
        yield (
            Labelled(
                file=f"seed_{seed}",
                set="simulated",
                label=NORMAL,
                rotors=frozenset(),
                onset_s=None,
                references=(),
                **empty,
            ),
            flight,
        )


def _outcome(kind: str, magnitude: str, flight: Flight, begins_s: float) -> Outcome:
    causes = [e for e in sensors(FlightFrame.of(flight)).events if not e.consequence]
    right = [e for e in causes if e.cause == kind]
    late = _late(right[0], begins_s) if right else None
    wrong = any(e.cause != kind for e in causes)
    rule = _loudest(flight) == kind.split("_")[0]
    return Outcome(kind, magnitude, bool(right), wrong, late, rule)


def _late(event: Event, begins_s: float) -> float | None:
    return None if event.onset_s is None else event.onset_s - begins_s


def _loudest(flight: Flight) -> str:
    """The rule of one line: the instrument whose mean moves most from the first ten seconds to the
    last, in deviations of the first."""
    moved = {}
    for name, columns in {"gyro": GYRO, "accel": ACC, "mag": MAG, "baro": ("baro_pa",)}.items():
        t, v = flight.signal(columns)
        first = v[(t > t[0] + SETTLED_S) & (t < t[0] + 2 * SETTLED_S)]
        last = v[t > t[-1] - SETTLED_S]
        spread = first.std(axis=0) + 1e-12
        moved[name] = float((np.abs(last.mean(axis=0) - first.mean(axis=0)) / spread).max())
    return max(moved, key=lambda n: moved[n])


def table(outcomes: Sequence[Outcome]) -> Iterator[str]:
    """A row per kind and magnitude."""
    yield "| fault | magnitude | flights | named | another name | onset, median error s | rule |"
    yield "|" + "---|" * 7
    for key in dict.fromkeys((o.kind, o.magnitude) for o in outcomes):
        rows = [o for o in outcomes if (o.kind, o.magnitude) == key]
        late = [abs(o.onset_s) for o in rows if o.onset_s is not None]
        onset = f"{np.median(late):.2f}" if late else "-"
        n, wrong, rule = (sum(getattr(o, k) for o in rows) for k in ("named", "wrong", "rule"))
        yield f"| `{key[0]}` | {key[1]} | {len(rows)} | {n} | {wrong} | {onset} | {rule} |"
