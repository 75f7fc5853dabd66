"""What critics and generators lose."""

from collections.abc import Callable

import torch
from torch import Tensor, nn
from torch.nn import functional


def gradient_penalty(critic: Callable[[Tensor], Tensor], real: Tensor, fake: Tensor) -> Tensor:
    """How far the slope of a critic is from 1 between real and fake.

    Args:
        critic: Of windows like `real`.
        real: Shape (batch, ...).
        fake: Of the same shape.

    Source: Gulrajani et al., Improved Training of Wasserstein GANs, 2017, Eq. 3.
    """
    share = torch.rand(len(real), *[1] * (real.dim() - 1), device=real.device)
    between = (share * real + (1 - share) * fake).detach().requires_grad_(True)
    (slope,) = torch.autograd.grad(critic(between).sum(), between, create_graph=True)
    return torch.mean((slope.flatten(1).norm(dim=1) - 1) ** 2)


def hinge(real: Tensor, fake: Tensor) -> Tensor:
    """Of a critic (Lim & Ye 2017; Esser et al. 2021)."""
    return (functional.relu(1 - real) + functional.relu(1 + fake)).mean() / 2


def real_or_fake(scores: Tensor, real: bool) -> Tensor:
    """Cross entropy of scores that should all say one thing (Goodfellow et al. 2014)."""
    wanted = torch.full_like(scores, float(real))
    return functional.binary_cross_entropy_with_logits(scores, wanted)


@torch.no_grad()
def clip_weights(network: nn.Module, size: float) -> None:
    """Keep every weight within a size (Arjovsky et al. 2017, Algorithm 1)."""
    for parameter in network.parameters():
        parameter.clamp_(-size, size)
