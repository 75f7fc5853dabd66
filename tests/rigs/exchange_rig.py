"""An FMU for model exchange driven by hand, whatever its FMI version, and by FMPy's solver."""

import ctypes
from collections.abc import Mapping
from pathlib import Path

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Model
from fmpy.fmi3 import FMU3Model
from instance import Instance
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Exchanged(Instance):
    """An instance whose states somebody else integrates."""

    model_types = (FMU2Model, FMU3Model)

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        description = fmpy.read_model_description(str(folder))
        self.n_states = description.numberOfContinuousStates
        self.moved = False
        self.n_indicators = description.numberOfEventIndicators

    def states(self) -> Array:
        return self._vector(self.fmu.getContinuousStates, self.n_states)

    def set_states(self, x: Array) -> None:
        buffer = (ctypes.c_double * len(x))(*x)
        self.fmu.setContinuousStates(buffer, len(x))

    def rates(self) -> Array:
        name = "getDerivatives" if self.fmi == 2 else "getContinuousStateDerivatives"
        return self._vector(getattr(self.fmu, name), self.n_states)

    def nominals(self) -> Array:
        return self._vector(self.fmu.getNominalsOfContinuousStates, self.n_states)

    def indicators(self) -> Array:
        return self._vector(self.fmu.getEventIndicators, self.n_indicators)

    def update(self) -> float:
        """An event iteration: when the next event is, inf: never. `moved`: whether states have."""
        fmu = self.fmu
        again, end, nominals, moved, planned, next_s = (
            fmu.newDiscreteStates() if self.fmi == 2 else fmu.updateDiscreteStates()
        )
        assert not (again or end or nominals)
        self.moved = bool(moved)
        return float(next_s) if planned else np.inf

    def _vector(self, get: object, n: int) -> Array:
        buffer = (ctypes.c_double * n)()
        assert callable(get)
        get(buffer, n)
        return np.array(buffer)


def solved(
    path: Path,
    stop_s: float,
    outputs: list[str],
    commands: NDArray[np.void],
    starts: Mapping[str, float],
    tolerance: float,
) -> Array:
    """By FMPy's CVode, a row each 10 ms, shape (n, outputs)."""
    result = fmpy.simulate_fmu(
        str(path),
        fmi_type="ModelExchange",
        stop_time=stop_s,
        output_interval=0.01,
        relative_tolerance=tolerance,
        input=commands,
        output=outputs,
        start_values=dict(starts),
        record_events=False,
    )
    return np.column_stack([np.asarray(result[n], dtype=np.float64).ravel() for n in outputs])
