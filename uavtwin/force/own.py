"""A user's own force law, a torch module or an ONNX file, stored as the folder of a law."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from learning.data.envelope import BEYOND
from learning.force.model import VEHICLE_FILE, ForceModel, save_force
from learning.force.module import law_function, module_onnx
from learning.force.windows import FlightWindows
from twin.component.rows import OverRows
from twin.logs import Flight

from ..flights import check_names
from ..output import results_folder
from ..vehicles import Vehicle
from .learn import origin, taught_by

if TYPE_CHECKING:
    from torch import nn


def windows_of(flights: Sequence[Flight], vehicle: Vehicle) -> list[FlightWindows]:
    """Training data for a module: `places` are its inputs, `left` the force and moment missing in
    the equations.

    Raises:
        TwinError: A flight lacks the motion, is too short, or has a different drive from the
            others.
    """
    return list(taught_by(flights, vehicle).flights)


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
    taught = taught_by(flights, vehicle)
    said = OverRows(function, 1)(np.vstack([w.places for w in taught.flights]))
    law = replace(taught.empty, most=BEYOND * np.abs(said).max(axis=0), module=function)
    with results_folder(folder, force) as out:
        save_force(ForceModel(law=law, onnx=content, **origin(flights, vehicle, 0)), out)
        (out / VEHICLE_FILE).write_text(vehicle.toml(), "utf-8")
    return folder
