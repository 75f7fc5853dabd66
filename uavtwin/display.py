"""Results as a person meets them: text in a console, a table in a notebook, one line as a value."""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from html import escape

from twin.representation import LONGEST


@dataclass(frozen=True, slots=True)
class TextTable:
    """Cells as text.

    Attributes:
        header: Of each column.
        rows: A cell per column.
    """

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def __str__(self) -> str:
        lines = (self.header, *self.rows)
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        return "\n".join(
            "  ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)).rstrip()
            for line in lines
        )

    def html(self) -> str:
        """As an HTML table."""
        head, *body = (
            "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in line)
            for tag, line in [("th", self.header), *(("td", row) for row in self.rows)]
        )
        rows = "".join(f"<tr>{cells}</tr>" for cells in body)
        return f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"


class DisplayMixin(ABC):
    """A result: `print` gives all that matters, a notebook the same, the prompt one line."""

    __slots__ = ()

    @abstractmethod
    def sections(self) -> Iterable[str | TextTable]:
        """What it says, the claim first."""

    @abstractmethod
    def brief(self) -> str:
        """What it is, in a few words."""

    def __str__(self) -> str:
        return "\n\n".join(map(str, self.sections()))

    def __repr__(self) -> str:
        text = self.brief()
        return f"<{text if len(text) <= LONGEST else text[: LONGEST - 3] + '...'}>"

    def _repr_html_(self) -> str:
        claim, *others = self.sections()
        return f"<p><b>{escape(str(claim))}</b></p>" + "".join(map(_html, others))


def _html(section: str | TextTable) -> str:
    if isinstance(section, TextTable):
        return section.html()
    return f"<p>{escape(section).replace(chr(10), '<br>')}</p>"
