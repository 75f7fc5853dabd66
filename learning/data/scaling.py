"""Standardisation of residuals and features, and the training envelope."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from twin.representation import ShortRepr

from ..preset import Normalise
from .channels import CHANNELS, FEATURE_CHANNELS, N_PHASES, PLACES
from .envelope import UNLIMITED, Envelope
from .flights import ResidualFlight

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

MIN_SAMPLES = 20
"""Least number of samples of a channel in a phase; with fewer, the scaling of all phases is
used."""
RATE_RESERVE, SPEED_RESERVE, DRIVE_RESERVE = 0.5, 0.5, 0.05
"""Differences within one flight condition: rad/s, m/s, and a share of a rotor's mean drive. Not
chosen on flights."""


@dataclass(frozen=True, slots=True)
class Scaling(ShortRepr):
    """Offsets and scales of a model; all are stored with the weights.

    Attributes:
        mean: Mean residual, shape (phases, 15), units of the channels.
        scale: Spread of the residual, > 0, shape (phases, 15), units of the channels.
        reading: Mean reading of the twin, shape (phases, 15), units of the channels.
        largest: Largest absolute training residual about its mean, over the scale, shape (15,).
        feature_mean: Mean of the features, shape (features,), units of the features.
        feature_scale: Scale of the features, > 0, shape (features,); `UNLIMITED` for one without
            data, which gives 0.
        least: Smallest standardised training feature, the lower limit of the network's input, shape
            (features,).
        most: Largest standardised training feature, the upper limit, shape (features,).
        place_centre: Centre of the envelope, as of `Envelope`, shape (places,).
        place_scale: Scale of the envelope, shape (places,).
        place_whitening: Whitening of the envelope, shape (places, places).
        place_reach: Reach of the envelope, shape (1,).
        rms: Rms of the uncorrected residual, the expected error outside the envelope, shape (15,).
    """

    mean: Array
    scale: Array
    reading: Array
    largest: Array
    feature_mean: Array
    feature_scale: Array
    least: Array
    most: Array
    place_centre: Array
    place_scale: Array
    place_whitening: Array
    place_reach: Array
    rms: Array

    def arrays(self) -> dict[str, Array]:
        """Every array by its name."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def without_offsets(self, channels: BoolArray) -> "Scaling":
        """The scaling with zero mean for some channels.

        Args:
            channels: Selected channels, shape (15,).
        """
        return replace(self, mean=np.where(channels, 0.0, self.mean))

    @property
    def envelope(self) -> Envelope:
        """Training envelope."""
        reach = float(self.place_reach[0])
        return Envelope(self.place_centre, self.place_scale, self.place_whitening, reach)


def feature_names(n_commands: int) -> tuple[str, ...]:
    """Names of the features, in order: virtual signals, then commands."""
    return (*(CHANNELS[i] for i in FEATURE_CHANNELS), *(f"cmd_{i + 1}" for i in range(n_commands)))


def features_of(flight: ResidualFlight) -> Array:
    """Features in their units, NaN where the twin has no reading, shape (n, features)."""
    return np.hstack([flight.virtual[:, list(FEATURE_CHANNELS)], flight.commands])


def place_names(n_commands: int) -> tuple[str, ...]:
    """Names of the physical inputs of the envelope, in order."""
    names = feature_names(n_commands)
    seen = ("speed" if len(some) > 1 else names[some[0]] for some in PLACES)
    return (*seen, *names[len(FEATURE_CHANNELS) :])


def places_of(raw: Array) -> Array:
    """Physical inputs of the envelope, shape (n, places).

    Args:
        raw: Features in their units, shape (n, features).
    """
    seen = [
        raw[:, some[0]] if len(some) == 1 else np.hypot(*raw[:, list(some)].T) for some in PLACES
    ]
    return np.column_stack([*seen, raw[:, len(FEATURE_CHANNELS) :]])


def _reserve(places: Array) -> Array:
    """Difference of each physical input within one flight condition, shape (places,)."""
    names = [CHANNELS[FEATURE_CHANNELS[some[0]]] for some in PLACES]
    own = [RATE_RESERVE if name.startswith("gyro") else SPEED_RESERVE for name in names]
    drives = np.nan_to_num(np.nanmean(np.abs(places[:, len(own) :]), axis=0))
    return np.array([*own, *(DRIVE_RESERVE * drives)])


def standardised(raw: Array, scaling: Scaling) -> Array:
    """Standardised features for the network: 0 where unknown, limited to the training range.

    Args:
        raw: Features in their units, NaN where unknown, shape (n, features).
        scaling: Scaling of the training.
    """
    features = (raw - scaling.feature_mean) / scaling.feature_scale
    held = np.minimum(np.maximum(features, scaling.least), scaling.most)
    return np.where(np.isfinite(raw), held, 0.0)


