"""What `check` prints: the verdict first, one screen, all of it on demand."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from cli_rig import run

from twin.frames import from_euler
from twin.logs.autopilot import Autopilot, Setpoint
from twin.logs.columns import QUAT, VEL
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import fly
from uavtwin.file_check import CheckReport, check_flight

SCREEN = 24
"""Lines of a terminal."""


def report(problems: int = 0, warnings: int = 0, good_for: tuple[str, ...] = ()) -> CheckReport:
    return CheckReport(
        "flight.ulg",
        {f"fact{k}": "so" for k in range(30)} | {"motors": "a, b, c"},
        tuple(f"broken {k}" for k in range(problems)),
        tuple(f"odd {k}" for k in range(warnings)),
        notes=("noted",),
        good_for=good_for,
        observable=("airframe: rotor_drag, mass_offset", "imu: gyro_bias"),
    )


@pytest.mark.parametrize(
    ("given", "claim"),
    [
        (report(), "flight.ulg: fine"),
        (report(1, 2), "flight.ulg: 1 problem, 2 warnings"),
        (
            report(
                0, 1, ("gap, teacher-forced: acc", "gap at a short horizon: q", "vehicle draft")
            ),
            "flight.ulg: 1 warning; good for gap, vehicle draft",
        ),
    ],
)
def test_the_verdict_is_the_first_line(given: CheckReport, claim: str) -> None:
    assert given.claim() == claim and str(given).startswith(claim)


def test_a_screen_holds_what_matters_most() -> None:
    long = report(3, 40, ("gap: acc", "vehicle draft"))
    shown = long.short_lines()
    texts = [text for _, text in shown]
    assert 15 < len(shown) < SCREEN - 2
    assert [t for t in texts if t.startswith("problem")] == [
        f"problem: broken {k}" for k in range(3)
    ]
    assert "warning: odd 0" in texts and "good for: vehicle draft" in texts
    assert not any(t.startswith("explain can") for t in texts)
    assert set(shown) <= set(long.lines()) and not any("motors" in t for t in texts)


def test_all_is_printed_on_demand(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    long = report(0, 40)
    monkeypatch.setattr("uavtwin.file_check.check_file", lambda path, vehicle, key: long)
    _, short, _ = run(capsys, "check", "flight.ulg")
    _, whole, _ = run(capsys, "check", "flight.ulg", "--all")
    assert "odd 39" not in short and short.splitlines()[-1].endswith("more lines: --all")
    assert "odd 39" in whole and len(whole.splitlines()) == 1 + len(long.lines())


def test_what_no_setpoint_asks_for_is_noted() -> None:
    copter = load_vehicle("copter_default")
    flight = fly(copter, copter, seed=1, waypoints=(("ground", 1.0, (0, 0, 0)),))
    t_s = np.arange(0.0, 1.0, 0.1)
    mission = Setpoint(VEL, t_s, np.zeros((10, 3)))
    level = np.zeros(10)
    lean = Setpoint(QUAT, t_s, from_euler(level, level, level).T)
    for asked, axes in (((), "roll, pitch or yaw"), ((mission,), "yaw"), ((mission, lean), "")):
        told = replace(flight, autopilot=Autopilot(setpoints=asked))
        notes = [n for n in check_flight(told, "one").notes if n.startswith("no setpoint of")]
        assert [n.partition(":")[0] for n in notes] == [f"no setpoint of {axes}"] * bool(axes)


def test_gap_without_a_vehicle_names_the_ways_out(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("UAVTWIN_VEHICLE", raising=False)
    code, _, err = run(capsys, "gap", "flight.ulg")
    said = " ".join(err.split())
    assert code == 2 and "copter_default" in said and "uavtwin vehicle draft LOG --mass" in said


def test_check_begins_without_the_slow_parts_of_scipy() -> None:
    """They take longer to load than a log to read."""
    code = "import sys, uavtwin.file_check; print({m for m in sys.modules if m[:6] == 'scipy.'})"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    for slow in ("ndimage", "spatial", "signal", "stats", "optimize", "interpolate"):
        assert f"scipy.{slow}" not in said.stdout
