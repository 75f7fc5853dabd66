"""A force law of somebody's own: a torch module, or an ONNX file, as the folder of a law."""

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
    """What a module may be taught by: `places` are its inputs, `left` what the equations lack.

    Raises:
        TwinError: A flight lacks the motion, is too short, or has another drive than the others.
    """
    return list(_taught(flights, vehicle).flights)


def _taught(flights: Sequence[Flight], vehicle: Vehicle) -> Taught:
    """What flights teach."""
    equations = Equations(vehicle, components_of(vehicle, drive_of(flights, vehicle))[0])
    return Taught.by([FlightWindows.of(f, vehicle, equations) for f in flights], equations)


def own_force(
    module: "nn.Module | bytes",
    flights: Sequence[Flight],
    vehicle: Vehicle,
    folder: Path,
    force: bool = False,
) -> Path:
    """Write a module as the folder of a law, which `evaluate` and `export corrected-twin` take.

    The flights that taught it give its envelope, beyond which it fades, and its bounds: twice as
    much as it says in them. Nothing else is judged: `evaluate` says what it is worth on others.

    Args:
        module: Of torch, as `learning.force.module` takes it; or an ONNX file's bytes.
        flights: That taught it.
        vehicle: Whose equations lack it.
        folder: To write.
        force: Whether the folder may hold other files already.

    Returns:
        The folder.

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
