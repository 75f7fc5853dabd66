"""A user's own force law, a torch module or an ONNX file, stored as the folder of a law."""

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from learning.data.envelope import BEYOND
from learning.force.equations import Equations
from learning.force.laws import Taught
from learning.force.model import (
    VEHICLE_FILE,
    ForceModel,
    TrainingFlight,
    save_force,
)
from learning.force.module import law_function, module_onnx
from learning.force.windows import FlightWindows
from twin.component.rows import OverRows
from twin.logs import Flight
from twin.residuals.aligned import components_of

from ..flights import check_names
from ..output import results_folder
from ..vehicles import Vehicle
from .learn import drive_of

if TYPE_CHECKING:
    from torch import nn


def windows_of(flights: Sequence[Flight], vehicle: Vehicle) -> list[FlightWindows]:
    """Training data for a module: `places` are its inputs, `left` the force and moment missing in
    the equations.

    Raises:
        TwinError: A flight lacks the motion, is too short, or has a different drive from the
            others.
    """
    return list(_taught(flights, vehicle).flights)


def _taught(flights: Sequence[Flight], vehicle: Vehicle) -> Taught:
    """Envelope and training data from the flights."""
    equations = Equations(vehicle, components_of(vehicle, drive_of(flights, vehicle))[0])
    return Taught.by([FlightWindows.of(f, vehicle, equations) for f in flights], equations)


def own_force(
    module: "nn.Module | bytes",
    flights: Sequence[Flight],
    vehicle: Vehicle,
    folder: Path,
    force: bool = False,
) -> Path:
    """Write a module as the folder of a law, which `evaluate` and `export corrected-twin` accept.

    The training flights give the envelope, outside of which the law fades, and its bounds: twice
    its largest output in them. The law is not validated here: `evaluate` measures it on other
    flights.

    Args:
        module: Torch module, as `learning.force.module` accepts it; or the bytes of an ONNX file.
        flights: Flights on which it was trained.
        vehicle: Vehicle whose equations it extends.
        folder: Folder to write.
        force: Whether the folder may contain other files already.

    Returns:
        Path of the folder.

    Raises:
        TwinError: The module cannot be a law, or a flight cannot be used.
    """
    check_names(flights)
    content = module if isinstance(module, bytes) else module_onnx(module).SerializeToString()
    function = law_function(content)
    taught = _taught(flights, vehicle)
    said = OverRows(function, 1)(np.vstack([w.places for w in taught.flights]))
    law = replace(taught.empty, most=BEYOND * np.abs(said).max(axis=0), module=function)
    with results_folder(folder, force) as out:
        save_force(
            ForceModel(
                law=law,
                flights=tuple(TrainingFlight(f.name, f.fingerprint) for f in flights),
                vehicle=vehicle.name,
                vehicle_sha256=hashlib.sha256(vehicle.toml().encode()).hexdigest(),
                seed=0,
                onnx=content,
            ),
            out,
        )
        (out / VEHICLE_FILE).write_text(vehicle.toml(), "utf-8")
    return folder
