"""What a learned force is worth, as a page; `docs/_generate/learned_force.py` calls it.

One rotation is one file in the cache, used again as long as flights and sources are the same, so a
run that was cut short goes on where it stopped.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.compensator.simulated import produce
from benchmarks.hidden_effects.files import write_json
from benchmarks.real_flights.__main__ import ONE_THREAD

from .measure import key, measure
from .page import page
from .rotations import FINER, GROUPS, MOVING, Places, Rotation, finer_aircraft, rotations

ROOT = Path(__file__).parents[2]


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit code 2 without the recordings."""
    parser = argparse.ArgumentParser(
        prog="docs/_generate/learned_force.py", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--data", type=Path, required=True, help="folder of the recordings")
    parser.add_argument(
        "--out", type=Path, default=ROOT / "docs" / "results" / "learned_force.md", help="page"
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument(
        "--work", type=Path, default=ROOT / "out" / "learned_force", help="folder of what was found"
    )
    parser.add_argument("--only", choices=GROUPS, action="append", help="these groups")
    options = parser.parse_args(arguments)
    places = Places(options.data, options.work)
    groups = options.only or GROUPS
    if not {FINER, MOVING}.isdisjoint(groups):
        produce(options.work, finer_aircraft())
    wanted = rotations(groups)
    needed = [f for r in wanted for some in r.files(places) for f in some]
    absent = [f for f in needed if not f.is_file()]
    if absent:
        print(f"no {absent[0]}; give the folder of the recordings by --data", file=sys.stderr)
        return 2
    options.out.write_text(page(run(wanted, places, options.jobs)), "utf-8")
    return 0


def run(wanted: Sequence[Rotation], places: Places, jobs: int) -> list[dict[str, Any]]:
    """Every rotation, from the cache where it is there."""
    files = [places.work / f"{key(r, places)}.json" for r in wanted]
    missing = [i for i, f in enumerate(files) if not f.is_file()]
    print(f"{len(files)} rotations, {len(files) - len(missing)} there already", file=sys.stderr)
    for name in ONE_THREAD:  # a process per core; sums come out the same on every machine
        os.environ[name] = "1"
    start = time.perf_counter()
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        waiting = {pool.submit(measure, wanted[i], places): i for i in missing}
        for done, future in enumerate(as_completed(waiting), start=1):
            i = waiting[future]
            if future.exception() is not None:  # what is not begun is not begun any more
                print(f"{wanted[i].group} {wanted[i].name}: failed", file=sys.stderr, flush=True)
                pool.shutdown(cancel_futures=True)
            said = future.result()
            write_json(files[i], said)
            left = (time.perf_counter() - start) / done * (len(missing) - done)
            print(
                f"{done}/{len(missing)} {said['group']} {said['name']}: "
                f"{said['evaluation']['claim']} {said['seconds']['all']:.0f} s; {left:.0f} s left",
                file=sys.stderr,
                flush=True,
            )
    return [json.loads(f.read_text("utf-8")) for f in files]


if __name__ == "__main__":
    raise SystemExit(main())
