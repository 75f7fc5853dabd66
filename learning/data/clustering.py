"""Feature clustering: assignment of channels to networks.

k-means on three statistics per channel (mean, variance, lag autocorrelation), each standardised
over the channels: in raw units the largest statistic would dominate.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from sklearn.cluster import KMeans
from threadpoolctl import threadpool_limits

from ..preset import Preset
from .channels import CHANNELS, GROUPS
from .flights import ResidualFlight

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Clusters = tuple[tuple[int, ...], ...]

LAG = 1
"""Lag of the autocorrelation, samples."""


def clusters_of(
    preset: Preset, flights: Sequence[ResidualFlight], chosen: Sequence[BoolArray], seed: int
) -> Clusters:
    """Channels of each network: indices in ascending order, clusters by their first channel.

    Args:
        preset: Preset with the clustering method.
        flights: Training flights.
        chosen: Samples that may be used in each flight, shape (n,).
        seed: Random seed of k-means.
    """
    numbers = range(len(CHANNELS))
    if preset.clustering == "none":
        return (tuple(numbers),)
    if preset.clustering == "channels":
        return tuple((i,) for i in numbers)
    if preset.clustering == "sensors":
        return tuple(tuple(numbers[columns]) for columns in GROUPS.values())
    return kmeans_clusters(channel_statistics(flights, chosen), preset.n_clusters, seed)


def channel_statistics(flights: Sequence[ResidualFlight], chosen: Sequence[BoolArray]) -> Array:
    """Mean, variance and lag-1 autocorrelation of each channel's residual, shape (15, 3).

    Samples held between two measurements count: they are part of the correlation that the network
    sees. A channel without samples has zeros.
    """
    found = np.zeros((len(CHANNELS), 3))
    for c in range(len(found)):
        parts = []
        for flight, use in zip(flights, chosen, strict=True):
            for a, b in flight.spans:
                values = flight.residual[a:b, c][use[a:b]]
                parts.append(values[np.isfinite(values)])
        values = np.concatenate(parts) if parts else np.zeros(0)
        if not len(values):
            continue
        mean, variance = float(values.mean()), float(values.var())
        pairs = sum(float((p[LAG:] - mean) @ (p[:-LAG] - mean)) for p in parts if len(p) > LAG)
        count = sum(max(len(p) - LAG, 0) for p in parts)
        found[c] = mean, variance, pairs / (count * variance) if count and variance > 0 else 0.0
    return found


def kmeans_clusters(statistics: Array, n_clusters: int, seed: int) -> Clusters:
    """k-means clusters of the rows, reproducible by seed.

    Args:
        statistics: Statistics, shape (channels, numbers).
        n_clusters: Maximum number of clusters; fewer where fewer rows differ.
        seed: Random seed of the initial centres.
    """
    spread = statistics.std(axis=0)
    points = (statistics - statistics.mean(axis=0)) / np.where(spread > 0, spread, 1.0)
    k = min(n_clusters, len(np.unique(points, axis=0)))
    with threadpool_limits(1):  # fifteen points: threads would only wait for each other
        labels = KMeans(n_clusters=k, n_init=20, random_state=seed).fit_predict(points)
    groups = [tuple(int(i) for i in np.flatnonzero(labels == k)) for k in np.unique(labels)]
    return tuple(sorted(groups))
