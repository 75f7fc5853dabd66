"""Codebooks, and the order in which their codes follow each other."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from torch import Tensor, nn

from ..model.network import Quantiser
from ..preset import Preset
from ..training.losses import quantiser_loss

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
