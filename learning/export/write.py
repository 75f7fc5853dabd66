"""Export of a trained compensator for any runtime: `model.onnx`, an int8 version, reference
vectors.

`model_int8.onnx` has 8-bit weights: about half of the size, nearly the same numbers. Quantised are
the products of weights with values computed inside a cluster: LSTM cells and latent, which have
most of the weights. A row of weights has one scale; the other factor has a scale computed at each
sample; sums are exact integers, equal in every runtime. Inputs stay float, since a single large
reading would leave few steps for the others, and so do codebook, linear prediction and read-out.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
from numpy.typing import NDArray
from onnx import NodeProto, TensorProto, helper, numpy_helper

from ..data.channels import CHANNELS, FEATURE_CHANNELS, GROUPS, N_PHASES, PHASE_CODES, UNITS
from ..data.flights import ResidualFlight, held
from ..model.compensator import Compensator
from .streaming import INPUTS, OUTPUTS, streaming_model

MODEL_FILE, INT8_FILE, REFERENCE_FILE = "model.onnx", "model_int8.onnx", "reference.npz"
"""Files: network, 8-bit network, and outputs of both for some inputs."""
FORMAT = "uavtwin compensator 1"
"""Value of the metadata `format`, which a reader can check."""
REFERENCE_SAMPLES = 300
"""Number of samples of the reference vectors: 3 s at 100 Hz, inside, outside and inside the
envelope again."""
LARGEST_COMMAND = 1.0
"""Limit of a mean command above which the inputs are rotor speeds, rad/s."""


def export_onnx(compensator: Compensator, folder: Path) -> Path:
    """Write the streaming model, its int8 version, and vectors for the verification of any runtime.

    The error of int8 is in its metadata: `int8_deviation`, see `deviation`.

    Args:
        compensator: Trained compensator.
        folder: Existing folder.

    Returns:
        Path of `model.onnx`.
    """
    said, vectors = metadata(compensator), reference_vectors(compensator)
    model = streaming_model(compensator)
    small = quantised(streaming_model(compensator, 1))  # with activation scales per sample
    loss = deviation(small, vectors)
    _write(model, said, folder / MODEL_FILE)
    _write(small, said | {"int8_deviation": f"{loss:.3g}"}, folder / INT8_FILE)
    arrays: dict[str, Any] = vectors
    np.savez(folder / REFERENCE_FILE, **arrays)
    return folder / MODEL_FILE


def _write(model: onnx.ModelProto, said: Mapping[str, str], path: Path) -> None:
    """Write the model with metadata and a hash of its graph, which detects damaged files."""
    digest = hashlib.sha256(model.graph.SerializeToString(deterministic=True)).hexdigest()
    onnx.helper.set_model_props(model, {**said, "graph_sha256": digest})
    path.write_bytes(model.SerializeToString(deterministic=True))


def metadata(compensator: Compensator) -> dict[str, str]:
    """Metadata for users of the file, as JSON texts by name."""
    info = compensator.info
    scaling = compensator.scaling()
    values: dict[str, Any] = {
        "channels": CHANNELS,
        "units": UNITS,
        "groups": tuple(GROUPS),
        "commands": _motors(compensator),
        "phases": dict(PHASE_CODES),
        "rate_hz": info.rate_hz,
        "protocol": info.protocol,
        "horizon": info.horizon,
        "preset": info.preset.name,
        "clusters": info.clusters,
        **compensator.details(),
        "uncorrected_rms": scaling.rms.tolist(),
        "normalisation": {
            name: getattr(scaling, name).tolist()
            for name in ("mean", "scale", "feature_mean", "feature_scale")
        },
        "vehicle": info.vehicle,
        "vehicle_sha256": info.vehicle_sha256,
        "training": info.training,
        "seed": info.seed,
    }
    return {"format": FORMAT} | {k: json.dumps(v, ensure_ascii=False) for k, v in values.items()}


def _motors(compensator: Compensator) -> list[str]:
    """Flight-table columns of the rotors' drive: commands, 0..1, or speeds in rad/s."""
    means = compensator.feature_mean[len(FEATURE_CHANNELS) :].tolist()
    kind = "rotor" if max(means, default=0.0) > LARGEST_COMMAND else "cmd"
    return [f"{kind}_{i}" for i in range(1, len(means) + 1)]


