"""One FMU instance behind preallocated buffers.

The FMPy API loads and instantiates; the three calls of the inner loop (set, step, get) go to the
library directly, with pointers made once: 1 us instead of 8 us a call.
"""

import ctypes
import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi2 import (
    FMU2Slave,
    defaultCallbacks,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)
from fmpy.fmi3 import FMU3Slave
from fmpy.model_description import ModelDescription, ScalarVariable
from numpy.typing import NDArray

from fmus.archive import open_archive, unpack
from twin.errors import FmuError

_TYPES: dict[int, dict[str, tuple[str, type[np.generic]]]] = {
    2: {
        "Real": ("Real", np.float64),
        "Integer": ("Integer", np.int32),
        "Enumeration": ("Integer", np.int32),
        "Boolean": ("Boolean", np.int32),
    },
    3: {
        "Float64": ("Float64", np.float64),
        "Float32": ("Float32", np.float32),
        "Int32": ("Int32", np.int32),
        "Int64": ("Int64", np.int64),
        "Enumeration": ("Int64", np.int64),
        "Boolean": ("Boolean", np.bool_),
    },
}
"""FMI type -> name in the get and set functions, NumPy type of its buffer."""


@dataclass(frozen=True, slots=True)
class Port:
    """A variable of an FMU as the master sees it."""

    name: str
    unit: str | None
    type: str
    reference: int
    causality: str


