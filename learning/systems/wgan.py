"""WGAN: a generator with noise against a critic of convolutions; no reconstruction term.

Source: Arjovsky, Chintala & Bottou, Wasserstein GAN, 2017: five steps of the critic for one of the
generator, its weights clipped: at 0.1, as at the 0.01 of the source so few windows teach nothing of
the phase. The critic sees what the generator was given.
"""

import torch
from torch import Tensor, nn

from ..blocks.adversarial import clip_weights
from ..blocks.convolution import Critic
from ..blocks.recurrent import Translator
from ..training.system_family import SystemFamily
from .system import Batch, Numbers, System, SystemPreset

NOISE = 16
"""Random numbers per sample."""
CLIP = 0.1
CRITIC_STEPS = 5


class Wgan(System):
    """Translator and critic; others are built on it."""

    def __init__(self, preset: SystemPreset, n_given: int, n_channels: int) -> None:
        super().__init__(preset, n_given, n_channels)
        sizes = (self.n_phases, preset.units, preset.code_size, n_channels)
        self.generator = Translator(n_given + NOISE, *sizes)
        self.critic: nn.Module = Critic(n_channels + n_given + self.n_phases)

    def turns(self, done: float) -> tuple[str, ...]:
        """The critic is ahead."""
        return (*["critic"] * CRITIC_STEPS, "generator")

    def players(self) -> dict[str, nn.Module]:
        """Two."""
        return {"critic": self.critic, "generator": self.generator}

    def after_step(self, player: str) -> None:
        """The critic stays flat enough."""
        if player == "critic":
            clip_weights(self.critic, CLIP)

    def drawn(self, given: Tensor, phase: Tensor) -> Tensor:
        """Residuals of what is given, and of noise."""
        noise = torch.randn(*phase.shape[:2], NOISE, device=phase.device)
        said: Tensor = self.generator([given, noise], phase)
        return said

    def scores(self, residual: Tensor, batch: Batch) -> Tensor:
        """How real the critic holds it to be; what was not measured it does not see."""
        said: Tensor = self.critic(residual * batch.scored, batch.given, batch.phase)
        return said

    def loss(self, player: str, batch: Batch) -> Tensor:
        """Difference of scores, Eq. 2."""
        fake = self.scores(self.drawn(batch.given, batch.phase), batch).mean()
        if player == "generator":
            return -fake
        return fake - self.scores(batch.target, batch).mean()

    def reconstruct(self, given: Tensor, phase: Tensor) -> Tensor:
        """One draw."""
        return self.drawn(given, phase)

    def generate(self, phase: Tensor, prior: Numbers) -> Tensor:
        """One draw."""
        return self.drawn(phase[..., :0], phase)


class WganFamily(SystemFamily):
    """For the registry."""

    system, preset = Wgan, SystemPreset("wgan")
