"""Readings of two sensors that begin at different times and pass different filters."""

import numpy as np
import pytest

from twin.residuals.channels import EVERY, GRID_HZ, measured


@pytest.mark.parametrize("later", range(EVERY))
@pytest.mark.parametrize("band_hz", [18.0, 11.0, 5.3])
def test_sensors_that_go_together_keep_the_same_instants(later: int, band_hz: float) -> None:
    """The second is known from `later` rows on and has a filter that settles in another time."""
    n = 2000
    t_s, values = np.arange(n) / GRID_HZ, np.zeros((n, 1))
    kept = []
    for begins, band in ((100, 18.0), (100 + later, band_hz)):
        known = np.arange(n) >= begins
        found = measured(("x",), "1", t_s, values, known, band, None, 50.0, together=True)
        assert found is not None and len(found.t_s) == len(found.values) == len(found.piece)
        kept.append(found.t_s)
    assert len(np.intersect1d(kept[0], kept[1])) == min(map(len, kept))
