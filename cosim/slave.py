"""One FMU instance behind preallocated buffers, and the Jacobian of its outputs.

The FMPy API loads and instantiates; the calls of the inner loop (set, step, get) go to the library
directly, see `calls`.
"""

import contextlib
import ctypes
import os
import tempfile
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from fmpy.fmi2 import FMU2Slave, defaultCallbacks, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi3 import FMU3Slave
from numpy.typing import NDArray

from fmus.archive import unpack
from twin.errors import FmuError

from .calls import (
    FOLLOWING,
    MORE,
    ONE,
    QUARTER,
    TINY,
    Library,
    SharedTrace,
    Step,
    TracedCall,
    Transfer,
)
from .interface import SCALARS, Port, read_interface

Array = NDArray[np.float64]
_OK, _WARNING, _DISCARD, _FATAL, _PENDING = 0, 1, 2, 4, 5  # `fmi2Status`, `fmi3Status`
_LAST_SUCCESSFUL_TIME, _TERMINATED = 2, 3
"""Kinds of `fmi2StatusKind`."""
_LONGEST = 1000
"""Largest number of characters of a message from an FMU."""


class SavedState:
    """A saved state of one slave, in the FMU's memory until `Slave.free`."""

    def __init__(self) -> None:
        self.handle = ctypes.c_void_p()


