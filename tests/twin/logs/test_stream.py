"""A flight table that grows in its file, cut off anywhere."""

from pathlib import Path

import numpy as np
import pytest
from sample_logs import flown_table

from twin.errors import LogError
from twin.logs import open_flight, read_flight
from twin.logs.flight import Notes, Settled
from twin.logs.table import CUT, TableStream, flight_schema, fold, noted

SETTLED = Settled({"acc_x": 190.25}, -0.1)


def written(path: Path, rows: int = 500, batch: int = 100) -> list[int]:
    """Sizes of the file after each batch."""
    table, sizes = flown_table().iloc[:rows], []
    stream = TableStream(path, flight_schema(4))
    for first in range(0, rows, batch):
        part = table.iloc[first : first + batch]
        notes = Notes(facts={"n": str(first)}, settled=SETTLED)
        stream.append({str(c): part[c].to_numpy() for c in part}, noted(notes))
        sizes.append(path.stat().st_size)
    stream.close()
    return sizes


def test_what_was_written_is_read(tmp_path: Path) -> None:
    path = tmp_path / "flight.arrows"
    written(path)
    flight, table = read_flight(path), flown_table().iloc[:500]
    assert flight.facts["n"] == "400" and flight.settled == SETTLED
    assert "rotor_1" not in flight.table and not flight.findings
    for column in table:
        assert flight.table[column].tolist() == table[column].tolist()


@pytest.mark.parametrize("more", [0, 1, 100, 5000])
def test_cut_off_it_is_whole_up_to_the_last_batch(tmp_path: Path, more: int) -> None:
    path = tmp_path / "flight.arrows"
    sizes = written(path)
    blob = path.read_bytes()
    path.write_bytes(blob[: sizes[2] + more])
    flight = read_flight(path)
    assert len(flight.table) == 300 and flight.facts["n"] == "200"
    assert [f.message for f in flight.findings if f.where == "file"] == [CUT]


def test_cut_within_its_first_batch_it_says_so(tmp_path: Path) -> None:
    path = tmp_path / "flight.arrows"
    written(path, 100)
    path.write_bytes(path.read_bytes()[:1500])
    with pytest.raises(LogError, match="no whole batch"):
        read_flight(path)


def test_folded_it_is_the_same_flight(tmp_path: Path) -> None:
    stream, parquet = tmp_path / "flight.arrows", tmp_path / "flight.parquet"
    written(stream)
    before = read_flight(stream)
    assert fold(stream, parquet) == 500 and not stream.exists()
    after = read_flight(parquet)
    assert after.fingerprint == before.fingerprint and after.settled == SETTLED
    assert {k: v for k, v in after.facts.items() if k != "format"} == {"n": "400"}
    assert open_flight(parquet).settled == SETTLED
    assert [p.name for p in tmp_path.iterdir()] == ["flight.parquet"]


def test_without_rows_nothing_is_left(tmp_path: Path) -> None:
    stream = TableStream(tmp_path / "flight.arrows", flight_schema(4))
    stream.close()
    assert fold(stream.path, tmp_path / "flight.parquet") == 0
    assert not list(tmp_path.iterdir())


def test_a_file_that_is_there_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "flight.arrows").touch()
    with pytest.raises(LogError, match=r"flight\.arrows: cannot be written"):
        TableStream(tmp_path / "flight.arrows", flight_schema(4))


def test_a_rate_that_is_none_is_not_taken_over(tmp_path: Path) -> None:
    path = tmp_path / "flight.arrows"
    stream = TableStream(path, flight_schema(4))
    table = flown_table().iloc[:10]
    wrong = Notes(settled=Settled({"acc_x": -1.0}))
    stream.append({str(c): table[c].to_numpy() for c in table}, noted(wrong))
    stream.close()
    flight = read_flight(path)
    assert flight.settled is None
    assert any("cannot be read" in f.message for f in flight.findings)
    assert np.isfinite(flight.table["acc_x"]).all()
