"""One system in five hands: Python, our master with FMI 2 and FMI 3, libcosim, ecos.

The importers run in processes of their own: a crash of theirs is a failed test, not the end of
all tests.
"""

import importlib
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from cosim.master import Algorithm, Master
from cosim.system import System, connect
from fmus import build, component_model
from twin.airframe import airframe
from twin.component import Component
from twin.imu import imu
from twin.vehicle_file import load_vehicle

Array = NDArray[np.float64]
STEP_S, STEPS = 1e-3, 2000
AIRFRAME_STARTS = {
    "initial.omega_x": 0.7,
    "initial.omega_z": -0.4,
    "initial.vel_x": 3.0,
    "initial.q_x": 0.1,
    "wind_x": 2.5,
    "wind_y": -1.5,
    "mass": 1.5,
    "drag.linear_x": 0.3,
    "drag.quadratic_y": 0.05,
}
IMU_STARTS = {"acc_bias_z": 0.05, "position_x": 0.03, "gyro_bias_y": -0.01}
STARTS = {f"airframe.{n}": v for n, v in AIRFRAME_STARTS.items()} | {
    f"imu.{n}": v for n, v in IMU_STARTS.items()
}


@cache
def components() -> tuple[Component, Component]:
    """An airframe and an IMU whose accelerometer has states and whose gyroscope has none."""
    vehicle = replace(load_vehicle("copter_default"), accel_cutoff_hz=80.0)
    return airframe(vehicle), imu(vehicle)


def output_names() -> list[str]:
    return [f"{c.name}.{n}" for c in components() for n in c.output_names]


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> dict[int, dict[str, Path]]:
    folder = tmp_path_factory.mktemp("importers")
    return {
        fmi: {
            c.name: build(component_model(c), folder / f"{c.name}{fmi}.fmu", fmi)
            for c in components()
        }
        for fmi in (2, 3)
    }


def our_master(paths: dict[str, Path]) -> Master:
    _, sensor = components()
    system = System(paths, connect("airframe", "imu", sensor.input_names), STARTS)
    master = Master(system, output_names())
    master.initialize()
    return master


def with_master(paths: dict[str, Path], algorithm: Algorithm) -> Array:
    """Outputs at every communication point, shape (STEPS + 1, n)."""
    with our_master(paths) as master:
        return master.run(STEPS * STEP_S, STEP_S, algorithm).values


def with_python() -> Array:
    """The same by hand: both step from what was there at the start of the step."""
    body, sensor = components()
    p = [
        c.parameter_values({n: v for n, v in starts.items() if n not in c.input_names})
        for c, starts in ((body, AIRFRAME_STARTS), (sensor, IMU_STARTS))
    ]
    u = body.input_values({n: v for n, v in AIRFRAME_STARTS.items() if n in body.input_names})
    taken = [body.output_names.index(n) for n in sensor.input_names]

    def outputs(c: Component, x: Array, u: Array, p: Array) -> Array:
        return np.asarray(c.outputs(x, u, p), dtype=np.float64).ravel()

    x = np.asarray(body.initial(u, p[0]), dtype=np.float64).ravel()
    y = outputs(body, x, u, p[0])
    felt = y[taken]
    z = np.asarray(sensor.initial(felt, p[1]), dtype=np.float64).ravel()
    rows = [np.concatenate([y, outputs(sensor, z, felt, p[1])])]
    for _ in range(STEPS):
        felt = y[taken]
        x, z = body.advance(x, u, p[0], STEP_S), sensor.advance(z, felt, p[1], STEP_S)
        y = outputs(body, x, u, p[0])
        # The gyroscope still shows the input of the step: that is Jacobi.
        rows.append(np.concatenate([y, outputs(sensor, z, felt, p[1])]))
    return np.array(rows)


@pytest.fixture(scope="module")
def ours(fmus: dict[int, dict[str, Path]]) -> Array:
    return with_master(fmus[2], "jacobi")


def test_fmi3_is_fmi2_to_the_bit(fmus: dict[int, dict[str, Path]], ours: Array) -> None:
    assert np.abs(np.diff(ours, axis=0)).max() > 1e-3  # it flies
    assert with_master(fmus[3], "jacobi").tobytes() == ours.tobytes()


