"""Pictures of report pages, taken by a headless Chromium (`apt-get install chromium`).

    python docs/_generate/pictures.py [--work FOLDER]

writes the picture of the README, the report of `uavtwin demo`, and that of docs/guide/live.md, the
page of `uavtwin live --demo` after its alarm.
"""

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

DOCS = Path(__file__).parents[1]
sys.path.insert(0, str(DOCS.parent / "tests" / "rigs"))

from page_rigs.browser import View, browser  # noqa: E402

REPORT = (1000, 806)
"""Size of the picture of the README."""
LIVE = (1000, 1150)
"""Size of the picture of a flight under way."""
SERVES, LISTENS = "127.0.0.1:8079", "udpin:127.0.0.1:14579"
SEEN_S = 6.0
"""After the alarm, for what differs to be seen."""
SEED = "4"
"""Of the demo: rotor drag."""
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--hide-scrollbars",
    "--virtual-time-budget=10000",  # until the figures are drawn
)


ALONE = """
<style>.modebar {{display: none !important}}</style>
<script>
  const part = document.querySelector({part});
  if ({part} !== "main") document.querySelector("main").replaceChildren(part);
</script>
</body>"""
"""Put at the end of a page: one part of it alone. Figures are drawn as they come into sight."""


def photograph(page: Path, picture: Path, size: tuple[int, int], part: str = "main") -> None:
    """A part of a page as PNG.

    Args:
        page: HTML file; it must need no network.
        picture: PNG file to write.
        size: Width and height of the picture, pixels; what is below is cut.
        part: CSS selector.

    Raises:
        SystemExit: No Chromium is installed.
        CalledProcessError: It failed.
    """
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        sys.exit("no chromium here to take pictures with: apt-get install chromium")
    picture.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "page.html"
        head, _, tail = page.read_text("utf-8").rpartition("</body>")
        copy.write_text(head + ALONE.format(part=json.dumps(part)) + tail, "utf-8")
        subprocess.run(
            [
                browser,
                *FLAGS,
                f"--user-data-dir={folder}/profile",
                f"--window-size={size[0]},{size[1]}",
                f"--screenshot={picture.resolve()}",
                copy.as_uri(),
            ],
            check=True,
            capture_output=True,
            timeout=120,
        )


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


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--work", type=Path, help="folder to work in; default: a temporary one")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        work = (given.work or Path(temporary)) / "demo"
        if not (work / "report.html").is_file():
            uavtwin = Path(sys.executable).parent / "uavtwin"
            subprocess.run([uavtwin, "demo", "--seed", SEED, "--out", work], check=True)
        photograph(work / "report.html", DOCS / "pictures" / "report.png", REPORT)
    photograph_live(DOCS / "pictures" / "live.png", LIVE)


if __name__ == "__main__":
    main()
