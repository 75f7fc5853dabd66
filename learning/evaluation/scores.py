"""What one row of an evaluation holds: which samples, and the figures of what is left of them."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.errors import ModelError

from ..data.channels import CHANNELS, GROUPS, N_PHASES, PHASE_CODES, UNITS
from ..data.flights import ResidualFlight
from ..model.baselines import phase_means
from ..model.corrected import Corrected
from . import metrics

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
WHOLE = "all"
"""Phase of the rows over a whole flight."""
GROUP_OF = {c: g for g, columns in GROUPS.items() for c in CHANNELS[columns]}
PHASE_OF = {code: name for name, code in PHASE_CODES.items()}


def residual_scale(train: Sequence[ResidualFlight]) -> Array:
    """Spread of the training residual, shape (phases, 15); 1 where there is none."""
    mean = phase_means(train)
    pooled = [
        np.concatenate([f.residual[f.fresh[:, c], c] for f in train]) for c in range(len(CHANNELS))
    ]
    spread = np.tile([v.std() if len(v) else 0.0 for v in pooled], (N_PHASES, 1))
    return np.where(spread > 1e-9 * np.abs(mean) + 1e-15, spread, 1.0)


def cells(flight: ResidualFlight) -> Iterator[tuple[str, int, str, BoolArray]]:
    """Phase, number and name of the channel, and fresh samples there, shape (n,), of each row."""
    for c, channel in enumerate(CHANNELS):
        fresh = flight.fresh[:, c]
        if not fresh.any():
            continue
        yield WHOLE, c, channel, fresh
        for code in np.unique(flight.phase[fresh]):
            yield PHASE_OF[int(code)], c, channel, fresh & (flight.phase == code)


class Cell:
    """One channel of one flight in one phase, to be scored under several models."""

    def __init__(
        self,
        flight: ResidualFlight,
        phase: str,
        c: int,
        channel: str,
        here: BoolArray,
        scale: Array,
    ) -> None:
        """Take the samples; what holds for all models is computed once."""
        self._c, self._here = c, here
        self._residual = flight.residual[here, c]
        self._t_s, self._scale = flight.t_s[here], scale[flight.phase[here], c]
        self._before = metrics.rmse(self._residual)
        self._spread_before = metrics.spread_of(self._residual)
        self._powers = self._bands("before", self._residual)
        self._key = {
            "flight": flight.name,
            "phase": phase,
            "channel": channel,
            "group": GROUP_OF[channel],
            "unit": UNITS[c],
            "n": len(self._residual),
        }

    def scored(self, corrected: Corrected) -> dict[str, Any]:
        """A row of the table."""
        here, scale = self._here, self._scale
        correction, spread = corrected.correction[here, self._c], corrected.spread[here, self._c]
        left = self._residual - correction
        rmse, spread_left = metrics.rmse(left), metrics.spread_of(left)
        return {
            **self._key,
            "mse": rmse**2,
            "rmse": rmse,
            "mae": metrics.mae(left),
            "wasserstein": metrics.wasserstein(self._residual, correction),
            "rmse_before": self._before,
            "removed": metrics.share_removed(rmse, self._before),
            "spread_before": self._spread_before,
            "spread_left": spread_left,
            "removed_beyond_constant": metrics.share_removed(spread_left, self._spread_before),
            "mse_std": metrics.mse(left / scale),
            "rmse_std": metrics.rmse(left / scale),
            "mae_std": metrics.mae(left / scale),
            "wasserstein_std": metrics.wasserstein(self._residual / scale, correction / scale),
            "inside": float(np.mean(corrected.inside[here])),
            "within_1": metrics.coverage(left, spread, 1),
            "within_2": metrics.coverage(left, spread, 2),
            **self._powers,
            **self._bands("left", left),
        }

    def _bands(self, stem: str, values: Array) -> dict[str, float]:
        powers = metrics.band_powers(self._t_s, values)
        return {f"{stem} {b}": float(p) for b, p in zip(metrics.BANDS, powers, strict=True)}


def check_flights(train: Sequence[ResidualFlight], test: Sequence[ResidualFlight]) -> None:
    """Raise ModelError unless there are flights of one rate, none in both."""
    if not train or not test:
        raise ModelError(
            f"{len(train)} training and {len(test)} test flights: give at least one of each."
        )
    rates = sorted({f.rate_hz for f in (*train, *test)})
    if len(rates) > 1:
        raise ModelError(f"flights at {rates} Hz: make the residuals anew at one rate.")
    twice = sorted({f.name for f in train} & {f.name for f in test})
    if twice:
        raise ModelError(f"flights {twice} are in training and test: split by flight.")


def check_finite(name: str, flight: ResidualFlight, corrected: Corrected) -> None:
    """Raise ModelError where a scored correction or spread is not finite."""
    bad = flight.fresh & ~(np.isfinite(corrected.correction) & np.isfinite(corrected.spread))
    if bad.any():
        row, channel = (int(i) for i in np.argwhere(bad)[0])
        raise ModelError(
            f"{name}: correction or spread of {CHANNELS[channel]} is not finite at "
            f"{flight.t_s[row]:.3f} s of {flight.name}, phase {PHASE_OF[int(flight.phase[row])]}. "
            f"Did the training diverge?"
        )
