"""VQGAN: VQVAE, and a patch critic once 30 % of the training are over.

Source: Esser, Rombach & Ommer, Taming Transformers for High-Resolution Image Synthesis, 2021:
hinge loss, weight of the critic such that its gradient at the last layer is that of the error
(Eq. 7). It generates as VQVAE does.
"""

import torch
from torch import Tensor, nn

from ..blocks.adversarial import hinge
from ..blocks.convolution import Critic
from ..training.system_family import SystemFamily
from .system import Batch, SystemPreset, mean_square
from .vqvae import VqVae

BEGINS = 0.3
LARGEST_WEIGHT, TINY = 1e4, 1e-6


class VqGan(VqVae):
    """A patch is what the critic scores: 8 samples apart, 29 wide."""

    def __init__(self, preset: SystemPreset, n_given: int, n_channels: int) -> None:
        super().__init__(preset, n_given, n_channels)
        self.critic = Critic(n_channels + self.n_phases)

    def turns(self, done: float) -> tuple[str, ...]:
        """The network alone at first."""
        return ("network",) if done < BEGINS else ("critic", "network")

    def players(self) -> dict[str, nn.Module]:
        """Two; the first is all but the critic."""
        network = nn.ModuleList([self.encoder, self.codebook, self.decoder])
        return {"network": network, "critic": self.critic}

    def loss(self, player: str, batch: Batch) -> Tensor:
        """Hinge of the critic; error, codebook and adaptive critic of the network."""
        y, of_codebook = self.said(batch.given, batch.phase)
        fake = self.critic(y * batch.scored, batch.phase)
        if player == "critic":
            return hinge(self.critic(batch.target * batch.scored, batch.phase), fake)
        error = mean_square(y - batch.target, batch.scored)
        if batch.done < BEGINS:
            return error + of_codebook
        against = -fake.mean()
        weight = (self._slope(error) / (self._slope(against) + TINY)).clamp(max=LARGEST_WEIGHT)
        loss: Tensor = error + of_codebook + weight * against
        return loss

    def _slope(self, loss: Tensor) -> Tensor:
        """Size of the gradient at the last layer."""
        (slope,) = torch.autograd.grad(loss, self.decoder.out.weight, retain_graph=True)
        size: Tensor = slope.norm().detach()
        return size


class VqGanFamily(SystemFamily):
    """For the registry."""

    system, preset = VqGan, SystemPreset("vqgan")
