"""`uavtwin export`: components of a vehicle as FMU files."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from fmus import FmuModel, build, component_model, replay_model
from fmus.platforms import Platform, compilers, select_platforms
from twin.airframe import airframe
from twin.battery import battery
from twin.component import Component, unknown_name
from twin.errors import TwinError
from twin.flightlog import Flight, read_flight
from twin.imu import imu
from twin.vehicle_file import load_vehicle

from .output import sha256

COMPONENTS = ("airframe", "imu", "battery", "replay")


def export_components(
    names: Sequence[str],
    vehicle: str,
    fmi: str,
    flight: Path | None,
    drive: str | None,
    starts: Sequence[str],
    platform: str = "linux64",
) -> Callable[[Path], list[dict[str, Any]]]:
    """Check everything, then return the function that writes the FMUs into a folder.

    Raises:
        TwinError: An unknown component, FMI version, drive, platform or start value; a missing
            flight or compiler.
    """
    for name in names:
        if name not in COMPONENTS:
            raise TwinError(unknown_name("export", "component", name, COMPONENTS))
    versions = _versions(fmi)
    platforms = _platforms(platform)
    if drive not in (None, "command", "rotor_speed"):
        raise TwinError(f"--drive {drive}: choose command or rotor_speed.")
    if "replay" in names and flight is None:
        raise TwinError("replay needs the flight to replay: --flight LOG.")
    model = load_vehicle(vehicle)
    values = _starts(starts)
    makers: dict[str, Callable[[], Component]] = {
        "airframe": lambda: airframe(model, drive),  # type: ignore[arg-type]
        "imu": lambda: imu(model),
        "battery": lambda: battery(model),
    }
    parts = {n: makers[n]() for n in names if n != "replay"}
    for name in values:
        known = {v.name for c in parts.values() for v in c.parameters + c.inputs}
        if name not in known:
            raise TwinError(unknown_name("--start", "parameter or input", name, known))
    models = [
        component_model(c.with_starts({k: v for k, v in values.items() if k in _settable(c)}))
        for c in parts.values()
    ]
    if flight is not None and "replay" in names:
        models.append(_replay(read_flight(flight)))
    return lambda out: _write(models, versions, platforms, out)


def _write(
    models: Sequence[FmuModel],
    versions: Sequence[int],
    platforms: Sequence[Platform],
    out: Path,
) -> list[dict[str, Any]]:
    names = [p.name for p in platforms]
    written = []
    for version in versions:
        folder = out if len(versions) == 1 else out / f"fmi{version}"
        folder.mkdir(exist_ok=True)
        for model in models:
            path = build(model, folder / f"{model.name}.fmu", version, names)
            written.append(
                {
                    "file": str(path.relative_to(out)),
                    "fmi": version,
                    "platforms": names,
                    "bytes": path.stat().st_size,
                    "sha256": sha256(path),
                }
            )
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


def _starts(texts: Sequence[str]) -> dict[str, float]:
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


def _replay(flight: Flight) -> FmuModel:
    columns = tuple(c for c in flight.table if c not in ("time", "phase") and flight.has(c))
    return replay_model(flight, columns)
