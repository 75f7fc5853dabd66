"""VQWWVAE: VQVAE with a Wasserstein distance per channel in its loss.

No public code or text was found: after the one-line description. The distance of two samples of
one dimension is the mean distance of their ordered values.
"""

from torch import Tensor

from ..training.system_family import SystemFamily
from .system import Batch, SystemPreset, mean_absolute, mean_square
from .vqvae import VqVae


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


class VqwwVaeFamily(SystemFamily):
    """For the registry."""

    system, preset = VqwwVae, SystemPreset("vqwwvae")
