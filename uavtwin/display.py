"""Display of results: text in a console, a table in a notebook, one line as a value."""

from collections.abc import Iterable
from dataclasses import dataclass
from html import escape
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar, Protocol

from twin.representation import LONGEST

from .output import output_file
from .record import Record


@dataclass(frozen=True, slots=True)
class TextTable:
    """Cells as text.

    Attributes:
        header: Heading of each column.
        rows: A cell per column.
        unbroken: Columns whose cells are never wrapped.
    """

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    unbroken: tuple[int, ...] = (0,)

    def _widths(self) -> list[int]:
        return [max(map(len, column)) for column in zip(self.header, *self.rows, strict=True)]

    @property
    def width(self) -> int:
        """Largest number of characters of a line."""
        widths = self._widths()
        return sum(widths) + 2 * len(widths)

    def upright(self) -> str:
        """A line per cell that is not empty, a block per row."""
        name = max(map(len, self.header), default=0)
        blocks = (
            "\n".join(f"{n.ljust(name)}  {c}" for n, c in zip(self.header, row, strict=True) if c)
            for row in self.rows
        )
        return "\n\n".join(blocks)

    def __str__(self) -> str:
        lines, widths = (self.header, *self.rows), self._widths()
        return "\n".join(
            "  ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)).rstrip()
            for line in lines
        )

    def html(self) -> str:
        """The table as HTML."""
        head, *body = (
            "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in line)
            for tag, line in [("th", self.header), *(("td", row) for row in self.rows)]
        )
        rows = "".join(f"<tr>{cells}</tr>" for cells in body)
        return f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"


class Recorded(Protocol):
    """A result with a record."""

    @property
    def record(self) -> Record:
        """Record of every number."""


class DisplayMixin:
    """A result with text forms: `print` and notebooks show everything important, the prompt one
    line."""

    __slots__ = ()

    def findings(self) -> Iterable[str | TextTable]:
        """Text of the result, the main sentence first."""
        raise NotImplementedError

    def sections(self) -> Iterable[str | TextTable]:
        """Findings, then warnings where the result has some."""
        yield from self.findings()
        if warnings := getattr(self, "warnings", ()):
            yield "\n".join(warnings)

    def brief(self) -> str:
        """Short description."""
        raise NotImplementedError

    def json(self: Recorded) -> dict[str, Any]:
        """The record as strict JSON content, as printed by `--json`."""
        return self.record.json()

    def __str__(self) -> str:
        return "\n\n".join(map(str, self.sections()))

    def __repr__(self) -> str:
        text = self.brief()
        return f"<{text if len(text) <= LONGEST else text[: LONGEST - 3] + '...'}>"

    def _repr_html_(self) -> str:
        claim, *others = self.sections()
        return f"<p><b>{escape(str(claim))}</b></p>" + "".join(map(_html, others))


class PageMixin(DisplayMixin):
    """A result with a page."""

    __slots__ = ()

    page: ClassVar[str]
    """Module whose `page_text` creates the HTML of the result. It is given as text, since pages
    print results and are above them in the import order."""

    def report(self, path: str | Path) -> Path:
        """Write the page, one self-contained HTML file; returns its path."""
        with output_file(Path(path)) as file:
            self.draw(file)
        return Path(path)

    def draw(self, file: Path) -> None:
        """Write the page into a file of a results folder, which converts errors."""
        file.write_text(import_module(self.page).page_text(self), encoding="utf-8")


def _html(section: str | TextTable) -> str:
    if isinstance(section, TextTable):
        return section.html()
    return f"<p>{escape(section).replace(chr(10), '<br>')}</p>"
