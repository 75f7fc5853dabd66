"""Linear prediction under the network, in closed form, and what validation time says of either.

The network learns only what this leaves; either is used only as far as it helps.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .channels import CHANNELS
from .preset import Protocol
from .sequences import SpanSequence

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]
Pair = tuple[Array, Array]

RIDGES = (1e-6, 1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0)
"""Tried strengths, per sample; the weights' unit is one, since everything is standardised."""
BLOCK_S = 1.0
"""Residuals a second apart count as independent evidence."""
EVIDENCE = 1.5
"""Gain per block over its standard error, below which it is taken for chance."""


def choose_ridges(
    spans: Sequence[SpanSequence],
    train: Sequence[BoolArray],
    validate: Sequence[BoolArray],
    protocol: Protocol,
    rate_hz: float,
) -> Array:
    """Strength of the ridge per channel, shape (15,); infinite where nothing plainly helps.

    Args:
        spans: All training flights.
        train: Per span the samples to fit, shape (n, 15).
        validate: Per span the samples that choose, shape (n, 15).
        protocol: Decides the regressors.
        rate_hz: Samples per second.
    """
    blocks = time_blocks(spans, rate_hz)
    ridges = []
    for c in range(len(CHANNELS)):
        x, target = _channel(spans, protocol, c)
        fit, look = (np.concatenate([m[:, c] for m in rows]) for rows in (train, validate))
        ridges.append(_best_ridge(x, target, fit, look, blocks[look]))
    return np.array(ridges)


def fit_base(
    spans: Sequence[SpanSequence], rows: Sequence[BoolArray], protocol: Protocol, ridges: Array
) -> Array:
    """Weights of the linear prediction per channel.

    `track`: autoregression straight to the horizon, sum of weights times `lags` of the channel.
    `free`: weights times [features, slow features]. `reconstruct`: none.

    Args:
        spans: All training flights.
        rows: Per span the samples to fit, shape (n, 15).
        protocol: Decides the regressors.
        ridges: As from `choose_ridges`, shape (15,).

    Returns:
        Shape (15, regressors).
    """
    weights = []
    for c, ridge in enumerate(ridges):
        x, target = _channel(spans, protocol, c)
        chosen = np.concatenate([m[:, c] for m in rows])
        weights.append(_ridge(x[chosen], target[chosen], float(ridge)))
    return np.array(weights)


def predict_base(span: SpanSequence, weights: Array, protocol: Protocol) -> Array:
    """Linear prediction over a span, shape (n, 15)."""
    columns = [regressors(span, protocol, c) @ w for c, w in enumerate(weights)]
    return np.stack(columns, axis=-1)


def regressors(span: SpanSequence, protocol: Protocol, channel: int) -> Array:
    """What the linear prediction of a channel is made from, shape (n, regressors)."""
    if protocol == "track":
        return span.lags[:, channel]
    if protocol == "free":
        return np.hstack([span.features, span.slow])
    return np.zeros((len(span.d), 0))


def gates(y: Array, left: Array, scored: BoolArray, blocks: IntArray) -> Array:
    """Share of the network's output, 0..1, that leaves the smallest square error, per channel.

    Zero where the gain could be chance.

    Args:
        y: Output of the network, shape (n, 15).
        left: What the linear prediction leaves, shape (n, 15).
        scored: Samples that count, shape (n, 15); a channel without any gets 0.
        blocks: As from `time_blocks`, shape (n,).

    Returns:
        Shape (15,).
    """
    power = np.sum(y**2, axis=0, where=scored)
    together = np.sum(y * left, axis=0, where=scored)
    share = np.divide(together, power, out=np.zeros_like(power), where=power > 0)
    share = np.clip(share, 0.0, 1.0)
    gain = np.where(scored, left**2 - (left - share * y) ** 2, 0.0)
    rows = zip(gain.T, scored.T, strict=True)
    helps = [evidence(g[m], blocks[m]) >= EVIDENCE for g, m in rows]
    return np.where(helps, share, 0.0)


def time_blocks(spans: Sequence[SpanSequence], rate_hz: float) -> IntArray:
    """Number of the second in which each sample lies, counted over all spans, shape (n,)."""
    numbers, first = [], 0
    for span in spans:
        number = (np.arange(len(span.d)) / (BLOCK_S * rate_hz)).astype(np.intp)
        numbers.append(first + number)
        first += int(number[-1]) + 1
    return np.concatenate(numbers)


def evidence(gain: Array, blocks: IntArray) -> float:
    """Mean gain per block over its standard error; 0 with fewer than three blocks.

    Args:
        gain: Decrease of the square error per sample, shape (n,).
        blocks: To which each sample belongs, shape (n,).
    """
    _, place = np.unique(blocks, return_inverse=True)
    per_block = np.bincount(place, gain)
    if len(per_block) < 3:
        return 0.0
    error = float(per_block.std(ddof=1)) / len(per_block) ** 0.5
    return float(per_block.mean()) / error if error > 0 else 0.0


def _channel(spans: Sequence[SpanSequence], protocol: Protocol, channel: int) -> Pair:
    """Regressors and target of a channel over all spans."""
    x = np.concatenate([regressors(s, protocol, channel) for s in spans])
    return x, np.concatenate([s.d[:, channel] for s in spans])


def _ridge(x: Array, target: Array, ridge: float) -> Array:
    if not len(x) or not np.isfinite(ridge):
        return np.zeros(x.shape[1])
    gram, moment = x.T @ x / len(x), x.T @ target / len(x)
    return np.asarray(np.linalg.solve(gram + ridge * np.eye(len(gram)), moment))


def _best_ridge(
    x: Array, target: Array, train: BoolArray, validate: BoolArray, blocks: IntArray
) -> float:
    """The strength that does best on the validation samples; blocks of these."""
    if not train.any() or not validate.any() or not x.shape[1]:
        return np.inf
    before = target[validate] ** 2
    gains = []
    for ridge in RIDGES:
        weights = _ridge(x[train], target[train], ridge)
        gains.append(before - (target[validate] - x[validate] @ weights) ** 2)
    best = int(np.argmax([gain.sum() for gain in gains]))
    return RIDGES[best] if evidence(gains[best], blocks) >= EVIDENCE else np.inf
