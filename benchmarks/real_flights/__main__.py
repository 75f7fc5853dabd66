"""What `twin.explain` says about recorded flights, as a page.

`docs/_generate/real_flights.py` calls it.

One rotation is one file in the cache. It is used again as long as flights, vehicle file, converter,
`twin/` and the measuring itself are the same, so a run that was cut short goes on where it stopped.
"""

import argparse
import hashlib
import json
import os
import sys
import time
import traceback
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from datetime import date
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.hidden_effects.files import write_json
from benchmarks.hidden_effects.run import failure, twin_state

from .measure import measure
from .page import details, state
from .rows import read_rows, renewed, rows, short_page, write_rows
from .scenarios import SCENARIOS, Scenario, sources

HERE = Path(__file__).parent
CACHE = HERE.parents[1] / "out" / "real_flights"
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
Rotation = tuple[Scenario, str]


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit code 1 when a rotation failed, 2 without the recordings."""
    parser = argparse.ArgumentParser(
        prog="docs/_generate/real_flights.py", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--data", type=Path, help="folder of the recordings")
    parser.add_argument("--out", type=Path, required=True, help="Markdown file to write")
    parser.add_argument("--stored", action="store_true", help="from the rows beside the page")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--cache", type=Path, default=CACHE, help="folder of what was found")
    names = [s.name for s in SCENARIOS]
    parser.add_argument("--only", choices=names, action="append", help="these scenarios")
    options = parser.parse_args(arguments)
    data = options.out.with_suffix(".jsonl")
    if options.stored:
        options.out.write_text(short_page(read_rows(data), data.name), "utf-8")
        return 0
    if options.data is None:
        parser.error("give the folder of the recordings by --data, or --stored")
    chosen = [s for s in SCENARIOS if options.only is None or s.name in options.only]
    absent = [f for s in chosen for f in s.flights if not (options.data / f).is_file()]
    if absent:
        print(f"{options.data}: no {absent[0]}; give the folder by --data", file=sys.stderr)
        return 2
    cases = run(options.data, chosen, options.cache, options.jobs)
    found = [(s, [cases[s.name, f] for f in s.flights]) for s in chosen]
    facts = {"measured": f"{date.today():%d %B %Y}", "note": "", "state": state(found)}
    new, stored = list(rows(details(found))), read_rows(data) if data.is_file() else []
    if options.only and stored:
        when = f"measured on {facts['measured']}. {facts['state']}"
        write_rows(data, renewed(stored, new, when))
    else:
        write_rows(data, [facts, *new])
    options.out.write_text(short_page(read_rows(data), data.name), "utf-8")
    return 1 if any(c["said"]["verdict"] == "error" for c in cases.values()) else 0


def run(
    data: Path, scenarios: Sequence[Scenario], cache: Path, jobs: int
) -> dict[tuple[str, str], dict[str, Any]]:
    """Every rotation, (scenario, flight held out) -> content; from the cache where it is there."""
    state = twin_state()
    files = {
        (s.name, f): cache / f"{key(data, s, f, state)}.json" for s in scenarios for f in s.flights
    }
    rotations = {(s.name, f): (s, f) for s in scenarios for f in s.flights}
    found = {k: json.loads(p.read_text("utf-8")) for k, p in files.items() if p.is_file()}
    missing = [k for k in rotations if k not in found]
    print(f"{len(rotations)} rotations, {len(found)} there already", file=sys.stderr)
    if not missing:
        return found
    for name in ONE_THREAD:  # a process per core; sums come out the same on every machine
        os.environ[name] = "1"
    start = time.perf_counter()
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        waiting = {pool.submit(answer, data, rotations[k]): k for k in missing}
        for done, future in enumerate(as_completed(waiting), start=1):
            k, said = waiting[future], {**future.result(), "twin": state}
            found[k] = said
            if said["said"]["verdict"] != "error":
                write_json(files[k], said)
            left = (time.perf_counter() - start) / done * (len(missing) - done)
            print(
                f"{done}/{len(missing)} {k[0]} without {said['holdout']}: "
                f"{said['said']['verdict']}, {said['seconds']:.0f} s; {left:.0f} s left",
                file=sys.stderr,
                flush=True,
            )
    if twin_state() != state:
        print("twin/ has changed meanwhile: run it again", file=sys.stderr)
    return found


def answer(data: Path, rotation: Rotation) -> dict[str, Any]:
    """What is said about a rotation; an exception becomes the verdict "error"."""
    scenario, holdout = rotation
    try:
        return measure(data, scenario, holdout)
    except Exception as error:
        traceback.print_exc()
        said = failure(f"{type(error).__name__}: {error}")
        name = Path(holdout).stem
        empty: dict[str, Any] = {"numbers": {}, "predicted": {}, "channels": [], "braking": None}
        return {"scenario": scenario.name, "holdout": name, "said": said, "seconds": 0.0, **empty}


def key(data: Path, scenario: Scenario, holdout: str, state: str) -> str:
    """Name of a rotation and hash of all that it depends on, `state` of `twin/` included."""
    digest = hashlib.sha256(state.encode())
    digest.update(f"{scenario.vehicle_text}{scenario.indoors}".encode())
    scripts = {p for f in scenario.flights for p in sources(f)}
    for path in [HERE / "measure.py", *sorted(scripts)]:
        digest.update(path.read_bytes())
    for flight in (*scenario.flights, holdout):
        digest.update(flight.encode() + (data / flight).read_bytes())
    return f"{scenario.name}.{Path(holdout).stem}.{digest.hexdigest()[:12]}"


if __name__ == "__main__":
    raise SystemExit(main())
