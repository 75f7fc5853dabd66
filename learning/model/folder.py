"""A trained model as a folder of safetensors and JSON, which run no code when read.

Content common to all families is written and read here; the family adds its own part.
"""

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from twin.errors import ModelError

from ..data.channels import CHANNELS, UNITS, check_channels
from .family import ModelInfo
from .registry import family_named

if TYPE_CHECKING:
    from .family import Family, TrainedModel

WEIGHTS = "weights.safetensors"  # in the folder of a model
MODEL = "model.json"  # in the folder of a model: everything except weights
CURVE = "learning_curve.json"
"""Name of the learning curve's file."""
FORMAT = 6
"""Version of the folder's format."""


def save(model: "TrainedModel", folder: Path) -> None:
    """Write weights and description; the same model gives the same bytes."""
    folder.mkdir(parents=True, exist_ok=True)
    tensors = {k: np.ascontiguousarray(v) for k, v in model.tensors().items()}
    part = folder / f"{WEIGHTS}.part"
    save_file(tensors, part)
    os.replace(part, folder / WEIGHTS)
    write_json(folder / MODEL, info_json(model))


def load(folder: Path) -> "TrainedModel":
    """Load the model of a folder, of any family.

    Raises:
        ModelError: A file is missing, has another format or family, or does not match the
            description.
    """
    for name in (MODEL, WEIGHTS):
        if not (folder / name).is_file():
            raise ModelError(f"{folder}: no {name}; a model is what `uavtwin train` wrote")
    try:
        content = json.loads((folder / MODEL).read_text("utf-8"))
        family = family_named(content["family"])
        model: TrainedModel = family.build(
            info_from_json(content, family), load_file(folder / WEIGHTS)
        )
    except (
        *(AttributeError, KeyError, TypeError, ValueError, RuntimeError),
        *(ModelError, SafetensorError),
    ) as error:
        raise ModelError(
            f"{folder}: {MODEL} and {WEIGHTS} do not fit each other or this version ({error}); "
            "train the model again"
        ) from error
    return model


def info_json(model: "TrainedModel") -> dict[str, Any]:
    """Content of `model.json`."""
    info = model.info
    return {
        "format": FORMAT,
        "family": model.family,
        "protocol": info.protocol,
        "horizon": info.horizon,
        "rate_hz": info.rate_hz,
        "n_commands": info.n_commands,
        "channels": list(CHANNELS),
        "units": list(UNITS),
        "clusters": [[CHANNELS[i] for i in cluster] for cluster in info.clusters],
        **model.details(),
        "preset": asdict(info.preset),
        "seed": info.seed,
        "vehicle": info.vehicle,
        "vehicle_sha256": info.vehicle_sha256,
        "flights": list(info.flights),
        "training": info.training,
        "metrics": info.metrics,
    }


def info_from_json(content: Mapping[str, Any], family: "Family[Any, Any]") -> ModelInfo[Any]:
    """Description from the content of `model.json`; inverse of `info_json`."""
    if content["format"] != FORMAT:
        raise ValueError(f"layout {content['format']}")
    check_channels(content["channels"])
    same = {f.name for f in fields(ModelInfo)} - {"preset", "clusters", "flights"}
    numbers = {name: i for i, name in enumerate(CHANNELS)}
    clusters = [[numbers[name] for name in cluster] for cluster in content["clusters"]]
    return ModelInfo(
        preset=_preset_from_json(content["preset"], family),
        clusters=tuple(tuple(cluster) for cluster in clusters),
        flights=tuple(content["flights"]),
        **{name: content[name] for name in same},
    )


def _preset_from_json(content: Mapping[str, Any], family: "Family[Any, Any]") -> Any:
    """Preset of the family; JSON has lists in place of its tuples."""
    kind = type(next(iter(family.presets.values())))
    return kind(**{k: tuple(v) if isinstance(v, list) else v for k, v in content.items()})


def write_json(path: Path, content: object) -> None:
    """Write JSON atomically: a reader sees the old file or the new one."""
    part = path.with_name(f"{path.name}.part")
    part.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", "utf-8")
    os.replace(part, path)
