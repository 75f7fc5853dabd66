"""libcosim and ecos run a system, two slaves or an .ssp, and tell all outputs after each step.

The importers run in processes of their own: a crash of theirs is a failed test, not the end of
all tests.
"""

import importlib
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from places import lacking

from twin.component import Component
from twin.physics.airframe import airframe
from twin.physics.sensors.imu import imu
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


def needs(package: str) -> None:
    """Skip without the package, or fail where every test counts."""
    try:
        importlib.import_module(package)
    except (ImportError, OSError) as error:
        lacking(False, f"{package} cannot be imported: {error}")


def in_process_of(package: str, out: Path, *arguments: str) -> Array:
    """What this file as a program, see its end, leaves in a file. Shape (STEPS, n)."""
    needs(package)
    command = [sys.executable, __file__, package, str(out), *arguments]
    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=900)
    assert result.returncode == 0, result.stdout + result.stderr
    values: Array = np.load(out)
    return values


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
