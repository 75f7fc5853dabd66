"""Sensors as native FMUs, every effect, noise and delay switched on: the bits of the Python run."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from fmpy.validation import validate_fmu
from instance import Array, Instance, unzip
from sensor_rig import motion, readings

from fmus import build, component_model
from twin.component import Component
from twin.effects import EFFECTS, effects_of
from twin.physics.sensors.barometer import barometer
from twin.physics.sensors.imu import imu
from twin.physics.sensors.magnetometer import magnetometer
from twin.physics.sensors.position import position_sensor
from twin.vehicle_file import load_vehicle

STEPS = 2000
VEHICLE = replace(load_vehicle("crazyflie"), accel_cutoff_hz=80.0)
MAKERS: dict[str, Callable[[], Component]] = {
    "imu": lambda: imu(VEHICLE, EFFECTS),
    "magnetometer": lambda: magnetometer(VEHICLE, EFFECTS),
    "barometer": lambda: barometer(VEHICLE, EFFECTS),
    "gnss": lambda: position_sensor(VEHICLE, EFFECTS),
    "mocap": lambda: position_sensor(VEHICLE, EFFECTS, "mocap"),
}
SETTINGS = {
    "imu": {
        "acc_noise": 0.1,
        "gyro_noise": 0.01,
        "acc_bias_walk": 0.02,
        "gyro_bias_walk": 0.003,
        "imu_delay.delay_s": 0.0123,
        "stuck_sensor.time_s": 1.2,
        "sample_period": 0.0035,  # no multiple of the communication step
    },
    "magnetometer": {"mag_noise": 1e-7, "mag_bias_walk": 1e-8, "sample_period": 0.0105},
    "barometer": {"baro_noise": 2.0, "baro_bias_walk": 0.3},
    "gnss": {"position_delay.delay_s": 0.037, "frame_yaw": 0.3, "sample_period": 0.02},
    "mocap": {"position_delay.delay_s": 0.037, "frame_yaw": 0.3, "antenna_x": 0.1},
}


@cache
def sensor(name: str) -> Component:
    return MAKERS[name]()


def settings(name: str) -> dict[str, float]:
    names = {v.name for v in sensor(name).parameters}
    switches = {f"{e}.enabled": 1.0 for e in EFFECTS if f"{e}.enabled" in names}
    return {**switches, **SETTINGS[name], "seed": 11.0}


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, int], Path]:
    """(sensor, FMI version) -> FMU."""
    folder = tmp_path_factory.mktemp("sensors")

    @cache
    def built(name: str, fmi: int) -> Path:
        return build(component_model(sensor(name)), folder / f"{name}-{fmi}.fmu", fmi)

    return built


def fly(instance: Instance, inputs: tuple[str, ...], u: Array, first: int = 0) -> Array:
    """Outputs after each step of a millisecond with the inputs held."""
    rows = []
    for k, row in enumerate(u, start=first):
        instance.set(dict(zip(inputs, row, strict=True)))
        instance.step(k * 1e-3)
        rows.append(instance.outputs())
    return np.array(rows)


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", MAKERS)
def test_python_and_fmu_give_the_same_bits(
    name: str, fmi: int, archive: Callable[[str, int], Path], tmp_path: Path
) -> None:
    component = sensor(name)
    u = motion(component, STEPS)
    instance = Instance(unzip(archive(name, fmi), tmp_path))
    first = dict(zip(component.input_names, u[0], strict=True))
    instance.start({**first, **settings(name)})
    start = instance.outputs()
    got = np.vstack([start, fly(instance, component.input_names, u)])
    instance.close()
    np.testing.assert_array_equal(got, readings(component, u, settings(name)))
    assert np.all(np.ptp(got, axis=0) > 0)


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", MAKERS)
def test_rollback_is_exact(
    name: str, fmi: int, archive: Callable[[str, int], Path], tmp_path: Path
) -> None:
    """Saved at random instants, run on, restored, run again: equal to the last bit."""
    component = sensor(name)
    u = motion(component, 1000)
    instance = Instance(unzip(archive(name, fmi), tmp_path)).start(settings(name))
    word = "FMUstate" if fmi == 2 else "FMUState"
    get, put, free = (getattr(instance.fmu, verb + word) for verb in ("get", "set", "free"))
    rng = np.random.default_rng(1)
    done = 0
    for _ in range(30):
        ahead = int(rng.integers(1, 20))
        fly(instance, component.input_names, u[done : done + ahead], done)
        done += ahead
        saved, coming = get(), u[done : done + 25]
        once = fly(instance, component.input_names, coming, done)
        put(saved)
        np.testing.assert_array_equal(fly(instance, component.input_names, coming, done), once)
        put(saved)
        free(saved)
    instance.close()


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", MAKERS)
def test_descriptions_are_valid(name: str, fmi: int, archive: Callable[[str, int], Path]) -> None:
    assert validate_fmu(str(archive(name, fmi))) == []


def test_all_sensor_effects_are_among_those_tested() -> None:
    tested = {p.removesuffix(".enabled") for name in MAKERS for p in settings(name)}
    for part in ("imu", "magnetometer", "barometer", "position"):
        assert {e.name for e in effects_of(part)} <= tested
