"""The airframe as a pythonfmu slave: the same equations, evaluated by Python.

Only the benchmark uses it, as the yardstick of the native FMU. The FMU needs a Python host with
this project installed.
"""

from typing import Any

import numpy as np
from pythonfmu import Fmi2Causality, Fmi2Slave, Real

from twin.airframe import airframe
from twin.vehicle_file import load_vehicle


class AirframeSlave(Fmi2Slave):  # type: ignore[misc]
    """Airframe of the default vehicle, commands in, pose out."""

    description = "Airframe evaluated in Python; needs a Python host with uavtwin installed"

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._component = airframe(load_vehicle("copter_default"))
        self._u = self._component.input_values()
        self._p = self._component.parameter_values()
        self._x = np.asarray(self._component.initial(self._u, self._p), dtype=np.float64).ravel()
        self._evaluate()
        for i, variable in enumerate(self._component.inputs):
            self._register(variable.name, Fmi2Causality.input, "_u", i)
        for i, variable in enumerate(self._component.output_variables):
            self._register(variable.name, Fmi2Causality.output, "_y", i)

    def _register(self, name: str, causality: Fmi2Causality, array: str, i: int) -> None:
        def get() -> float:
            return float(getattr(self, array)[i])

        def put(value: float) -> None:
            getattr(self, array)[i] = value

        self.register_variable(Real(name, causality=causality, getter=get, setter=put))

    def _evaluate(self) -> None:
        y = self._component.outputs(self._x, self._u, self._p)
        self._y = np.asarray(y, dtype=np.float64).ravel()

    def do_step(self, current_time: float, step_size: float) -> bool:
        """One communication step."""
        self._x = self._component.advance(self._x, self._u, self._p, step_size)
        self._evaluate()
        return True
