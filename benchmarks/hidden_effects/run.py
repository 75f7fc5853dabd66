"""Let `uavtwin explain` look at every case: `python -m benchmarks.hidden_effects.run DIR`.

It is given the folder of one case and writes to DIR/results/ID; the truth lies elsewhere. Cases
with a result are skipped, so a run that was cut short goes on where it stopped.
"""

import argparse
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

LONGEST_S = 900


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit code 1 when a case gave no result."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("dir", type=Path)
    parser.add_argument("--jobs", type=int, default=1, help="cases at the same time")
    options = parser.parse_args(arguments)
    results = options.dir.resolve() / "results"
    folders = sorted(p for p in (options.dir / "flights").iterdir() if p.is_dir())
    missing = [f for f in folders if not (results / f.name / "explain.json").is_file()]
    print(f"{len(folders)} cases, {len(folders) - len(missing)} there already", file=sys.stderr)
    start, failed = time.perf_counter(), 0
    with ThreadPoolExecutor(options.jobs) as pool:
        jobs = pool.map(lambda folder: explain(folder, results / folder.name), missing)
        for done, problem in enumerate(jobs, start=1):
            failed += bool(problem)
            spent = time.perf_counter() - start
            print(f"{done}/{len(missing)} {spent:.0f} s {problem}".rstrip(), file=sys.stderr)
    return 1 if failed else 0


def explain(folder: Path, out: Path) -> str:
    """Explain one case; returns what went wrong, "" when nothing did."""
    command = [
        *(sys.executable, "-c", "from cosim.cli import main; main()"),
        *("explain", "fit_1.parquet", "fit_2.parquet"),
        *("--holdout", "holdout_1.parquet", "--vehicle", "vehicle.toml"),
        *("--out", str(out), "--force"),
    ]
    try:
        run = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, timeout=LONGEST_S, check=False
        )
    except subprocess.TimeoutExpired:
        return f"{folder.name}: longer than {LONGEST_S} s"
    if (out / "explain.json").is_file():
        return ""
    lines = run.stderr.strip().splitlines() or ["no message"]
    return f"{folder.name}: exit code {run.returncode}: {lines[-1]}"


if __name__ == "__main__":
    raise SystemExit(main())
