"""Readings whose filters settle in different times: which rows of them are kept."""

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


def test_a_piece_in_which_the_filter_does_not_settle_is_none() -> None:
    """Of a low-pass at 1 Hz, which settles in 2 s, a piece of 1.75 s keeps no row."""
    t_s, values = np.arange(1000) / GRID_HZ, np.ones((1000, 1))
    short = np.arange(1000) < 350
    assert measured(("x",), "1", t_s, values, short, 1.0, None, 2.5) is None
    found = measured(("x",), "1", t_s, values, np.arange(1000) != 350, 1.0, None, 2.5)
    assert found is not None
    assert len(found.rows) == 1
    assert np.unique(found.piece).tolist() == [0]
    assert found.t_s.min() > 352 / GRID_HZ + 1.9
