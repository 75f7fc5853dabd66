"""Sequences in, sequences out, nothing seen before its time."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn


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