class Slave:
    """An instantiated co-simulation FMU, FMI 2 or 3.

    After `bind`, `inputs` and `outputs` are float64 arrays in the order of the names given;
    `write_inputs` and `read_outputs` move them to and from the FMU.

    Attributes:
        sets: Calls that set the inputs.
        gets: Calls that get the outputs.
        doing: Call of doStep.
    """

    def __init__(self, name: str, path: Path, trace: SharedTrace | None = None) -> None:
        """Load and instantiate; `trace` records the calls for other processes: `TracedSlave`."""
        self.name, self.path, self._trace = name, path, trace
        self._who = f"{name} ({path.name})"
        self.interface = read_interface(path)
        self._messages: deque[str] = deque(maxlen=20)
        self._folder = tempfile.TemporaryDirectory(prefix="uavtwin-")
        self._fmu = self._instantiate()
        self.library = Library(self._fmu, self.interface.fmi, self._who, trace)
        self._saved: set[SavedState] = set()
        self._fresh, self._running, self._dead = True, False, False
        self.bind([], [], np.zeros(0), np.zeros(0))

    # -- life cycle -----------------------------------------------------------------------

    def _instantiate(self) -> Any:
        description, fmi = self.interface.description, self.interface.fmi
        kind = FMU2Slave if fmi == 2 else FMU3Slave
        fmu, here = None, os.getcwd()
        try:
            unpack(self.path, Path(self._folder.name))
            arguments = {
                "guid": description.guid if fmi == 2 else description.instantiationToken,
                "modelIdentifier": description.coSimulation.modelIdentifier,
                "unzipDirectory": self._folder.name,
                "instanceName": self.name,
            }
            fmu = self._call("loading its library", lambda: kind(**arguments))
            if fmi == 2:
                callbacks = fmi2CallbackFunctions()
                callbacks.logger = fmi2CallbackLoggerTYPE(self._log2)
                callbacks.allocateMemory = defaultCallbacks.allocateMemory
                callbacks.freeMemory = defaultCallbacks.freeMemory
                options = {"callbacks": callbacks, "loggingOn": True}
            else:
                options = {"logMessage": self._log3}
            self._call("instantiate", lambda: fmu.instantiate(**options))
        except Exception as error:  # refused above, or FMPy's bare exceptions
            os.chdir(here)  # FMPy does not return from its folder if a library fails to load
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
        # A printf format, with arguments that ctypes cannot access.
        self._log3(env, status, category, (text or b"").replace(b"%%", b"%"))

    def _log3(self, env: Any, status: int, category: bytes, text: bytes) -> None:
        if status != _OK or category != b"logEvents":  # successful events explain no error
            self._messages.append((text or b"").decode(errors="replace"))

    def initialize(
        self,
        start_time_s: float,
        starts: Mapping[str, float],
        stop_time_s: float | None = None,
    ) -> None:
        """Enter initialisation at a time with start values; `finish_initialization` ends it."""
        self.library.clock.value = start_time_s
        self._fresh = False
        times = {"startTime": start_time_s, "stopTime": stop_time_s}
        enter: Callable[..., Any] = self._fmu.enterInitializationMode
        if self.interface.fmi == 2:
            self._checked("setupExperiment", lambda: self._fmu.setupExperiment(**times))
            times = {}
        self._checked("start values", lambda: self._set(starts))
        self._checked("enterInitializationMode", lambda: enter(**times))

    def finish_initialization(self) -> None:
        """Leave initialisation; afterwards the FMU can step."""
        self._checked("exitInitializationMode", self._fmu.exitInitializationMode)
        self._running = True

    def reset(self) -> None:
        """Return to the instantiated state, with the start values of the FMU.

        An instance that has not been initialised is in that state and is not reset: some FMUs fail
        there (fmi2Reset, fmi3Reset before the first use).

        Raises:
            FmuError: The FMU cannot be reset: a new instance is necessary.
        """
        if self._fresh:
            return
        if self._dead:
            raise self._error("reset", "not allowed after a fatal error.")
        self._checked("reset", self._fmu.reset)
        self._fresh, self._running = True, False

    def close(self) -> None:
        """Free the instance, its saved states, its library and its unpacked files."""
        if self._fmu is None:
            return
        try:
            if self._dead:
                self._fmu.freeLibrary()  # after a fatal error no other call is allowed
                return
            for state in list(self._saved):
                self.free(state)
            if self._running:
                with contextlib.suppress(Exception):  # messages no longer matter
                    self._call("terminate", self._fmu.terminate)
            self._call("freeInstance", self._fmu.freeInstance)
        finally:
            self._fmu = None
            self._folder.cleanup()

    # -- values ---------------------------------------------------------------------------

    @property
    def ports(self) -> dict[str, Port]:
        """All variables by name."""
        return self.interface.ports

    def bind(
        self, inputs: Sequence[str], outputs: Sequence[str], sent: Array, received: Array
    ) -> None:
        """Set the variables to exchange.

        Args:
            inputs: Names of the inputs.
            outputs: Names of the outputs.
            sent: Contiguous array, shape (len(inputs),): becomes `self.inputs`.
            received: Contiguous array, shape (len(outputs),): becomes `self.outputs`.
        """
        self.inputs, self.outputs = sent, received
        self.bound_inputs, self.bound_outputs = tuple(inputs), tuple(outputs)
        ports = [[self.interface.scalar(n) for n in names] for names in (inputs, outputs)]
        self.sets = Transfer(self.library, "Set", ports[0], sent)
        self.gets = Transfer(self.library, "Get", ports[1], received)
        self.doing = Step(self.library)
        self._setters, self._getters = self.sets.calls, self.gets.calls

    def write_inputs(self) -> None:
        """Send `inputs` to the FMU."""
        for set_, buffer, positions in self._setters:
            if positions is not None:
                buffer[:] = self.inputs[positions]
            if status := set_():
                self.judge(status, "set inputs")

    def read_outputs(self) -> None:
        """Fetch `outputs` from the FMU."""
        for get, buffer, positions in self._getters:
            if status := get():
                self.judge(status, "get outputs")
            if positions is not None:
                self.outputs[positions] = buffer

    def begin(
        self, inputs: Sequence[str], outputs: Sequence[str], starts: Mapping[str, float] = {}
    ) -> None:
        """Bind variables, and initialise at time zero from the instantiated state.

        Args:
            inputs: Names of the inputs that `advance` takes.
            outputs: Names of the outputs that it returns.
            starts: Start values, by name.
        """
        self.reset()
        self.bind(inputs, outputs, np.zeros(len(inputs)), np.zeros(len(outputs)))
        self.initialize(0.0, starts)
        self.finish_initialization()

    def advance(self, given: Array, time_s: float, step_s: float) -> Array:
        """One communication step with new inputs; returns a copy of the outputs after it."""
        self.inputs[:] = given
        self.write_inputs()
        self.step(time_s, step_s)
        self.read_outputs()
        return self.outputs.copy()

    def step(self, time_s: float, step_s: float) -> None:
        """One communication step."""
        step = self.doing
        step.time_s.value = time_s
        step.step_s.value = step_s
        if (status := step.call()) or step.flags.value:
            self.judge_step(status)

    def get(self, name: str) -> float:
        """Present value of one scalar of any causality."""
        value = np.zeros(1)
        transfer = Transfer(self.library, "Get", [self.interface.scalar(name)], value)
        for get, buffer, positions in transfer.calls:
            if status := get():
                self.judge(status, f"get {name}")
            if positions is not None:
                value[positions] = buffer
        return float(value[0])

    def _set(self, values: Mapping[str, float]) -> None:
        for name, value in values.items():
            port = self.interface.scalar(name)
            if not port.settable:
                raise FmuError(
                    f"{self.path.name}: {name} is an {port.causality}; only parameters and inputs "
                    f"have start values to set."
                )
            suffix, _ = SCALARS[self.interface.fmi][port.type]
            given = self.interface.value(port, value)
            getattr(self._fmu, f"set{suffix}")([port.reference], [given])

    # -- saved states ---------------------------------------------------------------------

    def save(self, into: SavedState | None = None) -> SavedState:
        """Save the present state of the FMU.

        Args:
            into: State to overwrite; None: a new one.

        Raises:
            FmuError: The FMU does not support it.
        """
        if not self.interface.saves_state:
            raise FmuError(
                f"{self.name} ({self.path.name}): cannot save its state "
                f"(canGetAndSetFMUstate is not true), so no step can be taken back. "
                f"Run with fixed steps."
            )
        state = into or SavedState()
        self._saved.add(state)
        self._state_call("Get", ctypes.byref(state.handle))
        return state

    def restore(self, state: SavedState) -> None:
        """Return to a saved state, which remains saved."""
        self._state_call("Set", state.handle)

    def free(self, state: SavedState) -> None:
        """Free a saved state; a second call has no effect."""
        if state in self._saved:
            self._saved.discard(state)
            self._state_call("Free", ctypes.byref(state.handle))

    def _state_call(self, verb: str, argument: Any) -> None:
        noun = "FMUstate" if self.interface.fmi == 2 else "FMUState"
        if status := self.library.call(verb + noun, argument)():
            self.judge(status, f"{verb.lower()} state")

    # -- failures -------------------------------------------------------------------------

    def _call(self, what: str, call: Callable[[], Any]) -> Any:
        """A call through FMPy."""
        return call() if self._trace is None else self._trace.traced(self._who, what, call)()

    def _said(self, fallback: str) -> str:
        text = "; ".join(self._messages) or fallback
        self._messages.clear()
        printable = "".join(c if c.isprintable() else " " for c in text)
        return " ".join(printable.split())[:_LONGEST]

    def _checked(self, what: str, call: Callable[[], Any]) -> None:
        try:
            self._call(what, call)
        except FmuError:
            raise
        except Exception as error:  # FMPy raises FMICallException and bare exceptions
            raise self._error(what, self._said(str(error))) from error

    def judge(self, status: int, what: str) -> None:
        """Raise unless a status is OK or a warning."""
        if status == _WARNING:
            return
        self._dead = status == _FATAL
        raise self._error(what, self._said("the FMU gave no reason"))

    def judge_step(self, status: int) -> None:
        """Raise unless the last step was completed; its status and flags decide."""
        step = self.doing
        t, h = step.time_s.value, step.step_s.value
        what = f"step at {t:g} s"
        event, terminate, early, _ = bytes(step.flags)
        terminate = terminate or (status == _DISCARD and self._wants_end())
        if status == _PENDING and self.interface.fmi == 2:
            raise self._error(what, "asynchronous steps (fmi2Pending) are not supported.")
        if status == _DISCARD or (status <= _WARNING and (terminate or early)):
            reached_s = self._reached_s()
            end = "asked to end the simulation" if terminate else "gave up"
            raise self._error(
                what,
                f"the FMU {end} at {reached_s:g} s instead of {t + h:g} s: "
                f"{self._said('no reason given')}. Choose a shorter step or an earlier stop time.",
            )
        if status <= _WARNING and event:
            raise self._error(what, "the FMU asks for event mode, which is not supported.")
        self.judge(status, what)

    def _wants_end(self) -> bool:
        """Whether an FMU that discarded a step requests the end of the simulation."""
        if self.interface.fmi == 3:
            return False  # reported by a flag of the step
        ends = ctypes.c_int(0)
        self.library.call("GetBooleanStatus", ctypes.c_int(_TERMINATED), ctypes.byref(ends))()
        return bool(ends.value)

    def _reached_s(self) -> float:
        if self.interface.fmi == 3:
            return self.doing.reached_s.value
        reached = ctypes.c_double(np.nan)
        kind = ctypes.c_int(_LAST_SUCCESSFUL_TIME)
        self.library.call("GetRealStatus", kind, ctypes.byref(reached))()
        return reached.value

    def _error(self, what: str, why: str) -> FmuError:
        return FmuError(f"{self._who}: {what}: {why}")


