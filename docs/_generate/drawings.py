"""Draw the two pictures of the architecture page: the layers, and what flows through them.

    python docs/_generate/drawings.py

writes SVG that needs nothing else: no script, no font, no network.
"""

import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

PICTURES = Path(__file__).parents[1] / "pictures"
INK, QUIET, LINE, PAPER = "#1a1d29", "#5b6270", "#b9c0cc", "#ffffff"
COLOURS = {
    "front door": "#e8eefb",
    "users of the twin": "#fdf0e1",
    "twin": "#eef4ee",
    "result": "#fff7cf",
    "input": "#f1f2f5",
}
FONT = 'font-family="Helvetica, Arial, sans-serif"'

WORDS = {
    "benchmarks": "is all that right? On aircraft that share no code with twin",
    "uavtwin": "the front door: names for Python, cli/, report/, demo/",
    "cosim": "systems (SSP), master, recordings",
    "fmus": "components to C to FMUs",
    "learning": "compensator to ONNX; alone needs torch",
    "twin.why": "why a flight went wrong, from its log alone",
    "twin.explain": "find, name, add, show; the result",
    "twin.explain.stochastic": "no mean: gust, noise",
    "twin.explain.unnamed": "equations",
    "twin.explain.design": "what to fly next",
    "twin.explain.inference": "likelihood, fit, selection, adequacy",
    "twin.explain.settings": "the numbers that decide a verdict, with their origin",
    "twin.explain.setting_group": "unit, meaning, origin of a setting",
    "twin.explain.model": "residuals as a function of the numbers of effects",
    "twin.residuals": "aligned flight, prediction, gap",
    "twin.flight": "controllers, missions, closed loop",
    "twin.draft": "a vehicle file from flights, mass and size",
    "twin.logs": "any format to one flight table",
    "twin.physics": "airframe, rotors, ground, battery, air, sensors/",
    "twin.effects": "the library of named causes",
    "twin.vehicle_file": "TOML with units and sources; convert/",
    "twin.vehicle": "numbers of one aircraft, its sensors, its site",
    "twin.component": "an equation written once: builder, rows, noise",
    "twin.errors": "what a user can mend",
    "twin.frames": "NED, FRD, rotations",
    "twin.formatting": "numbers as text",
    "twin.representation": "values in a line or two",
    "twin.topic_mapping": "names of topics of a ROS 2 bag",
    "twin.scratch": "temporary files, swept",
}
"""What each room of the list of layers holds."""
OF_THE_TWIN = {"learning", "fmus", "cosim"}


@dataclass(frozen=True, slots=True)
class Box:
    """A box of the flow: place of its left upper corner, pixels, title, words below, kind."""

    x: int
    y: int
    title: str
    words: str
    kind: str
    width: int = 170
    height: int = 52


FLOW = {
    "log": Box(10, 20, "log", "PX4, flight table", "input"),
    "file": Box(10, 130, "vehicle file", "numbers with source", "input"),
    "flight": Box(225, 20, "Flight", "twin.logs", "twin"),
    "vehicle": Box(225, 130, "Vehicle", "twin.vehicle", "twin"),
    "components": Box(225, 240, "components", "twin.physics + effects", "twin"),
    "aligned": Box(440, 20, "aligned flight", "twin.residuals", "twin"),
    "residuals": Box(440, 130, "residuals", "measured - simulated", "twin"),
    "gap": Box(655, 20, "gap", "gap.json, report", "result"),
    "explain": Box(655, 130, "explanation", "twin.explain", "twin"),
    "better": Box(870, 130, "better vehicle file", "explain.json, report", "result"),
    "compensator": Box(655, 240, "compensator", "learning: ONNX", "twin"),
    "fmu": Box(870, 240, "FMU, SSP", "fmus, cosim", "result"),
}
ARROWS = (
    ("log", "flight"),
    ("flight", "aligned"),
    ("file", "vehicle"),
    ("vehicle", "components"),
    ("aligned", "residuals"),
    ("components", "residuals"),
    ("residuals", "gap"),
    ("residuals", "explain"),
    ("residuals", "compensator"),
    ("explain", "better"),
    ("better", "fmu"),
    ("compensator", "fmu"),
)


