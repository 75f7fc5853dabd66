"""`uavtwin simulate`: scenarios fly, what shapes them acts, same seed same bytes, wrong use."""

import json
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from cli_rig import run
from page_rigs.figures import figures_of

from cosim.ssp import write_ssp
from cosim.system import System
from twin.errors import TwinError
from twin.flight.assembly import flying_twin
from twin.flight.mission import mission_names
from uavtwin.simulation import (
    Scenario,
    ineffective,
    run_scenario,
    scenario_system,
    shaping_starts,
    summary,
)
from uavtwin.vehicles import load_vehicle

VEHICLE = "crazyflie"
WINDY = Scenario(
    "tour",
    load_vehicle(VEHICLE),
    wind_m_s=(3.0, -2.0, 0.0),
    gusts=True,
    seed=4,
    effects=("rotor_drag",),
)
Call = Callable[..., tuple[int, str, str]]


@pytest.fixture
def simulate(capsys: pytest.CaptureFixture[str]) -> Call:
    return lambda *arguments: run(capsys, "simulate", *arguments)


@pytest.fixture(scope="module")
def windy(tmp_path_factory: pytest.TempPathFactory) -> System:
    return scenario_system(WINDY, tmp_path_factory.mktemp("windy"))


@pytest.mark.parametrize(
    ("vehicle", "shaped", "says"),
    [
        ("copter_default", {"wind_m_s": (15.0, 0.0, 0.0)}, ["wind: changes nothing"]),
        ("copter_default", {"gusts": True}, ["gust: changes nothing"]),
        ("copter_default", {"effects": ("steady_wind",)}, ["steady wind: changes nothing"]),
        ("copter_default", {"wind_m_s": (15.0, 0.0, 0.0), "effects": ("rotor_drag",)}, []),
        ("copter_default", {"wind_m_s": (15.0, 0.0, 0.0), "effects": ("blade_flapping",)}, []),
        (
            "copter_default",
            {"wind_m_s": (1.0, 0.0, 0.0), "effects": {"rotor_drag": {"k_xy_1_s": 0.0}}},
            ["wind: changes nothing"],
        ),
        ("feisi_x150", {"wind_m_s": (15.0, 0.0, 0.0), "gusts": True}, []),
        ("copter_default", {}, []),
        (
            "copter_default",
            {"starts": {"airframe.rotor_drag.k_xy_1_s": 0.6}},
            ["airframe.rotor_drag.k_xy_1_s: changes nothing, rotor_drag is switched off"],
        ),
        (
            "copter_default",
            {
                "starts": {
                    "airframe.rotor_drag.k_xy_1_s": 0.6,
                    "airframe.rotor_drag.enabled": 1.0,
                    "airframe.mass": 1.5,
                }
            },
            [],
        ),
    ],
)
def test_what_changes_nothing_is_said(vehicle: str, shaped: Any, says: list[str]) -> None:
    scenario = Scenario("hover", load_vehicle(vehicle), **shaped)
    twin = flying_twin(load_vehicle(vehicle))
    found = ineffective(twin.with_starts(shaping_starts(twin, scenario)), scenario)
    assert [text.startswith(start) for text, start in zip(found, says, strict=True)] == [
        True for _ in says
    ]


@pytest.mark.slow
def test_wind_without_effect_is_a_warning(simulate: Call, tmp_path: Path) -> None:
    given = ("hover", "--vehicle", "copter_default", "--wind", "15,0,0", "--stop", 1)
    code, said, warned = simulate(*given, "--out", tmp_path / "o", "--json")
    assert code == 0
    assert "warning: wind: changes nothing" in warned
    assert json.loads(said)["warnings"][0] in warned


@pytest.mark.slow
@pytest.mark.parametrize("name", mission_names())
def test_every_scenario_flies(simulate: Call, tmp_path: Path, name: str) -> None:
    code, said, _ = simulate(name, "--vehicle", VEHICLE, "--out", tmp_path / "o")
    assert code == 0
    assert said.startswith(f"{name}: ")
    assert {p.name for p in (tmp_path / "o").iterdir()} == {
        "recording.parquet",
        "summary.json",
        "report.html",
        "run.json",
    }
    figures = json.loads((tmp_path / "o" / "summary.json").read_text())
    assert figures["tracking_rms_m"] < 0.1
    assert figures["tracking_worst_m"] < 0.25
    table = pd.read_parquet(tmp_path / "o" / "recording.parquet")
    assert table.columns[0] == "time"
    assert np.isfinite(table.to_numpy()).all()
    assert -table["airframe.pos_z"].min() > 0.7  # it was up
    np.testing.assert_allclose(np.diff(table["time"]), 0.01, atol=1e-9)


