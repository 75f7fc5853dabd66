"""A learned force and moment as a folder: one JSON file, and the vehicle for which it was
learned."""

import hashlib
import json
import shutil
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec import UNSET, UnsetType

from twin.errors import ModelError, TwinError
from twin.physics.residual_force import FEATURES, INPUTS, OUTPUTS, ForceLaw
from twin.representation import ShortRepr

FILE, VEHICLE_FILE = "force.json", "vehicle.toml"  # in the folder of a law
MODULE_FILE = "force.onnx"
"""File in the same folder: the module, for a law with one."""
NONE, LINEAR, MODULE = "none", "linear", "module"
"""Kinds of law for an output."""
FORMAT = 7
"""Version of the file's format."""
_OUTPUTS = tuple(f"{kind}_{a}" for kind, a in OUTPUTS)  # names in the file


@dataclass(frozen=True, slots=True)
class RidgeScore:
    """Score of a law with one ridge, on flights left out.

    Attributes:
        part: Part of the law: `both`, or the one of force and moment that is used alone.
        ridge: Ridge parameter.
        ratio: Error over that of the twin with the untrained observer alone, geometric mean over
            flights, quantities and horizons.
        worst: The largest error ratio of a quantity, over flights and horizons.
    """

    part: str
    ridge: float
    ratio: float
    worst: float


@dataclass(frozen=True, slots=True)
class Output:
    """One of the six outputs.

    Attributes:
        law: Kind of law: `linear`, `module`, or `none`.
        ridge: Ridge of the fit; None for a module, and where there is no law.
    """

    law: str
    ridge: float | None


@dataclass(frozen=True, slots=True)
class TrainingFlight:
    """A training flight.

    Attributes:
        name: Name of the flight.
        sha256: Hash of the flight, `Flight.fingerprint`.
    """

    name: str
    sha256: str


@dataclass(frozen=True, slots=True)
class MissionCheck:
    """Result of the missions in random wind that a law had to fly.

    Attributes:
        flights: Number of flights; 0 where no law was chosen, or no controller can be designed
            for the vehicle.
        lost: Missions lost with the law chosen first, among those that are flown without it.
        withdrawn: Laws with which missions were lost, the better first.
        unsteady: Laws with which the twin does not settle in a hover in still air; they were not
            tried further.
        problem: Why no controller can be designed for the vehicle; missing: one can.
    """

    flights: int = 0
    lost: int = 0
    withdrawn: int = 0
    unsteady: int = 0
    problem: str | UnsetType = UNSET


@dataclass(frozen=True, slots=True)
class Acceptance:
    """Comparison of the chosen law with predictions that need no law, on flights left out; None
    where none was chosen.

    Attributes:
        over_observer: Error over that of the explained twin with the untrained observer, median
            over those flights, quantities and horizons that the law changes.
        over_last_motion: Error of position and velocity over that of constant velocity, after 0.5 s
            of open-loop prediction, geometric mean over flights.
        fast: The same for fast flights; None: there is none.
        refused: Whether the law is rejected, as the observer alone is as good.
    """

    over_observer: float | None = None
    over_last_motion: float | None = None
    fast: float | None = None
    refused: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Origin:
    """Provenance of a law.

    Attributes:
        vehicle: Name of the vehicle.
        vehicle_sha256: SHA-256 hash of the vehicle file.
        seed: Random seed of the wind in the missions.
        flights: Training flights.
        tried: Scores of the ridges on flights left out; empty for a single flight.
        acceptance: Comparison with predictions that need no law, on flights left out.
        closed_loop: Missions in random wind before the law was released.
        imu_noise: White noise of accelerometer, m/s2, and gyroscope, rad/s, in readings of a hover
            5 ms apart; missing where no flight taught it.
    """

    vehicle: str
    vehicle_sha256: str
    seed: int
    flights: tuple[TrainingFlight, ...]
    tried: tuple[RidgeScore, ...] = ()
    acceptance: Acceptance = Acceptance()
    closed_loop: MissionCheck = MissionCheck()
    imu_noise: tuple[float, ...] | UnsetType = UNSET


@dataclass(frozen=True, slots=True, kw_only=True)
class ForceFile(Origin):
    """Content of `force.json`, which `uavtwin train --protocol force` writes with `vehicle.toml`.

    Attributes:
        format: Version of the format.
        protocol: "force".
        inputs: Names of the inputs of the law.
        features: Names of the features of its linear part.
        outputs: Kind of law of each of the six outputs, by name.
        law: Arrays of the law, by name, row by row.
        module_sha256: SHA-256 hash of `force.onnx`; missing where no output is a module.
    """

    format: int
    protocol: str
    inputs: tuple[str, ...]
    features: tuple[str, ...]
    outputs: dict[str, Output]
    law: dict[str, Any]
    module_sha256: str | UnsetType = UNSET


