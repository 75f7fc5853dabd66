"""TSGAN: noise and phase to a spectrogram, the spectrogram to a series, a WGAN-GP each.

Source: Smith & Smith, Conditional GAN for timeseries generation, 2020; gradient penalty of weight
10, five steps of each critic and Adam without momentum as Gulrajani et al., 2017, Algorithm 1.
Spectrogram: logarithm of the size of a short-time Fourier transform, windows of 20 samples (Hann),
10 apart.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from ..blocks.adversarial import gradient_penalty
from ..blocks.convolution import SLOPE, Critic, channels_first
from ..training.system_family import SystemFamily
from .system import Batch, Numbers, System, SystemPreset

NOISE = 16
WINDOW, HOP = 20, 10
BINS = WINDOW // 2 + 1
FLOOR = 1e-2
PENALTY = 10.0
CRITIC_STEPS = 5


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


class TsGanFamily(SystemFamily):
    """For the registry."""

    system, preset = TsGan, SystemPreset("tsgan")
