"""Effects on the sensors: off is exactly absent, neutral is nothing, on is the definition."""

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from rig import Rig, plain, vec
from scipy.signal import periodogram
from scipy.spatial.transform import Rotation
from sensor_rig import Array, draws, effect_on, motion, readings

from twin.component import Component
from twin.effects import EFFECTS, Effect, effects_of
from twin.effects.sensors import IMU_CHANNELS
from twin.errors import ModelError
from twin.logs.columns import COLUMNS
from twin.physics.sensors.barometer import barometer
from twin.physics.sensors.imu import imu
from twin.physics.sensors.magnetometer import magnetometer
from twin.physics.sensors.position import position_sensor
from twin.vehicle import Vehicle

VEHICLE = plain(imu_position_m=np.array([0.05, -0.03, 0.02]), gyro_cutoff_hz=60.0)
MAKERS: dict[str, Callable[..., Component]] = {
    "imu": imu,
    "magnetometer": magnetometer,
    "barometer": barometer,
    "position": position_sensor,
}
NAMED = [e for component in MAKERS for e in effects_of(component)]
NOISE = {
    "imu": {"acc_noise": 0.1, "gyro_bias_walk": 0.01, "acc_bias_walk": 0.02, "gyro_noise": 0.01},
    "magnetometer": {"mag_noise": 1e-7, "mag_bias_walk": 1e-8},
    "barometer": {"baro_noise": 2.0, "baro_bias_walk": 0.3},
    "position": {"sample_period": 0.02},
}
TIMELY = {"stuck_sensor": {"stuck_sensor.time_s": 0.02}}


@pytest.mark.slow
@pytest.mark.parametrize("name", MAKERS)
def test_a_sensor_with_all_effects_off_is_the_one_without_to_the_last_bit(name: str) -> None:
    full, bare = MAKERS[name](VEHICLE, EFFECTS), MAKERS[name](VEHICLE)
    u = motion(full, 120)
    columns = [full.input_names.index(n) for n in bare.input_names]
    settings = {"seed": 3.0, **NOISE[name]}
    np.testing.assert_array_equal(
        readings(full, u, settings), readings(bare, u[:, columns], settings)
    )


@pytest.mark.slow
@pytest.mark.parametrize("effect", NAMED, ids=lambda e: e.name)
def test_an_effect_is_felt_at_its_start_value_and_not_at_its_neutral_one(effect: Effect) -> None:
    component = MAKERS[effect.component](VEHICLE, [effect.name])
    u = motion(component, 150)
    base = {**NOISE[effect.component], **TIMELY.get(effect.name, {}), "seed": 3.0}
    off = readings(component, u, base)
    on = readings(component, u, base | effect_on(effect.name))
    assert np.abs(on - off).max() > 1e-6 * np.abs(off).max()
    neutral = {
        f"{effect.name}.{p.name}": p.neutral
        for p in (p.sized(VEHICLE) for p in effect.parameters)
        if p.neutral is not None
    }
    same = readings(component, u, base | effect_on(effect.name) | neutral)
    np.testing.assert_allclose(same, off, rtol=1e-12, atol=1e-12 * np.abs(off).max())


def test_effects_need_columns_of_the_flight_table() -> None:
    columns = {c.name for c in COLUMNS}
    for effect in NAMED:
        for stem in effect.needs:
            assert any(c == stem or c.startswith(f"{stem}_") for c in columns), (effect.name, stem)


def test_effects_of_the_vehicle_are_on() -> None:
    biased = VEHICLE.with_effects({"accel_bias": {"x_m_s2": 0.7, "y_m_s2": 0.0, "z_m_s2": 0.0}})
    start = {v.name: v.start for v in imu(biased).parameters}
    assert (start["accel_bias.enabled"], start["accel_bias.x_m_s2"]) == (1.0, 0.7)
    assert "gyro_bias.enabled" not in start


# -- exact answers --------------------------------------------------------------------------

F, ALPHA, OMEGA = np.array([1.0, -2, -9]), np.array([3.0, -1, 4]), np.array([0.5, -1.5, 2.0])
MOVING = vec("specific_force", F) | vec("angular_acceleration", ALPHA) | vec("omega", OMEGA)


