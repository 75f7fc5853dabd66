"""Systems that encode and decode: CVAE, VQVAE and what is built on it."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from .blocks import CausalConvolution, Codebook, Critic, Recurrent, chain_of, drawn_chain, hinge
from .system import Batch, Numbers, System, SystemPreset, mean_absolute, mean_square

# ----------------------------------------------------------------------------------------
# CVAE: a Gaussian latent per sample, encoder and decoder conditioned on the phase.
#
# Source: Sohn, Lee & Yan, Learning Structured Output Representation using Deep Conditional
# Generative Models, 2015. A Gaussian of spread 1 about the decoder's output; weight of the KL term
# 1.


class Cvae(System):
    """LSTM to mean and spread of the latent, LSTM back."""

    autoencoder = True

    def __init__(self, preset: SystemPreset, n_given: int, n_channels: int) -> None:
        super().__init__(preset, n_given, n_channels)
        size, p = preset.code_size, self.n_phases
        self.encoder = Recurrent(n_given + p, preset.units, 2 * size)
        self.decoder = Recurrent(size + p, preset.units, n_channels)

    def loss(self, player: str, batch: Batch) -> Tensor:
        """The evidence's lower bound, negative, per sample."""
        mean, log_variance = self.encoder(batch.given, batch.phase).chunk(2, dim=-1)
        latent = mean + torch.exp(log_variance / 2) * torch.randn_like(mean)
        error = (self.decoder(latent, batch.phase) - batch.target) * batch.scored
        divergence = (mean**2 + log_variance.exp() - 1 - log_variance) / 2
        return torch.mean((error**2 / 2).sum(-1)) + torch.mean(divergence.sum(-1))

    def reconstruct(self, given: Tensor, phase: Tensor) -> Tensor:
        """From the mean of the latent."""
        mean, _ = self.encoder(given, phase).chunk(2, dim=-1)
        said: Tensor = self.decoder(mean, phase)
        return said

    def generate(self, phase: Tensor, prior: Numbers) -> Tensor:
        """From a latent of the unit Gaussian."""
        latent = torch.randn(*phase.shape[:2], self.preset.code_size, device=phase.device)
        said: Tensor = self.decoder(latent, phase)
        return said


# ----------------------------------------------------------------------------------------
# VQVAE: one codebook for all channels, the nearest code, gradients passed straight through.
#
# Source: van den Oord, Vinyals & Kavukcuoglu, Neural Discrete Representation Learning, 2017;
# commitment 0.25. It generates from a first-order Markov chain over the codes of each phase. With
# soft assignment, in the systems built on it, the chain is that of the nearest codes, and what is
# decoded is the mixture that a sample of the training was told by: the decoder knows no code
# alone.


class VqVae(System):
    """LSTM, codebook, LSTM; others are built on it."""

    autoencoder = True
    soft = False

    def __init__(self, preset: SystemPreset, n_given: int, n_channels: int) -> None:
        super().__init__(preset, n_given, n_channels)
        size, p = preset.code_size, self.n_phases
        self.encoder = Recurrent(n_given + p, preset.units, size)
        self.codebook = Codebook(self.soft, preset.n_codes, size)
        self.decoder = Recurrent(size + p, preset.units, n_channels)

    def latent(self, given: Tensor, phase: Tensor) -> Tensor:
        """Before the codebook, shape (batch, time, D)."""
        said: Tensor = self.encoder(given, phase)
        return said

    def said(self, given: Tensor, phase: Tensor) -> tuple[Tensor, Tensor]:
        """Residuals, and the loss of the codebook."""
        code, loss = self.codebook(self.latent(given, phase))
        return self.decoder(code, phase), loss

    def loss(self, player: str, batch: Batch) -> Tensor:
        """Error and codebook, Eq. 3."""
        y, of_codebook = self.said(batch.given, batch.phase)
        return mean_square(y - batch.target, batch.scored) + of_codebook

    def reconstruct(self, given: Tensor, phase: Tensor) -> Tensor:
        """Through the codebook."""
        return self.said(given, phase)[0]

    def learn_prior(self, given: Tensor, phase: Tensor, begins: NDArray[np.bool_]) -> Numbers:
        """The chain of nearest codes; where codes are mixed, what each sample was told by, too."""
        latent = self.latent(given, phase)
        codes = self.codebook.nearest(latent)[0].cpu().numpy()
        chain = chain_of(codes, phase[0].argmax(-1).cpu().numpy(), begins)
        if not self.soft:
            return chain
        return {**chain, "told": self.codebook(latent)[0][0].cpu().numpy()}

    def generate(self, phase: Tensor, prior: Numbers) -> Tensor:
        """Decoded from a chain drawn again."""
        rng = np.random.default_rng(int(torch.randint(2**31, ())))
        drawn = np.stack([drawn_chain(prior, p.cpu().numpy(), rng) for p in phase.argmax(-1)])
        if self.soft:
            code = torch.from_numpy(prior["told"][drawn])
        else:
            code = self.codebook.codes(torch.from_numpy(prior["codes"][drawn].astype(np.intp)))
        said: Tensor = self.decoder(code.to(phase.device), phase)
        return said


