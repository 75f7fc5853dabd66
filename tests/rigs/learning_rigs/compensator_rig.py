"""What the tests of the exported compensator share: tiny models, flights to run them along."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from scipy.signal import lfilter

from learning.data.channels import CHANNELS, FEATURE_CHANNELS, GROUPS, PLACES
from learning.data.flights import ResidualFlight
from learning.export.write import export_onnx
from learning.model.compensator import Compensator, ModelInfo
from learning.preset import BEST, Preset, Protocol
from twin.flight.mission import PHASES

torch.set_num_threads(1)  # on shared cores two threads wait for each other

Array = NDArray[np.float64]
Rows = dict[str, NDArray[np.float32]]
N = len(CHANNELS)
CLUSTERS = ((0, 1, 2, 6), (3, 4, 9), (5, 7, 8, 10, 14), (11, 12, 13))
TINY = replace(
    BEST,
    name="tiny",
    encoder_units=(10,),
    decoder_units=(8,),
    code_size=6,
    n_codes=16,
    phase_size=3,
)


def tiny(**changes: Any) -> Preset:
    """The tiny preset with some switches turned."""
    return replace(TINY, **changes)


@torch.no_grad()
def compensator(
    preset: Preset = TINY,
    protocol: Protocol = "track",
    horizon: int = 3,
    seed: int = 0,
    commands: int = 4,
    rate_hz: float = 100.0,
    envelope: float = 4.0,
    vehicle: str = "",
) -> Compensator:
    """A model whose every weight and buffer is something, as after training.

    Args:
        preset: Sizes and switches.
        protocol: Which measurements it sees.
        horizon: Of `track`; the others have none.
        seed: Of everything.
        commands: Motors.
        rate_hz: Samples per second.
        envelope: How far it reaches, in spreads of its inputs.
        vehicle: Name it is trained for.
    """
    torch.manual_seed(seed)
    horizon = horizon if protocol == "track" else 0
    info = ModelInfo(preset, protocol, horizon, rate_hz, commands, CLUSTERS, seed, vehicle)
    model = Compensator(info)
    model.mean.normal_(std=0.1)
    model.scale.uniform_(0.5, 1.5)
    model.reading.normal_(std=0.1)
    model.largest.fill_(0.5)
    model.feature_mean.normal_()
    model.feature_scale.uniform_(0.5, 1.5)
    model.feature_mean[-commands:] = 0.5
    model.feature_scale[-commands:] = 0.1
    _place(model, envelope)
    model.least.fill_(-1.5)
    model.most.fill_(1.5)
    model.base.normal_(std=0.2)
    for values in (model.rms, model.gate, model.leftover):
        values.uniform_(0.1, 1.0)
    model.spread_factor.uniform_(0.5, 1.5)
    model.anomaly_scale.uniform_(2.0, 8.0)
    for parameter in model.parameters():
        parameter.add_(0.1 * torch.randn_like(parameter))
    return model.eval()


def _place(model: Compensator, envelope: float) -> None:
    """Physical inputs about the means of the features, each mixed with the others."""
    seen = [some[0] for some in PLACES]
    first = len(FEATURE_CHANNELS)
    columns = [*seen, *range(first, first + model.info.n_commands)]
    model.place_centre.copy_(model.feature_mean[columns])
    model.place_scale.copy_(model.feature_scale[columns])
    mixed = torch.eye(len(columns)) + 0.1 * torch.randn(len(columns), len(columns))
    model.place_whitening.copy_(mixed)
    model.place_reach.fill_(envelope)


def flight(model: Compensator, samples: int, seed: int = 0) -> ResidualFlight:
    """Features that wander within the envelope, residuals, some sensors slow; one span."""
    rng = np.random.default_rng(seed)
    n_features = len(model.features)

    def wander(columns: int) -> Array:
        """Smooth noise of spread 1, shape (samples, columns)."""
        noise = rng.normal(size=(samples, columns))
        return np.asarray(3.1 * lfilter([0.1], [1.0, -0.9], noise, axis=0))

    scaling = model.scaling()
    features = scaling.feature_mean + scaling.feature_scale * wander(n_features)
    virtual = wander(N)
    virtual[:, [i for i, c in enumerate(CHANNELS) if c not in ("pos_x", "pos_y")]] = features[
        :, : N - 2
    ]
    phase = rng.integers(len(PHASES), size=1 + samples // 40).repeat(40)[:samples]
    fresh = np.zeros((samples, N), dtype=np.bool_)
    for every, columns in zip((1, 1, 10, 4, 4), GROUPS.values(), strict=True):
        fresh[::every, columns] = True
    residual = scaling.mean[phase] + scaling.scale[phase] * wander(N)
    for row in range(1, samples):
        residual[row] = np.where(fresh[row], residual[row], residual[row - 1])
    return ResidualFlight(
        name="made up",
        rate_hz=model.info.rate_hz,
        t_s=np.arange(samples) / model.info.rate_hz,
        virtual=virtual,
        residual=residual,
        fresh=fresh,
        commands=features[:, N - 2 :],
        phase=phase,
        spans=((0, samples),),
    )


def rows_of(along: ResidualFlight) -> Rows:
    """A flight as inputs of the ONNX file, shape (samples, width) each."""
    rows = {
        "virtual": along.virtual,
        "command": along.commands,
        "phase": along.phase[:, None],
        "measured": along.virtual + along.residual,
        "valid": along.fresh,
    }
    return {name: values.astype(np.float32) for name, values in rows.items()}


def exported(model: Compensator, folder: Path) -> Path:
    """The folder with the ONNX files of a model."""
    folder.mkdir(parents=True, exist_ok=True)
    export_onnx(model, folder)
    return folder


def changed(
    model: onnx.ModelProto, folder: Path, raw: dict[str, str] | None = None, **said: Any
) -> Path:
    """A new folder with a model whose checksum is right.

    Args:
        model: Perhaps with another graph than it had.
        folder: To be made.
        raw: Metadata other than they were, as texts.
        said: The same as values of JSON.
    """
    texts = {p.key: p.value for p in model.metadata_props}
    texts |= {k: json.dumps(v) for k, v in said.items()} | (raw or {})
    digest = hashlib.sha256(model.graph.SerializeToString(deterministic=True)).hexdigest()
    onnx.helper.set_model_props(model, texts | {"graph_sha256": digest})
    folder.mkdir(parents=True)
    (folder / "model.onnx").write_bytes(model.SerializeToString())
    return folder
