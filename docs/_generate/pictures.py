"""Pictures of report pages, taken by a headless Chromium (`apt-get install chromium`).

    python docs/_generate/pictures.py [--work FOLDER]

writes the picture of the README: the report of `uavtwin demo`.
"""

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

DOCS = Path(__file__).parents[1]
REPORT = (1000, 806)
"""Size of the picture of the README."""
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


if __name__ == "__main__":
    main()
