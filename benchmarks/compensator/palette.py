"""What the figures of the paper share: colours, channels that stand for their sensors, units."""

import numpy as np
from numpy.typing import NDArray

from learning.data.channels import UNITS
from learning.data.paper_tables import GAUSS_T

COLOURS = (
    *("#1f5fd0", "#e07b1a", "#2f8f5b", "#8a4fbf", "#c23b66", "#5fb8c9", "#b58900", "#8a8f98"),
    *("#7a5230", "#d98cb3", "#3f3f3f", "#9bbf3b", "#4b6f9e", "#e3b23c", "#6b8e7f", "#b04a2f"),
)
SHOWN = ("gyro_x", "acc_x", "mag_x", "pos_x", "vel_x")
"""Channels that are drawn over time, one of each sensor."""


def colours(count: int) -> list[str]:
    """So many, over again where there are not enough."""
    return [COLOURS[i % len(COLOURS)] for i in range(count)]


def printed_units() -> NDArray[np.float64]:
    """SI units in one of those that are printed, shape (15,)."""
    return np.array([GAUSS_T if unit == "T" else 1.0 for unit in UNITS])


def unit_of(channel: int) -> str:
    """As printed."""
    return "gauss" if UNITS[channel] == "T" else UNITS[channel]
