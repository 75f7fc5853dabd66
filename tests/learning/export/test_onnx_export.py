"""The ONNX file: numbers of torch, everything inside, the same bytes, and what int8 costs."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from learning_rigs.compensator_rig import Rows, compensator, exported, flight, rows_of, tiny
from places import ROOT

from learning.data.channels import CHANNELS, GROUPS, PHASE_CODES, UNITS
from learning.export.graph import IR_VERSION, OPSET
from learning.export.streaming import INPUTS, OUTPUTS, streaming_model
from learning.export.write import (
    INT8_FILE,
    MODEL_FILE,
    REFERENCE_FILE,
    deviation,
    reference_vectors,
    streamed,
)
from learning.model.compensator import Compensator

EXAMPLE = ROOT / "examples" / "compensate_with_onnxruntime.py"
SAMPLES = 10_000
TOLERANCE = 1e-5
"""Of numbers of size 1, which the tiny models' units are; the alarm is relative."""
MODELS: dict[str, dict[str, Any]] = {
    "track": {},
    "track, the newest residual": {"horizon": 1},
    "reconstruct": {"protocol": "reconstruct"},
    "free": {"protocol": "free"},
    "free, paper": {"protocol": "free", "preset": tiny(skip=False, spread_head=False)},
    "no features": {"preset": tiny(features=False, temperature=0.3)},
    "two layers": {"preset": tiny(encoder_units=(10, 7), decoder_units=(5, 9, 6))},
    "hard": {"preset": tiny(quantiser="hard")},
    "no quantiser": {"preset": tiny(quantiser="none"), "protocol": "free"},
    "one command": {"commands": 1, "rate_hz": 50.0},
}


def assert_same(said: Rows, right: dict[str, np.ndarray], tolerance: float = TOLERANCE) -> None:
    """Correction, spread, alarm, envelope."""
    np.testing.assert_array_equal(said["inside"], right["inside"])
    for name in ("correction", "spread"):
        np.testing.assert_allclose(said[name], right[name], tolerance, tolerance, err_msg=name)
    np.testing.assert_allclose(said["anomaly"], right["anomaly"], rtol=tolerance, atol=tolerance)


@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
def test_onnxruntime_is_torch_sample_by_sample(name: str) -> None:
    """In and out of the envelope, through phases, with sensors that pause."""
    model = compensator(**MODELS[name])
    right = reference_vectors(model)
    said = streamed(streaming_model(model), right)
    assert_same(said, right, 2e-6)
    limited = name != "reconstruct"
    assert 0.5 < right["inside"].mean() < (1.0 if limited else 1.1)
    for channel in ("correction", "spread"):
        assert np.all(right[channel][0] != 0)


@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
def test_a_batch_is_its_samples_one_by_one(name: str) -> None:
    """Seven aircraft side by side, each with a state of its own, one of them with a sample that is
    no number: the last rounding of float32 apart, as if each had been alone."""
    model, count, steps = compensator(**MODELS[name]), 7, 20
    graph, rows = streaming_model(model), reference_vectors(model)
    each = [{n: v[40 * i :][:steps].copy() for n, v in rows.items()} for i in range(count)]
    each[3]["virtual"][5] = np.nan
    alone = [streamed(graph, rows) for rows in each]
    session, state = _session(graph), np.zeros((count, model.state_size), np.float32)
    for k in range(steps):
        now = {n: np.stack([rows[n][k] for rows in each]) for n in INPUTS[:-1]}
        *said, state = session.run(None, now | {INPUTS[-1]: state})
        for output, values in zip(OUTPUTS[:-1], said, strict=True):
            right = np.stack([rows[output][k] for rows in alone])
            np.testing.assert_allclose(values, right, rtol=2e-5, atol=2e-6, err_msg=output)
    assert state.shape == (count, model.state_size)


def test_operators_are_named_after_their_layer(folder: Path) -> None:
    """None twice; what is quantised stays a call of one sample."""
    graph = onnx.load(folder / MODEL_FILE).graph
    names = [node.name for node in graph.node]
    assert len(set(names)) == len(names)
    layers = {name.rpartition(".")[0] for name in names}
    assert {"inputs", "features", "linear", "envelope", "alarm", "quantiser", "read_out"} < layers
    assert {"encoder.layer_0", "encoder.to_latent", "decoder.layer_0"} < layers
    small = onnx.load(folder / INT8_FILE).graph
    assert all(v.type.tensor_type.shape.dim[0].dim_value == 1 for v in small.input)


