"""AutoFilterVQ: a bank of filters that is learned, before a codebook with soft assignment.

After the paper's description. Kernels of 3, 9 and 27 samples for each number that is given, mixed
by a softmax of their own; they begin as what leaves everything as it is, and see no later sample.
"""

import torch
from torch import Tensor, nn

from ..blocks.convolution import CausalConvolution
from ..training.system_family import SystemFamily
from .system import SystemPreset
from .vqvae import VqVae

KERNELS = (3, 9, 27)


class FilterBank(nn.Module):
    """Finite impulse responses, one of each length per number; (batch, time, n) both ways."""

    def __init__(self, n: int) -> None:
        super().__init__()
        self.filters = nn.ModuleList(CausalConvolution(n, n, k, groups=n) for k in KERNELS)
        self.shares = nn.Parameter(torch.zeros(len(KERNELS), n))
        for each in self.filters:
            assert isinstance(each, CausalConvolution) and each.convolution.bias is not None
            nn.init.zeros_(each.convolution.weight)
            nn.init.ones_(each.convolution.weight[..., -1])
            nn.init.zeros_(each.convolution.bias)

    def forward(self, x: Tensor) -> Tensor:
        """Mixed."""
        ways = torch.stack([f(x.transpose(1, 2)).transpose(1, 2) for f in self.filters])
        return (ways * torch.softmax(self.shares, dim=0)[:, None, None, :]).sum(0)


class AutoFilterVq(VqVae):
    """The bank, then LSTM, soft codebook, LSTM."""

    soft = True

    def __init__(self, preset: SystemPreset, n_given: int, n_channels: int) -> None:
        super().__init__(preset, n_given, n_channels)
        self.bank = FilterBank(n_given)

    def latent(self, given: Tensor, phase: Tensor) -> Tensor:
        """Of what the filters leave."""
        return super().latent(self.bank(given), phase)


class AutoFilterVqFamily(SystemFamily):
    """For the registry."""

    system, preset = AutoFilterVq, SystemPreset("autofiltervq")