class Slave:
    """An instantiated co-simulation FMU, FMI 2 or 3.

    After `bind`, `inputs` and `outputs` are float64 arrays in the order of the names given;
    `write_inputs` and `read_outputs` move them to and from the FMU.
    """

    inputs: NDArray[np.float64]
    outputs: NDArray[np.float64]
    _step: Callable[[], int]

    def __init__(self, name: str, path: Path) -> None:
        self.name, self.path = name, path
        self.description = _describe(path)
        self.ports = {
            v.name: Port(v.name, v.unit, v.type, v.valueReference, v.causality)
            for v in self.description.modelVariables
        }
        self._fmi = 2 if self.description.fmiVersion.startswith("2") else 3
        self._messages: list[str] = []
        self._folder = tempfile.TemporaryDirectory(prefix="uavtwin-")
        self._fmu = self._instantiate()

    # -- life cycle -----------------------------------------------------------------------

    def _instantiate(self) -> Any:
        kind = FMU2Slave if self._fmi == 2 else FMU3Slave
        fmu, here = None, os.getcwd()
        try:
            unpack(self.path, Path(self._folder.name))
            fmu = kind(
                guid=self.description.guid
                if self._fmi == 2
                else self.description.instantiationToken,
                modelIdentifier=self.description.coSimulation.modelIdentifier,
                unzipDirectory=self._folder.name,
                instanceName=self.name,
            )
            if self._fmi == 2:
                callbacks = fmi2CallbackFunctions()
                callbacks.logger = fmi2CallbackLoggerTYPE(self._log2)
                callbacks.allocateMemory = defaultCallbacks.allocateMemory
                callbacks.freeMemory = defaultCallbacks.freeMemory
                fmu.instantiate(callbacks=callbacks)
            else:
                fmu.instantiate(logMessage=self._log3)
        except Exception as error:  # refused by us, or FMPy's bare exceptions
            os.chdir(here)  # where a library does not load, FMPy stays in its folder
            if fmu is not None:
                fmu.freeLibrary()
            self._folder.cleanup()
            if isinstance(error, FmuError):
                raise
            raise FmuError(
                f"{self.path.name}: cannot be loaded: {self._said(str(error))}"
            ) from error
        return fmu

    def _log2(self, env: Any, instance: bytes, status: int, category: bytes, text: bytes) -> None:
        # A printf format, whose arguments ctypes cannot see.
        self._messages.append(text.decode(errors="replace").replace("%%", "%"))

    def _log3(self, env: Any, status: int, category: bytes, text: bytes) -> None:
        self._messages.append(text.decode(errors="replace"))

    def _said(self, fallback: str) -> str:
        text = "; ".join(self._messages) or fallback
        self._messages.clear()
        return text

    def initialize(self, start_time_s: float, starts: Mapping[str, float]) -> None:
        """Enter initialisation at a time with start values; `finish_initialization` ends it."""
        if self._fmi == 2:
            self._checked(
                "setupExperiment", lambda: self._fmu.setupExperiment(startTime=start_time_s)
            )
            self._checked("start values", lambda: self._set(starts))
            self._checked("enterInitializationMode", self._fmu.enterInitializationMode)
        else:
            self._checked("start values", lambda: self._set(starts))
            self._checked(
                "enterInitializationMode",
                lambda: self._fmu.enterInitializationMode(startTime=start_time_s),
            )

    def finish_initialization(self) -> None:
        """Leave initialisation; from here on the FMU steps."""
        self._checked("exitInitializationMode", self._fmu.exitInitializationMode)

    def reset(self) -> None:
        """Back to the instantiated state, start values of the FMU."""
        self._checked("reset", self._fmu.reset)

    def close(self) -> None:
        """Free the instance, its library and its unpacked files."""
        if self._fmu is not None:
            self._fmu.freeInstance()
            self._fmu = None
            self._folder.cleanup()

    # -- values ---------------------------------------------------------------------------

    def port(self, name: str) -> Port:
        """The variable of that name.

        Raises:
            FmuError: There is none; the text names the nearest.
        """
        if name not in self.ports:
            near = get_close_matches(name, self.ports, n=1, cutoff=0.5)
            hint = f" Did you mean {near[0]!r}?" if near else ""
            raise FmuError(f"{self.path.name}: there is no variable {name!r}.{hint}")
        return self.ports[name]

    def output_names(self) -> list[str]:
        """Names of all outputs, in the order of the FMU's interface."""
        return [p.name for p in self.ports.values() if p.causality == "output"]

    def write_inputs(self) -> None:
        """Send `inputs` to the FMU."""
        for set_, buffer, positions in self._setters:
            if positions is not None:
                buffer[:] = self.inputs[positions]
            if set_() != 0:
                self._fail("set inputs")

    def read_outputs(self) -> None:
        """Fetch `outputs` from the FMU."""
        for get, buffer, positions in self._getters:
            if get() != 0:
                self._fail("get outputs")
            if positions is not None:
                self.outputs[positions] = buffer

    def step(self, time_s: float, step_s: float) -> None:
        """One communication step."""
        self._t.value, self._h.value = time_s, step_s
        if self._step() != 0:
            self._fail(f"step at {time_s:g} s")

    def get(self, name: str) -> float:
        """Present value of one variable of any causality."""
        port = self.port(name)
        values = getattr(self._fmu, f"get{self._type(port)[0]}")([port.reference])
        return float(values[0])

    def _set(self, values: Mapping[str, float]) -> None:
        for name, value in values.items():
            port = self.port(name)
            if port.causality not in ("parameter", "input"):
                raise FmuError(
                    f"{self.path.name}: {name} is an {port.causality}; only parameters and inputs "
                    f"have start values to set."
                )
            suffix, dtype = self._type(port)
            cast = float if np.issubdtype(dtype, np.floating) else int
            getattr(self._fmu, f"set{suffix}")([port.reference], [cast(value)])

    def _type(self, port: Port) -> tuple[str, type[np.generic]]:
        """Name in the get and set functions, and NumPy type of the buffer."""
        if port.type not in _TYPES[self._fmi]:
            raise FmuError(
                f"{self.path.name}: {port.name} has type {port.type}, which is not supported here."
            )
        return _TYPES[self._fmi][port.type]

    # -- buffers --------------------------------------------------------------------------

    def bind(
        self, inputs: Sequence[str], outputs: Sequence[str], buffer: NDArray[np.float64]
    ) -> None:
        """Choose the variables to move and where the outputs go.

        Args:
            inputs: Names; `self.inputs` gets this order.
            outputs: Names.
            buffer: Contiguous float64 of shape (len(outputs),): becomes `self.outputs`.
        """
        self.inputs, self.outputs = np.zeros(len(inputs)), buffer
        self._keep: list[Any] = []
        self._setters = self._moves("Set", inputs, self.inputs)
        self._getters = self._moves("Get", outputs, self.outputs)
        self._t, self._h = ctypes.c_double(), ctypes.c_double()
        flags = np.zeros(4)  # FMI 3 tells four things after a step, none of which is used here
        self._keep.append(flags)
        tail = (
            [ctypes.c_int(1)]
            if self._fmi == 2
            else [
                ctypes.c_bool(True),
                *(ctypes.c_void_p(flags.ctypes.data + 8 * i) for i in range(4)),
            ]
        )
        self._step = self._call("DoStep", self._t, self._h, *tail)

    def _moves(
        self, verb: str, names: Sequence[str], values: NDArray[np.float64]
    ) -> list[tuple[Callable[[], int], NDArray[Any], NDArray[np.intp] | None]]:
        """One raw call per FMI type: the call, its buffer, its positions in `values`."""
        groups: dict[str, list[int]] = {}
        for position, name in enumerate(names):
            groups.setdefault(self.port(name).type, []).append(position)
        moves = []
        for positions in groups.values():
            suffix, dtype = self._type(self.port(names[positions[0]]))
            whole = dtype is np.float64 and len(positions) == len(names)
            buffer = values if whole else np.zeros(len(positions), dtype=dtype)
            references = np.array([self.ports[names[i]].reference for i in positions], np.uint32)
            self._keep += [buffer, references]
            count = ctypes.c_size_t(len(positions))
            pointers = [ctypes.c_void_p(a.ctypes.data) for a in (references, buffer)]
            more = [] if self._fmi == 2 else [count]
            call = self._call(verb + suffix, pointers[0], count, pointers[1], *more)
            moves.append((call, buffer, None if whole else np.array(positions)))
        return moves

    def _call(self, function: str, *arguments: Any) -> Callable[[], int]:
        """A function of the library with its arguments made once.

        Indexing the library gives a pointer without the argument types that FMPy has set on its
        own, so ctypes converts nothing.
        """
        pointer = self._fmu.dll[f"fmi{self._fmi}{function}"]
        return partial(pointer, ctypes.c_void_p(self._fmu.component), *arguments)

    # -- failures -------------------------------------------------------------------------

    def _checked(self, what: str, call: Any) -> None:
        try:
            call()
        except FmuError:
            raise
        except Exception as error:  # FMPy raises FMICallException and bare exceptions
            raise FmuError(
                f"{self.name} ({self.path.name}): {what}: {self._said(str(error))}"
            ) from error

    def _fail(self, what: str) -> None:
        raise FmuError(
            f"{self.name} ({self.path.name}): {what}: {self._said('the FMU gave no reason')}"
        )


def _describe(path: Path) -> ModelDescription:
    open_archive(path)  # refuses what is not safe to parse
    try:
        description = fmpy.read_model_description(path)
    except Exception as error:  # FMPy and lxml raise many kinds
        raise FmuError(f"{path.name}: not a readable FMU: {error}") from error
    if description.coSimulation is None:
        raise FmuError(f"{path.name}: not a co-simulation FMU; the master needs one.")
    return description


def dependencies(description: ModelDescription) -> dict[str, set[str]]:
    """Inputs on which each output directly depends; all inputs where the FMU does not say."""
    inputs = {v.name for v in description.modelVariables if v.causality == "input"}
    result: dict[str, set[str]] = {}
    for unknown in description.outputs:
        variable: ScalarVariable = unknown.variable
        known = unknown.dependencies
        result[variable.name] = (
            inputs if known is None else {k.name for k in known if k.name in inputs}
        )
    return result
