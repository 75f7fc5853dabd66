"""Linear prediction in closed form, alone or under the network.

The network learns only the residual of the linear prediction; each is used only as far as it
reduces the error.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..data.envelope import BEYOND
from ..data.flights import ResidualFlight
from ..data.scaling import Scaling, fit_scaling, in_spans
from ..data.sequences import LAGS, OF_THE_DAY, SpanSequence, sequences
from ..preset import Normalise, Protocol

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

RIDGES = (1e-6, 1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0, 1e3)
"""Ridge parameters that are tried, per sample; weights are dimensionless, since everything is
standardised. The largest one leaves a trivial rule unchanged."""
MOST_FOLDS = 8
"""Maximum number of cross-validation folds."""
BLOCK_S = 1.0
"""Time after which residuals count as independent, s."""
MOST_BLOCKS = 1_000_000
"""Maximum number of blocks of one flight."""
EVIDENCE = 1.5
"""Gain per block over its standard error below which it may be chance."""


def fit_base(
    spans: Sequence[SpanSequence],
    scored: Sequence[BoolArray],
    protocol: Protocol,
    rate_hz: float,
) -> Array:
    """Weights of the linear prediction per channel; those of a trivial rule where nothing is
    clearly better.

    Regressors in `track`: [`lags` about `offset`, `change`] of each channel, an autoregression
    directly to the horizon with an observer of its offset; or [`own`, features, slow features]; or
    both. In `free`: the latter, for the sensors of `OF_THE_DAY` minus their running means. In
    `reconstruct`: none. The ridge pulls the weights towards those of a trivial rule: that the
    residual is zero (in `track`: its last value, or its mean so far), or that the sensor reads its
    mean (in `track`: its last value, or its mean so far), whatever the twin predicts. Rule,
    regressors and ridge are selected, and their gain evaluated, by cross-validation over flights,
    or over time spans of a single flight. Readings of a twin that follows the motion count as much
    as those in open loop, whose residual is larger.

    Args:
        spans: Spans of all training flights.
        scored: Samples that count in each span, shape (n, 15).
        protocol: Protocol, which determines the regressors.
        rate_hz: Sample rate, Hz.

    Returns:
        Weights from all data, shape (15, regressors).
    """
    blocks, folds = time_blocks(spans, rate_hz), _folds(spans)
    targets = to_learn(spans, scored, protocol)
    weights = []
    for c in range(spans[0].d.shape[1]):
        x = np.concatenate([regressors(s, protocol, c) for s in spans])
        target = np.concatenate([d[:, c] for d in targets])
        counts = np.concatenate([m[:, c] for m in scored])
        weight = _equalised(target, counts, np.concatenate([s.alone for s in spans]))
        x, target = x * weight[:, None], target * weight
        tried = _tried(protocol, x.shape[1])
        weights.append(_channel(x, target, counts, folds, blocks, tried))
    return np.array(weights)


def to_learn(
    spans: Sequence[SpanSequence], scored: Sequence[BoolArray], protocol: Protocol
) -> list[Array]:
    """Target of each span, shape (n, 15): the residual; in `free`, for the sensors of `OF_THE_DAY`,
    minus its mean over the flight where the twin follows.

    Args:
        spans: Spans of flights.
        scored: Samples that count in each span, shape (n, 15).
        protocol: Protocol, as of `fit_base`.
    """
    if protocol != "free":
        return [s.d for s in spans]
    means = {}
    for flight in {s.flight for s in spans}:
        own = [(s, m) for s, m in zip(spans, scored, strict=True) if s.flight == flight]
        d, counts = (
            np.concatenate(parts) for parts in zip(*[(s.d, m) for s, m in own], strict=True)
        )
        alone = np.concatenate([s.alone for s, _ in own])
        counts = counts & (~alone | alone.all())[:, None]
        mean = np.sum(d, axis=0, where=counts) / np.maximum(counts.sum(axis=0), 1)
        means[flight] = np.where(OF_THE_DAY, mean, 0.0)
    return [s.d - means[s.flight] for s in spans]


def _equalised(target: Array, scored: BoolArray, alone: BoolArray) -> Array:
    """Weight of each sample by which following and open-loop samples have equal mean squares, shape
    (n,)."""
    if not alone.any():
        return np.ones(len(target))
    modes = [scored & mode for mode in (alone, ~alone)]
    sizes = [float(np.sqrt(np.mean(target[m] ** 2))) if m.any() else 0.0 for m in modes]
    return np.asarray(1 / np.where(alone, *[s if s > 0 else 1.0 for s in sizes]))


def predict_base(span: SpanSequence, weights: Array, protocol: Protocol, largest: Array) -> Array:
    """Linear prediction over a span, limited by `bounded`, shape (n, 15).

    Args:
        span: Span of a flight.
        weights: Weights, as of `fit_base`.
        protocol: Protocol, which determines the regressors.
        largest: Largest residuals, as of `Scaling`, shape (15,).
    """
    columns = [regressors(span, protocol, c) @ w for c, w in enumerate(weights)]
    return np.asarray(bounded(np.stack(columns, axis=-1), span.offset[..., 0], largest))


def bounded(prediction: Array, offset: Array, largest: Array) -> Array:
    """Limit a prediction to a distance of `BEYOND` times the largest training residual from an
    offset.

    This bounds the error in flights outside the training envelope.

    Args:
        prediction: Prediction, shape (n, 15).
        offset: Running mean of the known residual, shape (n, 15); 0 except in `track`.
        largest: Largest residuals, as of `Scaling`, shape (15,).
    """
    return np.asarray(offset + (prediction - offset).clip(-BEYOND * largest, BEYOND * largest))


def regressors(span: SpanSequence, protocol: Protocol, channel: int) -> Array:
    """Regressors of the linear prediction of a channel, shape (n, regressors)."""
    if protocol == "track":
        offset = span.offset[:, channel]
        about = span.lags[:, channel] - offset[:, :1]
        now = (span.change[:, channel, None], span.own[:, channel, None])
        return np.hstack([about, offset, *now, span.features, span.slow])
    if protocol == "free" and OF_THE_DAY[channel]:
        n = len(OF_THE_DAY)
        return np.hstack([span.beyond[:, channel, None], span.beyond[:, n:]])
    if protocol == "free":
        return np.hstack([span.own[:, channel, None], span.features, span.slow])
    return np.zeros((len(span.d), 0))


def gates(y: Array, left: Array, scored: BoolArray, blocks: IntArray) -> Array:
    """Gate of each channel, 0..1: the share of the network's output with the least square error.

    Zero where the gain could be chance.

    Args:
        y: Output of the network, shape (n, 15).
        left: Residual of the linear prediction, shape (n, 15).
        scored: Samples that count, shape (n, 15); a channel without any gets 0.
        blocks: Block of each sample, as of `time_blocks`, shape (n,).

    Returns:
        Gates, shape (15,).
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
    """Block (second) of each sample, numbered over all spans, shape (n,)."""
    numbers, first = [], 0
    for span in spans:
        number = (np.arange(len(span.d)) / (BLOCK_S * rate_hz)).astype(np.intp)
        if span.alone.any():  # several passes over the same time
            numbers.append(MOST_BLOCKS * (1 + span.flight) + number)
            continue
        numbers.append(first + number)
        first += int(number[-1]) + 1
    return np.concatenate(numbers)