class TracedSlave(Slave):
    """A slave that traces its calls and checks the floating-point environment after each.

    The calls of the inner loop are written here, at half the cost of `TracedCall`.
    """

    def __init__(self, name: str, path: Path, trace: SharedTrace) -> None:
        """Load and instantiate."""
        self._slot = trace.call
        super().__init__(name, path, trace)

    def bind(
        self, inputs: Sequence[str], outputs: Sequence[str], sent: Array, received: Array
    ) -> None:
        """Set the variables to exchange, as in `Slave.bind`."""
        super().bind(inputs, outputs, sent, received)
        self._moves_in, self._moves_out = _bare(self._setters), _bare(self._getters)
        doing = cast(TracedCall, self.doing.call)
        self._bare_step = doing.number, -doing.number, doing.bare

    def write_inputs(self) -> None:
        """Send `inputs` to the FMU, as in `Slave.write_inputs`.

        Raises:
            FmuError: The FMU failed, or changed the floating-point environment.
        """
        slot, moves = self._slot, self._moves_in
        for number, returned, set_, buffer, positions in moves:
            if positions is not None:
                buffer[:] = self.inputs[positions]
            slot.value = number
            if status := set_():
                slot.value = returned
                self.judge(status, "set inputs")
        if moves:
            slot.value = returned  # of the last call
            if ONE + QUARTER + MORE != FOLLOWING or not TINY + TINY:
                raise cast(TracedCall, self._setters[-1][0]).spoilt()

    def read_outputs(self) -> None:
        """Fetch `outputs` from the FMU, as in `Slave.read_outputs`.

        Raises:
            FmuError: The FMU failed, or changed the floating-point environment.
        """
        slot, moves = self._slot, self._moves_out
        for number, returned, get, buffer, positions in moves:
            slot.value = number
            if status := get():
                slot.value = returned
                self.judge(status, "get outputs")
            if positions is not None:
                self.outputs[positions] = buffer
        if moves:
            slot.value = returned  # of the last call
            if ONE + QUARTER + MORE != FOLLOWING or not TINY + TINY:
                raise cast(TracedCall, self._getters[-1][0]).spoilt()

    def step(self, time_s: float, step_s: float) -> None:
        """One communication step, as in `Slave.step`.

        Raises:
            FmuError: The FMU failed, or changed the floating-point environment.
        """
        step, slot = self.doing, self._slot
        number, returned, call = self._bare_step
        step.time_s.value = time_s
        step.step_s.value = step_s
        slot.value = number
        status = call()
        slot.value = returned
        if ONE + QUARTER + MORE != FOLLOWING or not TINY + TINY:
            raise cast(TracedCall, step.call).spoilt()
        if status or step.flags.value:
            self.judge_step(status)


