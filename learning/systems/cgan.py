"""CGAN: LSTM generator and LSTM discriminator, both given the phase.

No public code or text was found: after the one-line description. Cross entropy as in Mirza &
Osindero, Conditional Generative Adversarial Nets, 2014; an L1 term of weight 10 where something is
given to be reconstructed, none where it generates.
"""

from torch import Tensor

from ..blocks.adversarial import real_or_fake
from ..blocks.recurrent import Recurrent
from ..training.system_family import SystemFamily
from .system import Batch, SystemPreset, mean_absolute
from .wgan import Wgan

WEIGHT_L1 = 10.0


class Cgan(Wgan):
    """The translator with noise against an LSTM that scores each sample."""

    def __init__(self, preset: SystemPreset, n_given: int, n_channels: int) -> None:
        super().__init__(preset, n_given, n_channels)
        self.critic = Recurrent(n_channels + n_given + self.n_phases, preset.units, 1)

    def turns(self, done: float) -> tuple[str, ...]:
        """One step each."""
        return ("critic", "generator")

    def after_step(self, player: str) -> None:
        """Nothing is clipped."""
        return

    def loss(self, player: str, batch: Batch) -> Tensor:
        """Cross entropy, and L1 for the generator."""
        drawn = self.drawn(batch.given, batch.phase)
        fake = self.scores(drawn, batch)
        if player == "critic":
            real = self.scores(batch.target, batch)
            return real_or_fake(real, True) + real_or_fake(fake, False)
        loss = real_or_fake(fake, True)
        if self.n_given:
            loss = loss + WEIGHT_L1 * mean_absolute(drawn - batch.target, batch.scored)
        return loss


class CganFamily(SystemFamily):
    """For the registry."""

    system, preset = Cgan, SystemPreset("cgan")
