"""Networks that look at windows: critics, and convolutions that do not see ahead."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional

SLOPE = 0.2
"""Of the leaky units of a critic (Radford, Metz & Chintala 2016)."""


def channels_first(*parts: Tensor) -> Tensor:
    """Parts (batch, time, some) side by side as (batch, all, time)."""
    return torch.cat(parts, dim=-1).transpose(1, 2)


class CausalConvolution(nn.Module):
    """A convolution over time that sees no later sample; (batch, channels, time) both ways."""

    def __init__(
        self, n_inputs: int, n_outputs: int, kernel: int, dilation: int = 1, groups: int = 1
    ) -> None:
        super().__init__()
        self.before = (kernel - 1) * dilation
        self.convolution = nn.Conv1d(n_inputs, n_outputs, kernel, dilation=dilation, groups=groups)

    def forward(self, x: Tensor) -> Tensor:
        """As long as `x`."""
        said: Tensor = self.convolution(functional.pad(x, (self.before, 0)))
        return said


class Critic(nn.Module):
    """How real each stretch of a window looks: strided convolutions over time.

    Args:
        n_inputs: Numbers per sample, conditions included.
        widths: Channels of each layer; each halves the time.
    """

    def __init__(self, n_inputs: int, widths: Sequence[int] = (32, 64, 64)) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for before, width in zip((n_inputs, *widths), widths, strict=False):
            layers += [nn.Conv1d(before, width, 5, stride=2, padding=2), nn.LeakyReLU(SLOPE)]
        self.layers = nn.Sequential(*layers, nn.Conv1d(widths[-1], 1, 1))

    def forward(self, *parts: Tensor) -> Tensor:
        """A score per stretch, shape (batch, stretches), of parts (batch, time, some)."""
        said: Tensor = self.layers(channels_first(*parts))
        return said.squeeze(1)
