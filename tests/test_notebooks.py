"""Notebooks of `examples/` run from the first cell to the last, stored with what they say."""

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from nbformat import NotebookNode

FOLDER = Path(__file__).parents[1] / "examples" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def read(path: Path) -> NotebookNode:
    notebook: NotebookNode = nbformat.read(path, as_version=4)  # type: ignore[no-untyped-call]
    return notebook


def test_there_are_notebooks() -> None:
    assert len(NOTEBOOKS) >= 5


MOST_BYTES = 200_000
"""Of a notebook with its outputs: of a figure its data, not the program that draws it."""


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_stored_with_output(path: Path) -> None:
    """In the order of one run, without errors; no time, no path of the machine that ran it."""
    text = path.read_text("utf-8")
    assert len(text) < MOST_BYTES
    assert "/tmp/" not in text and "/work" not in text and "/home" not in text
    cells = [c for c in read(path).cells if c.cell_type == "code"]
    assert [c.execution_count for c in cells] == list(range(1, len(cells) + 1))
    kinds = {o.output_type for c in cells for o in c.outputs}
    assert kinds and "error" not in kinds, "run docs/_generate/notebooks.py"
    streams = [o for c in cells for o in c.outputs if o.output_type == "stream"]
    assert not [o for o in streams if o.name == "stderr"]


LONG = {"find_and_add_an_effect"}
"""What the Python of the README does, and is tested for, in other words."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "path",
    [pytest.param(p, marks=pytest.mark.long) if p.stem in LONG else p for p in NOTEBOOKS],
    ids=lambda p: p.stem,
)
def test_runs(
    path: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    request: pytest.FixtureRequest,
) -> None:
    """Cells assert what they show; the first that fails ends the test with its traceback."""
    if "UAVTWIN_DATA" in path.read_text("utf-8"):
        monkeypatch.setenv("UAVTWIN_DATA", str(request.getfixturevalue("data_dir")))
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    notebook = read(path)
    client = NotebookClient(notebook, timeout=900, resources={"metadata": {"path": str(tmp_path)}})
    client.execute()
    assert all(c.execution_count for c in notebook.cells if c.cell_type == "code" and c.source)
