"""Innovations: autoregression driven by what it cannot say, drawn from a codebook or a Gaussian.

`learning.model.generator` as a family, so that it is trained, kept and compared as the systems are.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from ..data.channels import N_PHASES
from ..data.flights import ResidualFlight
from ..model.corrected import Corrected
from ..model.family import Family, Progress, Tensors, TrainingTask
from ..model.generator import CODES, ORDER, Drive, Generator, Sensor, fit_generator
from ..model.info import ModelInfo
from ..preset import Protocol
from ..training.inputs import describe_training

_PER_PHASE = ("codes", "counts", "covariance")


@dataclass(frozen=True, slots=True)
class InnovationsPreset:
    """Hyper-parameters.

    Attributes:
        name: As printed.
        order: Of the autoregression; 0: white noise.
        codes: Of each codebook, at most.
        drive: What drives it.
    """

    name: str
    order: int = ORDER
    codes: int = CODES
    drive: Drive = "codebook"


PRESETS = MappingProxyType(
    {
        p.name: p
        for p in (
            InnovationsPreset("ar-codebook"),
            InnovationsPreset("ar-gaussian", codes=0, drive="gaussian"),
            InnovationsPreset("white-noise", order=0, codes=0, drive="gaussian"),
        )
    }
)


@dataclass(frozen=True, slots=True)
class InnovationsModel:
    """A generator with its papers.

    Attributes:
        info: What it is.
        generator: What draws.
    """

    info: ModelInfo[InnovationsPreset]
    generator: Generator

    @property
    def family(self) -> str:
        """Its row in the registry."""
        return "innovations"

    def run(self, flight: ResidualFlight) -> Corrected:
        """A draw."""
        self.info.check_flight(flight)
        return self.generator.run(flight)

    def with_seed(self, seed: int) -> "InnovationsModel":
        """The same with other draws."""
        return replace(self, generator=self.generator.with_seed(seed))

    def tensors(self) -> Tensors:
        """Means, spreads, and what drives each sensor."""
        found = {"mean": self.generator.mean, "scale": self.generator.scale}
        for i, sensor in enumerate(self.generator.sensors):
            found[f"{i}.channels"] = np.array(sensor.channels, dtype=np.int64)
            found[f"{i}.every"] = np.array([sensor.every], dtype=np.int64)
            found[f"{i}.coefficients"] = sensor.coefficients
            for name in _PER_PHASE:
                for p, values in enumerate(getattr(sensor, name)):
                    found[f"{i}.{name}.{p}"] = values
        return found

    def details(self) -> Mapping[str, Any]:
        """Nothing more."""
        return {}


class Innovations(Family[InnovationsPreset, InnovationsModel]):
    """Closed form, but for k-means."""

    def presets(self) -> Mapping[str, InnovationsPreset]:
        """With a codebook, Gaussian, and no autoregression at all."""
        return PRESETS

    def protocols(self, preset: InnovationsPreset) -> Sequence[Protocol]:
        """It draws, and does nothing else."""
        return ("generate",)

    def fit(
        self,
        flights: Sequence[ResidualFlight],
        preset: InnovationsPreset,
        task: TrainingTask,
        folder: Path,
        progress: Progress,
    ) -> InnovationsModel:
        """As `fit_generator`."""
        info = describe_training("innovations", flights, preset, task)
        made = fit_generator(flights, task.seed, preset.order, preset.codes)
        return InnovationsModel(info, replace(made, drive=preset.drive))

    def build(self, info: ModelInfo[InnovationsPreset], tensors: Tensors) -> InnovationsModel:
        """The generator of these numbers."""
        count = sum(name.endswith(".every") for name in tensors)
        sensors = tuple(_sensor(tensors, i) for i in range(count))
        mean, scale = tensors["mean"], tensors["scale"]
        if mean.shape != (N_PHASES, len(info.channels)) or scale.shape != mean.shape:
            raise ValueError(f"means of shape {mean.shape}, spreads of shape {scale.shape}")
        return InnovationsModel(info, Generator(mean, scale, sensors, info.preset.drive, info.seed))

    def export(self, model: InnovationsModel, folder: Path) -> tuple[str, ...]:
        """None: what is drawn corrects nothing."""
        return ()


def _sensor(tensors: Tensors, i: int) -> Sensor:
    per_phase = {
        name: tuple(tensors[f"{i}.{name}.{p}"] for p in range(N_PHASES + 1)) for name in _PER_PHASE
    }
    return Sensor(
        channels=tuple(int(c) for c in tensors[f"{i}.channels"]),
        every=int(tensors[f"{i}.every"][0]),
        coefficients=tensors[f"{i}.coefficients"],
        **per_phase,
    )
