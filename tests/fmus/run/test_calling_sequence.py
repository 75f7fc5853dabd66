"""Every call in every state of FMI 2.0.5 (sec. 3.2.3, 4.2.4) and FMI 3.0 (sec. 2.3, 3.2, 4.2), and
calls with wrong arguments: what is not allowed returns an error, says why and changes nothing.

The tables name functions without `fmi2` and `fmi3`; a small FMU that has co-simulation and model
exchange stands for all, since what they share is this part of their C code (`fmus/c`).
"""

import ctypes
import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import casadi as ca
import pytest
from fmpy.fmi2 import FMU2Model, FMU2Slave
from fmpy.fmi3 import FMU3Model, FMU3Slave
from instance import Instance, unzip

from fmus import build, component_model, fuse
from twin.component import Component, ComponentBuilder

OK, DISCARD, ERROR = 0, 2, 3
FIXED, TUNABLE, LEVEL, PUSH, COUNT, Z = "initial.z", "damping", "level", "push", "count", "z"


def spring() -> Component:
    """A mass on a spring, pushed; it fails where it is pushed by more than 1e160."""
    m = ComponentBuilder("spring", "Mass on a spring")
    push = m.input("push", "N", "Force")
    level = m.input("level", "1", "Counted up", kind="integer")
    drop = m.parameter("damping", 0.1, "1/s", "Of the spring", minimum=0.0)
    z0 = m.parameter("initial.z", 1.0, "m", "Height at the start", fixed=True)
    m.sampled(0.1, "Between two counts")
    z, v = m.state("z", "m", "Height", z0), m.state("v", "m/s", "Speed", 0.0)
    n = m.memory("n", "1", "Counted", level)
    m.update("n", n + 1)
    m.crossing("touch", "m", "Height", z)
    m.derivative("z", v)
    m.derivative("v", push * push - 4.0 * z - drop * v)
    m.rests_while(drop < 0)
    m.output("z", "m", "Height", z)
    m.output("count", "1", "Counted", ca.floor(n), kind="integer")
    return m.build()


