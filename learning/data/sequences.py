"""Flights as standardised sequences: inputs and targets of the compensator.

One definition for training and evaluation; `learning.export.streaming` implements the same sample
by sample.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from twin.errors import ModelError

from ..preset import Protocol
from .channels import CHANNELS, N_PHASES
from .flights import ResidualFlight, held
from .scaling import Scaling, features_of, places_of, standardised

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

OF_THE_DAY = np.array([c.startswith(("acc", "mag")) for c in CHANNELS])
"""Sensors whose offset differs between days, shape (15,): in `free`, without measurements, the
offset of the training flights does not predict that of the next one, so only the deviation from a
running mean is corrected. A gyroscope is zeroed before each flight."""
LAGS = 8
"""Number of past residuals in the linear prediction of `track`."""
SMOOTHING_S = (0.1, 0.5)
"""Time constants of the low-passed copies of the features, s."""
OFFSET_S, OFFSET_PRIOR_S = 30.0, 1.0
"""Memory of the running means of the known residual and reading, s, which estimate a sensor's
current offset, and weight of the prior that there is none, as a duration, s. Not chosen on
flights."""
ERROR_S = 2.0
"""Memory of the ratio of errors to their expected size, s, with a prior weight of one reading. Of
1, 2, 3, 5 and 10 s and mean squares, sizes and their roots this was the best for one and two
spreads, over folds of NanoBench, and real_1 and real_2 of RflySimDT: within the goal in 80 and 92 %
of 40 sensors, without it in 24 and 52 %."""
MEAN_SIZE = math.sqrt(2 / math.pi)
"""Mean absolute value of a normal variable over its standard deviation. Errors have heavy tails,
and a few would dominate their squares."""


@dataclass(frozen=True, slots=True)
class SpanSequence:
    """One span of one flight, from its first sample on; everything is standardised.

    Attributes:
        flight: Index of the flight.
        start: Row of the flight at which the span starts.
        d: Residual: each sample held until the next, 0 before the first, shape (n, 15).
        fresh: Whether the residual is new, shape (n, 15).
        lags: Known values of `d`: at t - horizon and before, shape (n, 15, lags); one in
            `reconstruct`, none in `free`.
        offset: Running means of the newest value of `lags`, and of the sensor's reading then, as
            `own`: weights decay by 1 / e in `OFFSET_S`, with a prior of zeros for `OFFSET_PRIOR_S`;
            0 except in `track`, shape (n, 15, 2).
        change: Twin's reading at the time of the newest known residual minus the present one, over
            the scale; 0 except in `track`, shape (n, 15).
        own: Twin's present reading about its mean in the phase, over the scale, shape (n, 15).
        features: Features, shape (n, F).
        slow: Low-passed features, shape (n, 2 F).
        beyond: `own`, features and slow minus their running means inside the envelope, with the
            memory of `offset`, shape (n, 15 + 3 F); only in `free`.
        phase: Phase codes, shape (n,).
        distance: Distance from the training data, 1 at the envelope's edge, shape (n,).
        alone: Whether the twin ran open loop, shape (n,).
    """

    flight: int
    start: int
    d: Array
    fresh: BoolArray
    lags: Array
    offset: Array
    change: Array
    own: Array
    features: Array
    slow: Array
    beyond: Array
    phase: NDArray[np.intp]
    distance: Array
    alone: BoolArray

    @property
    def inside(self) -> BoolArray:
        """Whether each sample is inside the envelope, shape (n,)."""
        return np.asarray(self.distance <= 1)

    @property
    def rows(self) -> slice:
        """Rows of the span in the flight."""
        return slice(self.start, self.start + len(self.d))


def n_lags(protocol: Protocol) -> int:
    """Number of past residuals that are used."""
    return {"reconstruct": 1, "track": LAGS, "free": 0}[protocol]


def check_protocol(protocol: Protocol, horizon: int) -> None:
    """Raise ModelError unless the horizon, in samples, is allowed with the protocol."""
    if protocol == "track" and horizon < 1:
        raise ModelError(f"protocol track: horizon {horizon} samples; it needs 1 or more")
    if protocol != "track" and horizon != 0:
        raise ModelError(
            f"protocol {protocol}: horizon {horizon} samples; only track has one, leave it 0"
        )


def n_regressors(protocol: Protocol, n_features: int) -> int:
    """Number of regressors of a channel's linear prediction; see `linear.regressors`."""
    features = n_features * (1 + len(SMOOTHING_S))
    of = {"track": LAGS + 4 + features, "free": 1 + features}
    return of.get(protocol, 0)


def smoothing(rate_hz: float) -> tuple[float, ...]:
    """Filter coefficient per sample of each low-passed copy."""
    return tuple(1 - math.exp(-1 / (rate_hz * s)) for s in SMOOTHING_S)


def running_mean(rate_hz: float) -> tuple[float, float]:
    """Decay of a residual's weight per sample, and prior weight of zero in samples."""
    return math.exp(-1 / (rate_hz * OFFSET_S)), rate_hz * OFFSET_PRIOR_S


