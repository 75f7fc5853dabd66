"""Terms picked from sums are those that pysindy picks from samples."""

import numpy as np
import pytest
from pysindy.optimizers import FROLS

from twin.explain.inference.sparse_regression import forward

MOST = 4


@pytest.mark.parametrize("seed", range(10))
def test_the_same_terms_in_the_same_order_as_pysindy(seed: int) -> None:
    """Columns that look alike, of which three act."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(200, 12)) @ rng.normal(size=(12, 12))
    x /= np.linalg.norm(x, axis=0)
    y = x[:, [1, 5, 8]] @ [3.0, -2.0, 1.0] + 0.02 * rng.normal(size=200)
    found = FROLS(max_iter=MOST, alpha=0.0, unbias=False).fit(x, y[:, None]).history_
    order = forward(x.T @ x, x.T @ y, MOST)
    for n, coefficients in enumerate(found):
        assert {*np.flatnonzero(coefficients[0])} == {*order[:n]}


def test_no_more_are_picked_than_there_are() -> None:
    assert forward(np.eye(2), np.array([1.0, -3.0]), MOST).tolist() == [1, 0]
