"""HTML pages that need nothing but themselves: style, figures and the library that draws them."""

from collections.abc import Callable, Mapping
from typing import Any

import jinja2
from markupsafe import Markup
from plotly.offline import get_plotlyjs


def render(template: str, filters: Mapping[str, Callable[..., Any]], **content: Any) -> str:
    """Text of a page.

    Args:
        template: File of `templates` that extends `page.html.j2`.
        filters: Jinja filters it uses.
        content: What it shows; text is escaped.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("uavtwin.report", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(filters)
    return environment.get_template(template).render(plotlyjs=Markup(get_plotlyjs()), **content)