def sequences(
    flights: Sequence[ResidualFlight], scaling: Scaling, protocol: Protocol, horizon: int
) -> list[SpanSequence]:
    """Every span of every flight, in order."""
    return [
        _span(number, flight, span, scaling, protocol, horizon)
        for number, flight in enumerate(flights)
        for span in flight.spans
    ]


def _span(
    number: int,
    flight: ResidualFlight,
    span: tuple[int, int],
    scaling: Scaling,
    protocol: Protocol,
    horizon: int,
) -> SpanSequence:
    rows = slice(*span)
    phase = flight.phase[rows]
    fresh = flight.fresh[rows]
    new = (flight.residual[rows] - scaling.mean[phase]) / scaling.scale[phase]
    d = held(new, fresh, 0.0)
    raw = features_of(flight)[rows]
    features = standardised(raw, scaling)
    slow = [lfilter([a], [1.0, a - 1.0], features, axis=0) for a in smoothing(flight.rate_hz)]
    lags = [delayed(d, horizon + k) for k in range(n_lags(protocol))]
    change, offset = np.zeros_like(d), np.zeros((*d.shape, 2))
    virtual = flight.virtual[rows]
    own = np.nan_to_num((virtual - scaling.reading[phase]) / scaling.scale[phase])
    if protocol == "track":
        virtual = np.nan_to_num(virtual)
        then = delayed(held(virtual, fresh, virtual[0]), horizon, virtual[0])
        change = (then - virtual) / scaling.scale[phase]
        offset = _running_means(lags[0], lags[0] + change + own, *running_mean(flight.rate_hz))
    whole, distance = np.hstack([own, features, *slow]), _distance(raw, scaling, protocol)
    beyond = np.zeros((len(d), 0))
    if protocol == "free":
        beyond = beyond_mean(whole, distance <= 1, running_mean(flight.rate_hz)[0])
    return SpanSequence(
        flight=number,
        start=span[0],
        d=d,
        fresh=fresh,
        lags=np.stack(lags, axis=-1) if lags else np.zeros((*d.shape, 0)),
        offset=offset,
        change=change,
        own=own,
        features=features,
        slow=np.hstack(slow),
        beyond=beyond,
        phase=phase,
        distance=distance,
        alone=flight.alone_rows[rows],
    )


def limited(protocol: Protocol) -> bool:
    """Whether there is an envelope: models that repeat their input, or have none, have no
    envelope."""
    return protocol in ("track", "free")


def _distance(raw: Array, scaling: Scaling, protocol: Protocol) -> Array:
    if not limited(protocol):
        return np.zeros(len(raw))
    return scaling.envelope.distance(places_of(raw))


def one_hot(phase: NDArray[np.intp]) -> Array:
    """One-hot codes of phases, shape (n, phases)."""
    return np.eye(N_PHASES)[phase]


def _running_means(residual: Array, reading: Array, decay: float, prior: float) -> Array:
    """Running means of both, shape (n, k, 2); a residual of zero counts as missing."""
    there = (residual != 0).astype(np.float64)
    values = np.stack([residual, reading * there, there], axis=-1)
    sums = np.asarray(lfilter([1.0], [1.0, -decay], values, axis=0))
    return np.asarray(sums[..., :2] / (sums[..., 2:] + prior))


def error_memory(rate_hz: float) -> float:
    """Decay of an innovation's weight per sample."""
    return math.exp(-1 / (rate_hz * ERROR_S))


def error_of_today(size: Array, fresh: BoolArray, horizon: int, rate_hz: float) -> Array:
    """Size of the current flight's errors over their expected spread, shape (n, k).

    Args:
        size: Innovations over that spread, shape (n, k).
        fresh: Where there is one, shape (n, k).
        horizon: Number of samples until an innovation is known.
        rate_hz: Sample rate, Hz.
    """
    known = np.where(fresh, size / MEAN_SIZE, 0.0)
    values = np.stack([known, known > 0], axis=-1)
    sums = lfilter([1.0], [1.0, -error_memory(rate_hz)], values, axis=0)
    sums = delayed(sums, horizon) + 1.0
    return np.asarray(sums[..., 0] / sums[..., 1])


def beyond_mean(values: Array, counts: BoolArray, decay: float) -> Array:
    """Values minus their running mean, shape (n, k); zero before any has counted.

    Args:
        values: Values, shape (n, k).
        counts: Which of them count, since means differ on the ground, shape (n,).
        decay: Decay of a value's weight per sample.
    """
    weights = counts.astype(np.float64)[:, None]
    sums = lfilter([1.0], [1.0, -decay], np.hstack([weights * values, weights]), axis=0)
    return np.asarray((values * sums[:, -1:] - sums[:, :-1]) / np.maximum(sums[:, -1:], 1.0))


def delayed(values: Array, samples: int, before: Array | float = 0.0) -> Array:
    """The values some samples ago, or `before` at the start; shape (n, k)."""
    if samples == 0:
        return values
    late = np.empty_like(values)
    late[:samples] = before
    late[samples:] = values[:-samples]
    return late