def in_spans(flight: ResidualFlight) -> BoolArray:
    """Whether each sample is inside a span, shape (n,)."""
    inside = np.zeros(len(flight.t_s), dtype=np.bool_)
    for a, b in flight.spans:
        inside[a:b] = True
    return inside


def fit_scaling(
    flights: Sequence[ResidualFlight],
    chosen: Sequence[BoolArray],
    normalise: Normalise,
) -> Scaling:
    """Scaling and envelope from the training samples.

    Args:
        flights: Training flights.
        chosen: Samples that may be used in each flight, shape (n,).
        normalise: Normalisation, as in `Preset`.

    Returns:
        Scaling; mean and scale are those of a twin that follows the motion, where part of the data
        is. Constant channels and features have scale 1.
    """
    residual = np.concatenate(
        [np.where(f.fresh, f.residual, np.nan)[c] for f, c in zip(flights, chosen, strict=True)]
    )
    phase = np.concatenate([f.phase[c] for f, c in zip(flights, chosen, strict=True)])
    alone = np.concatenate([f.alone_rows[c] for f, c in zip(flights, chosen, strict=True)])
    follows = np.where(alone[:, None] & ~alone.all(), np.nan, residual)
    mean = np.zeros((N_PHASES, residual.shape[1]))
    scale = np.ones_like(mean)
    for c, column in enumerate(follows.T):
        known = np.isfinite(column)
        mean[:, c], scale[:, c] = _centre(column[known], normalise)
        for p in range(N_PHASES) if normalise != "pooled" else ():
            here = known & (phase == p)
            if here.sum() >= MIN_SAMPLES:
                mean[p, c], scale[p, c] = _centre(column[here], normalise)
        if normalise == "centred" and known.any():
            about = column[known] - mean[phase[known], c]
            scale[:, c] = _positive(float(about.std()), float(np.abs(mean[:, c]).max()))
    virtual = np.concatenate([f.virtual[c] for f, c in zip(flights, chosen, strict=True)])
    each = [features_of(f)[c] for f, c in zip(flights, chosen, strict=True)]
    features = np.concatenate(each)
    places = [places_of(raw) for raw in each if len(raw)]
    envelope = Envelope.of(places, _reserve(np.vstack(places)))
    about = np.nan_to_num((residual - mean[phase]) / scale[phase])
    least, most, centre, spread = np.array([_limits(column) for column in features.T]).T
    return Scaling(
        mean=mean,
        scale=scale,
        reading=phase_mean(virtual, np.isfinite(virtual), phase),
        largest=np.abs(about).max(axis=0, initial=0.0),
        feature_mean=centre,
        feature_scale=spread,
        least=(least - centre) / spread,
        most=(most - centre) / spread,
        place_centre=envelope.centre,
        place_scale=envelope.scale,
        place_whitening=envelope.whitening,
        place_reach=np.array([envelope.reach]),
        rms=np.array([_rms(column[np.isfinite(column)]) for column in follows.T]),
    )


def phase_mean(values: Array, known: BoolArray, phase: NDArray[np.intp]) -> Array:
    """Mean of known values in each phase, shape (phases, k): with fewer than `MIN_SAMPLES` that of
    all phases, 0 without any.

    Args:
        values: Values, shape (n, k).
        known: Which of them count, shape (n, k).
        phase: Phase codes, shape (n,).
    """
    found = np.zeros((N_PHASES, values.shape[1]))
    for p in (None, *range(N_PHASES)):
        here = known if p is None else known & (phase == p)[:, None]
        count = here.sum(axis=0)
        mean = np.sum(values, axis=0, where=here) / np.maximum(count, 1)
        rows = slice(None) if p is None else p
        found[rows] = np.where((p is None) | (count >= MIN_SAMPLES), mean, found[rows])
    return found


def _centre(values: Array, normalise: str) -> tuple[float, float]:
    """Centre and spread of some samples; (0, 1) without samples."""
    if not len(values):
        return 0.0, 1.0
    if normalise == "range":
        low, high = float(values.min()), float(values.max())
        return (low + high) / 2, _positive((high - low) / 2, (low + high) / 2)
    return float(values.mean()), _positive(float(values.std()), float(values.mean()))


def _positive(spread: float, centre: float) -> float:
    """The spread, or 1 where it is only rounding."""
    return spread if spread > 1e-9 * abs(centre) + 1e-15 else 1.0


def _limits(values: Array) -> tuple[float, float, float, float]:
    """Smallest and largest value, mean and spread of a feature."""
    values = values[np.isfinite(values)]
    if not len(values):
        return -UNLIMITED, UNLIMITED, 0.0, UNLIMITED
    low, high = float(values.min()), float(values.max())
    mean, spread = float(values.mean()), float(values.std())
    return low, high, mean, _positive(spread, mean)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0
