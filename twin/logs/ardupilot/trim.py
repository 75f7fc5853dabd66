"""The yaw trim of a flight: what rotors of one sense get beyond those of the other."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from .geometry import Geometry

_FLYING = ("hover", "forward", "tour")
_FEWEST = 20


@dataclass(frozen=True, slots=True)
class YawTrim:
    """What a flight gives to rotors of one sense beyond those of the other, to hold its heading.

    Attributes:
        command: Mean command of the clockwise rotors less that of the others.
        share: The same as a share of the mean command of all.
        n: Samples.
    """

    command: float
    share: float
    n: int

    def __str__(self) -> str:
        more = "more" if self.command >= 0.0 else "less"
        return (
            f"clockwise rotors get {abs(self.command):.3f} {more} than the others, "
            f"{abs(self.share):.1%} of the mean command"
        )


def yaw_trim(table: pd.DataFrame, rotors: Geometry) -> YawTrim | None:
    """Yaw trim of a flight, from its commands in hover and forward flight.

    Args:
        table: Flight table, its commands in the order of the rotors.
        rotors: Senses of the rotors.

    Returns:
        None where it has too few commands in the air.
    """
    names = [f"cmd_{k + 1}" for k in range(rotors.count)]
    if any(c not in table for c in names) or f"cmd_{rotors.count + 1}" in table:
        return None
    phase = table["phase"].replace("", np.nan).ffill()
    rows = table.loc[phase.isin(_FLYING), names].dropna().to_numpy(dtype=np.float64)
    if len(rows) < _FEWEST or len(set(rotors.sense)) < 2:
        return None
    clockwise = rotors.turn < 0.0
    apart = float(rows[:, clockwise].mean() - rows[:, ~clockwise].mean())
    return YawTrim(apart, apart / float(rows.mean()), len(rows))
