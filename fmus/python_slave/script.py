"""Python-slave FMU: a component behind the calls of pythonfmu.

`python_slave` copies this file into the FMU, next to copies of the necessary `twin` and `pythonfmu`
modules, all under names of that FMU. Values, checks and modes are those of `c/core.c`.
"""

import contextlib
import ctypes
import json
import sys
from collections.abc import Callable
from functools import cache, wraps
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from pythonfmu.fmi2slave import Fmi2Slave

from twin.component import Component, DelayLine, Run, Sampling, State, Variable, check_range
from twin.errors import ModelError

Array = NDArray[np.float64]

COMPONENT = "component.json"  # resource of the FMU
_VERSION = __name__.encode()
"""Prefix of each saved state: inside an FMU this name is derived from its content."""
_INSTANTIATED, _INITIALIZING, _STEPPING, _TERMINATED, _FAILED = range(5)
"""Modes of a slave, FMI 2, 4.2.4."""
_WHERE = (
    *("before initialization", "in initialization mode", "in step mode"),
    *("after terminate; reset the FMU first", "after an error in a step; reset the FMU first"),
)
"""Text on a mode in errors."""


def read_component(text: str) -> Component:
    """The component written by `python_slave.component_text`.

    Raises:
        ModelError: This CasADi cannot read the file of another version.
    """
    fields = json.loads(text, object_hook=_function)
    if sampling := fields["sampling"]:
        lines = tuple(DelayLine(**line) for line in sampling["lines"])
        fields["sampling"] = Sampling(**sampling | {"lines": lines})
    for table in ("parameters", "inputs", "output_variables"):
        fields[table] = tuple(Variable.from_row(row) for row in fields[table])
    fields["states"] = tuple(State(**row) for row in fields["states"])
    return Component(**fields)


def _function(fields: dict[str, Any]) -> Any:
    if "casadi" not in fields:
        return fields
    try:
        return ca.Function.deserialize(fields["function"])
    except Exception as error:  # CasADi raises bare ones
        raise ModelError(
            f"casadi {ca.CasadiMeta.version()} cannot read the equations: install casadi "
            f"{fields['casadi']}, which wrote them."
        ) from error


@cache
def _component() -> Component:
    """Component, read once, for the first instance: later the folder of this file may be
    deleted."""
    return read_component(Path(__file__).with_name(COMPONENT).read_text())


