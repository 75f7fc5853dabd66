"""Inertial measurement unit: lever arm, low-pass, bias and noise between motion and readings.

    acc  = LP(f_b + alpha x r + omega x (omega x r)) + b_a + n_a
    gyro = LP(omega) + b_g + n_g

with the specific force f_b at the centre of mass, the sensor at r, and LP a second-order
Butterworth low-pass. At each sample instant n is drawn anew and b takes a step of a random walk
from the bias on; between the instants both are held. Source: Titterton & Weston, Strapdown
Inertial Navigation Technology, ch. 3; noise model, IEEE Std 952-1997, annex C.
"""

from collections.abc import Sequence

import casadi as ca
import numpy as np

from .component import Component
from .component_builder import ComponentBuilder
from .frames import cross
from .vehicle import Vehicle

SAMPLE_PERIOD_S = 1e-3
AXES = ("x", "y", "z")
_FRD = ("forward", "right", "down")


def imu(vehicle: Vehicle) -> Component:
    """The IMU of a vehicle as a component."""
    m = ComponentBuilder("imu", f"Accelerometer and gyroscope of {vehicle.name}")
    period = m.sampled(SAMPLE_PERIOD_S, "Time between two draws of the noise")
    force = _vector_input(m, "specific_force", "m/s2", "Specific force at the centre of mass")
    alpha = _vector_input(m, "angular_acceleration", "rad/s2", "Angular acceleration")
    omega = _vector_input(m, "omega", "rad/s", "Body rate")
    arm = [
        m.parameter(
            f"position_{a}",
            float(vehicle.imu_position_m[i]),
            "m",
            f"Accelerometer from the centre of mass, body {_FRD[i]}",
        )
        for i, a in enumerate(AXES)
    ]
    tangential, centripetal = cross(alpha, arm), cross(omega, cross(omega, arm))
    at_sensor = [f + t + c for f, t, c in zip(force, tangential, centripetal, strict=True)]
    readings = (
        ("acc", "m/s2", "Accelerometer, specific force", at_sensor, vehicle.accel_cutoff_hz),
        ("gyro", "rad/s", "Gyroscope, body rate", omega, vehicle.gyro_cutoff_hz),
    )
    for name, unit, meaning, signal, cutoff in readings:
        bias = [
            m.parameter(
                f"{name}_bias_{a}",
                0.0,
                unit,
                f"Bias of the {meaning.split(',')[0].lower()}, body {d}",
            )
            for a, d in zip(AXES, _FRD, strict=True)
        ]
        if cutoff is not None:
            signal = _low_pass(m, name, unit, signal, cutoff)
        error = _noise(m, name, unit, period)
        for a, d, s, b, e in zip(AXES, _FRD, signal, bias, error, strict=True):
            m.output(f"{name}_{a}", unit, f"{meaning}, body {d}", s + b + e)
    return m.build()


def _noise(m: ComponentBuilder, name: str, unit: str, period: ca.SX) -> list[ca.SX]:
    """White noise plus the walk of the bias, per axis; both off by default."""
    white = m.parameter(
        f"{name}_noise", 0.0, unit, f"Noise of {name}, standard deviation", minimum=0
    )
    walk = m.parameter(
        f"{name}_bias_walk",
        0.0,
        unit,
        f"Walk of the bias of {name}, standard deviation after 1 s",
        minimum=0,
    )
    errors = []
    for a in AXES:
        drift = m.memory(f"{name}_drift_{a}", unit, f"Walk of the bias of {name}, {a}")
        noise = m.memory(f"{name}_noise_{a}", unit, f"Noise of {name}, {a}")
        m.update(f"{name}_drift_{a}", drift + walk * ca.sqrt(period) * m.noise())
        m.update(f"{name}_noise_{a}", white * m.noise())
        errors.append(drift + noise)
    return errors


def _vector_input(m: ComponentBuilder, name: str, unit: str, meaning: str) -> list[ca.SX]:
    return [
        m.input(f"{name}_{a}", unit, f"{meaning}, body {d}")
        for a, d in zip(AXES, _FRD, strict=True)
    ]


def _low_pass(
    m: ComponentBuilder, name: str, unit: str, signal: Sequence[ca.SX], cutoff_hz: float
) -> list[ca.SX]:
    """Second-order Butterworth low-pass per axis, starting settled on its input."""
    cutoff = m.parameter(
        f"{name}_cutoff", cutoff_hz, "Hz", f"Low-pass of {name}", minimum=1e-3, maximum=200.0
    )
    w = 2 * np.pi * cutoff
    filtered = []
    for a, s in zip(AXES, signal, strict=True):
        y = m.state(f"{name}_lp_{a}", unit, f"Low-passed {name}, {a}", s)
        v = m.state(
            f"{name}_lp_rate_{a}", f"{unit}.s-1", f"Rate of the low-passed {name}, {a}", 0.0
        )
        m.derivative(f"{name}_lp_{a}", v)
        m.derivative(f"{name}_lp_rate_{a}", w * w * (s - y) - np.sqrt(2) * w * v)
        filtered.append(y)
    return filtered
