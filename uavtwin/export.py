"""`uavtwin export`: components of a vehicle, or the whole twin, as files that FMI tools run."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, cast

from cosim.whole_twin import COMPENSATOR
from fmus import FmuModel, component_model, replay_model
from fmus.compensator import NetworkFile, read_network
from fmus.platforms import Platform, compilers, select_platforms
from twin.component import Component, unknown_name
from twin.effects import EFFECTS
from twin.errors import TwinError
from twin.flight.assembly import CONTROLLERS
from twin.flight.mission import mission
from twin.logs import Flight, read_flight
from twin.physics.airframe import airframe
from twin.physics.battery import battery
from twin.physics.environment import environment
from twin.physics.rotors import Drive
from twin.physics.sensors.position import PRESETS, Kind, position_sensor
from twin.physics.sensors.table import components_of_sensors
from twin.vehicle import Vehicle
from twin.vehicle.file import load_vehicle, vehicle_text

from .cli.options import named_numbers
from .products import (
    Product,
    compensator_product,
    native_product,
    settable,
    slave_product,
    twin_products,
    write_products,
)

FUSED = "corrected-twin"
VEHICLE_FILE = "vehicle.toml"
"""In the folder of a trained model: the vehicle whose twin it corrects."""


@dataclass(frozen=True, slots=True)
class Choice:
    """What a user wants exported, next to the names of the components.

    Attributes:
        vehicle: Vehicle file, or the name of a built-in vehicle.
        fmi: FMI versions, comma-separated.
        platform: Platforms, comma-separated, or "all".
        drive: Inputs of the airframe; None: what the vehicle describes.
        starts: "NAME=VALUE" texts; "part.name" for the corrected twin.
        flight: To replay.
        linear: Columns of the replay to interpolate, comma-separated.
        mission: Of the components `mission` and `corrected-twin`.
        controller: Of the corrected twin.
        model: Folder of a trained compensator, for `compensator` and `corrected-twin`.
        position: Kind of position sensor.
        python_slave: Whether components are evaluated by Python inside the FMU, for prototypes.
    """

    vehicle: str = "copter_default"
    fmi: str = "2"
    platform: str = "linux64"
    drive: str | None = None
    starts: Sequence[str] = ()
    flight: Path | None = None
    linear: str = ""
    mission: str = "hover"
    controller: str = "lqr"
    model: Path | None = None
    position: str = "gnss"
    python_slave: bool = False


def _makers(vehicle: Vehicle, choice: Choice) -> dict[str, Callable[[], Component]]:
    """Every component by its name, each with all its effects built in."""
    drive = cast(Drive | None, choice.drive)
    return {
        "airframe": lambda: airframe(vehicle, drive, EFFECTS),
        **{name: partial(make, vehicle, EFFECTS) for name, make in components_of_sensors().items()},
        "position": lambda: position_sensor(vehicle, EFFECTS, cast(Kind, choice.position)),
        "battery": lambda: battery(vehicle),
        "environment": lambda: environment(vehicle),
        "mission": lambda: mission(vehicle, choice.mission),
        "controller": lambda: CONTROLLERS["lqr"](vehicle),
        "controller_px4": lambda: CONTROLLERS["px4"](vehicle),
    }


def export_components(
    names: Sequence[str], choice: Choice
) -> Callable[[Path, Callable[[float], None]], list[dict[str, Any]]]:
    """Check everything, then return the function that writes into a folder.

    Raises:
        TwinError: An unknown component, FMI version, drive, platform or start value; a missing
            flight or compiler.
    """
    vehicle = load_vehicle(choice.vehicle)
    makers = _makers(vehicle, choice)
    choices = (*makers, "replay", COMPENSATOR, FUSED)
    for name in names:
        if name not in choices:
            raise TwinError(unknown_name("export", "component", name, choices))
    versions, platforms = _versions(choice.fmi), _platforms(choice.platform)
    if choice.drive not in (None, "command", "rotor_speed"):
        raise TwinError(f"--drive {choice.drive}: choose command or rotor_speed.")
    if choice.position not in PRESETS:
        raise TwinError(unknown_name("export", "position sensor", choice.position, PRESETS))
    if "replay" in names and choice.flight is None:
        raise TwinError("replay needs the flight to replay: --flight LOG.")
    if choice.python_slave and (versions != [2] or {"replay", FUSED} & set(names)):
        raise TwinError("--python-slave: FMI 2 and single components only; leave the rest native.")
    network = _network(names, choice, vehicle)
    values = start_values(choice.starts)
    products: list[Product] = []
    known: set[str] = set()

    def chosen(names: set[str]) -> dict[str, float]:
        """Start values of these names, which are one component's."""
        known.update(names)
        return {k: v for k, v in values.items() if k in names}

    for name in dict.fromkeys(names):
        if name == FUSED:
            products += twin_products(vehicle, choice.mission, choice.controller, network, chosen)
        elif name == "replay" and choice.flight is not None:
            products.append(native_product(_replay(read_flight(choice.flight), choice.linear)))
        elif name == COMPENSATOR and network is not None:
            products.append(compensator_product(network, versions, choice.python_slave, chosen))
        else:
            component = makers[name]()
            component = component.with_starts(chosen(settable(component)))
            slave = choice.python_slave
            products.append(
                slave_product(component) if slave else native_product(component_model(component))
            )
    for name in values:
        if name not in known:
            raise TwinError(unknown_name("--start", "parameter or input", name, known))
    return lambda out, progress: write_products(products, versions, platforms, out, progress)


