"""ContrastVQ: a codebook with soft assignment, and latents that know their window again.

After the paper's description. Two views of each window, scaled and shaken at random, are to be
nearer to each other than to those of the other windows of the batch: InfoNCE of van den Oord, Li &
Vinyals, 2018, temperature 0.07, as in Chen et al., 2020, Eq. 1.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from ..training.system_family import SystemFamily
from .system import Batch, SystemPreset
from .vqvae import VqVae

TEMPERATURE = 0.07
SHAKEN, SCALED = 0.05, 0.2
"""Spreads of noise and of the factor of a view."""
WEIGHT = 0.1
PROJECTED = 64


class ContrastVq(VqVae):
    """A projection of the mean latent is what is compared."""

    soft = True

    def __init__(self, preset: SystemPreset, n_given: int, n_channels: int) -> None:
        super().__init__(preset, n_given, n_channels)
        self.projection = nn.Linear(preset.code_size, PROJECTED)

    def loss(self, player: str, batch: Batch) -> Tensor:
        """Error, codebook, contrast."""
        one, other = (self._view(batch) for _ in range(2))
        likeness = one @ other.T / TEMPERATURE
        own = torch.arange(len(likeness), device=likeness.device)
        contrast = functional.cross_entropy(likeness, own) + functional.cross_entropy(
            likeness.T, own
        )
        return super().loss(player, batch) + WEIGHT * contrast / 2

    def _view(self, batch: Batch) -> Tensor:
        """Where a changed copy of each window lies, of length 1, shape (batch, PROJECTED)."""
        given = batch.given
        factor = 1 + SCALED * torch.randn(len(given), 1, given.shape[-1], device=given.device)
        seen = factor * given + SHAKEN * torch.randn_like(given)
        mean = self.latent(seen, batch.phase).mean(dim=1)
        return functional.normalize(self.projection(mean), dim=-1)


class ContrastVqFamily(SystemFamily):
    """For the registry."""

    system, preset = ContrastVq, SystemPreset("contrastvq")
