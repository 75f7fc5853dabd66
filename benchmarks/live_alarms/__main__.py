"""Alarms while it flies: `python -m benchmarks.live_alarms --out OUT --jobs 2`.

Flies the cases and looks at each second by second; one JSON file per case in OUT, and those that
are there are not flown again. `--page FILE` writes the page of what is there. `--tuning`: the
flights on which the settings were chosen, instead of those of the score.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path

from .flights import MAGNITUDES, SIZES, Case, real_flights
from .page import page
from .run import evaluated, file_of, score_case, write_row

QUIET_S = 240.0
"""Length of a flight in which nothing begins, s. Made up."""
QUIET = 8
"""Flights of four minutes in which nothing begins."""
FIRST_SEED = 1000
"""Seeds below it are for tuning."""


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--seeds", type=int, default=4, help="of each effect, of medium size")
    parser.add_argument("--tuning", action="store_true", help="the flights of the tuning")
    parser.add_argument("--data", type=Path, help="recorded flights; without it, simulated alone")
    parser.add_argument("--page", type=Path, help="write the page of what is there, and no more")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    if given.page:
        rows = [json.loads(p.read_text()) for p in sorted(given.out.glob("*.json"))]
        given.page.write_text(page(rows), "utf-8")
        return 0
    if given.data:
        for name, flight, vehicle in real_flights(given.data):
            if file_of(given.out, name).exists():
                continue
            row = {"name": name, "magnitude": "real", "effect": "", **evaluated(flight, vehicle)}
            write_row(given.out, name, row)
        return 0
    every = cases(given.tuning, given.seeds)
    wanted = [c for c in every if not file_of(given.out, c.name).exists()]
    with ProcessPoolExecutor(given.jobs, get_context("spawn")) as pool:
        for k, name in enumerate(pool.map(score_case, repeat(given.out), wanted), start=1):
            print(f"{k}/{len(wanted)} {name}", file=sys.stderr)
    return 0


def cases(tuning: bool, seeds: int) -> Iterator[Case]:
    """Cases: medium ones first, then quiet ones, then the other sizes, of half of the seeds."""
    first = 0 if tuning else FIRST_SEED
    for seed in range(first, first + seeds):
        for effect in SIZES:
            yield Case(effect, "medium", seed)
    for seed in range(first, first + QUIET):
        yield Case("", "none", seed, QUIET_S)
    for seed in range(first, first + max(seeds // 2, 1)):
        for effect in (e for e in SIZES if e != "stuck_sensor"):
            for magnitude in (m for m in MAGNITUDES if m != "medium"):
                yield Case(effect, magnitude, seed)


if __name__ == "__main__":
    raise SystemExit(main())
