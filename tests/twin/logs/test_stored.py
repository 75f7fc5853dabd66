"""A flight that stays in its file says what the same flight says in memory, to the bit."""

import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sample_logs import flown_table

from twin.errors import LogError
from twin.logs import Flight, StoredFlight, open_flight, read_flight
from twin.logs import table as table_module
from twin.logs.columns import ACC, GYRO, POS, QUAT, motor_columns
from twin.residuals.measured import measured_motion


@pytest.fixture(autouse=True)
def keep_all_in_files(monkeypatch: pytest.MonkeyPatch) -> None:
    """However small they are."""
    monkeypatch.setattr(table_module, "HELD_CELLS", 0)


def write(table: pd.DataFrame, folder: Path, rows_of_group: int = 999) -> Path:
    path = folder / "f.parquet"
    content = pa.Table.from_pandas(table, preserve_index=False)
    pq.write_table(content, path, row_group_size=rows_of_group)
    return path


def both(table: pd.DataFrame, folder: Path) -> tuple[StoredFlight, Flight]:
    path = write(table, folder)
    stored = open_flight(path)
    assert isinstance(stored, StoredFlight)
    return stored, read_flight(path)


def faults() -> dict[str, Callable[[pd.DataFrame], None]]:
    """What makes a finding, by name."""

    def beyond(f: pd.DataFrame) -> None:
        f.loc[700, "acc_y"] = 1e5

    def overflow(f: pd.DataFrame) -> None:
        f.loc[10:14, "cmd_2"] = 1.02

    def long_quaternion(f: pd.DataFrame) -> None:
        f.loc[400:900, list(QUAT)] *= 1.01

    def partial(f: pd.DataFrame) -> None:
        f.loc[5, "gyro_z"] = np.nan

    def paused(f: pd.DataFrame) -> None:
        f.loc[300:420, list(GYRO)] = np.nan

    def frozen(f: pd.DataFrame) -> None:
        f.loc[200:700, list(ACC)] = f.loc[200, list(ACC)].to_numpy()

    def upside(f: pd.DataFrame) -> None:
        f["acc_z"] *= -1.0

    def empty(f: pd.DataFrame) -> None:
        f["pos_x"] = np.nan

    def slow(f: pd.DataFrame) -> None:
        f.loc[f.index % 20 != 3, list(POS)] = np.nan

    def half_rate_attitude(f: pd.DataFrame) -> None:
        f.loc[f.index % 2 == 0, list(QUAT)] = np.nan
        f.loc[f.index % 4 == 1, list(QUAT)] *= -1.0

    def none(f: pd.DataFrame) -> None:
        pass

    return {k: v for k, v in locals().items() if callable(v)}


@pytest.mark.slow
@pytest.mark.parametrize("fault", faults())
def test_it_says_what_it_says_in_memory(fault: str, tmp_path: Path) -> None:
    table = flown_table()
    faults()[fault](table)
    stored, held = both(table, tmp_path)
    assert stored.findings == held.findings
    assert fault != "none" or held.findings == ()
    assert stored.facts == held.facts
    assert [*stored.columns] == [*held.columns]
    for column in held.table:
        np.testing.assert_array_equal(stored.columns[column], held.table[column])
        assert stored.has(column) == held.has(column), column
    pd.testing.assert_frame_equal(stored.between(2.0, 7.5).table, held.between(2.0, 7.5).table)
    for columns in (ACC, QUAT, motor_columns("cmd", 4)):
        for one, other in zip(stored.signal(columns), held.signal(columns), strict=True):
            np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("fault", ["none", "slow", "paused", "half_rate_attitude"])