class ComponentSlave(Fmi2Slave):  # type: ignore[misc]
    """One instance of the FMU."""

    run_type = Run
    """Class of its simulation run."""

    @property
    def may_lack(self) -> frozenset[str]:
        """Variables that may be NaN: none."""
        return frozenset()

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        with contextlib.suppress(ValueError):  # no longer needed, and invalid once it is deleted
            sys.path.remove(self.resources)
        self._component = c = self.described()
        self.vars = dict(enumerate(c.variables, start=1))
        self._v = np.array([v.start for v in c.variables], dtype=np.float64)
        self._first_output = len(c.parameters) + len(c.inputs)
        self._p = self._v[: len(c.parameters)]
        self._u = self._v[len(c.parameters) : self._first_output]
        self._y = self._v[self._first_output :]
        self._mode, self._time_s, self._start_s, self._stop_s = _INSTANTIATED, 0.0, 0.0, np.inf
        self._run: Run | None = None
        self._stale = True

    @staticmethod
    def described() -> Component:
        """Component of this FMU."""
        return _component()

    # -- life cycle -----------------------------------------------------------------------

    def setup_experiment(
        self, start_time: float, stop_time: float | None, tolerance: float | None
    ) -> None:
        """Store start time and stop time."""
        self._expect("start and stop time", "set", _INSTANTIATED)
        if not np.isfinite(start_time):
            self._refuse(f"start time {start_time:g} is not finite")
        stop_s = np.inf if stop_time is None else stop_time
        if not stop_s >= start_time:
            self._refuse(f"stop time {stop_s:g} s is before the start time {start_time:g} s")
        self._start_s, self._stop_s = start_time, stop_s

    def enter_initialization_mode(self) -> None:
        """Initialise at the start time."""
        self._expect("initialization", "entered", _INSTANTIATED)
        self._mode, self._time_s, self._stale = _INITIALIZING, self._start_s, True

    def exit_initialization_mode(self) -> None:
        """Compute the states at the start."""
        self._expect("initialization", "ended", _INITIALIZING)
        self._run = self._begin()
        self._check_finite("state", self._component.states, self._run.x)
        self._mode, self._stale = _STEPPING, True

    def do_step(self, current_time: float, step_size: float) -> bool:
        """One communication step."""
        self._expect("a step", "made", _STEPPING)
        if not 0 < step_size < np.inf:
            self._refuse(f"communication step size {step_size:g} s must be positive")
        if not abs(current_time - self._time_s) <= 1e-3 * step_size:
            self._refuse(f"doStep at {current_time:.9g} s, but the FMU is at {self._time_s:.9g} s")
        if (end_s := current_time + step_size) > self._stop_s + 1e-3 * step_size:
            self._refuse(f"doStep to {end_s:.9g} s, beyond the stop time {self._stop_s:.9g} s")
        assert self._run is not None
        self._mode = _FAILED
        self._run.step(current_time, step_size, self._u)
        self._time_s, self._stale = end_s, True
        self._check_finite("state", self._component.states, self._run.x)
        self._mode = _STEPPING
        return True

    def terminate(self) -> None:
        """Terminate; outputs can still be read."""
        self._expect("the simulation", "terminated", _STEPPING)
        self._mode = _TERMINATED

    # -- values ---------------------------------------------------------------------------

    def get_real(self, vrs: list[int]) -> list[float]:
        """Values by value reference; outputs from present inputs and parameters."""
        return self._get(vrs, "real")

    def get_integer(self, vrs: list[int]) -> list[int]:
        """Integers and codes of enumerations by value reference."""
        return [int(value) for value in self._get(vrs, "integer", "enumeration")]

    def get_boolean(self, vrs: list[int]) -> list[bool]:
        """Booleans by value reference."""
        return [value != 0 for value in self._get(vrs, "boolean")]

    def _get(self, vrs: list[int], *kinds: str) -> list[float]:
        for vr in vrs:
            name = self._variable(vr, kinds).name
            self._expect(name, "read", *range(_INITIALIZING, len(_WHERE)))
        if self._stale and any(vr > self._first_output for vr in vrs):
            self._put_out()
        return [float(self._v[vr - 1]) for vr in vrs]

    def set_real(self, vrs: list[int], values: list[float]) -> None:
        """Set parameters and inputs by value reference."""
        self._set(vrs, values, "real")

    def set_integer(self, vrs: list[int], values: list[int]) -> None:
        """Set integers and codes of enumerations by value reference."""
        self._set(vrs, [float(value) for value in values], "integer", "enumeration")

    def set_boolean(self, vrs: list[int], values: list[bool]) -> None:
        """Set Booleans by value reference."""
        self._set(vrs, [float(value) for value in values], "boolean")

    def _set(self, vrs: list[int], values: list[float], *kinds: str) -> None:
        for vr, value in zip(vrs, values, strict=True):
            variable = self._variable(vr, kinds)
            self._expect(variable.name, "set", _INSTANTIATED, _INITIALIZING, _STEPPING)
            if variable.causality == "output":
                self._refuse(f"{variable.name} is an output and cannot be set")
            if variable.fixed and self._mode >= _STEPPING:
                self._refuse(
                    f"{variable.name} is fixed once initialization has ended; reset the FMU first"
                )
            if not (variable.name in self.may_lack and np.isnan(value)):
                check_range(self._component.name, variable, value)
            self._v[vr - 1] = value
        self._stale = True

    def _variable(self, vr: int, kinds: tuple[str, ...]) -> Variable:
        if vr not in self.vars:
            self._refuse(f"no variable has value reference {vr}")
        variable: Variable = self.vars[vr]
        if variable.kind_name not in kinds:
            self._refuse(
                f"{variable.name} is of kind {variable.kind_name}, not {' or '.join(kinds)}"
            )
        return variable

    def _begin(self) -> Run:
        return self.run_type(self._component, self._u, self._p, self._start_s)

    def _put_out(self) -> None:
        run = self._run if self._mode >= _STEPPING else self._begin()
        assert run is not None
        self._y[:] = run.outputs(self._u)
        self._check_finite("output", self._component.output_variables, self._y)
        self._stale = False

    # -- saved states ---------------------------------------------------------------------

    def _get_fmu_state(self) -> bytes:
        size = self.run_type.saved_size(self._component)
        run = np.zeros(size) if self._run is None else self._run.saved()
        head = [self._mode, self._time_s, self._start_s, self._stop_s]
        return _VERSION + np.concatenate([head, self._p, self._u, run]).tobytes()

    def _set_fmu_state(self, state: bytes) -> None:
        expected = len(self._get_fmu_state())
        if len(state) != expected:
            self._refuse(f"saved state has {len(state)} bytes, expected {expected}")
        if not state.startswith(_VERSION):
            self._refuse("saved state belongs to another FMU or another version of this one")
        values = np.frombuffer(state, offset=len(_VERSION)).copy()
        (mode, *times), v, run = np.split(values, [4, 4 + self._first_output])
        self._mode, (self._time_s, self._start_s, self._stop_s) = int(mode), map(float, times)
        self._v[: self._first_output] = v
        self._run = self.run_type.restored(self._component, self._p, run)
        self._stale = True

    @staticmethod
    def _fmu_state_to_bytes(state: bytes) -> bytes:
        return state

    @staticmethod
    def _fmu_state_from_bytes(state: bytes) -> bytes:
        return state

    # -- failures -------------------------------------------------------------------------

    def _refuse(self, why: str) -> None:
        raise ModelError(f"{self._component.name}: {why}")

    def _expect(self, what: str, done: str, *modes: int) -> None:
        if self._mode not in modes:
            self._refuse(f"{what} cannot be {done} {_WHERE[self._mode]}")

    def _check_finite(self, kind: str, table: tuple[Any, ...], values: Array) -> None:
        wrong = ~np.isfinite(values)
        if wrong.any():
            allowed = [v.name in self.may_lack for v in table]
            wrong &= ~(np.isnan(values) & allowed)
        if wrong.any():
            i = int(np.flatnonzero(wrong)[0])
            self._refuse(
                f"{kind} {table[i].name} = {values[i]} at time {self._time_s:g} s: "
                f"the simulation has diverged"
            )


def _outliving_failures(method: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator: on failure of a call, keep references that pythonfmu releases and will release
    again with the instance."""

    @wraps(method)
    def call(slave: ComponentSlave, *arguments: Any) -> Any:
        """Call of the method that keeps references on failure."""
        try:
            return method(slave, *arguments)
        except Exception:
            for owned in (slave, slave.log_queue, type(slave)):
                keep(owned)
            raise

    return call


def keep(owned: object) -> None:
    """Add a reference that Python never releases."""
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(owned))


for _called in (
    "setup_experiment",
    "enter_initialization_mode",
    "exit_initialization_mode",
    "do_step",
    "terminate",
    *(f"{v}_{kind}" for v in ("get", "set") for kind in ("real", "integer", "boolean", "string")),
    "_get_fmu_state",
    "_set_fmu_state",
):
    setattr(ComponentSlave, _called, _outliving_failures(getattr(ComponentSlave, _called)))
