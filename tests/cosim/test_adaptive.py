"""Step-size control: error against tolerance, instants met, rollback of everything."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from alter import NO_STATES, altered
from numpy.typing import NDArray

from cosim.master import Algorithm, Control, Grid, Master
from cosim.slave import Slave
from cosim.system import Connection, System
from fmus import build, component_model
from twin.component import Component, ComponentBuilder
from twin.errors import FmuError
from twin.physics.sensors.imu import imu
from twin.vehicle_file import load_vehicle

Array = NDArray[np.float64]
SAMPLED = {"imu.sample_period": 0.03, "imu.gyro_noise": 0.1, "imu.seed": 7.0}


def integrator() -> Component:
    """dy/dt = k u: two of them in a ring with k = 1 and -1 are an oscillator."""
    m = ComponentBuilder("integrator", "Integrates its input")
    k = m.parameter("k", 1.0, "1/s", "Gain")
    start = m.parameter("initial.y", 0.0, "1", "Start")
    u = m.input("u", "1", "Input")
    y = m.state("y", "1", "State", start)
    m.derivative("y", k * u)
    m.output("y", "1", "Output", y)
    return m.build()


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("adaptive")
    made = {
        f"integrator{fmi}": build(component_model(integrator()), folder / f"i{fmi}.fmu", fmi)
        for fmi in (2, 3)
    }
    made["imu"] = build(component_model(imu(load_vehicle("copter_default"))), folder / "imu.fmu")
    return made


@pytest.fixture
def oscillator(fmus: dict[str, Path]) -> System:
    """y'' = -y with y(0) = 0, y'(0) = 1: y = sin t; FMI 2 and 3."""
    return System(
        {"y": fmus["integrator2"], "v": fmus["integrator3"]},
        (Connection("v.y", "y.u"), Connection("y.y", "v.u")),
        {"v.initial.y": 1.0, "v.k": -1.0},
    )


@pytest.fixture
def noisy(oscillator: System, fmus: dict[str, Path]) -> System:
    """The same beside an IMU that reads its noise alone."""
    return replace(
        oscillator,
        fmus={**oscillator.fmus, "imu": fmus["imu"]},
        starts={**oscillator.starts, **SAMPLED},
    )


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["settled", "gauss_seidel", "jacobi"])
def test_error_falls_with_the_tolerance(oscillator: System, algorithm: Algorithm) -> None:
    """First-order coupling: the error of a step is its h**2, the error at the end h: the square
    root of the tolerance."""
    errors, steps = [], []
    with Master(oscillator) as master:
        for tolerance in (1e-3, 1e-4, 1e-5, 1e-6):
            master.initialize()
            run = master.run_adaptive(3.0, 0.5, tolerance, algorithm)
            errors.append(np.abs(run["y.y"] - np.sin(run.time_s)).max())
            steps.append(run.steps)
            np.testing.assert_array_equal(run.time_s, 0.5 * np.arange(7))
    orders = -np.diff(np.log10(errors))
    assert np.all(np.abs(orders - 0.5) < 0.12), (errors, orders)
    assert np.all(np.diff(np.log10(steps)) < 0.65), steps


def test_step_length_follows_the_solution(oscillator: System) -> None:
    """A slow stretch after a fast one: the ring dies out as both gains are small."""
    with Master(oscillator) as master:
        master.initialize(starts={"v.k": -100.0, "y.k": 1.0})
        fast = master.run_adaptive(1.0, 0.1, 1e-4)
        master.initialize(starts={"v.k": -0.01, "y.k": 1.0})
        slow = master.run_adaptive(1.0, 0.1, 1e-4)
    assert slow.steps < fast.steps / 5
    assert fast.rejected > 0


def test_output_instants_do_not_drift(oscillator: System) -> None:
    with Master(oscillator) as master:
        master.initialize(10.0)
        first = master.run_adaptive(10.7, 0.1, 1e-3)
        second = master.run_adaptive(11.0, 0.1, 1e-3)
    np.testing.assert_array_equal(first.time_s, 10.0 + 0.1 * np.arange(8))
    assert second.time_s[-1] == pytest.approx(11.0, abs=1e-15)


def test_rollback_takes_the_noise_back(noisy: System) -> None:
    """Whatever was rejected in between, the k-th draw is the k-th draw."""
    with Master(noisy) as master:
        master.initialize()
        controlled = master.run_adaptive(3.0, 0.15, 1e-5)
        master.initialize()
        fixed = master.run(3.0, 0.03)
    assert controlled.rejected > 0
    gyro = controlled["imu.gyro_x"]
    assert len(np.unique(gyro)) == len(gyro)
    assert gyro.tobytes() == fixed["imu.gyro_x"][::5].tobytes()