class Raw:
    """One instance called past FMPy: statuses instead of exceptions."""

    def __init__(self, folder: Path, exchange: bool) -> None:
        kinds = (FMU2Model, FMU3Model) if exchange else (FMU2Slave, FMU3Slave)
        self.one = type("Kind", (Instance,), {"model_types": kinds})(folder)
        self.fmi, self.exchange, self.time_s = self.one.fmi, exchange, 0.0
        self.vr = self.one.reference

    def call(self, name: str, *arguments: Any) -> int:
        """Status of a function."""
        function = self.one.fmu.dll[f"fmi{self.fmi}{name}"]
        return int(function(ctypes.c_void_p(self.one.fmu.component), *arguments))

    def to(self, state: str) -> "Raw":
        """Into one of `STATES` by calls that are allowed."""
        if state == "instantiated":
            return self
        assert self.enter() == OK
        if state == "initialization":
            return self
        assert self.call("ExitInitializationMode") == OK
        if state == "continuous":
            assert self.call("EnterContinuousTimeMode") == OK
        if state == "failed":
            assert self.set(PUSH, 1e160) == OK
            assert self.step() == ERROR
        if state == "terminated":
            assert self.call("Terminate") == OK
        return self

    def anew(self) -> "Raw":
        """Reset."""
        assert self.call("Reset") == OK
        self.time_s = 0.0
        return self

    def enter(self, start_s: float = 0.0, stop_s: float | None = None) -> int:
        """Set the times and enter initialization mode."""
        times = (ctypes.c_double(start_s), stop_s is not None, ctypes.c_double(stop_s or 0.0))
        if self.fmi == 2:
            status = self.call("SetupExperiment", 0, ctypes.c_double(0.0), *times)
            return status or self.call("EnterInitializationMode")
        return self.call("EnterInitializationMode", False, ctypes.c_double(0.0), *times)

    def move(self, verb: str, kind: str, name: str | int, value: float = 0.0, n: int = 1) -> int:
        """Get or set one variable by the functions of a type, `n` values in FMI 3."""
        reference = self.vr[name] if isinstance(name, str) else name
        number = (
            (ctypes.c_double * 1)(value) if kind == "Real" else (ctypes.c_int32 * 1)(int(value))
        )
        suffix = {"Real": "Float64", "Integer": "Int32"}.get(kind, kind) if self.fmi == 3 else kind
        more = [] if self.fmi == 2 else [ctypes.c_size_t(n)]
        place = ctypes.byref(ctypes.c_uint32(reference))
        return self.call(verb + suffix, place, ctypes.c_size_t(1), number, *more)

    def set(self, name: str | int, value: float, kind: str = "Real") -> int:
        return self.move("Set", kind, name, value)

    def get(self, name: str | int, kind: str = "Real") -> int:
        return self.move("Get", kind, name)

    def step(self, time_s: float | None = None, step_s: float = 0.01) -> int:
        at = self.time_s if time_s is None else time_s
        head = ctypes.c_double(at), ctypes.c_double(step_s)
        if self.fmi == 2:
            status = self.call("DoStep", *head, 1)
        else:
            flags = [ctypes.byref(ctypes.c_bool()) for _ in range(3)]
            status = self.call("DoStep", *head, True, *flags, ctypes.byref(ctypes.c_double()))
        if status == OK:
            self.time_s = at + step_s
        return status

    def array(self, name: str, n: int = 2) -> int:
        """A function that fills or reads an array of real numbers."""
        return self.call(name, (ctypes.c_double * 3)(), ctypes.c_size_t(n))

    def update(self) -> int:
        if self.fmi == 2:
            return self.call("NewDiscreteStates", (ctypes.c_double * 8)())
        return self.call(
            "UpdateDiscreteStates", *(ctypes.byref(ctypes.c_double()) for _ in range(6))
        )

    def completed(self) -> int:
        flags = (ctypes.byref(ctypes.c_int32()) for _ in range(2))
        return self.call("CompletedIntegratorStep", 1, *flags)

    def derivative(self, unknown: str | int, known: str | int) -> int:
        references = [self.vr[n] if isinstance(n, str) else n for n in (unknown, known)]
        u, k = (ctypes.byref(ctypes.c_uint32(r)) for r in references)
        one, seed, result = ctypes.c_size_t(1), ctypes.c_double(1.0), ctypes.c_double()
        values: list[Any] = [ctypes.byref(seed), ctypes.byref(result)]
        if self.fmi == 3:
            values = [values[0], one, values[1], one]
        return self.call("GetDirectionalDerivative", u, one, k, one, *values)

    # -- saved states -------------------------------------------------------------------

    def noun(self) -> str:
        return "FMUstate" if self.fmi == 2 else "FMUState"

    def saved(self) -> ctypes.c_void_p:
        state = ctypes.c_void_p()
        assert self.call(f"Get{self.noun()}", ctypes.byref(state)) == OK
        return state

    def drop(self, state: ctypes.c_void_p) -> None:
        assert self.call(f"Free{self.noun()}", ctypes.byref(state)) == OK

    def text(self, short: int = 0) -> tuple[int, bytes]:
        """The present state as bytes, into a buffer that is `short` of some."""
        state, size = self.saved(), ctypes.c_size_t()
        assert self.call(f"Serialized{self.noun()}Size", state, ctypes.byref(size)) == OK
        buffer = ctypes.create_string_buffer(size.value)
        status = self.call(
            f"Serialize{self.noun()}", state, buffer, ctypes.c_size_t(size.value - short)
        )
        self.drop(state)
        return status, buffer.raw

    def read(self, text: bytes) -> int:
        """Make a state of bytes, and let it go."""
        state, verb = ctypes.c_void_p(), "DeSerialize" if self.fmi == 2 else "Deserialize"
        buffer = ctypes.create_string_buffer(text, len(text))
        status = self.call(
            verb + self.noun(), buffer, ctypes.c_size_t(len(text)), ctypes.byref(state)
        )
        self.drop(state)
        return status

    def restored(self) -> int:
        state = self.saved()
        status = self.call(f"Set{self.noun()}", state)
        self.drop(state)
        return status


Make = Callable[[int, bool], Raw]


