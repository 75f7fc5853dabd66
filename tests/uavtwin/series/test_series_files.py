"""Series of results as files: what comes back is what went in, in every form."""

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from series_rigs.mcap_rig import read_mcap

from cosim.master import Recording
from twin.residuals.gap import Channel, FlightGap
from uavtwin.gaps import GapResult, gap_record
from uavtwin.run import Run
from uavtwin.series import files as series_table
from uavtwin.series.files import Column, Series, compared, write_all_series, write_series
from uavtwin.series.mcap import POSE, TF, TF_STATIC

Array = np.ndarray
FORMS = ("parquet", "csv", "mcap")


def made_up(name: str = "flight", n: int = 50) -> Series:
    """Two channels at times of their own; some times are of both."""
    rng = np.random.default_rng(1)
    fast = np.linspace(0.0, 0.02 * (n - 1), n)
    slow = fast[::3] + 1e-12
    acc, twin = rng.standard_normal((2, len(fast)))
    pos, of_twin = rng.standard_normal((2, len(slow)))
    columns = [
        *compared("acc_x", "m/s^2", fast, acc, {"twin": twin}),
        *compared("pos_x", "m", slow, pos, {"twin": of_twin, "explained": pos / 2}, "after 0.5 s"),
    ]
    return Series(name, tuple(columns), {"verb": "gap"})


def from_parquet(path: Path) -> dict[str, dict[int, float]]:
    table = pd.read_parquet(path)
    return {
        c: dict(zip(np.rint(known["time"] * 1e9).astype(int), known[c], strict=True))
        for c in table.columns[1:]
        for known in [table[["time", c]].dropna()]
    }


def from_csv(path: Path) -> dict[str, dict[int, float]]:
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return {
        c: {round(float(r["time"]) * 1e9): float(r[c]) for r in rows if r[c]}
        for c in rows[0]
        if c != "time"
    }


def from_mcap(path: Path) -> dict[str, dict[int, float]]:
    read = read_mcap(path)
    return {
        f"{topic[1:]}.{field}": read.column(topic, field)
        for topic, schema in read.schemas.items()
        for field in schema["properties"]
    }


READ = {"parquet": from_parquet, "csv": from_csv, "mcap": from_mcap}


@pytest.mark.parametrize("form", FORMS)
def test_every_sample_comes_back(form: str, tmp_path: Path) -> None:
    """To the last bit, at its time in ns; no sample where there was none."""
    path, series = tmp_path / f"x.{form}", made_up()
    write_series(series, path)
    read: Callable[[Path], dict[str, dict[int, float]]] = READ[form]
    found = read(path)
    assert set(found) == set(series.names)
    for column in series.columns:
        wanted = dict(zip(np.rint(column.t_s * 1e9).astype(int), column.values, strict=True))
        assert found[column.name] == wanted, column.name


@pytest.mark.parametrize("form", FORMS)
def test_the_same_series_gives_the_same_bytes(form: str, tmp_path: Path) -> None:
    for name in "ab":
        write_series(made_up(), tmp_path / f"{name}.{form}")
    a, b = ((tmp_path / f"{name}.{form}").read_bytes() for name in "ab")
    assert a == b


def test_units_and_meanings_go_along(tmp_path: Path) -> None:
    for form in ("parquet", "mcap"):
        write_series(made_up(), tmp_path / f"x.{form}")
    schema, read = pq.read_schema(tmp_path / "x.parquet"), read_mcap(tmp_path / "x.mcap")
    assert schema.field("time").metadata == {b"unit": b"s"}
    assert schema.field("residual.pos_x").metadata == {b"unit": b"m", b"about": b"after 0.5 s"}
    assert schema.metadata[b"uavtwin"] == b'{"name": "flight", "verb": "gap"}'
    assert read.notes["units"]["residual_explained.pos_x"] == "m"
    assert read.notes["uavtwin"] == {"name": "flight", "verb": "gap"}
    assert read.schemas["/twin"]["properties"]["acc_x"]["description"] == "m/s^2"


def test_a_residual_is_measured_minus_its_side() -> None:
    values = {c.name: c.values for c in made_up().columns}
    for side, residual in (("twin", "residual"), ("explained", "residual_explained")):
        wanted = values["measured.pos_x"] - values[f"{side}.pos_x"]
        np.testing.assert_array_equal(values[f"{residual}.pos_x"], wanted)
    sides = {name.rpartition(".")[0] for name in values}
    assert sides - {"residual_explained"} <= set(series_table.SIDES)


GRID = st.lists(st.integers(0, 30), unique=True, max_size=12).map(sorted)


