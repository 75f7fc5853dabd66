"""IMU and battery against kinematics, filter theory and the exact discharge."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rig import Rig, plain, vec
from scipy.signal import cont2discrete, lfilter
from scipy.spatial.transform import Rotation
from sensor_rig import draws

from twin.component import Run
from twin.component.along import accumulated
from twin.errors import ModelError
from twin.physics.battery import battery
from twin.physics.sensors.imu import imu
from twin.vehicle.vehicle import Sensors
from twin.vehicle_file import load_vehicle

ARM = np.array([0.05, -0.03, 0.02])
vectors = st.tuples(*[st.floats(-20, 20)] * 3).map(np.array)


def sensor(**changes: object) -> Rig:
    return Rig(imu(plain(imu_position_m=ARM, **changes)))


def read(rig: Rig, f: np.ndarray, alpha: np.ndarray, omega: np.ndarray) -> dict[str, float]:
    u = rig.inputs(
        {**vec("specific_force", f), **vec("angular_acceleration", alpha), **vec("omega", omega)}
    )
    return rig.outputs(rig.state(), u)


@pytest.mark.parametrize("alpha", [0.0, 4.0])
def test_lever_arm_on_a_turntable(alpha: float) -> None:
    """Sensor at r on a body turning about a fixed axis through its CoM: the second derivative of
    its path, taken numerically in space and turned into body axes."""
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    rate, t = 3.0, 0.4

    def turned(t: float) -> Rotation:
        return Rotation.from_rotvec(axis * (rate * t + alpha * t**2 / 2))

    h = 1e-3
    path = [turned(t + k * h).apply(ARM) for k in (-2, -1, 0, 1, 2)]
    acceleration = np.array([-1, 16, -30, 16, -1]) @ np.array(path) / (12 * h * h)
    y = read(sensor(), np.zeros(3), axis * alpha, axis * (rate + alpha * t))
    felt = turned(t).apply([y[f"acc_{a}"] for a in "xyz"])
    np.testing.assert_allclose(felt, acceleration, atol=1e-7)


@given(f=vectors, alpha=vectors, omega=vectors)
@settings(max_examples=40, deadline=None)
def test_lever_arm_formula(f: np.ndarray, alpha: np.ndarray, omega: np.ndarray) -> None:
    y = read(_SENSOR, f, alpha, omega)
    expected = f + np.cross(alpha, ARM) + np.cross(omega, np.cross(omega, ARM))
    np.testing.assert_allclose([y[f"acc_{a}"] for a in "xyz"], expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal([y[f"gyro_{a}"] for a in "xyz"], omega)


_SENSOR = sensor()


def test_sensor_at_the_centre_of_mass_reads_the_specific_force() -> None:
    rig = Rig(imu(plain()))
    y = read(rig, np.array([1.0, 2, -9]), np.full(3, 50.0), np.full(3, 8.0))
    assert [y[f"acc_{a}"] for a in "xyz"] == [1.0, 2.0, -9.0]


def test_low_pass_against_the_exact_zero_order_hold() -> None:
    """Butterworth of second order: w^2 / (s^2 + sqrt(2) w s + w^2), input held over the step."""
    rig = Rig(imu(plain(gyro_cutoff_hz=30.0)))
    rng = np.random.default_rng(1)
    signal = rng.standard_normal(300)
    w, h = 2 * np.pi * 30.0, 1e-3
    numerator, denominator, _ = cont2discrete(([w * w], [1, np.sqrt(2) * w, w * w]), h)
    exact = lfilter(numerator[0], denominator, signal)
    x, measured = rig.state(), []
    for value in signal:
        u = rig.inputs({"omega_x": value})
        measured.append(rig.outputs(x, u)["gyro_x"])
        x = rig.component.advance(x, u, rig.p, h)
    # The truncation of RK4, (w h)^5 / 120 a step.
    np.testing.assert_allclose(measured, exact, atol=5e-5)
    assert np.ptp(exact) > 0.5


@pytest.mark.parametrize("ratio", [0.2, 1.0, 3.0])
def test_low_pass_frequency_response(ratio: float) -> None:
    """Gain 1 / sqrt(1 + (f / fc)^4): 0.707 and a quarter turn behind at the cutoff."""
    cutoff, h = 20.0, 1e-4
    f = ratio * cutoff
    rig = Rig(imu(plain(accel_cutoff_hz=cutoff)))
    n = round(4 / f / h) + round(0.2 / h)
    t = h * np.arange(n)
    names = list(rig.component.input_names)
    u = np.zeros((n, len(names)))
    u[:, names.index("specific_force_z")] = np.sin(2 * np.pi * f * (t + h / 2))  # middle of a hold
    held = [np.broadcast_to(v, (n, np.size(v))) for v in (rig.p, h)]
    (states,) = accumulated(rig.component.step, rig.state(), u, *held)
    z = rig.get(states, "acc_lp_z")[:, 0]
    late = t > 0.2
    waves = np.stack([np.sin(2 * np.pi * f * (t + h)), np.cos(2 * np.pi * f * (t + h))], axis=-1)
    (a, b), *_ = np.linalg.lstsq(waves[late], z[late], rcond=None)
    response = 1 / ((1j * ratio) ** 2 + np.sqrt(2) * 1j * ratio + 1)
    assert abs(a + 1j * b - response) < 2e-4
    assert abs(response) == pytest.approx(1 / np.sqrt(1 + ratio**4), rel=1e-12)


def test_low_pass_starts_settled() -> None:
    component = imu(plain(accel_cutoff_hz=10.0))
    rig = Rig(component)
    u = rig.inputs({"specific_force_z": -9.8})
    x = np.asarray(component.initial(u, rig.p), dtype=np.float64).ravel()
    states = rig.fly(x, u, 0.5)
    np.testing.assert_allclose(rig.get(states, "acc_lp_z"), -9.8, rtol=1e-12)


def test_cutoff_that_rk4_cannot_follow_is_refused() -> None:
    with pytest.raises(ModelError, match=r"gyro_cutoff = 500 Hz is outside its range"):
        imu(plain(gyro_cutoff_hz=500.0))


# -- battery ------------------------------------------------------------------------------


def test_discharge_is_exact() -> None:
    """At constant current the charge falls on a line, and the voltage stands R I below it."""
    data = load_vehicle("crazyflie").battery
    rig = Rig(battery(load_vehicle("crazyflie")), {"initial.charge": 0.9})
    current, seconds = 3.0, 60.0
    states = rig.fly(rig.state(), rig.inputs({"ibat_a": current}), seconds)
    charge = 0.9 - current * 1e-3 * np.arange(len(states)) / 900.0  # 250 mAh = 900 A s
    np.testing.assert_allclose(rig.get(states, "charge")[:, 0], charge, rtol=1e-11)
    y = rig.outputs(states[-1], rig.inputs({"ibat_a": current}))
    assert y["vbat_v"] == pytest.approx(3.0 + 1.2 * charge[-1] - 0.2 * current, rel=1e-11)
    assert data is not None
    assert data.capacity_a_s == pytest.approx(900.0)


def test_open_circuit_voltage_at_both_ends() -> None:
    component = battery(load_vehicle("crazyflie"))
    for charge, voltage in ((1.0, 4.2), (0.0, 3.0)):
        rig = Rig(component, {"initial.charge": charge, "initial.current": 0.0})
        y = rig.outputs(rig.state(), rig.inputs({"ibat_a": 0.0}))
        assert y["vbat_v"] == pytest.approx(voltage)


def test_vehicle_without_battery_is_said() -> None:
    with pytest.raises(ModelError, match=r"feisi_x150.*\[battery\]"):
        battery(load_vehicle("feisi_x150"))


def test_hover_draws_the_hover_current() -> None:
    """And double thrust draws 2^1.5 of it (induced power)."""
    from twin.physics.airframe import airframe

    vehicle = load_vehicle("crazyflie")
    rig = Rig(airframe(vehicle))
    assert rig.outputs(rig.state(), rig.inputs())["ibat_a"] == pytest.approx(2.1, rel=1e-9)
    light = Rig(airframe(replace(vehicle, mass_kg=vehicle.mass_kg / 2)), {"mass": 0.027})
    drawn = light.outputs(light.state(), light.inputs())["ibat_a"]
    assert drawn == pytest.approx(2.1 * 0.5**1.5, rel=1e-6)


@pytest.mark.slow
def test_noise_and_bias_walk_of_the_imu() -> None:
    """White noise has the size asked for; the walk's spread grows with the root of time."""
    sensor = imu(load_vehicle("copter_default"))
    white = draws(sensor, {"acc_noise": 0.2, "gyro_noise": 0.03}, 4000)
    assert white.std(axis=0) == pytest.approx([0.2] * 3 + [0.03] * 3, rel=0.05)
    assert np.abs(np.corrcoef(white.T) - np.eye(6)).max() < 0.07  # axes differ
    walks = np.array(
        [draws(sensor, {"gyro_bias_walk": 0.5}, 401, k)[[100, 400]] for k in range(60)]
    )
    early, late = walks[:, :, 3:].std(axis=(0, 2))
    assert late == pytest.approx(0.5 * np.sqrt(4.01), rel=0.17)  # 180 walks
    assert late / early == pytest.approx(2.0, rel=0.25)
    assert np.all(walks[:, :, :3] == 0.0)


def test_the_vehicle_file_sets_the_noise() -> None:
    quiet, loud = imu(plain()), imu(plain(sensors=Sensors(accel_noise_m_s2=0.3)))
    assert {v.name: v.start for v in quiet.parameters}["acc_noise"] == 0.0
    assert {v.name: v.start for v in loud.parameters}["acc_noise"] == 0.3


def test_an_imu_without_noise_is_the_ideal_one() -> None:
    sensor = imu(load_vehicle("copter_default"))
    u = sensor.input_values({"specific_force_z": -9.8})
    run = Run(sensor, u, sensor.parameter_values({"seed": 4}))
    run.step(0.0, 0.01, u)
    assert run.outputs(u).tolist() == [0.0, 0.0, -9.8, 0.0, 0.0, 0.0]
