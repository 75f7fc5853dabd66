"""Whitening of residuals: the noise of a channel as an autoregressive (AR) model of its residual.

Residual and regressors are filtered by its inverse, after which samples are nearly independent;
sums over time blocks then give the out-of-sample gain of an equation.

Source: prediction-error method with a noise model, Ljung, System Identification, ch. 7.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...representation import ShortRepr
from ...residuals.channels import Array, ChannelData
from ..model.model import Model
from ..settings import DEFAULT, LikelihoodSettings
from .noise import rounding_variance
from .spectrum import Flights

Key = tuple[int, int]
"""Flight and index of the time block in it."""


@dataclass(frozen=True, slots=True)
class Block:
    """Sums over one time block of whitened, normalised samples: slopes with slopes, shape (k, k),
    slopes with residual, shape (k,), residual with itself."""

    gram: Array
    pull: Array
    power: float

    def __add__(self, other: "Block") -> "Block":
        """Sum of both."""
        return Block(self.gram + other.gram, self.pull + other.pull, self.power + other.power)


@dataclass(frozen=True, slots=True)
class Autoregression(ShortRepr):
    """AR noise model of one channel in all flights.

    Attributes:
        inverse: Coefficients of the whitening filter, [1, a_1, ...].
        size: Standard deviation of the innovation.
        weights: Weights of the rows of each flight, shape (n,).
    """

    inverse: Array
    size: float
    weights: tuple[Array, ...]


def autoregression_of(
    channels: Sequence[ChannelData],
    unexplained: Sequence[Array],
    order: int,
    settings: LikelihoodSettings = DEFAULT.inference.likelihood,
) -> Autoregression:
    """AR noise model of a channel from its residual, with some white noise added: a share of the
    power, and the rounding variance.

    Args:
        channels: The channel in each flight.
        unexplained: Residual of each flight, shape (n,).
        order: Order of the AR model; 0: white.
        settings: Settings of the noise.
    """
    parts = [
        u[c.piece == k]
        for c, u in zip(channels, unexplained, strict=True)
        for k in np.unique(c.piece)
    ]
    rounding = float(np.mean(rounding_variance(channels[0].name)[1:]))
    long = [r for r in parts if len(r) > 2 * order]
    if order == 0 or not long:
        inverse, size = np.ones(1), float(np.sqrt(np.var(np.concatenate(parts)) + rounding))
    else:
        windows = np.vstack([np.lib.stride_tricks.sliding_window_view(r, order + 1) for r in long])
        past, now = windows[:, :-1][:, ::-1], windows[:, -1]
        rough = settings.roughness * float(np.mean(now * now)) + rounding
        a = np.linalg.solve(past.T @ past + rough * len(now) * np.eye(order), past.T @ now)
        inverse, middle = np.concatenate([[1.0], -a]), np.median(np.abs(now - past @ a))
        size = float(np.sqrt((1.4826 * middle) ** 2 + rough * (1.0 + float(a @ a))))
    weights = []
    for c, u in zip(channels, unexplained, strict=True):
        size_of = np.abs(_whitened(c, u, inverse)) / size
        weights.append(np.sqrt(np.minimum(1.0, settings.huber / np.maximum(size_of, 1e-9))))
    return Autoregression(inverse, size, tuple(weights))


def _whitened(channel: ChannelData, values: Array, inverse: Array) -> Array:
    """Values whitened piece by piece; zero until the filter has filled."""
    out = np.zeros_like(values)
    if out.size == 0:
        return out
    skip = len(inverse) - 1
    ends = np.flatnonzero(np.diff(channel.piece, append=-1)) + 1
    for first, end in zip([0, *ends[:-1]], ends, strict=True):
        filled = min(first + skip, end)  # a piece may be shorter than the filter
        for j, a in enumerate(inverse):
            out[filled:end] += a * values[filled - j : end - j]
    return out


_FAR = 1 << 32
"""More time blocks than any flight has."""


def blocks_of(
    flights: Flights,
    noise: Sequence[Autoregression],
    settings: LikelihoodSettings = DEFAULT.inference.likelihood,
) -> dict[Key, Block]:
    """Sums over time blocks, all channels together.

    Args:
        flights: Channels of each flight.
        noise: Noise model of each channel.
        settings: Length of the time blocks.
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
class WhitenedFlights(ShortRepr):
    """Flights whitened by an AR model of their residual.

    Attributes:
        model: Predictions of the flights.
        noise: Noise model of each channel.
        settings: Settings of the noise.
    """

    model: Model
    noise: tuple[Autoregression, ...]
    settings: LikelihoodSettings

    @classmethod
    def of(
        cls,
        model: Model,
        values: Mapping[str, float],
        settings: LikelihoodSettings = DEFAULT.inference.likelihood,
    ) -> "WhitenedFlights":
        """Flights whitened by the residual noise at some numbers, "effect.number" -> value."""
        left = model.channels([], values)
        noise = (
            autoregression_of(
                own, [c.residual - c.residual.mean() for c in own], settings.order, settings
            )
            for own in zip(*left, strict=True)
        )
        return cls(model, tuple(noise), settings)
