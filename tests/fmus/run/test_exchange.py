"""Model exchange: the same motion by a solver outside, and what the standard asks for besides."""

import ctypes
import math
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import casadi as ca
import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Model
from fmpy.fmi3 import FMU3Model
from fmpy.validation import validate_fmu
from instance import Array, Instance, unzip
from lxml import etree
from numpy.typing import NDArray

from fmus import build, component_model, fuse
from twin.component import Component, ComponentBuilder
from twin.errors import FmuError
from twin.physics.airframe import airframe
from twin.vehicle_file import load_vehicle


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


New = Callable[[int], Exchanged]
GRAVITY, HEIGHT_M, STIFFNESS = 9.81, 2.0, 4000.0
PERIOD_S = 0.1


def ball() -> Component:
    """Falls on a spring and dashpot; what it is pushed with comes late, its heat has a state."""
    m = ComponentBuilder("ball", "Ball over a floor")
    push = m.input("push", "N", "Force upwards")
    late = m.parameter("late.enabled", 0.0, "1", "Whether the push is late", kind="boolean")
    drop = m.parameter("damping", 10.0, "N.s/m", "Of the floor")
    m.sampled(PERIOD_S, "Time between two looks at the push")
    z = m.state("z", "m", "Height", HEIGHT_M)
    v = m.state("v", "m/s", "Speed upwards", 0.0)
    warmth = m.state("warmth", "K", "Warmth of the floor", 300.0)
    held = m.memory("held", "N", "Push as it arrives", push)
    m.update("warmth", ca.if_else(late, 300.0, warmth))
    m.update("held", m.delayed("push", push, ca.SX(PERIOD_S), 3))
    floor = ca.if_else(z < 0, -STIFFNESS * z - drop * v, 0.0)
    m.crossing("touch", "m", "Height, where the floor begins", z)
    m.derivative("z", v)
    m.derivative("v", ca.if_else(late, held, push) + floor - GRAVITY)
    m.derivative("warmth", ca.if_else(z < 0, 1.0, 0.0) - 0.1 * (warmth - 300.0))
    m.rests_while(late == 0)
    m.output("z", "m", "Height", z)
    m.output("energy", "N.m", "Energy", GRAVITY * z + v * v / 2)
    return m.build()


