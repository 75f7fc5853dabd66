"""`uavtwin export`: components of a vehicle, or the whole twin, as files that FMI tools run."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from fmus import FmuModel, build, component_model, fuse, replay_model
from fmus.platforms import Platform, compilers, select_platforms
from fmus.python_slave import build_python_slave
from twin.airframe import airframe
from twin.assembly import CONTROLLERS, Assembly, flying_twin
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
from twin.vehicle_file import load_vehicle

from .output import sha256
from .ssp import write_ssp
from .system import Connection, System

FUSED = "corrected-twin"
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
    choices = (*makers, "replay", FUSED)
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
    values = start_values(choice.starts)
    slaves: list[Component] = []
    models: list[FmuModel] = []
    assembly: Assembly | None = None
    known: set[str] = set()
    for name in dict.fromkeys(names):
        if name == FUSED:
            assembly = flying_twin(vehicle, choice.mission, choice.controller)
            settable = {f"{k}.{v}" for k, c in assembly.parts.items() for v in _settable(c)}
            assembly = assembly.with_starts({k: v for k, v in values.items() if k in settable})
            models.append(fused_model(assembly, vehicle.name))
            known |= settable
        elif name == "replay" and choice.flight is not None:
            models.append(_replay(read_flight(choice.flight), choice.linear))
        else:
            component = makers[name]()
            own = {k: v for k, v in values.items() if k in _settable(component)}
            component = component.with_starts(own)
            if choice.python_slave:
                slaves.append(component)
            else:
                models.append(component_model(component))
            known |= _settable(component)
    for name in values:
        if name not in known:
            raise TwinError(unknown_name("--start", "parameter or input", name, known))
    return lambda out, progress: _write(
        models, slaves, assembly, versions, platforms, out, progress
    )


def fused_model(assembly: Assembly, vehicle: str) -> FmuModel:
    """The whole twin as the model of one FMU."""
    text = f"Flying twin of {vehicle}: {', '.join(assembly.parts)} in one"
    return fuse("corrected_twin", text, assembly.parts, assembly.connections, STEP_S)


def system_of(
    assembly: Assembly,
    folder: Path,
    fmi: int = 2,
    platforms: Sequence[str] = ("linux64",),
    progress: Callable[[float], None] = lambda _: None,
) -> System:
    """The whole twin as one FMU per part, built into a folder, and connections."""
    fmus: dict[str, Path] = {}
    for name, part in assembly.parts.items():
        fmus[name] = build(component_model(part), folder / f"{name}.fmu", fmi, platforms)
        progress(len(fmus) / len(assembly.parts))
    connections = tuple(Connection(a, b) for a, b in assembly.connections)
    return System(fmus, connections, stop_time_s=assembly.duration_s, step_s=STEP_S)


def _write(
    models: Sequence[FmuModel],
    slaves: Sequence[Component],
    assembly: Assembly | None,
    versions: Sequence[int],
    platforms: Sequence[Platform],
    out: Path,
    progress: Callable[[float], None],
) -> list[dict[str, Any]]:
    names = [p.name for p in platforms]
    written, steps = [], len(versions) * (len(models) + len(slaves) + (assembly is not None))

    def add(path: Path, version: int) -> None:
        """List a file that was written."""
        written.append(
            {
                "file": str(path.relative_to(out)),
                "fmi": version,
                "platforms": names,
                "bytes": path.stat().st_size,
                "sha256": sha256(path),
            }
        )
        progress(len(written) / steps)

    for version in versions:
        folder = out if len(versions) == 1 else out / f"fmi{version}"
        folder.mkdir(exist_ok=True)
        for model in models:
            add(build(model, folder / f"{model.name}.fmu", version, names), version)
        for component in slaves:
            add(build_python_slave(component, folder / f"{component.name}.fmu"), version)
        if assembly is not None:
            parts = folder / "parts"
            parts.mkdir()
            system = system_of(assembly, parts, version, names)
            add(write_ssp(system, folder / "corrected_twin.ssp"), version)
            for path in system.fmus.values():
                path.unlink()
            parts.rmdir()
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


def _settable(component: Component) -> set[str]:
    return {v.name for v in component.parameters + component.inputs}


def _replay(flight: Flight, linear: str) -> FmuModel:
    columns = tuple(c for c in flight.table if c not in ("time", "phase") and flight.has(c))
    wanted = [c.strip() for c in linear.split(",") if c.strip()]
    for name in wanted:
        if name not in columns:
            raise TwinError(unknown_name(f"--linear, {flight.name}", "column", name, columns))
    return replay_model(flight, columns, tuple(wanted))
