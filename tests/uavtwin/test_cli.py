"""The command line as a user meets it: exit codes, messages, files."""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from cli_rig import run

from twin.logs import read_flight, write_flight
from twin.logs.airframe import Airframe
from twin.vehicle import layouts
from twin.vehicle_file import load_vehicle, vehicle_text
from uavtwin.cli import main
from uavtwin.cli.printing import print_sections, print_table
from uavtwin.cli.results import write_tables
from uavtwin.demo.flights import fly
from uavtwin.display import TextTable
from uavtwin.record import Record

VEHICLE = "copter_default"


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A flight table of a built-in flight."""
    path = tmp_path_factory.mktemp("flight") / "flight.parquet"
    vehicle = load_vehicle(VEHICLE)
    write_flight(fly(vehicle, vehicle.with_mass(1.1 * vehicle.mass_kg), seed=3), path)
    return path


@pytest.mark.slow
def test_gap_writes_its_files(
    capsys: pytest.CaptureFixture[str], table: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    code, said, _ = run(capsys, "gap", table, "--vehicle", VEHICLE, "--tables", "--out", out)
    assert code == 0
    assert "acc_z" in said.splitlines()[0]
    files = {"gap.json", "report.html", "run.json", "series", "tables"}
    assert {p.name for p in out.iterdir()} == files
    assert [p.name for p in (out / "series").iterdir()] == ["flight.parquet"]
    gap = json.loads((out / "gap.json").read_text())
    # To hover 10 % heavier takes 10 % more thrust: the twin expects 0.1 g too much of it.
    assert gap["channels"]["acc_z"]["mean"] == pytest.approx(0.1 * 9.80665, rel=0.05)
    assert set(gap) >= {"flights", "channels", "warnings"}
    channels = pd.read_csv(out / "tables" / "channels.csv", index_col="name")
    assert channels.at["acc_z", "mean"] == gap["channels"]["acc_z"]["mean"]
    assert channels.at["acc_z", "rms_ci95.2"] == gap["channels"]["acc_z"]["rms_ci95"][1]
    bands = pd.read_csv(out / "tables" / "channels.bands.csv").query("of == 'acc_z'")
    told = [b["residual_rms"] for b in gap["channels"]["acc_z"]["bands"]]
    assert bands["residual_rms"].tolist() == told
    phases = pd.read_csv(out / "tables" / "channels.by_phase.csv").query("of == 'acc_z'")
    by_phase = {k: p["rms"] for k, p in gap["channels"]["acc_z"]["by_phase"].items()}
    assert dict(zip(phases["name"], phases["rms"], strict=True)) == by_phase
    assert not [t for t in (out / "tables").iterdir() if "[" in t.read_text("utf-8")]
    assert len(pd.read_csv(out / "tables" / "worst.csv")) == len(gap["worst"])
    record = json.loads((out / "run.json").read_text())
    assert record["verb"] == "gap"
    assert [i["name"] for i in record["inputs"]] == ["flight.parquet"]
    assert len(record["inputs"][0]["sha256"]) == 64


@pytest.mark.slow
def test_the_same_run_gives_the_same_bytes(
    capsys: pytest.CaptureFixture[str], table: Path, tmp_path: Path
) -> None:
    for name in ("a", "b"):
        forms = ("--csv", "--mcap", "--out", tmp_path / name)
        run(capsys, "gap", table, "--vehicle", VEHICLE, *forms)
    assert len(list((tmp_path / "a" / "series").iterdir())) == 2
    series = ("series/flight.csv", "series/flight.mcap")
    for file in ("gap.json", "report.html", "run.json", *series):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes(), file


@pytest.mark.slow
def test_gap_needs_no_compiler(table: Path, tmp_path: Path) -> None:
    """Nothing on the path, no program started, neither FMU builder nor units library loaded."""
    code = """
import sys
def refuse(event, arguments):
    if event in ("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn"):
        raise SystemExit(f"{event}: {arguments}")
sys.addaudithook(refuse)
from uavtwin.cli.main import main
try:
    main()
finally:
    assert not {"fmus", "cosim", "pint"} & set(sys.modules), sorted(sys.modules)
