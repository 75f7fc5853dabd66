"""Flights as standardised sequences: what the compensator sees and what it should say.

One definition for training and evaluation; `learning.export.streaming` does the same sample
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
"""Sensors that have another offset on another day, shape (15,): in `free`, which sees no
measurement, what flights have in common of it says nothing of the next one, and only what is beyond
a running mean is corrected. A gyroscope is set to nothing before each flight."""
LAGS = 8
"""Past residuals in the linear prediction of `track`."""
SMOOTHING_S = (0.1, 0.5)
"""Time constants of the slow copies of the features."""
OFFSET_S, OFFSET_PRIOR_S = 30.0, 1.0
"""Memory of the running means of the known residual and reading, which hold the offset that a
sensor has today, and how long they have to be known before they count more than no offset at all.
Neither was chosen on flights."""
ERROR_S = 2.0
"""Memory of how far readings have been off, over what was expected, beside which the expected
counts as one reading. Of 1, 2, 3, 5 and 10 s and mean squares, sizes and their roots the best
balance of one and two spreads, over folds of NanoBench, and real_1 and real_2 of RflySimDT: within
the goal in 80 and 92 % of 40 sensors, without it in 24 and 52 %."""
MEAN_SIZE = math.sqrt(2 / math.pi)
"""Of a normal variable, over its standard deviation. Errors have long tails: of their squares a few
make all."""


@dataclass(frozen=True, slots=True)
class SpanSequence:
    """One span of one flight, from its first sample on; all standardised.

    Attributes:
        flight: Number of the flight.
        start: Row of the flight at which the span starts.
        d: Residual: each sample held until the next one, 0 before the first, shape (n, 15).
        fresh: Whether `d` is new, shape (n, 15).
        lags: Columns of `d` that are known: at t - horizon and before, shape (n, 15, lags); one
            in `reconstruct`, none in `free`.
        offset: Running means of what `lags` begins with, and of what the sensor read then, as
            `own`: each counts less by 1 / e in `OFFSET_S`, and zeros of `OFFSET_PRIOR_S` count with
            them; 0 unless in `track`, shape (n, 15, 2).
        change: What the twin read at the time of the newest known residual, minus what it reads
            now, over the scale; 0 unless in `track`, shape (n, 15).
        own: What the twin reads now, about its mean in the phase, over the scale, shape (n, 15).
        features: Shape (n, F).
        slow: Low-passed features, shape (n, 2 F).
        beyond: `own`, features and slow less their running means within the envelope, with the
            memory of `offset`, shape (n, 15 + 3 F); none but in `free`.
        phase: Codes, shape (n,).
        distance: From where training has been, 1 where that ends, shape (n,).
        alone: Whether the twin flew by itself, shape (n,).
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
        """Whether it is within the envelope, shape (n,)."""
        return np.asarray(self.distance <= 1)

    @property
    def rows(self) -> slice:
        """Rows of the flight."""
        return slice(self.start, self.start + len(self.d))


def n_lags(protocol: Protocol) -> int:
    """How many past residuals are looked at."""
    return {"reconstruct": 1, "track": LAGS, "free": 0}[protocol]


def check_protocol(protocol: Protocol, horizon: int) -> None:
    """Raise ModelError unless the horizon, in samples, goes with the protocol."""
    if protocol == "track" and horizon < 1:
        raise ModelError(f"protocol track: horizon {horizon} samples; it needs 1 or more")
    if protocol != "track" and horizon != 0:
        raise ModelError(
            f"protocol {protocol}: horizon {horizon} samples; only track has one, leave it 0"
        )


def n_regressors(protocol: Protocol, n_features: int) -> int:
    """How many numbers the linear prediction of a channel is made from; see `base.regressors`."""
    features = n_features * (1 + len(SMOOTHING_S))
    of = {"track": LAGS + 4 + features, "free": 1 + features}
    return of.get(protocol, 0)


def smoothing(rate_hz: float) -> tuple[float, ...]:
    """Share of the way that each slow copy goes towards the feature per sample."""
    return tuple(1 - math.exp(-1 / (rate_hz * s)) for s in SMOOTHING_S)


def running_mean(rate_hz: float) -> tuple[float, float]:
    """Share of its weight that a residual keeps per sample, and samples of no residual at all."""
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
    """Whether there is an envelope: what repeats what it is given, or sees nothing, has none."""
    return protocol in ("track", "free")


def _distance(raw: Array, scaling: Scaling, protocol: Protocol) -> Array:
    if not limited(protocol):
        return np.zeros(len(raw))
    return scaling.envelope.distance(places_of(raw))


def one_hot(phase: NDArray[np.intp]) -> Array:
    """Phases as rows of the unit matrix, shape (n, phases)."""
    return np.eye(N_PHASES)[phase]


def _running_means(residual: Array, reading: Array, decay: float, prior: float) -> Array:
    """Means so far of both, shape (n, k, 2); a residual of zero says that there is none."""
    there = (residual != 0).astype(np.float64)
    values = np.stack([residual, reading * there, there], axis=-1)
    sums = np.asarray(lfilter([1.0], [1.0, -decay], values, axis=0))
    return np.asarray(sums[..., :2] / (sums[..., 2:] + prior))


def error_memory(rate_hz: float) -> float:
    """Share of its weight that an innovation keeps per sample."""
    return math.exp(-1 / (rate_hz * ERROR_S))


def error_of_today(size: Array, fresh: BoolArray, horizon: int, rate_hz: float) -> Array:
    """How far readings are off today, over the spread that is expected of it, shape (n, k).

    Args:
        size: Of innovations, over that spread, shape (n, k).
        fresh: Where there is one, the same shape.
        horizon: Samples until one is known.
        rate_hz: Samples per second.
    """
    known = np.where(fresh, size / MEAN_SIZE, 0.0)
    values = np.stack([known, known > 0], axis=-1)
    sums = lfilter([1.0], [1.0, -error_memory(rate_hz)], values, axis=0)
    sums = delayed(sums, horizon) + 1.0
    return np.asarray(sums[..., 0] / sums[..., 1])


def beyond_mean(values: Array, counts: BoolArray, decay: float) -> Array:
    """Values less their mean so far, shape (n, k); nothing before any has counted.

    Args:
        values: Shape (n, k).
        counts: Which of them do: on the ground a twin reads other means, shape (n,).
        decay: Share of its weight that a value keeps per sample.
    """
    weights = counts.astype(np.float64)[:, None]
    sums = lfilter([1.0], [1.0, -decay], np.hstack([weights * values, weights]), axis=0)
    return np.asarray((values * sums[:, -1:] - sums[:, :-1]) / np.maximum(sums[:, -1:], 1.0))


def delayed(values: Array, samples: int, before: Array | float = 0.0) -> Array:
    """The values some samples ago, or those from before the first; shape (n, k)."""
    if samples == 0:
        return values
    late = np.empty_like(values)
    late[:samples] = before
    late[samples:] = values[:-samples]
    return late