def read(vehicle: Vehicle, effect: str, **numbers: float) -> tuple[Array, Array]:
    """Accelerometer and gyroscope with one effect on."""
    rig = Rig(imu(vehicle, [effect]), effect_on(effect, **numbers))
    y = np.array(list(rig.outputs(rig.state(), rig.inputs(MOVING)).values()))
    return y[:3], y[3:]


def test_bias_and_scale() -> None:
    acc, gyro = read(plain(), "accel_bias", accel_bias__y_m_s2=0.5)
    np.testing.assert_allclose(acc, F + np.array([0.2, 0.5, 0.15]), rtol=1e-14)
    np.testing.assert_array_equal(gyro, OMEGA)
    acc, gyro = read(plain(), "gyro_bias", gyro_bias__z_rad_s=-0.1)
    np.testing.assert_allclose(gyro, OMEGA + np.array([0.02, -0.015, -0.1]), rtol=1e-14)
    np.testing.assert_array_equal(acc, F)
    np.testing.assert_allclose(read(plain(), "accel_scale")[0], F * [1.05, 0.96, 1.04])
    np.testing.assert_allclose(read(plain(), "gyro_scale")[1], OMEGA * [1.05, 0.96, 1.04])


def test_misalignment_is_a_rotation() -> None:
    """A sensor turned by a vector of angles sees the force turned the other way."""
    angles = np.array([0.05, -0.1, 0.08])
    numbers = dict(zip(("x_rad", "y_rad", "z_rad"), angles, strict=True))
    acc, _ = read(
        plain(), "accel_misalignment", **{f"accel_misalignment__{k}": v for k, v in numbers.items()}
    )
    assert np.linalg.norm(acc) == pytest.approx(np.linalg.norm(F), rel=1e-14)
    size = np.linalg.norm(angles)
    exact = angles / size * 2 * np.arctan(size / 2)
    np.testing.assert_allclose(acc, Rotation.from_rotvec(exact).inv().apply(F), rtol=1e-12)
    near = Rotation.from_rotvec(angles).inv().apply(F)
    np.testing.assert_allclose(acc, near, atol=float(np.linalg.norm(F) * size**3 / 12))


def test_lever_arm_adds_to_that_of_the_vehicle() -> None:
    vehicle = plain(imu_position_m=np.array([0.05, -0.03, 0.02]))
    more = {"imu_lever_arm__x_m": 0.1, "imu_lever_arm__y_m": 0.0, "imu_lever_arm__z_m": -0.04}
    arm = vehicle.imu_position_m + np.array([0.1, 0.0, -0.04])
    expected = F + np.cross(ALPHA, arm) + np.cross(OMEGA, np.cross(OMEGA, arm))
    np.testing.assert_allclose(read(vehicle, "imu_lever_arm", **more)[0], expected, rtol=1e-12)


def test_noise_level() -> None:
    """Scaled noise of the model and further noise, independent of each other."""
    sensor = imu(plain(), ["sensor_noise_level"])
    level = {"sensor_noise_level.scale": 2.0, "sensor_noise_level.accel_m_s2": 0.3}
    noisy = {"acc_noise": 0.2, "gyro_noise": 0.03, **effect_on("sensor_noise_level"), **level}
    y = draws(sensor, {**noisy, "sensor_noise_level.gyro_rad_s": 0.0}, 4000)
    assert y.std(axis=0) == pytest.approx([0.5] * 3 + [0.06] * 3, rel=0.06)
    bare = draws(sensor, effect_on("sensor_noise_level"), 4000)  # of a model without noise
    assert bare.std(axis=0) == pytest.approx([0.2] * 3 + [0.01] * 3, rel=0.06)


