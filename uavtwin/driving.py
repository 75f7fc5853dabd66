"""A flight as inputs of the twin that a log drives, `export corrected-twin --drive`."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from learning.data.channels import phase_codes
from twin.logs import Flight
from twin.residuals.aligned import AlignedFlight
from twin.residuals.channels import in_step
from twin.residuals.measured import Signal
from twin.residuals.teacher_forced import GRID_S, RIGID, SPIN_RATE
from twin.vehicle import Vehicle

Array = NDArray[np.float64]
VOLTAGE = "vbat_v"
"""Column of the battery voltage, V."""
PREFIX = "airframe."
"""Of its inputs in the fused FMU."""


def driving_inputs(
    flight: Flight,
    vehicle: Vehicle,
    aligned: AlignedFlight,
    restarts: NDArray[np.intp],
    compensated: bool = False,
) -> NDArray[Any]:
    """Inputs of a driven twin at the start of each step of `GRID_S`, as FMPy takes them.

    A step that begins with `restart` ends at the given motion, so that of the next row is given.

    Args:
        flight: To replay.
        vehicle: Of the twin; where it knows how old a pose is, that is taken out.
        aligned: The flight on the grid of the twin.
        restarts: Rows, from 1 on, at which the twin is to have the measured motion, shape (k,);
            where that is unknown it goes on by itself.
        compensated: Whether it has a compensator, which is given the phase of the flight.

    Returns:
        A row per grid point: `time` from 0 on, commands or rotor speeds (with their rates of
        change, where the twin asks for them) and voltage as the flight has them,
        `airframe.restart` and `airframe.restart.pos_x` to `airframe.restart.omega_z`; with a
        compensator `compensator.phase`, too.
    """
    t_s = aligned.inputs.t_s
    given = {c: Signal(*flight.signal([c])).held(t_s)[:, 0] for c in aligned.inputs.columns}
    if VOLTAGE not in given and flight.has(VOLTAGE):
        given[VOLTAGE] = Signal(*flight.signal([VOLTAGE])).held(t_s)[:, 0]
    names = aligned.airframe.input_names
    measured = [n for n in names if n.startswith((SPIN_RATE, "rotor_"))]
    given |= {n: aligned.inputs.u[:, names.index(n)] for n in measured}
    ahead = np.vstack([true_motion(vehicle, aligned)[1:], np.full((1, len(RIGID)), np.nan)])
    known = np.isfinite(ahead).all(axis=1)
    given["restart"] = (np.isin(np.arange(len(t_s)) + 1, restarts) & known).astype(np.float64)
    given |= dict(zip((f"restart.{s}" for s in RIGID), np.nan_to_num(ahead).T, strict=True))
    columns = {PREFIX + name: values for name, values in given.items()}
    if compensated:
        columns["compensator.phase"] = phase_codes(aligned.phases).astype(np.float64)
    kinds = [(c, bool if c == f"{PREFIX}restart" else float) for c in columns]
    table = np.zeros(len(t_s), dtype=[("time", float), *kinds])
    table["time"] = GRID_S * np.arange(len(t_s))
    for name, values in columns.items():
        table[name] = values
    return table


def true_motion(vehicle: Vehicle, aligned: AlignedFlight) -> Array:
    """`RIGID` of a flight as the twin has it, known ages taken out; NaN where unknown, (n, 13)."""
    names = [s.name for s in aligned.airframe.states]
    return in_step(aligned, vehicle)[:, [names.index(s) for s in RIGID]]
