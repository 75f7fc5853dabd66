"""The folder of a learned force: written, read back, refused where it is damaged."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from onnx import TensorProto, helper, numpy_helper

from learning.force.model import (
    FILE,
    MODULE_FILE,
    Acceptance,
    ForceModel,
    MissionCheck,
    RidgeScore,
    TrainingFlight,
    load_force,
    save_force,
)
from learning.force.module import law_function
from twin.errors import ModelError
from twin.logs import Flight
from twin.physics.residual_force import FEATURES, INPUTS, ForceLaw


def _law(n: int) -> ForceLaw:
    rng = np.random.default_rng(n)
    d = len(INPUTS)
    return ForceLaw(
        linear=rng.normal(size=(6, len(FEATURES))),
        centre=rng.normal(size=d),
        scale=np.ones(d),
        whitening=np.eye(d),
        reach=1.5,
        most=np.ones(6),
        units=np.eye(6),
    )


MODEL = ForceModel(
    law=_law(0),
    flights=(TrainingFlight("one", "00"),),
    vehicle="x",
    vehicle_sha256="11",
    seed=3,
    ridge=0.1,
    tried=(RidgeScore("force", 1.0, 0.95, 1.1), RidgeScore("both", 0.1, 0.9, 1.01)),
    acceptance=Acceptance(0.5, 0.9, 0.8),
    closed_loop=MissionCheck(12, 1, 1),
)


def _same(a: ForceLaw, b: ForceLaw) -> bool:
    there = b.arrays()
    return all(np.array_equal(v, there[k]) for k, v in a.arrays().items())


def test_what_is_read_is_what_was_written(tmp_path: Path) -> None:
    save_force(MODEL, tmp_path)
    found = load_force(tmp_path)
    assert _same(found.law, MODEL.law)
    assert replace(found, law=MODEL.law) == MODEL


def test_the_same_model_gives_the_same_bytes(tmp_path: Path) -> None:
    save_force(MODEL, tmp_path)
    first = (tmp_path / FILE).read_bytes()
    save_force(load_force(tmp_path), tmp_path)
    assert (tmp_path / FILE).read_bytes() == first


@pytest.mark.parametrize(
    "spoil",
    [
        lambda c: c.update(format=99),
        lambda c: c["outputs"].pop("moment_z"),
        lambda c: c["law"].pop("reach"),
        lambda c: c["law"]["linear"].pop(),
        lambda c: c["law"]["scale"].__setitem__(0, -1.0),
        lambda c: c["tried"][0].update(ratio="fast"),
        lambda c: c.update(inputs=["airspeed"]),
    ],
)
def test_a_damaged_file_is_refused_by_name(tmp_path: Path, spoil: object) -> None:
    save_force(MODEL, tmp_path)
    content = json.loads((tmp_path / FILE).read_text("utf-8"))
    spoil(content)  # type: ignore[operator]
    (tmp_path / FILE).write_text(json.dumps(content), "utf-8")
    with pytest.raises(ModelError, match=rf"{FILE}.*Train the model again"):
        load_force(tmp_path)


def _module() -> bytes:
    """ONNX file of a law that is one matrix."""
    rows = (("x", 12), ("y", 6))
    given, wanted = (helper.make_tensor_value_info(n, TensorProto.FLOAT, ["n", k]) for n, k in rows)
    weights = numpy_helper.from_array(np.eye(12, 6, dtype=np.float32), "w")
    node = helper.make_node("MatMul", ["x", "w"], ["y"])
    graph = helper.make_graph([node], "g", [given], [wanted], [weights])
    opset = [helper.make_opsetid("", 17)]
    return bytes(helper.make_model(graph, opset_imports=opset, ir_version=8).SerializeToString())


def test_a_module_stays_with_its_law(tmp_path: Path) -> None:
    """The same bytes again; a folder that lost it, or has another, is no folder without a law."""
    onnx = _module()
    law = replace(MODEL.law, linear=np.zeros((6, len(FEATURES))), module=law_function(onnx))
    save_force(replace(MODEL, law=law, ridge=None, onnx=onnx), tmp_path)
    found, first = load_force(tmp_path), (tmp_path / FILE).read_bytes()
    assert found.law.module is not None and found.onnx == onnx
    save_force(found, tmp_path)
    assert (tmp_path / FILE).read_bytes() == first
    (tmp_path / MODULE_FILE).write_bytes(onnx + b"\0")
    with pytest.raises(ModelError, match=rf"{MODULE_FILE} beside it is not the one"):
        load_force(tmp_path)
    (tmp_path / MODULE_FILE).unlink()
    with pytest.raises(ModelError, match=rf"{MODULE_FILE} beside it is missing"):
        load_force(tmp_path)


def test_a_folder_without_one_says_who_writes_it(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="uavtwin train --protocol force"):
        load_force(tmp_path)


def test_a_flight_is_known_whatever_it_is_called() -> None:
    table = pd.DataFrame({"time": [0.0, 0.1], "pos_x": [1.0, np.nan], "phase": ["hover", ""]})
    flight = Flight("one", table)
    same = Flight("two", table[["phase", "pos_x", "time"]])
    other = Flight("one", table.assign(pos_x=[1.0, 2.0]))
    assert flight.fingerprint == same.fingerprint != other.fingerprint