@dataclass(frozen=True, slots=True, kw_only=True)
class ForceModel(Origin, ShortRepr):
    """A law with its provenance; a driven twin uses it together with the untrained observer.

    Attributes:
        law: The law as it is used.
        ridge: Ridge of the fit; None: there is none, or it is a module.
        onnx: ONNX file of the law's module; empty where it has none.
    """

    law: ForceLaw
    ridge: float | None = None
    onnx: bytes = b""

    @property
    def says(self) -> bool:
        """Whether there is a law."""
        return self.ridge is not None or self.law.module is not None

    @property
    def outputs(self) -> dict[str, Output]:
        """Kind of law of each of the six outputs, by name."""
        other = NONE if self.law.module is None else MODULE
        used = np.any(self.law.linear, axis=1).tolist()
        laws = [Output(LINEAR, self.ridge) if u else Output(other, None) for u in used]
        return dict(zip(_OUTPUTS, laws, strict=True))


def save_force(model: ForceModel, folder: Path) -> None:
    """Write `force.json` and, for a module, `force.onnx`; the same model gives the same bytes."""
    content = ForceFile(
        **_origin(model),
        format=FORMAT,
        protocol="force",
        inputs=tuple(name for name, _ in INPUTS),
        features=tuple(FEATURES),
        outputs=model.outputs,
        law={name: values.tolist() for name, values in model.law.arrays().items()},
        module_sha256=_sha256(model.onnx) if model.onnx else UNSET,
    )
    if model.onnx:
        (folder / MODULE_FILE).write_bytes(model.onnx)
    text = json.dumps(msgspec.to_builtins(content), indent=1, allow_nan=False)
    (folder / FILE).write_text(text + "\n", "utf-8")


def load_force(folder: Path) -> ForceModel:
    """Load the model of a folder.

    Raises:
        ModelError: The folder contains no law, or one of another format or version, or its module
            is missing.
    """
    path = folder / FILE
    if not path.is_file():
        raise ModelError(f"{folder}: no {FILE}; `uavtwin train --protocol force` writes one.")
    try:
        content = json.loads(path.read_text("utf-8"))
        file = msgspec.convert(content, ForceFile)
        if msgspec.json.decode(msgspec.json.encode(file)) != content:
            raise ModelError("it has keys that are none of its own")
        return _model(file, folder)
    except (msgspec.MsgspecError, KeyError, TypeError, ValueError, TwinError) as error:
        raise ModelError(
            f"{path}: is of another layout than this version's, or damaged ({error}). Train the "
            f"model again."
        ) from error


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def is_force(folder: Path) -> bool:
    """Whether a folder contains a learned force only, and no sensor compensator."""
    return (folder / FILE).is_file() and not (folder / "model.json").is_file()


def copy_force(folder: Path, out: Path) -> list[str]:
    """Copy the law of a folder into another; returns the names of its files."""
    names = [n for n in (FILE, MODULE_FILE) if (folder / n).is_file()]
    for name in names:
        shutil.copyfile(folder / name, out / name)
    return names


def _model(file: ForceFile, folder: Path) -> ForceModel:
    """Model from the content of a file, with the module where an output is one."""
    expected = {
        "format": FORMAT,
        "inputs": tuple(name for name, _ in INPUTS),
        "features": tuple(FEATURES),
    }
    given = {key: getattr(file, key) for key in expected}
    expected["outputs"], given["outputs"] = _OUTPUTS, tuple(file.outputs)
    for key, value in expected.items():
        if given[key] != value:
            raise ModelError(f"{key} is {given[key]}, not {value}")
    law = ForceLaw.of({k: np.array(v, dtype=np.float64) for k, v in file.law.items()})
    ridge = next((o.ridge for o in file.outputs.values() if o.ridge), None)
    model = ForceModel(**_origin(file), law=law, ridge=ridge)
    if all(output.law != MODULE for output in file.outputs.values()):
        return model
    path = folder / MODULE_FILE
    onnx = path.read_bytes() if path.is_file() else b""
    if _sha256(onnx) != file.module_sha256:
        raise ModelError(
            f"{MODULE_FILE} beside it is {'not the one that was written' if onnx else 'missing'}: "
            f"copy the whole folder, or write it again with `own_force`"
        )
    from .module import law_function

    return replace(model, law=replace(law, module=law_function(onnx)), onnx=onnx)


def _origin(of: Origin) -> dict[str, Any]:
    """Fields common to both classes."""
    return {f.name: getattr(of, f.name) for f in fields(Origin)}