@pytest.mark.slow
def test_wind_and_effects_act(windy: System) -> None:
    """Wind is felt through the drag that the effect adds, and only then."""
    lean = {}
    for wind, drag in ((0.0, True), (3.0, False), (3.0, True)):
        starts = {
            "environment.wind.x": wind,
            "environment.wind.y": 0.0,
            "environment.gust.enabled": 0.0,
            "airframe.rotor_drag.enabled": float(drag),
            "airframe.rotor_drag.k_xy_1_s": 0.5,
        }
        system = System(windy.fmus, windy.connections, starts)
        flight = run_scenario(system, stop_s=6.0)  # up and hovering
        lean[wind, drag] = 2 * np.arcsin(flight["airframe.q_y"][-1])
        assert flight["environment.wind_x"][-1] == wind
    assert abs(lean[0.0, True]) < 1e-3
    assert abs(lean[3.0, False]) < 1e-3
    assert lean[3.0, True] == pytest.approx(np.arctan(0.5 * 3.0 / 9.80665), rel=0.02)


@pytest.mark.slow
def test_gusts_blow_about_the_wind(windy: System) -> None:
    wind = run_scenario(windy, stop_s=20.0)["environment.wind_x"]
    assert 0.1 < np.std(wind) < 3.0
    assert np.mean(wind) == pytest.approx(3.0, abs=1.0)


@pytest.mark.slow
def test_same_seed_same_bytes(windy: System, tmp_path: Path) -> None:
    flights, other = [], {k: 5.0 if k.endswith(".seed") else v for k, v in windy.starts.items()}
    for i, starts in enumerate((windy.starts, windy.starts, other)):
        flights.append(run_scenario(replace(windy, starts=starts), stop_s=3.0))
        flights[i].write(tmp_path / f"{i}.parquet")
    written = [(tmp_path / f"{i}.parquet").read_bytes() for i in range(3)]
    assert written[0] == written[1] != written[2]
    for drawn in ("environment.wind_x", "position.meas_pos_x"):
        assert np.mean(flights[0][drawn] != flights[2][drawn]) > 0.5


@pytest.mark.slow
def test_fused_is_the_parts_to_the_last_bit(windy: System, tmp_path: Path) -> None:
    """A whole tour in wind, gusts and noise."""
    parts = run_scenario(windy)
    fused = run_scenario(scenario_system(replace(WINDY, fused=True), tmp_path))
    assert parts.time_s[-1] == pytest.approx(windy.stop_time_s, abs=0.01)
    table = fused.frame().rename(columns=lambda name: name.removeprefix("twin."))
    wanted = parts.frame()
    pd.testing.assert_frame_equal(table[list(wanted)], wanted, check_exact=True)
    assert table.shape == wanted.shape
    assert summary(fused) == summary(parts)


@pytest.mark.slow
def test_an_ssp_is_the_scenario_that_it_was_made_of(
    windy: System, simulate: Call, tmp_path: Path
) -> None:
    ssp = write_ssp(windy, tmp_path / "windy.ssp")
    code, said, _ = simulate(ssp, "--stop", "4", "--out", tmp_path / "a", "--csv")
    assert code == 0
    assert said.startswith("windy.ssp: 4 s flown")
    assert said.rstrip().endswith("report.html, recording.csv, summary.json, run.json")
    options = ("--vehicle", VEHICLE, "--wind=3,-2,0", "--gusts", "--seed", "4", "--csv")
    simulate("tour", *options, "--effect", "rotor_drag", "--stop", "4", "--out", tmp_path / "b")
    a, b = ((tmp_path / name / "recording.csv").read_bytes() for name in "ab")
    assert a == b
    made = [json.loads((tmp_path / name / "run.json").read_text()) for name in "ab"]
    assert made[1]["seed"] == 4
    assert made[0]["fmus"] == dict.fromkeys(windy.fmus, "FMI 2.0, co-simulation")
    assert made[1]["fmus"].keys() == windy.fmus.keys()


@pytest.mark.slow
def test_an_ssp_takes_start_values_and_no_other_shape(
    windy: System, simulate: Call, tmp_path: Path
) -> None:
    ssp = write_ssp(windy, tmp_path / "windy.ssp")
    starts = ("--start", "environment.wind.x=-3", "--start", "environment.gust.enabled=0")
    with zipfile.ZipFile(ssp, "a") as archive, pytest.warns(UserWarning, match="Duplicate name"):
        archive.writestr("SystemStructure.ssd", archive.read("SystemStructure.ssd"))
    code, said, told = simulate(ssp, *starts, "--stop", "0.5", "--out", tmp_path / "o")
    repeated = "the archive holds 'SystemStructure.ssd' 2 times, the same each time."
    assert f"warning: windy.ssp: {repeated}" in " ".join(told.split())
    assert code == 0
    assert said.startswith("windy.ssp: 0.5 s simulated")  # still on the ground: nothing to judge
    table = pd.read_parquet(tmp_path / "o" / "recording.parquet")
    assert table["environment.wind_x"].eq(-3).all()
    code, _, told = simulate(ssp, "--gusts", "--out", tmp_path / "p")
    assert code == 2
    assert "only start values go with it, not gusts." in told


