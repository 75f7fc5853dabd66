"""`uavtwin export`: components of a vehicle, or the whole twin, as files that FMI tools run."""

import hashlib
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

from fmus import FmuModel, build, component_model, fuse, replay_model
from fmus.compensator import (
    NetworkFile,
    UnsupportedNetworkError,
    native_model,
    read_network,
)
from fmus.platforms import Platform, compilers, select_platforms
from fmus.python_slave import build_network_slave, build_python_slave
from twin.airframe import airframe
from twin.assembly import CONTROLLERS, Assembly, connected_by_name, flying_twin
from twin.barometer import barometer
from twin.battery import battery
from twin.component import Component, unknown_name
from twin.effects import EFFECTS
from twin.environment import environment
from twin.errors import TwinError
from twin.flightlog import Flight, read_flight
from twin.imu import imu
from twin.magnetometer import magnetometer
from twin.mission import mission
from twin.position import PRESETS, Kind, position_sensor
from twin.rotors import Drive
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle, vehicle_text

from .output import sha256
from .ssp import write_ssp
from .system import Connection, System

FUSED, COMPENSATOR = "corrected-twin", "compensator"
VEHICLE_FILE = "vehicle.toml"
"""In the folder of a trained model: the vehicle whose twin it corrects."""
STEP_S = 1e-3
"""Step of the whole twin: of its fused FMU, and of the co-simulation of its parts."""


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
        "imu": lambda: imu(vehicle, EFFECTS),
        "magnetometer": lambda: magnetometer(vehicle, EFFECTS),
        "barometer": lambda: barometer(vehicle, EFFECTS),
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

    def chosen(settable: set[str]) -> dict[str, float]:
        """Start values for one of the components."""
        known.update(settable)
        return {k: v for k, v in values.items() if k in settable}

    for name in dict.fromkeys(names):
        if name == FUSED:
            products += _whole_twin(vehicle, choice, network, chosen)
        elif name == "replay" and choice.flight is not None:
            products.append(_native(_replay(read_flight(choice.flight), choice.linear)))
        elif name == COMPENSATOR and network is not None:
            products.append(_compensator(network, versions, choice.python_slave, chosen))
        else:
            component = makers[name]()
            component = component.with_starts(chosen(_settable(component)))
            slave = choice.python_slave
            products.append(_slave(component) if slave else _native(component_model(component)))
    for name in values:
        if name not in known:
            raise TwinError(unknown_name("--start", "parameter or input", name, known))
    return lambda out, progress: _write(products, versions, platforms, out, progress)


def default_vehicle(model: Path | None) -> str:
    """Vehicle where none is named: the one that a trained model corrects."""
    beside = None if model is None else model / VEHICLE_FILE
    return str(beside) if beside is not None and beside.is_file() else "copter_default"


def fused_model(assembly: Assembly, vehicle: str, compensator: FmuModel | None = None) -> FmuModel:
    """The whole twin as the model of one FMU, with a compensator or without."""
    parts = _parts(assembly, compensator)
    text = f"Flying twin of {vehicle}: {', '.join(parts)} in one"
    return fuse("corrected_twin", text, parts, connected_by_name(parts), STEP_S)


def system_of(
    assembly: Assembly,
    folder: Path,
    fmi: int = 2,
    platforms: Sequence[str] = ("linux64",),
    progress: Callable[[float], None] = lambda _: None,
    compensator: FmuModel | None = None,
) -> System:
    """The whole twin as one FMU per part, built into a folder, and connections."""
    fmus: dict[str, Path] = {}
    parts = _parts(assembly, compensator)
    for name, part in parts.items():
        model = component_model(part) if isinstance(part, Component) else part
        fmus[name] = build(model, folder / f"{name}.fmu", fmi, platforms)
        progress(len(fmus) / len(parts))
    connections = tuple(Connection(a, b) for a, b in connected_by_name(parts))
    return System(fmus, connections, stop_time_s=assembly.duration_s, step_s=STEP_S)


def _parts(assembly: Assembly, compensator: FmuModel | None) -> dict[str, Component | FmuModel]:
    """Parts by name.

    Raises:
        TwinError: The compensator reads what no part gives.
    """
    parts: dict[str, Component | FmuModel] = dict(assembly.parts)
    if compensator is None:
        return parts
    given = {name for part in assembly.parts.values() for name in part.output_names}
    missing = [n for n in compensator.input_names if "." not in n and n not in given]
    if missing:
        raise TwinError(
            f"the compensator reads {', '.join(missing)}, which this twin does not give: was it "
            f"trained on measured rotor speeds, and is the vehicle driven by commands?"
        )
    return parts | {COMPENSATOR: compensator}


# -- what is written ------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Product:
    """One file per FMI version.

    Attributes:
        file: Its name.
        write: `(path, FMI version, platforms)`: write it.
        note: What the user should know of it, or "".
    """

    file: str
    write: Callable[[Path, int, Sequence[str]], object]
    note: str = ""


