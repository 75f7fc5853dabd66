"""Systems of a generator against a critic: WGAN, CGAN, MRGAN, TSGAN."""

import torch
from torch import Tensor, nn
from torch.nn import functional

from .blocks import (
    SLOPE,
    Critic,
    Recurrent,
    Translator,
    channels_first,
    clip_weights,
    gradient_penalty,
    real_or_fake,
)
from .system import Batch, Numbers, System, SystemPreset, mean_absolute, mean_square

# ----------------------------------------------------------------------------------------
# WGAN: a generator with noise against a critic of convolutions; no reconstruction term.
#
# Source: Arjovsky, Chintala & Bottou, Wasserstein GAN, 2017: five steps of the critic for one of
# the generator, its weights clipped: at 0.1, as at the 0.01 of the source so few windows teach
# nothing of the phase. The critic sees what the generator was given.

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


# ----------------------------------------------------------------------------------------
# CGAN: LSTM generator and LSTM discriminator, both given the phase.
#
# No public code or text was found: after the one-line description. Cross entropy as in Mirza &
# Osindero, Conditional Generative Adversarial Nets, 2014; an L1 term of weight 10 where something
# is given to be reconstructed, none where it generates.

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


# ----------------------------------------------------------------------------------------
# MRGAN: a regression is trained first, frozen, and guides a CGAN.
#
# No public code or text was found: after the one-line description. The regression says the
# residual from what is given and the phase; generator and discriminator see what it says, and the
# generator gives what is to be added to it.

REGRESSION_ALONE = 0.3
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
        return ("regression",) if done < REGRESSION_ALONE else ("critic", "generator")

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


# ----------------------------------------------------------------------------------------
# TSGAN: noise and phase to a spectrogram, the spectrogram to a series, a WGAN-GP each.
#
# Source: Smith & Smith, Conditional GAN for timeseries generation, 2020; gradient penalty of
# weight 10, five steps of each critic and Adam without momentum as Gulrajani et al., 2017,
# Algorithm 1. Spectrogram: logarithm of the size of a short-time Fourier transform, windows of 20
# samples (Hann), 10 apart.

WINDOW, HOP = 20, 10
BINS = WINDOW // 2 + 1
FLOOR = 1e-2
PENALTY = 10.0


class TsGan(System):
    """Four networks: painter and its critic, player and its critic."""

    sees_ahead = True
    against = 0.0, 0.9

    def __init__(self, preset: SystemPreset, n_given: int, n_channels: int) -> None:
        super().__init__(preset, n_given, n_channels)
        conditions, painted = n_given + self.n_phases, BINS * n_channels
        self.painter = _convolutions(conditions + NOISE, 2 * preset.units, painted)
        self.painted = Critic(painted + conditions, (2 * preset.units, preset.units))
        self.player = _convolutions(painted + conditions + NOISE, 2 * preset.units, n_channels)
        self.played = Critic(n_channels + painted + conditions)
        self.register_buffer("hann", torch.hann_window(WINDOW), persistent=False)
        self.hann: Tensor

    def turns(self, done: float) -> tuple[str, ...]:
        """The critics are ahead."""
        critics = ["painted", "played"] * CRITIC_STEPS
        return (*critics, "painter", "player")

    def players(self) -> dict[str, nn.Module]:
        """Four."""
        names = ("painter", "painted", "player", "played")
        return {name: getattr(self, name) for name in names}

    def loss(self, player: str, batch: Batch) -> Tensor:
        """Scores of two WGANs, with the penalty for critics."""
        real, slow = self._spectrogram(batch.target * batch.scored), self._frames(batch)
        judging = player in ("painted", "played")
        with torch.set_grad_enabled(not judging):
            if player in ("painter", "painted"):
                fake, conditions, critic = self._paint(slow), slow, self.painted
            else:
                conditions = torch.cat([self._long(real, batch.target), _conditions(batch)], dim=-1)
                fake, critic = self._play(conditions) * batch.scored, self.played
                real = batch.target * batch.scored
        if not judging:
            return -torch.mean(critic(fake, conditions))
        gap = torch.mean(critic(fake, conditions)) - torch.mean(critic(real, conditions))
        penalty = gradient_penalty(lambda x: critic(x, conditions), real, fake)
        return gap + PENALTY * penalty

    def reconstruct(self, given: Tensor, phase: Tensor) -> Tensor:
        """One draw: a spectrogram, and a series of it."""
        conditions = torch.cat([given, phase], dim=-1)
        painted = self._paint(_slow(conditions))
        return self._play(torch.cat([self._long(painted, phase), conditions], dim=-1))

    def generate(self, phase: Tensor, prior: Numbers) -> Tensor:
        """One draw."""
        return self.reconstruct(phase[..., :0], phase)

    def _paint(self, slow: Tensor) -> Tensor:
        """Spectrogram of conditions per frame, shape (batch, frames, BINS * channels)."""
        noise = torch.randn(*slow.shape[:2], NOISE, device=slow.device)
        said: Tensor = self.painter(channels_first(slow, noise))
        return said.transpose(1, 2)

    def _play(self, conditions: Tensor) -> Tensor:
        """Series of conditions per sample, the spectrogram among them."""
        noise = torch.randn(*conditions.shape[:2], NOISE, device=conditions.device)
        said: Tensor = self.player(channels_first(conditions, noise))
        return said.transpose(1, 2)

    def _spectrogram(self, x: Tensor) -> Tensor:
        """Of windows (batch, time, channels), shape (batch, frames, BINS * channels)."""
        flat = x.transpose(1, 2).flatten(0, 1)
        found = torch.stft(flat, WINDOW, HOP, window=self.hann, return_complex=True).abs()
        size = torch.log(found + FLOOR).reshape(len(x), x.shape[-1], BINS, -1)
        return size.permute(0, 3, 2, 1).flatten(2)

    def _frames(self, batch: Batch) -> Tensor:
        return _slow(_conditions(batch))

    @staticmethod
    def _long(frames: Tensor, like: Tensor) -> Tensor:
        """Each frame for as long as it lasts, as long as `like`."""
        return functional.interpolate(
            frames.transpose(1, 2), size=like.shape[1], mode="linear", align_corners=True
        ).transpose(1, 2)


def _conditions(batch: Batch) -> Tensor:
    return torch.cat([batch.given, batch.phase], dim=-1)


def _slow(conditions: Tensor) -> Tensor:
    """Means about the middle of each frame, shape (batch, frames, some)."""
    x = conditions.transpose(1, 2)
    means = functional.avg_pool1d(x, WINDOW, HOP, padding=WINDOW // 2, count_include_pad=False)
    frames = 1 + conditions.shape[1] // HOP
    return means[..., :frames].transpose(1, 2)


def _convolutions(n_inputs: int, width: int, n_outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv1d(n_inputs, width, 5, padding=2),
        nn.LeakyReLU(SLOPE),
        nn.Conv1d(width, width, 5, padding=2),
        nn.LeakyReLU(SLOPE),
        nn.Conv1d(width, n_outputs, 5, padding=2),
    )
