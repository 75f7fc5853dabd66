"""Readings of a whole record at once equal those of the run, step by step."""

import numpy as np
import pytest
from rig import plain
from sensor_rig import effect_on, motion, readings

from twin.component.rows import noiseless_outputs
from twin.effects import EFFECTS
from twin.physics.sensors.imu import imu
from twin.physics.sensors.position import position_sensor

STILL = {f"pos_walk_{a}": 0.0 for a in "xyz"} | {
    f"{stem}_noise_{a}": 0.0 for stem in ("pos", "vel") for a in "xyz"
}
DELAYED = effect_on("imu_delay", "stuck_sensor", "accel_bias", "vibration")
CASES = {
    "plain": (imu(plain()), {}),
    "imu": (
        imu(plain(), EFFECTS),
        DELAYED | {"imu_delay.delay_s": 0.0123, "stuck_sensor.time_s": 0.1},
    ),
    "position": (
        position_sensor(plain(), EFFECTS),
        STILL | effect_on("position_delay", delay=0.01, position_delay__delay_s=0.0345),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_a_record_at_once(name: str) -> None:
    component, settings = CASES[name]
    u = motion(component, 250)
    u[:, [i for i, n in enumerate(component.input_names) if n.startswith("spin_")]] = 1.1
    step_by_step = readings(component, u, settings | {"sample_period": 1e-3})
    # The run reads an instant with the inputs held up to it.
    at_once = noiseless_outputs(component, np.vstack([u[:1], u]), 1e-3, settings)
    np.testing.assert_allclose(at_once, step_by_step, rtol=1e-12, atol=1e-12)
