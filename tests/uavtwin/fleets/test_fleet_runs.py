"""Fleets that are looked at: every log once, whatever is killed, by whatever engine."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
from cli_rig import run
from job_rigs.clusters import local_cluster
from job_rigs.killing import killed_beyond

import uavtwin as ut
from benchmarks.fleet.flights import aircraft_of, flown
from twin.errors import TwinError
from twin.logs import write_flight
from twin.vehicle_file import load_vehicle
from uavtwin.demo.in_flight import damaged_flight
from uavtwin.fleets.dataset import JOURNAL
from uavtwin.fleets.fleet import found_logs

pytestmark = pytest.mark.slow
FLIGHTS = 12
FILES = ("flights", "channels", "effects", "findings")
COMMAND = [*(sys.executable, "-c", "from uavtwin.cli.main import main; main()"), "fleet"]
OPTIONS = ["--vehicle", "copter_default", "--verbs", "check"]


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Parts of one flight as flights of three aircraft, and logs of no use."""
    folder = tmp_path_factory.mktemp("logs")
    flight = flown(aircraft_of(5)[4], 0.0, 1, 9.0)
    for k in range(FLIGHTS):
        facts = {"aircraft": f"autopilot {k % 3}", "airframe": "x"}
        path = folder / f"day_{k // 3}" / f"flight_{k}.parquet"
        path.parent.mkdir(exist_ok=True)
        write_flight(replace(flight.between(0.0, 8.0 + 0.05 * k), facts=facts), path)
    (folder / "bad").mkdir()
    whole = (folder / "day_0" / "flight_0.parquet").read_bytes()
    (folder / "bad" / "cut.parquet").write_bytes(whole[:-300])
    (folder / "bad" / "empty.ulg").write_bytes(b"")
    (folder / "bad" / "head.ulg").write_bytes(bytes(range(256)))
    (folder / "z_twice.parquet").write_bytes(whole)
    (folder / "README.txt").write_text("no log")
    (folder / "index.csv").write_text('log,pilot\nday_0/flight_0,"A, B"\n')
    (folder / "times.csv").write_text("time,pilot\n0.0,A\n1.0,B\n")
    return folder


