"""The tour of docs/dev/tour.md names files and definitions that exist."""

import ast
import re

from places import ROOT


def test_what_the_tour_names_exists() -> None:
    text = (ROOT / "docs" / "dev" / "tour.md").read_text()
    stops = re.findall(r"`(\w[\w/]*\.py)`(?:: `([\w.]+)`)?", text)
    assert len(stops) > 10
    for file, name in stops:
        tree = ast.parse((ROOT / file).read_text())
        for part in filter(None, name.split(".")):
            found = [n for n in ast.iter_child_nodes(tree) if getattr(n, "name", "") == part]
            assert found, f"{file} has no {name}"
            tree = found[0]
