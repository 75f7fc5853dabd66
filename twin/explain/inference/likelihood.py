"""Which numbers a residual asks for: whitened regression, scored on blocks of time left out.

The noise of a channel is an autoregression, fitted to what all numbers together leave
unexplained; residual and regressors pass its inverse, after which samples are as good as
independent. Hypotheses are then scored from sums over blocks of time: each is fitted on all blocks
but one, and gains what it explains of that one beyond `nothing`.

Source: prediction-error method with a noise model, Ljung, System Identification, ch. 7.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...representation import short_repr
from ...residuals.channels import ChannelData
from ..settings import DEFAULT, LikelihoodSettings
from .bounds import Bounds
from .robust_covariance import half_widths

Array = NDArray[np.float64]
Flights = Sequence[Sequence[ChannelData]]
Key = tuple[int, int]
"""Flight and number of the time block in it."""


@dataclass(frozen=True, slots=True)
class Block:
    """Sums over one block of time, of whitened samples in units of their noise.

    Attributes:
        gram: Slopes against slopes, shape (k, k).
        pull: Slopes against residual, shape (k,).
        power: Residual against itself.
    """

    gram: Array
    pull: Array
    power: float

    def __add__(self, other: "Block") -> "Block":
        """Sums over both."""
        return Block(self.gram + other.gram, self.pull + other.pull, self.power + other.power)


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise of one channel in all flights.

    Attributes:
        inverse: Coefficients of the filter that makes it white, [1, a_1, ...].
        size: Standard deviation of what is left then.
        weights: Per flight, of each row, shape (n,).
    """

    inverse: Array
    size: float
    weights: tuple[Array, ...]

    __repr__ = short_repr


def noise_of(
    channels: Sequence[ChannelData],
    unexplained: Sequence[Array],
    order: int,
    settings: LikelihoodSettings = DEFAULT.inference.likelihood,
) -> Noise:
    """Noise of a channel from what is left of it.

    Args:
        channels: The channel of each flight.
        unexplained: Per flight, shape (n,).
        order: Of the autoregression; 0: white.
        settings: Of the noise.
    """
    parts = [
        u[c.piece == k]
        for c, u in zip(channels, unexplained, strict=True)
        for k in np.unique(c.piece)
    ]
    inverse, size = _autoregression(parts, order, settings.roughness)
    weights = []
    for c, u in zip(channels, unexplained, strict=True):
        size_of = np.abs(_whitened(c, u, inverse)) / size
        weights.append(np.sqrt(np.minimum(1.0, settings.huber / np.maximum(size_of, 1e-9))))
    return Noise(inverse, size, tuple(weights))


def _autoregression(parts: Sequence[Array], order: int, roughness: float) -> tuple[Array, float]:
    """Inverse filter and the deviation of the innovation, with some white noise added."""
    long = [r for r in parts if len(r) > 2 * order]
    if order == 0 or not long:
        return np.ones(1), max(float(np.std(np.concatenate(list(parts)))), 1e-12)
    windows = np.vstack([np.lib.stride_tricks.sliding_window_view(r, order + 1) for r in long])
    past, now = windows[:, :-1][:, ::-1], windows[:, -1]
    rough = roughness * float(np.mean(now * now)) + 1e-300
    a = np.linalg.solve(past.T @ past + rough * len(now) * np.eye(order), past.T @ now)
    innovation = now - past @ a
    gain = 1.0 + float(a @ a)
    size = np.sqrt((1.4826 * np.median(np.abs(innovation))) ** 2 + rough * gain)
    return np.concatenate([[1.0], -a]), max(float(size), 1e-12)


def _whitened(channel: ChannelData, values: Array, inverse: Array) -> Array:
    """Inverse filter piece by piece; rows before it has filled are zero."""
    out = np.zeros_like(values)
    if out.size == 0:
        return out
    skip = len(inverse) - 1
    ends = np.flatnonzero(np.diff(channel.piece, append=-1)) + 1
    for first, end in zip([0, *ends[:-1]], ends, strict=True):
        for j, a in enumerate(inverse):
            out[first + skip : end] += a * values[first + skip - j : end - j]
    return out


