"""Training losses: Eqs. 10-15 and Algorithm 1 of the paper, with the preset's switches."""

import torch
from torch import Tensor

from ..data.clustering import Clusters
from ..model.network import Latent, NetworkOut, Quantiser
from ..preset import Preset

PARTS = ("reconstruction", "quantiser", "distribution", "spread")
"""Names of the parts of the loss."""


def losses(
    out: NetworkOut,
    target: Tensor,
    scored: Tensor,
    clusters: Clusters,
    quantisers: list[Quantiser],
    preset: Preset,
) -> dict[str, Tensor]:
    """Weighted parts of the loss over one window by name, each a scalar; their sum is
    differentiated.

    `reconstruction`: mean square error, summed over the clusters; `quantiser`: distance between
    latent and codes, summed over the clusters; `distribution`: differences of mean and spread, mean
    over the channels; `spread`: negative log likelihood of the predicted spread, whose gradient
    reaches no other output.

    Args:
        out: Output of the network, leading shape (batch, time).
        target: Target of `out.y`, shape (batch, time, 15).
        scored: 1 where the target counts, else 0, shape (batch, time, 15).
        clusters: Channels of each cluster.
        quantisers: Quantiser of each cluster.
        preset: Preset with weights and switches.
    """
    error = (out.y - target) * scored
    nought = error.new_zeros(())
    reconstruction, quantiser = nought, nought
    for cluster in clusters:
        columns = list(cluster)
        part = _mean(error[..., columns] ** 2, scored[..., columns])
        reconstruction = reconstruction + part * _length(len(columns), preset)
    if preset.quantiser != "none" and preset.weight_quantiser:
        for latent, codebook in zip(out.latents, quantisers, strict=True):
            quantiser = quantiser + quantiser_loss(latent, codebook.codes, preset)
    distribution = nought
    if preset.weight_distribution:
        distribution = moments_loss(out.y, target, scored) * _length(target.shape[-1], preset)
    spread = nought
    if preset.spread_head:
        shrunk = error.detach() * torch.exp(-out.log_spread)
        spread = _mean((out.log_spread + shrunk**2 / 2) * scored, scored)
    weighted = (
        preset.weight_reconstruction * reconstruction,
        preset.weight_quantiser * quantiser,
        preset.weight_distribution * distribution,
        spread,
    )
    return dict(zip(PARTS, weighted, strict=True))


def quantiser_loss(latent: Latent, codes: Tensor, preset: Preset) -> Tensor:
    """Codebook loss and commitment loss, Eqs. 10 and 11.

    Args:
        latent: Latent variables, shapes (batch, time, D) and (batch, time, K).
        codes: Codebook, shape (K, D).
        preset: Preset with `codebook_target` and `beta`.
    """
    code = latent.code
    if preset.codebook_target == "nearest":
        code = codes[latent.logits.argmax(-1)]
    to_codes = torch.mean((latent.z.detach() - code) ** 2)
    to_latent = torch.mean((latent.z - code.detach()) ** 2)
    return (to_codes + preset.beta * to_latent) * _length(codes.shape[-1], preset)


def moments_loss(y: Tensor, target: Tensor, scored: Tensor) -> Tensor:
    """|difference of means| + |difference of spreads| per channel, Algorithm 1 line 20.

    Args:
        y: Output, shape (batch, time, 15).
        target: Target, shape (batch, time, 15).
        scored: 1 where the target counts, else 0, shape (batch, time, 15).
    """
    count = scored.sum((0, 1)).clamp(min=1)
    parts = []
    for values in (y, target):
        mean = (values * scored).sum((0, 1)) / count
        variance = (((values - mean) * scored) ** 2).sum((0, 1)) / count
        parts.append((mean, torch.sqrt(variance + 1e-8)))
    (mean, spread), (target_mean, target_spread) = parts
    return (torch.abs(mean - target_mean) + torch.abs(spread - target_spread)).mean()


def _length(n: int, preset: Preset) -> int:
    """Factor that turns a mean over n numbers into the sum written in the paper."""
    return n if preset.norms == "sums" else 1


def _mean(values: Tensor, scored: Tensor) -> Tensor:
    return values.sum() / scored.sum().clamp(min=1)
