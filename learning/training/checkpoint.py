"""Checkpoint of a training, one safetensors file, from which it resumes."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from twin.errors import ModelError
from twin.scratch import scratch_file

CHECKPOINT = "checkpoint.safetensors"  # in the folder of a training


@dataclass(slots=True)
class TrainingState:
    """State of a training besides its tensors.

    Attributes:
        training: Hash of all inputs that determine the weights.
        epoch: Number of completed epochs.
        best_epoch: Epoch with the smallest validation error; its weights are stored.
        best_error: Smallest validation error; None before the first validation.
        curve: One entry per epoch.
    """

    training: str
    epoch: int = 0
    best_epoch: int = 0
    best_error: float | None = None
    curve: list[dict[str, Any]] = field(default_factory=list)


def save_checkpoint(
    folder: Path,
    standing: TrainingState,
    weights: Mapping[str, Tensor],
    best: Mapping[str, Tensor],
    optimisers: Mapping[str, torch.optim.Optimizer],
) -> None:
    """Write the checkpoint atomically; an interruption leaves the previous one."""
    tensors = {f"weights.{k}": v for k, v in weights.items()}
    tensors |= {f"best.{k}": v for k, v in best.items()}
    for name, optimiser in optimisers.items():
        for number, state in optimiser.state_dict()["state"].items():
            tensors |= {f"optimiser.{name}.{number}.{k}": v for k, v in state.items()}
    copies = {k: v.detach().clone().contiguous() for k, v in tensors.items()}
    with scratch_file(folder / CHECKPOINT) as file:
        save_file(copies, file, metadata={"standing": json.dumps(asdict(standing))})


def load_checkpoint(
    folder: Path, training: str, optimisers: Mapping[str, torch.optim.Optimizer]
) -> tuple[TrainingState, dict[str, Tensor], dict[str, Tensor]] | None:
    """Training state, weights and best weights; optimisers are restored. None without a checkpoint.

    Raises:
        ModelError: The checkpoint belongs to another training, or is unreadable.
    """
    path = folder / CHECKPOINT
    if not path.is_file():
        return None
    try:
        with safe_open(path, framework="pt") as file:
            standing = TrainingState(**json.loads(file.metadata()["standing"]))
            tensors = {k: file.get_tensor(k) for k in file.keys()}  # noqa: SIM118 - no mapping
    except (SafetensorError, KeyError, TypeError, ValueError) as error:
        raise ModelError(f"{path}: not readable ({error}); delete it to train again") from error
    if standing.training != training:
        raise ModelError(
            f"{path}: of another training (other flights, preset, protocol, horizon or seed); "
            "delete it, or train into another folder"
        )
    for name, optimiser in optimisers.items():
        state: dict[int, dict[str, Tensor]] = {}
        for place, tensor in _under(tensors, f"optimiser.{name}.").items():
            number, key = place.split(".")
            state.setdefault(int(number), {})[key] = tensor
        groups = optimiser.state_dict()["param_groups"]
        optimiser.load_state_dict({"state": state, "param_groups": groups})
    return standing, _under(tensors, "weights."), _under(tensors, "best.")


def _under(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}
