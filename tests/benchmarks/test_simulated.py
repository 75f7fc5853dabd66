"""Simulated flights with hidden effects: same bytes, nothing given away, resumable."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmarks.compensator.residuals import residuals
from benchmarks.compensator.simulated import (
    HIDDEN_SETS,
    VEHICLE,
    Individual,
    hide,
    individuals,
    main,
    orders,
    produce,
)
from benchmarks.hidden_effects.plants import missions
from learning.data.channels import GROUPS
from learning.data.flights import ResidualFlight
from twin.logs import read_flight
from twin.vehicle_file import load_vehicle

INDIVIDUAL = Individual("worn", 1, repeats=1)
SECONDS = 5.2


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One aircraft, flights cut short."""
    folder: Path = tmp_path_factory.mktemp("simulated")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(missions, "DURATION_S", SECONDS)
        produce(folder, [INDIVIDUAL])
    return folder


@pytest.fixture(scope="module")
def made(out: Path) -> ResidualFlight:
    (flight,) = residuals(out, [INDIVIDUAL], "test", rate_hz=50.0)[INDIVIDUAL.name][:1]
    return flight


@pytest.mark.slow
def test_files_can_be_read_and_give_nothing_away(out: Path) -> None:
    folder = INDIVIDUAL.folder(out)
    vehicle = load_vehicle(str(folder / VEHICLE))
    assert not vehicle.effects
    assert vehicle.name == INDIVIDUAL.aircraft.name
    train, test = INDIVIDUAL.files(out, "train"), INDIVIDUAL.files(out, "test")
    assert [f.stem for f in train] == ["train_hover_1", "train_takeoff_1"]
    assert [f.stem for f in test] == ["test_tour_1", "test_forward_1"]
    for path in train + test:
        flight = read_flight(path)
        assert flight.has("acc_x", "gyro_x", "mag_x", "pos_x", "vel_x", "q_w", "cmd_4")
    assert {f.name for f in folder.iterdir()} == {f.name for f in train + test} | {VEHICLE}
    truth = json.loads(INDIVIDUAL.truth(out).read_text())
    assert set(truth["effects"]) == set(HIDDEN_SETS["worn"])
    assert truth["effects"]["battery_sag"]["slope"]["value"] > 1


def test_training_never_moves_far_and_testing_does(out: Path) -> None:
    def fastest(use: str) -> list[float]:
        tables = [pd.read_parquet(f) for f in INDIVIDUAL.files(out, use)]
        return [float(np.hypot(t["vel_x"], t["vel_y"]).max()) for t in tables]

    assert max(fastest("train")) < 0.8 < 1.2 < min(fastest("test"))


def test_what_is_there_is_not_flown_again(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = INDIVIDUAL.files(out, "train")[0]
    before = path.stat().st_mtime_ns
    assert produce(out, [INDIVIDUAL]) == []
    assert "1 aircraft, 1 flown already" in capsys.readouterr().err
    assert path.stat().st_mtime_ns == before


@pytest.mark.slow
def test_command_line_gives_the_same_bytes_whatever_flies_beside(
    out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(missions, "DURATION_S", SECONDS)
    arguments = ["--out", str(tmp_path), "--set", "worn", "--seeds", "2", "--repeats", "1"]
    assert main(arguments) == 0
    assert {f.name for f in (tmp_path / "flights").iterdir()} == {"worn_0", "worn_1"}
    for path in INDIVIDUAL.folder(out).iterdir():
        again = INDIVIDUAL.folder(tmp_path) / path.name
        assert again.read_bytes() == path.read_bytes(), path.name


def test_sizes_differ_by_seed_and_flights_by_name() -> None:
    first, second = (hide(Individual("loaded", k))[1]["mass_offset"]["mass_kg"] for k in (0, 2))
    assert first.value != second.value
    plant, _ = hide(INDIVIDUAL)
    flown = orders(replace(INDIVIDUAL, repeats=2), plant)
    assert len({o.plant.charge for o in flown.values()}) == len(flown) == 8
    assert len({o.seed for o in flown.values()}) == 8
    assert len({i.name for i in individuals(seeds=3)}) == 3 * len(HIDDEN_SETS)


@pytest.mark.slow
def test_residuals_show_what_is_hidden_and_are_kept(
    out: Path, made: ResidualFlight, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Drag and a turned accelerometer: more than the noise of the sensors by far."""
    fresh = made.fresh[:, GROUPS["acc"]]
    assert made.rate_hz == 50.0 and fresh.any()
    assert np.sqrt(np.mean(made.residual[:, GROUPS["acc"]][fresh] ** 2)) > 0.2
    monkeypatch.setattr("benchmarks.compensator.residuals.residual_flight", None)
    (again,) = residuals(out, [INDIVIDUAL], "test", rate_hz=50.0)[INDIVIDUAL.name][:1]
    np.testing.assert_array_equal(again.residual, made.residual)
    assert again.spans == made.spans and again.name == made.name
    with pytest.raises(TypeError):  # another horizon is made again
        residuals(out, [INDIVIDUAL], "test", rate_hz=50.0, restart_s=0.2)