def test_python_is_the_fmu(ours: Array) -> None:
    """CasADi's interpreter against its C code: relative to the size of each signal."""
    python = with_python()
    scale = np.maximum(np.abs(ours).max(axis=0), 1e-3)
    assert np.max(np.abs(python - ours) / scale) <= 1e-12


def needs(package: str) -> None:
    """Skip without the package, or fail where every test counts."""
    try:
        importlib.import_module(package)
    except (ImportError, OSError) as error:
        message = f"{package} cannot be imported: {error}"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)


def seen_by(package: str, paths: dict[str, Path], folder: Path) -> Array:
    """Outputs after each step in another importer, shape (STEPS, n)."""
    needs(package)
    out = folder / "values.npy"
    command = [sys.executable, __file__, package, *map(str, paths.values()), str(out)]
    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert result.returncode == 0, result.stdout + result.stderr
    values: Array = np.load(out)
    assert values.shape == (STEPS, len(output_names()))
    return values


def test_libcosim_is_jacobi_to_the_bit(
    fmus: dict[int, dict[str, Path]], ours: Array, tmp_path: Path
) -> None:
    """libcosim counts nanoseconds, so its steps are 1 ms but for the last bit: so are ours here."""
    theirs = seen_by("libcosimpy", fmus[2], tmp_path)
    rows = []
    with our_master(fmus[2]) as master:
        for k in range(STEPS):
            start, stop = (n * 1_000_000 / 1e9 for n in (k, k + 1))
            rows.append(master.run(stop, stop - start, "jacobi").values[-1])
    assert np.array(rows).tobytes() == theirs.tobytes()
    np.testing.assert_allclose(theirs, ours[1:], rtol=0, atol=1e-12)


def test_ecos_is_settled_to_the_bit(fmus: dict[int, dict[str, Path]], tmp_path: Path) -> None:
    """ecos sets inputs once more after each step: feed-through outputs show the present."""
    theirs = seen_by("ecospy", fmus[2], tmp_path)
    assert with_master(fmus[2], "settled")[1:].tobytes() == theirs.tobytes()


# -- in the process of the importer ---------------------------------------------------------


def _with_libcosimpy(paths: Sequence[str]) -> Array:
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    execution = CosimExecution.from_step_size(round(STEP_S * 1e9))
    slave, reference = {}, {}
    for name, path in zip(("airframe", "imu"), paths, strict=True):
        slave[name] = execution.add_local_slave(CosimLocalSlave(path, name))
        for v in execution.slave_variables(slave[name]):
            reference[f"{name}.{v.name.decode()}"] = v.reference
    observer = CosimObserver.create_last_value()
    assert execution.add_observer(observer)
    for name, value in STARTS.items():
        assert execution.real_initial_value(slave[name.split(".")[0]], reference[name], value)
    for name in components()[1].input_names:
        execution.connect_real_variables(
            slave["airframe"], reference[f"airframe.{name}"], slave["imu"], reference[f"imu.{name}"]
        )
    groups = [
        (slave[c.name], [reference[f"{c.name}.{n}"] for n in c.output_names]) for c in components()
    ]
    rows = []
    for _ in range(STEPS):
        assert execution.step()
        rows.append([v for s, r in groups for v in observer.last_real_values(s, r)])
    return np.array(rows)


def _with_ecospy(paths: Sequence[str]) -> Array:
    from ecospy import EcosSimulation, EcosSimulationStructure

    def identifier(name: str) -> str:
        return name.replace(".", "::", 1)

    rows, names = [], [identifier(n) for n in output_names()]
    with EcosSimulationStructure() as structure:
        for name, path in zip(("airframe", "imu"), paths, strict=True):
            structure.add_model(name, path)
        for name in components()[1].input_names:
            structure.make_real_connection(f"airframe::{name}", f"imu::{name}")
        structure.add_parameter_set("starts", {identifier(n): v for n, v in STARTS.items()})
        with EcosSimulation(STEP_S, structure=structure) as simulation:
            simulation.init(parameter_set="starts")
            for _ in range(STEPS):
                simulation.step(1)
                rows.append([simulation.get_real(n) for n in names])
    return np.array(rows)


if __name__ == "__main__":
    run = {"libcosimpy": _with_libcosimpy, "ecospy": _with_ecospy}[sys.argv[1]]
    np.save(sys.argv[4], run(sys.argv[2:4]))
