"""TimeDDPM: diffusion of 100 linear steps, told from its noise by a U-Net with attention over time.

No public code or text was found: after the one-line description. Two levels, residual blocks and
attention as in Ho, Jain & Abbeel, 2020, appendix B, in one dimension.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from ..blocks.convolution import channels_first
from ..blocks.diffusion import Diffusion, StepEmbedding
from ..training.system_family import SystemFamily
from .system import SystemPreset
from .tdm import Tdm

STEPS = 100
GROUPS, HEADS = 8, 4
SMALLEST = 4
"""Windows are padded to a multiple: each of two levels halves them."""


class _Block(nn.Module):
    """Two convolutions with the step between them, and a way around."""

    def __init__(self, n_inputs: int, n_outputs: int, width: int) -> None:
        super().__init__()
        self.first = nn.Conv1d(n_inputs, n_outputs, 3, padding=1)
        self.second = nn.Conv1d(n_outputs, n_outputs, 3, padding=1)
        self.norms = nn.ModuleList(nn.GroupNorm(GROUPS, n_outputs) for _ in range(2))
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
        self.norm = nn.GroupNorm(GROUPS, wide)
        self.attention = nn.MultiheadAttention(wide, HEADS, batch_first=True)
        self.up = nn.ModuleList([_Block(2 * wide, width, width), _Block(2 * width, width, width)])
        self.end = nn.Conv1d(width, n_channels, 1)

    def forward(self, x: Tensor, step: Tensor, conditions: Tensor) -> Tensor:
        """Shape of `x`."""
        length, embedded = x.shape[1], self.step(step)
        x = functional.pad(channels_first(x, conditions), (0, -length % SMALLEST))
        kept = []
        for block in self.down:
            x = block(x, embedded)
            kept.append(x)
            x = functional.avg_pool1d(x, 2)
        x = self.middle(x, embedded)
        over_time = self.norm(x).transpose(1, 2)
        x = x + self.attention(over_time, over_time, over_time, need_weights=False)[0].transpose(
            1, 2
        )
        for block in self.up:
            x = functional.interpolate(x, scale_factor=2.0, mode="nearest")
            x = block(torch.cat([x, kept.pop()], dim=1), embedded)
        said: Tensor = self.end(x)[..., :length]
        return said.transpose(1, 2)


class TimeDdpm(Tdm):
    """As TDM, with another schedule and another denoiser."""

    sees_ahead = True

    def __init__(self, preset: SystemPreset, n_given: int, n_channels: int) -> None:
        super().__init__(preset, n_given, n_channels)
        self.diffusion = Diffusion(STEPS, "linear")
        self.denoiser = UNet(n_channels, n_given + self.n_phases, preset.units // 2)


class TimeDdpmFamily(SystemFamily):
    """For the registry."""

    system, preset = TimeDdpm, SystemPreset("timeddpm")
