"""Words of the field in names, JSON keys and headings: docs/reference/glossary.md."""

import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest
from places import ROOT

SHIPPED = ("twin", "learning", "fmus", "cosim", "uavtwin")
BANNED = {"told", "felt", "anew", "beside", "hung", "whoever", "looks", "kept"}
"""Words of no textbook: reported, observable, again, with, stored, ... say what is meant."""


def words_of(name: str) -> set[str]:
    """Words of an identifier in snake or camel case."""
    return {w.lower() for w in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)}


def banned_names(file: Path) -> Iterator[str]:
    """Identifiers of a Python file, and its strings that are keys, with a banned word."""
    with tokenize.open(file) as text:
        for token in tokenize.generate_tokens(text.readline):
            key = token.type == tokenize.STRING and re.fullmatch(r"[\"'](\w+)[\"']", token.string)
            name = token.string if token.type == tokenize.NAME else key[1] if key else ""
            if words_of(name) & BANNED:
                yield f"{file}:{token.start[0]} {name}"


def banned_headings(file: Path) -> Iterator[str]:
    """Headings of a Markdown file, and names in its code, with a banned word."""
    for line, text in enumerate(file.read_text().splitlines(), 1):
        names = [text] if text.startswith("#") else re.findall(r"`([\w.]+)`", text)
        for name in names:
            if words_of(name) & BANNED:
                yield f"{file}:{line} {name}"


@pytest.mark.slow
def test_names_and_keys() -> None:
    files = [f for p in SHIPPED for f in sorted((ROOT / p).rglob("*.py"))]
    assert [found for f in files for found in banned_names(f)] == []


def test_headings() -> None:
    files = [*sorted((ROOT / "docs").rglob("*.md")), ROOT / "README.md"]
    assert [found for f in files for found in banned_headings(f)] == []


def fragments(file: Path) -> Iterator[str]:
    """Summaries of docstrings, and lines of Args and Attributes, that begin with "Of"."""
    for line, text in enumerate(file.read_text("utf-8").splitlines(), 1):
        if re.match(r'\s*(?:[rR]?"""|[*\w, ]+: )Of ', text):
            yield f"{file}:{line} {text.strip()}"


def test_docstrings_are_no_fragments() -> None:
    """Each line of a docstring can be read without the line above."""
    files = [f for p in SHIPPED for f in sorted((ROOT / p).rglob("*.py"))]
    assert len(files) > 200
    assert [found for f in files for found in fragments(f)] == []


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ('"""Of the effect."""', 1),
        ("    name: Of the effect.", 1),
        ("    x, y: Of the hub, m.", 1),
        ("    name: Name of the effect. Of all.", 0),
    ],
)
def test_fragments_are_found(tmp_path: Path, text: str, found: int) -> None:
    file = tmp_path / "a.py"
    file.write_text(text)
    assert len(list(fragments(file))) == found


SHORT = {"guide": 800, "method": 3000}
"""Words that a page of a folder has at most: a reader finishes it."""
MOST = {"README.md": 600, "docs/guide": 12_000}
"""Words of the README, and of all of the guide together."""
PAGES = [f for folder in SHORT for f in sorted((ROOT / "docs" / folder).glob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_pages_of_use_and_method_are_short_and_in_words_of_the_field(page: Path) -> None:
    text = page.read_text("utf-8")
    prose = re.sub(r"```.*?```|`[^`]*`|\]\([^)]*\)", " ", text, flags=re.DOTALL)
    assert words_of(prose) & BANNED == set()
    assert len(text.split()) <= SHORT[page.parent.name]


@pytest.mark.parametrize(("place", "most"), MOST.items())
def test_readme_and_guide_are_short(place: str, most: int) -> None:
    files = sorted((ROOT / place).glob("*.md")) or [ROOT / place]
    assert 0 < sum(len(f.read_text("utf-8").split()) for f in files) <= most


def test_pages_of_results_are_short() -> None:
    """Rows of data stand in files beside them."""
    pages = (ROOT / "docs" / "results").glob("*.md")
    words = {p.name: len(p.read_text("utf-8").split()) for p in pages}
    assert {n: count for n, count in words.items() if count > SHORT["method"]} == {}


@pytest.mark.parametrize(
    ("text", "found"),
    [("told_s = 1", 1), ("class LiveTold: pass", 1), ('x["felt"]', 1), ("tolds = unkept = 1", 0)],
)
def test_banned_words_are_found(tmp_path: Path, text: str, found: int) -> None:
    file = tmp_path / "a.py"
    file.write_text(text)
    assert len(list(banned_names(file))) == found
