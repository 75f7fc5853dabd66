"""Self-contained HTML pages: style, figures and the plotting library."""

import gzip
import json
import re
from base64 import b64encode
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jinja2
from markupsafe import Markup

from twin.formatting import certainty, number, percent, pretty_unit

if TYPE_CHECKING:
    import plotly.graph_objects as go

Figure = dict[str, Any]
"""`data` and `layout` of a figure in the form of plotly.js."""

HERE = Path(__file__).parent
"""Folder of the templates and of the plotting library."""
BLACK, BLUE, ORANGE, GREY = "#000000", "#1f5fd0", "#e07b1a", "#8a8f98"
"""Colours of measured, nominal twin, compensated twin, residual, on every page."""
DARK = {
    BLACK: "#f2f4f7",
    BLUE: "#6ea8ff",
    ORANGE: "#ffa24d",
    GREY: "#99a2ae",
    "#c3c7cd": "#6d7580",
    "#2f8f5b": "#54c98a",
    "#8a4fbf": "#ba8df0",
    "#b58900": "#dfb647",
    "#c23b66": "#f27a9f",
    "#3aa0a8": "#5ccad2",
    "#5fb8c9": "#84d8e6",
    "#6b7280": "#a3abb7",
    "#d9622b": "#ff8f5c",
}
"""Colours of figures on a dark page, by the colour on a light page."""


@dataclass(frozen=True, slots=True)
class Plot:
    """Content of one figure for a template.

    Attributes:
        id: Identifier of its element.
        label: Description of the figure, for screen readers.
        height: Height in pixels.
        json: Figure as JSON, safe within a script element.
        scene: Whether it is a track in space instead of a plot.
        time: Group of figures with common time axes, "" where the axis is not time.
    """

    id: str
    label: str
    height: int
    json: Markup
    scene: bool = False
    time: str = ""


def plot(name: str, label: str, figure: "Figure | go.Figure", scene: bool = False) -> Plot:
    """A figure in the form of a template.

    Args:
        name: Identifier on the page; invalid characters are removed.
        label: Description in words.
        figure: Figure with its height in the layout; a track in space has its own.
        scene: Whether it is a track in space.
    """
    plain = _plain(figure)
    layout = plain.get("layout", plain)
    layout.pop("template", None)  # pages style their figures themselves
    identifier = re.sub(r"[^\w.@-]", "-", name)
    time = str(layout.get("meta", {}).get("time", ""))
    return Plot(identifier, label, int(layout["height"]), embedded(plain), scene, time)


def _plain(figure: "Figure | go.Figure") -> Figure:
    """A figure of plotly's objects as plain values."""
    return figure if isinstance(figure, dict) else dict(json.loads(figure.to_json()))


def embedded(value: Any) -> Markup:
    """A value as JSON that is safe inside a script element."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"))
    safe = text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
    return Markup(safe)


@cache
def _parts() -> dict[str, Markup]:
    """Common parts of every page."""
    bundle = (HERE / "vendor" / "plotly-basic.min.js.gz").read_bytes()
    licence = (HERE / "vendor" / "plotly-LICENSE.txt").read_text("utf-8")
    return {
        "style": Markup((HERE / "page.css").read_text("utf-8")),
        "script": Markup((HERE / "page.js").read_text("utf-8")),
        "licence": Markup(licence),
        "plotlyjs": Markup(b64encode(bundle).decode("ascii")),
        "dark": embedded(DARK),
    }


FILTERS: Mapping[str, Callable[..., Any]] = {
    "number": number,
    "percent": percent,
    "unit": pretty_unit,
    "certainty": certainty,
}
"""Jinja filters of all pages."""


def render(
    template: str,
    filters: Mapping[str, Callable[..., Any]] | None = None,
    folder: Path | None = None,
    **content: Any,
) -> str:
    """Text of a page.

    Args:
        template: File of `templates` that extends `page.html.j2`.
        filters: Jinja filters in addition to `FILTERS`.
        folder: Folder of the template, if not this one.
        content: Values for the template; text is escaped, half characters are written out.
    """
    own = jinja2.PackageLoader("uavtwin.report", "templates")
    elsewhere = [] if folder is None else [jinja2.FileSystemLoader(folder)]
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader([own, *elsewhere]),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {**FILTERS, **(filters or {})}
    page = environment.get_template(template).render(**_parts(), **content)
    page = _packed(_indexed(page))
    return page.encode("utf-8", "backslashreplace").decode("utf-8")


def _packed(page: str) -> str:
    """The page with all figures packed into one script, in which common parts occur once."""
    found: dict[str, str] = {}

    def taken(figure: re.Match[str]) -> str:
        begin, name, content = figure.groups()
        found[name] = content
        return f"{begin}</script>"

    page = _FIGURE.sub(taken, page)
    whole = ",".join(f"{json.dumps(name)}:{content}" for name, content in found.items())
    raw = gzip.compress(f"{{{whole}}}".encode("ascii"), mtime=0)
    return page.replace("<!--figures-->", b64encode(raw).decode("ascii"), 1)


_FIGURE = re.compile(
    r'(<script type="application/json" data-for="([^"]*)"[^>]*>)(.*?)</script>', re.DOTALL
)
"""A figure in the text of a page."""


def _indexed(page: str) -> str:
    """The page with links to its headings at the top, if there are several."""
    heads = re.findall(r'<h2 id="([^"]+)">(.*?)</h2>', page)
    if len(heads) < 2:
        return page
    links = "".join(f'<a href="#{name}">{text}</a>' for name, text in heads)
    return page.replace(
        "<!--index-->", f'<nav class="index" aria-label="On this page">{links}</nav>', 1
    )
