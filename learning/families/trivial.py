"""The baselines as models: what an aircraft gets that deserves no better."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from ..data.channels import CHANNELS, N_PHASES
from ..data.flights import ResidualFlight
from ..model.baselines import RULES, Baseline, fit_baseline
from ..model.corrected import Corrected
from ..model.family import Family, Progress, Tensors, TrainingTask
from ..model.info import ModelInfo
from ..preset import Protocol
from ..training.inputs import describe_training

_SPREAD = "expected"
"""Tensor that holds the spread; the others are the rule's."""


@dataclass(frozen=True, slots=True)
class TrivialPreset:
    """Which baseline.

    Attributes:
        name: As printed.
        rule: Its name in `learning.model.baselines.RULES`.
    """

    name: str
    rule: str


_PRESETS = MappingProxyType(
    {
        name: TrivialPreset(name, rule)
        for name, rule in zip(
            (
                *("none", "mean", "last", "average", "last-reading", "autoregression"),
                *("mean-reading", "linear-in-inputs"),
            ),
            RULES,
            strict=True,
        )
    }
)


@dataclass(frozen=True, slots=True)
class TrivialModel:
    """A baseline with its papers.

    Attributes:
        info: What it is.
        baseline: What it says.
    """

    info: ModelInfo[TrivialPreset]
    baseline: Baseline

    @property
    def family(self) -> str:
        """Its row in the registry."""
        return "trivial"

    def run(self, flight: ResidualFlight) -> Corrected:
        """The whole flight; there is no envelope and no alarm."""
        self.info.check_flight(flight)
        return self.baseline.run(flight)

    def tensors(self) -> Tensors:
        """Numbers of the rule, and the spread."""
        return {**self.baseline.numbers, _SPREAD: self.baseline.spread}

    def details(self) -> Mapping[str, Any]:
        """Nothing more."""
        return {}


class Trivial(Family[TrivialPreset, TrivialModel]):
    """Predictions anybody could write down in a minute."""

    def presets(self) -> Mapping[str, TrivialPreset]:
        """One per rule."""
        return _PRESETS

    def protocols(self, preset: TrivialPreset) -> Sequence[Protocol]:
        """Those of the rule."""
        return RULES[preset.rule].protocols

    def fit(
        self,
        flights: Sequence[ResidualFlight],
        preset: TrivialPreset,
        task: TrainingTask,
        folder: Path,
        progress: Progress,
    ) -> TrivialModel:
        """Means and least squares."""
        info = describe_training("trivial", flights, preset, task)
        return TrivialModel(info, fit_baseline(preset.rule, flights, task.horizon))

    def build(self, info: ModelInfo[TrivialPreset], tensors: Tensors) -> TrivialModel:
        """The baseline of these numbers."""
        numbers = {k: v for k, v in tensors.items() if k != _SPREAD}
        spread, wanted = tensors[_SPREAD], RULES[info.preset.rule].names
        if set(numbers) != set(wanted):
            raise ValueError(
                f"rule {info.preset.rule!r} needs {', '.join(wanted)}, not {', '.join(numbers)}"
            )
        if spread.shape != (N_PHASES, len(CHANNELS)):
            raise ValueError(f"{_SPREAD} of shape {np.shape(spread)}")
        return TrivialModel(info, Baseline(info.preset.rule, info.horizon, numbers, spread))

    def export(self, model: TrivialModel, folder: Path) -> tuple[str, ...]:
        """None."""
        return ()
