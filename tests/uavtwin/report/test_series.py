"""Thinned series look as all samples would; the bundle that draws them is what its table says."""

import gzip
import hashlib
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uavtwin.report.drawing import drawn, thinned
from uavtwin.report.page import HERE


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1), st.integers(1, 400), st.integers(1, 60))
def test_thinning_keeps_least_and_largest_of_each_column_and_every_gap(
    seed: int, n: int, columns: int
) -> None:
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.uniform(0.1, 1, n))
    y = np.where(rng.uniform(size=n) < 0.1, np.nan, rng.standard_normal(n))
    tx, _ = thinned(x, y, columns)
    assert len(tx) <= max(2 * columns, 3 * columns + 2)
    assert np.all(np.diff(tx) > 0)
    assert {*tx} <= {*x}
    share = (x - x[0]) / max(x[-1] - x[0], 1e-300)
    column = np.minimum((share * columns).astype(int), columns - 1)
    kept = np.isin(x, tx)
    for k in np.unique(column):
        whole, rest = y[column == k], y[(column == k) & kept]
        assert np.isnan(rest).any() == np.isnan(whole).any()
        if np.isfinite(whole).any():
            assert np.nanmin(rest) == np.nanmin(whole)
            assert np.nanmax(rest) == np.nanmax(whole)


def test_a_curve_shows_the_slow_part_and_a_band_the_rest() -> None:
    t = np.arange(0, 20, 0.005)
    slow = np.sin(2 * np.pi * 0.2 * t)
    shown = drawn(t, slow + 0.5 * np.sin(2 * np.pi * 40 * t), 300)
    inside = (shown.t_s > 1) & (shown.t_s < 19)
    true = np.sin(2 * np.pi * 0.2 * shown.t_s)
    assert np.abs(shown.curve - true)[inside].max() < 0.02
    assert shown.band is not None
    assert np.nanmax(shown.band[1]) > 1.45


def test_no_line_bridges_a_gap() -> None:
    t = np.concatenate([np.arange(0, 5, 0.01), np.arange(8, 12, 0.01)])
    shown = drawn(t, np.ones(len(t)), 100)
    gaps = np.flatnonzero(np.isnan(shown.curve))
    assert len(gaps) == 1
    assert shown.t_s[gaps[0] - 1] < 5 <= 8 <= shown.t_s[gaps[0] + 1]


def test_the_bundle_is_the_one_of_its_table_and_its_licence_goes_along() -> None:
    folder = HERE / "vendor"
    source = gzip.decompress((folder / "plotly-basic.min.js.gz").read_bytes())
    table = (folder / "README.md").read_text("utf-8")
    assert hashlib.sha256(source).hexdigest() in table
    (version,) = re.findall(rb"plotly\.js \(basic - minified\) v([\d.]+)", source[:400])
    assert version.decode() in table
    assert "MIT" in (folder / "plotly-LICENSE.txt").read_text("utf-8")
    assert b"</script" not in source.lower()
