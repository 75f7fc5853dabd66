"""A fused FMU against the co-simulation of its parts, against itself, and what `fuse` refuses."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import fmpy
import numpy as np
import pytest
from instance import Array, Instance
from kinds import commands, component, fused_connections, fused_parts, model, receiver

from cosim.master import Master
from cosim.system import Connection, System
from fmus import FmuModel, build, component_model, fuse
from twin.component import Component, ComponentBuilder
from twin.errors import FmuError

FmuFile = Callable[[str, int], Path]
New = Callable[[str, int], Instance]
H = 1e-3
STEPS = 3000
STARTS = {
    "airframe.initial.omega_x": 0.7,
    "airframe.initial.vel_y": 2.0,
    "airframe.initial.pos_z": -50.0,
    "airframe.wind_x": 3.0,
    "battery.initial.charge": 0.9,
    "imu.seed": 5.0,
    "imu.sample_period": 0.0035,  # no multiple of the step
    "imu.acc_noise": 0.2,
    "imu.gyro_bias_walk": 0.01,
    "receiver.seed": 5.0,
    "receiver.noise": 0.3,
}


def co_simulated(folder: Path, fmi: int, outputs: tuple[str, ...]) -> Array:
    """Outputs of the parts as FMUs of their own, every H."""
    fmus = {n: build(m, folder / f"{n}.fmu", fmi) for n, m in fused_parts().items()}
    connections = tuple(Connection(*c) for c in fused_connections())
    with Master(System(fmus, connections, STARTS), record=outputs) as master:
        master.initialize()
        return master.run(STEPS * H, H).values


def fused(path: Path, step_s: float) -> tuple[tuple[str, ...], Array]:
    """Names and values of all outputs, every `step_s`."""
    starts = {f"fused.{n}": v for n, v in STARTS.items()}
    with Master(System({"fused": path}, starts=starts)) as master:
        master.initialize()
        values = master.run(STEPS * H, step_s).values
    return tuple(n.removeprefix("fused.") for n in master.record_names), values


@pytest.mark.parametrize("fmi", [2, 3])
def test_equals_the_co_simulation_of_its_parts(fmu_file: FmuFile, tmp_path: Path, fmi: int) -> None:
    """From the first value on, to the last bit, whatever the communication step."""
    names, fine = fused(fmu_file("fused", fmi), H)
    parts = co_simulated(tmp_path, fmi, names)
    assert np.mean(np.ptp(parts, axis=0) > 0) > 0.8  # all but the replay's validity and the like
    assert fine.tobytes() == parts.tobytes()
    _, coarse = fused(fmu_file("fused", fmi), 10 * H)
    assert coarse.tobytes() == parts[::10].tobytes()


@pytest.mark.parametrize("fmi", [2, 3])
def test_equals_its_parts_within_a_larger_system(tmp_path: Path, fmi: int) -> None:
    """The commands come from outside, from an FMU next to it."""
    parts = fused_parts()
    inner = {n: m for n, m in parts.items() if n != "flight"}
    within = [c for c in fused_connections() if not c[0].startswith("flight.")]
    outside = [c for c in fused_connections() if c[0].startswith("flight.")]
    one = fuse("one", "Without the flight", inner, within)
    flight = build(parts["flight"], tmp_path / "flight.fmu", fmi)
    system = System(
        {"flight": flight, "one": build(one, tmp_path / "one.fmu", fmi)},
        tuple(Connection(a, f"one.{b}") for a, b in outside),
        {f"one.{n}": v for n, v in STARTS.items()},
    )
    names = tuple(n for part in one.parts for n in part.dependencies)
    with Master(system, record=[f"one.{n}" for n in names]) as master:
        master.initialize()
        values = master.run(STEPS * H, H).values
    assert values.tobytes() == co_simulated(tmp_path, fmi, names).tobytes()


def test_inputs_that_come_late_at_initialisation(tmp_path: Path) -> None:
    """One enters a state alone, of a part visited before; one an output of a part visited twice."""
    m = ComponentBuilder("integral", "Starts a state from its input and shows the integral of that")
    hidden = m.state("hidden", "1", "Input at the start", m.input("u", "1", "Input"))
    y = m.state("y", "1", "Its integral", 0.0)
    m.derivative("y", hidden)
    m.output("y", "1", "Its integral", y)
    integral = m.build()
    m = ComponentBuilder("first", "Gives before it takes")
    m.output("one", "1", "Always 1", 1.0)
    m.output("quotient", "1", "Not finite while the input is 0", 1 / m.input("u", "1", "Input", 2))
    first = m.build()
    m = ComponentBuilder("more", "Gives back at once")
    m.output("y", "1", "Three more", m.input("u", "1", "Input") + 3)
    more = m.build()
    parts = {"integral": integral, "first": first, "second": more, "last": more}
    connections = [
        ("first.one", "second.u"),
        ("second.y", "first.u"),
        ("first.quotient", "last.u"),
        ("last.y", "integral.u"),
    ]
    fused = fuse("f", "Fused", parts, connections)
    assert fused.order == (0, 1, 2, 1, 3)
    fmus = {n: build(component_model(c), tmp_path / f"{n}.fmu") for n, c in parts.items()}
    names = ["integral.y", "first.quotient", "second.y", "last.y"]
    with Master(System(fmus, tuple(Connection(*c) for c in connections)), names) as master:
        master.initialize()
        apart = master.run(0.1, H).values
    together = System({"f": build(fused, tmp_path / "f.fmu")})
    with Master(together, [f"f.{n}" for n in names]) as master:
        master.initialize()
        assert master.run(0.1, H).values.tobytes() == apart.tobytes()
    assert apart[0].tolist() == [0.0, 0.25, 4.0, 3.25]
    assert apart[-1, 0] == pytest.approx(0.325, rel=1e-12)


def test_odd_steps_leave_no_rounding_errors(tmp_path: Path) -> None:
    """29 steps of h = 1/3000 s in one communication step or in one each; 29 h / 29 is not h."""
    m = ComponentBuilder("lag", "Sampled at odd instants, behind a lag")
    m.sampled(0.0107, "Time between two samples")
    u = m.input("cmd_1", "1", "Input")
    held = m.memory("held", "1", "Input, held")
    m.update("held", u)
    y = m.state("y", "1", "Lagged", 0.0)
    m.derivative("y", (held - y) / 0.03)
    m.output("y", "1", "Lagged", y)
    h = 1 / 3000
    assert 29 * h / 29 != h
    parts: dict[str, FmuModel | Component] = {"lag": m.build(), "flight": commands()}
    path = build(fuse("f", "Fused", parts, [("flight.cmd_1", "lag.cmd_1")], h), tmp_path / "f.fmu")
    with Master(System({"f": path})) as master:
        master.initialize()
        fine = master.run(29 * 40 * h, h).values
        master.initialize()
        assert master.run(29 * 40 * h, 29 * h).values.tobytes() == fine[::29].tobytes()


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_step_that_is_no_multiple_is_divided_evenly(new: New, fmi: int) -> None:
    """2.5 ms are three steps inside; 1.000001 ms are one."""
    coarse, fine = new("fused", fmi).start(STARTS), new("fused", fmi).start(STARTS)
    coarse.step(0.0, 2.5e-3)
    for k in range(3):
        fine.step(k * 2.5e-3 / 3, 2.5e-3 / 3)
    np.testing.assert_allclose(coarse.outputs(), fine.outputs(), rtol=1e-12, atol=1e-12)
    coarse.step(2.5e-3, 1.0000005e-3)


@pytest.mark.parametrize("fmi", [2, 3])
def test_rollback_is_exact(new: New, fmi: int) -> None:
    """At random instants with noise and delays on, in this instance and in another one."""
    instance, other = new("fused", fmi).start(STARTS), new("fused", fmi)
    rng = np.random.default_rng(fmi)
    at = 0
    for ahead in rng.integers(1, 40, size=15):
        instance.run(int(ahead), at)
        at += int(ahead)
        instance.set({"airframe.wind_y": float(rng.normal())})  # that no step has seen yet
        state = instance.fmu.getFMUState()
        text = instance.fmu.serializeFMUState(state)
        first = instance.run(30, at).tobytes()
        instance.fmu.setFMUState(state)
        assert instance.run(30, at).tobytes() == first
        instance.fmu.setFMUState(state)
        assert instance.fmu.serializeFMUState(instance.fmu.getFMUState()) == text
        rebuilt = other.fmu.deserializeFMUState(text)
        other.fmu.setFMUState(rebuilt)
        assert other.run(30, at).tobytes() == first
        instance.fmu.freeFMUState(state)
        other.fmu.freeFMUState(rebuilt)


def test_reading_twice_and_setting_the_same_changes_nothing(new: New) -> None:
    """Connected inputs are held between the steps, whatever is set or asked."""
    quiet, busy = new("fused", 2).start(STARTS), new("fused", 2).start(STARTS)
    for k in range(50):
        quiet.step(k * H)
        busy.step(k * H)
        before = busy.outputs().tobytes()
        busy.set({n: busy.get(n) for n in ("airframe.wind_z", "battery.resistance")})
        assert busy.outputs().tobytes() == before
    assert quiet.outputs().tobytes() == before


# -- interface ------------------------------------------------------------------------------


def test_variables_are_those_of_the_parts() -> None:
    fused = model("fused")
    connected = {target for _, target in fused_connections()}
    for kind in ("parameter", "input", "output"):
        expected = [
            f"{n}.{v.name}"
            for n, m in fused_parts().items()
            for v in m.variables
            if v.causality == kind and f"{n}.{v.name}" not in connected
        ]
        assert [v.name for v in fused.variables if v.causality == kind] == expected
    order = [v.causality for v in fused.variables]
    assert order == sorted(order, key=("parameter", "input", "output").index)
    assert set(fused.resources) == {"flight/record.bin"}


def declared(path: Path, group: str) -> set[tuple[str, str]]:
    description = fmpy.read_model_description(str(path))
    return {(u.variable.name, k.name) for u in getattr(description, group) for k in u.dependencies}


def test_dependencies_while_stepping_are_those_of_the_own_part(fmu_file: FmuFile) -> None:
    connected = {target for _, target in fused_connections()}
    expected = {
        (f"{n}.{y}", f"{n}.{u}")
        for n, m in fused_parts().items()
        for y, inputs in m.dependencies.items()
        for u in inputs
        if f"{n}.{u}" not in connected
    }
    assert declared(fmu_file("fused", 2), "outputs") == expected


def test_initial_unknowns_reach_through_the_connections(fmu_file: FmuFile) -> None:
    told = declared(fmu_file("fused", 3), "initialUnknowns")
    assert ("imu.acc_z", "airframe.initial.vel_z") in told  # drag, felt by the accelerometer
    assert ("imu.acc_z", "airframe.wind_z") in told
    assert ("receiver.fix_x", "airframe.initial.pos_x") in told
    assert ("receiver.fix_x", "receiver.delay") not in told  # looked back to the start: the start
    assert ("battery.vbat_v", "imu.seed") not in told
    assert not {k for _, k in told} & {target for _, target in fused_connections()}


# -- derivatives ----------------------------------------------------------------------------


def knowns() -> list[str]:
    """Real inputs and parameters with room on both sides."""
    return [
        v.name
        for v in model("fused").variables
        if v.causality != "output"
        and v.real
        and not v.name.endswith((".seed", ".sample_period"))
        and (v.minimum is None or v.start > v.minimum)
        and (v.maximum is None or v.start < v.maximum)
    ]


def slopes(instance: Instance, names: list[str], seed: Array) -> tuple[Array, Array]:
    """Directional derivative of all outputs, and its fourth-order difference."""
    unknown = [instance.reference[n] for n in instance.output_names]
    known = [instance.reference[n] for n in names]
    exact = np.array(instance.fmu.getDirectionalDerivative(unknown, known, list(seed)))
    here = np.array([instance.get(n) for n in names])

    def moved(by: float) -> Array:
        instance.set(dict(zip(names, here + by * seed, strict=True)))
        return instance.outputs()

    e = 1e-5
    slope = (8 * (moved(e) - moved(-e)) - (moved(2 * e) - moved(-2 * e))) / (12 * e)
    instance.set(dict(zip(names, here, strict=True)))
    return exact, slope


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("stepping", [False, True])
def test_derivatives_against_differences(new: New, fmi: int, stepping: bool) -> None:
    rng = np.random.default_rng(3)
    fixed = {v.name for v in model("fused").variables if v.fixed}
    names = [n for n in knowns() if not (stepping and n in fixed)]
    size = np.array([v.start for v in model("fused").variables if v.name in names])
    size = np.where(size == 0, 1e-2, np.abs(size))
    for i, n in enumerate(names):  # small against the moments of inertia
        if n.startswith("airframe.inertia."):
            size[i] = size[names.index("airframe.inertia.xx")]
    instance = new("fused", fmi)
    instance.enter({n: v for n, v in STARTS.items() if n != "battery.initial.charge"})
    if stepping:
        instance.leave()
        instance.run(5)
    for _ in range(20):
        exact, slope = slopes(instance, names, rng.normal(size=len(names)) * size)
        scale = np.maximum(np.abs(slope), 1e-3 * np.max(np.abs(slope)) + 1e-12)
        assert np.max(np.abs(exact - slope) / scale) < 1e-6
        if stepping:
            instance.set({"airframe.wind_x": float(rng.normal())})


def test_derivatives_reach_through_connections_at_the_start_only(new: New) -> None:
    instance = new("fused", 2)
    instance.enter()

    def effect(unknown: str, known: str) -> float:
        get, reference = instance.fmu.getDirectionalDerivative, instance.reference
        return float(get([reference[unknown]], [reference[known]], [2.0])[0])

    assert effect("receiver.fix_x", "airframe.initial.pos_x") == 2.0
    instance.leave()
    assert effect("receiver.fix_x", "airframe.initial.pos_x") == 0.0
    assert effect("airframe.specific_force_z", "airframe.mass") != 0.0


# -- messages and refusals ------------------------------------------------------------------


@pytest.mark.parametrize("fmi", [2, 3])
def test_messages_name_part_and_variable(new: New, fmi: int) -> None:
    instance = new("fused", fmi)
    for values, text in (
        ({"airframe.mass": -1.0}, "airframe.mass = -1 is below its minimum 0.0001"),
        ({"battery.initial.charge": 1.5}, "battery.initial.charge = 1.5 is above its maximum 1"),
    ):
        with pytest.raises(Exception, match="Set"):
            instance.set(values)
        assert instance.messages[-1] == text
    with pytest.raises(Exception, match="Exit"):
        instance.start({"receiver.delay": 0.2})
    assert instance.messages[-1] == (
        "delay receiver.fix_x = 0.2 s must be from 0 to 0.0963 s: make it shorter or "
        "sample_period longer"
    )
    instance.fmu.reset()
    instance.start({"airframe.initial.omega_x": 1e160})
    with pytest.raises(Exception, match="DoStep"):
        instance.step(0.0)
    assert instance.messages[-1].startswith("state airframe.pos_x = ")


def gain(unit: str = "m") -> Component:
    m = ComponentBuilder("gain", "Twice the input")
    m.output("y", unit, "Output", 2 * m.input("u", unit, "Input"))
    return m.build()


@pytest.mark.parametrize(
    ("connections", "text"),
    [
        ([("a.z", "b.u")], r"no variable 'a\.z'\. Did you mean"),
        ([("a.y", "c.u")], r"no variable 'c\.u'"),
        ([("a.u", "b.u")], r"a\.u \(input\) -> b\.u \(input\)"),
        ([("a.y", "b.y")], r"a\.y \(output\) -> b\.y \(output\)"),
        ([("a.y", "s.u")], r"a\.y \[m\] -> s\.u \[s\]: units differ"),
        ([("a.y", "b.u"), ("b.y", "b.u")], r"b\.u has two sources"),
        ([("a.y", "b.u"), ("b.y", "a.u")], r"algebraic loop: .*a\.y"),
        ([("a.y", "a.u")], r"algebraic loop: a\.y -> a\.y"),
    ],
)
def test_wrong_connections_are_refused(connections: list[tuple[str, str]], text: str) -> None:
    with pytest.raises(FmuError, match=text):
        fuse("f", "", {"a": gain(), "b": gain(), "s": gain("s")}, connections)


def test_wrong_names_and_steps_are_refused() -> None:
    for name in ("a.b", "1", "", "ü"):
        with pytest.raises(FmuError, match="is no C identifier"):
            fuse("f", "", {name: gain()}, [])
        with pytest.raises(FmuError, match="is no C identifier"):
            fuse(name, "", {"a": gain()}, [])
    for step_s in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(FmuError, match=r"step .* must be positive"):
            fuse("f", "", {"a": gain()}, [], step_s)
    with pytest.raises(FmuError, match="a is fused already"):
        fuse("f", "", {"a": model("fused")}, [])


def test_two_of_one_kind_draw_different_noise_or_are_refused(tmp_path: Path) -> None:
    first = receiver().with_starts({"noise": 1.0})
    with pytest.raises(FmuError, match=r"a and b are the same component with the same seed 0"):
        fuse("f", "", {"a": first, "b": first}, [])
    two = fuse("f", "Two", {"a": first, "b": first.with_starts({"seed": 1.0})}, [])
    alone = build(component_model(first), tmp_path / "alone.fmu")
    with Master(System({"f": build(two, tmp_path / "f.fmu"), "a": alone})) as master:
        master.initialize()
        run = master.run(1.0, H)
    assert np.array_equal(run["f.a.fix_x"], run["a.fix_x"])
    assert not np.array_equal(run["f.a.fix_x"], run["f.b.fix_x"])


@pytest.mark.parametrize("fmi", [2, 3])
def test_two_builds_are_the_same_bytes(
    fmu_file: FmuFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fmi: int
) -> None:
    monkeypatch.setenv("UAVTWIN_CACHE", str(tmp_path / "empty"))
    again = fuse("fused", "Several parts in one", fused_parts(), fused_connections())
    first = fmu_file("fused", fmi).read_bytes()
    assert build(again, tmp_path / "again.fmu", fmi).read_bytes() == first
    other = replace(again, step_s=2e-3)
    assert build(other, tmp_path / "other.fmu", fmi).read_bytes() != first


def test_one_part_alone_is_the_component(tmp_path: Path) -> None:
    """Fused or not, the same bits; only the names differ."""
    body = component("airframe-copter_default").with_starts({"initial.omega_y": 0.4})
    one = build(fuse("one", "", {"body": body}, []), tmp_path / "one.fmu")
    plain = build(component_model(body), tmp_path / "plain.fmu")
    with Master(System({"one": one, "plain": plain})) as master:
        master.initialize()
        values = master.run(0.5, 0.01).values
    n = len(body.output_names)
    assert values[:, :n].tobytes() == values[:, n:].tobytes()