# ----------------------------------------------------------------------------------------
# VQGAN: VQVAE, and a patch critic once 30 % of the training are over.
#
# Source: Esser, Rombach & Ommer, Taming Transformers for High-Resolution Image Synthesis, 2021:
# hinge loss, weight of the critic such that its gradient at the last layer is that of the error
# (Eq. 7). It generates as VQVAE does.

CRITIC_BEGINS = 0.3
LARGEST_WEIGHT, TINY = 1e4, 1e-6


class VqGan(VqVae):
    """A patch is what the critic scores: 8 samples apart, 29 wide."""

    def __init__(self, preset: SystemPreset, n_given: int, n_channels: int) -> None:
        super().__init__(preset, n_given, n_channels)
        self.critic = Critic(n_channels + self.n_phases)

    def turns(self, done: float) -> tuple[str, ...]:
        """The network alone at first."""
        return ("network",) if done < CRITIC_BEGINS else ("critic", "network")

    def players(self) -> dict[str, nn.Module]:
        """Two; the first is all but the critic."""
        network = nn.ModuleList([self.encoder, self.codebook, self.decoder])
        return {"network": network, "critic": self.critic}

    def loss(self, player: str, batch: Batch) -> Tensor:
        """Hinge of the critic; error, codebook and adaptive critic of the network."""
        y, of_codebook = self.said(batch.given, batch.phase)
        fake = self.critic(y * batch.scored, batch.phase)
        if player == "critic":
            return hinge(self.critic(batch.target * batch.scored, batch.phase), fake)
        error = mean_square(y - batch.target, batch.scored)
        if batch.done < CRITIC_BEGINS:
            return error + of_codebook
        against = -fake.mean()
        weight = (self._slope(error) / (self._slope(against) + TINY)).clamp(max=LARGEST_WEIGHT)
        loss: Tensor = error + of_codebook + weight * against
        return loss

    def _slope(self, loss: Tensor) -> Tensor:
        """Size of the gradient at the last layer."""
        (slope,) = torch.autograd.grad(loss, self.decoder.out.weight, retain_graph=True)
        size: Tensor = slope.norm().detach()
        return size


# ----------------------------------------------------------------------------------------
# VQWWVAE: VQVAE with a Wasserstein distance per channel in its loss.
#
# No public code or text was found: after the one-line description. The distance of two samples of
# one dimension is the mean distance of their ordered values.


class VqwwVae(VqVae):
    """Order of the values over a window, channel by channel."""

    def loss(self, player: str, batch: Batch) -> Tensor:
        """Error, codebook, distributions."""
        y, of_codebook = self.said(batch.given, batch.phase)
        apart = _ordered(y * batch.scored) - _ordered(batch.target * batch.scored)
        error = mean_square(y - batch.target, batch.scored)
        return error + of_codebook + mean_absolute(apart, _ordered(batch.scored))


def _ordered(values: Tensor) -> Tensor:
    return values.sort(dim=1).values


# ----------------------------------------------------------------------------------------
# AutoFilterVQ: a bank of filters that is learned, before a codebook with soft assignment.
#
# After the paper's description. Kernels of 3, 9 and 27 samples for each number that is given,
# mixed by a softmax of their own; they begin as what leaves everything as it is, and see no later
# sample.

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