def reference_vectors(compensator: Compensator) -> dict[str, NDArray[np.float32]]:
    """Inputs and the corresponding outputs of `Compensator.run`, from zero state.

    Features vary within the envelope and, in the second third, leave it.

    Returns:
        Vectors by their name in the ONNX file, shape (samples, width) each, without the states.
    """
    rng = np.random.default_rng(0)
    scaling, n = compensator.scaling(), REFERENCE_SAMPLES
    walk = np.cumsum(rng.normal(size=(n, len(compensator.features))), axis=0) / np.sqrt(n)
    walk[n // 3 : 2 * n // 3 : 10] *= 30
    features = scaling.feature_mean + scaling.feature_scale * walk
    virtual = np.zeros((n, len(CHANNELS)))
    virtual[:, list(FEATURE_CHANNELS)] = features[:, : len(FEATURE_CHANNELS)]
    phase = rng.integers(N_PHASES, size=1 + n // 50).repeat(50)[:n]
    residual = scaling.mean[phase] + scaling.scale[phase] * rng.normal(size=virtual.shape)
    rows = {
        "virtual": virtual,
        "command": features[:, len(FEATURE_CHANNELS) :],
        "phase": phase[:, None],
        "measured": virtual + residual,
        "valid": rng.random(virtual.shape) < 0.7,
    }
    inputs = {name: values.astype(np.float32) for name, values in rows.items()}
    found = compensator.run(flight_of(inputs, compensator.info.rate_hz))
    anomaly = np.nan_to_num(found.anomaly)[:, None]  # 0 for a model without alarms
    right = {
        "correction": found.correction,
        "spread": found.spread,
        "anomaly": anomaly,
        "inside": found.inside[:, None],
    }
    return inputs | {name: values.astype(np.float32) for name, values in right.items()}


def flight_of(inputs: Mapping[str, NDArray[np.float32]], rate_hz: float) -> ResidualFlight:
    """Sequence of inputs of the ONNX file as a flight of one span.

    Args:
        inputs: Inputs by name, finite where valid, shape (samples, width) each.
        rate_hz: Sample rate, Hz.
    """
    virtual, command, phase, measured, valid = (inputs[name] for name in INPUTS[:-1])
    samples, fresh = len(virtual), valid > 0.5
    residual = np.where(fresh, measured.astype(np.float64) - virtual, np.nan)
    return ResidualFlight(
        name="samples",
        rate_hz=rate_hz,
        t_s=np.arange(samples) / rate_hz,
        virtual=virtual.astype(np.float64),
        residual=held(residual),
        fresh=fresh,
        commands=command.astype(np.float64),
        phase=phase[:, 0].astype(np.intp),
        spans=((0, samples),),
    )


Vectors = Mapping[str, NDArray[np.float32]]
LARGEST = 127
"""Largest int8 weight; -128 is excluded, so that a row and its negative have the same steps."""
_FLAT = "flat"
"""Name of a constant: shape of one row per cluster."""


def quantised(model: onnx.ModelProto) -> onnx.ModelProto:
    """The model with 8-bit weights, checked; without the shapes of intermediate tensors."""
    given = onnx.ModelProto()
    given.CopyFrom(model)
    wide = set(_wide_products(model))
    numbers = {t.name: t for t in given.graph.initializer}
    if wide:
        numbers[_FLAT] = numpy_helper.from_array(np.array([0, 1, -1], np.int64), _FLAT)
    nodes: list[NodeProto] = []
    for node in given.graph.node:
        if node.name not in wide:
            nodes.append(node)
            continue
        x, name = node.input
        rows, scale = _rows(numpy_helper.to_array(numbers.pop(name)))
        for array, suffix in ((rows, "rows"), (scale, "scale")):
            numbers[f"{name}_{suffix}"] = numpy_helper.from_array(array, f"{name}_{suffix}")
        nodes += _integer_product(x, name, node.output[0])
    for field, content in (("node", nodes), ("initializer", numbers.values())):
        given.graph.ClearField(field)
        getattr(given.graph, field).extend(content)
    onnx.checker.check_model(given, full_check=True)
    return given


def _rows(weights: NDArray[np.float32]) -> tuple[NDArray[np.int8], NDArray[np.float32]]:
    """Columns of weights as rows of integers, and their scales.

    Args:
        weights: Weights, shape (C, n, m).

    Returns:
        Integers, shape (C, m, n), and scales, shape (C, 1, m).
    """
    scale = np.abs(weights).max(axis=1, keepdims=True) / LARGEST
    scale[scale == 0] = 1
    return np.rint(weights / scale).astype(np.int8).swapaxes(1, 2), scale


def _integer_product(x: str, weights: str, out: str) -> list[NodeProto]:
    """Operators for `out` = x times the weights, in integers; shapes (C, 1, n) and (C, 1, m)."""
    steps, step, zero, column, sums = (f"{out}_{n}" for n in ("x", "step", "zero", "column", "sum"))
    row, floats, factor = (f"{out}_{n}" for n in ("row", "float", "factor"))
    make = helper.make_node
    return [
        make("DynamicQuantizeLinear", [x], [steps, step, zero]),
        make("Transpose", [steps], [column], perm=[0, 2, 1]),
        make("MatMulInteger", [f"{weights}_rows", column, "", zero], [sums]),
        make("Reshape", [sums, _FLAT], [row]),
        make("Cast", [row], [floats], to=TensorProto.FLOAT),
        make("Mul", [f"{weights}_scale", step], [factor]),
        make("Mul", [floats, factor], [out]),
    ]


def deviation(model: onnx.ModelProto, reference: Vectors) -> float:
    """Rms difference of the correction over its rms, median over the channels with a correction.

    Args:
        model: Exported model.
        reference: Inputs, and the expected outputs.
    """
    right = reference["correction"].astype(np.float64)
    wrong = streamed(model, reference)["correction"] - right
    rms = np.sqrt(np.mean(right**2, axis=0))
    used = rms > 0
    return (
        float(np.median(np.sqrt(np.mean(wrong**2, axis=0))[used] / rms[used]))
        if used.any()
        else 0.0
    )


def streamed(model: onnx.ModelProto, inputs: Vectors) -> dict[str, NDArray[np.float32]]:
    """Outputs of onnxruntime on one thread, sample by sample from zero state.

    Args:
        model: Exported model.
        inputs: Inputs by name, shape (samples, width) each.

    Returns:
        Outputs by name, shape (samples, width) each.
    """
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(
        model.SerializeToString(), options, providers=["CPUExecutionProvider"]
    )
    (size,) = (i.shape[1] for i in session.get_inputs() if i.name == INPUTS[-1])
    state, rows = np.zeros((1, size), np.float32), []
    for k in range(len(inputs[INPUTS[0]])):
        now = {name: inputs[name][k : k + 1] for name in INPUTS[:-1]}
        *said, state = session.run(None, now | {INPUTS[-1]: state})
        rows.append([s[0] for s in said])
    columns = [np.stack(column) for column in zip(*rows, strict=True)]
    return dict(zip(OUTPUTS[:-1], columns, strict=True))


def _wide_products(model: onnx.ModelProto) -> Iterator[str]:
    """Names of the products of values computed inside a cluster with weights used once, without the
    codebook."""
    inferred = onnx.shape_inference.infer_shapes(model).graph
    batches = {t.name for t in model.graph.initializer if len(t.dims) == 3}
    own = {v.name for v in inferred.value_info if len(v.type.tensor_type.shape.dim) == 3}
    uses = [name for node in model.graph.node for name in node.input]
    for node in model.graph.node:
        once = [name for name in node.input if name in batches and uses.count(name) == 1]
        if node.op_type == "MatMul" and node.input[0] in own and once == [node.input[1]]:
            yield node.name
