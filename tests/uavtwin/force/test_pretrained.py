"""The models that are shipped: found by their names, and worth what their cards say."""

from pathlib import Path

import pytest
import yaml

import uavtwin as ut
from twin.vehicle_file import load_vehicle
from uavtwin.demo.chain import HOLDOUT
from uavtwin.demo.flights import fly, hide
from uavtwin.exports.parts import PRETRAINED, learned, model_folder
from uavtwin.force.evaluate import SHIPPED, UNTRAINED, ForceEvaluation

MODELS = sorted(p.name for p in PRETRAINED.iterdir() if p.is_dir())
SEED = 4
"""Of the demo whose flights taught the model."""


@pytest.mark.parametrize("name", MODELS)
def test_a_shipped_model_has_its_card_and_its_vehicle(name: str) -> None:
    folder = model_folder(name)
    network, force = learned(folder)
    assert network is not None or force is not None
    head = yaml.safe_load((folder / "README.md").read_text("utf-8").split("---")[1])
    assert head["license"] == "bsd-3-clause" and head["model-index"]
    assert head["vehicle"]["name"] == load_vehicle(folder / "vehicle.toml").name


def test_a_folder_of_the_same_name_comes_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert model_folder("copter_drag") == PRETRAINED / "copter_drag"
    assert model_folder("other/copter_drag") == Path("other/copter_drag")
    Path("copter_drag").mkdir()
    assert model_folder("copter_drag") == Path("copter_drag")


@pytest.mark.slow
def test_it_flies_a_flight_of_the_demo_closer_than_the_observer() -> None:
    vehicle = load_vehicle("copter_default")
    plant = hide(vehicle, SEED).plant
    ((name, waypoints),) = HOLDOUT.items()
    found = ut.evaluate("copter_drag", fly(vehicle, plant, 99, name, waypoints))
    assert isinstance(found, ForceEvaluation)
    rows = found.record.summary
    off = {r["model"]: r["velocity"] for r in rows if r["horizon_s"] == 0.5}
    assert off[SHIPPED] < 0.5 * off[UNTRAINED]
