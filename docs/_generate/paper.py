"""Write results/paper.md and its sister pages from the scores that are kept: the paper's tables.

    python docs/_generate/paper.py [--check]

Trains nothing: `python -m benchmarks.paper` does, and keeps the scores.
"""

import argparse
import sys
from pathlib import Path

import jinja2

sys.path.insert(
    0, str(Path(__file__).parents[2])
)  # benchmarks are no part of the installed package

from benchmarks.paper import comparison, tables

PAGES = ("paper", "paper_less_data", "paper_weights", "paper_published")
"""Names of the pages and of their templates."""


def filled(page: str) -> str:
    """Text of a page."""
    environment = jinja2.Environment(
        keep_trailing_newline=True, trim_blocks=True, undefined=jinja2.StrictUndefined
    )
    template = Path(tables.__file__).with_name(f"{page}.md.j2").read_text("utf-8")
    rows = comparison.read_rows()
    return environment.from_string(template).render(
        rows=rows,
        tables=tables,
        needed_epochs=comparison.NEEDED_EPOCHS,
        epochs=comparison.ABLATION_EPOCHS,
    )


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--check", action="store_true", help="change nothing; 1: out of date")
    given, stale = parser.parse_args(), []
    for page in PAGES:
        file = Path(__file__).parents[1] / "results" / f"{page}.md"
        text = filled(page)
        if not file.is_file() or file.read_text("utf-8") != text:
            stale.append(file.name)
            if not given.check:
                file.write_text(text, "utf-8")
    if given.check and stale:
        print(f"out of date, run docs/_generate/paper.py: {', '.join(stale)}", file=sys.stderr)
    return int(given.check and bool(stale))


if __name__ == "__main__":
    raise SystemExit(main())
