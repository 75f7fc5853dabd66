"""CVAE: a Gaussian latent per sample, encoder and decoder conditioned on the phase.

Source: Sohn, Lee & Yan, Learning Structured Output Representation using Deep Conditional
Generative Models, 2015. A Gaussian of spread 1 about the decoder's output; weight of the KL term 1.
"""

import torch
from torch import Tensor

from ..blocks.recurrent import Recurrent
from ..training.system_family import SystemFamily
from .system import Batch, Numbers, System, SystemPreset


class Cvae(System):
    """LSTM to mean and spread of the latent, LSTM back."""

    autoencoder = True

    def __init__(self, preset: SystemPreset, n_given: int, n_channels: int) -> None:
        super().__init__(preset, n_given, n_channels)
        size, p = preset.code_size, self.n_phases
        self.encoder = Recurrent(n_given + p, preset.units, 2 * size)
        self.decoder = Recurrent(size + p, preset.units, n_channels)

    def loss(self, player: str, batch: Batch) -> Tensor:
        """The evidence's lower bound, negative, per sample."""
        mean, log_variance = self.encoder(batch.given, batch.phase).chunk(2, dim=-1)
        latent = mean + torch.exp(log_variance / 2) * torch.randn_like(mean)
        error = (self.decoder(latent, batch.phase) - batch.target) * batch.scored
        divergence = (mean**2 + log_variance.exp() - 1 - log_variance) / 2
        return torch.mean((error**2 / 2).sum(-1)) + torch.mean(divergence.sum(-1))

    def reconstruct(self, given: Tensor, phase: Tensor) -> Tensor:
        """From the mean of the latent."""
        mean, _ = self.encoder(given, phase).chunk(2, dim=-1)
        said: Tensor = self.decoder(mean, phase)
        return said

    def generate(self, phase: Tensor, prior: Numbers) -> Tensor:
        """From a latent of the unit Gaussian."""
        latent = torch.randn(*phase.shape[:2], self.preset.code_size, device=phase.device)
        said: Tensor = self.decoder(latent, phase)
        return said


class CvaeFamily(SystemFamily):
    """For the registry."""

    system, preset = Cvae, SystemPreset("cvae")
