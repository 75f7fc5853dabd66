"""Is a predicted spread what the errors really are? Shares within it, and spread against error."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..data.channels import CHANNELS, GROUPS, UNITS
from ..data.flights import ResidualFlight
from ..model.corrected import Corrected, Model
from . import metrics

Array = NDArray[np.float64]
GAUSSIAN = (0.6827, 0.9545)
"""Share of samples within one and two spreads where the errors are Gaussian of that spread."""


def calibration(model: Model, flights: Sequence[ResidualFlight]) -> pd.DataFrame:
    """Share of fresh samples within one and two predicted spreads.

    Args:
        model: Its spread is judged.
        flights: None of them of its training.

    Returns:
        A row per channel group: group, n, within_1, within_2; to be held against `GAUSSIAN`.
    """
    corrected = [model.run(f) for f in flights]
    rows = []
    for group in GROUPS:
        left, spread = _samples(flights, corrected, group)
        shares = [metrics.coverage(left, spread, k) for k in (1, 2)]
        rows.append({"group": group, "n": len(left), "within_1": shares[0], "within_2": shares[1]})
    return pd.DataFrame(rows)


def reliability(model: Model, flights: Sequence[ResidualFlight], bins: int = 10) -> pd.DataFrame:
    """Predicted spread against what is really left, samples in order of the predicted spread.

    Args:
        model: Its spread is judged.
        flights: None of them of its training.
        bins: Equal parts per group.

    Returns:
        A row per group and part: group, unit, part, predicted, left (both rms); groups without a
        sample have none.
    """
    corrected = [model.run(f) for f in flights]
    rows = []
    for group, columns in GROUPS.items():
        curve = metrics.reliability(*_samples(flights, corrected, group), bins)
        for k, (predicted, left) in enumerate(curve):
            rows.append(
                {
                    "group": group,
                    "unit": UNITS[columns][0],
                    "part": k,
                    "predicted": float(predicted),
                    "left": float(left),
                }
            )
    return pd.DataFrame(rows, columns=["group", "unit", "part", "predicted", "left"])


def _samples(
    flights: Sequence[ResidualFlight], corrected: Sequence[Corrected], group: str
) -> tuple[Array, Array]:
    """What is left and its predicted spread at the fresh samples of a group, shape (n,) each."""
    left, spread = [], []
    for flight, said in zip(flights, corrected, strict=True):
        for c in range(len(CHANNELS))[GROUPS[group]]:
            here = flight.fresh[:, c]
            left.append(flight.residual[here, c] - said.correction[here, c])
            spread.append(said.spread[here, c])
    return np.concatenate(left), np.concatenate(spread)
