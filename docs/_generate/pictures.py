"""Pictures of report pages, taken by a headless Chromium (`apt-get install chromium`).

    python docs/_generate/pictures.py [--work FOLDER]
    python docs/_generate/pictures.py --logs LOG...
    python docs/_generate/pictures.py --paper TABLES --epochs 50 --work FOLDER

writes the picture of the README, of the report of `uavtwin demo`, and that of docs/guide/live.md,
the page of `uavtwin live --demo` after its alarm; with logs that of docs/guide/serve.md alone, the
list of them; with the paper's residual tables those of docs/results/paper.md, the paper's figures
5 to 13, for which it trains what FOLDER does not hold yet.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

DOCS = Path(__file__).parents[1]
sys.path.insert(0, str(DOCS.parent / "tests" / "rigs"))

from page_rigs.browser import View, browser  # noqa: E402
from serve_rigs.sites import Process  # noqa: E402

REPORT = (1000, 520)
"""Size of the picture of the README."""
CONVINCES = "#before-after + details"
"""Its part of the report: measured, model before and after, and what both leave."""
LIVE = (1000, 1150)
"""Size of the picture of a flight under way."""
CARD = 140
"""Height of a figure's card on a page beyond that of the figure, pixels."""
SERVED = (1000, 830)
"""Size of the picture of the list of flights."""
SERVES, LISTENS = "127.0.0.1:8079", "udpin:127.0.0.1:14579"
SEEN_S = 6.0
"""After the alarm, for what differs to be seen."""
SEED = "4"
"""Of the demo: rotor drag."""
ALONE = """
(() => {
  const page = document.querySelector("main"), part = document.querySelector(%s);
  if (part === null) return false;
  if (part !== page) {
    page.replaceChildren(part);
    document.querySelector("nav")?.remove();
  }
  for (const bar of document.querySelectorAll(".modebar")) bar.style.display = "none";
  window.scrollTo(0, 0);
  return true;
})()
"""
"""Leaves one part of a page alone; whether it has it."""
DRAWN_S = 2.0
"""For figures to be drawn: they are as they come into sight."""


def photograph(page: Path, picture: Path, size: tuple[int, int], part: str = "main") -> None:
    """A part of a page as PNG.

    Args:
        page: HTML file; it must need no network.
        picture: PNG file to write.
        size: Width and height of the picture, pixels; what is below is cut.
        part: CSS selector.

    Raises:
        SystemExit: The page has no such part.
        FileNotFoundError: No Chromium is installed.
    """
    picture.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, browser(Path(folder)) as opened:
        opened.open(page, View(size[0], dark=False))
        if not opened.run(ALONE % json.dumps(part)):
            sys.exit(f"{page}: has no part {part} to take a picture of")
        time.sleep(DRAWN_S)
        opened.picture(picture, size[1])


def photograph_live(picture: Path, size: tuple[int, int]) -> None:
    """The page of `uavtwin live --demo` some seconds after its alarm, as PNG.

    Args:
        picture: PNG file to write.
        size: Width and height of the picture, pixels; what is below is cut.
    """
    uavtwin = str(Path(sys.executable).parent / "uavtwin")
    command = [uavtwin, "live", "--demo", "--serve", SERVES, "--listen", LISTENS]
    live = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    with tempfile.TemporaryDirectory() as folder, browser(Path(folder)) as opened, live:
        assert live.stdout is not None
        for line in live.stdout:
            if line.startswith("page: "):
                opened.visit(line.split()[1], View(size[0], dark=False))
            if line.startswith("ALARM"):
                break
        else:
            sys.exit("the demo ended without an alarm: try `uavtwin live --demo`")
        time.sleep(SEEN_S)
        opened.picture(picture, size[1])
        live.terminate()


def photograph_served(logs: list[Path], picture: Path, size: tuple[int, int]) -> None:
    """The list of `uavtwin serve` with logs that were dropped, as PNG.

    Args:
        logs: To drop.
        picture: PNG file to write.
        size: Width and height of the picture, pixels; what is below is cut.
    """
    with (
        tempfile.TemporaryDirectory() as folder,
        Process(Path(folder) / "store") as served,
        browser(Path(folder)) as opened,
    ):
        opened.visit(served.address, View(size[0], dark=False))
        opened.choose("#files", *logs)
        every = f"document.querySelectorAll('#rows .verdict').length === {len(logs)}"
        opened.wait(f"{every} && !document.querySelector('#rows .tag, #uploads li')", 600)
        opened.picture(picture, size[1])


def photograph_paper(tables: Path, work: Path, epochs: int | None) -> None:
    """The paper's figures as PNG: of its tables, of trainings, and of kept scores.

    Args:
        tables: Folder of the residual tables.
        work: Folder of the trainings; what it holds is not trained again.
        epochs: Of each training; None: the preset's.
    """
    sys.path.insert(0, str(DOCS.parent))
    from benchmarks.paper.__main__ import figures
    from benchmarks.paper.figures import figures_page

    drawn = figures(tables, work, epochs, jobs=1)
    with tempfile.TemporaryDirectory() as folder:
        for name, (title, figure) in drawn.items():
            page = Path(folder, f"{name}.html")
            page.write_text(figures_page({name: (title, figure)}), "utf-8")
            picture = DOCS / "results" / "pictures" / f"paper_{name}.png"
            photograph(page, picture, (1000, figure.layout.height + CARD), ".card")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--work", type=Path, help="folder to work in; default: a temporary one")
    parser.add_argument("--logs", type=Path, nargs="+", help="logs of the picture of serve")
    parser.add_argument("--paper", type=Path, help="the paper's residual tables")
    parser.add_argument("--epochs", type=int, help="of its systems; default: their presets'")
    given = parser.parse_args()
    if given.paper:
        with tempfile.TemporaryDirectory() as temporary:
            photograph_paper(given.paper, given.work or Path(temporary), given.epochs)
        return
    if given.logs:
        photograph_served(given.logs, DOCS / "pictures" / "serve.png", SERVED)
        return
    with tempfile.TemporaryDirectory() as temporary:
        work = (given.work or Path(temporary)) / "demo"
        if not (work / "report.html").is_file():
            uavtwin = Path(sys.executable).parent / "uavtwin"
            subprocess.run([uavtwin, "demo", "--seed", SEED, "--out", work], check=True)
        photograph(work / "report.html", DOCS / "pictures" / "report.png", REPORT, CONVINCES)
    photograph_live(DOCS / "pictures" / "live.png", LIVE)


if __name__ == "__main__":
    main()