@pytest.fixture(scope="module")
def balls(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    folder = tmp_path_factory.mktemp("balls")
    model = component_model(ball(), exchange=True)
    return {fmi: build(model, folder / f"ball{fmi}.fmu", fmi) for fmi in (2, 3)}


@pytest.fixture
def new(balls: dict[int, Path], tmp_path: Path) -> Iterator[New]:
    """FMI version -> a fresh instance, initialised and past its first event."""
    made: list[Exchanged] = []

    def instance(fmi: int) -> Exchanged:
        folder = unzip(balls[fmi], tmp_path / str(len(made)))
        made.append(Exchanged(folder))
        return made[-1]

    yield instance
    for one in made:
        one.close()


@pytest.mark.parametrize("fmi", [2, 3])
def test_description(balls: dict[int, Path], fmi: int) -> None:
    assert validate_fmu(str(balls[fmi])) == []
    description = fmpy.read_model_description(str(balls[fmi]))
    assert description.coSimulation is not None
    assert description.numberOfContinuousStates == 3
    assert description.numberOfEventIndicators == 1
    local = [v.name for v in description.modelVariables if v.causality == "local"]
    assert local == [
        "state.v",
        "state.warmth",
        "der(z)",
        "der(state.v)",
        "der(state.warmth)",
        "touch",
    ]
    told = {u.variable.name: {d.name for d in u.dependencies} for u in description.derivatives}
    assert told == {
        "der(z)": {"state.v"},
        "der(state.v)": {"z", "state.v", "push"},
        "der(state.warmth)": {"z", "state.warmth"},
    }
    outputs = {u.variable.name: {d.name for d in u.dependencies} for u in description.outputs}
    assert outputs == {"z": {"z"}, "energy": {"z", "state.v"}}


@pytest.mark.parametrize("fmi", [2, 3])
def test_functions_of_a_solver(new: New, fmi: int) -> None:
    one = new(fmi).start({"push": 1.5})
    assert one.update() == np.inf  # nothing is late, so instants are not felt
    one.fmu.enterContinuousTimeMode()
    np.testing.assert_array_equal(one.states(), [HEIGHT_M, 0.0, 300.0])
    np.testing.assert_array_equal(one.nominals(), [HEIGHT_M, 1.0, 300.0])
    np.testing.assert_array_equal(one.rates(), [0.0, 1.5 - GRAVITY, 0.0])
    np.testing.assert_array_equal(one.indicators(), [HEIGHT_M])
    one.fmu.setTime(0.25)
    one.set_states(np.array([-0.01, 2.0, 310.0]))
    one.set({"push": -1.0})
    assert one.get("time") == 0.25 if fmi == 3 else True
    force = 0.01 * STIFFNESS - 10.0 * 2.0
    rates = np.array([2.0, force - 1.0 - GRAVITY, 0.0])
    np.testing.assert_allclose(one.rates(), rates, atol=1e-12)
    assert [one.get(n) for n in ("der(z)", "state.v", "touch")] == [2.0, 2.0, -0.01]
    assert [bool(told) for told in one.fmu.completedIntegratorStep()] == [False, False]
    one.fmu.terminate()


@pytest.mark.parametrize("fmi", [2, 3])
def test_directional_derivatives(new: New, fmi: int) -> None:
    """Of derivatives and outputs by states and inputs, against the equations."""
    one = new(fmi).start()
    one.fmu.enterContinuousTimeMode()
    one.set_states(np.array([-0.01, 2.0, 310.0]))
    unknown = ["der(z)", "der(state.v)", "der(state.warmth)", "energy"]
    exact = {
        "z": [0.0, -STIFFNESS, 0.0, GRAVITY],
        "state.v": [1.0, -10.0, 0.0, 2.0],
        "state.warmth": [0.0, 0.0, -0.1, 0.0],
        "push": [0.0, 1.0, 0.0, 0.0],
    }
    for known, column in exact.items():
        got = one.fmu.getDirectionalDerivative(
            [one.reference[n] for n in unknown], [one.reference[known]], [1.0]
        )
        np.testing.assert_allclose(got, column, atol=1e-12)


@pytest.mark.parametrize("fmi", [2, 3])
def test_touching_down_is_a_state_event(balls: dict[int, Path], fmi: int) -> None:
    """From rest it touches after sqrt(2 h / g) to the precision of the solver."""
    result = fmpy.simulate_fmu(
        str(balls[fmi]),
        fmi_type="ModelExchange",
        stop_time=0.7,
        output_interval=0.1,
        relative_tolerance=1e-9,
        output=["z"],
    )
    off_grid = [t for t in result["time"] if abs(t / 0.1 - round(t / 0.1)) > 1e-9]
    assert off_grid[0] == pytest.approx(math.sqrt(2 * HEIGHT_M / GRAVITY), abs=1e-8)


@pytest.mark.parametrize("fmi", [2, 3])
def test_sample_instants_are_time_events(new: New, fmi: int) -> None:
    """Switched on in flight they begin, and the push then comes two looks late."""
    one = new(fmi).start({"push": 1.0})
    one.update()
    one.fmu.enterContinuousTimeMode()
    one.fmu.setTime(0.73)
    one.fmu.enterEventMode()
    one.set({"late.enabled": 1.0})
    assert one.update() == pytest.approx(0.8)
    one.set({"push": 5.0})
    felt = []
    for k in (8, 9, 10):
        felt.append(one.rates()[1] + GRAVITY)
        one.fmu.enterContinuousTimeMode()
        one.fmu.setTime(k * PERIOD_S)
        one.fmu.enterEventMode()
        assert one.update() == pytest.approx((k + 1) * PERIOD_S)
    felt.append(one.rates()[1] + GRAVITY)
    np.testing.assert_allclose(felt, [1.0, 1.0, 5.0, 5.0])


@pytest.mark.parametrize("fmi", [2, 3])
def test_an_instant_may_move_a_state(new: New, balls: dict[int, Path], fmi: int) -> None:
    """Which the importer hears once, and which the description has announced."""
    one = new(fmi).start({"late.enabled": 1.0})
    one.update()
    one.fmu.enterContinuousTimeMode()
    one.set_states(np.array([1.0, 0.0, 310.0]))
    one.fmu.setTime(PERIOD_S)
    one.fmu.enterEventMode()
    one.update()
    assert one.moved
    one.update()
    assert not one.moved
    np.testing.assert_array_equal(one.states(), [1.0, 0.0, 300.0])
    with zipfile.ZipFile(balls[fmi]) as archive:
        root = etree.fromstring(archive.read("modelDescription.xml"))
    (warm,) = root.xpath("//*[@reinit='true']")
    assert (warm if fmi == 3 else warm.getparent()).get("name") == "state.warmth"


@pytest.mark.parametrize("fmi", [2, 3])
def test_rollback_is_exact(new: New, fmi: int) -> None:
    one, other = (new(fmi).start({"late.enabled": 1.0, "push": 3.0}) for _ in range(2))
    one.update()
    saved = one.fmu.getFMUState()
    text = one.fmu.serializeFMUState(saved)
    before = one.states(), one.rates()
    one.fmu.enterContinuousTimeMode()
    one.fmu.setTime(0.1)
    one.set_states(before[0] - 1.0)
    one.set({"push": 9.0})
    one.fmu.enterEventMode()
    one.update()
    one.fmu.setFMUState(saved)
    assert one.fmu.serializeFMUState(one.fmu.getFMUState()) == text
    other.fmu.setFMUState(other.fmu.deserializeFMUState(text))
    for restored in (one, other):
        np.testing.assert_array_equal(restored.states(), before[0])
        np.testing.assert_array_equal(restored.rates(), before[1])
        assert restored.update() == pytest.approx(PERIOD_S)


@pytest.mark.parametrize("fmi", [2, 3])
def test_refusals(new: New, balls: dict[int, Path], tmp_path: Path, fmi: int) -> None:
    one = new(fmi).start()
    one.fmu.enterContinuousTimeMode()
    refused: list[tuple[Callable[[], None], str]] = [
        (lambda: one.set_states(np.zeros(2)), "asks for 2 numbers, there are 3"),
        (lambda: one.set_states(np.array([1.0, np.nan, 300.0])), "state v = nan at time 0 s"),
        (lambda: one.set({"touch": 1.0}), "touch is computed and cannot be set"),
    ]
    for call, said in refused:
        with pytest.raises(FMICallException):
            call()
        assert said in one.messages[-1]
    one.set_states(np.array([1.0, 0.0, 300.0]))
    with pytest.raises(FMICallException):
        one.update()
    assert "discrete states cannot be updated in continuous-time mode" in one.messages[-1]
    stepped = Instance(unzip(balls[fmi], tmp_path / "stepped")).start()
    state = stepped.fmu.serializeFMUState(stepped.fmu.getFMUState())
    with pytest.raises(FMICallException):
        one.fmu.deserializeFMUState(state)
    assert "is of the other kind, co-simulation or model exchange" in one.messages[-1]
    stepped.close()


def test_only_what_can_be_exchanged(tmp_path: Path) -> None:
    with pytest.raises(FmuError, match="is for model exchange; give it for co-simulation alone"):
        fuse("two", "Two", {"ball": component_model(ball(), exchange=True)}, [])


HOLD_S = 0.1


@pytest.fixture(scope="module")
def airframes(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    folder = tmp_path_factory.mktemp("airframes")
    component = airframe(load_vehicle("copter_default"), effects=("command_delay",))
    model = component_model(component, exchange=True)
    return {fmi: build(model, folder / f"airframe{fmi}.fmu", fmi) for fmi in (2, 3)}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fmi", "stop_s", "starts"),
    [
        (2, 3.0, {"wind_x": 2.0}),
        (3, 3.0, {"wind_x": 2.0}),
        (2, 1.0, {"command_delay.enabled": 1.0, "command_delay.delay_s": 0.0305}),
    ],
)
def test_airframe_flies_as_in_co_simulation(
    airframes: dict[int, Path], tmp_path: Path, fmi: int, stop_s: float, starts: dict[str, float]
) -> None:
    """Commands change every 0.1 s; both ways are within 1e-6 of the span of each output.

    CVode works at a relative tolerance of 1e-10; co-simulation at 0.1 ms agrees with that at 1 ms
    to 1e-11, so what differs is the error of CVode.
    """
    inside = Instance(unzip(airframes[fmi], tmp_path / "inside"))
    n, every = round(stop_s / HOLD_S), round(HOLD_S / 0.01)
    rng = np.random.default_rng(1)
    inside.enter(starts)
    trim = inside.get("cmd_1")
    steps = trim + 0.005 * rng.standard_normal((n, 4))
    names = [f"cmd_{i}" for i in range(1, 5)]
    held = [inside.get(v) for v in _other_inputs(airframes[fmi])]
    inside.set(dict(zip(names, steps[0], strict=True)))
    inside.leave()
    rows = [inside.outputs()]
    for k in range(n * every):
        inside.set(dict(zip(names, steps[k // every], strict=True)))
        inside.step(k * 0.01, 0.01)
        rows.append(inside.outputs())
    columns = [*names, *_other_inputs(airframes[fmi])]
    times = np.repeat(np.arange(n + 1) * HOLD_S, 2)[1:-1]
    signals = np.array(
        [(t, *steps[k // 2], *held) for k, t in enumerate(times)],
        dtype=[("time", float), *((c, float) for c in columns)],
    )
    outside = solved(airframes[fmi], stop_s, inside.output_names, signals, starts, 1e-10)
    inside.close()
    assert _farthest(np.array(rows), outside) < 1e-6


def _other_inputs(path: Path) -> list[str]:
    variables = fmpy.read_model_description(str(path)).modelVariables
    return [v.name for v in variables if v.causality == "input" and v.name[:4] != "cmd_"]


def _farthest(inside: Array, outside: Array) -> float:
    """Largest difference of two flights, in units of the span of each output."""
    span = np.ptp(inside, axis=0)
    assert span.max() > 1.0  # it flies
    return float((np.abs(inside - outside) / np.maximum(span, 1.0)).max())


@pytest.mark.slow
def test_arrays_are_integrated_as_scalars_are(airframes: dict[int, Path], tmp_path: Path) -> None:
    """FMPy's CVode sees the same states, derivatives and events, so that every bit of what it
    makes of them is the same: a fall onto the ground with changing commands."""
    component = airframe(load_vehicle("copter_default"), effects=("command_delay",))
    whole = replace(component_model(component, exchange=True), arrays=True)
    vectors = build(whole, tmp_path / "arrays.fmu", 3)
    assert validate_fmu(str(vectors)) == []
    states = fmpy.read_model_description(str(vectors)).numberOfContinuousStates
    plain = airframes[3]
    assert states == fmpy.read_model_description(str(plain)).numberOfContinuousStates
    times = np.array([0.0, 0.1, 0.1, 0.5])
    levels = np.array([0.2, 0.3, 0.5, 0.1])[:, None] + [0.0, 0.01, -0.01, 0.02]
    singles = np.zeros(4, dtype=[("time", float), *((f"cmd_{i}", float) for i in range(1, 5))])
    several = np.zeros(4, dtype=[("time", float), ("cmd", float, (4,))])
    several["time"] = singles["time"] = times
    several["cmd"] = levels
    for k in range(4):
        singles[f"cmd_{k + 1}"] = levels[:, k]
    many, single = (
        fmpy.simulate_fmu(
            str(path),
            fmi_type="ModelExchange",
            stop_time=0.5,
            output_interval=0.01,
            relative_tolerance=1e-8,
            input=commands,
            record_events=False,
        )
        for path, commands in ((vectors, several), (plain, singles))
    )
    outputs = [e for e in whole.entries if e.first.causality == "output"]
    assert {len(e.members) for e in outputs} >= {1, 3, 4}
    for entry in outputs:
        columns = np.column_stack([single[v.name] for v in entry.members])
        assert np.reshape(many[entry.name], columns.shape).tobytes() == columns.tobytes()
    assert np.ptp(single["vel_z"]) > 1.0, "it falls"
