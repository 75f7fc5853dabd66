"""The FC-MC-SVQ network: for each cluster of channels an LSTM encoder, a codebook with soft
assignment, and an LSTM decoder.

Every module maps whole sequences, from an initial to a final state: rows of `[h, c]` of each layer,
encoder before decoder, cluster after cluster; zero at the start.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from ..data.channels import N_PHASES
from ..data.clustering import Clusters
from ..preset import Preset, Protocol

LOG_SPREAD_LIMIT = 6.0
"""Limit of the predicted log spread, so that spreads stay within e^-6..e^6 of the scale and are
never zero or infinite."""


@dataclass(frozen=True, slots=True)
class Latent:
    """Variables of one cluster's quantiser, for the losses; leading shape (batch, time).

    Attributes:
        z: Latent vector, shape (..., D).
        code: Input of the decoder, before any gradient estimator, shape (..., D).
        logits: Logits of the assignment, not normalised, shape (..., K).
    """

    z: Tensor
    code: Tensor
    logits: Tensor


@dataclass(frozen=True, slots=True)
class NetworkOut:
    """Output of the network.

    Attributes:
        y: Output in units of the training target, shape (..., 15).
        log_spread: Logarithm of the predicted spread of `y`, 0 without a spread head, shape (...,
            15).
        latents: Latent variables per cluster; empty where no loss needs them.
    """

    y: Tensor
    log_spread: Tensor
    latents: tuple[Latent, ...] = ()


class LstmStack(nn.Module):
    """Stacked LSTM layers."""

    def __init__(self, n_inputs: int, units: Sequence[int]) -> None:
        super().__init__()
        sizes = [n_inputs, *units]
        self.layers = nn.ModuleList(nn.LSTM(a, b, batch_first=True) for a, b in pairwise(sizes))
        self.units = tuple(units)

    @property
    def state_size(self) -> int:
        """Size of the packed state."""
        return 2 * sum(self.units)

    def forward(self, x: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Outputs (batch, time, units) and next state for x (batch, time, inputs)."""
        parts = torch.split(state, [n for n in self.units for _ in range(2)], dim=-1)
        states = []
        for layer, h, c in zip(self.layers, parts[::2], parts[1::2], strict=True):
            x, (h, c) = layer(x, (h.unsqueeze(0).contiguous(), c.unsqueeze(0).contiguous()))
            states += [h.squeeze(0), c.squeeze(0)]
        return x, torch.cat(states, dim=-1)


class Quantiser(nn.Module):
    """Codebook quantiser of one cluster."""

    codes: nn.Parameter
    """Codebook, shape (K, D)."""

    def __init__(self, preset: Preset) -> None:
        super().__init__()
        self.kind = preset.quantiser
        self.temperature = preset.temperature
        self.straight_through = preset.straight_through
        codes = torch.empty(preset.n_codes, preset.code_size)
        if preset.codebook_start == "uniform":
            nn.init.uniform_(codes, -1 / preset.n_codes, 1 / preset.n_codes)
        else:
            nn.init.normal_(codes)
            length = (preset.code_size * preset.temperature / 2) ** 0.5
            codes = length * nn.functional.normalize(codes, dim=-1)
        self.codes = nn.Parameter(codes)

    def forward(self, z: Tensor) -> tuple[Tensor, Latent]:
        """Decoder input for z (..., D), and the variables that the losses need."""
        squares = (self.codes * self.codes).sum(-1)
        # |z - e|^2 = |z|^2 - (2 z.e - |e|^2): the same |z|^2 for every code cancels in a softmax
        closeness = (2 * z) @ self.codes.T - squares  # (..., K)
        logits = closeness / self.temperature
        if self.kind == "none":
            return z, Latent(z, z, logits)
        if self.kind == "soft":
            code = torch.softmax(logits, dim=-1) @ self.codes
        else:
            nearest = (closeness == closeness.amax(-1, keepdim=True)).to(z.dtype)
            code = (nearest / nearest.sum(-1, keepdim=True)) @ self.codes
        passed = code
        if self.kind == "hard" or self.straight_through:
            passed = z + (code - z).detach()
        return passed, Latent(z, code, logits)

    def response(self) -> Tensor:
        """Derivative of the code by the latent at zero, shape (D, D)."""
        if self.kind != "soft":
            return torch.eye(self.codes.shape[1])
        weights = torch.softmax(-(self.codes * self.codes).sum(-1) / self.temperature, dim=0)
        about = self.codes - weights @ self.codes
        return (about.T * weights) @ about * (2 / self.temperature)

    def at_rest(self) -> Tensor:
        """Code at latent zero, shape (D,)."""
        return self.forward(torch.zeros(self.codes.shape[1]))[1].code


