"""The reliability diagram: an SVG that needs no script, no font and no network."""

from collections.abc import Mapping, Sequence
from typing import Any

from .rates import wilson

SIZE, MARGIN = 360, 50
_COLOURS = ("#1f5fbf", "#d9731a", "#3a8f4d")
_TICKS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
_FONT = 'font-family="Helvetica, Arial, sans-serif" font-size="12"'


def reliability_svg(curves: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Share that came true over the probability that was said, with 95 % intervals.

    Args:
        curves: Bins of `chances.reliability` by what they are of.
    """
    whole = SIZE + 2 * MARGIN
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {whole} {whole}" {_FONT}>',
        f'<rect width="{whole}" height="{whole}" fill="#ffffff"/>',
        _line(0, 0, 1, 1, "#b9c0cc", dashed=True),
        _line(0, 0, 1, 0, "#1a1d29"),
        _line(0, 0, 0, 1, "#1a1d29"),
    ]
    for tick in _TICKS:
        parts.append(_text(_x(tick), _y(0) + 18, f"{tick:g}", "middle"))
        parts.append(_text(_x(0) - 8, _y(tick) + 4, f"{tick:g}", "end"))
    parts.append(_text(_x(0.5), whole - 12, "probability that was said", "middle"))
    turn = f'transform="rotate(-90 14 {_y(0.5):.1f})"'
    parts.append(_text(14, _y(0.5), "share of effects that were hidden", "middle", turn))
    for i, (name, bins) in enumerate(curves.items()):
        colour = _COLOURS[i % len(_COLOURS)]
        parts.append(_text(_x(0.04), _y(0.96 - 0.06 * i), name, "start", f'fill="{colour}"'))
        points = [(b["said"], b["came_true"] / b["n"]) for b in bins]
        path = " ".join(f"{_x(p):.1f},{_y(q):.1f}" for p, q in points)
        parts.append(
            f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="1.5"/>'
        )
        for (p, q), b in zip(points, bins, strict=True):
            low, high = wilson(b["came_true"], b["n"]) or (q, q)
            parts.append(_line(p, low, p, high, colour))
            parts.append(
                f'<circle cx="{_x(p):.1f}" cy="{_y(q):.1f}" r="4" fill="{colour}">'
                f"<title>{b['came_true']} of {b['n']}</title></circle>"
            )
    return "\n".join([*parts, "</svg>"]) + "\n"


def _x(value: float) -> float:
    return MARGIN + SIZE * value


def _y(value: float) -> float:
    return MARGIN + SIZE * (1 - value)


def _line(x0: float, y0: float, x1: float, y1: float, colour: str, dashed: bool = False) -> str:
    dash = ' stroke-dasharray="5 4"' if dashed else ""
    return (
        f'<line x1="{_x(x0):.1f}" y1="{_y(y0):.1f}" x2="{_x(x1):.1f}" y2="{_y(y1):.1f}" '
        f'stroke="{colour}"{dash}/>'
    )


def _text(x: float, y: float, words: str, anchor: str, more: str = "") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" {more}>{words}</text>'
