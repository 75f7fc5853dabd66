"""The last seconds of a flight that goes on, told from arrays."""

import numpy as np
import pandas as pd
import pytest
from sample_logs import flown_table

from twin.errors import LogError
from twin.logs import Flight
from twin.logs.columns import ACC, POS
from twin.residuals.stream import LastRows, Rows


def portions(table: pd.DataFrame, rows: int) -> list[Rows]:
    columns = {str(c): table[c].to_numpy() for c in table}
    starts = range(0, len(table), rows)
    return [{c: v[k : k + rows] for c, v in columns.items()} for k in starts]


def kept(table: pd.DataFrame, rows: int = 70) -> LastRows:
    last = LastRows("flown")
    for portion in portions(table, rows):
        last.append(portion)
    return last


def test_it_says_what_a_table_says() -> None:
    table = flown_table().iloc[:300].copy()
    table["mag_x"] = np.nan
    table.loc[100:, "vbat_v"] = 15.0
    whole, recent = Flight("flown", table), kept(table).flight()
    assert list(recent.columns) == list(table)
    assert {c for c in table if recent.has(c)} == {c for c in table if whole.has(c)}
    for columns in (ACC, POS, ("vbat_v",)):
        for mine, other in zip(recent.signal(columns), whole.signal(columns), strict=True):
            np.testing.assert_array_equal(mine, other)
    assert [*map(list, recent.phase_codes)] == [*map(list, whole.phase_codes)]
    pd.testing.assert_frame_equal(recent.table, table.reset_index(drop=True))
    with pytest.raises(LogError, match="no samples of mag_x"):
        recent.signal(["mag_x"])


def test_a_column_that_comes_later_was_empty_before() -> None:
    early, late = portions(flown_table().iloc[:60], 30)
    last = LastRows("flown")
    last.append({c: v for c, v in early.items() if c not in ("acc_x", "phase")})
    last.append(late)
    rows = last.rows()
    assert len(last) == 60 and np.isnan(rows["acc_x"][:30]).all()
    assert set(rows["phase"][:30]) == {""}
    np.testing.assert_array_equal(rows["acc_x"][30:], late["acc_x"])


def test_older_samples_of_slow_signals_are_kept() -> None:
    """As many as are needed of one, one of each other, and the row whose phase counts."""
    table = flown_table().iloc[:400].copy()
    table["vbat_v"] = np.nan
    table.loc[[10, 20], "vbat_v"] = 15.0
    last = kept(table)
    before_s = float(table["time"].iloc[300])
    last.forget(before_s, {"acc_x": 4})
    t_s = last.rows()["time"]
    assert np.sum(t_s >= before_s) == 100
    old = t_s[t_s < before_s]
    assert table["time"].iloc[20] in old and table["time"].iloc[10] not in old
    known = table["acc_x"].notna().to_numpy()[:300]
    assert set(table["time"].to_numpy()[:300][known][-4:]) <= set(old) and len(old) < 12
