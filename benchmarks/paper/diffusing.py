"""Systems that take noise away step by step: TDM, TimeDDPM."""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

from .blocks import CausalConvolution, Diffusion, StepEmbedding, channels_first
from .system import Batch, Numbers, System, SystemPreset

# ----------------------------------------------------------------------------------------
# TDM: diffusion of 50 cosine steps, told from its noise by dilated gated convolutions.
#
# No public code or text was found: after the one-line description. The network is that of Kong et
# al., DiffWave, 2021, sec. 3, with convolutions that see no later sample, and conditions before
# the first of them, too.

COSINE_STEPS = 50
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
        self.diffusion = Diffusion(COSINE_STEPS, "cosine")
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


# ----------------------------------------------------------------------------------------
# TimeDDPM: diffusion of 100 linear steps, told from its noise by a U-Net with attention over time.
#
# No public code or text was found: after the one-line description. Two levels, residual blocks and
# attention as in Ho, Jain & Abbeel, 2020, appendix B, in one dimension.

LINEAR_STEPS = 100
NORM_GROUPS, HEADS = 8, 4
SMALLEST = 4
"""Windows are padded to a multiple: each of two levels halves them."""


class _Block(nn.Module):
    """Two convolutions with the step between them, and a way around."""

    def __init__(self, n_inputs: int, n_outputs: int, width: int) -> None:
        super().__init__()
        self.first = nn.Conv1d(n_inputs, n_outputs, 3, padding=1)
        self.second = nn.Conv1d(n_outputs, n_outputs, 3, padding=1)
        self.norms = nn.ModuleList(nn.GroupNorm(NORM_GROUPS, n_outputs) for _ in range(2))
        self.of_step = nn.Linear(width, n_outputs)
        self.around = nn.Conv1d(n_inputs, n_outputs, 1)

    def forward(self, x: Tensor, step: Tensor) -> Tensor:
        inside = functional.silu(self.norms[0](self.first(x))) + self.of_step(step)[..., None]
        said: Tensor = functional.silu(self.norms[1](self.second(inside))) + self.around(x)
        return said


class UNet(nn.Module):
    """v of noisy windows, by their step and conditions; (batch, time, some)."""

    def __init__(self, n_channels: int, n_conditions: int, width: int) -> None:
        super().__init__()
        wide = 2 * width
        self.step = StepEmbedding(width)
        self.down = nn.ModuleList(
            [_Block(n_channels + n_conditions, width, width), _Block(width, wide, width)]
        )
        self.middle = _Block(wide, wide, width)
        self.norm = nn.GroupNorm(NORM_GROUPS, wide)
        self.attention = nn.MultiheadAttention(wide, HEADS, batch_first=True)
        self.up = nn.ModuleList([_Block(2 * wide, width, width), _Block(2 * width, width, width)])
        self.end = nn.Conv1d(width, n_channels, 1)

    def forward(self, x: Tensor, step: Tensor, conditions: Tensor) -> Tensor:
        """Shape of `x`."""
        length, embedded = x.shape[1], self.step(step)
        x = functional.pad(channels_first(x, conditions), (0, -length % SMALLEST))
        skipped = []
        for block in self.down:
            x = block(x, embedded)
            skipped.append(x)
            x = functional.avg_pool1d(x, 2)
        x = self.middle(x, embedded)
        over_time = self.norm(x).transpose(1, 2)
        x = x + self.attention(over_time, over_time, over_time, need_weights=False)[0].transpose(
            1, 2
        )
        for block in self.up:
            x = functional.interpolate(x, scale_factor=2.0, mode="nearest")
            x = block(torch.cat([x, skipped.pop()], dim=1), embedded)
        said: Tensor = self.end(x)[..., :length]
        return said.transpose(1, 2)


class TimeDdpm(Tdm):
    """As TDM, with another schedule and another denoiser."""

    sees_ahead = True

    def __init__(self, preset: SystemPreset, n_given: int, n_channels: int) -> None:
        super().__init__(preset, n_given, n_channels)
        self.diffusion = Diffusion(LINEAR_STEPS, "linear")
        self.denoiser = UNet(n_channels, n_given + self.n_phases, preset.units // 2)