@pytest.fixture(scope="module")
def springs(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    folder = tmp_path_factory.mktemp("springs")
    model = component_model(spring(), exchange=True)
    return {f: unzip(build(model, folder / f"{f}.fmu", f), folder / f"{f}") for f in (2, 3)}


@pytest.fixture
def make(springs: dict[int, Path]) -> Iterator[Make]:
    """(FMI version, model exchange) -> an instance, freed after the test."""
    made: list[Raw] = []

    def raw(fmi: int, exchange: bool) -> Raw:
        made.append(Raw(springs[fmi], exchange))
        return made[-1]

    yield raw
    for one in made:
        one.one.close()


STATES = {
    False: ("instantiated", "initialization", "step", "terminated", "failed"),
    True: ("instantiated", "initialization", "event", "continuous", "terminated"),
}
"""By model exchange."""
ANY = {"instantiated", "initialization", "step", "event", "continuous", "terminated", "failed"}
RUNNING = {"step", "event", "continuous"}
READABLE = ANY - {"instantiated"}
COMPUTED = READABLE - {"failed"}  # where what has diverged is no number
SETTABLE = {"instantiated", "initialization", "step", "event"}

COMMON: Mapping[str, tuple[Callable[[Raw], int], set[str]]] = {
    "SetDebugLogging": (lambda r: r.call("SetDebugLogging", 1, ctypes.c_size_t(0), None), ANY),
    "EnterInitializationMode": (lambda r: r.enter(), {"instantiated"}),
    "ExitInitializationMode": (lambda r: r.call("ExitInitializationMode"), {"initialization"}),
    "Terminate": (lambda r: r.call("Terminate"), RUNNING),
    "Reset": (lambda r: r.call("Reset"), ANY),
    "Get, output": (lambda r: r.get(Z), COMPUTED),
    "Get, parameter": (lambda r: r.get(TUNABLE), READABLE),
    "Get, integer": (lambda r: r.get(COUNT, "Integer"), COMPUTED),
    "Set, fixed parameter": (lambda r: r.set(FIXED, 2.0), {"instantiated", "initialization"}),
    "Set, tunable parameter": (lambda r: r.set(TUNABLE, 0.2), SETTABLE),
    "Set, input": (lambda r: r.set(PUSH, 0.5), SETTABLE | {"continuous"}),
    "Set, discrete input": (lambda r: r.set(LEVEL, 3, "Integer"), SETTABLE),
    "Set, output": (lambda r: r.set(Z, 1.0), set()),
    "GetFMUState": (lambda r: r.restored(), ANY),
    "SerializeFMUState": (lambda r: r.text()[0], ANY),
    "DeserializeFMUState": (lambda r: r.read(r.text()[1]), ANY),
    "GetDirectionalDerivative": (lambda r: r.derivative(Z, PUSH), COMPUTED),
    "DoStep": (lambda r: r.step(), {"step"}),
    "EnterEventMode": (lambda r: r.call("EnterEventMode"), {"event", "continuous"}),
    "UpdateDiscreteStates": (lambda r: r.update(), {"event"}),
    "EnterContinuousTimeMode": (lambda r: r.call("EnterContinuousTimeMode"), {"event"}),
    "CompletedIntegratorStep": (lambda r: r.completed(), {"continuous"}),
    "SetTime": (lambda r: r.call("SetTime", ctypes.c_double(0.0)), {"event", "continuous"}),
}
SOLVER: Mapping[str, tuple[Callable[[Raw], int], set[str]]] = {
    "SetContinuousStates": (lambda r: r.array("SetContinuousStates"), {"continuous"}),
    "GetContinuousStates": (lambda r: r.array("GetContinuousStates"), READABLE),
    "GetDerivatives": (
        lambda r: r.array("GetDerivatives" if r.fmi == 2 else "GetContinuousStateDerivatives"),
        READABLE,
    ),
    "GetEventIndicators": (lambda r: r.array("GetEventIndicators", 1), READABLE),
    "GetNominals": (lambda r: r.array("GetNominalsOfContinuousStates"), ANY),
}
"""Of a solver outside: never in co-simulation."""
OWN: Mapping[int, Mapping[str, tuple[Callable[[Raw], int], set[str]]]] = {
    2: {
        "SetupExperiment": (
            lambda r: r.call(
                "SetupExperiment", 0, ctypes.c_double(), ctypes.c_double(), 0, ctypes.c_double()
            ),
            {"instantiated"},
        ),
        "CancelStep": (lambda r: r.call("CancelStep"), set()),
    },
    3: {
        "EvaluateDiscreteStates": (
            lambda r: r.call("EvaluateDiscreteStates"),
            {"initialization", "event"},
        ),
        "EnterConfigurationMode": (lambda r: r.call("EnterConfigurationMode"), set()),
        "ExitConfigurationMode": (lambda r: r.call("ExitConfigurationMode"), set()),
        "EnterStepMode": (lambda r: r.call("EnterStepMode"), set()),
    },
}


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize(
    ("exchange", "state"), [(e, s) for e, all_ in STATES.items() for s in all_]
)
def test_what_a_state_allows(make: Make, fmi: int, exchange: bool, state: str) -> None:
    table = {**COMMON, **OWN[fmi], **SOLVER}
    one, found = make(fmi, exchange), {}
    for name, (call, states) in table.items():
        one.anew().to(state)
        one.one.messages.clear()
        before = one.text()
        status = call(one)
        allowed = state in states and (exchange or name not in SOLVER)
        if status != (OK if allowed else ERROR):
            found[name] = status
        if not allowed:
            assert len(one.one.messages) == 1, name
            assert state == "failed" or one.text() == before, name
    assert found == {}


BEYOND: Mapping[str, tuple[Callable[[Raw], int], str]] = {
    "unknown reference, get": (lambda r: r.get(9999), "step"),
    "unknown reference, set": (lambda r: r.set(9999, 1.0), "step"),
    "time, set": (lambda r: r.set(0, 1.0), "step"),
    "integer by Real, get": (lambda r: r.get(COUNT), "step"),
    "integer by Real, set": (lambda r: r.set(LEVEL, 1.0), "step"),
    "real by Integer, get": (lambda r: r.get(Z, "Integer"), "step"),
    "real by Boolean, set": (lambda r: r.set(PUSH, 1, "Boolean"), "step"),
    "input NaN": (lambda r: r.set(PUSH, math.nan), "step"),
    "input infinite": (lambda r: r.set(PUSH, -math.inf), "instantiated"),
    "below the minimum": (lambda r: r.set(TUNABLE, -1.0), "instantiated"),
    "no step": (lambda r: r.step(step_s=0.0), "step"),
    "step backward": (lambda r: r.step(step_s=-0.01), "step"),
    "step NaN": (lambda r: r.step(step_s=math.nan), "step"),
    "step infinite": (lambda r: r.step(step_s=math.inf), "step"),
    "step from before": (lambda r: r.step(time_s=-0.01), "step"),
    "step from after": (lambda r: r.step(time_s=0.01), "step"),
    "step from NaN": (lambda r: r.step(time_s=math.nan), "step"),
    "start NaN": (lambda r: r.enter(math.nan), "instantiated"),
    "start infinite": (lambda r: r.enter(math.inf), "instantiated"),
    "stop before start": (lambda r: r.enter(2.0, 1.0), "instantiated"),
    "stop NaN": (lambda r: r.enter(0.0, math.nan), "instantiated"),
    "no such category": (
        lambda r: r.call(
            "SetDebugLogging", 1, ctypes.c_size_t(1), (ctypes.c_char_p * 1)(b"logDreams")
        ),
        "step",
    ),
    "no state": (lambda r: r.call(f"Set{r.noun()}", None), "step"),
    "buffer too short": (lambda r: r.text(short=1)[0], "step"),
    "state too short": (lambda r: r.read(r.text()[1][:-1]), "step"),
    "state too long": (lambda r: r.read(r.text()[1] + b"\0"), "step"),
    "state of nothing": (lambda r: r.read(b""), "step"),
    "state of another": (lambda r: r.read(b"x" + r.text()[1][1:]), "step"),
    "derivative of an input": (lambda r: r.derivative(PUSH, PUSH), "step"),
    "derivative by an output": (lambda r: r.derivative(Z, COUNT), "step"),
    "derivative of nothing": (lambda r: r.derivative(9999, PUSH), "step"),
    "derivative by nothing": (lambda r: r.derivative(Z, 9999), "step"),
    "time NaN": (lambda r: r.call("SetTime", ctypes.c_double(math.nan)), "continuous"),
    "too few states, get": (lambda r: r.array("GetContinuousStates", 1), "continuous"),
    "too many states, set": (lambda r: r.array("SetContinuousStates", 3), "continuous"),
    "too many indicators": (lambda r: r.array("GetEventIndicators", 2), "continuous"),
    "too few nominals": (lambda r: r.array("GetNominalsOfContinuousStates", 0), "continuous"),
}
WRONG: Mapping[int, Mapping[str, tuple[Callable[[Raw], int], str]]] = {
    2: {
        "input derivatives": (
            lambda r: r.call(
                "SetRealInputDerivatives",
                ctypes.byref(ctypes.c_uint32(r.vr[PUSH])),
                ctypes.c_size_t(1),
                ctypes.byref(ctypes.c_int(1)),
                ctypes.byref(ctypes.c_double(1.0)),
            ),
            "step",
        ),
        "a text": (
            lambda r: r.call(
                "GetString",
                ctypes.byref(ctypes.c_uint32(r.vr[Z])),
                ctypes.c_size_t(1),
                ctypes.byref(ctypes.c_char_p()),
            ),
            "step",
        ),
    },
    3: {
        "too many values, get": (lambda r: r.move("Get", "Real", Z, n=2), "step"),
        "too few values, set": (lambda r: r.move("Set", "Real", PUSH, n=0), "step"),
        "a clock": (
            lambda r: r.call(
                "GetClock",
                ctypes.byref(ctypes.c_uint32(r.vr[Z])),
                ctypes.c_size_t(1),
                ctypes.byref(ctypes.c_bool()),
            ),
            "step",
        ),
    },
}


@pytest.mark.parametrize("fmi", [2, 3])
def test_wrong_arguments(make: Make, fmi: int) -> None:
    """An error with one message; the state stays what it was, to the bit, and the run goes on."""
    found, instances = {}, {exchange: make(fmi, exchange) for exchange in STATES}
    for name, (call, state) in {**BEYOND, **WRONG[fmi]}.items():
        one = instances[state == "continuous"].anew().to(state)
        before = one.text()
        one.one.messages.clear()
        if (status := call(one)) != ERROR or len(one.one.messages) != 1:
            found[name] = status
        assert one.text() == before, name
        if state == "step":
            assert one.step() == OK, name
    assert found == {}


@pytest.mark.parametrize("fmi", [2, 3])
def test_from_every_state_a_reset_begins_anew(make: Make, fmi: int) -> None:
    for exchange, states in STATES.items():
        fresh = make(fmi, exchange).text()
        for state in states:
            one = make(fmi, exchange).to(state).anew()
            assert one.text() == fresh
            one.to(states[2])


def test_status_of_what_is_not_pending(make: Make) -> None:
    """FMI 2: no step is pending; the time of the last successful step is known."""
    one, value = make(2, False).to("step"), ctypes.c_double()
    assert one.step() == OK
    for name in ("GetStatus", "GetIntegerStatus", "GetBooleanStatus", "GetStringStatus"):
        assert one.call(name, 0, ctypes.byref(value)) == DISCARD
    assert one.call("GetRealStatus", 2, ctypes.byref(value)) == OK
    assert value.value == pytest.approx(0.01)


# -- the stop time --------------------------------------------------------------------------


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("step_s", [0.01, 0.1, 0.3, 1 / 3])
def test_no_step_goes_beyond_the_stop_time(make: Make, fmi: int, step_s: float) -> None:
    """Times added up with their rounding errors end there; one step more is refused."""
    one, n, start_s = make(fmi, False), round(3.0 / step_s), 5.0
    assert one.enter(start_s, start_s + n * step_s) == OK
    assert one.call("ExitInitializationMode") == OK
    one.time_s = start_s
    for _ in range(n):
        assert one.step(step_s=step_s) == OK
    one.one.messages.clear()
    assert one.step(step_s=step_s) == ERROR
    (message,) = one.one.messages
    assert message == (
        f"doStep to {start_s + (n + 1) * step_s:.9g} s, beyond the stop time "
        f"{start_s + n * step_s:.9g} s"
    )
    one.anew().to("step")  # the stop time is forgotten
    assert one.step(step_s=100.0) == OK


@pytest.mark.parametrize("fmi", [2, 3])
def test_no_step_of_a_solver_ends_beyond_the_stop_time(make: Make, fmi: int) -> None:
    """It may look there on its way: a variable-step solver overshoots and interpolates back."""
    one = make(fmi, True)
    assert one.enter(0.0, 1.0) == OK
    assert one.call("ExitInitializationMode") == OK
    assert one.call("EnterContinuousTimeMode") == OK
    for time_s, expected in ((1.0, OK), (1.01, ERROR)):
        assert one.call("SetTime", ctypes.c_double(time_s)) == OK
        assert one.get(Z) == OK
        assert one.completed() == expected
        assert one.call("EnterEventMode") == expected
        if expected == OK:
            assert one.call("EnterContinuousTimeMode") == OK


@pytest.mark.parametrize("fmi", [2, 3])
def test_the_stop_time_of_parts_in_one(tmp_path: Path, fmi: int) -> None:
    """A fused FMU, and the stop time in its saved state."""
    model = fuse("two", "Two", {"a": component_model(spring()), "b": component_model(spring())}, [])
    one = Raw(unzip(build(model, tmp_path / "two.fmu", fmi), tmp_path / "two"), False)
    assert one.enter(0.0, 0.02) == OK
    assert one.call("ExitInitializationMode") == OK
    saved = one.saved()
    assert (one.step(), one.step(), one.step()) == (OK, OK, ERROR)
    assert one.anew().call(f"Set{one.noun()}", saved) == OK
    assert (one.step(), one.step(), one.step()) == (OK, OK, ERROR)
    one.drop(saved)
    one.one.close()
