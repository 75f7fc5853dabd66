"""What a system must offer: what it loses, how it reconstructs, how it generates.

A system works on standardised windows, (batch, time, channels). What it may see of them is
`given`: the residual itself in `reconstruct`, an older one in `track`, virtual signals and commands
in `free`, nothing in `generate`. All that is drawn comes from torch's own generator.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from torch import Tensor, nn

from ..data.channels import N_PHASES
from ..preset import Normalise

Numbers = Mapping[str, NDArray[np.float32]]


@dataclass(frozen=True, slots=True)
class SystemPreset:
    """Hyper-parameters: the paper's Table I for all, what else makes a system is in its module.

    Attributes:
        name: As printed.
        units: Of each LSTM.
        code_size: Of the latent and the codes.
        n_codes: Of each codebook.
        normalise: As in `learning.preset.Preset`.
        learning_rate: Of Adam, for all that is trained.
        epochs: Of the training.
        batch: Windows per step.
        window: Samples.
        stride: Between the starts of two windows; None: `window`.
        carry: No state is carried on to the next.
        augment: Nothing is changed at random.
    """

    name: str
    units: int = 64
    code_size: int = 128
    n_codes: int = 512
    normalise: Normalise = "pooled"
    learning_rate: float = 1e-3
    epochs: int = 250
    batch: int = 4
    window: int = 100
    stride: int | None = None
    carry: int = 1
    augment: float = 0.0


@dataclass(frozen=True, slots=True)
class Batch:
    """Windows for one step, shapes (batch, time, ...).

    Attributes:
        given: What may be seen.
        phase: One-hot.
        target: Residuals.
        scored: 1 where a residual was measured and counts, else 0; of the shape of `target`.
        done: Share of the training that is behind, 0..1.
    """

    given: Tensor
    phase: Tensor
    target: Tensor
    scored: Tensor
    done: float


class System(nn.Module, ABC):
    """A network, or several that are trained in turn.

    Args:
        preset: Sizes.
        n_given: Numbers per sample that may be seen.
        n_channels: Of the residual.
    """

    autoencoder: ClassVar[bool] = False
    """Whether it generates by what it learned in `reconstruct`; else it learns to `generate`."""
    sees_ahead: ClassVar[bool] = False
    """Whether what it says of a sample depends on later ones of its window."""
    against: ClassVar[tuple[float, float]] = 0.5, 0.9
    """Memory of Adam where players work against each other (Radford, Metz & Chintala 2016)."""

    def __init__(self, preset: SystemPreset, n_given: int, n_channels: int) -> None:
        super().__init__()
        self.preset, self.n_given, self.n_channels = preset, n_given, n_channels
        self.n_phases = N_PHASES

    def turns(self, done: float) -> tuple[str, ...]:
        """Who is trained on a batch, one after the other."""
        return ("network",)

    def players(self) -> dict[str, nn.Module]:
        """What is trained by an optimiser of its own, by the names of `turns`."""
        return {"network": self}

    @abstractmethod
    def loss(self, player: str, batch: Batch) -> Tensor:
        """What a player is to make small."""

    def after_step(self, player: str) -> None:
        """Called when the player's weights have changed."""
        return

    @abstractmethod
    def reconstruct(self, given: Tensor, phase: Tensor) -> Tensor:
        """Residuals of what is given, shape (batch, time, channels)."""

    def learn_prior(self, given: Tensor, phase: Tensor, begins: NDArray[np.bool_]) -> Numbers:
        """What `generate` draws from, where that is not noise alone.

        Args:
            given: All of the training, one span behind the other, shape (1, n, given).
            phase: One-hot, shape (1, n, phases).
            begins: Where a span begins, shape (n,).
        """
        return {}

    @abstractmethod
    def generate(self, phase: Tensor, prior: Numbers) -> Tensor:
        """Residuals as they might have been, shape (batch, time, channels).

        Args:
            phase: One-hot, shape (batch, time, phases).
            prior: Of `learn_prior`.
        """


def mean_square(error: Tensor, scored: Tensor) -> Tensor:
    """Mean of the squares that count."""
    return (error**2 * scored).sum() / scored.sum().clamp(min=1)


def mean_absolute(error: Tensor, scored: Tensor) -> Tensor:
    """Mean of the absolute values that count."""
    return (error.abs() * scored).sum() / scored.sum().clamp(min=1)