def default_vehicle(model: Path | None) -> str:
    """Vehicle where none is named: the one that a trained model corrects."""
    beside = None if model is None else model / VEHICLE_FILE
    return str(beside) if beside is not None and beside.is_file() else "copter_default"


def _network(names: Sequence[str], choice: Choice, vehicle: Vehicle) -> NetworkFile | None:
    """The trained network, held against the vehicle.

    Raises:
        TwinError: It is missing, nothing needs it, or it is of another vehicle.
    """
    if choice.model is None:
        if COMPENSATOR in names:
            raise TwinError("compensator needs a trained model: --model FOLDER.")
        return None
    if not {COMPENSATOR, FUSED} & set(names):
        raise TwinError("--model goes with compensator and corrected-twin.")
    network = read_network(choice.model)
    if len(network.commands) != vehicle.rotors.count:
        raise TwinError(
            f"{choice.model}: the model was trained with {len(network.commands)} motors, "
            f"{vehicle.name} has {vehicle.rotors.count}. Give the vehicle it was trained for."
        )
    if network.vehicle and network.vehicle != vehicle.name:
        raise TwinError(
            f"{choice.model}: the model corrects the twin of {network.vehicle}, not of "
            f"{vehicle.name}. Give --vehicle {network.vehicle}, or train on flights of "
            f"{vehicle.name}."
        )
    text, _ = vehicle_text(choice.vehicle)
    if network.vehicle_sha256 not in ("", hashlib.sha256(text.encode()).hexdigest()):
        raise TwinError(
            f"{choice.model}: the model was trained on other numbers of {vehicle.name} than those "
            f"in {choice.vehicle}, and would correct what is no longer wrong. Give the file it was "
            f"trained with, or train anew."
        )
    return network


def _versions(fmi: str) -> list[int]:
    try:
        versions = sorted({int(v) for v in fmi.split(",")})
    except ValueError:
        versions = []
    if not versions or not set(versions) <= {2, 3}:
        raise TwinError(f"--fmi {fmi}: choose 2, 3 or 2,3.")
    return versions


def _platforms(text: str) -> tuple[Platform, ...]:
    platforms = select_platforms(name.strip() for name in text.split(","))
    compilers(platforms)  # a missing one is reported before anything is written
    return platforms


def start_values(texts: Sequence[str]) -> dict[str, float]:
    """Start values of "NAME=NUMBER" texts."""
    return named_numbers(texts, "--start", "NAME=NUMBER")


def _replay(flight: Flight, linear: str) -> FmuModel:
    columns = tuple(c for c in flight.table if c not in ("time", "phase") and flight.has(c))
    wanted = [c.strip() for c in linear.split(",") if c.strip()]
    for name in wanted:
        if name not in columns:
            raise TwinError(unknown_name(f"--linear, {flight.name}", "column", name, columns))
    return replay_model(flight, columns, tuple(wanted))
