"""FC-MC-SVQ: the network of `learning.model.network` over the linear prediction."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import torch

from ..data.flights import ResidualFlight
from ..devices import device_named
from ..model.compensator import Compensator
from ..model.family import Family, Progress, Tensors, TrainingTask
from ..model.info import ModelInfo
from ..preset import PRESETS, PROTOCOLS, Preset, Protocol
from ..training.train import train


class Svq(Family[Preset, Compensator]):
    """The paper's network and what measurably beats it."""

    def presets(self) -> Mapping[str, Preset]:
        """As in `learning.preset`."""
        return PRESETS

    def protocols(self, preset: Preset) -> Sequence[Protocol]:
        """All of them."""
        return PROTOCOLS

    def fit(
        self,
        flights: Sequence[ResidualFlight],
        preset: Preset,
        task: TrainingTask,
        folder: Path,
        progress: Progress,
    ) -> Compensator:
        """Train; a checkpoint in the folder is gone on from."""
        return train(
            flights,
            preset,
            task.protocol,
            task.horizon,
            task.seed,
            folder,
            progress,
            vehicle=task.vehicle,
            vehicle_sha256=task.vehicle_sha256,
            device=device_named(task.device),
            checkpoints=task.checkpoints,
        )

    def build(self, info: ModelInfo[Preset], tensors: Tensors) -> Compensator:
        """The network with these weights."""
        model = Compensator(info)
        model.load_state_dict({k: torch.from_numpy(v) for k, v in tensors.items()})
        return model.eval()

    def export(self, model: Compensator, folder: Path) -> tuple[str, ...]:
        """The streaming model as ONNX, the same in int8, reference vectors."""
        from ..export.write import INT8_FILE, MODEL_FILE, REFERENCE_FILE, export_onnx

        export_onnx(model, folder)
        return MODEL_FILE, INT8_FILE, REFERENCE_FILE