def _native(model: FmuModel) -> Product:
    return Product(f"{model.name}.fmu", lambda path, fmi, on: build(model, path, fmi, on))


def _slave(component: Component) -> Product:
    return Product(f"{component.name}.fmu", lambda path, *_: build_python_slave(component, path))


def _compensator(
    network: NetworkFile,
    versions: Sequence[int],
    python_slave: bool,
    chosen: Callable[[set[str]], dict[str, float]],
) -> Product:
    """Native; as a Python slave where that is wanted, or the C generator refuses the network."""
    if not python_slave:
        try:
            model = native_model(network)
            return _native(model.with_starts(chosen(_settable(model))))
        except UnsupportedNetworkError as refusal:
            if versions != [2]:
                raise TwinError(
                    f"{network.path}: {refusal}. A Python slave can run it, for FMI 2 alone: "
                    f"--fmi 2."
                ) from None
            note = f"{refusal}; so it is a Python slave: its host must be Python with onnxruntime"
            return replace(_network_slave(network), note=note)
    return _network_slave(network)


def _network_slave(network: NetworkFile) -> Product:
    return Product("compensator.fmu", lambda path, *_: build_network_slave(network, path))


def _whole_twin(
    vehicle: Vehicle,
    choice: Choice,
    network: NetworkFile | None,
    chosen: Callable[[set[str]], dict[str, float]],
) -> list[Product]:
    """The fused FMU and the `.ssp`."""
    assembly = flying_twin(vehicle, choice.mission, choice.controller)
    compensator = None
    if network is not None:
        try:
            compensator = native_model(network)
        except UnsupportedNetworkError as refusal:
            raise TwinError(
                f"{network.path}: {refusal}. The corrected twin is native; export the compensator "
                f"alone, as a Python slave."
            ) from None
    parts = _parts(assembly, compensator)
    starts = chosen({f"{k}.{v}" for k, part in parts.items() for v in _settable(part)})
    own = f"{COMPENSATOR}."
    assembly = assembly.with_starts({k: v for k, v in starts.items() if not k.startswith(own)})
    if compensator is not None:
        compensator = compensator.with_starts(
            {k.removeprefix(own): v for k, v in starts.items() if k.startswith(own)}
        )

    def write(path: Path, fmi: int, platforms: Sequence[str]) -> None:
        """The `.ssp`, its FMUs built beside it and taken away again."""
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=".parts") as folder:
            write_ssp(
                system_of(assembly, Path(folder), fmi, platforms, compensator=compensator), path
            )

    fused = fused_model(assembly, vehicle.name, compensator)
    return [_native(fused), Product("corrected_twin.ssp", write)]


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
            f"{vehicle.name}. Leave --vehicle out, or train on flights of {vehicle.name}."
        )
    text, _ = vehicle_text(choice.vehicle)
    if network.vehicle_sha256 not in ("", hashlib.sha256(text.encode()).hexdigest()):
        raise TwinError(
            f"{choice.model}: the model was trained on other numbers of {vehicle.name} than those "
            f"in {choice.vehicle}, and would correct what is no longer wrong. Leave --vehicle out, "
            f"or train anew."
        )
    return network


def _write(
    products: Sequence[Product],
    versions: Sequence[int],
    platforms: Sequence[Platform],
    out: Path,
    progress: Callable[[float], None],
) -> list[dict[str, Any]]:
    names = [p.name for p in platforms]
    written: list[dict[str, Any]] = []
    for version in versions:
        folder = out if len(versions) == 1 else out / f"fmi{version}"
        folder.mkdir(exist_ok=True)
        for product in products:
            path = folder / product.file
            product.write(path, version, names)
            row = {
                "file": str(path.relative_to(out)),
                "fmi": version,
                "platforms": names,
                "bytes": path.stat().st_size,
                "sha256": sha256(path),
            }
            written.append(row | ({"note": product.note} if product.note else {}))
            progress(len(written) / (len(versions) * len(products)))
    return written


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
    """Start values of "NAME=NUMBER" texts.

    Raises:
        TwinError: A text is not of that form.
    """
    values = {}
    for text in texts:
        name, equals, value = text.partition("=")
        try:
            values[name] = float(value)
        except ValueError:
            equals = ""
        if not equals:
            raise TwinError(f"--start {text}: write NAME=NUMBER.")
    return values


def _settable(part: Component | FmuModel) -> set[str]:
    return {v.name for v in part.variables if v.causality != "output"}


def _replay(flight: Flight, linear: str) -> FmuModel:
    columns = tuple(c for c in flight.table if c not in ("time", "phase") and flight.has(c))
    wanted = [c.strip() for c in linear.split(",") if c.strip()]
    for name in wanted:
        if name not in columns:
            raise TwinError(unknown_name(f"--linear, {flight.name}", "column", name, columns))
    return replay_model(flight, columns, tuple(wanted))
