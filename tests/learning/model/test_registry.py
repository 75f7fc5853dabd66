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
from learning.model.registry import FAMILIES, family_named, preset_named
from twin.errors import ModelError

ROOT = Path(str(learning.__file__)).parents[1]


@pytest.mark.parametrize(("name", "member"), FAMILIES.items())
def test_the_member_of_every_row_is_there(name: str, member: str) -> None:
    module, _, class_name = member.partition(":")
    file = f"{module.rpartition('.')[2]}.py"
    assert find_spec(module) is not None, f"{name!r} names {member}: there is no {file}"
    kind = getattr(import_module(module), class_name, None)
    assert kind is not None, f"{name!r}: {file} has no class {class_name}"
    assert issubclass(kind, Family), f"{name!r}: {class_name} is no Family"
    lacking = ", ".join(sorted(kind.__abstractmethods__))
    assert not lacking, f"{name!r}: {class_name} lacks {lacking}"
    assert kind.name == name


def test_every_family_has_a_row() -> None:
    """A family is a class in `learning` with `Family[...]` among its bases."""
    found = set()
    for path in (ROOT / "learning").rglob("*.py"):
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for node in ast.parse(path.read_text("utf-8")).body:
            bases = [ast.unparse(b) for b in node.bases] if isinstance(node, ast.ClassDef) else []
            if isinstance(node, ast.ClassDef) and any(b.startswith("Family[") for b in bases):
                found.add(f"{module}:{node.name}")
    forgotten = sorted(found - {*FAMILIES.values()})
    assert not forgotten, f"in no row of learning/model/registry.py: {', '.join(forgotten)}"


@pytest.mark.parametrize("name", FAMILIES)
def test_presets_are_of_one_kind(name: str) -> None:
    family = family_named(name)
    assert len({type(p) for p in family.presets.values()}) == 1 and family.usual in family.presets
    for key, preset in family.presets.items():
        assert preset.name == key and is_dataclass(preset) and family.protocols(preset)
        found, same = preset_named(key)
        assert type(found) is type(family) and same == preset


def test_names_are_those_of_one_family() -> None:
    presets = [p for name in FAMILIES for p in family_named(name).presets]
    assert len(set(presets)) == len(presets)


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
        family_named("cvae")
    with pytest.raises(ModelError, match=r"no preset 'cvae'; there are .*paper, .*linear"):
        preset_named("cvae")
