"""A trained compensator as files for any runtime: `model.onnx`, int8, reference vectors."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from numpy.typing import NDArray

from ..data.channels import CHANNELS, GROUPS, N_PHASES, PHASE_CODES, SEEN, UNITS
from ..model.compensator import Compensator
from ..threads import one_thread
from .int8 import deviation, quantised
from .step import INPUTS, OUTPUTS, streaming_model

MODEL_FILE, INT8_FILE, REFERENCE_FILE = "model.onnx", "model_int8.onnx", "reference.npz"
FORMAT = "uavtwin compensator 1"
"""Value of the metadata `format`: what a reader may rely on."""
REFERENCE_SAMPLES = 300
LARGEST_COMMAND = 1.0
"""A mean beyond this is one of rotor speeds, rad/s."""


def export_onnx(compensator: Compensator, folder: Path) -> Path:
    """Write the streaming model, the same in int8, and vectors to check any runtime by.

    What int8 costs is among its metadata: `int8_deviation`, see `int8.deviation`.

    Args:
        compensator: Trained.
        folder: Must exist.

    Returns:
        The path of `model.onnx`.
    """
    said, vectors = metadata(compensator), reference_vectors(compensator)
    model = streaming_model(compensator)
    small = quantised(streaming_model(compensator, 1))  # whose scales are those of a sample
    loss = deviation(small, vectors)
    _write(model, said, folder / MODEL_FILE)
    _write(small, said | {"int8_deviation": f"{loss:.3g}"}, folder / INT8_FILE)
    arrays: dict[str, Any] = vectors
    np.savez(folder / REFERENCE_FILE, **arrays)
    return folder / MODEL_FILE


def _write(model: onnx.ModelProto, said: Mapping[str, str], path: Path) -> None:
    """The model with metadata, and a hash of its graph that tells when the file is damaged."""
    digest = hashlib.sha256(model.graph.SerializeToString(deterministic=True)).hexdigest()
    onnx.helper.set_model_props(model, {**said, "graph_sha256": digest})
    path.write_bytes(model.SerializeToString(deterministic=True))


def metadata(compensator: Compensator) -> dict[str, str]:
    """What a user of the file must know, as JSON texts by name."""
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
    """Flight-table columns of what drove the rotors: commands, 0..1, or speeds in rad/s."""
    means = compensator.feature_mean[len(SEEN) :].tolist()
    kind = "rotor" if max(means, default=0.0) > LARGEST_COMMAND else "cmd"
    return [f"{kind}_{i}" for i in range(1, len(means) + 1)]


def reference_vectors(compensator: Compensator, seed: int = 0) -> dict[str, NDArray[np.float32]]:
    """Inputs and the outputs that belong to them, sample after sample from the state zero.

    Features wander within the envelope and, in the second third, out of it.

    Returns:
        By name of the ONNX file, shape (samples, width) each, without the states.
    """
    rng = np.random.default_rng(seed)
    scaling, n = compensator.scaling(), REFERENCE_SAMPLES
    walk = np.cumsum(rng.normal(size=(n, len(compensator.features))), axis=0) / np.sqrt(n)
    walk[n // 3 : 2 * n // 3 : 10] *= 30
    features = scaling.feature_mean + scaling.feature_scale * walk
    virtual = np.zeros((n, len(CHANNELS)))
    virtual[:, list(SEEN)] = features[:, : len(SEEN)]
    phase = rng.integers(N_PHASES, size=1 + n // 50).repeat(50)[:n]
    residual = scaling.mean[phase] + scaling.scale[phase] * rng.normal(size=virtual.shape)
    rows = {
        "virtual": virtual,
        "command": features[:, len(SEEN) :],
        "phase": phase[:, None],
        "measured": virtual + residual,
        "valid": rng.random(virtual.shape) < 0.7,
    }
    inputs = {name: values.astype(np.float32) for name, values in rows.items()}
    v, u, p, m, w = (torch.from_numpy(inputs[name])[:, None] for name in INPUTS[:-1])
    state, said = torch.zeros(1, compensator.state_size), []
    with one_thread(), torch.no_grad():
        for k in range(n):
            *outputs, state = compensator.step(v[k], u[k], p[k], m[k], w[k], state)
            said.append([o.numpy()[0] for o in outputs])
    columns = zip(OUTPUTS[:-1], zip(*said, strict=True), strict=True)
    return inputs | {name: np.stack(rows) for name, rows in columns}
