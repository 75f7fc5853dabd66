"""Write results/paper.md: the paper's tables; and WORK/figures.html: its figures.

    python docs/_generate/paper.py --data ../shared/data --work out/paper

Runs what is not done yet, some hours on two cores (`--seeds 1 --share 1` makes the least of the
main table); it may be stopped and goes on from there.
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
from benchmarks.compensator.paper_figures import figures_page
from learning.data.paper_tables import paper_flights

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
    parser.add_argument("--seeds", type=int, default=3, help="of the main table")
    parser.add_argument(
        "--share", type=float, action="append", help="of the data, in the main table"
    )
    given = parser.parse_args()
    if given.share and 1 not in given.share:
        parser.error("--share without 1: the figures are of trainings on all of the data")
    tables = given.data / "rflysimdt" / "paper_residuals"
    common = ["--data", str(tables), "--out", str(given.work), "--jobs", str(given.jobs)]
    shares = [f"--share={s:g}" for s in given.share or ()]
    sizes = [f"--seeds={given.seeds}", *shares]
    paper.main([*common, "--only=table2", *sizes])
    table2 = (given.work / "paper.md").read_text("utf-8")
    paper.main([*common, f"--epochs={NEEDED_EPOCHS}", "--only=needed"])
    needed = (given.work / "paper.md").read_text("utf-8")
    some = [f"--only={name}" for name in ("ablations", "samples", "weights")]
    paper.main([*common, f"--epochs={EPOCHS}", *some])
    variants = (given.work / "paper.md").read_text("utf-8")
    edge.main([f"--out={given.work}"])
    template = Path(paper.__file__).with_name("paper.md.j2").read_text("utf-8")
    environment = jinja2.Environment(
        keep_trailing_newline=True, trim_blocks=True, undefined=jinja2.StrictUndefined
    )
    filled = environment.from_string(template).render(
        options=" ".join(sizes),
        commit=_commit(),
        machine=f"{os.cpu_count()} cores, {_processor()}",
        table2=table2,
        needed=needed,
        needed_epochs=NEEDED_EPOCHS,
        variants=variants,
        epochs=EPOCHS,
        edge=(given.work / "edge.md").read_text("utf-8"),
    )
    (Path(__file__).parents[1] / "results" / "paper.md").write_text(filled, "utf-8")
    whole = paper.Options(None, given.seeds, published=False, shares=(1.0,))
    variants_of_best = [
        r for r in paper.ablations(replace(whole, epochs=EPOCHS)) if r.name.startswith("best: ")
    ]
    page = figures_page(
        paper_flights(tables),
        paper.corrections(paper.table2(whole), given.work),
        paper.corrections(variants_of_best, given.work),
    )
    (given.work / "figures.html").write_text(page, "utf-8")


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
