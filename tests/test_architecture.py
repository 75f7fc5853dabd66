"""The floor plan of docs/dev/architecture.md.

Layers, circles and forbidden imports are contracts of import-linter in `pyproject.toml`; here are
these contracts, and the rules that import-linter does not have (`rigs/import_graph`).
"""

from collections.abc import Mapping
from functools import cache
from pathlib import Path

import grimp
import pytest
from import_graph import (
    fragments,
    long_modules,
    modules_of,
    private_uses,
    shared_names,
    untyped_packages,
)
from importlinter.cli import lint_imports
from places import ROOT

SHIPPED = ("twin", "learning", "fmus", "cosim", "uavtwin")
PACKAGES = (*SHIPPED, "benchmarks")
FEWEST_LINES = 60
"""Of a module that one other module imports."""
TABLES = ("uavtwin.cli.", "twin.physics.")
"""A file per verb, per component: one row of a table each, however short."""
MOST_LINES = 650
"""Of a module: one concept; about 600."""


@cache
def graph() -> grimp.ImportGraph:
    """Imports for type checkers alone do not count."""
    return grimp.build_graph(*PACKAGES, exclude_type_checking_imports=True, cache_dir=None)


# -- the tree -------------------------------------------------------------------------------


@pytest.mark.slow
def test_contracts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Layers, circles, forbidden imports; imports inside functions count."""
    monkeypatch.chdir(ROOT)
    assert lint_imports(no_cache=True, show_timings=False) == 0


@pytest.mark.slow
def test_a_module_is_one_concept() -> None:
    """Neither a fragment of its only importer nor several concepts."""
    files = {m: f for m, f in modules_of(ROOT, SHIPPED).items() if not m.startswith(TABLES)}
    assert fragments(files, graph(), FEWEST_LINES) == []
    assert long_modules(modules_of(ROOT, SHIPPED), MOST_LINES) == []


@pytest.mark.slow
def test_private_names_stay_in_their_module() -> None:
    assert private_uses(modules_of(ROOT, PACKAGES)) == []


def test_test_modules_have_names_of_their_own() -> None:
    assert shared_names(ROOT, "tests") == []


def test_types_are_shipped() -> None:
    assert untyped_packages(ROOT, SHIPPED) == []


def test_caches_of_benchmarks_follow_every_source_they_come_from() -> None:
    """What makes a residual flight, and what keeps it, is in the hash of its file."""
    from benchmarks.compensator.residuals import source_files

    hashed = {f.resolve() for f in source_files()}
    files = modules_of(ROOT, PACKAGES)
    makers = ("learning.data.flights", "twin.logs.read")
    needed = set(makers).union(*(graph().find_upstream_modules(m) for m in makers))
    packages = {"learning", "learning.data"}  # a line of text each
    assert {files[m].resolve() for m in needed & files.keys() - packages} - hashed == set()


# -- each rule can be broken ----------------------------------------------------------------


def made_up(folder: Path, files: Mapping[str, str]) -> dict[str, Path]:
    """Modules of a tree of these files, and the packages they are in."""
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        for parent in path.relative_to(folder).parents:
            (folder / parent / "__init__.py").touch()
    return modules_of(folder, sorted({name.partition("/")[0] for name in files}))


def test_private_names_are_found(tmp_path: Path) -> None:
    """Imported by name, read from a module, or in a private module; others' do not count."""
    broken = made_up(
        tmp_path,
        {
            "p/a.py": "_x = 1\ny = 2",
            "p/_b.py": "z = 1",
            "p/c.py": "from .a import _x, y",
            "p/d.py": "from p import a as other\nprint(other._x, other.y, other.__name__)",
            "p/e.py": "from ._b import z",
            "p/f.py": "import numpy as np\nnp._private\nfrom __future__ import annotations",
        },
    )
    assert private_uses(broken) == [
        "p.c:1 imports p.a._x",
        "p.d:2 reads other._x",
        "p.e:1 imports p._b.z",
    ]


def test_fragments_and_long_modules_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Short and imported once; short and imported twice; long."""
    files = made_up(
        tmp_path,
        {
            "made_up_tree/once.py": "x = 1",
            "made_up_tree/twice.py": "y = 2",
            "made_up_tree/a.py": "from .once import x\nfrom .twice import y\n" + "\n" * 80,
            "made_up_tree/b.py": "from .twice import y\nfrom . import a\n",
        },
    )
    monkeypatch.syspath_prepend(tmp_path)
    built = grimp.build_graph("made_up_tree", cache_dir=None)
    assert fragments(files, built, 60) == [
        "made_up_tree.once: 1 lines, imported by made_up_tree.a alone"
    ]
    assert long_modules(files, 80) == ["made_up_tree.a: 82 lines"]


def test_missing_markers_are_found(tmp_path: Path) -> None:
    made_up(tmp_path, {"p/a.py": ""})
    assert untyped_packages(tmp_path, ["p"]) == ["p has no py.typed"]
    (tmp_path / "p" / "py.typed").touch()
    assert untyped_packages(tmp_path, ["p"]) == []


def test_names_that_are_there_twice_are_found(tmp_path: Path) -> None:
    for name in ("a/test_x.py", "b/test_x.py", "b/test_y.py", "a/conftest.py", "b/conftest.py"):
        path = tmp_path / "tests" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    assert shared_names(tmp_path, "tests") == ["test_x: tests/a/test_x.py, tests/b/test_x.py"]
