"""Write results/compensator.md: what compensators remove on flights that they have not seen.

    python docs/_generate/compensator.py --data ../shared/data --work out/results

Runs what is not done yet, some forty minutes on two cores; it may be stopped and
goes on from there.
"""

import argparse
import sys
from pathlib import Path

import jinja2

sys.path.insert(
    0, str(Path(__file__).parents[2])
)  # benchmarks are no part of the installed package

from benchmarks.compensator import prediction

EPOCHS, SEEDS, AIRCRAFT = 30, 1, 1
"""Of every training; aircraft per set of hidden effects."""


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder of the recorded flights")
    parser.add_argument("--work", type=Path, required=True, help="folder of what is half done")
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    out, simulated = given.work / "prediction", given.work / "simulated"
    folders = ["--data", str(given.data), "--out", str(out), "--simulated", str(simulated)]
    sizes = [f"--epochs={EPOCHS}", f"--seeds={SEEDS}", f"--aircraft={AIRCRAFT}"]
    prediction.main([*folders, *sizes, f"--jobs={given.jobs}"])
    template = Path(prediction.__file__).with_name("prediction.md.j2").read_text("utf-8")
    filled = jinja2.Template(template, keep_trailing_newline=True).render(
        predicted=(out / "prediction.md").read_text("utf-8"), epochs=EPOCHS
    )
    (Path(__file__).parents[1] / "results" / "compensator.md").write_text(filled, "utf-8")


if __name__ == "__main__":
    main()
