"""What the tables of a fleet say together: in rows in which something, or nothing, is planted."""

import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from cli_rig import run
from fleet_rigs.rows import AIRCRAFT, FLIGHTS, HEAVY, WORN, lines, made_fleet
from page_rigs.browser import VIEWS, browser, faults, needs_browser, pictures

import uavtwin as ut
from twin.errors import TwinError
from uavtwin.fleets.dataset import TABLES, write_dataset
from uavtwin.fleets.fleet import numbers_of_files, write_vehicles
from uavtwin.fleets.query import query
from uavtwin.fleets.result import (
    CELLS,
    HEADER,
    UNKNOWN,
    FleetResult,
    of_logs,
    result_of,
    table_of,
)
from uavtwin.vehicles import load_vehicle


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_fleet(tmp_path_factory.mktemp("fleet"))


@pytest.fixture(scope="module")
def result(folder: Path) -> FleetResult:
    return result_of(folder, "copter_default")


@pytest.mark.slow
def test_what_is_planted_is_told_and_nothing_else(result: FleetResult) -> None:
    assert {(d.aircraft, d.number) for d in result.differing} >= {(HEAVY, "carried")}
    assert {d.aircraft for d in result.differing} <= {HEAVY, WORN}
    assert [(d.aircraft, d.number) for d in result.drifting] == [(WORN, "battery_resistance_ohm")]
    (drift,) = result.drifting
    assert drift.trend.low < 0.01 < drift.trend.high
    assert result.bad == 1
    assert result.claim.startswith(f"{AIRCRAFT * FLIGHTS + 1} logs of {AIRCRAFT} aircraft: ")


def few(folder: Path, keep: tuple[str, ...], carried: float = 1.0) -> FleetResult:
    """Three flights each of some aircraft."""
    rows = [
        line
        for line in lines()
        if (line["flights"][0].get("aircraft", "") in keep and line["job"] < 3 * AIRCRAFT)
    ]
    for line in rows:
        line["flights"][0]["carried"] = carried
    write_dataset(rows, folder)
    return result_of(folder, "copter_default")


