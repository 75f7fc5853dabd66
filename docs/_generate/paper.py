"""Write results/paper.md, paper_weights.md, paper_less_data.md and paper_published.md: the paper's
tables; and WORK/figures.html: its figures.

    python docs/_generate/paper.py --data ../shared/data --work out/paper

Runs what is not done yet, some hours on two cores; it may be stopped and goes on from there.
`--page` picks one page, and fewer `--seeds` make less.
"""

import argparse
import os
import platform
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import jinja2

sys.path.insert(
    0, str(Path(__file__).parents[2])
)  # benchmarks are no part of the installed package

from benchmarks.paper import comparison as paper
from benchmarks.paper import edge
from benchmarks.paper.edge import usage, usage_figure
from benchmarks.paper.figures import (
    Figures,
    FlightCorrections,
    best_systems,
    by_sensor,
    by_share,
    comparison,
    figures_page,
    improvements,
    timelines,
)
from benchmarks.paper.missions import real_missions, simulated_missions
from benchmarks.paper.trainings import pack_scores, paper_flights, run_all, unpack_scores
from learning.compute import device_named
from learning.preset import BEST, PAPER

OURS = (PAPER.name, BEST.name)
EPOCHS = 12
"""Of the tables with many variants."""
NEEDED_EPOCHS = 50
"""Of that of the protocols in which the answer is not given."""


PAGES = {
    "paper": ("table2", "needed", "samples", "ablations"),
    "paper_weights": ("weights",),
    "paper_less_data": ("table2",),
    "paper_published": ("published",),
}
"""Names of the pages, of their templates and of the tables that each shows."""


SCORES = Path(__file__).parents[1] / "results" / "paper_runs.jsonl"
"""Of every training that the pages show: what was trained is not trained again elsewhere."""


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder of the recorded flights")
    parser.add_argument("--work", type=Path, required=True, help="folder of what is half done")
    parser.add_argument("--page", choices=PAGES, action="append", help="default: all")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--device", default="cpu", help="to train on: cpu, cuda or auto")
    parser.add_argument("--seeds", type=int, default=1, help="of Table II")
    parser.add_argument("--seeds-table3", type=int, default=3, help="of Table III")
    parser.add_argument("--seeds-table5", type=int, default=3, help="of Table V")
    parser.add_argument("--seeds-paper", type=int, help="of the paper's preset in Table V")
    given = parser.parse_args()
    if "paper" not in (given.page or PAGES):  # whose figures need more than scores
        unpack_scores(SCORES, given.work)
    for page in given.page or PAGES:
        _write(page, given)
    pack_scores(given.work, SCORES)
    if "paper" in (given.page or PAGES):
        tables = given.data / "rflysimdt" / "paper_residuals"
        page = figures_page(_figures(tables, given.work, given.jobs))
        (given.work / "figures.html").write_text(page, "utf-8")


def _write(page: str, given: argparse.Namespace) -> None:
    """Make the tables of a page, and the page."""
    seeds = f"--seeds={given.seeds}"
    fifth = [f"--seeds={given.seeds_table5}"]
    fifth += [] if given.seeds_paper is None else [f"--seeds-paper={given.seeds_paper}"]
    shares = ("--share=1",) if page == "paper" else ("--share=0.5", "--share=0.25")
    asked = {
        "table2": [seeds, *shares],
        "needed": [f"--epochs={NEEDED_EPOCHS}"],
        "samples": [f"--seeds={given.seeds_table3}"],
        "weights": fifth,
        "published": [],
        "ablations": [f"--epochs={EPOCHS}"],
    }
    text = {}
    for name in PAGES[page]:
        paper.main(
            [
                f"--data={given.data / 'rflysimdt' / 'paper_residuals'}",
                f"--out={given.work}",
                f"--jobs={given.jobs}",
                f"--device={given.device}",
                f"--only={name}",
                *asked[name],
            ]
        )
        text[name] = (given.work / "paper.md").read_text("utf-8")
    if page == "paper":
        edge.main([f"--out={given.work}"])
        text["edge"] = (given.work / "edge.md").read_text("utf-8")
    environment = jinja2.Environment(
        keep_trailing_newline=True, trim_blocks=True, undefined=jinja2.StrictUndefined
    )
    template = Path(paper.__file__).with_name(f"{page}.md.j2").read_text("utf-8")
    filled = environment.from_string(template).render(
        options=" ".join([f"--page={page}", *_told(page, given)]),
        commit=_commit(),
        machine=f"{os.cpu_count()} cores, {_processor()}",
        device=device_named(given.device).type,
        needed_epochs=NEEDED_EPOCHS,
        epochs=EPOCHS,
        **text,
    )
    (Path(__file__).parents[1] / "results" / f"{page}.md").write_text(filled, "utf-8")


