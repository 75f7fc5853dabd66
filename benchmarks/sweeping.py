"""Many runs of a sweep: `python -m benchmarks.sweeping --runs 10000 --kills 20 --out OUT`.

Twenty seconds of the built-in aircraft's tour in wind, with another mass and drag in each run:
first without kills, then the same again with kills, whose table must be the same to the last byte;
then a tenth of the runs with one process, for the ratio.
"""

import argparse
import json
import shutil
from pathlib import Path
from typing import Any

from uavtwin.sweeps.outcome import JOURNAL

from .watched import watched

SWEEP = (
    *("sweep", "tour", "--duration", "20", "--seed", "1"),
    *("--vary", "airframe.mass=1.4:1.8", "--vary", "wind.speed=0:8"),
    *("--vary", "effect.rotor_drag.k_xy_1_s=0.1:0.6"),
)
TABLE = "runs.parquet"


def main() -> int:
    """Command line; 1: the tables differ."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--runs", type=int, default=10_000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--kills", type=int, default=20)
    given = parser.parse_args()
    found = {
        "whole": flown(given.out / "whole", given.runs, given.workers, 0),
        "killed": flown(given.out / "killed", given.runs, given.workers, given.kills),
    }
    few = max(1, given.runs // 10)
    found["few"] = flown(given.out / "few", few, given.workers, 0)
    found["few, one process"] = flown(given.out / "one", few, 1, 0)
    one, all_ = (found[k]["wall_s"] for k in ("few, one process", "few"))
    same = [
        (given.out / a / TABLE).read_bytes() == (given.out / b / TABLE).read_bytes()
        for a, b in (("whole", "killed"), ("few", "one"))
    ]
    told = {"runs": given.runs, "faster_than_one_process": one / all_, "same_bytes": same, **found}
    (given.out / "benchmark.json").write_text(json.dumps(told, indent=2), "utf-8")
    print(json.dumps(told, indent=2))
    return 0 if all(same) else 1


def flown(out: Path, runs: int, workers: int, kills: int) -> dict[str, Any]:
    """What the sweep costs."""
    shutil.rmtree(out, ignore_errors=True)
    count = ("--runs", str(runs), "--workers", str(workers), "--out", str(out))
    most = max(1, runs // max(1, kills))
    return watched([*SWEEP, *count], out, out / JOURNAL, kills, (1, most))


if __name__ == "__main__":
    raise SystemExit(main())