@pytest.mark.slow
@pytest.mark.parametrize("protocol", ["reconstruct", "track", "free"])
def test_onnxruntime_is_torch_over_a_flight(protocol: Any) -> None:
    """10,000 samples against the sequence form, which evaluation uses."""
    model = compensator(protocol=protocol)
    along = flight(model, SAMPLES)
    found = model.run(along)
    right = {
        "correction": found.correction,
        "spread": found.spread,
        "anomaly": np.nan_to_num(found.anomaly)[:, None],
        "inside": found.inside[:, None],
    }
    said = streamed(streaming_model(model), rows_of(along))
    assert_same(said, right)
    assert 0.8 < found.inside.mean() <= 1.0


@pytest.mark.parametrize("name", MODELS)
def test_nothing_is_computed_for_nothing(name: str) -> None:
    graph = streaming_model(compensator(**MODELS[name])).graph
    used = {i for node in graph.node for i in node.input} | {o.name for o in graph.output}
    unused = [n.name for n in graph.node if not used & set(n.output)]
    assert not unused


@pytest.mark.parametrize("protocol", ["reconstruct", "track", "free"])
def test_a_sample_with_no_number_is_as_if_it_had_not_been(protocol: Any) -> None:
    """To the bit; a measurement that is not said to be valid may be anything."""
    model = compensator(protocol=protocol)
    rows = rows_of(flight(model, 30))
    rows["measured"] = np.where(rows["valid"] > 0.5, rows["measured"], np.float32("nan"))
    graph, kept = streaming_model(model), [k for k in range(30) if k not in (10, 20)]
    right = streamed(graph, {name: values[kept] for name, values in rows.items()})
    rows["virtual"][10, 3], rows["command"][20, 1] = np.float32("nan"), np.float32("inf")
    said = streamed(graph, rows)
    for name, values in right.items():
        assert np.isfinite(said[name]).all(), name
        np.testing.assert_array_equal(said[name][kept], values, name)
    assert not said["inside"][[10, 20]].any() and not said["correction"][[10, 20]].any()


def test_outside_the_envelope_nothing_is_corrected() -> None:
    model = compensator()
    rows = rows_of(flight(model, 30))
    rows["command"][10:20, 2] = float(model.place_centre[-2]) + 100.0
    said = streamed(streaming_model(model), rows)
    assert not said["correction"][10:20].any()
    assert not said["inside"][10:20].any()
    np.testing.assert_array_equal(said["spread"][10:20], np.tile(model.rms.numpy(), (10, 1)))
    assert said["correction"][20:].all()


def test_a_phase_beyond_the_table_counts_as_its_last() -> None:
    model = compensator()
    rows = rows_of(flight(model, 5))
    last, beyond = dict(rows), dict(rows)
    last["phase"] = np.full((5, 1), max(PHASE_CODES.values()), np.float32)
    beyond["phase"] = np.full((5, 1), 99, np.float32)
    graph = streaming_model(model)
    assert_same(streamed(graph, beyond), streamed(graph, last), 0.0)


# -- the files ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def model() -> Compensator:
    return compensator(vehicle="crazyflie")


