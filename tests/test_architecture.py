"""The floor plan of docs/dev/architecture.md: what the tree keeps, and how each rule breaks.

The rules themselves are functions of `rigs/import_graph`.
"""

from collections.abc import Mapping
from functools import cache
from pathlib import Path

import pytest
from import_graph import (
    Tree,
    circles,
    imports_of,
    private_uses,
    read_layers,
    read_tree,
    shared_names,
    untyped_packages,
    upward_arrows,
)
from places import ROOT

SHIPPED = ("twin", "learning", "fmus", "cosim", "uavtwin")
PACKAGES = (*SHIPPED, "benchmarks")
CHECKING = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n"
LAYERS = read_layers((ROOT / "docs" / "dev" / "architecture.md").read_text())


@cache
def tree() -> Tree:
    return read_tree(ROOT, PACKAGES)


# -- the tree -------------------------------------------------------------------------------


@pytest.mark.slow
def test_no_circle() -> None:
    """Imports inside functions count: none of them is there to break a circle."""
    assert circles(tree()) == []


def test_no_arrow_upwards() -> None:
    assert upward_arrows(tree(), LAYERS) == []


def test_every_layer_is_there() -> None:
    """A layer that was renamed would let everything through."""
    named = [name for layer in LAYERS for name in layer]
    assert [n for n in named if n not in tree().files] == []
    assert len(set(named)) == len(named)
    assert {n.partition(".")[0] for n in named} == set(PACKAGES)


def test_cosim_sees_nothing_of_explain() -> None:
    assert imports_of(tree(), "twin.explain", within="cosim") == []


def test_torch_is_in_learning_alone() -> None:
    assert imports_of(tree(), "torch", outside="learning") == []
    assert imports_of(tree(), "torch") != []


@pytest.mark.slow
def test_private_names_stay_at_home() -> None:
    assert private_uses(tree()) == []


def test_test_modules_have_names_of_their_own() -> None:
    assert shared_names(ROOT, "tests") == []


def test_types_are_shipped() -> None:
    assert untyped_packages(ROOT, SHIPPED) == []


def test_caches_of_benchmarks_follow_every_source_they_come_from() -> None:
    """What makes a residual flight, and what keeps it, is in the hash of its file."""
    from benchmarks.compensator.residuals import source_files

    hashed = {f.resolve() for f in source_files()}
    makers = ("learning.data.flights", "learning.data.residual_table", "twin.logs.read")
    packages = {"learning", "learning.data"}  # a line of text each
    needed = {tree().files[m].resolve() for m in tree().reached(makers) - packages}
    assert needed - hashed == set()


# -- each rule can be broken ----------------------------------------------------------------


def made_up(folder: Path, files: Mapping[str, str]) -> Tree:
    """A tree of these files, and the packages they are in."""
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        for parent in path.relative_to(folder).parents:
            (folder / parent / "__init__.py").touch()
    return read_tree(folder, sorted({name.partition("/")[0] for name in files}))


@pytest.mark.parametrize(
    ("there", "found"),
    [
        ("from .b import y", True),
        ("from . import b", True),
        ("from p import b", True),
        ("import p.b", True),
        ("def f():\n    from .b import y", True),
        ("class A:\n    def f(self):\n        import p.b as other", True),
        ("import importlib\nimportlib.import_module('p.b')", True),
        ("try:\n    from .b import y\nexcept ImportError:\n    y = 1", True),
        (
            f"{CHECKING}    from .b import y\nelse:\n    y = 1",
            False,
        ),
        (
            f"{CHECKING}    y = 1\nelse:\n    from .b import y",
            True,
        ),
        ("import q.b", False),
    ],
)
def test_circles_are_found(tmp_path: Path, there: str, found: bool) -> None:
    broken = made_up(tmp_path, {"p/a.py": there, "p/b.py": "from .a import x\ny = 1"})
    assert bool(circles(broken)) == found


def test_arrows_upwards_are_found(tmp_path: Path) -> None:
    """The longest prefix counts, whatever the order of the packages."""
    layers = [["p.low"], ["p.mid.deep"], ["p.mid"]]
    files = {
        "p/low/a.py": "",
        "p/mid/b.py": "import p\nfrom .deep.c import x\nfrom ..low import a",
        "p/mid/deep/c.py": "from ...low.a import y",
    }
    assert upward_arrows(made_up(tmp_path, files), layers) == []
    files["p/mid/deep/c.py"] = "def f():\n    from ..b import z"
    files["p/low/a.py"] = "from p.mid.deep import c"
    files["p/new/d.py"] = "from ..low import a"
    assert upward_arrows(made_up(tmp_path, files), layers) == [
        "p.low.a:1 imports p.mid.deep.c, which is above it",
        "p.mid.deep.c:2 imports p.mid.b, which is above it",
        "p.new.d is in no layer",
    ]


def test_forbidden_imports_are_found(tmp_path: Path) -> None:
    """Of others' packages and of ours, whole and in part; names alike are none."""
    broken = made_up(
        tmp_path,
        {
            "cosim/a.py": "from twin.explain.fit import x",
            "cosim/b.py": "import torchvision\nimport twin.explained",
            "cosim/c.py": "def f():\n    import torch.nn as nn",
            "learning/d.py": "import torch",
            "twin/explain/fit.py": "x = 1",
            "twin/explained.py": "",
        },
    )
    assert imports_of(broken, "twin.explain", within="cosim") == [
        "cosim.a:1 imports twin.explain.fit"
    ]
    assert imports_of(broken, "torch", outside="learning") == ["cosim.c:2 imports torch.nn"]


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
        "p.e:1 imports p._b.z",
        "p.d:2 reads other._x",
    ]


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


def test_layers_are_read() -> None:
    assert read_layers("text\n```layers\na b\nc\n```\nmore") == [["a", "b"], ["c"]]
    with pytest.raises(AssertionError, match="no block"):
        read_layers("none here")
