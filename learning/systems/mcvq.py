"""MCVQ: slow and fast part of the residual, each with encoder, codebook and decoder of its own.

After the paper's description. The slow part is the mean of the last nine samples; soft assignment.
"""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from ..training.system_family import SystemFamily
from .system import Batch, Numbers, System, SystemPreset, mean_square
from .vqvae import VqVae

SLOW = 9
"""Samples."""


class _Part(VqVae):
    soft = True


class McVq(System):
    """Two networks whose sum is the residual."""

    autoencoder = True

    def __init__(self, preset: SystemPreset, n_given: int, n_channels: int) -> None:
        super().__init__(preset, n_given, n_channels)
        self.parts = nn.ModuleList(_Part(preset, n_given, n_channels) for _ in range(2))

    def loss(self, player: str, batch: Batch) -> Tensor:
        """Each part answers for its own share of the residual."""
        loss = torch.zeros((), device=batch.given.device)
        halves = zip(self._parts(), _split(batch.given), _split(batch.target), strict=True)
        for part, given, target in halves:
            y, of_codebook = part.said(given, batch.phase)
            loss = loss + mean_square(y - target, batch.scored) + of_codebook
        return loss

    def reconstruct(self, given: Tensor, phase: Tensor) -> Tensor:
        """The sum of both."""
        both = zip(self._parts(), _split(given), strict=True)
        return torch.stack([part.reconstruct(half, phase) for part, half in both]).sum(0)

    def learn_prior(self, given: Tensor, phase: Tensor, begins: NDArray[np.bool_]) -> Numbers:
        """A chain each."""
        both = enumerate(zip(self._parts(), _split(given), strict=True))
        return {
            f"{k}.{name}": values
            for k, (part, half) in both
            for name, values in part.learn_prior(half, phase, begins).items()
        }

    def generate(self, phase: Tensor, prior: Numbers) -> Tensor:
        """The sum of two draws."""
        drawn = []
        for k, part in enumerate(self._parts()):
            own = {n.removeprefix(f"{k}."): v for n, v in prior.items() if n.startswith(f"{k}.")}
            drawn.append(part.generate(phase, own))
        return torch.stack(drawn).sum(0)

    def _parts(self) -> list[_Part]:
        return [part for part in self.parts if isinstance(part, _Part)]


def _split(x: Tensor) -> tuple[Tensor, Tensor]:
    """Slow and fast part of (batch, time, n); before the first sample is zero."""
    padded = functional.pad(x.transpose(1, 2), (SLOW - 1, 0))
    slow = functional.avg_pool1d(padded, SLOW, stride=1).transpose(1, 2)
    return slow, x - slow


class McVqFamily(SystemFamily):
    """For the registry."""

    system, preset = McVq, SystemPreset("mcvq")
