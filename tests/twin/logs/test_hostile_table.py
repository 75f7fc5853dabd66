"""Flight tables made to fell the reader: bounded in time and memory, one clear error."""

import io
import json
import time
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from sample_logs import flight_table

from twin.draft.hover import hover_of
from twin.errors import LogError
from twin.logs import Flight, read_flight

LAYOUT = {
    "position": [[1.0, 0.0, 0.0]],
    "direction": [1.0],
    "metric": True,
    "sd": 0.1,
    "source": "",
}
MODE = {"name": "Hold", "start_s": 0}
FILTER = {"sensor": "gyro", "kind": "notch", "frequency_hz": 80.0, "source": ""}
SETPOINT = {
    "columns": ["pos_x", "pos_y", "pos_z"],
    "t_s": [0.0, 1.0],
    "values": [[0.0, None, 1.0]] * 2,
}
LONG = {"t_s": [float(k) for k in range(10_001)], "values": [[0.0] * 3] * 10_001}


def parquet(table: pa.Table) -> bytes:
    file = io.BytesIO()
    pq.write_table(table, file)
    return file.getvalue()


def read(folder: Path, blob: bytes) -> Flight:
    path = folder / "flight"
    path.write_bytes(blob)
    start = time.process_time()
    try:
        return read_flight(path)
    finally:
        assert time.process_time() - start < 5.0


@pytest.mark.slow
def test_a_table_too_large_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    """Equal rows cost next to nothing in the file."""
    part = pa.table({"time": np.zeros(5_000_000, np.float32), "acc_x": np.zeros(5_000_000)})
    file = io.BytesIO()
    with pq.ParquetWriter(file, part.schema) as writer:
        for _ in range(3):
            writer.write_table(part)
    blob = file.getvalue()
    assert len(blob) < 1_000_000
    with pytest.raises(LogError, match="15000000 rows of 2 columns; at most"):
        read(tmp_path, blob)


@pytest.mark.slow
def test_thousands_of_unknown_columns(tmp_path: Path) -> None:
    table = flight_table()
    extra = pd.DataFrame({f"my_own_{i}": np.zeros(len(table)) for i in range(5000)})
    wide = pd.concat([table, extra], axis=1)
    for blob in (parquet(pa.Table.from_pandas(wide)), wide.iloc[:9].to_csv(index=False).encode()):
        found = [f for f in read(tmp_path, blob).findings if "not of the flight table" in f.message]
        assert [f.count for f in found] == [4900]