@dataclass(frozen=True)
class Whitened:
    """Samples of all channels of all flights, white and in units of their noise.

    They are sorted by cells: by block of time, and by channel within it.

    Attributes:
        residual: Shape (n,).
        slopes: Shape (n, k).
        channel: Number of the channel, shape (n,).
        block: Number of the block of time, shape (n,).
        keys: Of the blocks.
        n_channels: How many channels there are.
    """

    residual: Array
    slopes: Array
    channel: NDArray[np.intp]
    block: NDArray[np.intp]
    keys: tuple[Key, ...]
    n_channels: int

    __repr__ = short_repr

    def per_cell(self, values: Array) -> Array:
        """Sums over each channel in each block, shape (blocks, channels, ...)."""
        first, cell = self._cells
        sums = np.zeros((len(self.keys) * self.n_channels, *values.shape[1:]))
        sums[cell] = np.add.reduceat(values, first, axis=0)
        return sums.reshape(len(self.keys), self.n_channels, *values.shape[1:])

    def grams(self) -> Array:
        """Slopes against slopes, of each cell, shape (blocks, channels, k, k)."""
        first, cell = self._cells
        k = self.slopes.shape[1]
        grams = np.zeros((len(self.keys) * self.n_channels, k, k))
        for c, i, j in zip(cell, first, [*first[1:], len(self.residual)], strict=True):
            grams[c] = self.slopes[i:j].T @ self.slopes[i:j]
        return grams.reshape(len(self.keys), self.n_channels, k, k)

    def blocks(self) -> dict[Key, Block]:
        """Sums over blocks of time."""
        pulls = self.per_cell(self.slopes * self.residual[:, None]).sum(axis=1)
        powers = self.per_cell(self.residual**2).sum(axis=1)
        rows = zip(self.keys, self.grams().sum(axis=1), pulls, powers, strict=True)
        return {key: Block(gram, pull, float(power)) for key, gram, pull, power in rows}

    @cached_property
    def _cells(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """First row of each cell that has any, and its number."""
        number = self.block * self.n_channels + self.channel
        cell, first = np.unique(number, return_index=True)
        return first, cell


_FAR = 1 << 32
"""More blocks of time than any flight has."""


def whiten(
    flights: Flights,
    noise: Sequence[Noise],
    settings: LikelihoodSettings = DEFAULT.inference.likelihood,
) -> Whitened:
    """Channels through the inverse of their noise.

    Args:
        flights: Channels of each flight.
        noise: Of each channel.
        settings: Length of the blocks of time.
    """
    residuals, slopes, channels, keys = [], [], [], []
    for f, row in enumerate(flights):
        for i, (c, n) in enumerate(zip(row, noise, strict=True)):
            weight = n.weights[f] / n.size
            residuals.append(_whitened(c, c.residual, n.inverse) * weight)
            slopes.append(_whitened(c, c.slopes, n.inverse) * weight[:, None])
            channels.append(np.full(len(c.t_s), i, dtype=np.intp))
            keys.append(f * _FAR + np.floor(c.t_s / settings.block_s).astype(np.intp))
    known, block = np.unique(np.concatenate(keys), return_inverse=True)
    channel = np.concatenate(channels)
    order = np.lexsort((channel, block))
    return Whitened(
        residual=np.concatenate(residuals)[order],
        slopes=np.concatenate(slopes)[order],
        channel=channel[order],
        block=block[order],
        keys=tuple(divmod(int(k), _FAR) for k in known),
        n_channels=len(noise),
    )


def blocks_of(
    flights: Flights,
    noise: Sequence[Noise],
    settings: LikelihoodSettings = DEFAULT.inference.likelihood,
) -> dict[Key, Block]:
    """Sums over blocks of time, all channels together."""
    return whiten(flights, noise, settings).blocks()


def believed(gains: Array, settings: LikelihoodSettings = DEFAULT.inference.likelihood) -> Array:
    """Log likelihood of each channel, given that no law is exact.

    What a law gets wrong grows with what it explains: a gain counts in full up to `exact`, and by
    its ratio above, as in a posterior that asks for closeness to the data and not for the data:
    Miller & Dunson, J. American Statistical Association 114 (2019).
    """
    exact = settings.exact
    return np.where(gains > 0, exact * np.log1p(np.maximum(gains, 0) / exact), gains)


class Scores:
    """Hypotheses over the same samples: a set of columns may change, the others do not."""

    def __init__(self, rows: Whitened, sd: Array, away: Array | None = None) -> None:
        """Sum over each channel in each block of time.

        Args:
            rows: Samples.
            sd: Standard deviation of the prior of each column, shape (k,).
            away: Present value of each column minus the mean of its prior; default: zero.
        """
        self._pulls = rows.per_cell(rows.slopes * rows.residual[:, None])
        self._grams = rows.grams()
        self._precision = 1.0 / sd**2
        prior_pull = -self._precision * (np.zeros_like(sd) if away is None else away)
        self._gram = self._grams.sum(axis=(0, 1))
        self._pull = self._pulls.sum(axis=(0, 1)) + prior_pull

    def fit(self, columns: Sequence[int]) -> tuple[Array, Array]:
        """Change of the numbers and its covariance, shapes (k,) and (k, k)."""
        c = np.asarray(columns, dtype=np.intp)
        inverse = np.linalg.inv(self._gram[np.ix_(c, c)] + np.diag(self._precision[c]))
        return inverse @ self._pull[c], inverse

    def half_widths(self, columns: Sequence[int]) -> Array:
        """Half of the 95 % interval of each fitted change, shape (k,)."""
        c = np.asarray(columns, dtype=np.intp)
        change, inverse = self.fit(c.tolist())
        grams, pulls = self._of(c)
        return half_widths(inverse, grams, pulls - grams @ change)

    def told(
        self,
        columns: Sequence[int],
        gains: Array,
        settings: LikelihoodSettings = DEFAULT.inference.likelihood,
    ) -> float:
        """How many of some numbers the channels tell, with a law that is not exact.

        A direction in which they may move without changing much of what is explained is free.
        MacKay, Neural Computation 4 (1992): number of well-determined parameters.

        Args:
            columns: The numbers.
            gains: Log likelihood that each channel gains by them, shape (channels,).
            settings: How exact a law is.
        """
        c = np.asarray(columns, dtype=np.intp)
        grams, _ = self._of(c)
        gram = np.einsum("bckl,c->kl", grams, 1 / (1 + np.maximum(gains, 0) / settings.exact))
        return float(np.trace(np.linalg.solve(gram + np.diag(self._precision[c]), gram)))

    def gains(self, columns: Sequence[int], bounds: Bounds) -> Array:
        """Log likelihood over that of no change, each block left out of its fit.

        Args:
            columns: Numbers that may change.
            room: Of their changes.

        Returns:
            Shape (blocks, channels).
        """
        if not len(columns):
            return np.zeros(self._pulls.shape[:2])
        c = np.asarray(columns, dtype=np.intp)
        grams, pulls = self._of(c)
        rest = self._gram[np.ix_(c, c)] - grams.sum(axis=1) + np.diag(self._precision[c])
        inverse = np.linalg.inv(rest)
        theta = np.einsum("bkl,bl->bk", inverse, self._pull[c] - pulls.sum(axis=1))
        theta = bounds.inside(theta, inverse)
        bent = np.einsum("bckl,bl->bck", grams, theta)
        return np.asarray(np.einsum("bck,bk->bc", pulls - 0.5 * bent, theta))

    def _of(self, columns: NDArray[np.intp]) -> tuple[Array, Array]:
        """Sums of some columns."""
        return self._grams[:, :, columns[:, None], columns], self._pulls[:, :, columns]


def noise_of_all(
    flights: Flights, sd: Array, settings: LikelihoodSettings = DEFAULT.inference.likelihood
) -> list[Noise]:
    """Noise of every channel, from what all numbers together leave unexplained.

    The first fit takes the noise for white: an autoregression would take an offset for a walk.

    Args:
        flights: Channels of each flight; all have the same channels in the same order.
        sd: Prior deviations of the numbers, shape (k,).
        settings: Of the noise.
    """
    by_channel = list(zip(*flights, strict=True))
    unexplained = [[c.residual for c in channels] for channels in by_channel]
    order = 0
    for _ in range(settings.rounds + 1):
        noise = [
            noise_of(c, u, order, settings) for c, u in zip(by_channel, unexplained, strict=True)
        ]
        change, _ = Scores(whiten(flights, noise, settings), sd).fit(range(len(sd)))
        unexplained = [[c.residual - c.slopes @ change for c in ch] for ch in by_channel]
        order = settings.order
    return [noise_of(c, u, order, settings) for c, u in zip(by_channel, unexplained, strict=True)]
