"""One system in five hands: Python, our master with FMI 2 and FMI 3, libcosim, ecos."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from importer_rig import (
    AIRFRAME_STARTS,
    IMU_STARTS,
    STARTS,
    STEP_S,
    STEPS,
    Array,
    components,
    in_process_of,
    output_names,
)

from cosim.master import Algorithm, Master
from cosim.ssp import write_ssp
from cosim.system import System, connect
from fmus import build, component_model
from twin.component import Component
from twin.physics.airframe import airframe
from twin.physics.battery import battery
from twin.physics.sensors.imu import imu
from twin.vehicle_file import load_vehicle


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


@pytest.mark.slow
def test_fmi3_is_fmi2_to_the_bit(fmus: dict[int, dict[str, Path]], ours: Array) -> None:
    assert np.abs(np.diff(ours, axis=0)).max() > 1e-3  # it flies
    assert with_master(fmus[3], "jacobi").tobytes() == ours.tobytes()


@pytest.mark.slow
def test_python_is_the_fmu(ours: Array) -> None:
    """CasADi's interpreter against its C code: relative to the size of each signal."""
    python = with_python()
    scale = np.maximum(np.abs(ours).max(axis=0), 1e-3)
    assert np.max(np.abs(python - ours) / scale) <= 1e-12


def seen_by(package: str, paths: dict[str, Path], folder: Path) -> Array:
    """Outputs after each step in another importer, shape (STEPS, n)."""
    values = in_process_of(package, folder / "values.npy", *map(str, paths.values()))
    assert values.shape == (STEPS, len(output_names()))
    return values


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_libcosim_reads_our_ssp(trio: System, tmp_path: Path) -> None:
    """Structure, start values, base step and the slower IMU: the bits of `jacobi`."""
    theirs = ssp_seen_by("libcosimpy", trio, tmp_path)
    with Master(trio, SSP_NAMES) as master:
        master.initialize()
        ours = master.run(STEPS * STEP_S, STEP_S, "jacobi").values[1:]
    # Their steps are 1 ms but for the last bit.
    np.testing.assert_allclose(theirs, ours, rtol=1e-12, atol=1e-12)


@pytest.mark.slow
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