def test_steps_end_at_sample_instants(noisy: System, monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[tuple[float, float]] = []
    step = Slave.step

    def spy(slave: Slave, time_s: float, step_s: float) -> None:
        if slave.name == "imu":
            taken.append((time_s, time_s + step_s))
        step(slave, time_s, step_s)

    monkeypatch.setattr(Slave, "step", spy)
    with Master(noisy) as master:
        master.initialize(1.0)
        master.run_adaptive(1.5, 0.1, 1e-4)
    ends = np.array([end for _, end in taken])
    for begin, end in taken:
        first = np.floor((begin - 1.0) / 0.03 + 1e-6) + 1
        assert 1.0 + first * 0.03 >= end - 1e-9
    for instant in 1.0 + 0.03 * np.arange(1, 17):
        assert np.abs(ends - instant).min() < 1e-12


@pytest.mark.parametrize("fmi", [2, 3])
def test_saved_states(fmus: dict[str, Path], fmi: int) -> None:
    slave = Slave("y", fmus[f"integrator{fmi}"])
    try:
        slave.bind(["u"], ["y"], np.array([2.0]), np.zeros(1))
        slave.initialize(0.0, {})
        slave.finish_initialization()
        slave.write_inputs()
        start = slave.save()
        for _ in range(2):
            slave.step(0.0, 0.5)
            assert slave.get("y") == pytest.approx(1.0)
            slave.restore(start)
            assert slave.get("y") == 0.0
        slave.step(0.0, 0.25)
        assert slave.save(start) is start
        slave.step(0.25, 0.25)
        slave.restore(start)
        assert slave.get("y") == pytest.approx(0.5)
        slave.free(start)
        slave.free(start)
        slave.save()  # left to close()
    finally:
        slave.close()


def test_refusals(oscillator: System, fmus: dict[str, Path]) -> None:
    stiff = altered(fmus["integrator2"], "stateless.fmu", NO_STATES)
    other = replace(oscillator, fmus={**oscillator.fmus, "y": stiff})
    with Master(other) as master:
        master.initialize()
        with pytest.raises(FmuError, match=r"y \(stateless\.fmu\): step-size control needs"):
            master.run_adaptive(1.0, 0.1, 1e-3)
        with pytest.raises(FmuError, match=r"cannot save its state"):
            master.slaves[0].save()
        master.run(1.0, 0.1)
    with Master(replace(oscillator, periods={"y": 2})) as master:
        master.initialize()
        with pytest.raises(FmuError, match=r"periods of slaves exclude each other"):
            master.run_adaptive(1.0, 0.1, 1e-3)
    with Master(oscillator) as master:
        master.initialize()
        with pytest.raises(FmuError, match=r"tolerance = 0: needs a positive number"):
            master.run_adaptive(1.0, 0.1, 0.0)
        with pytest.raises(FmuError, match=r"not a whole number of steps of 0\.3"):
            master.run_adaptive(1.0, 0.3, 1e-3)
        with pytest.raises(FmuError, match=r"error of \w\.y is still .* times the tolerance"):
            master.run_adaptive(1.0, 0.1, 1e-18)
        with pytest.raises(FmuError, match=r"call initialize"):
            master.run(2.0, 0.1)


# -- the parts ------------------------------------------------------------------------------


def test_grid() -> None:
    grid = Grid(1.0, 0.1)
    instants = [1.0]
    while instants[-1] < 1.95:
        instants.append(grid.after(instants[-1]))
    np.testing.assert_allclose(instants, 1.0 + 0.1 * np.arange(11), rtol=1e-15)
    assert grid.after(1.1 - 1e-9) == pytest.approx(1.2)  # that is 1.1 with rounding errors


def test_control_against_a_known_error() -> None:
    """An error of c h**2 settles at the tolerance; crumbs before an instant are avoided."""
    control = Control(("y",), np.ones(1), 1e-4, 1e-9, 1.0)
    tried = []
    for _ in range(30):
        h = control.length(10.0)
        control.accepts(0.0, h, np.array([3.0 * h * h]), np.zeros(1))
        tried.append(h)
    assert tried[-1] == pytest.approx(0.9 * np.sqrt(1e-4 / 3.0), rel=1e-9)
    assert control.rejected >= 1
    control.step_s = 0.4
    lengths, left = [], 1.0
    while left > 1e-12:
        lengths.append(control.length(left))
        left -= lengths[-1]
    assert lengths == pytest.approx([0.4, 0.3, 0.3])
    assert all(b <= a for a, b in pairwise(lengths))
