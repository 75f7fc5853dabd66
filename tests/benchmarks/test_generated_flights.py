"""Signals drawn as those of the training flights were, by `benchmarks.paper.generated`."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.paper import generated
from twin.errors import TwinError
from twin.logs import Flight, read_flight, write_flight
from twin.vehicle_file import load_vehicle
from uavtwin.cli import main
from uavtwin.demo.flights import fly

COPTER = load_vehicle("copter_default")
NOISE_M_S2, BIAS_M_S2 = 0.4, 0.8


def _run(*arguments: object) -> None:
    main.app([str(a) for a in arguments], standalone_mode=False)


def _generated(*arguments: object) -> None:
    generated.main([str(a) for a in arguments])


def _noisy(seed: int) -> Flight:
    """A flight whose accelerometer reads an offset along x, and noise."""
    flight = fly(COPTER, COPTER, seed, f"noisy_{seed}")
    rng, table = np.random.default_rng(seed), flight.table.copy()
    table["acc_x"] += BIAS_M_S2 + NOISE_M_S2 * rng.standard_normal(len(table))
    return replace(flight, table=table)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Flights and a model of two of them."""
    place = tmp_path_factory.mktemp("generate")
    logs = [place / f"{k}.parquet" for k in range(3)]
    for k, log in enumerate(logs):
        write_flight(_noisy(k), log)
    options = ("--vehicle", "copter_default", "--protocol", "generate", "--model", "innovations")
    _run("train", *logs[:2], *options, "--out", place / "model")
    return place


@pytest.mark.slow
def test_the_drawn_sensors_are_those_of_the_training(folder: Path) -> None:
    """A flight table that is read again: the offset and noise that were planted, no others."""
    _generated(
        "fly", folder / "model", "--mission", "hover", "--seed", 3, "--out", folder / "a.csv"
    )
    flight = read_flight(folder / "a.csv")
    table = flight.table[flight.table["phase"] == "hover"]
    acc = table[["acc_x", "acc_y"]].dropna()
    assert len(acc) == pytest.approx(100 * len(table) / 200, rel=0.05)  # as the model's rate
    assert acc["acc_x"].mean() == pytest.approx(BIAS_M_S2, abs=0.15)
    assert acc["acc_x"].std() == pytest.approx(NOISE_M_S2, rel=0.25)
    assert acc["acc_y"].std() < 0.3 * NOISE_M_S2
    assert "mag_x" not in flight.table  # no flight of the training has a magnetometer
    said = json.loads((folder / "a.run.json").read_text("utf-8"))
    assert said["seed"] == 3 and len(said["inputs"]) == 3


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes(folder: Path) -> None:
    short = (folder / "model", "--mission", "takeoff")
    for name, seed in (("one", 1), ("two", 1), ("other", 2)):
        _generated("fly", *short, "--seed", seed, "--out", folder / f"{name}.parquet")
    one, two, other = ((folder / f"{n}.parquet").read_bytes() for n in ("one", "two", "other"))
    assert one == two != other
    with pytest.raises(TwinError, match=r"one\.parquet: exists"):
        _generated("fly", folder / "model", "--out", folder / "one.parquet")


@pytest.mark.slow
def test_draws_are_held_against_a_flight(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _generated("evaluate", folder / "model", folder / "2.parquet", "--out", tmp_path / "e")
    printed = json.loads((tmp_path / "e" / "evaluation.json").read_text("utf-8"))
    assert capsys.readouterr().out == f"{printed['claim']}\n"
    assert printed["protocol"] == "generate" and printed["family"] == "innovations"
    rows = {(r["group"], r["model"]): r for r in printed["groups"]}
    assert {m for _, m in rows} >= {"model", "white noise", "a training flight"}
    assert rows["acc", "model"]["wasserstein_std"] < 0.2
    page = (tmp_path / "e" / "report.html").read_text("utf-8")
    assert "Drawn signals" in page and "a training flight" in page
    with pytest.raises(TwinError, match=r"corrects nothing.*benchmarks\.paper\.generated evaluate"):
        _run("evaluate", folder / "model", folder / "2.parquet", "--out", tmp_path / "f")


@pytest.mark.slow
def test_a_model_that_corrects_draws_nothing(folder: Path, tmp_path: Path) -> None:
    options = ("--vehicle", "copter_default", "--protocol", "free", "--model", "linear")
    _run("train", folder / "0.parquet", folder / "1.parquet", *options, "--out", tmp_path / "m")
    with pytest.raises(TwinError, match=r"trained for the protocol free; what draws"):
        _generated("fly", tmp_path / "m", "--out", tmp_path / "x.parquet")
    assert not (tmp_path / "x.parquet").exists()
    with pytest.raises(TwinError, match=r"model linear has the presets linear, no 'best'"):
        _run("train", folder / "0.parquet", *options, "--preset", "best", "--out", tmp_path / "n")
