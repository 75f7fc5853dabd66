"""Run the tutorial and write its outputs and pictures.

    python docs/_generate/tutorial.py [--work FOLDER] [--no-pictures]

A block with a title becomes a file; blocks of `sh` are run in their order; the `text` block that
follows gets what they print. The pictures are taken of the reports that they write.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from pictures import photograph

DOCS = Path(__file__).parents[1]
PAGE = DOCS / "tutorial" / "index.md"
LINES = 14
"""Of an output that are shown."""
PICTURES = {
    "gap": ("main > .card.scroll", (1000, 345)),
    "explained": (".card:has(#time-acc_z-0)", (880, 470)),
    "wind": (".card:has(#followed-position)", (880, 495)),
}
"""Folder of a report, which part of it is shown, and its width and height, pixels."""
_BLOCK = re.compile(r'```(?P<language>\w+)(?: title="(?P<title>[^"]+)")?\n(?P<body>.*?)```', re.S)


@dataclass(frozen=True, slots=True)
class Block:
    """A block of code of the page; `title` is the file that it becomes."""

    language: str
    title: str | None
    body: str


def blocks(page: str) -> list[Block]:
    """All blocks of a page, in order."""
    return [Block(m["language"], m["title"], m["body"]) for m in _BLOCK.finditer(page)]


def run_blocks(page: str, work: Path) -> list[str]:
    """Write the files and run the commands of a page in an empty folder.

    Returns:
        What each block of `sh` printed. Exit code 1 of `uavtwin` says that it found something.

    Raises:
        RuntimeError: A command failed.
    """
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    printed = []
    for block in blocks(page):
        if block.title is not None:
            (work / block.title).write_text(block.body, "utf-8")
        elif block.language == "sh":
            said = []
            for command in block.body.splitlines():
                result = subprocess.run(
                    ["bash", "-c", command],
                    cwd=work,
                    env={**os.environ, "PATH": path, "COLUMNS": "100"},
                    capture_output=True,
                    text=True,
                )
                told = command.startswith("uavtwin ") and "Traceback" not in result.stderr
                if result.returncode not in ((0, 1) if told else (0,)):
                    raise RuntimeError(f"{command}\n{result.stdout}{result.stderr}")
                said.append(result.stdout)
            printed.append("".join(said))
    return printed


def with_outputs(page: str, printed: list[str]) -> str:
    """The page with the outputs in its `text` blocks, long ones cut."""
    rest = iter(printed)

    def fill(match: re.Match[str]) -> str:
        """A block with its next output."""
        if match["language"] != "text":
            return match[0]
        lines = [line.rstrip() for line in next(rest).splitlines()]
        shown = lines if len(lines) <= LINES else [*lines[: LINES - 1], "..."]
        return "\n".join(["```text", *shown, "```"])

    return _BLOCK.sub(fill, page)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--work", type=Path, help="folder to work in; default: a temporary one")
    parser.add_argument("--no-pictures", action="store_true", help="outputs only; no browser")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        work = given.work or Path(temporary)
        work.mkdir(parents=True, exist_ok=True)
        page = PAGE.read_text("utf-8")
        PAGE.write_text(with_outputs(page, run_blocks(page, work)), "utf-8")
        if not given.no_pictures:
            for name, (part, size) in PICTURES.items():
                picture = PAGE.parent / "pictures" / f"{name}.png"
                photograph(work / name / "report.html", picture, size, part)


if __name__ == "__main__":
    main()
