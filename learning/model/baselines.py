"""Baselines: trivial predictions that a compensator must beat.

| baseline | prediction |
|---|---|
| none | no correction |
| mean | mean of the training residual in the same phase |
| last | the last known residual; with a horizon of 0 the measurement itself |
| average | mean of the last 21 known residuals (`reconstruct`) |
| mean reading | training mean of the reading in the phase (`track`, `free`) |
| last reading | last reading of the sensor (`track`) |
| linear AR(8) | 8 residuals up to t - h, one linear map per channel directly to t (`track`) |
| linear in inputs | virtual signals, commands and low-passed copies (`track`, `free`) |

Each predicts the mean of the phase where nothing else is known, and has the interface of a model:
`run`. Baselines of readings do not use the twin: a correction that is not better makes the twin
useless.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from sklearn.linear_model import Ridge
from sklearn.model_selection import GridSearchCV, LeaveOneGroupOut

from ..data.channels import CHANNELS
from ..data.flights import ResidualFlight, held
from ..data.scaling import features_of, in_spans, phase_mean
from ..data.sequences import delayed, smoothing
from ..preset import PROTOCOLS, Protocol
from .family import Corrected

Array = NDArray[np.float64]
ORDER = 8
"""Order of the autoregression: 0.08 s at 100 Hz, as `data.sequences.LAGS`."""
AVERAGED = 21
"""Length of the moving average, an odd number of samples, about 0.2 s at 100 Hz. Made up."""
TINY = 1e-6
"""Ridge of the autoregression, relative to the power of its regressors: samples of a slow sensor
repeat from lag to lag."""
RIDGES = (1e-4, 1e-2, 1.0, 100.0)
"""Ridge parameters that are tried in the regression on inputs; its regressors are standardised."""
Numbers = Mapping[str, Array]


@dataclass(frozen=True, slots=True)
class Rule:
    """Definition of a baseline: how it is fitted and what it predicts.

    Attributes:
        protocols: Protocols under which it may be used.
        fit: Function: training flights and horizon -> its numbers by name.
        predict: Function: flight, numbers and horizon -> correction, shape (n, 15), units of the
            channels.
    """

    protocols: tuple[Protocol, ...]
    fit: Callable[[Sequence[ResidualFlight], int], Numbers]
    predict: Callable[[ResidualFlight, Numbers, int], Array]


@dataclass(frozen=True, slots=True)
class Baseline:
    """A fitted baseline, with its spread on the training flights.

    Attributes:
        rule: Name of the rule in `RULES`.
        horizon: Age of the newest residual that it sees, samples.
        numbers: Fitted numbers of the rule, by name.
        spread: Rms error on the training flights, per phase and channel, shape (phases, 15).
    """

    rule: str
    horizon: int
    numbers: Numbers
    spread: Array

    def run(self, flight: ResidualFlight) -> Corrected:
        """Correction of the whole flight, without envelope and alarm."""
        n = len(flight.t_s)
        return Corrected(
            RULES[self.rule].predict(flight, self.numbers, self.horizon),
            self.spread[flight.phase],
            np.full(n, np.nan),
            np.ones(n, dtype=np.bool_),
        )


def fit_baselines(
    train: Sequence[ResidualFlight], protocol: str, horizon: int = 0
) -> dict[str, Baseline]:
    """Every baseline of a protocol, by name.

    Args:
        train: Training flights.
        protocol: `reconstruct`, `track` or `free`.
        horizon: Prediction horizon in `track`, samples.
    """
    return {n: fit_baseline(n, train, horizon) for n, r in RULES.items() if protocol in r.protocols}


def fit_baseline(name: str, train: Sequence[ResidualFlight], horizon: int = 0) -> Baseline:
    """One baseline by name; arguments as in `fit_baselines`."""
    rule = RULES[name]
    numbers = rule.fit(train, horizon)
    left = [(f.residual - rule.predict(f, numbers, horizon)) ** 2 for f in train]
    return Baseline(name, horizon, numbers, np.sqrt(by_phase(train, left)))


def by_phase(train: Sequence[ResidualFlight], values: Sequence[Array]) -> Array:
    """Mean of values over the samples of each phase, as of `phase_mean`, shape (phases, 15).

    Args:
        train: Flights, whose phases and fresh samples are used.
        values: Values of each flight, shape (n, 15).
    """
    phase, fresh = (np.concatenate([getattr(f, n) for f in train]) for n in ("phase", "fresh"))
    return phase_mean(np.concatenate(values), fresh, phase)


def phase_means(train: Sequence[ResidualFlight]) -> Array:
    """Mean residual of each phase, or of all phases where there are too few samples, shape (phases,
    15)."""
    return by_phase(train, [f.residual for f in train])


def lags(flight: ResidualFlight, values: Array, horizon: int, count: int) -> Array:
    """Known values at t - horizon, t - horizon - 1, ...: the last fresh value at each time.

    Args:
        flight: Flight; each span starts from zero.
        values: Values, used where fresh, shape (n, 15).
        horizon: Age of the newest value, samples.
        count: Number of lags.

    Returns:
        Values, shape (n, 15, count), 0 where the span has none yet.
    """
    found = np.zeros((*values.shape, count))
    known = flight.fresh & np.isfinite(values)
    for a, b in flight.spans:
        value = held(values[a:b], known[a:b], 0.0)
        found[a:b] = np.stack([delayed(value, horizon + k) for k in range(count)], axis=-1)
    return found


def slow_features(flight: ResidualFlight, centre: Array, spread: Array) -> Array:
    """Standardised virtual signals and commands, with low-passed copies of them, shape (n, 3 F).

    Unknown values are replaced by their mean, where the low-passes start in each span.
    """
    raw = (features_of(flight) - centre) / spread
    now = np.where(np.isfinite(raw), raw, 0.0)
    found = [now]
    for share in smoothing(flight.rate_hz):
        slow = np.zeros_like(now)
        for a, b in flight.spans:
            slow[a:b] = lfilter([share], [1.0, share - 1.0], now[a:b], axis=0)
        found.append(slow)
    return np.hstack(found)


# -- the rules ------------------------------------------------------------------------------


def _about(flight: ResidualFlight, mean: Array) -> Array:
    return flight.residual - mean[flight.phase]


def _average(flight: ResidualFlight, mean: Array, horizon: int, count: int) -> Array:
    past = lags(flight, _about(flight, mean), horizon, count)
    return np.asarray(mean[flight.phase] + past.mean(axis=-1))


def _fit_mean(train: Sequence[ResidualFlight], horizon: int) -> Numbers:
    return {"mean": phase_means(train)}


def _fit_reading(train: Sequence[ResidualFlight], horizon: int) -> Numbers:
    """Mean reading of each sensor."""
    return {"reading": by_phase(train, [np.nan_to_num(f.virtual) + f.residual for f in train])}


def _last_reading(flight: ResidualFlight, numbers: Numbers, horizon: int) -> Array:
    reading = numbers["reading"][flight.phase]
    about = flight.virtual + flight.residual - reading
    return _less_virtual(flight, reading + lags(flight, about, horizon, 1)[..., 0])


def _less_virtual(flight: ResidualFlight, reading: Array) -> Array:
    return np.nan_to_num(reading - flight.virtual)


def _fit_autoregression(train: Sequence[ResidualFlight], horizon: int) -> Numbers:
    mean = phase_means(train)
    weights = np.zeros((len(CHANNELS), ORDER))
    past = [lags(f, _about(f, mean), horizon, ORDER) for f in train]
    for c in range(len(CHANNELS)):
        x = np.concatenate([p[f.fresh[:, c], c] for p, f in zip(past, train, strict=True)])
        y = np.concatenate([_about(f, mean)[f.fresh[:, c], c] for f in train])
        if len(y) and np.any(x):
            weights[c] = Ridge(TINY * np.sum(x**2), fit_intercept=False).fit(x, y).coef_
    return {"mean": mean, "weights": weights}


def _autoregression(flight: ResidualFlight, numbers: Numbers, horizon: int) -> Array:
    mean = numbers["mean"]
    past = lags(flight, _about(flight, mean), horizon, ORDER)
    return np.asarray(mean[flight.phase] + np.einsum("tck,ck->tc", past, numbers["weights"]))


def _fit_linear_in_inputs(train: Sequence[ResidualFlight], horizon: int) -> Numbers:
    mean = phase_means(train)
    inside = np.concatenate([features_of(f)[in_spans(f)] for f in train])
    finite = np.isfinite(inside)
    n = np.maximum(finite.sum(axis=0), 1)
    centre = np.where(finite, inside, 0.0).sum(axis=0) / n
    spread = np.sqrt(np.where(finite, (inside - centre) ** 2, 0.0).sum(axis=0) / n)
    spread[spread <= 1e-9 * np.abs(centre) + 1e-15] = np.inf  # ignores constant features
    x = [slow_features(f, centre, spread) for f in train]
    weights = []
    for c in range(len(CHANNELS)):
        seen = [a[f.fresh[:, c]] for a, f in zip(x, train, strict=True)]
        weights.append(_ridge(seen, [_about(f, mean)[f.fresh[:, c], c] for f in train]))
    return {"mean": mean, "centre": centre, "spread": spread, "weights": np.stack(weights)}


def _linear_in_inputs(flight: ResidualFlight, numbers: Numbers, horizon: int) -> Array:
    x = slow_features(flight, numbers["centre"], numbers["spread"])
    return np.asarray(numbers["mean"][flight.phase] + x @ numbers["weights"].T)


# -- least squares --------------------------------------------------------------------------


def _ridge(x: Sequence[Array], y: Sequence[Array]) -> Array:
    """Ridge regression weights, with the ridge that is best on flights left out, or zero.

    For a single flight, its last fifth is left out.
    """
    flight = np.repeat(np.arange(len(y)), [len(b) for b in y])
    every, target = np.concatenate(x), np.concatenate(y)
    if len(target) and flight[0] == flight[-1]:
        flight = (5 * np.arange(len(target)) // len(target)) // 4
    if len(groups := np.unique(flight)) < 2:
        return np.zeros(every.shape[1])
    search = GridSearchCV(
        Ridge(fit_intercept=False),
        {"alpha": [strength * len(target) for strength in RIDGES]},
        scoring=lambda fit, a, b: -float(np.sum((b - fit.predict(a)) ** 2)),
        cv=LeaveOneGroupOut().split(every, groups=flight),
    ).fit(every, target)
    if -search.best_score_ * len(groups) >= float(target @ target):
        return np.zeros(every.shape[1])
    return np.asarray(search.best_estimator_.coef_)


RULES: Mapping[str, Rule] = MappingProxyType(
    {
        "none": Rule(PROTOCOLS, lambda f, h: {}, lambda f, _, h: np.zeros_like(f.residual)),
        "mean": Rule(PROTOCOLS, _fit_mean, lambda f, k, h: k["mean"][f.phase]),
        "last": Rule(
            ("reconstruct", "track"), _fit_mean, lambda f, k, h: _average(f, k["mean"], h, 1)
        ),
        "average": Rule(
            ("reconstruct",), _fit_mean, lambda f, k, h: _average(f, k["mean"], h, AVERAGED)
        ),
        "last reading": Rule(("track",), _fit_reading, _last_reading),
        f"linear AR({ORDER})": Rule(("track",), _fit_autoregression, _autoregression),
        "mean reading": Rule(
            ("track", "free"),
            _fit_reading,
            lambda f, k, h: _less_virtual(f, k["reading"][f.phase]),
        ),
        "linear in inputs": Rule(("track", "free"), _fit_linear_in_inputs, _linear_in_inputs),
    }
)
"""All baselines by name, in the order in which they are printed."""
