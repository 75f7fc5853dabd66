"""Inputs that once felled a reader, and some seconds of a search for more."""

import random
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from cli_rig import run as cli
from fuzzing.all_kinds import KINDS, kind
from fuzzing.engine import Child, Recipe, Result, recipes
from fuzzing.layout import draw_axis_fault, motion
from places import lacking

CORPUS = [
    Recipe.parse(line) for line in Path(__file__).with_name("corpus.jsonl").read_text().splitlines()
]
MOST_SILENT = 0.05


@pytest.fixture(scope="module")
def child() -> Iterator[Child]:
    with Child() as one:
        yield one


def run(child: Child, recipe: Recipe) -> Result:
    """A recipe's result; skipped where it begins with a flight that is not here, but not in CI."""
    lacking(recipe.base in kind(recipe.kind).bases(), f"no {recipe.base}: set UAVTWIN_DATA")
    return child.run(recipe)


@pytest.mark.parametrize("recipe", CORPUS, ids=lambda r: f"{r.kind}-{r.base}-{r.steps[-1][0]}")
def test_what_once_felled_a_reader_does_not(child: Child, recipe: Recipe) -> None:
    result = run(child, recipe)
    assert not result.fault, result.text


@pytest.mark.slow
@pytest.mark.parametrize("count", [15, pytest.param(60, marks=pytest.mark.long)])
@pytest.mark.parametrize("name", KINDS)
def test_a_short_search_fells_no_reader(child: Child, name: str, count: int) -> None:
    """The same recipes each time, `make fuzz` draws others; of what could be told nearly all is."""
    found = [child.run(recipe) for recipe in islice(recipes(name, kind(name), 0), count)]
    faults = [f"{r.recipe.line()}\n{r.text}" for r in found if r.fault]
    assert not faults, "\n".join(faults)
    seen = [r for r in found if r.visible and r.outcome != "same"]
    silent = [r.recipe.line() for r in seen if r.outcome == "silent"]
    assert len(silent) <= 1 + MOST_SILENT * len(seen), "\n".join(silent)


@pytest.mark.parametrize("name", KINDS)
def test_a_recipe_is_all_that_is_needed(name: str) -> None:
    """Through a line of the corpus and back, the same bytes."""
    this = kind(name)
    bases = this.bases()
    for recipe in islice(recipes(name, this, 3), 5):
        again = Recipe.parse(recipe.line())
        assert again == recipe
        blobs = []
        for each in (recipe, again):
            blob = bases[each.base]
            for step in each.steps:
                blob = this.apply(blob, step)
            blobs.append(blob)
        assert blobs[0] == blobs[1]


@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n in KINDS if n not in ("onnx", "datagrams", "design")])
def test_exit_codes_are_those_of_the_documents(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, name: str
) -> None:
    """0: fine, 1: findings, 2: refused, which names the file. Kinds that `check` reads."""
    this = kind(name)
    path = tmp_path / this.file
    for recipe in islice(recipes(name, this, 8, sorted(this.bases())[:1]), 6):
        blob = this.bases()[recipe.base]
        for step in recipe.steps:
            blob = this.apply(blob, step)
        path.write_bytes(blob)
        code, said, error = cli(capsys, "check", path)
        found = any(f"\n  {kind}: " in said for kind in ("problem", "warning"))
        expected = 2 if error else 1 if found else 0
        assert code == expected, recipe.line()
        assert not error or error.startswith(f"error: {path.name}"), error


@pytest.mark.parametrize(
    ("to", "outcome", "text"),
    [
        ("memory", "crash", "MemoryError"),
        ("raise", "crash", "IndexError: as the file said"),
        ("die", "killed", "died"),
        ("other", "silent", ""),
        ("sound", "same", ""),
    ],
)
def test_a_fault_is_seen(child: Child, to: str, outcome: str, text: str) -> None:
    result = child.run(Recipe("faulty", "sound", (("set", {"to": to}),)))
    assert result.outcome == outcome and text in result.text
    assert result.visible and result.fault == (outcome in ("crash", "killed"))


@pytest.mark.parametrize(
    ("quantity", "still", "moved"), [("gyro", 0.002, 0.02), ("acc", 0.05, 0.5), ("vel", 0.02, 0.2)]
)
def test_an_axis_that_hardly_moves_is_not_counted(
    quantity: str, still: float, moved: float
) -> None:
    """A sine of a period of 2 s: its mean over half a second is 0.9 of it at most."""
    rng, t_s = random.Random(1), np.arange(0.0, 20.0, 0.01)
    noise = 0.1 * np.random.default_rng(1).standard_normal(len(t_s))
    for size, expected in ((still, True), (moved, False)):
        values = 9.8 + size * np.sin(np.pi * t_s) + size * noise
        given = draw_axis_fault(rng, "axis_scale", quantity, t_s, values)
        assert given.get("still", False) is expected
        assert "still" not in draw_axis_fault(rng, "axis_freeze", quantity, t_s, values)
    assert np.isnan(motion(t_s[:3], t_s[:3]))


def test_what_is_still_is_not_visible(child: Child) -> None:
    """The same recipe with and without the mark."""
    step = {"topic": "IMU", "field": "GyrX", "by": 0.3}
    for still in ({}, {"still": True}):
        result = child.run(Recipe("dataflash", "flown", (("axis_scale", step | still),)))
        assert result.outcome == "told"
        assert result.visible is not bool(still)
