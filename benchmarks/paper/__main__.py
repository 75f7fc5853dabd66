"""Train the systems of the paper's tables and keep their scores: `python -m benchmarks.paper`.

    python -m benchmarks.paper --data D --out OUT [--only II] [--figures]

D holds the paper's residual tables (takeoff_flight1.parquet, ...). A run that is done is not done
again; rows of the tables replace those in docs/results/paper_scores.jsonl, from which
docs/_generate/paper.py prints the pages. `--figures` trains for no table, but what the paper's
figures 5 to 13 are drawn from, and writes them: OUT/figures.html.
"""

import argparse
import subprocess
import sys
from pathlib import Path

from learning.preset import BEST, PAPER

from . import comparison as paper
from .edge import costs, exported_ours, usage, usage_figure
from .figures import (
    Figures,
    FlightCorrections,
    best_systems,
    by_share,
    comparison,
    figures_page,
    improvements,
    timelines,
)
from .missions import real_missions, simulated_missions
from .trainings import SYSTEMS, paper_flights, run_all

EDGE = "IV"
"""Table that needs no training."""


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder of the paper's tables")
    parser.add_argument("--out", type=Path, required=True, help="folder of what is half done")
    parser.add_argument("--only", action="append", choices=(*paper.TABLES, EDGE))
    parser.add_argument("--epochs", type=int, help="of every run; default: the preset's")
    parser.add_argument("--seeds", type=int, default=1, help="of each row")
    parser.add_argument("--seeds-paper", type=int, help="of the paper's preset; default: as many")
    parser.add_argument("--share", type=float, action="append", help="of the data, in Table II")
    parser.add_argument("--jobs", type=int, default=1, help="trainings at a time, one thread each")
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda", "auto"))
    parser.add_argument("--scores", type=Path, default=paper.SCORES, help="file of the rows")
    parser.add_argument("--figures", action="store_true", help="write OUT/figures.html instead")
    given = parser.parse_args(arguments)
    shares = tuple(given.share or paper.SHARES["table2"])
    options = paper.Options(given.epochs, given.seeds, shares, given.seeds_paper)
    if given.figures:
        page = figures_page(figures(given.data, given.out, given.epochs, given.jobs))
        (given.out / "figures.html").write_text(page, "utf-8")
        return 0
    commit = _commit()
    for table in given.only or (*paper.TABLES, EDGE):
        print(f"Table {table}:", file=sys.stderr)
        if table == EDGE:
            rows = [
                {"table": EDGE, "row": c.name, "commit": commit, **c.scores()}
                for c in costs(given.out / "onnx")
            ]
        else:
            runs = paper.TABLES[table](options)
            found = run_all(given.data, given.out, runs, given.jobs, given.device)
            rows = paper.rows_of(table, found, commit)
        paper.write_rows(rows, given.scores)
    return 0


def figures(tables: Path, work: Path, epochs: int | None, jobs: int) -> Figures:
    """All of the paper's that are drawn; what has not been trained yet is.

    Args:
        tables: Folder of the paper's tables.
        work: Folder of what is half done.
        epochs: Of every run; None: the preset's.
        jobs: Trainings at a time.
    """
    flights = paper_flights(tables)
    options = paper.Options(epochs, seeds=1, shares=(1.0,))
    runs = {r.name: r for r in paper.table2(options) if r.role == "reconstruct"}
    run_all(tables, work, list(runs.values()), jobs)
    said = paper.corrections(list(runs.values()), work)
    ours = (PAPER.name, BEST.name)
    compared = {n: s for n, s in said.items() if n in (*ours, *SYSTEMS)}
    best = FlightCorrections.of(flights, compared).best()
    aged = [r for r in paper.needed(options) if r.role == "track" and r.name == BEST.name]
    run_all(tables, work, aged, jobs)
    folder = work / "missions"
    asked = [runs[n] for n in dict.fromkeys([*ours, *best])]
    seen = {**real_missions(flights, said), **simulated_missions(folder, asked, jobs)}
    late = {
        **real_missions(flights, paper.corrections(aged, work, "track")),
        **simulated_missions(folder, aged, jobs),
    }
    rows = [r for r in paper.read_rows() if r["table"] == "ablations"]
    variants = [r for r in rows if r["row"].startswith(f"{BEST.name}: ")]
    used = {n: usage(file) for n, (_, file) in exported_ours(work / "onnx").items()}
    ways = {
        f"{BEST.name}, given the residual": (seen, BEST.name),
        f"{PAPER.name}, given the residual": (seen, PAPER.name),
        f"{BEST.name}, given that of ten samples ago": (late, BEST.name),
    }
    return {
        **comparison(flights, compared),
        "missions": ("Figure 9: four missions, as corrected by best", timelines(seen, BEST.name)),
        "improvements": ("Figure 10: improvement per sensor", improvements(ways)),
        "best_systems": ("Figure 11: the four best systems", best_systems(seen, best)),
        "ablations": ("Figure 12: variants of best by share of the data", by_share(variants)),
        "usage": ("Figure 13: processor and memory over a run, onnxruntime", usage_figure(used)),
    }


def _commit() -> str:
    """Of the code that trains."""
    command, here = ["git", "rev-parse", "--short", "HEAD"], Path(__file__).parent
    said = subprocess.run(command, cwd=here, check=True, capture_output=True, text=True)
    return said.stdout.strip()


if __name__ == "__main__":
    raise SystemExit(main())
