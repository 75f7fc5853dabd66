"""Evaluation of models under a named protocol, with baselines, as one tidy table.

Only fresh samples are scored. A row gives the errors of one model in one channel of one flight in
one phase ("all": the whole flight):

| column | meaning |
|---|---|
| n | samples |
| mse, rmse, mae | errors, residual minus correction, units of the channel |
| wasserstein | distance between the distributions of residual and correction |
| rmse_before, removed | uncorrected rms, and its relative reduction |
| spread_before, spread_left | standard deviations in this row, uncorrected and corrected |
| removed_beyond_constant | relative reduction of the standard deviation |
| inside | share of samples within the model's envelope |
| within_1, within_2 | share of samples within one and two predicted spreads |
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import wasserstein_distance

from twin.errors import ModelError

from .data.channels import CHANNELS, GROUPS, PHASE_CODES, UNITS
from .data.flights import ResidualFlight
from .model.baselines import fit_baselines
from .model.family import Corrected, Model, TrainingTask

_MEANS = ("mse", "mae", "wasserstein", "inside", "within_1", "within_2")
"""Columns that are pooled with their numbers of samples as weights."""
_ROOTS = ("rmse_before", "spread_before", "spread_left")
"""Columns whose squares are pooled in this way."""


def evaluate(
    model: Model | Mapping[str, Model] | None,
    train: Sequence[ResidualFlight],
    test: Sequence[ResidualFlight],
    task: TrainingTask,
) -> pd.DataFrame:
    """Score models and the baselines of their protocol.

    Args:
        model: One model, named "model", several by name, or None for the baselines alone.
        train: Training flights of the baselines.
        test: Flights to score, none of them in `train`.
        task: Protocol, horizon and seed of the models.

    Returns:
        Table with one row per model, flight, phase and channel; see the module. A channel without a
        fresh sample has no row.

    Raises:
        ModelError: There are no flights, rates differ, or a correction is not finite.
    """
    check_flights(train, test)
    models = fitted(model, train, task)
    rows: list[dict[str, Any]] = []
    for name, each in models.items():
        head = {"protocol": task.protocol, "horizon": task.horizon, "model": name}
        for flight in test:
            corrected = each.run(flight)
            check_finite(name, flight, corrected)
            rows += [head | row for row in scored(flight, corrected)]
    return _with_shares(pd.DataFrame(rows))


def fitted(
    model: Model | Mapping[str, Model] | None, train: Sequence[ResidualFlight], task: TrainingTask
) -> dict[str, Model]:
    """The baselines of a task and the models, by name."""
    named = dict(model) if isinstance(model, Mapping) else {} if model is None else {"model": model}
    baselines = fit_baselines(train, task.protocol, task.horizon)
    if both := sorted(set(named) & set(baselines)):
        raise ModelError(f"models {both} are called like baselines: give them other names.")
    return {**baselines, **named}


def pooled(
    table: pd.DataFrame,
    by: Sequence[str] = ("protocol", "horizon", "model", "group", "phase"),
) -> pd.DataFrame:
    """Rows of `evaluate` pooled: squares and shares weighted by their numbers of samples.

    Args:
        table: Table of `evaluate`.
        by: Columns to group by; units must be equal within a group for the figures in physical
            units to be meaningful.

    Returns:
        Pooled rows in order of appearance; Wasserstein distances are weighted means.
    """
    weight = table["n"]
    columns = {name: table[name] for name in by}
    parts = pd.DataFrame(columns | {"n": weight})
    for name in _MEANS:
        parts[name] = weight * table[name]
        parts[f"{name}/n"] = weight.where(table[name].notna(), 0)
    for name in _ROOTS:
        parts[name] = weight * table[name] ** 2
    sums = parts.groupby(list(by), sort=False, dropna=False).sum()
    found = pd.DataFrame({"n": sums["n"]})
    for name in _MEANS:
        found[name] = sums[name] / sums[f"{name}/n"].where(sums[f"{name}/n"] > 0)
    for name in _ROOTS:
        found[name] = np.sqrt(sums[name] / sums["n"])
    found["rmse"] = np.sqrt(found["mse"])
    found = _with_shares(found)
    ordered = ["n", *(c for c in table if c in found and c != "n")]
    return found[ordered].reset_index()


def _with_shares(table: pd.DataFrame) -> pd.DataFrame:
    """The table with the removed shares: 1 for all, 0 for nothing, NaN where nothing was there."""
    shares = {"removed": ("rmse", "rmse_before")}
    shares["removed_beyond_constant"] = ("spread_left", "spread_before")
    for name, (left, before) in shares.items():
        table[name] = 1 - table[left] / table[before].where(table[before] > 0)
    return table


Array = NDArray[np.float64]
WHOLE = "all"
"""Phase of the rows for a whole flight."""
GROUP_OF = {c: g for g, columns in GROUPS.items() for c in CHANNELS[columns]}
"""Sensor group of each channel."""
PHASE_OF = {code: name for name, code in PHASE_CODES.items()}
"""Name of each phase code."""


def scored(flight: ResidualFlight, corrected: Corrected) -> Iterator[dict[str, Any]]:
    """Rows of the table for one flight: each channel with fresh samples, in all phases and in
    each."""
    for c, channel in enumerate(CHANNELS):
        fresh = flight.fresh[:, c]
        codes = np.unique(flight.phase[fresh])
        parts = {PHASE_OF[int(code)]: fresh & (flight.phase == code) for code in codes}
        for phase, here in ({WHOLE: fresh} | parts).items() if fresh.any() else ():
            residual, correction = flight.residual[here, c], corrected.correction[here, c]
            left, spread = residual - correction, corrected.spread[here, c]
            yield {
                "flight": flight.name,
                "phase": phase,
                "channel": channel,
                "group": GROUP_OF[channel],
                "unit": UNITS[c],
                "n": len(residual),
                **errors(residual, correction),
                "rmse_before": rms(residual),
                "spread_before": float(np.std(residual)),
                "spread_left": float(np.std(left)),
                "inside": float(np.mean(corrected.inside[here])),
                "within_1": float(np.mean(np.abs(left) <= spread)),
                "within_2": float(np.mean(np.abs(left) <= 2 * spread)),
            }


def errors(residual: Array, correction: Array) -> dict[str, float]:
    """Errors of a correction, shape (n,) both, by name; see the module.

    Source of the Wasserstein distance: order 1, Villani, Optimal Transport (2009), ch. 6.
    """
    left = residual - correction
    return {
        "mse": float(np.mean(left**2)),
        "rmse": rms(left),
        "mae": float(np.mean(np.abs(left))),
        "wasserstein": float(wasserstein_distance(residual, correction)),
    }


def rms(values: Array) -> float:
    """Root mean square of values, shape (n,)."""
    return math.sqrt(float(np.mean(values**2)))


# -- what is refused ----------------------------------------------------------------------


def check_flights(train: Sequence[ResidualFlight], test: Sequence[ResidualFlight]) -> None:
    """Raise ModelError unless there are flights of one rate, and none is in both sets."""
    if not train or not test:
        raise ModelError(
            f"{len(train)} training and {len(test)} test flights: give at least one of each."
        )
    rates = sorted({f.rate_hz for f in (*train, *test)})
    if len(rates) > 1:
        raise ModelError(f"flights at {rates} Hz: make the residuals again at one rate.")
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