"""
    call = [sys.executable, "-c", code, "gap", str(table), "--vehicle", VEHICLE]
    environment = {k: v for k, v in os.environ.items() if k not in ("PATH", "CC", "CXX")}
    done = subprocess.run(
        [*call, "--out", str(tmp_path / "o")],
        env={**environment, "PATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    channels = json.loads((tmp_path / "o" / "gap.json").read_text())["channels"]
    assert channels["vel_z"]["horizon_s"] == 0.5


@pytest.mark.slow
def test_gap_prints_strict_json(
    capsys: pytest.CaptureFixture[str], table: Path, tmp_path: Path
) -> None:
    code, said, _ = run(
        capsys, "gap", table, "--vehicle", VEHICLE, "--out", tmp_path / "o", "--json"
    )
    assert code == 0
    assert json.loads(said, parse_constant=pytest.fail) == json.loads(
        (tmp_path / "o" / "gap.json").read_text()
    )


@pytest.mark.slow
def test_an_output_folder_that_holds_files_is_kept(
    capsys: pytest.CaptureFixture[str], table: Path, tmp_path: Path
) -> None:
    (tmp_path / "precious.txt").write_text("mine")
    code, _, said = run(capsys, "gap", table, "--vehicle", VEHICLE, "--out", tmp_path)
    assert code == 2
    assert "--force" in said
    assert [p.name for p in tmp_path.iterdir()] == ["precious.txt"]
    code, _, _ = run(capsys, "gap", table, "--vehicle", VEHICLE, "--out", tmp_path, "--force")
    assert code == 0
    assert (tmp_path / "precious.txt").read_text() == "mine"


@pytest.mark.slow
def test_an_interrupted_gap_writes_nothing(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    table: Path,
    tmp_path: Path,
) -> None:
    def interrupt(_: object, path: Path, *__: object) -> None:
        """Half a report, then Ctrl-C."""
        path.write_text("<html>")
        raise KeyboardInterrupt

    monkeypatch.setattr("uavtwin.display.PageMixin.draw", interrupt)
    code, _, _ = run(capsys, "gap", table, "--vehicle", VEHICLE, "--out", tmp_path / "o")
    assert code == 130
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_demo_names_the_effect_it_hid(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """On shorter flights, and with one mission at the end."""
    start = (("ground", 0.5, (0.0, 0.0, 0.0)), ("takeoff", 3.0, (0.0, 0.0, -1.0)))
    there, back = (*start, ("forward", 2.0, (3.0, 1.0, -1.0))), ("forward", 2.0, (0.0, 0.0, -1.3))
    across = (*start, ("forward", 2.0, (-1.0, 2.0, -1.0)), back)
    monkeypatch.setattr("uavtwin.demo.chain.FIT", {"fit_1": (*there, back), "fit_2": across})
    monkeypatch.setattr("uavtwin.demo.chain.HOLDOUT", {"holdout": across})
    monkeypatch.setattr("twin.flight.closed_loop.mission_names", lambda: ("takeoff",))
    code, said, _ = run(capsys, "demo", "--seed", 4, "--out", tmp_path / "d")
    truth = json.loads((tmp_path / "d" / "truth.json").read_text())
    assert code == 0
    assert truth["effect"] == "rotor_drag"
    assert truth["named_rightly"] is True
    assert truth["text"] in said
    assert "The name is right." in said
    gap, name = said.splitlines()[:2]
    assert "disagree most in acc_x" in gap
    assert name.startswith("Missing from the model: rotor drag ")
    assert json.loads((tmp_path / "d" / "explain.json").read_text())["verdict"] == "named"
    files = {str(p.relative_to(tmp_path / "d")) for p in (tmp_path / "d").rglob("*.*")}
    assert files == {
        "airframe.fmu",
        "explain.json",
        "gap.html",
        "gap.json",
        "report.html",
        "run.json",
        "truth.json",
        "vehicle.toml",
        *(f"flights/{n}.parquet" for n in ("fit_1", "fit_2", "holdout")),
    }
    code, _, _ = run(capsys, "check", tmp_path / "d" / "flights" / "fit_1.parquet")
    assert code == 0


@pytest.mark.slow
def test_export_lists_what_it_wrote(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    arguments = ("airframe", "imu", "battery", "--vehicle", "crazyflie", "--fmi", "2,3", "--json")
    code, said, _ = run(capsys, "export", *arguments, "--out", tmp_path / "f")
    assert code == 0
    rows = json.loads(said)
    assert len(rows) == 6
    for row in rows:
        assert (tmp_path / "f" / row["file"]).stat().st_size == row["bytes"]
        code, said, _ = run(capsys, "check", tmp_path / "f" / row["file"])
        assert code == 0, said


@pytest.mark.slow
def test_exported_start_values_are_baked_in(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    import fmpy

    code, _, _ = run(capsys, "export", "airframe", "--start", "initial.pos_z=-3", "--out", tmp_path)
    assert code == 0
    starts = {
        v.name: v.start
        for v in fmpy.read_model_description(tmp_path / "airframe.fmu").modelVariables
    }
    assert float(starts["initial.pos_z"]) == -3.0


class Place(Record, frozen=True, kw_only=True):
    """Of a flight."""

    share: float


class Row(Record, frozen=True, kw_only=True):
    """One that lacks things."""

    name: str
    place: Place | None
    never: Place | None = None


class Whole(Record, frozen=True, kw_only=True):
    """Lists, parts by name, parts by two names, and a part that holds such."""

    rows: tuple[Row, ...]
    days: dict[str, dict[str, Place]]
    nothing: dict[str, dict[str, Place]]
    flown: "Inner"


class Inner(Record, frozen=True, kw_only=True):
    """Parts by name, beside a number."""

    stable: bool
    missions: dict[str, Place]


def test_tables_have_no_column_for_what_has_columns_of_its_own(tmp_path: Path) -> None:
    one = Place(share=0.5)
    whole = Whole(
        rows=(Row(name="a", place=None), Row(name="b", place=one)),
        days={"first": {"wind": one}, "second": {}},
        nothing={"first": {}},
        flown=Inner(stable=True, missions={"hover": one, "tour": one}),
    )
    write_tables(whole, tmp_path / "tables")
    found = {p.name: pd.read_csv(p) for p in (tmp_path / "tables").iterdir()}
    assert {*found} == {"rows.csv", "days.csv", "flown.missions.csv"}
    assert list(found["rows.csv"]) == ["name", "never", "place.share"]
    assert found["days.csv"].to_dict("records") == [{"of": "first", "name": "wind", "share": 0.5}]
    assert found["flown.missions.csv"]["name"].tolist() == ["hover", "tour"]


def _broken_tables(table: Path, folder: Path) -> dict[str, tuple[Path, str]]:
    good = pd.read_parquet(table)
    frames = {
        "backward time": good.assign(time=good["time"].where(good.index != 100, 0.0)),
        "no time": good.drop(columns="time"),
        "no commands": good.drop(columns=[f"cmd_{i}" for i in range(1, 5)]),
        "infinite": good.assign(acc_x=good["acc_x"].where(good.index != 7, np.inf)),
        "text": good.assign(acc_x="fast"),
    }
    words = {
        "backward time": "time",
        "no time": "time",
        "no commands": "cmd_1",
        "infinite": "acc_x",
        "text": "acc_x",
    }
    paths = {}
    for name, frame in frames.items():
        path = folder / f"{name.replace(' ', '_')}.csv"
        frame.to_csv(path, index=False)
        paths[name] = (path, words[name])
    return paths


@pytest.mark.slow
def test_bad_flights_get_one_clear_error(
    capsys: pytest.CaptureFixture[str], table: Path, tmp_path: Path
) -> None:
    cases = _broken_tables(table, tmp_path)
    for name, content in (("empty", b""), ("not a log", b"hello, pilot"), ("zip", b"PK\x03\x04")):
        path = tmp_path / f"{name}.ulg"
        path.write_bytes(content)
        cases[name] = (path, path.name)
    cases["missing"] = (tmp_path / "nowhere.ulg", "nowhere.ulg")
    cases["a folder"] = (tmp_path, tmp_path.name)
    for name, (path, word) in cases.items():
        code, _, said = run(capsys, "gap", path, "--vehicle", VEHICLE, "--out", tmp_path / "o")
        assert code == 2, name
        assert said.startswith("error: "), (name, said)
        assert word in said, (name, said)
        assert not (tmp_path / "o").exists(), name


@pytest.mark.slow
def test_rotors_that_contradict_the_log_are_refused_before_any_search(
    capsys: pytest.CaptureFixture[str], table: Path, tmp_path: Path
) -> None:
    log, mine = tmp_path / "stated.parquet", tmp_path / "mine.toml"
    stated = Airframe(layout=layouts.frame("x", "SYS_AUTOSTART 4001 of the log"))
    write_flight(replace(read_flight(table), airframe=stated), log)
    text, right = vehicle_text(VEHICLE)[0], '["ccw", "ccw", "cw", "cw"]'
    assert right in text
    mine.write_text(text.replace(right, '["cw", "cw", "ccw", "ccw"]'))
    out = tmp_path / "o"
    for verb in (("gap",), ("explain", "--no-fmus"), ("calibrate",), ("train",)):
        code, _, said = run(capsys, *verb, log, "--vehicle", mine, "--out", out)
        assert code == 2, verb
        assert said.startswith("error: stated.parquet: the vehicle file contradicts"), (verb, said)
        assert "rotors.direction of mine.toml says cw for rotor 1" in said
        assert "SYS_AUTOSTART 4001 of the log" in said
        assert not out.exists(), verb
    code, said, _ = run(capsys, "check", log, "--vehicle", mine)
    assert code == 1
    assert "the vehicle file contradicts the log" in said and "good for: gap" in said
    code, _, said = run(capsys, "gap", log, "--vehicle", mine, "--out", out, "--trust-vehicle")
    assert code == 0, said
    code, _, said = run(capsys, "gap", log, "--vehicle", VEHICLE, "--out", out, "--force")
    assert code == 0, said


@pytest.mark.slow
def test_wrong_use_of_options(
    capsys: pytest.CaptureFixture[str], table: Path, tmp_path: Path
) -> None:
    out = ("--out", tmp_path / "o")
    cases = {
        ("gap", table, "--vehicle", "copter_defaul", *out): "copter_default",
        ("gap", table, "--vehicle", VEHICLE, "--horizon", "0", *out): "horizon",
        ("gap", table, "--vehicle", VEHICLE, "--horizon", "nan", *out): "horizon",
        ("export", "airfame", *out): "airframe",
        ("export", "airframe", "--fmi", "1", *out): "--fmi",
        ("export", "airframe", "--start", "mas=1", *out): "mass",
        ("export", "airframe", "--start", "mass=-1", *out): "mass",
        ("export", "airframe", "--start", "mass", *out): "NAME=NUMBER",
        ("export", "replay", *out): "--flight",
        ("export", "airframe", "--drive", "magic", *out): "rotor_speed",
        ("export", "airframe", "--drive", "mission", *out): "corrected-twin",
        (
            "export",
            "airframe",
            "--vehicle",
            "feisi_x150",
            "--drive",
            "rotor_speeds",
            *out,
        ): "thrust_from_speed",
        ("export", "battery", "--vehicle", "feisi_x150", *out): "[battery]",
        ("check", tmp_path / "nothing.ulg"): "nothing.ulg",
        ("frobnicate",): "frobnicate",
    }
    for arguments, word in cases.items():
        code, _, said = run(capsys, *arguments)
        assert code == 2, arguments
        assert word in said, (arguments, said)
        assert not (tmp_path / "o").exists(), arguments


@pytest.mark.slow
def test_a_cut_log_is_a_counted_finding(
    capsys: pytest.CaptureFixture[str], data_dir: Path, tmp_path: Path
) -> None:
    whole = (data_dir / "rflysimdt" / "real_3.ulg").read_bytes()
    cut = tmp_path / "cut.ulg"
    cut.write_bytes(whole[: len(whole) * 2 // 3])
    code, _, said = run(capsys, "gap", cut, "--vehicle", "feisi_x150", "--out", tmp_path / "o")
    assert code == 1
    assert "finding: cut" in said
    assert (tmp_path / "o" / "report.html").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("log", "vehicle"),
    [
        ("real_1", "feisi_x150"),
        ("real_2", "feisi_x150"),
        ("real_3", "feisi_x150"),
        ("sim_1", VEHICLE),
        ("sim_2", VEHICLE),
        ("sim_3", VEHICLE),
    ],
)
def test_real_logs(
    capsys: pytest.CaptureFixture[str], data_dir: Path, tmp_path: Path, log: str, vehicle: str
) -> None:
    path = data_dir / "rflysimdt" / f"{log}.ulg"
    code, said, _ = run(capsys, "gap", path, "--vehicle", vehicle, "--out", tmp_path / "o")
    assert code == 0
    assert "us of pulse width per motor" in said
    gap = json.loads((tmp_path / "o" / "gap.json").read_text())
    assert set(gap["channels"]["acc_z"]["by_phase"]) == {"takeoff", "hover", "land"}
    if vehicle == VEHICLE:  # the simulator's own parameters: the twin explains most of what moves
        assert gap["channels"]["acc_z"]["share"] < 0.35
        assert gap["channels"]["gyro_rate_x"]["share"] < 0.5


@pytest.mark.slow
def test_nanobench_through_the_example(
    capsys: pytest.CaptureFixture[str], data_dir: Path, tmp_path: Path
) -> None:
    converter = Path(__file__).parents[2] / "examples" / "nanobench_to_flight_table.py"
    source = data_dir / "nanobench" / "B2_circle_slow_rep2.parquet"
    path = tmp_path / "circle.parquet"
    subprocess.run([sys.executable, converter, source, path], check=True, capture_output=True)
    code, said, _ = run(capsys, "gap", path, "--vehicle", "crazyflie", "--out", tmp_path / "o")
    assert code == 0
    assert "acc_z" in said
    gap = json.loads((tmp_path / "o" / "gap.json").read_text())
    assert gap["channels"]["acc_x"]["n"] > 1000


@pytest.mark.slow
def test_check_tells_a_motor_without_samples(
    capsys: pytest.CaptureFixture[str], table: Path, tmp_path: Path
) -> None:
    broken = pd.read_parquet(table).assign(cmd_2=np.nan)
    broken.to_csv(tmp_path / "broken.csv", index=False)
    code, said, _ = run(capsys, "check", tmp_path / "broken.csv")
    assert code == 1
    assert "warning: cmd_2: has no sample at all" in said
    assert "problem: good for nothing yet: neither commands" in said
    assert "good for: " not in said


@pytest.mark.slow
def test_one_bad_file_hides_no_other(
    capsys: pytest.CaptureFixture[str], table: Path, tmp_path: Path
) -> None:
    (tmp_path / "bad.toml").write_text("name =", "utf-8")
    files = (tmp_path / "nothing.ulg", table, tmp_path / "bad.toml", "hover.toml", table)
    code, said, error = run(capsys, "check", *files)
    assert (code, said.count("good for: gap, teacher-forced")) == (2, 2)
    assert [line.split(":")[0] for line in error.splitlines()] == ["error"] * 3
    assert "nothing.ulg: no such file" in error
    code, said, error = run(capsys, "check", "--json", *files)
    told = json.loads(said)
    assert code == 2
    assert [t["file"] for t in told] == [Path(f).name for f in files]
    assert ["error" in t for t in told] == [True, False, True, True, False]


@pytest.mark.slow
def test_a_mistake_of_ours_is_one_line_with_a_code_of_its_own(
    capsys: pytest.CaptureFixture[str],
    table: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An equation that divides by zero, in `check` and in a verb that does not look for it."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setattr("uavtwin.file_check.observable_effects", lambda flight: 1 / 0)
    monkeypatch.setattr("uavtwin.vehicles.load_vehicle", lambda name: 1 / 0)
    for arguments, doing in (
        (("check", table), f"check {table}"),
        (("simulate", "hover", "--out", tmp_path / "o"), "simulate hover --out"),
    ):
        code, said, error = run(capsys, *arguments)
        (line,) = error.splitlines()
        assert (code, said) == (3, "")
        assert doing in line
        assert "ZeroDivisionError: division by zero" in line
        (file,) = tmp_path.rglob("error-*.txt")
        assert str(file) in line
        assert "Traceback" in file.read_text("utf-8")
        file.unlink()


def test_brackets_are_text_and_no_markup(capsys: pytest.CaptureFixture[str]) -> None:
    """Names of files, tables and columns may hold what rich takes for styles."""
    table = TextTable(("[battery]", "[/x]"), (("[red]low", "[/y]"), ("[bold]", "a")))
    print_table(table)
    print_sections(["[/x] of [battery]", table])
    said, _ = capsys.readouterr()
    for text in ("[battery]", "[/x]", "[red]low", "[/y]", "[bold]"):
        assert said.count(text) >= 2


@pytest.mark.slow
def test_names_from_files_do_not_steer_the_terminal(
    capsys: pytest.CaptureFixture[str], table: Path, tmp_path: Path
) -> None:
    """Escapes, overrides of the direction, and bytes that are no text, in names of all kinds."""
    text = vehicle_text("feisi_x150")[0]
    lines = [line for line in text.splitlines() if not line.startswith("name")]
    named = tmp_path / "named.toml"
    named.write_text('name = "a\\u001b[31m"\n' + "\n".join(lines), "utf-8")
    steering = tmp_path / "log\x1b]0;title\x07\u202e.csv"
    pd.read_parquet(table).to_csv(steering, index=False)
    broken = Path(os.fsdecode(bytes(tmp_path) + b"/log\xff.csv"))
    shutil.copy(steering, broken)
    code, said, error = run(capsys, "check", named, steering, broken)
    assert code == 2
    assert "named.toml: name = " in error
    assert "must be text without control characters" in error
    assert r"log\x1b]0;title\x07\u202e.csv" in said
    assert r"log\udcff.csv" in said
    code, told, _ = run(capsys, "check", "--json", steering, broken)
    assert [r["file"] for r in json.loads(told)] == [steering.name, broken.name]
    for printed in (said, error, told):
        assert not {"\x1b", "\x07"} & set(printed)
        printed.encode("utf-8")


@pytest.mark.slow
def test_check_asks_of_an_odd_vehicle_and_fails_an_impossible_one(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    text, path = vehicle_text("feisi_x150")[0], tmp_path / "mine.toml"
    path.write_text(text, "utf-8")
    code, said, _ = run(capsys, "check", path)
    assert code == 0
    assert "question: rotors.lag = none: rotors take 15 to 75 ms" in said
    code, said, _ = run(capsys, "check", path, "--json")
    (report,) = json.loads(said)
    assert code == 0
    assert report["problems"] == []
    assert {"key", "value", "why", "way_out"} == set(report["questions"][0])
    path.write_text(text.replace("8.82e-4]", "18.82e-4]"), "utf-8")
    code, said, _ = run(capsys, "check", path)
    assert code == 1
    assert "problem: body.inertia" in said


@pytest.mark.slow
@pytest.mark.parametrize("word", ["version", "--version"])
def test_the_installed_command_runs(word: str) -> None:
    command = Path(sys.executable).with_name("uavtwin")
    result = subprocess.run(
        [command, word], capture_output=True, text=True, check=True, env={**os.environ}
    )
    assert result.stdout.strip() == version("uavtwin")


def test_every_file_of_the_command_line_is_a_verb() -> None:
    """A verb that is written and not listed in `PANELS` would be missing without a word."""
    files = {p.stem for p in Path(str(main.__file__)).parent.glob("*.py")}
    shared = {"__init__", "main", "options", "printing", "results", "hil"}  # `live --hil`
    listed = {str(verb.__name__) for verb in main.VERBS} - {"version"}
    assert files - shared == listed | {"vehicle"}


def test_a_file_in_the_place_of_the_verb_is_answered_with_the_verb(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "my log.ulg"
    log.touch()
    code, _, err = run(capsys, log)
    assert code == 2
    assert "uavtwin why" in err


@pytest.mark.parametrize(
    ("given", "now"),
    [
        (["selected", "SELECT 1"], ["--sql=SELECT 1", "selected"]),
        (["f", "/* c */ SELECT 1"], ["--sql=/* c */ SELECT 1", "f"]),
        (["f", "-- c\nFROM flights", "--json"], ["--sql=-- c\nFROM flights", "f", "--json"]),
        (["--time-limit", "5", "f", "(SELECT 1)"], ["--sql=(SELECT 1)", "--time-limit", "5", "f"]),
        (["--help"], ["--help"]),
        (["f", "--sql=SELECT 1"], ["f", "--sql=SELECT 1"]),
    ],
)
def test_the_former_query_asks_with_its_second_argument(given: list[str], now: list[str]) -> None:
    assert main._renamed(["query", *given]) == ["fleet", *now]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("query", "folder"), "--sql"),
        (("bench", "--json"), "python -m benchmarks.speed"),
        (("generate", "model", "--seed", "1"), "simulate MISSION --model FOLDER"),
    ],
)
def test_a_former_name_says_what_it_is_now(
    capsys: pytest.CaptureFixture[str], given: tuple[str, ...], said: str
) -> None:
    code, out, err = run(capsys, *given)
    assert (code, out) == (2, "") and said in err
    assert "bench" not in run(capsys, "--help")[1]
