"""Write results/compensator.md: the paper's tables, and what compensators remove.

    python docs/_generate/compensator.py --data ../shared/data --work out/results

Runs what is not done yet: the paper's tables, and what compensators remove on flights that they
were not trained on. About two hours on two cores; it may be stopped and goes on from there.
"""

import argparse
import sys
from pathlib import Path

import jinja2

sys.path.insert(
    0, str(Path(__file__).parents[2])
)  # benchmarks are no part of the installed package

from benchmarks.compensator import paper, prediction

EPOCHS = 12
"""Of the tables with many variants."""
PREDICTION_EPOCHS, PREDICTION_SEEDS, AIRCRAFT = 30, 1, 1
"""Of the tables of prediction; aircraft per set of hidden effects."""


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder of the recorded flights")
    parser.add_argument("--work", type=Path, required=True, help="folder of what is half done")
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    tables, out = given.data / "rflysimdt" / "paper_residuals", given.work / "paper"
    common = ["--data", str(tables), "--out", str(out), "--jobs", str(given.jobs)]
    paper.main([*common, "--only=table2"])
    table2 = (out / "paper.md").read_text("utf-8")
    some = [f"--only={name}" for name in ("ablations", "samples", "weights")]
    paper.main([*common, f"--epochs={EPOCHS}", *some])
    variants = (out / "paper.md").read_text("utf-8")
    predicted = given.work / "prediction"
    prediction.main(
        [
            "--data",
            str(given.data),
            "--out",
            str(predicted),
            f"--epochs={PREDICTION_EPOCHS}",
            f"--seeds={PREDICTION_SEEDS}",
            f"--aircraft={AIRCRAFT}",
            "--simulated",
            str(given.work / "simulated"),
            "--jobs",
            str(given.jobs),
        ]
    )
    write(table2, variants, (predicted / "prediction.md").read_text("utf-8"))


def write(table2: str, variants: str, predicted: str) -> None:
    """Put the tables into the page; what they say is written in the template."""
    template = Path(paper.__file__).with_name("results.md.j2").read_text("utf-8")
    filled = jinja2.Template(template, keep_trailing_newline=True).render(
        table2=table2,
        variants=variants,
        predicted=predicted,
        epochs=EPOCHS,
        prediction_epochs=PREDICTION_EPOCHS,
    )
    (Path(__file__).parents[1] / "results" / "compensator.md").write_text(filled, "utf-8")


if __name__ == "__main__":
    main()
