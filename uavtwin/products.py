"""What `uavtwin export` writes: one file per component and FMI version, each in its own way."""

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cosim.ssp import write_ssp
from cosim.whole_twin import COMPENSATOR, fused_model, parts_of, system_of
from fmus import FmuModel, build
from fmus.compensator import NetworkFile, UnsupportedNetworkError, native_model
from fmus.platforms import Platform
from fmus.python_slave.build import build_network_slave, build_python_slave
from twin.component import Component
from twin.errors import TwinError
from twin.flight.assembly import flying_twin
from twin.vehicle import Vehicle

from .output import sha256

Chosen = Callable[[set[str]], dict[str, float]]
"""Start values that the user gave, of those that can be set."""


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


def native_product(model: FmuModel) -> Product:
    """A native FMU."""
    return Product(f"{model.name}.fmu", lambda path, fmi, on: build(model, path, fmi, on))


def slave_product(component: Component) -> Product:
    """An FMU run by Python."""
    return Product(f"{component.name}.fmu", lambda path, *_: build_python_slave(component, path))


def compensator_product(
    network: NetworkFile,
    versions: Sequence[int],
    python_slave: bool,
    chosen: Chosen,
) -> Product:
    """Native; as a Python slave where that is wanted, or the C generator refuses the network."""
    if not python_slave:
        try:
            model = native_model(network)
            return native_product(model.with_starts(chosen(settable(model))))
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


def twin_products(
    vehicle: Vehicle,
    mission: str,
    controller: str,
    network: NetworkFile | None,
    chosen: Chosen,
) -> list[Product]:
    """The fused FMU and the `.ssp`."""
    assembly = flying_twin(vehicle, mission, controller)
    compensator = None
    if network is not None:
        try:
            compensator = native_model(network)
        except UnsupportedNetworkError as refusal:
            raise TwinError(
                f"{network.path}: {refusal}. The corrected twin is native; export the compensator "
                f"alone, as a Python slave."
            ) from None
    parts = parts_of(assembly, compensator)
    starts = chosen({f"{k}.{v}" for k, part in parts.items() for v in settable(part)})
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
    return [native_product(fused), Product("corrected_twin.ssp", write)]


def settable(part: Component | FmuModel) -> set[str]:
    """Names of what has a start value."""
    return {v.name for v in part.variables if v.causality != "output"}


def write_products(
    products: Sequence[Product],
    versions: Sequence[int],
    platforms: Sequence[Platform],
    out: Path,
    progress: Callable[[float], None],
) -> list[dict[str, Any]]:
    """Write everything; a row per file: name, version, platforms, size, hash, perhaps a note."""
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