def evidence(gain: Array, blocks: IntArray) -> float:
    """Mean gain per block over its standard error; 0 with fewer than three blocks.

    Args:
        gain: Decrease of the square error per sample, shape (n,).
        blocks: Block of each sample, shape (n,).
    """
    _, place = np.unique(blocks, return_inverse=True)
    per_block = np.bincount(place, gain)
    if len(per_block) < 3:
        return 0.0
    error = float(per_block.std(ddof=1)) / len(per_block) ** 0.5
    return float(per_block.mean()) / error if error > 0 else 0.0


def _folds(spans: Sequence[SpanSequence]) -> IntArray:
    """Cross-validation fold of each sample, shape (n,)."""
    flights = np.concatenate([np.full(len(s.d), s.flight) for s in spans])
    if flights.min() < flights.max():
        return np.asarray(flights % MOST_FOLDS, dtype=np.intp)
    if any(s.alone.any() for s in spans):  # several passes over the same time
        parts = [np.arange(len(s.d)) * MOST_FOLDS // len(s.d) for s in spans]
        return np.concatenate(parts).astype(np.intp)
    return np.arange(len(flights), dtype=np.intp) * MOST_FOLDS // len(flights)


def _tried(protocol: Protocol, n: int) -> list[tuple[Array, IntArray]]:
    """Candidates: weights of trivial rules, and regressors that may be added to them, the fewest
    first.

    The first rule is used where nothing is clearly better. All rules of `track` follow the offset
    of the current flight: flights with one offset do not determine that of another day.
    """
    every = np.arange(n)
    if protocol != "track":
        rules = [np.zeros(n), -np.eye(1, n)[0]] if n else []
        return [(rule, every) for rule in rules]
    past, now = every[[*range(LAGS), LAGS + 2]], every[LAGS + 3 :]
    about, offset, reading, change, own = np.eye(n)[[0, *range(LAGS, LAGS + 4)]]
    last, mean_reading = offset + about, reading - own
    of_past, of_now = [offset, last, last + change], [offset, mean_reading]
    return [
        *((rule, past) for rule in of_past),
        *((rule, now) for rule in of_now),
        *((rule, np.concatenate([past, now])) for rule in (*of_past, mean_reading)),
    ]


def _channel(
    x: Array,
    target: Array,
    scored: BoolArray,
    folds: IntArray,
    blocks: IntArray,
    tried: Sequence[tuple[Array, IntArray]],
) -> Array:
    """Weights from all data, with the rule, regressors and ridge that are best in
    cross-validation."""
    if not scored.any():
        return np.zeros(x.shape[1])
    found, most = tried[0][0].copy() if tried else np.zeros(x.shape[1]), 0.0
    plain = x @ found
    for rule, columns in tried:
        weights, gain = _chosen(x[:, columns], target, x @ rule, plain, scored, folds, blocks)
        if gain > most:
            found, most = rule.copy(), gain
            found[columns] += weights
    return found


def _chosen(
    x: Array,
    target: Array,
    ruled: Array,
    plain: Array,
    scored: BoolArray,
    folds: IntArray,
    blocks: IntArray,
) -> tuple[Array, float]:
    """Weights that the best ridge adds to a rule, and the square error that both save against the
    first rule.

    None where the saving could be chance.

    Args:
        x: Regressors, shape (n, k).
        target: Target, shape (n,).
        ruled: Prediction of the rule, shape (n,).
        plain: Prediction of the first rule, shape (n,).
        scored: Samples that count, shape (n,).
        folds: Fold of each sample, shape (n,).
        blocks: Block of each sample, as of `time_blocks`, shape (n,).
    """
    left = target - ruled
    parts = [scored & (folds == k) for k in np.unique(folds)]
    grams = np.array([x[p].T @ x[p] for p in parts])  # (folds, regressors, regressors)
    moments = np.array([x[p].T @ left[p] for p in parts])
    counts = np.array([p.sum() for p in parts])
    gram, moment, count = grams.sum(0), moments.sum(0), int(counts.sum())
    said = np.tile(ruled, (len(RIDGES), 1))
    for k, fold in enumerate(np.unique(folds)):
        here, others = folds == fold, count - int(counts[k])
        for prediction, ridge in zip(said, RIDGES, strict=True):
            weights = _ridge(gram - grams[k], moment - moments[k], others, ridge)
            prediction[here] += x[here] @ weights
    gains = (target - plain) ** 2 - (target - said) ** 2  # (ridges, n)
    best = _strongest(gains[:, scored], blocks[scored])
    if evidence(gains[best, scored], blocks[scored]) < EVIDENCE:
        return np.zeros(x.shape[1]), 0.0
    return _ridge(gram, moment, count, RIDGES[best]), float(gains[best, scored].sum())


def _strongest(gains: Array, blocks: IntArray) -> int:
    """The strongest ridge whose gain is within one standard error of the best.

    Args:
        gains: Decrease of the square error, by ridge, shape (ridges, n).
        blocks: Block of each sample, shape (n,).

    Source: the one-standard-error rule, Breiman et al., Classification and Regression Trees, 1984,
    sec. 3.4.3.
    """
    best = int(np.argmax(gains.sum(1)))
    worse = gains[best] - gains
    within = [i for i, w in enumerate(worse) if i == best or evidence(w, blocks) < 1]
    return max(within)


def _ridge(gram: Array, moment: Array, count: int, ridge: float) -> Array:
    """Ridge regression weights from sums over `count` samples; zero without samples."""
    if count < 1:
        return np.zeros(len(moment))
    return np.asarray(np.linalg.solve(gram / count + ridge * np.eye(len(gram)), moment / count))


def scaling_for(
    flights: Sequence[ResidualFlight], normalise: Normalise, protocol: Protocol
) -> Scaling:
    """Scaling of a training under a protocol."""
    scaling = fit_scaling(flights, [in_spans(f) for f in flights], normalise)
    return scaling.without_offsets(OF_THE_DAY) if protocol == "free" else scaling


def left_out_errors(
    flights: Sequence[ResidualFlight],
    normalise: Normalise,
    protocol: Protocol,
    horizon: int,
    scaling: Scaling,
) -> list[Array]:
    """Errors in every span with a prediction and a scaling fitted to the other flights.

    Errors on the fitted samples themselves give a spread that is too small for others: on RflySimDT
    two such spreads contained 56 to 93 % of a flight left out, instead of 95 %.

    Args:
        flights: Two or more flights.
        normalise: Normalisation of the residuals.
        protocol: Protocol, which determines the regressors.
        horizon: Age of the newest residual, samples, in `track`; otherwise 0.
        scaling: Scaling of the returned errors.

    Returns:
        Errors in the spans of all flights, in order, shape (n, 15); NaN outside the envelope of the
        others, where their model would correct nothing.
    """
    errors = []
    for one in flights:
        others = [f for f in flights if f is not one]
        theirs = scaling_for(others, normalise, protocol)
        seen = sequences(others, theirs, protocol, horizon)
        base = fit_base(seen, [s.fresh for s in seen], protocol, one.rate_hz)
        for span in sequences([one], theirs, protocol, horizon):
            left = span.d - predict_base(span, base, protocol, theirs.largest)
            error = left * theirs.scale[span.phase] / scaling.scale[span.phase]
            errors.append(np.where(span.inside[:, None], error, np.nan))
    return errors
