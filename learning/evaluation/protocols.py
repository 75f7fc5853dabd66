"""Evaluation under a named protocol, beside the baselines: one tidy table.

Only fresh samples are scored. A row is one channel of one flight in one phase ("all": the whole
flight) as one model left it:

| column | says |
|---|---|
| n | samples |
| mse, rmse, mae | of residual minus correction, units of the channel |
| wasserstein | distance between the distributions of residual and correction |
| rmse_before, removed | uncorrected rms, and the share of it that is gone |
| spread_before, spread_left | both about their own mean in this row: what a constant leaves |
| removed_beyond_constant | the share of the former that is gone |
| *_std | in units of the training residual's spread in this channel |
| inside | share of samples within the model's envelope |
| within_1, within_2 | share of samples within one and two predicted spreads |
| before B, left B | power in frequency band B, Hz, about the mean |
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from twin.errors import ModelError

from ..data.flights import ResidualFlight
from ..model.baselines import fit_baselines
from ..model.corrected import Model
from .scores import WHOLE, Cell, cells, check_finite, check_flights, residual_scale

__all__ = ["TASKS", "WHOLE", "Task", "evaluate", "fitted", "pooled"]

_MEANS = (
    "mse",
    "mae",
    "wasserstein",
    "mse_std",
    "mae_std",
    "wasserstein_std",
    "inside",
    "within_1",
    "within_2",
)
_ROOTS = ("rmse_before", "spread_before", "spread_left")


@dataclass(frozen=True, slots=True)
class Task:
    """A protocol with its horizon.

    Attributes:
        protocol: `reconstruct`, `track` or `free`; `generate` is scored by `generating`.
        horizon: Age of the newest residual that may be seen, samples; 0 but in `track`.
    """

    protocol: str
    horizon: int = 0

    def __post_init__(self) -> None:
        if self.protocol not in ("reconstruct", "track", "free"):
            raise ModelError(
                f"protocol {self.protocol!r}: choose reconstruct, track or free; generated "
                f"signals are scored by benchmarks.paper.generated."
            )
        if (self.horizon >= 1) != (self.protocol == "track"):
            raise ModelError(
                f"protocol {self.protocol}, horizon {self.horizon} samples: track needs 1 or more, "
                f"the others 0."
            )


TASKS = (
    Task("reconstruct"),
    *(Task("track", h) for h in (1, 10, 50, 100)),
    Task("free"),
)
"""Every protocol whose corrections are compared sample by sample."""


def evaluate(
    model: Model | Mapping[str, Model] | None,
    train: Sequence[ResidualFlight],
    test: Sequence[ResidualFlight],
    task: Task,
) -> pd.DataFrame:
    """Score models and the baselines of their protocol.

    Args:
        model: One, called "model", several by name, or None for the baselines alone.
        train: What baselines and standardised units are made from.
        test: Flights to score, none of them in `train`.
        task: Protocol the models work under.

    Returns:
        One row per model, flight, phase and channel; see the module. A channel without a fresh
        sample has none.

    Raises:
        ModelError: There are no flights, rates differ, or a correction is not finite.
    """
    check_flights(train, test)
    models = fitted(model, train, task)
    scale = residual_scale(train)
    known = [[Cell(flight, *cell, scale) for cell in cells(flight)] for flight in test]
    rows: list[dict[str, Any]] = []
    for name, each in models.items():
        head = {"protocol": task.protocol, "horizon": task.horizon, "model": name}
        for flight, parts in zip(test, known, strict=True):
            corrected = each.run(flight)
            check_finite(name, flight, corrected)
            rows += [head | part.scored(corrected) for part in parts]
    return pd.DataFrame(rows)


def fitted(
    model: Model | Mapping[str, Model] | None, train: Sequence[ResidualFlight], task: Task
) -> dict[str, Model]:
    """The baselines of a task, then the models, by name."""
    named = dict(model) if isinstance(model, Mapping) else {} if model is None else {"model": model}
    baselines = fit_baselines(train, task.protocol, task.horizon)
    if both := sorted(set(named) & set(baselines)):
        raise ModelError(f"models {both} are called like baselines: give them other names.")
    return {**baselines, **named}


def pooled(
    table: pd.DataFrame,
    by: Sequence[str] = ("protocol", "horizon", "model", "group", "phase"),
) -> pd.DataFrame:
    """Rows of `evaluate` pooled: squares and shares by their number of samples.

    Args:
        table: Of `evaluate`.
        by: Columns that stay apart; within a row of the result units must not differ for the
            figures in physical units to mean anything.

    Returns:
        In the order of appearance; Wasserstein distances are means of those of the parts.
    """
    weight = table["n"]
    columns = {name: table[name] for name in by}
    powers = [c for c in table if c.startswith(("before ", "left "))]
    parts = pd.DataFrame(columns | {"n": weight})
    for name in (*_MEANS, *powers):
        parts[name] = weight * table[name]
        parts[f"{name}/n"] = weight.where(table[name].notna(), 0)
    for name in _ROOTS:
        parts[name] = weight * table[name] ** 2
    sums = parts.groupby(list(by), sort=False, dropna=False).sum()
    found = pd.DataFrame({"n": sums["n"]})
    for name in (*_MEANS, *powers):
        found[name] = sums[name] / sums[f"{name}/n"].where(sums[f"{name}/n"] > 0)
    for name in _ROOTS:
        found[name] = np.sqrt(sums[name] / sums["n"])
    found["rmse"], found["rmse_std"] = np.sqrt(found["mse"]), np.sqrt(found["mse_std"])
    found["removed"] = _removed(found["rmse"], found["rmse_before"])
    found["removed_beyond_constant"] = _removed(found["spread_left"], found["spread_before"])
    ordered = ["n", *(c for c in table if c in found and c != "n")]
    return found[ordered].reset_index()


def _removed(left: pd.Series, before: pd.Series) -> pd.Series:
    return 1 - left / before.where(before > 0)
