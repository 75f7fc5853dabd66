"""Markdown of a card: texts that come from files, and tables."""

import re
from collections.abc import Sequence
from typing import Any

Table = tuple[list[str], list[list[str]]]
"""Header and rows."""


def plain(text: Any) -> str:
    """A text from a file as one cell of Markdown: no markup, no line ends, no other cell."""
    one_line = " ".join(str(text).split())
    return re.sub(r"([\\`*\[\]<>|&])", r"\\\1", one_line)


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of Markdown; texts pass `plain`."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(
        "| " + " | ".join(c if c == "---" else plain(c) for c in line) + " |" for line in lines
    )
