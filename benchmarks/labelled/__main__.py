"""Labelled flights of others: `python -m benchmarks.labelled --data DATA`.

Asks every method about every flight of the index that is in DATA (else the folder in
`UAVTWIN_DATA`) and prints a table per set. `--page FILE` writes it between the marks of that page,
`--only SET` asks about one set. `--simulated HOURS` adds simulated flights without a fault,
`--seeds N` simulated faults of instruments, N flights of each kind and magnitude.
"""

import argparse
import os
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path

from twin.logs import Flight, read_flight
from twin.why.flight import FlightFrame

from .flights import Labelled, labelled, opened
from .instruments import faults, normal_flights
from .methods import METHODS, Asked
from .page import flight_rows, tables, write_between, write_flights
from .score import Said


def answers(flights: Iterable[tuple[Labelled, Flight]], data: Path) -> dict[str, list[Said]]:
    """What each method says of each flight."""
    said: dict[str, list[Said]] = {name: [] for name in METHODS}
    normal: dict[str, Flight] = {}
    for each, flight in flights:
        frame = FlightFrame.of(flight)
        hours = sum(p.flown - p.start for p in frame.airborne) * frame.dt_s / 3600.0
        references = [_read_once(normal, r, data) for r in each.references]
        asked = Asked(flight, frame, references, data / each.file)
        for name, method in METHODS.items():
            said[name].append(Said(each, method(asked), hours))
    return said


def _read_once(known: dict[str, Flight], file: str, data: Path) -> Flight:
    if file not in known:
        known[file] = read_flight(data / file)
    return known[file]


def main(arguments: Sequence[str] | None = None) -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=os.environ.get("UAVTWIN_DATA"))
    parser.add_argument("--page", type=Path)
    parser.add_argument("--only", default="")
    parser.add_argument("--simulated", type=float, default=0.0)
    parser.add_argument("--seeds", type=int, default=0)
    given = parser.parse_args(arguments)
    if given.data is None:
        parser.error("--data, or UAVTWIN_DATA: folder of the data")
    flights = [f for f in labelled() if given.only in f.set]
    data = Path(given.data)
    there = chain(opened(flights, data), normal_flights(given.simulated))
    said: Mapping[str, Sequence[Said]] = answers(there, data)
    text = tables(said, list(faults(given.seeds)))
    print(text)
    if given.page is not None:
        write_between(given.page, text)
        write_flights(given.page.with_suffix(".csv"), list(flight_rows(said)))


if __name__ == "__main__":
    main()
