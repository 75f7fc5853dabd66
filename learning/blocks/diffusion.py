"""Denoising diffusion: noise is added step by step, and a network learns to take it away.

What the network says is v, a turn of signal and noise that tells both at every step: the noise
alone does not tell the signal where next to nothing of it is left.

Source: Ho, Jain & Abbeel, Denoising Diffusion Probabilistic Models, 2020; cosine schedule: Nichol &
Dhariwal, 2021, Eq. 17; v: Salimans & Ho, 2022, sec. 4.
"""

import math
from collections.abc import Callable
from typing import Literal

import torch
from torch import Tensor, nn

Denoiser = Callable[[Tensor, Tensor], Tensor]
"""Noisy windows (batch, time, channels) and their steps (batch,) to v."""
LARGEST_BETA = 0.999
OFFSET = 0.008
LINEAR = (1e-3, 0.2)
"""First and last beta of the linear schedule: of 1000 steps 1e-4 and 0.02 are usual, of 100 ten
times as much leaves as little of the signal."""


class Diffusion(nn.Module):
    """Schedule, loss and sampler.

    Args:
        steps: How many.
        schedule: Of the noise.
    """

    kept: Tensor
    """Share of the variance that is still signal after each step, shape (steps,)."""
    betas: Tensor
    """Variance of the noise of each step, shape (steps,)."""

    def __init__(self, steps: int, schedule: Literal["cosine", "linear"]) -> None:
        super().__init__()
        if schedule == "cosine":
            t = torch.arange(steps + 1, dtype=torch.float64) / steps
            signal = torch.cos((t + OFFSET) / (1 + OFFSET) * math.pi / 2) ** 2
            betas = (1 - signal[1:] / signal[:-1]).clamp(max=LARGEST_BETA)
        else:
            betas = torch.linspace(*LINEAR, steps, dtype=torch.float64)
        self.register_buffer("betas", betas.float(), persistent=False)
        self.register_buffer("kept", torch.cumprod(1 - betas, 0).float(), persistent=False)

    def loss(self, denoiser: Denoiser, x: Tensor, scored: Tensor) -> Tensor:
        """Mean square of the error in v.

        Args:
            denoiser: To be trained.
            x: Windows, shape (batch, time, channels).
            scored: 1 where a sample counts, the same shape.
        """
        step = torch.randint(len(self.betas), (len(x),), device=x.device)
        signal, rest = self.signal(step)
        noise = torch.randn_like(x)
        turned = signal * noise - rest * x
        error = (denoiser(signal * x + rest * noise, step) - turned) ** 2
        return (error * scored).sum() / scored.sum().clamp(min=1)

    def sample(self, denoiser: Denoiser, shape: tuple[int, int, int]) -> Tensor:
        """Windows from noise, Algorithm 2; draws from torch's generator."""
        x = torch.randn(shape, device=self.betas.device)
        for k in reversed(range(len(self.betas))):
            step = torch.full((shape[0],), k, device=x.device)
            signal, rest = self.signal(step)
            clean = signal * x - rest * denoiser(x, step)
            beta, kept = self.betas[k], self.kept[k]
            before = self.kept[k - 1] if k else torch.ones_like(kept)
            x = before.sqrt() * beta * clean + (1 - beta).sqrt() * (1 - before) * x
            x = x / (1 - kept)
            if k:
                x = x + (beta * (1 - before) / (1 - kept)).sqrt() * torch.randn_like(x)
        return x

    def signal(self, step: Tensor) -> tuple[Tensor, Tensor]:
        """Shares of signal and noise in noisy windows, shape (batch, 1, 1) each."""
        kept = self.kept[step][:, None, None]
        return kept.sqrt(), (1 - kept).sqrt()


class StepEmbedding(nn.Module):
    """The step as sines and cosines through two layers (Vaswani et al. 2017, sec. 3.5)."""

    rates: Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        rates = torch.exp(-math.log(1e4) * torch.arange(size // 2) / (size // 2))
        self.register_buffer("rates", rates, persistent=False)
        self.layers = nn.Sequential(nn.Linear(size, size), nn.SiLU(), nn.Linear(size, size))

    def forward(self, step: Tensor) -> Tensor:
        """Shape (batch, size) of steps (batch,)."""
        angle = step[:, None] * self.rates
        said: Tensor = self.layers(torch.cat([angle.sin(), angle.cos()], dim=-1))
        return said