@pytest.mark.parametrize(
    "noted",
    [
        b"[" * 100_000,
        b"[]",
        b"\xff\xfe",
        json.dumps(
            {"findings": [{"severity": "info", "where": "x", "message": "y", "count": None}]}
        ),
        json.dumps({"findings": [{"severity": "loud", "where": "x", "message": "y"}]}),
        json.dumps({"findings": [{"severity": "info", "where": 3, "message": "y"}]}),
        json.dumps({"site": ["indoors"]}),
        json.dumps({"airframe": {"rotors": [4]}}),
        json.dumps({"airframe": {"layout": LAYOUT | {"position": [[1.0, 0.0]]}}}),
        json.dumps({"airframe": {"layout": LAYOUT | {"direction": [0.5]}}}),
        json.dumps({"airframe": {"layout": LAYOUT | {"direction": "none"}}}),
        json.dumps({"filter_delays_s": {"baro": 0.01}}),
        json.dumps({"filter_delays_s": {"acc": -0.01}}),
        json.dumps({"filter_delays_s": {"gyro": 0.3}}),
        json.dumps({"autopilot": {"modes": [{"name": "Hold", "start_s": "soon"}]}}),
        json.dumps({"autopilot": {"modes": [MODE | {"start_s": 2}, MODE | {"start_s": 1}]}}),
        json.dumps({"autopilot": {"modes": [MODE | {"name": "x" * 301}]}}),
        json.dumps({"autopilot": {"modes": [MODE] * 1001}}),
        json.dumps({"autopilot": {"failsafes": [MODE | {"end_s": -1}]}}),
        json.dumps({"autopilot": {"messages": [{"t_s": 0, "level": "loud", "text": ""}]}}),
        json.dumps({"autopilot": {"messages": [{"t_s": 0, "level": "", "text": ""}] * 2001}}),
        json.dumps({"autopilot": {"filters": [FILTER | {"frequency_hz": 0.0}]}}),
        json.dumps({"autopilot": {"setpoints": [SETPOINT | {"columns": ["acc_x"]}]}}),
        json.dumps({"autopilot": {"setpoints": [SETPOINT, SETPOINT]}}),
        json.dumps({"autopilot": {"setpoints": [SETPOINT | {"t_s": [0.0, 0.0]}]}}),
        json.dumps({"autopilot": {"setpoints": [SETPOINT | {"t_s": [0.0, None]}]}}),
        json.dumps({"autopilot": {"setpoints": [SETPOINT | {"values": [[0, 0, 0], [0, 0]]}]}}),
        json.dumps({"autopilot": {"setpoints": [SETPOINT | {"every": 0}]}}),
        json.dumps({"autopilot": {"setpoints": [SETPOINT | LONG]}}),
    ],
    ids=lambda noted: str(noted)[:60],
)
def test_what_a_writer_noted_is_checked(tmp_path: Path, noted: Any) -> None:
    table = pa.Table.from_pandas(flight_table()).replace_schema_metadata({b"uavtwin": noted})
    flight = read(tmp_path, parquet(table))
    (found,) = [f.message for f in flight.findings if f.where == "file"]
    assert found.startswith("what the writer noted cannot be read")
    assert flight.airframe is None and flight.site is None and flight.autopilot is None


@pytest.mark.parametrize("delays", [{}, {"filter_delays_s": {"acc": 0.0225}}])
def test_a_table_without_the_delay_of_its_low_pass_is_to_be_converted_again(
    tmp_path: Path, delays: dict[str, Any]
) -> None:
    message = "low-passed; its time is 22.5 ms before the time stamp of the log, the delay of it"
    noted = {"findings": [{"severity": "info", "where": "acc", "message": message}]} | delays
    table = pa.Table.from_pandas(flight_table())
    table = table.replace_schema_metadata({b"uavtwin": json.dumps(noted).encode()})
    found = [f.message for f in read(tmp_path, parquet(table)).findings if f.where == "file"]
    assert ["Convert the log again" in m for m in found] == ([] if delays else [True])


def test_what_is_refused_of_the_autopilot_is_nearly_right(tmp_path: Path) -> None:
    noted = {"autopilot": {"modes": [MODE], "filters": [FILTER], "setpoints": [SETPOINT]}}
    table = pa.Table.from_pandas(flight_table())
    table = table.replace_schema_metadata({b"uavtwin": json.dumps(noted).encode()})
    told = read(tmp_path, parquet(table)).autopilot
    assert told is not None and len(told.modes) == len(told.filters) == len(told.setpoints) == 1
    assert np.isnan(told.setpoints[0].values[0]).tolist() == [False, True, False]


@pytest.mark.parametrize("digits", [5, 5000])
def test_a_motor_of_absurd_number_is_no_motor(tmp_path: Path, digits: int) -> None:
    table = flight_table()
    table["cmd_" + "9" * digits] = 0.0
    (found,) = [
        f
        for f in read(tmp_path, parquet(pa.Table.from_pandas(table))).findings
        if "not a column" in f.message
    ]
    assert found.where == ("cmd_" + "9" * digits)[:40]


@pytest.mark.slow
def test_a_cell_of_fifty_megabytes(tmp_path: Path) -> None:
    text = "time,acc_x\n0.0,1\n0.1," + "9" * 50_000_000 + "\n"
    with pytest.raises(LogError, match="line 3 has 50000004 characters"):
        read(tmp_path, text.encode())


