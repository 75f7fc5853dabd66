"""A flight as inputs of the twin that a log drives, `export corrected-twin --drive`."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.residuals.aligned import AlignedFlight
from twin.residuals.teacher_forced import GRID_S, RIGID

PREFIX = "airframe."
"""Of its inputs in the fused FMU."""


def driving_inputs(aligned: AlignedFlight, restarts: NDArray[np.intp]) -> NDArray[Any]:
    """Inputs of a driven twin at the start of each step of `GRID_S`, as FMPy takes them.

    A step that begins with `restart` ends at the given motion, so that of the next row is given.

    Args:
        aligned: The flight on the grid of its twin.
        restarts: Rows, from 1 on, at which the twin is to have the measured motion, shape (k,);
            it is known there.

    Returns:
        A row per grid point: `time` from 0 on, commands or rotor speeds and voltage as the flight
        has them, `airframe.restart` and `airframe.restart.pos_x` to `airframe.restart.omega_z`.
    """
    body, n = aligned.airframe, len(aligned.states)
    columns = {c: aligned.inputs.u[:, body.input_names.index(c)] for c in aligned.inputs.columns}
    columns["restart"] = np.isin(np.arange(n) + 1, restarts).astype(np.float64)
    ahead = np.nan_to_num(aligned.states[1:])
    for name, values in zip((s.name for s in body.states), ahead.T, strict=True):
        if name in RIGID:
            columns[f"restart.{name}"] = np.append(values, values[-1])
    kinds = [(PREFIX + c, bool if c == "restart" else float) for c in columns]
    table = np.zeros(n, dtype=[("time", float), *kinds])
    table["time"] = GRID_S * np.arange(n)
    for name, values in columns.items():
        table[PREFIX + name] = values
    return table
