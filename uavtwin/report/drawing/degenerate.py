"""Whether a figure shows anything."""

import json
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from ..page import Plot
from .series import unpacked


def degenerate(figure: Plot) -> Iterator[str]:
    """What is wrong with a figure: no curve, a single point, no extent, panels that overlap.

    Args:
        figure: As a page holds it.
    """
    content = json.loads(figure.json)
    data, layout = content["data"], content["layout"]
    if not data:
        yield "no curve"
    for trace in data:
        x, y = (unpacked(trace[k]) for k in "xy")
        known = np.isfinite(x) & np.isfinite(y)
        if known.sum() < 2:
            yield f"{trace.get('name')}: {known.sum()} points"
        elif np.ptp(x[known]) <= 0 and np.ptp(y[known]) <= 0:
            yield f"{trace.get('name')}: one dot"
    domains = sorted(v["domain"] for k, v in layout.items() if k.startswith("yaxis"))
    if any(high > low for (_, high), (low, _) in pairwise(domains)):
        yield "panels overlap"
    titles = [v["title"]["text"] for k, v in layout.items() if k.startswith("yaxis")]
    if not all(titles):
        yield "an axis without a title"
