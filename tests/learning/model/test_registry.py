"""The registry of families: no part of one is forgotten. `test_families.py` has the rest."""

import ast
import os
import subprocess
import sys
from dataclasses import is_dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

import learning
from learning.model.family import Family
from learning.model.registry import FAMILIES, FamilyRow, family_row, preset_named
from twin.errors import ModelError

ROWS = FAMILIES
ROOT = Path(str(learning.__file__)).parents[1]
NAMES = [row.name for row in ROWS]


@pytest.mark.parametrize("row", ROWS, ids=NAMES)
def test_the_member_of_every_row_is_there(row: FamilyRow) -> None:
    module, _, name = row.member.partition(":")
    file = f"{module.rpartition('.')[2]}.py"
    assert find_spec(module) is not None, f"{row.name!r} names {row.member}: there is no {file}"
    kind = getattr(import_module(module), name, None)
    assert kind is not None, f"{row.name!r}: {file} has no class {name}"
    assert issubclass(kind, Family), f"{row.name!r}: {name} is no Family"
    lacking = ", ".join(sorted(kind.__abstractmethods__))
    assert not lacking, f"{row.name!r}: {name} lacks {lacking}"


def test_every_family_has_a_row() -> None:
    """A family is a class in `learning` with `Family[...]` among its bases."""
    found = set()
    for path in (ROOT / "learning").rglob("*.py"):
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for node in ast.parse(path.read_text("utf-8")).body:
            bases = [ast.unparse(b) for b in node.bases] if isinstance(node, ast.ClassDef) else []
            if isinstance(node, ast.ClassDef) and any(b.startswith("Family[") for b in bases):
                found.add(f"{module}:{node.name}")
    forgotten = sorted(found - {row.member for row in FAMILIES})
    assert not forgotten, f"in no row of learning/model/registry.py: {', '.join(forgotten)}"


@pytest.mark.parametrize("row", ROWS, ids=NAMES)
def test_the_row_names_the_presets(row: FamilyRow) -> None:
    presets = row.load().presets()
    assert tuple(presets) == row.presets, f"{row.name!r} has the presets {', '.join(presets)}"
    assert len({type(p) for p in presets.values()}) == 1
    for name, preset in presets.items():
        assert preset.name == name and is_dataclass(preset)
        assert preset_named(name) == (row, preset)
        assert row.load().protocols(preset)


def test_names_are_those_of_one_family() -> None:
    presets = [p for row in ROWS for p in row.presets]
    assert len(set(NAMES)) == len(NAMES) and len(set(presets)) == len(presets)


def test_the_registry_imports_no_family() -> None:
    code = (
        "import sys; import learning.model.registry\n"
        "print([m for m in sys.modules if m == 'torch' or m.startswith('learning.training')])"
    )
    said = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert said.stdout == "[]\n"


def test_what_is_in_no_row_is_refused() -> None:
    with pytest.raises(ModelError, match=r"no family 'cvae'; there are .*svq, linear"):
        family_row("cvae")
    with pytest.raises(ModelError, match=r"no preset 'cvae'; there are .*paper, .*linear"):
        preset_named("cvae")