def _told(page: str, given: argparse.Namespace) -> list[str]:
    """Options that decide what a page holds, as they are written."""
    if page == "paper_published":
        return []
    if page == "paper_weights":
        own = [] if given.seeds_paper is None else [f"--seeds-paper={given.seeds_paper}"]
        return [f"--seeds-table5={given.seeds_table5}", *own]
    third = [f"--seeds-table3={given.seeds_table3}"] if page == "paper" else []
    return [f"--seeds={given.seeds}", *third]


def _figures(tables: Path, work: Path, jobs: int) -> Figures:
    """All of the paper's that are drawn, of trainings that are done but for the missions'."""
    flights = paper_flights(tables)
    options = paper.Options(None, seeds=1, shares=(1.0,))
    runs = {r.name: r for r in paper.table2(options) if r.protocol == "reconstruct"}
    said = paper.corrections(list(runs.values()), work)
    compared = {n: s for n, s in said.items() if n in (*OURS, *paper.COMPARED)}
    best = FlightCorrections.of(flights, compared).best()
    old = replace(options, epochs=NEEDED_EPOCHS)
    aged = [r for r in paper.needed(old) if r.protocol == "track" and r.name == BEST.name]
    folder = work / "missions"
    asked = [runs[n] for n in dict.fromkeys([*OURS, *best])]
    given = {**real_missions(flights, said), **simulated_missions(folder, asked, jobs)}
    late = {
        **real_missions(flights, paper.corrections(aged, work, "track")),
        **simulated_missions(folder, aged, jobs),
    }
    variants = paper.ablations(replace(options, epochs=EPOCHS))
    ours = [r for r in variants if r.name.startswith(f"{BEST.name}: ")]
    used = {n: usage(work / "onnx" / f"{n}.onnx") for n in OURS}
    ways = {
        f"{BEST.name}, given the residual": (given, BEST.name),
        f"{PAPER.name}, given the residual": (given, PAPER.name),
        f"{BEST.name}, given that of ten samples ago": (late, BEST.name),
    }
    return [
        *comparison(flights, said),
        (f"Figure 9: four missions, {BEST.name}", timelines(given, BEST.name)),
        ("Figure 10: improvement per sensor", improvements(ways)),
        ("Figure 11: the four best systems", best_systems(given, best)),
        (
            f"Figure 12: variants, sensor by sensor, {EPOCHS} epochs",
            by_sensor(FlightCorrections.of(flights, paper.corrections(ours, work))),
        ),
        (
            f"Figure 12: variants by share of the data, {EPOCHS} epochs",
            by_share(run_all(tables, work, ours)),
        ),
        ("Figure 13: processor and memory over a run, onnxruntime", usage_figure(used)),
    ]


def _commit() -> str:
    """Of the code that made the tables."""
    command, here = ["git", "rev-parse", "--short", "HEAD"], Path(__file__).parent
    said = subprocess.run(command, cwd=here, check=True, capture_output=True, text=True)
    return said.stdout.strip()


def _processor() -> str:
    """Its kind, as Linux names it."""
    lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


if __name__ == "__main__":
    main()
