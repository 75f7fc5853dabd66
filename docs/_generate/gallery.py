"""The picture that convinces, of every effect of the library: a flight with it planted.

    python docs/_generate/gallery.py --out out/gallery [EFFECT ...]

writes pages of ten effects each, as `uavtwin explain` draws them. What changes a mean is flown by
our own airframe with the effect, what does not by the plant of the benchmark.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.planted import flown, model_of_library, shown, unsteady
from twin.effects import EFFECTS
from twin.explain.model.model import has_mean
from uavtwin.report.drawing import Budget, degenerate
from uavtwin.report.evidence import steady_evidence, unsteady_evidence
from uavtwin.report.page import Plot, render

HERE = Path(__file__).parent
ON_A_PAGE = 10
DRAWN = Budget(300)


@dataclass(frozen=True, slots=True)
class Entry:
    """One effect.

    Attributes:
        effect: Identifier.
        meaning: Of the effect, in a line.
        plots: Its figures.
        how: To be read.
        faults: What is degenerate about a figure; none should be.
    """

    effect: str
    meaning: str
    plots: list[Plot]
    how: str
    faults: list[str]


def entry(effect: str) -> Entry:
    """The picture of an effect.

    Args:
        effect: Identifier.
    """
    if has_mean(EFFECTS[effect]):
        found = shown(effect, model_of_library(flown(effect)))
        plots, how = steady_evidence(found.acts, found.with_it, found.model.flights, DRAWN)
    else:
        seen = unsteady(effect)
        plots, how = unsteady_evidence(seen.found, seen.flight, seen.residuals, seen.vehicle, DRAWN)
    faults = [f"{p.id}: {fault}" for p in plots for fault in degenerate(p)]
    return Entry(effect, EFFECTS[effect].meaning, plots, how, faults if plots else ["no figure"])


def write_page(entries: Sequence[Entry], number: int, pages: int, out: Path) -> Path:
    """Write one page of the gallery; returns its path.

    Args:
        entries: On the page.
        number: Of the page, from 1.
        pages: Of the gallery.
        out: Folder.
    """
    out.mkdir(parents=True, exist_ok=True)
    path = out / f"gallery_{number}.html"
    page = render("gallery.html.j2", {}, HERE, entries=entries, number=number, pages=pages)
    path.write_text(page, encoding="utf-8")
    return path


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder to write to")
    parser.add_argument("effects", nargs="*", help="default: all")
    given = parser.parse_args()
    wanted, faulty = list(given.effects or EFFECTS), False
    parts = [wanted[i : i + ON_A_PAGE] for i in range(0, len(wanted), ON_A_PAGE)]
    for number, part in enumerate(parts, start=1):
        entries = []
        for effect in part:
            entries.append(entry(effect))
            print(f"{effect}: {'; '.join(entries[-1].faults) or 'fine'}", file=sys.stderr)
        print(write_page(entries, number, len(parts), given.out))
        faulty |= any(e.faults for e in entries)
    return int(faulty)


if __name__ == "__main__":
    sys.exit(main())