def test_signals_at_any_time(fault: str, tmp_path: Path) -> None:
    """Rows around a time are enough to interpolate and to hold, before and after the record, too;
    quaternions have the sign of their neighbours."""
    table = flown_table()
    faults()[fault](table)
    motions = [measured_motion(f) for f in both(table, tmp_path)]
    assert motions[0].notes == motions[1].notes
    end_s = float(table["time"].iloc[-1])
    rng = np.random.default_rng(0)
    for name in ("position", "velocity", "attitude", "rates"):
        one, other = (getattr(m, name) for m in motions)
        assert one.rate_hz == other.rate_hz
        np.testing.assert_array_equal(one.values, other.values)
        for _ in range(20):
            begin_s, last_s = np.sort(rng.uniform(-1.0, end_s + 1.0, 2))
            t_s = np.linspace(begin_s, last_s, 17)
            np.testing.assert_array_equal(one.at(t_s), other.at(t_s))
            np.testing.assert_array_equal(one.held(t_s), other.held(t_s))


@pytest.mark.slow
@settings(max_examples=20)
@given(first=st.integers(0, 3100), length=st.integers(0, 3100))
def test_any_rows(tmp_path_factory: pytest.TempPathFactory, first: int, length: int) -> None:
    stored, held = both(flown_table(), tmp_path_factory.mktemp("t"))
    time = held.time_s
    start_s = time[min(first, len(time) - 1)]
    end_s = time[min(first + length, len(time) - 1)]
    part = stored.between(start_s, end_s)
    pd.testing.assert_frame_equal(part.table, held.between(start_s, end_s).table)


@pytest.mark.parametrize(
    ("column", "row", "value"),
    [("time", 900, 1.0), ("gyro_y", 7, np.inf), ("cmd_1", 800, 1400.0), ("q_w", 3, 0.5)],
)
def test_it_is_refused_with_the_same_words(
    column: str, row: int, value: float, tmp_path: Path
) -> None:
    table = flown_table()
    table.loc[row, column] = value
    path = write(table, tmp_path)
    errors = []
    for read in (open_flight, read_flight):
        with pytest.raises(LogError) as error:
            read(path)
        errors.append(str(error.value))
    assert errors[0] == errors[1]


def test_what_has_to_be_turned_first_is_read_whole(tmp_path: Path) -> None:
    euler = flown_table().drop(columns=list(QUAT))
    euler = euler.assign(roll_rad=0.0, pitch_rad=0.0, yaw_rad=0.1)
    assert isinstance(open_flight(write(euler, tmp_path)), Flight)


def test_other_formats_and_no_file_are_left_to_the_reader(tmp_path: Path) -> None:
    path = tmp_path / "f.csv"
    flown_table().to_csv(path, index=False)
    assert isinstance(open_flight(path), Flight)
    with pytest.raises(LogError, match="there is no such file"):
        open_flight(tmp_path / "none.parquet")


def test_a_file_cut_short_is_damaged(tmp_path: Path) -> None:
    path = write(flown_table(), tmp_path)
    blob = path.read_bytes()
    path.write_bytes(blob[: len(blob) // 2])
    with pytest.raises(LogError, match="damaged Parquet file"):
        open_flight(path)


def test_a_part_that_is_damaged_is_told_when_it_is_read(tmp_path: Path) -> None:
    path = write(flown_table(), tmp_path)
    stored = open_flight(path)
    names = pq.read_schema(path).names
    chunk = pq.read_metadata(path).row_group(1).column(names.index("acc_x"))
    header = chunk.dictionary_page_offset or chunk.data_page_offset
    blob = bytearray(path.read_bytes())
    blob[header : header + 40] = b"\xff" * 40
    path.write_bytes(blob)
    with pytest.raises(LogError, match="damaged Parquet file"):
        stored.signal(ACC)


@pytest.mark.slow
def test_memory_is_that_of_a_few_columns(tmp_path: Path) -> None:
    """Opened and checked, the table as a whole is never there."""
    short = flown_table()
    rows = 60_000
    table = short.iloc[np.arange(rows) % len(short)].assign(time=0.01 * np.arange(rows))
    path = write(table, tmp_path, 20_000)
    whole = table.drop(columns="phase").to_numpy().nbytes
    del table
    tracemalloc.start()
    try:
        stored = open_flight(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert isinstance(stored, StoredFlight)
    assert peak < whole, peak / whole