@pytest.mark.slow
@given(grids=st.lists(GRID, min_size=1, max_size=4), rows=st.integers(1, 7))
def test_blocks_are_the_table(grids: list[list[int]], rows: int) -> None:
    """However few rows a block has, and whatever the times of the columns."""
    columns = tuple(
        Column(f"a.{k}", "1", np.array(g) * 1e-3, np.array(g, dtype=float) + 100 * k)
        for k, g in enumerate(grids)
    )
    parts = list(Series("x", columns).blocks(rows))
    assert all(len(t) <= rows for t, _ in parts)
    times = [t for part, _ in parts for t in part.tolist()]
    assert times == sorted({1_000_000 * t for g in grids for t in g})
    for k, grid in enumerate(grids):
        values = [v for _, block in parts for v in block[k].tolist()]
        known = {t: v for t, v in zip(times, values, strict=True) if np.isfinite(v)}
        assert known == {1_000_000 * t: t + 100.0 * k for t in grid}


def test_a_long_series_is_written_in_blocks(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The same table, in as many row groups."""
    write_series(made_up(), tmp_path / "whole.parquet")
    monkeypatch.setattr(Series.blocks, "__defaults__", (16,))
    write_series(made_up(), tmp_path / "blocks.parquet")
    assert pq.ParquetFile(tmp_path / "blocks.parquet").num_row_groups > 3
    whole, blocks = (pd.read_parquet(tmp_path / f"{n}.parquet") for n in ("whole", "blocks"))
    pd.testing.assert_frame_equal(whole, blocks)


def test_files_are_named_for_their_flights(tmp_path: Path) -> None:
    """Names that make no file name, and two that would make one."""
    every = [made_up(name, 3) for name in ("../day 1/a", ".._day_1_a", "b", "é")]
    written = write_all_series(every, tmp_path, ("parquet",))
    assert written == [f"series/{n}.parquet" for n in ("_day_1_a", "_day_1_a_2", "b", "_")]
    assert sorted(str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*.*")) == sorted(written)
    assert write_all_series([], tmp_path / "none", ("csv",)) == []
    assert not (tmp_path / "none").exists()


def test_residuals_of_a_gap_are_those_of_its_numbers(tmp_path: Path) -> None:
    t, rng = np.arange(0.0, 20.0, 0.02), np.random.default_rng(2)
    measured, simulated = rng.standard_normal((2, len(t)))
    channel = Channel("acc_x", "m/s^2", 0.0, t, measured, simulated, np.full(len(t), "hover"))
    gaps = (FlightGap("flight", "vehicle", (channel,), (("hover", 0.0, 20.0),), (), {}),)
    (path,) = write_all_series(GapResult(gaps).series(), tmp_path, ("parquet",))
    residual = pd.read_parquet(tmp_path / path)["residual.acc_x"]
    told = gap_record(gaps).json()["channels"]["acc_x"]
    assert np.sqrt(np.mean(residual**2)) == pytest.approx(told["rms"], rel=1e-12)
    assert len(residual) == told["n"] and residual.mean() == pytest.approx(told["mean"], rel=1e-9)


def recorded(incomplete: str = "") -> Run:
    names = [*(f"airframe.pos_{a}" for a in "xyz"), *(f"airframe.q_{a}" for a in "wxyz")]
    values = np.random.default_rng(3).standard_normal((5, 8))
    recording = Recording(
        (*names, "mission.phase"), np.linspace(0.0, 0.04, 5), values, incomplete=incomplete
    )
    units = {n: "m" for n in names[:3]} | {"mission.phase": ""}
    return Run("tour", recording, units)


def test_a_recording_keeps_its_units_and_why_it_is_incomplete(tmp_path: Path) -> None:
    run = recorded("a.fmu failed")
    path = run.save(tmp_path / "recording.parquet")
    table, schema = pd.read_parquet(path), pq.read_schema(path)
    pd.testing.assert_frame_equal(table, run.recording.frame())
    assert table.attrs == {"incomplete": "a.fmu failed"}
    assert schema.field("airframe.pos_x").metadata == {b"unit": b"m"}
    assert schema.field("time").metadata == {b"unit": b"s"}
    assert not schema.field("mission.phase").metadata


def test_a_recording_flies_in_mcap(tmp_path: Path) -> None:
    run = recorded("a.fmu failed")
    read = read_mcap(run.save(tmp_path / "recording.mcap"))
    assert set(read.messages) == {"/airframe", "/mission", TF, TF_STATIC, POSE}
    assert list(read.column("/mission", "phase").values()) == run["mission.phase"].tolist()
    told = [[m["pose"]["position"][a] for a in "xyz"] for _, m in read.messages[POSE]]
    np.testing.assert_array_equal(told, run.recording.values[:, :3])
    assert read.notes["uavtwin"]["incomplete"] == "a.fmu failed"