@pytest.mark.slow
def test_nothing_compared_is_never_none(tmp_path: Path) -> None:
    """Of three aircraft nothing can be compared: no sentence says that none differs."""
    three = few(tmp_path, ("A01", "A02", "A03"))
    assert not three.differences and not three.drifts
    told = str(three)
    assert "none differ" not in told and "none drift" not in told
    assert "cannot be determined (3 named aircraft, 4 are needed)" in three.claim
    assert "no aircraft has 6 flights whose logs have a date" in three.claim
    assert len(three.cannot) == 2
    three.report(tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert "None of those compared" not in page and "Not determined." in page


def test_logs_that_name_no_aircraft_are_said_to(tmp_path: Path) -> None:
    write_dataset(
        ({"flights": [{"log": f"{k}.csv", "status": "fine", "aircraft": ""}]} for k in range(2)),
        tmp_path,
    )
    claim = result_of(tmp_path, "copter_default").claim
    assert claim.startswith("2 logs of aircraft that no log names: ")
    assert "0 named aircraft, 4 are needed" in claim


def test_four_aircraft_of_which_no_number_is_known_are_not_compared(tmp_path: Path) -> None:
    write_dataset(
        (
            {"flights": [{"log": f"{k}.ulg", "status": "fine", "aircraft": f"A{k % 4}"}]}
            for k in range(8)
        ),
        tmp_path,
    )
    found = result_of(tmp_path, "copter_default")
    assert "no number is known of 4 aircraft" in found.claim


def test_an_aircraft_of_one_flight_does_not_differ(tmp_path: Path) -> None:
    """Far out as it may be: how much its own flights differ is not known."""

    def flights(left_out: set[int]) -> Iterator[dict[str, list[dict[str, object]]]]:
        for k in sorted(set(range(18)) - left_out):
            level = 0.9 if k % 6 == 0 else 0.5 + 0.001 * k
            row = {"log": f"{k}.ulg", "aircraft": f"A{k % 6}", "hover_command": level}
            yield {"flights": [{"status": "fine", **row}]}

    write_dataset(flights(set()), tmp_path / "several")
    (far,) = result_of(tmp_path / "several", "copter_default").differing
    assert (far.aircraft, far.flights) == ("A0", 3)
    write_dataset(flights({0, 6}), tmp_path / "single")
    assert not result_of(tmp_path / "single", "copter_default").differing


@pytest.mark.slow
def test_every_aircraft_and_every_log_has_a_row(result: FleetResult, tmp_path: Path) -> None:
    assert [r.name for r in result.rows] == [f"A{k:02d}" for k in range(1, AIRCRAFT + 1)]
    assert {r.flights for r in result.rows} == {FLIGHTS}
    heavy, first = (next(r for r in result.rows if r.name == n) for n in (HEAVY, "A01"))
    assert set(heavy.named) == {"rotor_drag", "mass_offset"}
    assert not first.named
    cells = dict(zip(HEADER, heavy.cells(), strict=True))
    assert cells["hover"] == "0.500"
    assert (cells["least loaded motor"], cells["most loaded motor"]) == ("2: -4 %", "1: +4 %")
    even = dict(zip(HEADER, replace(heavy, split=(0.001, -0.001)).cells(), strict=True))
    assert even["least loaded motor"] == even["most loaded motor"] == ""
    assert cells["lacks"].startswith("mass offset (")
    assert cells["went wrong"] == "" and CELLS in str(result)
    printed = table_of(result.rows, "aircraft", 20).rows[0]
    assert printed[2] == UNKNOWN and "" not in printed
    three = few(tmp_path, ("A01", "A02", "A03"))
    logs = of_logs(tmp_path)
    assert len(logs) == 9
    assert all(r.name in str(three) for r in (*three.rows, *logs))
    assert [r["aircraft"] for r in three.json()["overview"]] == ["A01", "A02", "A03"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("carried", "fits"), [(1.14, True), (0.86, True), (1.2, False), (0.7, False)]
)
def test_a_file_that_does_not_fit_is_a_finding(tmp_path: Path, carried: float, fits: bool) -> None:
    found = few(tmp_path, ("A01", "A02", "A03"), carried)
    assert bool(found.misfits) is not fits
    assert ("does not fit 3 of them" in found.claim) is not fits
    if not fits:
        said = str(found)
        assert "A01: copter_default does not fit this aircraft" in said
        assert f"it carries {100 * carried:.0f} % of its weight" in said


@pytest.mark.slow
def test_of_a_fleet_without_a_plant_nothing_is_told(tmp_path: Path) -> None:
    silent = result_of(made_fleet(tmp_path, planted=False), "copter_default")
    assert not silent.differing
    assert not silent.drifting
    assert len(silent.drifts) == 7 * AIRCRAFT  # every number was tested


def test_an_effect_of_most_is_of_the_type_and_one_of_one_its_own(
    result: FleetResult, tmp_path: Path
) -> None:
    base = load_vehicle("copter_default")
    files = numbers_of_files(result.spreads, list(result.explained), True)
    written = write_vehicles(files, base, {}, tmp_path)
    assert written == ["copter_default.toml", *(f"A{k:02d}.toml" for k in range(1, 9))]
    shared, heavy, untold = (
        load_vehicle(tmp_path / "vehicles" / f"{n}.toml") for n in ("copter_default", "A04", "A01")
    )
    (drag,) = (s for s in result.spreads if s.effect == "rotor_drag")
    assert len(drag.aircraft) == AIRCRAFT - 1
    key = "effects.rotor_drag.k_xy_1_s"
    assert shared.effects["rotor_drag"]["k_xy_1_s"] == pytest.approx(drag.common.mean, rel=1e-5)
    assert shared.effects["rotor_drag"]["k_xy_1_s"] == pytest.approx(0.35, abs=0.04)
    assert "mass_offset" not in shared.effects
    assert heavy.effects["mass_offset"]["mass_kg"] == pytest.approx(0.1, abs=0.02)
    assert heavy.effects["rotor_drag"]["k_xy_1_s"] != shared.effects["rotor_drag"]["k_xy_1_s"]
    assert untold.effects["rotor_drag"] == shared.effects["rotor_drag"]
    share = {n: v.deviations[key].share for n, v in (("type", shared), ("untold", untold))}
    assert share["untold"] > 1.5 * share["type"]  # the spread between aircraft is in it
    assert "not determined by its own flights" in untold.sources[key]
    alone = numbers_of_files(result.spreads, list(result.explained), False)
    assert not alone.of_type  # each aircraft against its own file
    assert set(alone.of_aircraft["A01"]) == set()


def test_tables_say_units_and_are_as_documented(folder: Path) -> None:
    page = (Path(__file__).parents[3] / "docs" / "reference" / "tables.md").read_text("utf-8")
    for table, columns in TABLES.items():
        schema = pq.read_schema(folder / f"{table}.parquet")
        assert schema.names == [c.name for c in columns]
        for c in columns:
            told = schema.field(c.name).metadata
            assert told == {b"unit": c.unit.encode(), b"meaning": c.meaning.encode()}
            assert f"| `{c.name}` |" in page


@pytest.mark.slow
def test_a_query_joins_tables(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sql = (
        "select aircraft, count(*) as n, avg(carried) as c from flights join effects using "
        "(log, aircraft) where effect = 'mass_offset' group by aircraft"
    )
    ((aircraft, n, carried),) = query(folder, sql).rows
    assert (aircraft, n) == (HEAVY, FLIGHTS)
    assert carried == pytest.approx(1.08, abs=0.02)
    code, out, _ = run(capsys, "query", folder, sql, "--json")
    assert code == 0
    assert json.loads(out) == [{"aircraft": HEAVY, "n": FLIGHTS, "c": carried}]
    code, out, _ = run(capsys, "fleet", folder, "--sql", sql, "--csv")
    assert out.splitlines() == ["aircraft,n,c", f"{HEAVY},{FLIGHTS},{carried}"]
    code, out, _ = run(capsys, "fleet", folder, "--sql", sql)
    assert HEAVY in out


@pytest.mark.slow
def test_a_wide_answer_is_printed_a_cell_per_line(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, _ = run(
        capsys, "fleet", folder, "--sql", "select * from flights order by log limit 2"
    )
    assert code == 0
    (first, second) = out.strip().split("\n\n")
    rows = [line.split(maxsplit=1) for line in first.splitlines()]
    assert rows[0] == ["log", "0000.parquet"] and ["hover_command", "0.5"] in rows
    assert all(len(r) == 2 for r in rows), "no cell is empty"
    assert second.startswith("log") and "0001.parquet" in second


def test_a_query_gives_the_numbers_of_pandas(folder: Path) -> None:
    rows = query(folder, "select log, carried from flights order by log").rows
    flights = pd.read_parquet(folder / "flights.parquet").sort_values("log")
    assert [r[0] for r in rows] == flights["log"].tolist()
    counted = ut.query(folder, "select aircraft, count(*) as n from flights group by aircraft")
    assert dict(counted.rows)[WORN] == FLIGHTS
    assert counted.frame()["n"].sum() == len(flights)
    assert [np.nan if r[1] is None else r[1] for r in rows] == pytest.approx(
        flights["carried"].tolist(), nan_ok=True
    )


@pytest.mark.parametrize(
    ("sql", "says"),
    [
        ("select * from '/etc/passwd'", "There are flights, channels, effects, findings."),
        ("select * from read_csv('/etc/passwd')", "reads nothing but flights"),
        ("select * from read_parquet('{folder}/flights.parquet')", "reads nothing but flights"),
        ("select * from glob('/*')", "reads nothing but flights"),
        ("copy flights to '{folder}/stolen.csv'", "this is not one SELECT"),
        ("attach '{folder}/new.db'", "this is not one SELECT"),
        ("set enable_external_access = true", "this is not one SELECT"),
        ("install httpfs", "this is not one SELECT"),
        ("delete from flights", "this is not one SELECT"),
        ("create table more as select 1", "this is not one SELECT"),
        ("select 1; select 2", "this is not one SELECT"),
        ("", "no SELECT"),
        ("selct", "syntax error"),
        ("select nothing from flights", '"nothing" not found'),
        ("select * from runs", "There are flights, channels, effects, findings."),
        ("select * from folder", "There are flights, channels, effects, findings."),
    ],
)
def test_what_is_no_question_to_the_tables_is_refused(folder: Path, sql: str, says: str) -> None:
    before = sorted(folder.iterdir())
    with pytest.raises(TwinError) as caught:
        query(folder, sql.format(folder=folder))
    assert says in str(caught.value)
    assert str(caught.value).startswith("query: ")
    assert sorted(folder.iterdir()) == before


def test_a_folder_without_tables_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, err = run(capsys, "query", tmp_path, "select 1")
    assert code == 2
    assert "lacks flights.parquet" in err
    code, _, err = run(capsys, "fleet", tmp_path / "none", "--sql", "select 1")
    assert "is no folder" in err
    code, _, err = run(capsys, "fleet", tmp_path, tmp_path, "--sql", "select 1")
    assert code == 2
    assert "asks one folder" in err
    code, _, err = run(capsys, "fleet", tmp_path, "--csv")
    assert code == 2
    assert "--sql" in err


@needs_browser
@pytest.mark.slow
def test_the_page_of_a_fleet_is_fine_to_look_at(result: FleetResult, tmp_path: Path) -> None:
    page = result.report(tmp_path / "report.html")
    with browser(tmp_path / "browser") as opened:
        for view in VIEWS:
            assert faults(opened, page, view, pictures(tmp_path) / f"fleet_{view}.png") == []


@pytest.mark.slow
def test_the_page_says_how_many_were_tried_and_which_is_bad(
    result: FleetResult, tmp_path: Path
) -> None:
    page = result.report(tmp_path / "report.html")
    text = page.read_text("utf-8")
    assert page.stat().st_size < 1_500_000
    assert f"{len(result.differences)} comparisons" in text
    assert "Benjamini and Hochberg" in text
    assert "broken.ulg" in text
    assert "cut off" in text
    assert '<script src="' not in text
    assert "http://" not in text.partition('id="plotly"')[0]


@pytest.mark.parametrize(
    "column",
    [pa.array([{"a": 1}] * 3), pa.array([b"\xff"] * 3), pa.array([1.0, 2.0, 3.0])],
    ids=["struct", "bytes", "numbers"],
)
def test_tables_of_others_are_no_dataset(folder: Path, tmp_path: Path, column: pa.Array) -> None:
    """A table of the name whose columns are others; one with a footer that is cut."""
    for table in TABLES:
        shutil.copy(folder / f"{table}.parquet", tmp_path)
    path = tmp_path / "flights.parquet"
    whole = path.read_bytes()
    pq.write_table(pa.table({"log": column}), path)
    with pytest.raises(TwinError, match=r"flights\.parquet: columns .*are missing, or of another"):
        query(tmp_path, "select log from flights")
    path.write_bytes(whole[:-100])
    with pytest.raises(TwinError, match=r"flights\.parquet: damaged Parquet file"):
        query(tmp_path, "select log from flights")


@pytest.mark.slow
def test_a_query_without_end_is_ended(folder: Path) -> None:
    endless = "with recursive n(i) as (select 1 union all select i + 1 from n) select max(i) from n"
    with pytest.raises(TwinError, match=r"took longer than 0\.2 s, the limit"):
        query(folder, endless, 0.2)
    with pytest.raises(TwinError, match="needs a positive number"):
        query(folder, "select 1", 0.0)
    assert query(folder, "select 1 as one", 0.2).records() == [{"one": 1}]
