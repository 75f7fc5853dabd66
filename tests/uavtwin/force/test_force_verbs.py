"""A force that the file lacks: learned, flown by exported FMUs on another flight, refused."""

import json
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pandas as pd
import pytest
import yaml

import uavtwin as ut
from twin.errors import TwinError
from twin.logs import write_flight
from twin.vehicle_file import load_vehicle
from uavtwin.cli import main
from uavtwin.demo.flights import fly
from uavtwin.force import closed_loop, open_loop
from uavtwin.force.evaluate import EXPLAINED, LAST_READING, SHIPPED, SHOWN, UNTRAINED, over
from uavtwin.force.memory import CHECKPOINT, Memory

COPTER = load_vehicle("copter_default")
DRAG_1_S = 0.6
PLANT = replace(
    COPTER,
    drag_linear_n_s_m=COPTER.drag_linear_n_s_m
    + DRAG_1_S * COPTER.mass_kg * np.array([1.0, 1.0, 0.0]),
)
PLACES = {
    "one": ((4.0, 2.0, -2.0), (-3.0, -2.0, -2.5), (3.0, -4.0, -2.0)),
    "two": ((-4.0, 3.0, -2.0), (3.0, 3.0, -1.5), (-2.0, -4.0, -2.0)),
    "three": ((3.0, -3.0, -2.0), (-4.0, 2.0, -2.0), (2.0, 4.0, -2.5)),
}


def _run(*arguments: object) -> None:
    main.app([str(a) for a in arguments], standalone_mode=False)


@pytest.fixture(scope="module", autouse=True)
def _fewer_flights() -> Iterator[None]:
    """A quarter of the starts, a sixth of the missions: nothing hangs on their number."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(open_loop, "EVERY_S", 1.0)
        patch.setattr(closed_loop, "FLIGHTS", 2 * len(closed_loop.MISSIONS))
        yield


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Three flights of a vehicle with more drag than its file says."""
    folder = tmp_path_factory.mktemp("flights")
    paths = {}
    for seed, (name, places) in enumerate(PLACES.items(), start=1):
        legs = (
            ("ground", 0.5, (0.0, 0.0, 0.0)),
            ("takeoff", 2.5, (0.0, 0.0, -2.0)),
            *(("tour", 3.5, place) for place in places),
        )
        paths[name] = folder / f"{name}.parquet"
        write_flight(fly(COPTER, PLANT, seed, name, legs), paths[name])
    return paths


