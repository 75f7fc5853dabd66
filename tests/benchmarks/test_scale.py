"""Verbs against length of flight: the flights that are made, its slopes, and its children."""

import json
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from benchmarks.speed import scale
from benchmarks.speed.scale import Took, run_scale, slope, took, write_long
from twin.errors import TwinError
from uavtwin.record import plain


def flown(rows: int) -> pd.DataFrame:
    """A flight that ends where it began."""
    t = np.arange(rows) / 200.0
    return pd.DataFrame({"time": t, "pos_x": np.sin(2 * np.pi * np.arange(rows) / rows)})


def test_a_long_flight_goes_on_where_it_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scale, "ROWS_OF_GROUP", 500)
    short = flown(700)
    path = tmp_path / "long.parquet"
    write_long(short, 200.0, 0.1, path)
    long = pq.read_table(path).to_pandas()
    assert pq.read_metadata(path).num_row_groups == 3
    np.testing.assert_allclose(long["time"], np.arange(1200) / 200.0, atol=1e-12)
    np.testing.assert_array_equal(long["pos_x"][700:], short["pos_x"][:500])
    assert np.abs(np.diff(long["pos_x"])).max() < 0.01


def test_slopes_are_those_of_a_straight_line() -> None:
    runs = [Took("gap", m, 9.9, 3.0 + 2.0 * m, 150.0 + 5.0 * m) for m in (1.0, 2.0, 7.0)]
    found = slope(runs)
    assert found.verb == "gap"
    assert found.processor_s_per_min == pytest.approx(2.0)
    assert found.mb_per_min == pytest.approx(5.0)
    assert math.isnan(slope(runs[:1]).mb_per_min)


@pytest.mark.parametrize(
    ("minutes", "rate_hz", "what"),
    [([], 200.0, "--minutes"), ([1e9], 200.0, "--minutes"), ([1.0], 300.0, "--rate 300")],
)
def test_what_cannot_be_flown_is_refused(minutes: list[float], rate_hz: float, what: str) -> None:
    with pytest.raises(TwinError, match=what):
        run_scale(minutes, rate_hz)


@pytest.mark.slow
def test_children_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scale, "short_flight", lambda rate_hz: flown(700).assign(pos_y=0.0))
    found = run_scale([0.2, 0.1], 200.0, ("read", "check"))
    assert [(t.verb, t.minutes) for t in found.runs] == [
        ("read", 0.1),
        ("read", 0.2),
        ("check", 0.1),
        ("check", 0.2),
    ]
    assert all(30.0 < t.peak_mb < 1500.0 and t.processor_s > 0.05 for t in found.runs)
    assert [s.verb for s in found.slopes] == ["read", "check"]
    json.dumps(plain(found), allow_nan=False)


@pytest.mark.slow
def test_a_verb_that_fails_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "f.parquet"
    path.write_bytes(b"PAR1")
    with pytest.raises(TwinError, match="check of 1 min: "):
        took("check", 1.0, path)
