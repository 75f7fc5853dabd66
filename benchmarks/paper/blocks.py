"""Parts that several systems are built of."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from learning.model.network import Quantiser
from learning.preset import Preset
from learning.training.losses import quantiser_loss

# ----------------------------------------------------------------------------------------
# Sequences in, sequences out, nothing seen before its time.


class Recurrent(nn.Module):
    """An LSTM and a linear map of what it says.

    Args:
        n_inputs: Numbers per sample.
        units: Of the LSTM.
        n_outputs: Numbers per sample.
    """

    def __init__(self, n_inputs: int, units: int, n_outputs: int) -> None:
        super().__init__()
        self.lstm = nn.LSTM(n_inputs, units, batch_first=True)
        self.out = nn.Linear(units, n_outputs)

    def forward(self, *parts: Tensor) -> Tensor:
        """Outputs of inputs given in parts, each (batch, time, some)."""
        said: Tensor = self.out(self.lstm(torch.cat(parts, dim=-1))[0])
        return said


class Translator(nn.Module):
    """Encoder, latent, decoder: what a generator is that has no codebook.

    Args:
        n_inputs: Numbers per sample that are encoded, besides the phase.
        n_phases: Of the one-hot phase, which encoder and decoder see.
        units: Of each LSTM.
        size: Of the latent.
        n_outputs: Numbers per sample.
    """

    def __init__(self, n_inputs: int, n_phases: int, units: int, size: int, n_outputs: int) -> None:
        super().__init__()
        self.encoder = Recurrent(n_inputs + n_phases, units, size)
        self.decoder = Recurrent(size + n_phases, units, n_outputs)

    def forward(self, inputs: Sequence[Tensor], phase: Tensor) -> Tensor:
        """Outputs, shape (batch, time, n_outputs)."""
        said: Tensor = self.decoder(self.encoder(*inputs, phase), phase)
        return said


# ----------------------------------------------------------------------------------------
# Networks that look at windows: critics, and convolutions that do not see ahead.

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


# ----------------------------------------------------------------------------------------
# Codebooks, and the order in which their codes follow each other.

Array = NDArray[np.float64]
Numbers = Mapping[str, NDArray[np.float32]]
COMMITMENT = 0.25
"""Weight of the latent's term (van den Oord et al. 2017, Eq. 3)."""


class Codebook(nn.Module):
    """Nearest codes with the gradient passed straight through, or soft ones.

    Args:
        soft: Mean of the codes, weighted by their distance.
        n_codes: K.
        size: D.
    """

    def __init__(self, soft: bool, n_codes: int, size: int) -> None:
        super().__init__()
        self.preset = Preset(
            "codebook",
            quantiser="soft" if soft else "hard",
            codebook_start="softmax" if soft else "uniform",
            codebook_target="soft" if soft else "nearest",
            n_codes=n_codes,
            code_size=size,
            beta=COMMITMENT,
        )
        self.quantiser = Quantiser(self.preset)

    def forward(self, z: Tensor) -> tuple[Tensor, Tensor]:
        """What the decoder gets of z (..., D), and the loss of the codebook."""
        code, latent = self.quantiser(z)
        return code, quantiser_loss(latent, self.quantiser.codes, self.preset)

    def nearest(self, z: Tensor) -> Tensor:
        """Numbers of the nearest codes, shape (...)."""
        numbers: Tensor = self.quantiser(z)[1].logits.argmax(-1)
        return numbers

    def codes(self, numbers: Tensor) -> Tensor:
        """Codes of these numbers, shape (..., D)."""
        return self.quantiser.codes[numbers]


def chain_of(
    codes: NDArray[np.intp], phase: NDArray[np.intp], begins: NDArray[np.bool_]
) -> Numbers:
    """A first-order Markov chain per phase, as the training showed it.

    Args:
        codes: Numbers of codes in their order, shape (n,).
        phase: Of each, shape (n,).
        begins: Which do not follow on the one before, shape (n,).
    """
    return {
        "codes": codes.astype(np.float32),
        "phase": phase.astype(np.float32),
        "begins": begins.astype(np.float32),
    }


def drawn_chain(
    chain: Numbers, phase: NDArray[np.intp], rng: np.random.Generator
) -> NDArray[np.intp]:
    """Samples of the training whose codes are drawn one after the other, shape (n,).

    The next code is one that followed the present one in the phase; where none did, one that the
    phase has at all, or any code of the training.

    Args:
        chain: Of `chain_of`.
        phase: Of each sample, shape (n,).
        rng: Of the draws.
    """
    codes, phases = chain["codes"].astype(np.intp), chain["phase"].astype(np.intp)
    follows = np.flatnonzero(chain["begins"][1:] == 0) + 1
    keys = np.stack([phases[follows], codes[follows - 1]], axis=1)
    after: dict[tuple[int, int], list[int]] = {}
    for (p, before), sample in zip(keys.tolist(), follows.tolist(), strict=True):
        after.setdefault((p, before), []).append(sample)
    ever = {p: np.flatnonzero(phases == p).tolist() for p in np.unique(phases).tolist()}
    drawn, now = np.empty(len(phase), dtype=np.intp), -1
    for t, p in enumerate(phase.tolist()):
        possible = after.get((p, now)) or ever.get(p) or range(len(codes))
        drawn[t] = possible[int(rng.integers(len(possible)))]
        now = int(codes[drawn[t]])
    return drawn


# ----------------------------------------------------------------------------------------
# What critics and generators lose.


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


# ----------------------------------------------------------------------------------------
# Denoising diffusion: noise is added step by step, and a network learns to take it away.
#
# What the network says is v, a turn of signal and noise that tells both at every step: the noise
# alone does not tell the signal where next to nothing of it is left.
#
# Source: Ho, Jain & Abbeel, Denoising Diffusion Probabilistic Models, 2020; cosine schedule:
# Nichol & Dhariwal, 2021, Eq. 17; v: Salimans & Ho, 2022, sec. 4.

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

    signal_share: Tensor
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
        self.register_buffer("signal_share", torch.cumprod(1 - betas, 0).float(), persistent=False)

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
            beta, signal_share = self.betas[k], self.signal_share[k]
            before = self.signal_share[k - 1] if k else torch.ones_like(signal_share)
            x = before.sqrt() * beta * clean + (1 - beta).sqrt() * (1 - before) * x
            x = x / (1 - signal_share)
            if k:
                x = x + (beta * (1 - before) / (1 - signal_share)).sqrt() * torch.randn_like(x)
        return x

    def signal(self, step: Tensor) -> tuple[Tensor, Tensor]:
        """Shares of signal and noise in noisy windows, shape (batch, 1, 1) each."""
        signal_share = self.signal_share[step][:, None, None]
        return signal_share.sqrt(), (1 - signal_share).sqrt()


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
