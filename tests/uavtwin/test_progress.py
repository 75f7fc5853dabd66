"""Progress goes to stderr, whatever is asked for on stdout."""

import io
import json
import sys
import time
from pathlib import Path

import pytest
from cli_rig import run
from rich.console import Console

from twin.logs import write_flight
from twin.vehicle_file import load_vehicle
from uavtwin.cli import main, printing
from uavtwin.demo.flights import fly

LEGS = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 2.0, (0.0, 0.0, -1.5)),
    ("hover", 1.5, (0.0, 0.0, -1.5)),
)


def terminal(monkeypatch: pytest.MonkeyPatch) -> io.StringIO:
    """Stderr as a terminal."""
    seen = io.StringIO()
    console = Console(file=seen, force_terminal=True, width=80)
    monkeypatch.setattr(printing, "STDERR", console)
    return seen


def test_the_bar_is_on_stderr_and_stdout_holds_the_json_alone(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    seen = terminal(monkeypatch)
    with printing.progress("explaining") as step:
        step(0.5)
    printing.print_rows([{"verdict": "named"}])
    assert "explaining" in seen.getvalue()
    assert json.loads(capsys.readouterr().out) == [{"verdict": "named"}]


def test_explain_shows_it_with_json_too(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """On a flight that is refused: how it is shown does not depend on what is found."""
    vehicle = load_vehicle("copter_default")
    flight = fly(vehicle, vehicle, 1, "short", LEGS)
    flight.table["phase"] = "ground"
    write_flight(flight, tmp_path / "short.parquet")
    seen = terminal(monkeypatch)
    words = ["explain", tmp_path / "short.parquet", "--vehicle", "copter_default", "--json"]
    words += ["--indoor", "--no-fmus", "--out", tmp_path / "out"]
    monkeypatch.setattr(sys, "argv", ["uavtwin", *map(str, words)])
    with pytest.raises(SystemExit) as stop:
        main.main()
    assert stop.value.code == 1
    assert json.loads(capsys.readouterr().out)["verdict"] == "unusable"
    assert "explaining" in seen.getvalue()
    options = json.loads((tmp_path / "out" / "run.json").read_text())["options"]
    assert options["indoors"] == {"short": {"indoors": True, "source": "as told"}}


def test_where_stderr_is_no_terminal_a_line_now_and_then_says_how_far_it_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clock = iter((0.0, 4.0, 8.0, 11.0, 17.0, 19.0, 22.0))
    monkeypatch.setattr(time, "monotonic", lambda: next(clock))
    with printing.progress("training") as step:
        for done in (0.1, 0.2, 0.275, 0.425, 0.475, 0.55):
            step(done)
    said = capsys.readouterr()
    assert said.err.splitlines() == ["training: 28 %", "training: 55 %, 18 s left"]
    assert said.out == ""


def test_time_left_is_said_once_it_is_known_and_does_not_jump() -> None:
    """A search of 60 s that says a tenth for its first half, then goes on evenly."""
    left, said = printing.TimeLeft(), {}
    for second in range(1, 61):
        done = second / 300 if second < 30 else 0.1 + 0.9 * (second - 29) / 31
        said[second] = left.said(float(second), done)
    known = {s: float(text.removesuffix(" s left")) for s, text in said.items() if text}
    assert known and min(known) > 34, known
    assert all(abs(s + value - 60) < 12 for s, value in known.items()), known


def test_the_environment_names_the_vehicle(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Where the command does not, and not for `--since`."""
    flight = tmp_path / "f.parquet"
    vehicle = load_vehicle("copter_default")
    write_flight(fly(vehicle, vehicle, 1, "short", LEGS), flight)
    monkeypatch.setenv("UAVTWIN_VEHICLE", "no_such_aircraft")
    for verb in (["gap", flight], ["explain", flight], ["simulate", "hover"], ["export", "imu"]):
        code, _, told = run(capsys, *verb, "--out", tmp_path / "out")
        assert code == 2
        assert "no_such_aircraft" in told
    code, _, told = run(capsys, "explain", flight, "--since", "crazyflie", "--out", tmp_path / "o")
    assert code == 2
    assert "no_such_aircraft" not in told
    assert "calibrat" in told