def rooms() -> list[list[str]]:
    """Layers of the contracts in `pyproject.toml`, the top first, those side by side together."""
    settings = tomllib.loads((PICTURES.parents[1] / "pyproject.toml").read_text("utf-8"))
    contracts = settings["tool"]["importlinter"]["contracts"]
    packages, twin, explain = [c["layers"] for c in contracts if c["type"] == "layers"][:3]
    below = [[f"twin.{name}" for name in _side_by_side(layer)] for layer in twin]
    return [
        *([name] for name in packages if name != "twin"),
        below[0],
        *(_side_by_side(layer) for layer in explain),
        *below[1:],
    ]


def _side_by_side(layer: str) -> list[str]:
    return [name.strip() for name in re.split("[|:]", layer)]


def layers() -> str:
    """The layers as SVG."""
    width, high, gap, left = 860, 40, 6, 8
    rows = []
    for i, side_by_side in enumerate(rooms()):
        n = len(side_by_side)
        each = (width - 2 * left - gap * (n - 1)) / n
        for k, name in enumerate(side_by_side):
            x, y = left + k * (each + gap), left + i * (high + gap)
            rows.append(_box(x, y, each, high, COLOURS[_kind(name)]))
            if n < 3:
                rows.append(_text(x + 12, y + 25, name, INK, bold=True))
                rows.append(_text(x + each - 12, y + 25, WORDS[name], QUIET, "end", 13))
            else:
                rows.append(_text(x + 12, y + 17, name, INK, bold=True))
                rows.append(_text(x + 12, y + 33, WORDS[name], QUIET, size=12))
    height = 2 * left + len(rooms()) * (high + gap) - gap
    return _svg(width, height, "Layers: imports go downwards only", rows)


def _kind(room: str) -> str:
    if room.startswith("twin"):
        return "twin"
    return "users of the twin" if room in OF_THE_TWIN else "front door"


def flow() -> str:
    """The flow of data as SVG."""
    rows = [
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" '
        f'markerHeight="8" orient="auto"><path d="M0 0 8 4 0 8z" fill="{QUIET}"/></marker></defs>'
    ]
    rows += [_arrow(FLOW[a], FLOW[b]) for a, b in ARROWS]
    for box in FLOW.values():
        rows.append(_box(box.x, box.y, box.width, box.height, COLOURS[box.kind]))
        middle = box.x + box.width / 2
        rows.append(_text(middle, box.y + 22, box.title, INK, anchor="middle", bold=True))
        rows.append(_text(middle, box.y + 41, box.words, QUIET, anchor="middle", size=12))
    return _svg(1050, 312, "From a log to a better twin", rows)


def _arrow(start: Box, end: Box) -> str:
    """A line from the side of a box that faces the other: right to left, or down."""
    if end.x > start.x:
        x1, y1 = float(start.x + start.width), start.y + start.height / 2
        x2, y2 = float(end.x - 2), end.y + end.height / 2
    else:
        x1 = x2 = start.x + start.width / 2
        y1, y2 = float(start.y + start.height), float(end.y - 2)
    return (
        f'<line x1="{x1:g}" y1="{y1:g}" x2="{x2:g}" y2="{y2:g}" stroke="{QUIET}" '
        'stroke-width="1.5" marker-end="url(#tip)"/>'
    )


def _box(x: float, y: float, width: float, height: float, colour: str) -> str:
    return (
        f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="6" '
        f'fill="{colour}" stroke="{LINE}"/>'
    )


def _text(
    x: float,
    y: float,
    text: str,
    colour: str,
    anchor: str = "start",
    size: int = 14,
    bold: bool = False,
) -> str:
    weight = ' font-weight="bold"' if bold else ""
    return (
        f'<text x="{x:g}" y="{y:g}" {FONT} font-size="{size}" fill="{colour}" '
        f'text-anchor="{anchor}"{weight}>{escape(text)}</text>'
    )


def _svg(width: int, height: int, title: str, content: Sequence[str]) -> str:
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        f'width="{width}" height="{height}" role="img">'
    )
    paper = f'<rect width="{width}" height="{height}" fill="{PAPER}"/>'
    return "\n".join([head, f"<title>{escape(title)}</title>", paper, *content, "</svg>\n"])


def main() -> None:
    """Write both."""
    (PICTURES / "layers.svg").write_text(layers(), "utf-8")
    (PICTURES / "data_flow.svg").write_text(flow(), "utf-8")


if __name__ == "__main__":
    main()
