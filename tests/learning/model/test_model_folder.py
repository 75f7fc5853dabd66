"""Model folder: what was written is read; what does not fit is refused."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from learning_rigs.residual_rig import made_up, tiny, train

from learning.data.channels import CHANNELS
from learning.model.compensator import Compensator
from learning.model.folder import MODEL, WEIGHTS, load, save
from twin.errors import ModelError

FLIGHT = made_up(0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("model")
    preset = tiny(epochs=1, clustering="sensors")
    train([FLIGHT], preset, "track", 2, 0, path)
    return path


@pytest.fixture
def copy(folder: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(folder, tmp_path / "copy"))


def test_read_as_written(folder: Path, tmp_path: Path) -> None:
    model = load(folder)
    save(model, tmp_path)
    for name in (WEIGHTS, MODEL):
        assert (folder / name).read_bytes() == (tmp_path / name).read_bytes()
    again = load(tmp_path)
    assert isinstance(again, Compensator)
    assert again.info == model.info and not again.training
    one, other = model.run(FLIGHT), again.run(FLIGHT)
    for name in ("correction", "spread", "anomaly", "inside"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_description_says_what_a_tool_needs(folder: Path) -> None:
    said = json.loads((folder / MODEL).read_text())
    assert said["channels"] == list(CHANNELS) and len(said["units"]) == 15
    assert said["clusters"][1] == ["acc_x", "acc_y", "acc_z"]
    assert (said["protocol"], said["horizon"], said["rate_hz"]) == ("track", 2, 100.0)
    assert (said["vehicle"], said["vehicle_sha256"], said["n_commands"]) == ("v", "0f", 2)
    assert [f["name"] for f in said["flights"]] == ["made_up_0"]
    place = said["envelope"]
    assert place["inputs"][-1] == "cmd_2" and len(place["centre"]) == len(place["inputs"]) == 7
    assert FLIGHT.commands[:, 1].min() < place["centre"][-1] < FLIGHT.commands[:, 1].max()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"format": 99}, "layout 99"),
        ({"channels": ["gyro_x"]}, "channels gyro_x"),
        ({"clusters": [["nonsense"]]}, "nonsense"),
        ({"n_commands": 3}, "size mismatch"),
    ],
)
def test_a_description_that_does_not_fit_is_refused(
    copy: Path, change: dict[str, object], said: str
) -> None:
    content = json.loads((copy / MODEL).read_text()) | change
    (copy / MODEL).write_text(json.dumps(content))
    with pytest.raises(ModelError, match=f"(?s){said}.*train the model again"):
        load(copy)


def test_damaged_and_missing_files_are_refused(copy: Path) -> None:
    weights = (copy / WEIGHTS).read_bytes()
    (copy / WEIGHTS).write_bytes(weights[: len(weights) // 2])
    with pytest.raises(ModelError, match="do not fit"):
        load(copy)
    (copy / WEIGHTS).unlink()
    with pytest.raises(ModelError, match=f"no {WEIGHTS}"):
        load(copy)


def test_nothing_is_a_pickle(folder: Path) -> None:
    assert {p.suffix for p in folder.iterdir()} == {".json", ".safetensors"}
    assert isinstance(load(folder), Compensator)
