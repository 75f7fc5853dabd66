"""A trained model as a folder: safetensors and JSON, nothing that runs code when it is read."""

import json
import os
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from safetensors import SafetensorError
from safetensors.torch import load_file, save_file

from twin.errors import ModelError

from ..data.channels import CHANNELS, UNITS
from ..data.scaling import UNLIMITED
from ..preset import preset_from_json, preset_json
from .compensator import Compensator, ModelInfo

WEIGHTS = "weights.safetensors"
MODEL = "model.json"
CURVE = "learning_curve.json"
FORMAT = 1
"""Version of the folder's layout."""


def save(compensator: Compensator, folder: Path) -> None:
    """Write weights and description; the same model gives the same bytes."""
    folder.mkdir(parents=True, exist_ok=True)
    tensors = {k: v.detach().contiguous() for k, v in compensator.state_dict().items()}
    part = folder / f"{WEIGHTS}.part"
    save_file(tensors, part)
    os.replace(part, folder / WEIGHTS)
    write_json(folder / MODEL, info_json(compensator))


def load(folder: Path) -> Compensator:
    """The model of a folder.

    Raises:
        ModelError: A file is missing, of another layout or does not fit the description.
    """
    for name in (MODEL, WEIGHTS):
        if not (folder / name).is_file():
            raise ModelError(f"{folder}: no {name}; a model is what `uavtwin train` wrote")
    try:
        compensator = Compensator(info_from_json(json.loads((folder / MODEL).read_text("utf-8"))))
        compensator.load_state_dict(load_file(folder / WEIGHTS))
    except (KeyError, TypeError, ValueError, RuntimeError, SafetensorError) as error:
        raise ModelError(
            f"{folder}: {MODEL} and {WEIGHTS} do not fit each other or this version ({error}); "
            "train the model anew"
        ) from error
    return compensator.eval()


def info_json(compensator: Compensator) -> dict[str, Any]:
    """Content of `model.json`."""
    info = compensator.info
    low, high = compensator.low.tolist(), compensator.high.tolist()
    return {
        "format": FORMAT,
        "protocol": info.protocol,
        "horizon": info.horizon,
        "rate_hz": info.rate_hz,
        "n_commands": info.n_commands,
        "channels": list(CHANNELS),
        "units": list(UNITS),
        "clusters": [[CHANNELS[i] for i in cluster] for cluster in info.clusters],
        "envelope": {
            name: [a, b] if abs(a) < UNLIMITED / 2 else None
            for name, a, b in zip(compensator.features, low, high, strict=True)
        },
        "preset": preset_json(info.preset),
        "seed": info.seed,
        "vehicle": info.vehicle,
        "vehicle_sha256": info.vehicle_sha256,
        "flights": list(info.flights),
        "training": info.training,
        "metrics": info.metrics,
    }


def info_from_json(content: Mapping[str, Any]) -> ModelInfo:
    """What `info_json` was made from."""
    if content["format"] != FORMAT or tuple(content["channels"]) != CHANNELS:
        raise ValueError(f"layout {content['format']} with {len(content['channels'])} channels")
    same = {f.name for f in fields(ModelInfo)} - {"preset", "clusters", "flights"}
    numbers = {name: i for i, name in enumerate(CHANNELS)}
    clusters = [[numbers[name] for name in cluster] for cluster in content["clusters"]]
    return ModelInfo(
        preset=preset_from_json(content["preset"]),
        clusters=tuple(tuple(cluster) for cluster in clusters),
        flights=tuple(content["flights"]),
        **{name: content[name] for name in same},
    )


def write_json(path: Path, content: object) -> None:
    """Write JSON in one go: a reader sees the old file or the new one."""
    part = path.with_name(f"{path.name}.part")
    part.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", "utf-8")
    os.replace(part, path)
