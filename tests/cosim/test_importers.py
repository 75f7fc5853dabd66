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
from cosim.ssp import write_ssp
from cosim.system import System, connect
from fmus import build, component_model
from twin.component import Component
from twin.physics.airframe import airframe
from twin.physics.battery import battery
from twin.physics.sensors.imu import imu
from twin.vehicle.file import load_vehicle

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
IMU_STARTS = {"position_z": 0.05, "position_x": 0.03, "acc_cutoff": 70.0}
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
    values = in_process_of(package, folder / "values.npy", *map(str, paths.values()))
    assert values.shape == (STEPS, len(output_names()))
    return values


def in_process_of(package: str, out: Path, *arguments: str) -> Array:
    """What this file as a program, see its end, leaves in a file."""
    needs(package)
    command = [sys.executable, __file__, package, str(out), *arguments]
    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert result.returncode == 0, result.stdout + result.stderr
    values: Array = np.load(out)
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


# -- the same as .ssp -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def trio(tmp_path_factory: pytest.TempPathFactory) -> System:
    """An airframe and its battery, which feel each other, and an IMU at a fifth of the rate."""
    vehicle, folder = load_vehicle("crazyflie"), tmp_path_factory.mktemp("trio")
    parts = (airframe(vehicle), battery(vehicle), imu(replace(vehicle, accel_cutoff_hz=80.0)))
    return System(
        {c.name: build(component_model(c), folder / f"{c.name}.fmu") for c in parts},
        connect("airframe", "imu", parts[2].input_names)
        + connect("airframe", "battery", ["ibat_a"])
        + connect("battery", "airframe", ["vbat_v"]),
        {
            **{f"airframe.cmd_{i}": 0.7 + 1e-5 * i for i in range(1, 5)},
            "airframe.initial.pos_z": -50.0,
            "airframe.initial.omega_x": 0.1,
            "airframe.wind_y": -1.5,
            "battery.initial.charge": 0.9,
            "imu.position_x": 0.03,
        },
        {"imu": 5},
        step_s=STEP_S,
    )


SSP_NAMES = ("airframe.pos_z", "airframe.omega_x", "battery.vbat_v", "imu.acc_z", "imu.gyro_x")


def ssp_seen_by(package: str, system: System, folder: Path) -> Array:
    ssp = write_ssp(system, folder / "trio.ssp")
    values = in_process_of(package, folder / "values.npy", str(ssp), *SSP_NAMES)
    assert values.shape == (STEPS, len(SSP_NAMES))
    assert np.ptp(values, axis=0).min() > 1e-7  # everything moves
    return values


def test_libcosim_reads_our_ssp(trio: System, tmp_path: Path) -> None:
    """Structure, start values, base step and the slower IMU: the bits of `jacobi`."""
    theirs = ssp_seen_by("libcosimpy", trio, tmp_path)
    with Master(trio, SSP_NAMES) as master:
        master.initialize()
        ours = master.run(STEPS * STEP_S, STEP_S, "jacobi").values[1:]
    # Their steps are 1 ms but for the last bit.
    np.testing.assert_allclose(theirs, ours, rtol=1e-12, atol=1e-12)


def test_ecos_reads_our_ssp(trio: System, tmp_path: Path) -> None:
    """The bits of `settled`. ecos reads no rates from SSP, so every slave steps at 1 ms, and after
    a step it passes values on by one link only, so the battery does not feed the airframe here."""
    forward = [c for c in trio.connections if not c.source.startswith("battery")]
    even = replace(trio, periods={}, connections=tuple(forward))
    theirs = ssp_seen_by("ecospy", even, tmp_path)
    with Master(even, SSP_NAMES) as master:
        master.initialize()
        ours = master.run(STEPS * STEP_S, STEP_S, "settled").values[1:]
    assert ours.tobytes() == theirs.tobytes()


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


def _ssp_with_libcosimpy(arguments: Sequence[str]) -> Array:
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimObserver import CosimObserver

    ssp, *names = arguments
    execution = CosimExecution.from_ssp_file(ssp)  # with the base step of the file
    observer = CosimObserver.create_last_value()
    assert execution.add_observer(observer)
    places = []
    for slave, _, name in (n.partition(".") for n in names):
        index = execution.slave_index_from_instance_name(slave)
        found = [v for v in execution.slave_variables(index) if v.name.decode() == name]
        places.append((index, [found[0].reference]))
    rows = []
    for _ in range(STEPS):
        assert execution.step()
        rows.append([observer.last_real_values(s, r)[0] for s, r in places])
    return np.array(rows)


def _ssp_with_ecospy(arguments: Sequence[str]) -> Array:
    from ecospy import EcosSimulation

    ssp, *names = arguments
    rows, names = [], [n.replace(".", "::", 1) for n in names]
    with EcosSimulation(STEP_S, ssp_path=ssp) as simulation:
        simulation.init(parameter_set="initialValues")
        for _ in range(STEPS):
            simulation.step(1)
            rows.append([simulation.get_real(n) for n in names])
    return np.array(rows)


if __name__ == "__main__":
    package, out, *arguments = sys.argv[1:]
    parts = {"libcosimpy": _with_libcosimpy, "ecospy": _with_ecospy}
    whole = {"libcosimpy": _ssp_with_libcosimpy, "ecospy": _ssp_with_ecospy}
    run = whole if arguments[0].endswith(".ssp") else parts
    np.save(out, run[package](arguments))
