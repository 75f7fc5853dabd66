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
from twin.errors import TwinError
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
    assert flown.table["airframe.mass"].notna().sum() == 1


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
    ],
)
def test_what_cannot_be_flown_is_refused(
    runs: list[dict[str, Any]], shared: dict[str, Any], says: str
) -> None:
    with pytest.raises(TwinError, match=re.escape(says)):
        ut.simulate_many(runs, **shared)
