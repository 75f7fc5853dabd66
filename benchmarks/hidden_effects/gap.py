"""How large a hidden effect shows, without noise: readings of the flight minus those of the
aircraft as the vehicle file has it, in the same true motion and with the same commands."""

import numpy as np
from numpy.polynomial.polynomial import polyval
from scipy.signal import lfilter

from .plants.aircraft import Aircraft
from .plants.missions import CONTROL_HZ
from .plants.own.flight import Trace
from .plants.own.parameters import FIELD_T, Array, Batch, Parameters
from .plants.own.physics import Dynamics, Layout, motion, own_dynamics
from .plants.own.vectors import rotation, to_body
from .plants.sensing import accelerometer, barometer, gyroscope, magnetometer, measured_pose

UNITS = {
    "acc": "m/s^2",
    "angacc": "rad/s^2",
    "gyro": "rad/s",
    "mag": "T",
    "baro": "Pa",
    "pos": "m",
    "vel": "m/s",
    "att": "rad",
}
AIRBORNE_M = 0.1


def true_gap(
    aircraft: Aircraft,
    plant: Parameters,
    trace: Trace,
    i: int,
    dynamics: Dynamics = own_dynamics,
) -> dict[str, Array]:
    """Residuals by channel of the i-th flight over its samples in the air, shape (m,)."""
    nominal = aircraft.nominal
    truth = trace.truth[:, :, i].T
    expected, alpha = _nominal(aircraft, truth, trace.command[:, :, i].T, dynamics)
    pose = measured_pose(plant, trace, i)
    inverse = truth[6:10] * np.array([1.0, -1, -1, -1])[:, None]
    residual = {
        "acc": accelerometer(plant, trace.imu_force[:, :, i].T) - expected,
        "angacc": truth[13:16] - alpha,
        "gyro": gyroscope(plant, trace, i) - truth[10:13],
        "mag": magnetometer(plant, trace, i)
        - to_body(rotation(truth[6:10]), np.array(FIELD_T)[:, None]),
        "baro": (barometer(plant, trace, i) - barometer(nominal, trace, i))[None],
        "pos": pose[:3] - truth[:3],
        "vel": pose[3:6] - truth[3:6],
        "att": 2 * _vector_part(inverse, pose[6:]),
    }
    airborne = -truth[2] > nominal.leg + AIRBORNE_M
    names = {
        name: [name] if len(rows) == 1 else [f"{name}_{a}" for a in "xyz"]
        for name, rows in residual.items()
    }
    return {
        channel: row[airborne]
        for name, rows in residual.items()
        for channel, row in zip(names[name], rows, strict=True)
    }


def gap_json(flights: list[dict[str, Array]]) -> dict[str, dict[str, float | str]]:
    """Rms by channel over several flights."""
    pooled = {c: np.concatenate([f[c] for f in flights]) for c in flights[0]}
    return {
        channel: {
            "unit": UNITS[channel.split("_")[0]],
            "rms": float(f"{np.sqrt(np.mean(values**2)):.6g}"),
        }
        for channel, values in pooled.items()
    }


def _nominal(
    aircraft: Aircraft, truth: Array, command: Array, dynamics: Dynamics
) -> tuple[Array, Array]:
    """Specific force at the accelerometer and angular acceleration of the aircraft of the file."""
    nominal = aircraft.nominal
    batch, layout = Batch([nominal]), Layout(len(command))
    x = np.zeros((layout.size, truth.shape[1]))
    x[:13] = truth[:13]
    x[layout.rope][2] = 1.0
    x[layout.charge] = 1.0
    target = polyval(command, aircraft.speed_of_command or (nominal.speed_0, nominal.speed_1))
    stay = float(np.exp(-1 / (CONTROL_HZ * nominal.lag)))
    begin = np.full((len(command), 1), nominal.speed_0)
    speed, _ = lfilter([0.0, 1 - stay], [1.0, -stay], target, axis=1, zi=begin)
    x[layout.rotor] = speed
    at = motion(batch, layout, x, command, np.zeros((3, 1)), 0.0, dynamics)
    return at.imu_force, at.angular_acceleration


def _vector_part(a: Array, b: Array) -> Array:
    """Vector part of the product of two quaternions, scalar part made positive."""
    flip = np.where((a[0] * b[0] - (a[1:] * b[1:]).sum(axis=0)) < 0, -1.0, 1.0)
    x = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    y = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1]
    z = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]
    return np.asarray(flip * np.stack([x, y, z]))