@pytest.mark.parametrize("kind", [pa.list_(pa.float64()), pa.timestamp("us"), pa.binary()])
def test_columns_of_something_else_than_numbers(tmp_path: Path, kind: pa.DataType) -> None:
    table = pa.table({"time": pa.nulls(9, kind), "acc_x": np.zeros(9)})
    with pytest.raises(LogError, match="column time holds"):
        read(tmp_path, parquet(table))


@pytest.mark.slow
def test_a_text_in_many_rows_is_held_once(tmp_path: Path) -> None:
    """200 MB of one phase; the memory that reading takes is measured."""
    n = 4000
    phase = pa.array(["x" * 50_000]).take(pa.array(np.zeros(n, np.int32)))
    table = pa.table({"time": 0.01 * np.arange(n), "acc_x": np.ones(n), "phase": phase})
    blob = parquet(table)
    del table, phase
    held = pa.default_memory_pool()
    before = held.bytes_allocated()
    tracemalloc.start()
    with pytest.raises(LogError, match=r"unknown phase 'x{40}'"):
        read(tmp_path, blob)
    assert tracemalloc.get_traced_memory()[1] < 50e6
    tracemalloc.stop()
    assert held.bytes_allocated() - before < 50e6


def with_column(name: str, column: pa.Array) -> pa.Table:
    table = pa.Table.from_pandas(flight_table(), preserve_index=False)
    return table.append_column(name, column)


ROWS = len(flight_table())
DEEP = pa.array(np.zeros(ROWS))
for _ in range(90):
    DEEP = pa.StructArray.from_arrays([DEEP], ["s"])


@pytest.mark.parametrize(
    "column",
    [
        pa.array([{"a": [1]}] * ROWS),
        pa.array([[1, 2]] * ROWS),
        pa.array([[("a", 1)]] * ROWS, type=pa.map_(pa.string(), pa.int64())),
        pa.array([b"\xff"] * ROWS),
        DEEP,
    ],
    ids=["struct", "list", "map", "bytes", "deep"],
)
def test_columns_of_others_may_hold_anything(tmp_path: Path, column: pa.Array) -> None:
    """They are named and not read; where one has the name of a signal, it is refused."""
    flight = read(tmp_path, parquet(with_column("foo", column)))
    assert [f.where for f in flight.findings if "not a column" in f.message] == ["foo"]
    with pytest.raises(LogError, match=r"column baro_pa holds|deeply nested"):
        read(tmp_path, parquet(with_column("baro_pa", column)))


def test_a_name_that_is_no_text(tmp_path: Path) -> None:
    blob = parquet(with_column("foo_bar", pa.array(np.zeros(ROWS))))
    with pytest.raises(LogError, match=r"flight: damaged Parquet file .a column name is not UTF-8"):
        read(tmp_path, blob.replace(b"foo_bar", b"\xff\xfe\xfa_bar"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("metadata", "said"),
    [
        ({b"k" * (17 << 20): b"v"}, "the footer of this Parquet file has"),
        ({b"k": b"v" * (5 << 20)}, "damaged Parquet file"),
        ({f"{k}".encode(): b"" for k in range(100_001)}, "damaged Parquet file"),
    ],
)
def test_metadata_of_a_table_has_a_bound(
    tmp_path: Path, metadata: dict[bytes, bytes], said: str
) -> None:
    table = pa.Table.from_pandas(flight_table(), preserve_index=False)
    blob = parquet(table.replace_schema_metadata(metadata))
    with pytest.raises(LogError, match=said):
        read(tmp_path, blob)


def test_commands_that_are_zero_in_flight_are_a_finding(tmp_path: Path) -> None:
    frame = flight_table().assign(phase="hover")
    frame["time"] = 0.01 * np.arange(ROWS)
    frame = pd.concat([frame] * (500 // ROWS + 1), ignore_index=True)
    frame["time"] = 0.01 * np.arange(len(frame))
    for i in range(1, 5):
        frame[f"cmd_{i}"] = 0.0
    flight = read(tmp_path, parquet(pa.Table.from_pandas(frame, preserve_index=False)))
    (found,) = [f for f in flight.findings if f.where == "cmd"]
    assert found.severity == "error" and "all 0 for" in found.message
    assert hover_of(flight) is None
