"""VQVAE: one codebook for all channels, the nearest code, gradients passed straight through.

Source: van den Oord, Vinyals & Kavukcuoglu, Neural Discrete Representation Learning, 2017;
commitment 0.25. It generates from a first-order Markov chain over the codes of each phase. With
soft assignment, in the systems built on it, the chain is that of the nearest codes, and what is
decoded is the mixture that a sample of the training was told by: the decoder knows no code alone.
"""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..blocks.codebook import Codebook, chain_of, drawn_chain
from ..blocks.recurrent import Recurrent
from ..training.system_family import SystemFamily
from .system import Batch, Numbers, System, SystemPreset, mean_square


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
        """Decoded from a chain drawn anew."""
        rng = np.random.default_rng(int(torch.randint(2**31, ())))
        drawn = np.stack([drawn_chain(prior, p.cpu().numpy(), rng) for p in phase.argmax(-1)])
        if self.soft:
            code = torch.from_numpy(prior["told"][drawn])
        else:
            code = self.codebook.codes(torch.from_numpy(prior["codes"][drawn].astype(np.intp)))
        said: Tensor = self.decoder(code.to(phase.device), phase)
        return said


class VqVaeFamily(SystemFamily):
    """For the registry."""

    system, preset = VqVae, SystemPreset("vqvae")
