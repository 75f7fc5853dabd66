"""MRGAN: a regression is trained first, frozen, and guides a CGAN.

No public code or text was found: after the one-line description. The regression says the residual
from what is given and the phase; generator and discriminator see what it says, and the generator
gives what is to be added to it.
"""

import torch
from torch import Tensor, nn

from ..blocks.recurrent import Recurrent, Translator
from ..training.system_family import SystemFamily
from .cgan import Cgan
from .system import Batch, SystemPreset, mean_square
from .wgan import NOISE

ALONE = 0.3
"""Share of the training in which the regression is trained."""


class MrGan(Cgan):
    """Regression, generator, discriminator."""

    def __init__(self, preset: SystemPreset, n_given: int, n_channels: int) -> None:
        super().__init__(preset, n_given, n_channels)
        sizes = (self.n_phases, preset.units, preset.code_size, n_channels)
        self.regression = Recurrent(n_given + self.n_phases, preset.units, n_channels)
        self.generator = Translator(n_given + n_channels + NOISE, *sizes)
        self.critic = Recurrent(2 * n_channels + n_given + self.n_phases, preset.units, 1)

    def turns(self, done: float) -> tuple[str, ...]:
        """The regression first, then the other two."""
        return ("regression",) if done < ALONE else ("critic", "generator")

    def players(self) -> dict[str, nn.Module]:
        """Three."""
        return {**super().players(), "regression": self.regression}

    @torch.no_grad()
    def guide(self, given: Tensor, phase: Tensor) -> Tensor:
        """What the regression says."""
        said: Tensor = self.regression(given, phase)
        return said

    def drawn(self, given: Tensor, phase: Tensor) -> Tensor:
        """The regression, and what the generator adds."""
        guide = self.guide(given, phase)
        return guide + super().drawn(torch.cat([given, guide], dim=-1), phase)

    def scores(self, residual: Tensor, batch: Batch) -> Tensor:
        """By a discriminator that sees the guide."""
        guide = self.guide(batch.given, batch.phase)
        said: Tensor = self.critic(residual * batch.scored, batch.given, guide, batch.phase)
        return said

    def loss(self, player: str, batch: Batch) -> Tensor:
        """Square of the error, or that of a CGAN."""
        if player != "regression":
            return super().loss(player, batch)
        return mean_square(self.regression(batch.given, batch.phase) - batch.target, batch.scored)


class MrGanFamily(SystemFamily):
    """For the registry."""

    system, preset = MrGan, SystemPreset("mrgan")
