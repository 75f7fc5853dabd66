"""Figures and tables of the page, as Markdown."""

from collections.abc import Iterable, Sequence

MICRO = {"T": ("µT", 1e6)}
"""Units that are shown in millionths."""


def in_shown_unit(value: float, unit: str) -> tuple[float, str]:
    """A value in the unit that people read, and that unit."""
    name, factor = MICRO.get(unit, (unit, 1.0))
    return factor * value, name


def figure(value: float) -> str:
    """Three significant digits; no exponent where a person would write none."""
    return f"{value:.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:.3g}"


def interval(value: float, ci95: tuple[float, float] | None, unit: str, mark: str = "") -> str:
    """A number with its interval, in the unit that people read."""
    text = f"{figure(in_shown_unit(value, unit)[0])}{mark}"
    if ci95 is None:
        return text
    low, high = (figure(in_shown_unit(end, unit)[0]) for end in ci95)
    return f"{text} ({low} to {high})"


def section(title: str) -> list[str]:
    """A heading below that of a scenario."""
    return ["", f"### {title}", ""]


def table(head: Sequence[str], lines: Iterable[Sequence[str]]) -> list[str]:
    """A Markdown table."""
    content = [
        f"| {' | '.join(c.replace('|', '&#124;') for c in line)} |" for line in (head, *lines)
    ]
    return [content[0], "|" + "---|" * len(head), *content[1:]]