@pytest.mark.slow
def test_the_controller_is_swapped(windy: System, tmp_path: Path) -> None:
    px4 = scenario_system(Scenario("tour", load_vehicle(VEHICLE), "px4"), tmp_path)
    lqr = replace(windy, starts={})
    ours, theirs = (summary(run_scenario(s, stop_s=6.0)) for s in (lqr, px4))
    assert ours["tracking_worst_m"] != theirs["tracking_worst_m"]
    assert max(ours["tracking_worst_m"], theirs["tracking_worst_m"]) < 0.5


@pytest.mark.slow
def test_report_shows_every_part_with_units(windy: System, simulate: Call, tmp_path: Path) -> None:
    simulate(
        "tour",
        "--vehicle",
        VEHICLE,
        "--stop",
        "3",
        "--wind",
        "1,0,0",
        "--fused",
        "--out",
        tmp_path / "o",
    )
    page = (tmp_path / "o" / "report.html").read_text("utf-8")
    assert "src=" not in page.split("</script>")[-1]  # opens offline
    for part in windy.fmus:
        assert f'aria-label="Outputs of {part} over time"' in page
    assert "<dt>wind</dt><dd>1,0,0</dd>" in page
    figures = str(figures_of(page))
    assert "specific_force, m/s" in figures and "position north, m" in figures


@pytest.mark.slow
def test_steps_and_intervals(windy: System) -> None:
    rows = [
        run_scenario(windy, 0.1, step_s=step_s, interval_s=interval_s).time_s[1]
        for step_s, interval_s in ((None, None), (0.003, None), (0.02, None), (0.001, 0.004))
    ]
    np.testing.assert_allclose(rows, [0.01, 0.009, 0.02, 0.004])


WRONG = {
    ("tuor",): "neither an .ssp file nor a scenario: takeoff, hover",
    ("nowhere.ssp",): "nowhere.ssp",
    ("tour", "--vehicle", "crazyfly"): "crazyfly",
    ("tour", "--controller", "lqg"): "Did you mean 'lqr'?",
    ("tour", "--wind", "5"): "--wind 5: write three numbers",
    ("tour", "--wind", "nan,0,0"): "wind.x = nan must be a finite number",
    ("tour", "--effect", "rotordrag"): "Did you mean 'rotor_drag'?",
    ("tour", "--start", "airframe.mass"): "write NAME=NUMBER",
    ("tour", "--start", "mass=1"): "there is no part 'mass'",
    ("tour", "--start", "airframe.mas=1"): "Did you mean 'mass'?",
    ("tour", "--start", "airframe.mass=-1"): "outside its range",
    ("tour", "--algorithm", "magic"): "magic",
    ("tour", "--seed", "-1"): "--seed",
}


@pytest.mark.slow
@pytest.mark.parametrize("arguments", WRONG)
def test_wrong_use(simulate: Call, tmp_path: Path, arguments: tuple[str, ...]) -> None:
    vehicle = () if "--vehicle" in arguments else ("--vehicle", VEHICLE)
    code, said, told = simulate(*arguments, *vehicle, "--out", tmp_path / "o")
    assert code == 2
    assert WRONG[arguments] in told, told
    assert said == ""
    assert not (tmp_path / "o").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("times", "text"),
    [
        ({"stop_s": -1.0}, "stop -1: not even one interval"),
        ({"stop_s": np.nan}, "stop nan"),
        ({"stop_s": np.inf}, "stop inf s in steps of 0.001 s: inf steps"),
        ({"stop_s": 1e9}, "stop 1e+09 s in steps of 0.001 s: 1e+12 steps, at most 1e+08 are taken"),
        (
            {"step_s": 1e-12},
            "steps, at most 1e+08 are taken. Give an earlier stop or a longer step",
        ),
        ({"stop_s": 9e4, "interval_s": 0.001}, "9e+07 rows of"),
        ({"step_s": 0.0}, "step 0: needs a positive number"),
        ({"step_s": -1.0}, "step -1"),
        ({"interval_s": np.nan}, "interval nan"),
        ({"interval_s": 0.0}, "interval 0"),
        ({"interval_s": 0.0015}, "not a whole number of steps of 0.001 s"),
    ],
)
def test_wrong_times(windy: System, times: dict[str, Any], text: str) -> None:
    with pytest.raises(TwinError) as refused:
        run_scenario(windy, **times)
    assert text in str(refused.value)


def test_a_system_without_stop_time_asks_for_one(windy: System) -> None:
    with pytest.raises(TwinError, match="give one in seconds"):
        run_scenario(System(windy.fmus, windy.connections))