# ----------------------------------------------------------------------------------------
# ContrastVQ: a codebook with soft assignment, and latents that know their window again.
#
# After the paper's description. Two views of each window, scaled and shaken at random, are to be
# nearer to each other than to those of the other windows of the batch: InfoNCE of van den Oord, Li
# & Vinyals, 2018, temperature 0.07, as in Chen et al., 2020, Eq. 1.

CONTRAST_TEMPERATURE = 0.07
SHAKEN, SCALED = 0.05, 0.2
"""Spreads of noise and of the factor of a view."""
CONTRAST_WEIGHT = 0.1
PROJECTED = 64


class ContrastVq(VqVae):
    """A projection of the mean latent is what is compared."""

    soft = True

    def __init__(self, preset: SystemPreset, n_given: int, n_channels: int) -> None:
        super().__init__(preset, n_given, n_channels)
        self.projection = nn.Linear(preset.code_size, PROJECTED)

    def loss(self, player: str, batch: Batch) -> Tensor:
        """Error, codebook, contrast."""
        one, other = (self._view(batch) for _ in range(2))
        likeness = one @ other.T / CONTRAST_TEMPERATURE
        own = torch.arange(len(likeness), device=likeness.device)
        contrast = functional.cross_entropy(likeness, own) + functional.cross_entropy(
            likeness.T, own
        )
        return super().loss(player, batch) + CONTRAST_WEIGHT * contrast / 2

    def _view(self, batch: Batch) -> Tensor:
        """Where a changed copy of each window lies, of length 1, shape (batch, PROJECTED)."""
        given = batch.given
        factor = 1 + SCALED * torch.randn(len(given), 1, given.shape[-1], device=given.device)
        seen = factor * given + SHAKEN * torch.randn_like(given)
        mean = self.latent(seen, batch.phase).mean(dim=1)
        return functional.normalize(self.projection(mean), dim=-1)


# ----------------------------------------------------------------------------------------
# MCVQ: slow and fast part of the residual, each with encoder, codebook and decoder of its own.
#
# After the paper's description. The slow part is the mean of the last nine samples; soft
# assignment.

SLOW = 9
"""Samples."""


class _Part(VqVae):
    soft = True


class McVq(System):
    """Two networks whose sum is the residual."""

    autoencoder = True

    def __init__(self, preset: SystemPreset, n_given: int, n_channels: int) -> None:
        super().__init__(preset, n_given, n_channels)
        self.parts = nn.ModuleList(_Part(preset, n_given, n_channels) for _ in range(2))

    def loss(self, player: str, batch: Batch) -> Tensor:
        """Each part answers for its own share of the residual."""
        loss = torch.zeros((), device=batch.given.device)
        halves = zip(self._parts(), _split(batch.given), _split(batch.target), strict=True)
        for part, given, target in halves:
            y, of_codebook = part.said(given, batch.phase)
            loss = loss + mean_square(y - target, batch.scored) + of_codebook
        return loss

    def reconstruct(self, given: Tensor, phase: Tensor) -> Tensor:
        """The sum of both."""
        both = zip(self._parts(), _split(given), strict=True)
        return torch.stack([part.reconstruct(half, phase) for part, half in both]).sum(0)

    def learn_prior(self, given: Tensor, phase: Tensor, begins: NDArray[np.bool_]) -> Numbers:
        """A chain each."""
        both = enumerate(zip(self._parts(), _split(given), strict=True))
        return {
            f"{k}.{name}": values
            for k, (part, half) in both
            for name, values in part.learn_prior(half, phase, begins).items()
        }

    def generate(self, phase: Tensor, prior: Numbers) -> Tensor:
        """The sum of two draws."""
        drawn = []
        for k, part in enumerate(self._parts()):
            own = {n.removeprefix(f"{k}."): v for n, v in prior.items() if n.startswith(f"{k}.")}
            drawn.append(part.generate(phase, own))
        return torch.stack(drawn).sum(0)

    def _parts(self) -> list[_Part]:
        return [part for part in self.parts if isinstance(part, _Part)]


def _split(x: Tensor) -> tuple[Tensor, Tensor]:
    """Slow and fast part of (batch, time, n); before the first sample is zero."""
    padded = functional.pad(x.transpose(1, 2), (SLOW - 1, 0))
    slow = functional.avg_pool1d(padded, SLOW, stride=1).transpose(1, 2)
    return slow, x - slow