@pytest.fixture(scope="module")
def model(logs: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Learned from the first two."""
    folder = tmp_path_factory.mktemp("learned") / "model"
    _run(
        "train",
        *(logs["one"], logs["two"]),
        *("--vehicle", "copter_default", "--protocol", "force", "--out", folder),
    )
    return folder


@pytest.fixture(scope="module")
def found(
    model: Path, logs: dict[str, Path], tmp_path_factory: pytest.TempPathFactory
) -> tuple[dict[str, object], Path]:
    """Evaluated on the third."""
    out = tmp_path_factory.mktemp("evaluated") / "evaluation"
    _run("evaluate", model, logs["three"], "--physics", "copter_default", "--out", out)
    return json.loads((out / "evaluation.json").read_text("utf-8")), out


@pytest.mark.slow
def test_the_drag_that_is_missing_becomes_a_law(model: Path) -> None:
    names = {p.name for p in model.iterdir()}
    assert names == {"README.md", "force.json", "vehicle.toml", "report.html", "run.json"}
    law = json.loads((model / "force.json").read_text("utf-8"))
    columns, values = law["features"], np.array(law["law"]["linear"])
    for a, row in zip("xy", values, strict=False):
        assert law["outputs"][f"force_{a}"]["law"] == "linear"
        of_air = row[columns.index(f"air_{a}")] + 2.0 * row[columns.index(f"speed air_{a}")]
        assert -1.2 * DRAG_1_S < of_air < -0.4 * DRAG_1_S, "at 2 m/s; the tilt tells of it, too"
    page = (model / "report.html").read_text("utf-8")
    assert not re.search(r'<(script|link|img)[^>]+(src|href)="http', page)


@pytest.mark.slow
def test_a_training_that_is_cut_off_is_resumed_to_the_same_bytes(
    model: Path, logs: dict[str, Path], tmp_path: Path
) -> None:
    """After its first step, later, and in the middle of a line."""
    out, add, steps = tmp_path / "model", Memory._add, 0
    words = ("train", logs["one"], logs["two"], "--vehicle", "copter_default", "--protocol")
    for most in (1, 2, 2):
        left = most

        def cut(memory: Memory, *given: Any) -> None:
            nonlocal left
            add(memory, *given)
            left -= 1
            if not left:
                raise KeyboardInterrupt

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Memory, "_add", cut)
            _run(*words, "force", "--out", out)  # the command line takes Ctrl-C for an end
        assert [p.name for p in out.iterdir()] == [CHECKPOINT]
        steps += most  # none is taken twice
        assert len((out / CHECKPOINT).read_text().splitlines()) == 1 + steps
        with (out / CHECKPOINT).open("a") as file:
            file.write('{"what": "half')
    with pytest.raises(TwinError, match="of another training of a learned force"):
        _run(*words, "force", "--seed", "1", "--out", out)
    _run(*words, "force", "--out", out)
    assert {p.name: p.read_bytes() for p in out.iterdir()} == {
        p.name: p.read_bytes() for p in model.iterdir()
    }


@pytest.mark.slow
def test_the_exported_twin_is_less_far_off_on_a_flight_it_has_not_seen(
    found: tuple[dict[str, object], Path], model: Path, logs: dict[str, Path]
) -> None:
    told, out = found
    rows = {r["model"]: r for r in told["summary"] if r["horizon_s"] == 0.5}  # type: ignore[attr-defined]
    assert rows[SHIPPED]["velocity"] < 0.5 * rows[EXPLAINED]["velocity"]
    assert rows[SHIPPED]["velocity"] < rows[UNTRAINED]["velocity"]
    assert rows[SHIPPED]["velocity"] < rows[LAST_READING]["velocity"]
    assert rows["physics"]["position"] == pytest.approx(rows[EXPLAINED]["position"], rel=1e-9)
    assert min(told["inside"]["three"][:3]) > 0.8  # type: ignore[index]
    assert SHOWN[UNTRAINED] in (out / "report.html").read_text("utf-8")
    series = pd.read_parquet(out / "series" / "three.parquet")
    for side, twin in (("", "physics"), ("_explained", EXPLAINED), ("_corrected", SHIPPED)):
        off = series[[f"residual{side}.velocity_{a}" for a in "xyz"]]
        assert np.sqrt((off**2).mean().sum()) == pytest.approx(rows[twin]["velocity"], rel=1e-9)
    head = yaml.safe_load((out / "README.md").read_text("utf-8").split("---\n")[1])
    metrics = {m["name"]: m["value"] for m in head["model-index"][0]["results"][0]["metrics"]}
    assert metrics["velocity after 0.5 s, m/s"] == rows[SHIPPED]["velocity"]


@pytest.mark.slow
def test_the_shipped_fmu_holds_law_and_observer(model: Path, tmp_path: Path) -> None:
    _run(
        "export",
        *("corrected-twin", "--drive", "commands", "--model", model, "--out", tmp_path / "fmus"),
    )
    (fmu,) = (tmp_path / "fmus").glob("*.fmu")
    starts = {v.name: v.start for v in fmpy.read_model_description(fmu).modelVariables if v.start}
    law = json.loads((model / "force.json").read_text("utf-8"))
    weight = law["law"]["linear"][0][law["features"].index("air_x")]
    assert float(starts["residual_force.linear.force_x.air_x"]) == weight
    assert starts["airframe.disturbance.enabled"] == "true"


@pytest.mark.slow
def test_one_twin_has_the_law_and_the_correction_of_its_sensors(
    model: Path, logs: dict[str, Path], tmp_path: Path
) -> None:
    """Trained, exported and evaluated as one folder; alone it flies with the law."""
    both = tmp_path / "both"
    _run(
        *("train", logs["one"], logs["two"], "--vehicle", "copter_default", "--protocol", "free"),
        *("--rate", 50, "--law", model, "--out", both),
    )
    assert (both / "force.json").read_bytes() == (model / "force.json").read_bytes()
    fmus, flown = tmp_path / "fmus", tmp_path / "flown"
    _run("export", "corrected-twin", "--drive", "commands", "--model", both, "--out", fmus)
    names = {
        v.name for v in fmpy.read_model_description(fmus / "corrected_twin.fmu").modelVariables
    }
    assert {"residual_force.distance", "compensator.corrected.gyro_x"} <= names
    _run("evaluate", both, logs["three"], "--out", flown)
    rows = json.loads((flown / "evaluation.json").read_text("utf-8"))["in_use"]["channels"]
    (alone,) = (r for r in rows if (r["channel"], r["mode"]) == ("vel_x", "alone"))
    assert alone["uncorrected"] < 0.1, "m/s; without the law it brakes by 0.6 m/s2 less per m/s"


@pytest.mark.slow
def test_a_mission_is_flown_with_the_law(model: Path, tmp_path: Path) -> None:
    twin = ut.twin(
        ut.load_vehicle(str(model / "vehicle.toml")), "tour", force=ut.learned_force(model)
    )
    (fmu,) = ut.export(twin, tmp_path / "twin.fmu").paths
    outputs = ["residual_force.force_x", "residual_force.distance", "airframe.vel_x"]
    flown = fmpy.simulate_fmu(fmu, output=outputs)
    moving = np.abs(flown["airframe.vel_x"]) > 0.5
    assert moving.any()
    pushed = flown["residual_force.force_x"][moving] * flown["airframe.vel_x"][moving]
    assert np.mean(pushed < 0) > 0.8 and pushed.mean() < -0.2, "drag takes energy, W"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda m, logs, t: ("evaluate", m, _renamed(logs["one"], t)), "trained on this flight"),
        (
            lambda m, logs, t: ("evaluate", m, logs["three"], "--explained", "copter_default"),
            "explained does not go with",
        ),
        (
            lambda m, logs, t: ("export", "corrected-twin", "--model", m, "--vehicle", "crazyflie"),
            "not of",
        ),
        (lambda m, logs, t: ("export", "compensator", "--model", m), "no FMU of its own"),
        (
            lambda m, logs, t: ("export", "corrected-twin", "--model", m, "--noise"),
            "nothing is to be drawn",
        ),
        (lambda m, logs, t: ("export", "corrected-twin", "--model", m, "--int8"), "no form of 8"),
        (
            lambda m, logs, t: (
                *("train", logs["one"], "--vehicle", "copter_default"),
                *("--protocol", "force", "--epochs", 3),
            ),
            "epochs 3: protocol force has no such choice",
        ),
        (
            lambda m, logs, t: (
                *("train", logs["one"], "--vehicle", "copter_default"),
                *("--protocol", "force", "--device", "auto"),
            ),
            "device auto: protocol force has no such choice",
        ),
        (
            lambda m, logs, t: (
                *("train", logs["one"], "--vehicle", "copter_default", "--law", m),
                *("--protocol", "track"),
            ),
            "acts in the exported twin, which protocol free corrects alone",
        ),
    ],
)
def test_what_cannot_be_done_says_why(
    model: Path,
    logs: dict[str, Path],
    tmp_path: Path,
    make: Callable[[Path, dict[str, Path], Path], tuple[object, ...]],
    said: str,
) -> None:
    with pytest.raises(TwinError, match=said):
        _run(*make(model, logs, tmp_path), "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def _renamed(path: Path, folder: Path) -> Path:
    copy = folder / "other_name.parquet"
    copy.write_bytes(path.read_bytes())
    return copy


@pytest.mark.slow
def test_one_flight_teaches_no_law(logs: dict[str, Path], tmp_path: Path) -> None:
    trained = ut.train(
        ut.read_flight(logs["one"]), ut.vehicle("copter_default"), tmp_path / "m", protocol="force"
    )
    assert "one flight tells none" in trained.claim
    assert not trained.model().law.linear.any()  # type: ignore[union-attr]


@pytest.mark.slow
def test_ratios_are_of_the_explained_twin(found: tuple[dict[str, object], Path]) -> None:
    import pandas as pd

    table = pd.DataFrame(found[0]["cells"])
    ratios = over(table, EXPLAINED)
    assert (ratios == 1).all() and len(ratios) == 12