def _bare(moves: Sequence[Any]) -> list[tuple[int, int, Any, NDArray[Any], NDArray[Any] | None]]:
    """Trace numbers before and after, and the bare call, of transfers."""
    return [
        (call.number, -call.number, call.bare, buffer, positions)
        for call, buffer, positions in moves
    ]


_ROOT_EPS = float(np.sqrt(np.finfo(np.float64).eps))  # relative step of forward differences


def jacobian(slave: Slave, outputs: Sequence[str], inputs: Sequence[str]) -> Callable[[], Array]:
    """Derivatives of bound outputs with respect to bound inputs, at the present inputs.

    The FMU's directional derivatives, or forward differences by set and get where it has none. The
    derivative of a variable that is not real is 0.

    Returns:
        A function without arguments that returns the matrix, shape (outputs, inputs).
    """
    rows = [i for i, n in enumerate(outputs) if slave.ports[n].kind == "Real"]
    columns = [i for i, n in enumerate(inputs) if slave.ports[n].kind == "Real"]
    made = _tangents if slave.interface.has_derivatives else _differences
    inner = made(slave, [outputs[i] for i in rows], [inputs[i] for i in columns])
    matrix = np.zeros((len(outputs), len(inputs)))
    at = np.ix_(rows, columns)

    def evaluate() -> Array:
        """Fill the matrix."""
        matrix[at] = inner()
        return matrix

    return evaluate


def _tangents(slave: Slave, outputs: Sequence[str], inputs: Sequence[str]) -> Callable[[], Array]:
    columns = np.zeros((len(inputs), len(outputs)))
    ports = [slave.ports[n] for n in outputs]
    calls = [
        slave.library.tangent(ports, slave.ports[name], column)
        for name, column in zip(inputs, columns, strict=True)
    ]

    def evaluate() -> Array:
        """Directional derivatives: one call per input."""
        for call in calls:
            if status := call():
                slave.judge(status, "directional derivative")
        return columns.T

    return evaluate


def _differences(
    slave: Slave, outputs: Sequence[str], inputs: Sequence[str]
) -> Callable[[], Array]:
    rows = [slave.bound_outputs.index(n) for n in outputs]
    columns = [slave.bound_inputs.index(n) for n in inputs]
    nominal = [slave.ports[n].nominal for n in inputs]

    def evaluate() -> Array:
        """Forward differences: one set and get per input; all values are restored afterwards."""
        u, y = slave.inputs.copy(), slave.outputs.copy()
        matrix = np.zeros((len(rows), len(columns)))
        for k, j in enumerate(columns):
            slave.inputs[j] = u[j] + _ROOT_EPS * max(abs(u[j]), nominal[k])
            slave.write_inputs()
            slave.read_outputs()
            matrix[:, k] = (slave.outputs[rows] - y[rows]) / (slave.inputs[j] - u[j])
            slave.inputs[j] = u[j]
        slave.write_inputs()
        slave.outputs[:] = y
        return matrix

    return evaluate
