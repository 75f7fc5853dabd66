"""A flight whose instruments all agree, into which tests put faults."""

import numpy as np

from twin.frames import from_euler, rotation_vector, to_body
from twin.logs.columns import ACC, GYRO, MAG, POS, QUAT, VEL

G, FIELD = 9.80665, np.array([2.0e-5, 0.0, 4.4e-5])
ONSET_S, RATE_HZ = 25.0, 100.0
Table = dict[str, np.ndarray]


def sound(seconds: float = 45.0, seed: int = 0) -> Table:
    """A flight that swings about hover, with all sensors sound: exact kinematics, white noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1 / RATE_HZ)
    yaw = 0.4 * np.sin(0.31 * t)
    q = from_euler(0.15 * np.sin(1.1 * t + 0.3), 0.12 * np.sin(0.9 * t), yaw).T
    rates = rotation_vector(np.roll(q, -1, axis=0), q) * RATE_HZ
    rates[-1] = rates[-2]
    acc_n = np.column_stack([np.sin(0.9 * t), 0.8 * np.cos(1.1 * t), 0.3 * np.sin(0.7 * t)])
    vel = np.cumsum(acc_n, axis=0) / RATE_HZ
    vel -= vel.mean(axis=0)
    pos = np.cumsum(vel, axis=0) / RATE_HZ
    pos[:, 2] -= 20.0
    force = np.stack(to_body(list(q.T), list((acc_n - [0, 0, G]).T)), axis=1)
    field = np.stack(to_body(list(q.T), [np.full(len(t), b) for b in FIELD]), axis=1)
    table = {"time": t} | {f"cmd_{i}": np.full(len(t), 0.5) for i in range(1, 5)}
    columns = ((GYRO, rates, 2e-3), (ACC, force, 0.03), (MAG, field, 3e-7), (QUAT, q, 2e-4))
    for names, values, noise in (*columns, (VEL, vel, 0.01), (POS, pos, 0.01)):
        noisy = values + noise * rng.standard_normal(values.shape)
        table |= dict(zip(names, noisy.T, strict=True))
    table["baro_pa"] = 101325.0 * np.exp(pos[:, 2] / 8434.0) + 2.0 * rng.standard_normal(len(t))
    table["vbat_v"] = 16.0 - 0.01 * t + 0.01 * rng.standard_normal(len(t))
    table["ibat_a"] = 20.0 + 0.2 * rng.standard_normal(len(t))
    return table
