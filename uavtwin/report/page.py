"""HTML pages that need nothing but themselves: style, figures and the library that draws them."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup
from plotly.offline import get_plotlyjs


def render(
    template: str,
    filters: Mapping[str, Callable[..., Any]],
    folder: Path | None = None,
    **content: Any,
) -> str:
    """Text of a page.

    Args:
        template: File of `templates` that extends `page.html.j2`.
        filters: Jinja filters it uses.
        folder: Where the template lies, if not here.
        content: What it shows; text is escaped, half characters are written out.
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
    environment.filters.update(filters)
    page = environment.get_template(template).render(plotlyjs=Markup(get_plotlyjs()), **content)
    return page.encode("utf-8", "backslashreplace").decode("utf-8")
