"""Position sensor: geometry of antenna and frame, delay, sample and hold, noise."""

import numpy as np
import pytest
from rig import plain, q, vec
from scipy.spatial.transform import Rotation
from sensor_rig import draws, effect_on

from twin.component import Run
from twin.effects import EFFECTS
from twin.frames import from_euler, rotation_vector
from twin.physics.sensors.position import PRESETS, position_sensor
from twin.vehicle.vehicle import Sensors

QUIET = {f"{stem}_noise_{a}": 0.0 for stem in ("pos", "vel") for a in "xyz"} | {
    f"pos_walk_{a}": 0.0 for a in "xyz"
}
MOCAP = position_sensor(plain(), EFFECTS, "mocap")
GNSS = position_sensor(plain(), EFFECTS)
PLACE, SPEED, RATE = np.array([1.0, -2, -3]), np.array([4.0, 5, -6]), np.array([0.3, -0.2, 0.9])
ATTITUDE = from_euler(0.2, -0.3, 1.1)
STILL = vec("pos", PLACE) | vec("vel", SPEED) | q(ATTITUDE) | vec("omega", RATE)


def at_start(**parameters: float) -> dict[str, float]:
    """What motion capture without noise reads at the start."""
    p = MOCAP.parameter_values({**QUIET, "attitude_noise": 0.0, **parameters})
    u = MOCAP.input_values(STILL)
    return dict(zip(MOCAP.output_names, Run(MOCAP, u, p).outputs(u).tolist(), strict=True))


def three(y: dict[str, float], stem: str) -> np.ndarray:
    return np.array([y[f"meas_{stem}_{a}"] for a in "xyz"])


def test_without_errors_the_motion_comes_out() -> None:
    y = at_start()
    np.testing.assert_array_equal(three(y, "pos"), PLACE)
    np.testing.assert_array_equal(three(y, "vel"), SPEED)
    np.testing.assert_allclose([y[f"meas_q_{a}"] for a in "wxyz"], ATTITUDE, atol=1e-15)


def test_the_antenna_moves_with_the_body() -> None:
    arm = np.array([0.1, 0.2, -0.3])
    y = at_start(**vec("antenna", arm))
    body = Rotation.from_quat(ATTITUDE, scalar_first=True)
    np.testing.assert_allclose(three(y, "pos"), PLACE + body.apply(arm), rtol=1e-12)
    np.testing.assert_allclose(three(y, "vel"), SPEED + body.apply(np.cross(RATE, arm)), rtol=1e-12)


def test_the_frame_of_the_sensor_is_turned_and_shifted() -> None:
    yaw, shift = 0.7, np.array([10.0, 20, 30])
    y = at_start(frame_yaw=yaw, **vec("frame", shift))
    turn = Rotation.from_rotvec([0, 0, yaw])
    np.testing.assert_allclose(three(y, "pos"), turn.apply(PLACE) + shift, rtol=1e-12)
    np.testing.assert_allclose(three(y, "vel"), turn.apply(SPEED), rtol=1e-12)
    attitude = np.array([y[f"meas_q_{a}"] for a in "wxyz"])
    expected = turn * Rotation.from_quat(ATTITUDE, scalar_first=True)
    assert (expected.inv() * Rotation.from_quat(attitude, scalar_first=True)).magnitude() < 1e-12


@pytest.mark.parametrize(("delay_s", "effect_s"), [(0.0, 0.0), (0.11, 0.0), (0.08, 0.05)])
def test_late_samples_of_a_constant_speed(delay_s: float, effect_s: float) -> None:
    """Position on a line, sampled at 10 Hz: held between samples and exactly the delay behind.

    Before the start the aircraft counts as having stood where it started.
    """
    settings = effect_on("position_delay", position_delay__delay_s=effect_s) if effect_s else {}
    p = GNSS.parameter_values({**QUIET, "delay": delay_s, **settings})
    total = delay_s + effect_s

    def inputs(t: float) -> np.ndarray:
        return GNSS.input_values({"pos_x": 3.0 * t, "vel_x": 3.0})

    step = 0.01
    run = Run(GNSS, inputs(0.0), p)
    for k in range(60):
        run.step(k * step, step, inputs((k + 1) * step))
        sampled = np.floor((k + 1) * step / 0.1 + 1e-9) * 0.1
        read = run.outputs(inputs(9e9))[0]  # nothing of the present comes through
        assert read == pytest.approx(3.0 * max(sampled - total, 0.0), abs=1e-9)


def test_preset_noise() -> None:
    y = draws(MOCAP, {"pos_walk_x": 0.0}, 3000)
    assert y[:, :3].std(axis=0) == pytest.approx(PRESETS["mocap"].noise_m, rel=0.06)
    assert y[:, 3:6].std(axis=0) == pytest.approx(PRESETS["mocap"].velocity_noise_m_s, rel=0.06)
    level = np.tile([1.0, 0, 0, 0], (len(y), 1))
    turned = rotation_vector(y[:, 6:], level)
    assert turned.std(axis=0) == pytest.approx([PRESETS["mocap"].attitude_noise_rad] * 3, rel=0.06)
    np.testing.assert_allclose(np.linalg.norm(y[:, 6:], axis=1), 1.0, rtol=1e-14)


@pytest.mark.slow
def test_the_walk_of_the_position_grows_with_the_root_of_time() -> None:
    quiet = {k: v for k, v in QUIET.items() if not k.startswith("pos_walk")}
    walks = np.array(
        [
            draws(GNSS, {**quiet, "sample_period": 0.1}, 401, seed)[[100, 400], :2]
            for seed in range(90)
        ]
    )
    early, late = walks.std(axis=(0, 2))
    assert late == pytest.approx(0.1 * np.sqrt(40.1), rel=0.17)
    assert late / early == pytest.approx(2.0, rel=0.25)


def test_the_vehicle_file_comes_before_the_preset() -> None:
    sensors = Sensors(
        position={"delay_s": 0.2, "noise_m": (1.0, 2.0, 3.0), "attitude_noise_rad": 0.1}
    )
    sensor = position_sensor(plain(sensors=sensors))
    start = {v.name: v.start for v in sensor.parameters}
    assert (start["delay"], start["pos_noise_z"], start["vel_noise_x"]) == (0.2, 3.0, 0.05)
    assert "meas_q_w" not in sensor.output_names  # GNSS knows no attitude
    mocap = position_sensor(plain(sensors=sensors), kind="mocap")
    assert {v.name: v.start for v in mocap.parameters}["attitude_noise"] == 0.1