class ClusterNetwork(nn.Module):
    """Encoder, codebook and decoder of one cluster of channels.

    Args:
        n_channels: Number of channels in the cluster.
        n_seen: Number of inputs per sample, without the phase: known residuals, features.
        copies: Whether the first `n_channels` inputs are the targets: the linear path then starts
            as the identity; otherwise as zero.
        preset: Preset with sizes and switches.
    """

    def __init__(self, n_channels: int, n_seen: int, copies: bool, preset: Preset) -> None:
        super().__init__()
        size, encoded, decoded = (
            preset.code_size,
            preset.encoder_units[-1],
            preset.decoder_units[-1],
        )
        self.encoder = LstmStack(n_seen + preset.phase_size, preset.encoder_units)
        self.to_latent = nn.Linear(encoded, size)
        self.quantiser = Quantiser(preset)
        self.decoder = LstmStack(size + preset.phase_size, preset.decoder_units)
        self.to_output = nn.Linear(decoded, n_channels)
        self.skip_in = nn.Linear(n_seen, size, bias=False) if preset.skip else None
        self.skip_out = nn.Linear(size, n_channels) if preset.skip else None
        self.to_spread = nn.Linear(decoded, n_channels) if preset.spread_head else None
        if self.to_spread is not None:
            nn.init.zeros_(self.to_spread.weight)
            nn.init.zeros_(self.to_spread.bias)
        if preset.skip:
            self._start(n_channels, copies, preset.skip_gain)

    @property
    def state_size(self) -> int:
        """Size of the packed state."""
        return self.encoder.state_size + self.decoder.state_size

    def forward(
        self, seen: Tensor, phase: Tensor, state: Tensor
    ) -> tuple[Tensor, Tensor, Latent, Tensor]:
        """Output, log spread, latent and next state.

        Args:
            seen: Inputs, shape (batch, time, n_seen).
            phase: Embedding of the phase, shape (batch, time, phase_size).
            state: State, shape (batch, state_size).
        """
        sizes = [self.encoder.state_size, self.decoder.state_size]
        encoder_state, decoder_state = torch.split(state, sizes, dim=-1)
        h, encoder_state = self.encoder(torch.cat([seen, phase], dim=-1), encoder_state)
        z = self.to_latent(h)
        if self.skip_in is not None:
            z = z + self.skip_in(seen)
        code, latent = self.quantiser(z)
        h, decoder_state = self.decoder(torch.cat([code, phase], dim=-1), decoder_state)
        y = self.to_output(h)
        if self.skip_out is not None:
            y = y + self.skip_out(code)
        log_spread = torch.zeros_like(y)
        if self.to_spread is not None:
            # the spread learns from the error, never the other way round
            log_spread = self.to_spread(h.detach()).clamp(-LOG_SPREAD_LIMIT, LOG_SPREAD_LIMIT)
        return y, log_spread, latent, torch.cat([encoder_state, decoder_state], dim=-1)

    def _start(self, n_channels: int, copies: bool, gain: float) -> None:
        """Initialise: the code carries the sample, and the LSTMs, which add context, start at
        zero."""
        assert self.skip_in is not None and self.skip_out is not None
        nn.init.orthogonal_(self.skip_in.weight, gain)
        for layer in (self.to_latent, self.to_output, self.skip_out):
            nn.init.zeros_(layer.bias)
        nn.init.normal_(self.to_latent.weight, std=0.01 * gain)
        nn.init.normal_(self.to_output.weight, std=0.01)
        nn.init.zeros_(self.skip_out.weight)
        if copies:
            with torch.no_grad():
                through = self.quantiser.response() @ self.skip_in.weight[:, :n_channels]
                self.skip_out.weight.copy_(torch.linalg.pinv(through))
                self.skip_out.bias.copy_(-self.skip_out.weight @ self.quantiser.at_rest())


class SvqNetwork(nn.Module):
    """Networks of all clusters in parallel, conditioned on the phase.

    Args:
        preset: Preset with sizes and switches.
        protocol: Protocol: in `free` the residual is no input, in `reconstruct` the features are
            none.
        clusters: Channels of each cluster.
        n_features: Number of features: virtual signals and commands.
    """

    order: Tensor

    def __init__(
        self, preset: Preset, protocol: Protocol, clusters: Clusters, n_features: int
    ) -> None:
        super().__init__()
        self.clusters = clusters
        self.sees_known = protocol != "free"
        self.sees_features = preset.sees_features(protocol)
        self.phase_embedding = nn.Parameter(torch.randn(N_PHASES, preset.phase_size))
        seen = n_features if self.sees_features else 0
        self.networks = nn.ModuleList(
            ClusterNetwork(
                len(c),
                seen + (len(c) if self.sees_known else 0),
                protocol == "reconstruct",
                preset,
            )
            for c in clusters
        )
        places = [c for cluster in clusters for c in cluster]
        order = [places.index(c) for c in range(len(places))]
        self.register_buffer("order", torch.tensor(order), persistent=False)

    @property
    def state_size(self) -> int:
        """Size of the packed state."""
        return sum(self._sizes())

    def forward(
        self, known: Tensor, features: Tensor, phase: Tensor, state: Tensor
    ) -> tuple[NetworkOut, Tensor]:
        """Output over a sequence, and the state after it.

        Args:
            known: Standardised residuals, shape (batch, time, 15); ignored in `free`.
            features: Standardised features, shape (batch, time, features).
            phase: One-hot phase, shape (batch, time, phases).
            state: State, shape (batch, state_size).
        """
        embedded = phase @ self.phase_embedding
        features = features if self.sees_features else features[..., :0]
        found = []
        parts = torch.split(state, self._sizes(), dim=-1)
        for network, cluster, part in zip(self.networks, self.clusters, parts, strict=True):
            own = known[..., list(cluster) if self.sees_known else []]
            found.append(network(torch.cat([own, features], dim=-1), embedded, part))
        ys, spreads, latents, states = zip(*found, strict=True)
        y, spread = (torch.cat(each, dim=-1)[..., self.order] for each in (ys, spreads))
        return NetworkOut(y, spread, latents), torch.cat(states, dim=-1)

    def fill_unseen(self, seen: Sequence[bool]) -> None:
        """Set the embedding of phases without training data to the mean of the others."""
        rows = torch.tensor(list(seen), dtype=torch.bool)
        if rows.any():
            with torch.no_grad():
                self.phase_embedding[~rows] = self.phase_embedding[rows].mean(0)

    def _sizes(self) -> list[int]:
        return [n.state_size for n in self.networks if isinstance(n, ClusterNetwork)]
