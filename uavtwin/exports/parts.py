"""Exportable objects: components of a vehicle, the whole twin, a replay, a compensator."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from cosim.whole_twin import COMPENSATOR
from fmus import FmuModel, replay_model
from fmus.compensator import FILE, INT8_FILE, NetworkFile, read_network
from fmus.names import LONGEST_TEXT
from twin.component import Component, unknown_name
from twin.effects import effects_for
from twin.errors import TwinError
from twin.flight.assembly import COMPONENTS, Assembly, Choices, driven_twin, flying_twin
from twin.logs import Flight
from twin.physics.residual_force import ForceLaw
from twin.physics.rotors import Drive
from twin.physics.sensors.position import PRESETS, Kind
from twin.representation import ShortRepr
from twin.vehicle import Vehicle

from ..flights import checked_flights
from ..output import sha256
from ..vehicles import GROUNDED, checked_vehicle
from .bands import AccuracyRecord, accuracy_part
from .credibility import FactorRecord

if TYPE_CHECKING:
    from learning.force.model import ForceModel

Controller = Literal["lqr", "px4"]
OBSERVER = "airframe.disturbance.enabled"
"""Parameter that enables the disturbance observer of a driven twin."""
NOISE = "residual_force.noise.enabled"
"""Parameter that enables the noise of a learned force, where it is included."""


@dataclass(frozen=True, slots=True)
class Twin(ShortRepr):
    """A vehicle with its sensors: components, connections, perhaps a compensator.

    Attributes:
        name: Name of the vehicle.
        assembly: Components and their connections.
        compensator: Correction of the sensors; None: without.
        grounded: Reason why it cannot fly by the vehicle file; "": none.
        changes: Differences from the twin of the vehicle file.
        evidence: SHA-256 of the files on which the differences are based, by name; flights among
            them.
        bands: Factor of the card for the bands of its outputs; None: it has no bands.
    """

    name: str
    assembly: Assembly
    compensator: NetworkFile | None = None
    grounded: str = ""
    changes: tuple[str, ...] = ()
    evidence: Mapping[str, str] = field(default_factory=dict)
    bands: FactorRecord | None = None


@dataclass(frozen=True, slots=True)
class LearnedForce(ShortRepr):
    """Learned force and moment that a vehicle's equations lack.

    Attributes:
        model: Learned law.
        folder: Folder from which it was read, for messages.
    """

    model: "ForceModel"
    folder: Path = Path("learned force")


def twin(
    vehicle: Vehicle,
    mission: str = "hover",
    controller: Controller = "lqr",
    compensator: NetworkFile | None = None,
    drive: Drive | None = None,
    force: "LearnedForce | None" = None,
    position: Kind = "gnss",
    observer: bool = False,
    noise: bool = False,
    accuracy: AccuracyRecord | None = None,
) -> Twin:
    """The whole twin of a vehicle, with all effects included and those of the vehicle on.

    Args:
        vehicle: Vehicle of the twin.
        mission: Name of the mission.
        controller: Controller of the mission.
        compensator: Compensator from `uavtwin.compensator`, trained for this vehicle.
        drive: Commands or rotor speeds as external inputs, for replaying a log, without mission and
            controller; None: it flies the mission.
        force: Learned force from `learned_force`, for this vehicle.
        position: Kind of position sensor.
        observer: Whether a driven twin has its disturbance observer on; with a learned model it
            always has.
        noise: Whether the noise of the learned force is included (`residual_force.noise.enabled`,
            on), and the white noise of accelerometer and gyroscope is that of its flights.
        accuracy: Errors on other flights, so that a driven twin outputs error bands and their
            validity; None: no such outputs.

    Raises:
        TwinError: An unknown mission, controller, drive or position sensor, or a compensator or
            force of another vehicle.
    """
    model = checked_vehicle(vehicle, "twin")
    _check_position("twin", position)
    if compensator is not None:
        check_compensator(compensator, model)
    law = None if force is None else law_for(force, model, noise)
    if noise and (law is None or not law.noise.any()):
        raise TwinError(
            "noise: nothing is to be drawn. It is of a learned force whose training flights hover, "
            "and whose twin does; train with such a flight."
        )
    changes, evidence = _taught(compensator, force)
    bands = None
    if drive is None:
        assembly = flying_twin(model, mission, controller, law=law, position=position)
    else:
        _check_drive("twin", drive)
        part = None
        if accuracy is not None:
            part, bands = accuracy_part(accuracy, model, drive, observer, changes)
        assembly = driven_twin(model, drive, law=law, position=position, accuracy=part)
        if observer or force is not None or compensator is not None:
            assembly = assembly.with_starts({OBSERVER: 1.0})
    if noise:
        white = force.model.imu_noise if force is not None else ()
        assembly = assembly.with_starts({NOISE: 1.0} | imu_starts(white or ()))
    if observer:
        changes.append("an observer acts on it")
    if noise:
        changes.append("noise of the force is drawn")
    return Twin(model.name, assembly, compensator, model.grounded, tuple(changes), evidence, bands)


LAWLESS = "its training accepted no law: the untrained observer alone acts, where a log drives it"
"""What exports say of a twin whose training found none that flies better on other flights."""


READ_S = 5e-3
"""Time between two draws of the white noise that flights have, s: a fifth of the shortest period of
`NOISE_HZ`. It is held in between, so that who reads more often finds the same density below."""


def imu_starts(white: Sequence[float]) -> dict[str, float]:
    """Start values of the IMU for white noise of accelerometer, m/s2, and gyroscope, rad/s, in
    readings `READ_S` apart; none, so that those of the vehicle file stay, where it is not known."""
    if not white or min(white) <= 0:
        return {}
    acc, gyro = white
    return {"imu.acc_noise": acc, "imu.gyro_noise": gyro, "imu.sample_period": READ_S}


def _taught(
    compensator: NetworkFile | None, force: LearnedForce | None
) -> tuple[list[str], dict[str, str]]:
    """Notes on included learned models; hashes of the models and of their training flights."""
    changes, evidence = [], {}
    if compensator is not None:
        changes.append("a trained compensator corrects its sensors")
        evidence[compensator.path.name] = sha256(compensator.path)
    if force is not None:
        from learning.force.model import FILE as FORCE_FILE

        changes.append("a learned force acts on it" if force.model.says else LAWLESS)
        evidence |= {f.name: f.sha256 for f in force.model.flights}
        if (force.folder / FORCE_FILE).is_file():
            evidence[FORCE_FILE] = sha256(force.folder / FORCE_FILE)
    return changes, evidence


def component(
    name: str,
    vehicle: Vehicle,
    *,
    drive: Drive | None = None,
    position: Kind = "gnss",
    mission: str = "hover",
) -> Component:
    """One component of a vehicle, with all effects that act in it.

    Args:
        name: Name in `twin.flight.assembly.COMPONENTS`.
        vehicle: Vehicle of the component.
        drive: Inputs of the airframe; None: those that the vehicle describes.
        position: Kind of position sensor.
        mission: Mission of the component `mission`.

    Raises:
        TwinError: There is no such component, drive, sensor or mission, or the vehicle lacks
            numbers for it.
    """
    model = checked_vehicle(vehicle, "component")
    if name not in COMPONENTS:
        raise TwinError(unknown_name("component", "component", name, COMPONENTS))
    if drive is not None:
        _check_drive(name, drive)
    _check_position(name, position)
    made = COMPONENTS[name](model, Choices(effects_for(model), drive, position, mission))
    return replace(made, description=with_reason(made.description, model.grounded))


def with_reason(description: str, grounded: str) -> str:
    """A description for an FMU, followed by the reason why the twin cannot fly; "": none."""
    text = f"{description} {GROUNDED}{grounded}" if grounded else description
    return shorten(text, LONGEST_TEXT, placeholder=" ...")


def _check_drive(name: str, drive: str) -> None:
    drives = get_args(Drive)
    if drive not in drives:
        raise TwinError(unknown_name(name, "drive", drive, drives))


def _check_position(name: str, position: str) -> None:
    if position not in PRESETS:
        raise TwinError(unknown_name(name, "position sensor", position, PRESETS))


def replay(flight: Flight, linear: Iterable[str] = ()) -> FmuModel:
    """A recorded flight for export: its columns become outputs.

    Args:
        flight: Flight to replay.
        linear: Columns to interpolate linearly; others hold their last value.

    Raises:
        TwinError: The flight has no such column.
    """
    (one,) = checked_flights([flight], "replay")
    columns = tuple(c for c in one.table if c not in ("time", "phase") and one.has(c))
    wanted = tuple(linear)
    for name in wanted:
        if name not in columns:
            raise TwinError(unknown_name(f"linear, {one.name}", "column", name, columns))
    return replay_model(one, columns, wanted)


def compensator(folder: str | Path, int8: bool = False) -> NetworkFile:
    """A trained compensator from the folder of `train`.

    Args:
        folder: Folder with its `model.onnx`.
        int8: Whether to use weights of 8 bits: about half of the size, and faster.

    Raises:
        FmuError: The folder has none.
    """
    return read_network(model_folder(folder), INT8_FILE if int8 else FILE)


def check_compensator(network: NetworkFile, vehicle: Vehicle) -> None:
    """Check a compensator against the vehicle of the twin.

    Raises:
        TwinError: It was trained for another vehicle, or for other numbers of this one.
    """
    folder = network.path.parent
    if len(network.commands) != vehicle.rotors.count:
        raise TwinError(
            f"{folder}: the model was trained with {len(network.commands)} motors, "
            f"{vehicle.name} has {vehicle.rotors.count}. Give the vehicle it was trained for."
        )
    _check_taught(str(folder), network.vehicle, network.vehicle_sha256, vehicle)


def check_unaided(network: NetworkFile) -> None:
    """Refuse a compensator with measurements as inputs, where there is no aircraft.

    Raises:
        TwinError: It has measurements as inputs.
    """
    if network.sees_measurements:
        raise TwinError(
            f"{network.path.parent}: this compensator corrects by what the aircraft measured a "
            f"while ago (protocol {network.protocol}); here no aircraft flies. Train one that "
            f"sees none: uavtwin train --protocol free, or --protocol force."
        )


def law_for(force: LearnedForce, vehicle: Vehicle, noise: bool = False) -> ForceLaw:
    """The law of a learned force, checked against the vehicle of the twin, with or without its
    noise.

    Raises:
        TwinError: It was learned for another vehicle, or for other numbers of this one.
    """
    taught = force.model
    _check_taught(str(force.folder), taught.vehicle, taught.vehicle_sha256, vehicle)
    law = taught.law
    return law if noise else replace(law, noise=np.zeros_like(law.noise))


def learned_force(folder: str | Path) -> LearnedForce:
    """A learned force from a folder of `train` under the protocol `force`.

    Raises:
        ModelError: The folder has none.
    """
    from learning.force.model import load_force

    place = model_folder(folder)
    return LearnedForce(load_force(place), place)


PRETRAINED = Path(__file__).parent.parent / "pretrained"
"""Folder with the folder of each built-in model, by name."""


def model_folder(given: str | Path) -> Path:
    """Folder of a model: a path, or the name of a built-in model."""
    shipped = PRETRAINED / Path(given).name
    if Path(given).exists() or str(given) != shipped.name or not shipped.is_dir():
        return Path(given)
    return shipped


def learned(folder: Path, int8: bool = False) -> tuple[NetworkFile | None, LearnedForce | None]:
    """Models in a folder of `train`: a compensator of the sensors, a learned force, or both.

    Args:
        folder: Folder to read.
        int8: Whether to use weights of 8 bits, as in `compensator`.

    Raises:
        TwinError: It has neither.
    """
    from learning.force.model import FILE as FORCE_FILE
    from learning.force.model import is_force

    if not folder.is_dir():
        shipped = ", ".join(sorted(p.name for p in PRETRAINED.iterdir() if p.is_dir()))
        raise TwinError(f"{folder}: no such folder, and no model that is shipped: {shipped}.")
    force = learned_force(folder) if (folder / FORCE_FILE).is_file() else None
    return None if is_force(folder) else compensator(folder, int8), force


def _check_taught(model: str, name: str, sha256: str, vehicle: Vehicle) -> None:
    """Check a trained model's vehicle, "" where not stated, against the given one."""
    if name and name != vehicle.name:
        raise TwinError(
            f"{model}: the model corrects the twin of {name}, not of {vehicle.name}. Give the "
            f"vehicle {name}, or train on flights of {vehicle.name}."
        )
    text = checked_vehicle(vehicle, COMPENSATOR).toml()
    if sha256 not in ("", hashlib.sha256(text.encode()).hexdigest()):
        raise TwinError(
            f"{model}: the model was trained on other numbers of {vehicle.name} than those "
            f"given, and would correct what is no longer wrong. Give the vehicle file it was "
            f"trained with, or train again."
        )
