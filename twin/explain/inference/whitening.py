"""Residuals made white: the noise of a channel as an autoregression of what a model leaves.

Residual and regressors pass its inverse, after which samples are as good as independent; sums over
blocks of time then say what an equation gains on time that it was not fitted on.

Source: prediction-error method with a noise model, Ljung, System Identification, ch. 7.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...representation import short_repr
from ...residuals.channels import Array, ChannelData
from ..model.model import Model
from ..settings import DEFAULT, LikelihoodSettings
from .noise import rounding_variance

Flights = Sequence[Sequence[ChannelData]]
Key = tuple[int, int]
"""Flight and number of the time block in it."""


@dataclass(frozen=True, slots=True)
class Block:
    """Sums over one block of time, of whitened samples in units of their noise: slopes against
    slopes, shape (k, k), slopes against residual, shape (k,), residual against itself."""

    gram: Array
    pull: Array
    power: float

    def __add__(self, other: "Block") -> "Block":
        """Sums over both."""
        return Block(self.gram + other.gram, self.pull + other.pull, self.power + other.power)


@dataclass(frozen=True, slots=True)
class Autoregression:
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


def autoregression_of(
    channels: Sequence[ChannelData],
    unexplained: Sequence[Array],
    order: int,
    settings: LikelihoodSettings = DEFAULT.inference.likelihood,
) -> Autoregression:
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
    rounding = float(np.mean(rounding_variance(channels[0].name)[1:]))
    inverse, size = _autoregression(parts, order, settings.roughness, rounding)
    weights = []
    for c, u in zip(channels, unexplained, strict=True):
        size_of = np.abs(_whitened(c, u, inverse)) / size
        weights.append(np.sqrt(np.minimum(1.0, settings.huber / np.maximum(size_of, 1e-9))))
    return Autoregression(inverse, size, tuple(weights))


def _autoregression(
    parts: Sequence[Array], order: int, roughness: float, rounding: float
) -> tuple[Array, float]:
    """Inverse filter and the deviation of the innovation, with some white noise added: a share of
    the power, and the variance of rounding to the least count."""
    long = [r for r in parts if len(r) > 2 * order]
    if order == 0 or not long:
        return np.ones(1), float(np.sqrt(np.var(np.concatenate(list(parts))) + rounding))
    windows = np.vstack([np.lib.stride_tricks.sliding_window_view(r, order + 1) for r in long])
    past, now = windows[:, :-1][:, ::-1], windows[:, -1]
    rough = roughness * float(np.mean(now * now)) + rounding
    a = np.linalg.solve(past.T @ past + rough * len(now) * np.eye(order), past.T @ now)
    innovation = now - past @ a
    gain = 1.0 + float(a @ a)
    size = np.sqrt((1.4826 * np.median(np.abs(innovation))) ** 2 + rough * gain)
    return np.concatenate([[1.0], -a]), float(size)


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


_FAR = 1 << 32
"""More blocks of time than any flight has."""


def blocks_of(
    flights: Flights,
    noise: Sequence[Autoregression],
    settings: LikelihoodSettings = DEFAULT.inference.likelihood,
) -> dict[Key, Block]:
    """Sums over blocks of time, all channels together.

    Args:
        flights: Channels of each flight.
        noise: Of each channel.
        settings: Length of the blocks of time.
    """
    residuals, slopes, keys = [], [], []
    for f, row in enumerate(flights):
        for c, n in zip(row, noise, strict=True):
            weight = n.weights[f] / n.size
            residuals.append(_whitened(c, c.residual, n.inverse) * weight)
            slopes.append(_whitened(c, c.slopes, n.inverse) * weight[:, None])
            keys.append(f * _FAR + np.floor(c.t_s / settings.block_s).astype(np.intp))
    number = np.concatenate(keys)
    order = np.argsort(number, kind="stable")
    y, x = np.concatenate(residuals)[order], np.concatenate(slopes)[order]
    known, first = np.unique(number[order], return_index=True)
    found = {}
    for key, a, b in zip(known, np.split(x, first[1:]), np.split(y, first[1:]), strict=True):
        found[divmod(int(key), _FAR)] = Block(a.T @ a, a.T @ b, float(b @ b))
    return found


@dataclass(frozen=True, slots=True)
class WhitenedFlights:
    """Flights with the noise that is left of them.

    Attributes:
        model: Flights.
        noise: Of each channel.
        settings: Of the noise.
    """

    model: Model
    noise: tuple[Autoregression, ...]
    settings: LikelihoodSettings

    __repr__ = short_repr

    @classmethod
    def of(
        cls,
        model: Model,
        values: Mapping[str, float],
        settings: LikelihoodSettings = DEFAULT.inference.likelihood,
    ) -> "WhitenedFlights":
        """The noise that the model leaves with some numbers, "effect.number" -> value."""
        left = model.channels([], values)
        noise = (
            autoregression_of(
                own, [c.residual - c.residual.mean() for c in own], settings.order, settings
            )
            for own in zip(*left, strict=True)
        )
        return cls(model, tuple(noise), settings)
