"""How the figures of the paper look."""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

MAX_POINTS = 4000
"""Samples of one trace above which the plot, never the numbers, is thinned."""


def thin(values: NDArray[np.float64] | Sequence[float], every: int = 1) -> list[float]:
    """Every `every`-th value, with six digits: what a page holds of it."""
    return [float(f"{v:.6g}") for v in np.asarray(values, dtype=np.float64)[::every]]


def styled(figure: go.Figure, height: int) -> go.Figure:
    """The figure with the margins of all pages, height in pixels."""
    figure.update_layout(height=height, margin={"l": 76, "r": 20, "t": 24, "b": 44})
    return figure