@pytest.mark.slow
@pytest.mark.parametrize("spin", [1.0, 1.3])
def test_vibration_is_at_the_rotor_frequency_and_grows_with_the_square_of_the_speed(
    spin: float,
) -> None:
    """Four rotors at one speed: one line per axis, four times the amplitude by RMS sum or less."""
    sensor = imu(plain(), ["vibration"])
    frequency = {"vibration__frequency_hz": 100.0, "vibration__accel_m_s2": 2.0}
    u = np.tile(
        sensor.input_values({"spin_1": spin, "spin_2": 0, "spin_3": 0, "spin_4": 0}), (500, 1)
    )
    y = readings(sensor, u, effect_on("vibration", **frequency, vibration__gyro_rad_s=0.1))
    for channel, amplitude, harmonic in ((0, 2.0, 1), (1, 2.0, 1), (2, 2.0, 2), (3, 0.1, 1)):
        f, power = periodogram(y[1:, channel], 1000.0, scaling="spectrum", detrend=False)
        strongest = np.argmax(power)
        assert f[strongest] == pytest.approx(harmonic * 100.0 * spin, abs=2.0)
        assert np.sqrt(2 * power.sum()) == pytest.approx(amplitude * spin**2, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("delay_s", [0.0, 0.0137, 0.2])
def test_imu_delay(delay_s: float) -> None:
    """A delay of whole and broken sample periods: the straight line between the samples."""
    sensor = imu(plain(), ["imu_delay"])
    u = motion(sensor, 400)
    prompt = readings(sensor, u)
    late = readings(sensor, u, effect_on("imu_delay", imu_delay__delay_s=delay_s))
    # Row k + 1 was read at (k + 1) ms with the inputs held since k ms.
    t = np.arange(len(prompt)) * 1e-3
    for i in range(6):
        np.testing.assert_allclose(late[:, i], np.interp(t - delay_s, t, prompt[:, i]), atol=1e-12)


def test_a_delay_that_does_not_fit_is_refused() -> None:
    sensor = imu(plain(), ["imu_delay"])
    with pytest.raises(ModelError, match=r"acc_x = 0\.3 s must be from 0 to 0\.25 s"):
        readings(sensor, motion(sensor, 2), effect_on("imu_delay", imu_delay__delay_s=0.3))


@pytest.mark.slow
@pytest.mark.parametrize("channel", range(1, 7))
def test_a_stuck_channel_repeats_its_last_value(channel: int) -> None:
    sensor = imu(plain(), ["stuck_sensor"])
    u = motion(sensor, 100)
    settings = {"acc_noise": 0.1, "gyro_noise": 0.1, "seed": 8.0}
    free = readings(sensor, u, settings)
    when = {"stuck_sensor__channel": float(channel), "stuck_sensor__time_s": 0.05}
    stuck = readings(sensor, u, settings | effect_on("stuck_sensor", **when))
    others = [i for i in range(6) if i != channel - 1]
    np.testing.assert_array_equal(stuck[:, others], free[:, others])
    np.testing.assert_array_equal(stuck[:50], free[:50])
    assert np.unique(stuck[50:, channel - 1]).size == 1
    assert IMU_CHANNELS[channel - 1] == sensor.output_names[channel - 1]


@pytest.mark.parametrize("name", MAKERS)
@pytest.mark.parametrize("on", [0.0, 1.0])
def test_derivatives_are_finite_with_and_without_noise(name: str, on: float) -> None:
    """Of the readings at the first instant against inputs and parameters."""
    component = MAKERS[name](VEHICLE, EFFECTS)
    sampling = component.sampling
    assert sampling is not None
    u, p = (ca.SX.sym(n, len(v)) for n, v in (("u", component.inputs), ("p", component.parameters)))
    x = component.initial(u, p)
    draw = np.ones(sampling.channels)
    y = component.outputs(sampling.update(x, u, p, draw, sampling.signals(x, u, p)), u, p)
    slopes = ca.Function("slopes", [u, p], [ca.jacobian(y, ca.vertcat(u, p))])
    switches = {v.name: on for v in component.parameters if v.name.endswith(".enabled")}
    silent = {v.name: 0.0 for v in component.parameters if "noise" in v.name} | switches
    for parameters in (switches, silent):
        values = slopes(component.input_values(), component.parameter_values(parameters))
        assert np.all(np.isfinite(np.asarray(values)))