@pytest.fixture(scope="module")
def folder(model: Compensator, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported(model, tmp_path_factory.mktemp("model"))


@pytest.mark.slow
def test_the_same_model_gives_the_same_bytes(
    model: Compensator, folder: Path, tmp_path: Path
) -> None:
    again = exported(model, tmp_path)
    for name in (MODEL_FILE, INT8_FILE, REFERENCE_FILE):
        assert (again / name).read_bytes() == (folder / name).read_bytes(), name


def test_reads_where_onnx_of_2022_reads(folder: Path) -> None:
    """Pinned versions, plain operators, nothing outside the standard."""
    graph = onnx.load(folder / MODEL_FILE)
    onnx.checker.check_model(graph, full_check=True)
    assert (OPSET, IR_VERSION) == (17, 8)
    assert [(o.domain, o.version) for o in graph.opset_import] == [("", OPSET)]
    assert graph.ir_version == IR_VERSION
    assert "LSTM" not in {node.op_type for node in graph.graph.node}
    assert [i.name for i in graph.graph.input] == list(INPUTS)
    assert [o.name for o in graph.graph.output] == list(OUTPUTS)
    for value in (*graph.graph.input, *graph.graph.output):
        batch, width = value.type.tensor_type.shape.dim
        assert (batch.dim_param, batch.dim_value) == ("batch", 0)
        assert width.dim_value > 0
    assert all(t.data_location == onnx.TensorProto.DEFAULT for t in graph.graph.initializer)


def test_metadata_say_what_a_user_must_know(model: Compensator, folder: Path) -> None:
    texts = {p.key: p.value for p in onnx.load(folder / MODEL_FILE).metadata_props}
    assert texts.pop("format") == "uavtwin compensator 1"
    assert len(texts.pop("graph_sha256")) == 64
    said = {name: json.loads(text) for name, text in texts.items()}
    assert tuple(said["channels"]) == CHANNELS
    assert tuple(said["units"]) == UNITS
    assert tuple(said["groups"]) == tuple(GROUPS)
    assert said["commands"] == ["cmd_1", "cmd_2", "cmd_3", "cmd_4"]
    assert said["phases"] == dict(PHASE_CODES)
    assert (said["protocol"], said["horizon"], said["rate_hz"]) == ("track", 3, 100.0)
    assert said["vehicle"] == "crazyflie"
    inputs = ["gyro_x", "gyro_y", "gyro_z", "speed", "vel_z", "cmd_1", "cmd_2", "cmd_3", "cmd_4"]
    assert said["envelope"]["inputs"] == inputs
    np.testing.assert_array_equal(said["envelope"]["centre"], model.place_centre)
    assert said["envelope"]["reach"] == float(model.place_reach)
    np.testing.assert_array_equal(said["normalisation"]["scale"], model.scale.numpy())


@pytest.mark.slow
def test_a_model_of_rotor_speeds_says_so(tmp_path: Path) -> None:
    """Then the twin's rotor speeds are to be fed, and no commands."""
    fast = compensator(commands=2)
    fast.feature_mean[-2:] = 1800.0
    texts = {
        p.key: p.value for p in onnx.load(exported(fast, tmp_path) / MODEL_FILE).metadata_props
    }
    assert json.loads(texts["commands"]) == ["rotor_1", "rotor_2"]


def test_reference_vectors_check_a_runtime(folder: Path) -> None:
    reference = dict(np.load(folder / REFERENCE_FILE))
    assert_same(streamed(onnx.load(folder / MODEL_FILE), reference), reference)


@pytest.mark.slow
def test_int8_is_smaller_and_says_what_it_costs(tmp_path: Path) -> None:
    wide = compensator(tiny(encoder_units=(64,), decoder_units=(64,), code_size=32))
    folder = exported(wide, tmp_path)
    reference = dict(np.load(folder / REFERENCE_FILE))
    small = onnx.load(folder / INT8_FILE)
    assert small.ByteSize() < 0.5 * (folder / MODEL_FILE).stat().st_size
    (cost,) = (float(p.value) for p in small.metadata_props if p.key == "int8_deviation")
    assert cost == pytest.approx(deviation(small, reference), rel=1e-2)
    assert 0 < cost < 0.02
    assert deviation(onnx.load(folder / MODEL_FILE), reference) < 1e-5


@pytest.mark.slow
def test_the_example_needs_no_torch(folder: Path) -> None:
    """Nor anything else than onnxruntime and numpy, in at most 30 lines."""
    text = EXAMPLE.read_text()
    assert len(text.splitlines()) <= 30
    blocked = "import sys; sys.modules.update(dict.fromkeys(['torch', 'onnx', 'twin', 'learning']))"
    program = f"{blocked}; sys.argv = ['example', {str(folder)!r}]; exec({text!r})"
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, check=True
    )
    assert "300 samples" in result.stdout, result.stdout


def _session(graph: onnx.ModelProto) -> Any:
    import onnxruntime

    return onnxruntime.InferenceSession(
        graph.SerializeToString(), providers=["CPUExecutionProvider"]
    )
