"""The short horizon once more, through FMUs: the oracle of `twin.residuals.short_horizon`.

Replay FMU, airframe FMU and IMU FMU stepped by the master, the airframe restarted from the measured
state at every window through its start values.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from cosim.master import Master
from cosim.system import System, connect
from fmus import build, component_model, replay_model
from twin.effects import acting_late
from twin.logs import Flight
from twin.residuals.aligned import AlignedFlight
from twin.residuals.short_horizon import READ
from twin.residuals.teacher_forced import GRID_S

Array = NDArray[np.float64]


def window_ends_of_fmus(
    flight: Flight, aligned: AlignedFlight, starts: Sequence[int], steps: int, folder: Path
) -> Array:
    """`READ` at the end of windows, shape (w, 13)."""
    ends = np.empty((len(starts), len(READ)))
    with open_fmus(flight, aligned, folder) as master:
        for row, k in enumerate(starts):
            begin_s = float(aligned.inputs.t_s[k])
            master.initialize(begin_s, start_values(aligned, k))
            recording = master.run(begin_s + steps * GRID_S, GRID_S, "settled", every=steps)
            for i, name in enumerate(READ):
                slave = "imu" if name in aligned.imu.output_names else "airframe"
                ends[row, i] = recording[f"{slave}.{name}"][-1]
    return ends


def open_fmus(flight: Flight, aligned: AlignedFlight, folder: Path) -> Master:
    """Replay, airframe and IMU as FMUs behind the master."""
    driven = as_driven(flight, aligned)
    fmus = {
        "replay": build(replay_model(driven, aligned.inputs.columns), folder / "replay.fmu"),
        "airframe": build(component_model(aligned.airframe), folder / "airframe.fmu"),
        "imu": build(component_model(aligned.imu), folder / "imu.fmu"),
    }
    wires = connect("replay", "airframe", aligned.inputs.columns)
    wires += connect("airframe", "imu", aligned.imu.input_names)
    return Master(System(fmus, wires, starts={"airframe.ground.enabled": 0.0}))


def as_driven(flight: Flight, aligned: AlignedFlight) -> Flight:
    """What drives the airframe, as a flight: its own table unless commands are late.

    A row for each change, since samples are held.
    """
    switches = {v.name for v in aligned.airframe.parameters}
    if not any(f"{e.name}.enabled" in switches for e in acting_late()):
        return flight
    inputs, names = aligned.inputs, aligned.airframe.input_names
    u = inputs.u[:, [names.index(c) for c in inputs.columns]]
    kept = np.append(True, np.any(u[1:] != u[:-1], axis=1))
    kept[-1] = True
    table = pd.DataFrame(u[kept], columns=list(inputs.columns))
    table.insert(0, "time", inputs.t_s[kept])
    return Flight(flight.name, table)


def start_values(aligned: AlignedFlight, k: int) -> dict[str, float]:
    """Start values of the airframe FMU for the state at grid point k.

    Some count from where the airframe would start by itself, such as a load from its place at rest:
    by what it starts too far off when given the state itself, the start value is too large.
    """
    body, wanted = aligned.airframe, aligned.states[k]
    names = [f"initial.{s.name}" for s in body.states]
    settable = {v.name for v in body.parameters}
    given = {n: float(x) for n, x in zip(names, wanted, strict=True) if n in settable}
    reached = body.initial(aligned.inputs.u[k], body.parameter_values(given))
    beyond = dict(zip(names, np.asarray(reached, dtype=np.float64).ravel() - wanted, strict=True))
    return {f"airframe.{n}": x - float(beyond[n]) for n, x in given.items()}
