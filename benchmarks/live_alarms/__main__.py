"""Alarms while it flies: `python -m benchmarks.live_alarms [--data DATA] [--page PAGE]`.

Flights are fed to `twin.why.watch` second by second: recorded ones of the labelled sets (rotor 1
stops in seven; twenty clean ones), and planted ones of `benchmarks.sudden_faults`. What is said
first stands beside the first event that `why` finds in the whole log, and the trivial rule: when
the outputs part by 150 us after six seconds of flight, the highest is the failed rotor.
"""

import argparse
import csv
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.sudden_faults.__main__ import SCORED
from benchmarks.sudden_faults.built_in import Planted
from twin.errors import TwinError
from twin.logs import Flight, read_flight
from twin.vehicle import Vehicle
from twin.why.diagnose import diagnose
from twin.why.flight import FlightFrame
from twin.why.records import Event
from twin.why.rules import parted_outputs
from twin.why.watch import PASSING, PERIOD_S, Alarm, Watch

INDEX = Path(__file__).parents[1] / "labelled" / "index.csv"
"""Of recorded flights."""
SETS = ("rflymad_sil", "clean", "px4_negatives")
"""Of it, those that are looked at."""
PLANTED = (("rotor_failure", 0.2), ("rotor_failure", 0.5), ("rotor_failure", 1.0), ("", 0.0))
"""Cause and size of planted flights, of three seeds each; "": nothing, 120 s."""
BEGIN, END = "<!-- benchmarks.live_alarms: begin -->", "<!-- benchmarks.live_alarms: end -->"
"""Marks of the generated part of the page."""


@dataclass(frozen=True)
class Said:
    """What was said of one flight.

    Attributes:
        name: Of the flight.
        set: Of which set.
        truth: What began, and when; "" for nothing.
        alarms: All that were raised, in order, as they were at the end.
        event: The first event of the log that nothing explains; None: there is none.
        rule: What the trivial rule reads.
        flown_s: Time that was looked at.
        busy: Processor over time of flight.
    """

    name: str
    set: str
    truth: str
    alarms: tuple[Alarm, ...]
    event: Event | None
    rule: str
    flown_s: float
    busy: float

    @property
    def same(self) -> bool:
        """Whether the first alarm that was not withdrawn is the first event of the log."""
        stood = (a.event for a in self.alarms if a.closed_s is None or a.event.cause in PASSING)
        first = next(stood, None)
        if first is None or self.event is None:
            return first is self.event
        key = ("cause", "rotor", "sensor")
        return all(getattr(first, k) == getattr(self.event, k) for k in key)


def watched(flight: Flight, vehicle: Vehicle | None = None) -> tuple[tuple[Alarm, ...], float]:
    """Alarms of a flight that is fed look by look, and processor time over time of flight."""
    watch, known, began = Watch(vehicle), dict[tuple[float, str], Alarm](), time.process_time()
    t, columns, first = flight.time_s, flight.columns, 0
    for end in np.searchsorted(t, np.arange(t[0] + PERIOD_S, t[-1] + PERIOD_S, PERIOD_S)):
        watch.push({c: v[first:end] for c, v in columns.items()})
        first = int(end)
        known |= {(a.raised_s, a.event.cause): a for a in watch.evaluate()}
    return tuple(known.values()), (time.process_time() - began) / float(t[-1] - t[0])


def said_of(flight: Flight, of_set: str, truth: str = "", vehicle: Vehicle | None = None) -> Said:
    """What is said of a flight on the stream, in the log, and by the rule."""
    alarms, busy = watched(flight, vehicle)
    events = [e for e in diagnose(flight).events if e.onset_s is not None and not e.consequence]
    rule = parted_outputs(FlightFrame.of(flight))
    return Said(
        flight.name,
        of_set,
        truth,
        alarms,
        events[0] if events else None,
        "-" if rule is None else f"rotor {rule.rotor}, {rule.t_s:.2f} s",
        float(flight.time_s[-1] - flight.time_s[0]),
        busy,
    )


def recorded(data: Path) -> Iterator[Said]:
    """Flights of the index that are there."""
    for row in csv.DictReader(INDEX.open(encoding="utf-8")):
        if row["set"] not in SETS or not (data / row["file"]).is_file():
            continue
        try:
            flight = read_flight(data / row["file"])
            truth = "rotor 1 stops" if row["set"] == SETS[0] else ""
            yield said_of(flight, row["set"], truth)
        except TwinError as error:
            print(error)


def planted(seeds: int) -> Iterator[Said]:
    """Flights of our own plants."""
    for cause, size in PLANTED:
        for seed in range(SCORED, SCORED + seeds):
            case = Planted(cause, size, seed)
            flight, begins_s, rotor = case.flown()
            truth = f"rotor {rotor} loses {100 * size:.0f} %, {begins_s:.2f} s" if cause else ""
            yield said_of(flight, "planted", truth, case.vehicle)


def lines(rows: list[Said]) -> Iterator[str]:
    """Table and sums."""
    yield "| flight | what began | alarms | raised | first event of the log | rule |"
    yield "|---|---|---|---|---|---|"
    for r in rows:
        names = "; ".join(map(_named, r.alarms)) or "none"
        raised = "; ".join(f"{a.raised_s:.1f} s" for a in r.alarms)
        log = "none" if r.event is None else _of(r.event)
        yield f"| {r.name} | {r.truth or 'nothing known'} | {names} | {raised} | {log} | {r.rule} |"
    same, hours = sum(r.same for r in rows), sum(r.flown_s for r in rows if not r.truth) / 3600
    false = sum(len(r.alarms) for r in rows if not r.truth)
    busy = np.array([r.busy for r in rows])
    yield ""
    yield f"First alarm, and first event of the log alike: {same} of {len(rows)}. "
    yield f"Alarms where nothing is known to begin: {false} in {hours:.2f} h. Processor per second "
    yield f"of flight: {np.mean(busy):.2f} s in the mean, {busy.max():.2f} s at the most."


def _named(alarm: Alarm) -> str:
    return _of(alarm.event) + (" (over)" if alarm.closed_s is not None else "")


def _of(event: Event) -> str:
    which = f" {event.rotor[0]}" if event.rotor else f" {event.sensor}" if event.sensor else ""
    when = "" if event.onset_s is None else f", {event.onset_s:.2f} s"
    return f"{event.cause.replace('_', ' ')}{which}{when}"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, help="folder of recorded flights")
    parser.add_argument("--seeds", type=int, default=3, help="of each planted fault")
    parser.add_argument("--page", type=Path, help="page whose generated part is written")
    given = parser.parse_args()
    rows = [*(recorded(given.data) if given.data else ()), *planted(given.seeds)]
    text = "\n".join(lines(rows))
    if given.page is None:
        print(text)
        return
    page = given.page.read_text("utf-8")
    head, tail = page.split(BEGIN)[0], page.split(END)[1]
    given.page.write_text(f"{head}{BEGIN}\n{text}\n{END}{tail}", "utf-8")


if __name__ == "__main__":
    main()
