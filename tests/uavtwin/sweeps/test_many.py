"""Many simulations in one call: each the same as alone, to the last bit."""

import re
from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import uavtwin as ut
from cosim.recording import Recording
from cosim.ssp import write_ssp
from twin.errors import TwinError
from uavtwin.simulation import Scenario, asked_scenario, scenario_system
from uavtwin.sweeps.many import Listed
from uavtwin.sweeps.plan import MOST_SYSTEMS, Plan, plan_of
from uavtwin.sweeps.sweep import WORTH, RunWorker

SHARED: dict[str, Any] = {"scenario": "takeoff", "gusts": True, "effects": ("rotor_drag",)}
SECONDS = 3.0


def same(one: ut.Run, other: ut.Run) -> bool:
    """Every output, its unit and its name, bit by bit."""
    a, b = one.recording, other.recording
    return (a.names, a.time_s.tobytes(), a.values.tobytes()) == (
        b.names,
        b.time_s.tobytes(),
        b.values.tobytes(),
    ) and all(one.units[name] == other.units[name] for name in a.names)


def alone(own: Mapping[str, Any], **how: Any) -> ut.Run:
    return ut.simulate(**{**SHARED, **own}, duration=SECONDS, **how)


@pytest.mark.slow
def test_each_is_the_run_that_simulate_gives() -> None:
    """Vehicles, missions, controllers, winds, seeds and start values; one by one, and in lanes."""
    light = ut.vehicle("copter_default")
    heavy = replace(light, mass_kg=1.1 * light.mass_kg)
    given: list[dict[str, Any]] = [
        {"wind": (w, 0.0, 0.0), "seed": k} for w, k in product((0.0, 5.0), range(WORTH // 2))
    ]
    given += [
        {"vehicle": heavy, "seed": 5},
        {"scenario": "hover", "effects": {"rotor_drag": {"k_xy_1_s": 0.4}}},
        {"controller": "px4", "starts": {"airframe.mass": 1.3}},
    ]
    flown = ut.simulate_many(given, **SHARED, duration=SECONDS)
    assert len(flown) == len(given)
    for number in (0, 7, WORTH - 1, WORTH, WORTH + 1, WORTH + 2):
        assert same(flown[number], alone(given[number])), number
    assert len({run.recording.values.tobytes() for run in flown}) == len(given)
    assert flown.table["mission"].unique().tolist() == ["takeoff", "hover"]
    mass = [light.mass_kg] * WORTH + [heavy.mass_kg, light.mass_kg, 1.3]
    assert flown.table["airframe.mass"].tolist() == mass


@pytest.mark.slow
def test_rows_of_another_interval(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RunWorker, "_alone", None)  # all go in lanes
    given = [{"seed": k} for k in range(WORTH)]
    flown = ut.simulate_many(given, **SHARED, duration=SECONDS, interval=0.025, workers=1)
    assert same(flown[9], alone(given[9], interval=0.025))


@pytest.mark.slow
def test_what_comes_of_them_is_saved_iterated_and_shown(tmp_path: Path) -> None:
    flown = ut.simulate_many([{"seed": 1}, {"seed": 2}], **SHARED, duration=SECONDS)
    assert str(flown).startswith("takeoff: 2 runs, all flown")
    assert [run.record.tracking_rms_m for run in flown] == flown.table["tracking_rms_m"].tolist()
    assert flown[-1] is flown[1:][0] is list(flown)[1]
    assert flown.frame().loc[1].equals(flown[1].frame())
    folder = flown.save(tmp_path / "saved")
    assert pd.read_parquet(folder / "runs.parquet").equals(flown.table)
    stored = pd.read_parquet(folder / "recordings" / "run_000001.parquet")
    np.testing.assert_array_equal(stored["airframe.pos_z"], flown[1]["airframe.pos_z"])
    assert "uavtwin simulate takeoff" in flown.report(tmp_path / "page.html").read_text()
    with pytest.raises(TwinError, match="saved"):
        flown.save(folder)


@pytest.mark.parametrize(
    ("runs", "shared", "says"),
    [
        ([], {"scenario": "hover"}, "no runs are given"),
        ([{"seed": 1}], {}, "run 0: of what? Give scenario='tour'"),
        ([{}, {"sead": 1}], {"scenario": "hover"}, "there is no argument 'sead'"),
        ([{}, {"wind": (1.0, 2.0)}], {"scenario": "hover"}, "run 1: wind = (1.0, 2.0): give three"),
        ([{}, {"vehicle": "crazyflie"}], {"scenario": "hover"}, "run 1: "),
        ([{}] * 4, {"scenario": "tour", "interval": 1e-3, "duration": 1e5}, "at most 268435456"),
        ([{}, {"starts": {"airframe.mass": -1.0}}], {"scenario": "hover"}, "run 1: airframe"),
        ([{}, {"starts": {"airframe.mas": 1.0}}], {"scenario": "hover"}, "run 1: airframe"),
        ([{}, {"starts": {"airframe.mass": "m"}}], {"scenario": "hover"}, "run 1: starts = "),
        ([{}, {"scenario": "hovr"}], {"scenario": "hover"}, "run 1: "),
        ([{}, {"controller": "lqg"}], {"scenario": "hover"}, "run 1: "),
        ([{}, {"controller": 3}], {"scenario": "hover"}, "run 1: controller = 3: needs a name"),
        ([{}, {"effects": ["rotordrag"]}], {"scenario": "hover"}, "run 1: effects: there is no"),
        ([{}, {"effects": {"rotor_drag": 1}}], {"scenario": "hover"}, "run 1: effects: rotor_drag"),
        ("abc", {"scenario": "hover"}, "run 0: 'a': give the arguments of each run"),
        ({"seed": 1}, {"scenario": "hover"}, "run 0: 'seed': give the arguments of each run"),
        ([{}, None], {"scenario": "hover"}, "run 1: None: give the arguments of each run"),
        (7, {"scenario": "hover"}, "runs = 7: give the arguments of each run"),
        ([{"wind": "abc"}], {"scenario": "hover"}, "run 0: wind = 'abc': give three"),
        ([{"wind": ("a", "b", "c")}], {"scenario": "hover"}, "run 0: wind = ('a', 'b', 'c'): give"),
        ([{"seed": "x"}], {"scenario": "hover"}, "run 0: seed = 'x': needs a whole number"),
        ([{"gusts": "yes"}], {"scenario": "hover"}, "run 0: gusts = 'yes': needs true or false"),
        ([{"scenario": None}], {}, "run 0: scenario = None: needs the name of a mission"),
        ([{}], {"scenario": "hover", "workers": 1.5}, "workers 1.5: needs a whole number"),
    ],
)
def test_what_cannot_be_flown_is_refused(runs: Any, shared: dict[str, Any], says: str) -> None:
    with pytest.raises(TwinError, match=re.escape(says)):
        ut.simulate_many(runs, **shared)


@pytest.fixture
def ssp(tmp_path: Path) -> Path:
    """A hover that a file describes."""
    return write_ssp(scenario_system(Scenario("hover"), tmp_path), tmp_path / "hover.ssp")


@pytest.mark.parametrize(
    ("own", "named"),
    [
        ({"wind": (4.0, 0.0, 0.0)}, "wind_m_s"),
        ({"gusts": True}, "gusts"),
        ({"seed": 3}, "seed"),
        ({"effects": ["rotor_drag"]}, "effects"),
        ({"effects": {"nothing_of_this_name": {}}}, "effects"),
    ],
)
def test_every_run_of_an_ssp_takes_start_values_only(
    ssp: Path, own: dict[str, Any], named: str
) -> None:
    with pytest.raises(TwinError, match=rf"run 1: .* not {named}\."):
        ut.simulate_many([{}, own], scenario=ssp)


def test_a_sweep_of_an_ssp_varies_start_values_only(ssp: Path, tmp_path: Path) -> None:
    with pytest.raises(TwinError, match=r"an \.ssp brings its own parts.* not gusts\."):
        ut.sweep(ssp, out=tmp_path / "out", vary={"gusts": [False, True]}, method="grid")


def plan(given: list[dict[str, Any]], folder: Path) -> Plan:
    """Plan of runs of a mission, with full recordings."""
    scenarios = [asked_scenario("plan", "hover", fused=True, **own) for own in given]
    return plan_of(scenarios, folder, whole=True)


def test_equal_vehicles_share_a_system(tmp_path: Path) -> None:
    light = ut.vehicle("copter_default")
    heavy = [replace(light, mass_kg=1.1 * light.mass_kg) for _ in range(MOST_SYSTEMS)]
    given: list[dict[str, Any]] = [{"vehicle": v} for v in (None, light, replace(light), *heavy)]
    made = plan(given, tmp_path)
    assert [job.stand for job in made.jobs] == [0] * 3 + [1] * MOST_SYSTEMS
    assert made.vehicles == ("copter_default", "copter_default (2)")


def test_a_run_without_an_argument_has_the_value_that_flies() -> None:
    light = ut.vehicle("copter_default")
    heavy = replace(light, mass_kg=1.1 * light.mass_kg)
    given: list[dict[str, Any]] = [
        {"vehicle": None, "starts": None},
        {"vehicle": heavy, "wind": (1.0, 0.0, 0.0), "gusts": True, "seed": 4},
        {"vehicle": light, "effects": {"rotor_drag": {"k_xy_1_s": 0.4}}},
        {"controller": "px4", "starts": {"airframe.mass": 1.3}},
    ]
    flown = ut.simulate_many(given, scenario="hover", duration=0.1)
    asked = flown.table[[*flown.design.vary]]
    lqr, still = ["lqr"] * 3, [0.0, 0.0]
    assert asked.drop(columns="effect.rotor_drag.k_xy_1_s").to_dict("list") == {
        "mission": ["hover"] * 4,
        "vehicle": ["copter_default", "copter_default (2)", "copter_default", "copter_default"],
        "wind.north": [0.0, 1.0, *still],
        "wind.east": [0.0, 0.0, *still],
        "wind.down": [0.0, 0.0, *still],
        "gusts": [False, True, False, False],
        "seed": [0.0, 4.0, *still],
        "effect.rotor_drag": [False, False, True, False],
        "controller": [*lqr, "px4"],
        "airframe.mass": [light.mass_kg, heavy.mass_kg, light.mass_kg, 1.3],
    }
    assert asked["effect.rotor_drag.k_xy_1_s"][2] == 0.4
    assert [bool(flown.again(run)) for run in range(4)] == [True, False, True, True]
    single = ut.simulate(**{"scenario": "hover", "duration": 0.1, **given[1]})
    assert "wind" in single.warnings[0]
    assert [run.warnings for run in flown] == [(), single.warnings, (), ()]
    assert flown.warnings == single.warnings
    assert dict(flown[1].units) == dict(single.units)
    assert flown[1] in flown
    assert flown.index(flown[1]) == 1
    assert flown != replace(flown, table=flown.table.copy())


def test_effects_that_are_read_once_act_in_all_runs() -> None:
    flown = ut.simulate_many([{}, {}], scenario="hover", duration=0.1, effects=iter(["rotor_drag"]))
    assert flown.table["effect.rotor_drag"].tolist() == [True, True]
    assert [run.facts["effects"] for run in flown] == ["rotor_drag"] * 2


def test_too_many_values_are_refused_before_building(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uavtwin.sweeps.plan.fused_system", None)
    with pytest.raises(TwinError, match="at most 268435456"):
        ut.simulate_many([{}] * 4, scenario="tour", interval=1e-3, duration=1e5)


def test_a_run_that_failed_at_its_start_has_no_file(tmp_path: Path) -> None:
    empty = Recording((), np.zeros(0), np.zeros((0, 0)))
    table = pd.DataFrame({"run": [0], "outcome": ["failed"]})
    ended = ut.Runs("hover", table, Listed({}), [], runs=(ut.Run("hover", empty, {}),))
    folder = ended.save(tmp_path / "saved")
    assert [file.name for file in folder.iterdir()] == ["runs.parquet"]
