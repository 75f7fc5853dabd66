"""TDM: diffusion of 50 cosine steps, told from its noise by dilated gated convolutions.

No public code or text was found: after the one-line description. The network is that of Kong et
al., DiffWave, 2021, sec. 3, with convolutions that see no later
sample, and conditions before the first of them, too.
"""

import math

import torch
from torch import Tensor, nn

from ..blocks.convolution import CausalConvolution, channels_first
from ..blocks.diffusion import Diffusion, StepEmbedding
from ..training.system_family import SystemFamily
from .system import Batch, Numbers, System, SystemPreset

STEPS = 50
DILATIONS = (1, 2, 4, 8, 16, 32)


class _Layer(nn.Module):
    """A gated convolution, with a way around it and one out of it."""

    def __init__(self, n_conditions: int, width: int, dilation: int) -> None:
        super().__init__()
        self.of_step = nn.Linear(width, width)
        self.convolution = CausalConvolution(width, 2 * width, 3, dilation)
        self.of_conditions = nn.Conv1d(n_conditions, 2 * width, 1)
        self.out = nn.Conv1d(width, 2 * width, 1)

    def forward(self, x: Tensor, step: Tensor, conditions: Tensor) -> tuple[Tensor, Tensor]:
        """What goes on to the next layer and what goes out, (batch, width, time) each."""
        inside = self.convolution(x + self.of_step(step)[..., None]) + self.of_conditions(
            conditions
        )
        gate, value = inside.chunk(2, dim=1)
        around, out = self.out(torch.sigmoid(gate) * torch.tanh(value)).chunk(2, dim=1)
        return (x + around) / math.sqrt(2), out


class GatedDenoiser(nn.Module):
    """v of noisy windows, by their step and conditions; (batch, time, some)."""

    def __init__(self, n_channels: int, n_conditions: int, width: int) -> None:
        super().__init__()
        self.begin = nn.Conv1d(n_channels + n_conditions, width, 1)
        self.step = StepEmbedding(width)
        self.layers = nn.ModuleList(_Layer(n_conditions, width, d) for d in DILATIONS)
        self.end = nn.Sequential(
            nn.Conv1d(width, width, 1), nn.ReLU(), nn.Conv1d(width, n_channels, 1)
        )

    def forward(self, x: Tensor, step: Tensor, conditions: Tensor) -> Tensor:
        """Shape of `x`."""
        x, conditions = channels_first(x, conditions), channels_first(conditions)
        x, embedded = self.begin(x), self.step(step)
        total = torch.zeros_like(x)
        for layer in self.layers:
            x, out = layer(x, embedded, conditions)
            total = total + out
        said: Tensor = self.end(total / math.sqrt(len(self.layers)))
        return said.transpose(1, 2)


class Tdm(System):
    """Schedule and denoiser; another is built on it."""

    def __init__(self, preset: SystemPreset, n_given: int, n_channels: int) -> None:
        super().__init__(preset, n_given, n_channels)
        self.diffusion = Diffusion(STEPS, "cosine")
        n_conditions = n_given + self.n_phases
        self.denoiser: nn.Module = GatedDenoiser(n_channels, n_conditions, preset.units)

    def loss(self, player: str, batch: Batch) -> Tensor:
        """That of the noise."""
        conditions = torch.cat([batch.given, batch.phase], dim=-1)
        return self.diffusion.loss(
            lambda x, step: self.denoiser(x, step, conditions), batch.target, batch.scored
        )

    def reconstruct(self, given: Tensor, phase: Tensor) -> Tensor:
        """One draw."""
        conditions = torch.cat([given, phase], dim=-1)
        return self.diffusion.sample(
            lambda x, step: self.denoiser(x, step, conditions),
            (*phase.shape[:2], self.n_channels),
        )

    def generate(self, phase: Tensor, prior: Numbers) -> Tensor:
        """One draw."""
        return self.reconstruct(phase[..., :0], phase)


class TdmFamily(SystemFamily):
    """For the registry."""

    system, preset = Tdm, SystemPreset("tdm")
