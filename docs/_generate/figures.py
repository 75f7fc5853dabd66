"""Write results/figures.md from results/figures.toml.

    python docs/_generate/figures.py [--bench [FILE] | --check]

`--bench` measures speed anew first (`python -m benchmarks.speed`, two minutes on a quiet machine),
or takes what it wrote into a file with `--json`. `--check` changes nothing and exits 1 if the page
is out of date.
"""

import argparse
import json
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tomlkit
from tables import rows

DOCS = Path(__file__).parents[1]
STORE, PAGE = DOCS / "results" / "figures.toml", DOCS / "results" / "figures.md"
HEAD = ("figure", "value", "goal", "command")
INTRODUCTION = """\
# Figures

Written by `python docs/_generate/figures.py` from `docs/results/figures.toml`; `make figures`
measures those of `python -m benchmarks.speed` anew. Two cores of a server (AMD EPYC). Times on a
shared machine move by a third from run to run; the ratios stand. Intervals are 95 %. What is missed
is said.

"""

Figure = dict[str, Any]


def measured(bench: Sequence[dict[str, Any]]) -> dict[str, float | None]:
    """Values of the rows of `benchmarks.speed` by name; the second of a name is "NAME (2)"."""
    seen: Counter[str] = Counter()
    values = {}
    for row in bench:
        name = row["what"]
        seen[name] += 1
        values[name if seen[name] == 1 else f"{name} ({seen[name]})"] = row["value"]
    return values


def update(figures: Sequence[Figure], bench: dict[str, float | None]) -> list[str]:
    """Write measured values into figures.

    Returns:
        Figures that were left as they are, since a row of theirs was not measured.
    """
    left = []
    for figure in figures:
        names = figure.get("bench", [])
        found = [bench.get(name) for name in names]
        if names and None not in found:
            figure["value"] = figure["form"].format(*found)
        elif names:
            left.append(figure["what"])
    return left


def page(figures: Sequence[Figure]) -> str:
    """The whole page."""
    lines = [
        (str(f["what"]), *(str(f[k]) for k in HEAD[1:3]), f"`{f['command']}`") for f in figures
    ]
    return INTRODUCTION + "\n".join(rows(HEAD, lines)) + "\n"


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--bench", nargs="?", type=Path, const=Path("-"), help="measure, or FILE")
    parser.add_argument("--check", action="store_true")
    given = parser.parse_args()
    store = tomlkit.parse(STORE.read_text("utf-8"))
    figures: list[Figure] = store.unwrap()["figure"]
    if given.bench is not None:
        if given.bench == Path("-"):
            command = [sys.executable, "-m", "benchmarks.speed", "--json"]
            said = subprocess.run(
                command, cwd=DOCS.parent, check=True, stdout=subprocess.PIPE, text=True
            ).stdout
        else:
            said = given.bench.read_text("utf-8")
        for what in update(figures, measured(json.loads(said))):
            print(f"not measured, left as it is: {what}", file=sys.stderr)
        for i, figure in enumerate(figures):
            store["figure"][i]["value"] = figure["value"]
        STORE.write_text(tomlkit.dumps(store), "utf-8")
    wanted = page(figures)
    stale = not PAGE.is_file() or PAGE.read_text("utf-8") != wanted
    if stale:
        print(f"{PAGE.name} is out of date")
        if not given.check:
            PAGE.write_text(wanted, "utf-8")
    return 1 if stale and given.check else 0


if __name__ == "__main__":
    sys.exit(main())
