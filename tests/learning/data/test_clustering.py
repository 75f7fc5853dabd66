"""Feature clustering: groups are complete, repeatable, and found where they are plain."""

import numpy as np
import pytest
from learning_rigs.residual_rig import made_up, tiny

from learning.data.channels import CHANNELS
from learning.data.clustering import channel_statistics, clusters_of, kmeans_clusters
from learning.data.scaling import in_spans

FLIGHTS = [made_up(0), made_up(1)]
ALL = [in_spans(f) for f in FLIGHTS]


@pytest.mark.parametrize("clustering", ["kmeans", "sensors", "none", "channels"])
def test_every_channel_has_one_network_and_the_same_again(clustering: str) -> None:
    preset = tiny(clustering=clustering)
    clusters = clusters_of(preset, FLIGHTS, ALL, seed=0)
    assert sorted(c for cluster in clusters for c in cluster) == list(range(len(CHANNELS)))
    assert clusters == clusters_of(preset, FLIGHTS, ALL, seed=0)


@pytest.mark.parametrize(
    ("clustering", "sizes"), [("none", [15]), ("channels", [1] * 15), ("sensors", [3] * 5)]
)
def test_sizes(clustering: str, sizes: list[int]) -> None:
    clusters = clusters_of(tiny(clustering=clustering), FLIGHTS, ALL, seed=0)
    assert [len(c) for c in clusters] == sizes


@pytest.mark.parametrize("seed", range(3))
def test_kmeans_finds_plain_groups(seed: int) -> None:
    """Three heaps far apart, units apart by 1e6."""
    rng = np.random.default_rng(seed)
    heaps = rng.permutation(np.repeat([0, 1, 2], 5))
    centres = np.array([[0.0, 0.0, 0.0], [1.0, 1e6, 0.0], [0.0, 1e6, 1e-3]])
    points = centres[heaps] + 0.01 * rng.normal(size=(15, 3)) * [1.0, 1e6, 1e-3]
    found = kmeans_clusters(points, 3, seed=0)
    assert set(found) == {tuple(int(i) for i in np.flatnonzero(heaps == h)) for h in range(3)}


def test_statistics_of_a_channel() -> None:
    statistics = channel_statistics(FLIGHTS, ALL)
    values = np.concatenate([f.residual[u][:, 3] for f, u in zip(FLIGHTS, ALL, strict=True)])
    np.testing.assert_allclose(statistics[3, :2], [values.mean(), values.var()])
    assert np.all((statistics[:, 2] > 0.5) & (statistics[:, 2] < 1))  # made to be slow


def test_channels_alike_give_fewer_clusters() -> None:
    assert len(kmeans_clusters(np.ones((15, 3)), 4, seed=0)) == 1
