"""Run the notebooks of `examples/` and store what their cells print.

    python docs/_generate/notebooks.py [NAME ...]

Of a figure its data is stored, not the program that draws it; no time, no path of the machine.
"""

import os
import sys
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode

FOLDER = Path(__file__).parents[2] / "examples" / "notebooks"
LIMIT_S = 1800
"""Longest run of a cell, s."""


def executed(path: Path) -> NotebookNode:
    """A notebook with its outputs."""
    notebook: NotebookNode = nbformat.read(path, as_version=4)  # type: ignore[no-untyped-call]
    with tempfile.TemporaryDirectory() as folder:
        resources = {"metadata": {"path": folder}}
        NotebookClient(notebook, timeout=LIMIT_S, resources=resources).execute()
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
        for output in cell.get("outputs", ()):
            if "application/vnd.plotly.v1+json" in output.get("data", {}):
                output.data.pop("text/html", None)
    notebook.metadata.pop("widgets", None)
    notebook.metadata.language_info = {"name": "python"}
    return notebook


def main(names: list[str]) -> None:
    """Run those of some names, all where none is given."""
    os.environ.setdefault("PLOTLY_RENDERER", "plotly_mimetype")
    for path in sorted(FOLDER.glob("*.ipynb")):
        if not names or path.stem in names:
            nbformat.write(executed(path), path)  # type: ignore[no-untyped-call]


if __name__ == "__main__":
    main(sys.argv[1:])
