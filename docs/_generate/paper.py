"""Write results/paper.md: the paper's tables; and WORK/figures.html: its figures.

    python docs/_generate/paper.py --data ../shared/data --work out/paper

Runs what is not done yet, some hours on two cores (`--seeds 1 --share 1 --seeds-table5 1` makes
less); it may be stopped and goes on from there.
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

from benchmarks.compensator import edge, paper
from benchmarks.compensator.mission_figures import best_systems, improvements, timelines
from benchmarks.compensator.missions import real_missions, simulated_missions
from benchmarks.compensator.paper_figures import (
    Figures,
    Said,
    by_sensor,
    by_share,
    comparison,
    figures_page,
)
from benchmarks.compensator.trainings import run_all
from benchmarks.compensator.usage import usage, usage_figure
from learning.data.paper_tables import paper_flights
from learning.devices import device_named
from learning.preset import BEST, PAPER

OURS = (PAPER.name, BEST.name)
EPOCHS = 12
"""Of the tables with many variants."""
NEEDED_EPOCHS = 50
"""Of that of the protocols in which the answer is not given."""


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder of the recorded flights")
    parser.add_argument("--work", type=Path, required=True, help="folder of what is half done")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--device", default="cpu", help="to train on: cpu, cuda or auto")
    parser.add_argument("--seeds", type=int, default=3, help="of Table II")
    parser.add_argument("--seeds-table3", type=int, default=3, help="of Table III")
    parser.add_argument("--seeds-table5", type=int, default=3, help="of Table V")
    parser.add_argument("--epochs-table5", type=int, help="of Table V; default: the presets'")
    parser.add_argument("--share", type=float, action="append", help="of the data, in Table II")
    parser.add_argument("--published", action="store_true", help="the published code in Table II")
    given = parser.parse_args()
    if given.share and 1 not in given.share:
        parser.error("--share without 1: the figures are of trainings on all of the data")
    tables = given.data / "rflysimdt" / "paper_residuals"
    sizes = [f"--seeds={given.seeds}", *(f"--share={s:g}" for s in given.share or ())]
    sizes += ["--published"] * given.published
    short = [f"--epochs={given.epochs_table5}"] if given.epochs_table5 else []

    def made(*what: str) -> str:
        common = ["--data", str(tables), "--out", str(given.work), "--jobs", str(given.jobs)]
        paper.main([*common, "--device", given.device, *what])
        return Path(given.work, "paper.md").read_text("utf-8")

    text = {
        "table2": made("--only=table2", *sizes),
        "needed": made("--only=needed", f"--epochs={NEEDED_EPOCHS}"),
        "samples": made("--only=samples", f"--seeds={given.seeds_table3}"),
        "weights": made("--only=weights", f"--seeds={given.seeds_table5}", *short),
        "ablations": made("--only=ablations", f"--epochs={EPOCHS}"),
    }
    edge.main([f"--out={given.work}"])
    template = Path(paper.__file__).with_name("paper.md.j2").read_text("utf-8")
    environment = jinja2.Environment(
        keep_trailing_newline=True, trim_blocks=True, undefined=jinja2.StrictUndefined
    )
    filled = environment.from_string(template).render(
        options=" ".join(
            [
                *sizes,
                f"--seeds-table3={given.seeds_table3}",
                f"--seeds-table5={given.seeds_table5}",
                *(f"--epochs-table5={given.epochs_table5}" for _ in short),
            ]
        ),
        epochs_table5=given.epochs_table5,
        commit=_commit(),
        machine=f"{os.cpu_count()} cores, {_processor()}",
        device=device_named(given.device).type,
        needed_epochs=NEEDED_EPOCHS,
        epochs=EPOCHS,
        edge=(given.work / "edge.md").read_text("utf-8"),
        **text,
    )
    (Path(__file__).parents[1] / "results" / "paper.md").write_text(filled, "utf-8")
    page = figures_page(_figures(tables, given.work, given.jobs))
    (given.work / "figures.html").write_text(page, "utf-8")


def _figures(tables: Path, work: Path, jobs: int) -> Figures:
    """All of the paper's that are drawn, of trainings that are done but for the missions'."""
    flights = paper_flights(tables)
    options = paper.Options(None, seeds=1, published=False, shares=(1.0,))
    runs = {r.name: r for r in paper.table2(options) if r.protocol == "reconstruct"}
    said = paper.corrections(list(runs.values()), work)
    compared = {n: s for n, s in said.items() if n in (*OURS, *paper.COMPARED)}
    best = Said.of(flights, compared).best()
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
            by_sensor(Said.of(flights, paper.corrections(ours, work))),
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