@pytest.fixture(scope="module")
def whole(logs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("whole") / "out"
    found = ut.fleet(logs, "copter_default", out=out, verbs=["check"], workers=1)
    assert found.aircraft == {f"{k}, x": 4 for k in range(3)}
    return out


def same(a: Path, b: Path) -> None:
    for name in FILES:
        assert (a / f"{name}.parquet").read_bytes() == (b / f"{name}.parquet").read_bytes(), name
    for name in ("fleet.json", "report.html"):
        assert (a / name).read_bytes() == (b / name).read_bytes(), name


def test_every_log_has_one_row_and_a_bad_one_its_reason(logs: Path, whole: Path) -> None:
    flights = pd.read_parquet(whole / "flights.parquet")
    assert flights["log"].tolist() == [log.name for log in found_logs([logs])]
    status = dict(zip(flights["log"], flights["status"], strict=True))
    assert status.pop("bad/cut.parquet") == status.pop("bad/empty.ulg") == "unreadable"
    assert status.pop("bad/head.ulg") == "unreadable"
    assert status.pop("z_twice.parquet") == "copy"
    assert status.pop("index.csv") == status.pop("times.csv") == "no log"
    assert set(status.values()) <= {"fine", "findings"}
    errors = flights.set_index("log")["error"]
    assert "the file is empty (0 bytes)" in errors["bad/empty.ulg"]
    assert errors["z_twice.parquet"] == (
        "holds the same flight as day_0/flight_0.parquet, which counts once"
    )
    assert not (whole / JOURNAL).exists()


def test_a_killed_fleet_goes_on_and_no_log_is_lost_or_twice(
    logs: Path, whole: Path, tmp_path: Path
) -> None:
    """And the number of workers changes no byte."""
    out = tmp_path / "killed"
    command = [*COMMAND, str(logs), *OPTIONS, "--out", str(out), "--workers"]
    for wanted in (2, 9):
        assert killed_beyond([*command, "1"], out / JOURNAL, wanted)
    with (out / JOURNAL).open("a") as journal:
        journal.write('{"job": 5, "fli')  # a kill in the middle of a line
    done = subprocess.run([*command, "2"], capture_output=True, text=True)
    assert done.returncode == 1, done.stderr  # bad logs are findings
    same(out, whole)


@pytest.mark.filterwarnings("ignore")
def test_a_cluster_finds_the_same(logs: Path, whole: Path, tmp_path: Path) -> None:
    with local_cluster(1) as address:
        ut.fleet(
            logs,
            "copter_default",
            out=tmp_path / "o",
            verbs=["check"],
            engine="dask",
            scheduler=address,
        )
    same(tmp_path / "o", whole)


def test_a_log_that_takes_too_long_costs_its_row(
    logs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = logs / "day_0" / "flight_0.parquet"
    code, out, _ = run(
        capsys,
        *("fleet", log, *OPTIONS, "--time-limit", "0.001", "--out", tmp_path / "o", "--json"),
    )
    assert code == 1
    assert json.loads(out)["statuses"] == {"failed": 1}
    (row,) = pd.read_parquet(tmp_path / "o" / "flights.parquet").to_dict("records")
    assert row["error"] == "took longer than 0.001 s, the limit (--time-limit)"


def test_what_an_aircraft_lacks_goes_into_its_file_and_is_gone_with_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With it, the gap shrinks."""
    log = tmp_path / "logs" / "one.parquet"
    log.parent.mkdir()
    write_flight(flown(aircraft_of(5)[4], 0.0, 3, 12.0), log)
    first, second = tmp_path / "first", tmp_path / "second"
    each = ("--each", "aircraft", "--workers", "1")
    code, said, _ = run(
        capsys, "fleet", log.parent, "--vehicle", "copter_default", *each, "--out", first
    )
    assert code == 1
    assert "rotor_drag.k_xy_1_s" in said
    own = ut.load_vehicle(first / "vehicles" / "A05_made_copter.toml")
    assert own.effects["rotor_drag"]["k_xy_1_s"] == pytest.approx(0.35, abs=0.1)
    assert not ut.load_vehicle(first / "vehicles" / "copter_default.toml").effects
    own_files = ("--per-aircraft", first / "vehicles", "--verbs", "gap", "--workers", "1")
    code, _, _ = run(capsys, "fleet", log.parent, *own_files, "--out", second)
    assert code == 0
    (flight,) = pd.read_parquet(second / "flights.parquet").to_dict("records")
    assert flight["status"] == "fine"
    gaps = [
        pd.read_parquet(f / "channels.parquet").query("channel == 'acc_x' and horizon_s == 0")
        for f in (first, second)
    ]
    before, after = (float(g[g["phase"] == "whole flight"]["rms"].iloc[0]) for g in gaps)
    assert after < 0.5 * before


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({}, "neither of --vehicle and --per-aircraft"),
        ({"verbs": ["gap"]}, "check and why need none"),
        ({"vehicle": "copter_default", "verbs": ["gap", "chek"]}, "chek"),
        ({"vehicle": "copter_defalt"}, "copter_default"),
        ({"vehicle": "copter_default", "each": "day"}, "day"),
    ],
)
def test_what_cannot_be_done_is_refused_before_anything_is(
    given: dict[str, object], says: str, logs: Path, tmp_path: Path
) -> None:
    with pytest.raises(TwinError) as caught:
        ut.fleet(logs, out=tmp_path / "out", **given)  # type: ignore[arg-type]
    assert says in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_places_without_logs_are_named(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for given, says in (("empty", "holds no logs"), ("none.ulg", "there is no such file")):
        with pytest.raises(TwinError, match=says):
            ut.fleet(tmp_path / given, "copter_default", out=tmp_path / "out")
    with pytest.raises(TwinError, match="no log matches this pattern"):
        ut.fleet(tmp_path / "*.ulg", "copter_default", out=tmp_path / "out")


def test_a_fleet_of_files_that_are_no_logs_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text("time,pilot\n0.0,A\n")
    out = tmp_path / "out"
    code, _, err = run(capsys, "fleet", tmp_path, "--verbs", "check", "--out", out)
    assert code == 2
    assert "a.csv: no log: " in err
    assert "fleet: none of 2 files is a log. a.csv: " in err
    assert not (out / "fleet.json").exists()


def test_why_needs_no_vehicle(tmp_path: Path) -> None:
    """A sound flight, and one whose rotor 3 loses thrust: causes in the row of each."""
    logs = tmp_path / "logs"
    logs.mkdir()
    damaged = damaged_flight(load_vehicle("copter_default"), 15.0, 0.4, 30.0)
    for name, flight in {"damaged": damaged, "sound": damaged.between(0.0, 14.0)}.items():
        write_flight(flight, logs / f"{name}.parquet")
    found = ut.fleet(logs, out=tmp_path / "out", verbs=["why"], workers=1)
    rows = pd.read_parquet(tmp_path / "out" / "flights.parquet").set_index("log")
    assert rows.loc["damaged.parquet", ["status", "why", "causes"]].tolist() == [
        *("fine", "found"),
        "rotor failure, rotor 3",
    ]
    assert rows.loc["sound.parquet", "causes"] in (None, "")
    assert "rotor failure, rotor 3" in str(found)
    assert ": 1 of 2 flights went wrong, " in found.claim
    assert (found.json()["diagnosed"], found.json()["went_wrong"]) == (2, 1)
    assert "logs that are fine" in (tmp_path / "out" / "report.html").read_text("utf-8")
