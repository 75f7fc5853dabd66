"""Where a training stands, so that it can go on after a kill: one file of tensors and numbers."""

import pickle
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from twin.errors import ModelError
from twin.scratch import scratch_file

CHECKPOINT = "checkpoint.pt"  # in the folder of a training


@dataclass(slots=True)
class TrainingState:
    """Where a training stands, besides its tensors.

    Attributes:
        training: Hash of all that decides the weights.
        epoch: Epochs done.
        best_epoch: Epoch with the smallest validation error; its weights are kept.
        best_error: That error; None before the first look.
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
    """Write everything in one go; a kill meanwhile leaves the checkpoint before."""
    states = {name: optimiser.state_dict() for name, optimiser in optimisers.items()}
    content = (asdict(standing), dict(weights), dict(best), states)
    with scratch_file(folder / CHECKPOINT) as file:
        torch.save(content, file)


def load_checkpoint(
    folder: Path, training: str, optimisers: Mapping[str, torch.optim.Optimizer]
) -> tuple[TrainingState, dict[str, Tensor], dict[str, Tensor]] | None:
    """TrainingState, weights and best weights; optimisers take up their states. None without one.

    Raises:
        ModelError: The checkpoint is of another training, or not readable.
    """
    path = folder / CHECKPOINT
    if not path.is_file():
        return None
    try:  # tensors and plain numbers alone: nothing in the file is run
        said, weights, best, states = torch.load(path, weights_only=True)
        standing = TrainingState(**said)
    except (pickle.UnpicklingError, RuntimeError, EOFError, TypeError, ValueError) as error:
        why = str(error).partition("\n")[0]
        raise ModelError(f"{path}: not readable ({why}); delete it to train again") from error
    if standing.training != training:
        raise ModelError(
            f"{path}: of another training (other flights, preset, protocol, horizon or seed); "
            "delete it, or train into another folder"
        )
    for name, optimiser in optimisers.items():
        optimiser.load_state_dict(states[name])
    return standing, weights, best
