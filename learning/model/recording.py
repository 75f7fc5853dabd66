"""Residuals of a training flight played back: how alike two real flights are, and no more."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..data.channels import N_PHASES
from ..data.flights import ResidualFlight
from .baselines import by_phase, phase_means
from .corrected import Corrected

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Recording:
    """Plays pieces of training flights in the same phase.

    Attributes:
        mean: Of the residual by phase, shape (phases, 15); said where no flight had the phase.
        scale: Spread about it, shape (phases, 15).
        pieces: By phase, the residual of each training flight in it, shape (n_i, 15).
        seed: Of which piece is played, and from where.
    """

    mean: Array
    scale: Array
    pieces: tuple[tuple[Array, ...], ...]
    seed: int = 0

    def with_seed(self, seed: int) -> "Recording":
        """The same recordings, played from elsewhere."""
        return replace(self, seed=seed)

    def run(self, flight: ResidualFlight) -> Corrected:
        """Each stretch of one phase from a piece drawn anew, begun again where it ends."""
        rng = np.random.default_rng([self.seed, zlib.crc32(flight.name.encode())])
        correction = self.mean[flight.phase]
        for a, b in flight.spans:
            edges = a + 1 + np.flatnonzero(np.diff(flight.phase[a:b]))
            for rows in np.split(np.arange(a, b), edges - a):
                pieces = self.pieces[flight.phase[rows[0]]]
                if pieces:
                    piece = pieces[int(rng.integers(len(pieces)))]
                    start = int(rng.integers(len(piece)))
                    correction[rows] = piece[(start + np.arange(len(rows))) % len(piece)]
        n = len(flight.t_s)
        return Corrected(
            correction, self.scale[flight.phase], np.full(n, np.nan), np.ones(n, dtype=np.bool_)
        )


def fit_recording(train: Sequence[ResidualFlight]) -> Recording:
    """Cut training flights into phases."""
    mean = phase_means(train)
    scale = np.sqrt(by_phase(train, [(f.residual - mean[f.phase]) ** 2 for f in train]))
    pieces: list[list[Array]] = [[] for _ in range(N_PHASES)]
    for flight in train:
        rows = np.concatenate([np.arange(a, b) for a, b in flight.spans])
        residual = np.where(np.isfinite(flight.residual), flight.residual, mean[flight.phase])[rows]
        for p in range(N_PHASES):
            part = residual[flight.phase[rows] == p]
            if len(part):
                pieces[p].append(part)
    return Recording(mean, scale, tuple(tuple(p) for p in pieces))
