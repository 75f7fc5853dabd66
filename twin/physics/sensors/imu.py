"""Inertial measurement unit: lever arm, low-pass and noise between motion and readings.

    acc  = LP(f_b + alpha x r + omega x (omega x r)) + n_a
    gyro = LP(omega) + n_g

with the specific force f_b at the centre of mass, the sensor at r, and LP a second-order
Butterworth low-pass. At each sample instant n, white noise plus a random walk, is drawn;
between the instants it is held while the rest follows the motion. Source: Titterton & Weston,
Strapdown Inertial Navigation Technology, ch. 3; noise model, IEEE Std 952-1997, annex C.

Scale, misalignment, bias, vibration, delay and a stuck channel are effects (`twin.effects`).
"""

from collections.abc import Iterable

import casadi as ca
import numpy as np

from ...component import Component, ComponentBuilder
from ...effects import Blocks
from ...effects.sensors import IMU_CHANNELS
from ...effects.stages import Freezing, ImuMotion, ImuNoise, ImuReading, Latency, Mounting
from ...frames import AXES, carried
from ...vehicle import Vehicle
from .common import (
    BODY,
    NoiseLevel,
    late,
    noise,
    noise_level,
    sensor_blocks,
    vector_input,
    vector_parameter,
)

SAMPLE_PERIOD_S = 1e-3
"""Time between two draws of the noise, s. Made up."""
DELAY_SAMPLES = 251
"""Number of stored samples: the longest delay is one sample period less."""
_UNITS = ("m/s2",) * 3 + ("rad/s",) * 3  # units of the six readings
_MEANINGS = tuple(
    f"{sensor}, {d}"
    for sensor in ("Accelerometer, specific force", "Gyroscope, body rate")
    for d in BODY
)  # names of the six readings


def imu(vehicle: Vehicle, effects: Iterable[str] = ()) -> Component:
    """The IMU of a vehicle as a component.

    Args:
        vehicle: Numbers of the aircraft, and the effects that are switched on.
        effects: Effects to build in, switched off: identifiers of `twin.effects.EFFECTS`; those of
            other components are ignored.
    """
    m = ComponentBuilder("imu", f"Accelerometer and gyroscope of {vehicle.name}")
    period = m.sampled(SAMPLE_PERIOD_S, "Time between two draws of the noise")
    blocks = sensor_blocks(m, vehicle, "imu", effects)
    undisturbed = _motion_at_imu(m, vehicle, blocks)
    disturbed = blocks.apply(undisturbed)
    reading = blocks.apply(
        ImuReading(
            acc=_low_pass(
                m,
                "acc",
                disturbed.specific_force_b,
                undisturbed.specific_force_b,
                vehicle.accel_cutoff_hz,
            ),
            gyro=_low_pass(
                m, "gyro", disturbed.omega_b, undisturbed.omega_b, vehicle.gyro_cutoff_hz
            ),
        )
    )
    readings = _delayed(m, blocks, [*reading.acc, *reading.gyro])
    errors = _errors(m, vehicle, blocks, period)
    readings = [r + e for r, e in zip(readings, errors, strict=True)]
    readings = _frozen(m, blocks, readings, period)
    for channel, unit, meaning, value in zip(
        IMU_CHANNELS, _UNITS, _MEANINGS, readings, strict=True
    ):
        m.output(channel, unit, meaning, value)
    blocks.idle()
    return m.build()


def _motion_at_imu(m: ComponentBuilder, vehicle: Vehicle, blocks: Blocks) -> ImuMotion:
    """Declared inputs, transformed to the position of the accelerometer."""
    force = vector_input(m, "specific_force", "m/s2", "Specific force at the centre of mass", BODY)
    alpha = vector_input(m, "angular_acceleration", "rad/s2", "Angular acceleration", BODY)
    omega = vector_input(m, "omega", "rad/s", "Body rate", BODY)
    rotors = range(1, vehicle.rotors.count + 1) if blocks.include("vibration") else ()
    spin = [
        m.input(f"spin_{i}", "1", f"Speed of rotor {i} over that in hover", 1.0) for i in rotors
    ]
    meaning = "Accelerometer from the centre of mass"
    arm = vector_parameter(m, "position", vehicle.imu_position_m.tolist(), "m", meaning, BODY)
    arm = blocks.apply(Mounting(arm)).arm_b
    return ImuMotion(carried(force, arm, omega, alpha), omega, spin)


def _low_pass(
    m: ComponentBuilder,
    name: str,
    signal: list[ca.SX],
    settled_on: list[ca.SX],
    cutoff_hz: float | None,
) -> list[ca.SX]:
    """Second-order Butterworth low-pass per axis, initially in steady state without vibration."""
    if cutoff_hz is None:
        return signal
    cutoff = m.parameter(
        f"{name}_cutoff", cutoff_hz, "Hz", f"Low-pass of {name}", minimum=1e-3, maximum=200.0
    )
    w = 2 * np.pi * cutoff
    unit = _UNITS[IMU_CHANNELS.index(f"{name}_x")]
    filtered = []
    for a, s, start in zip(AXES, signal, settled_on, strict=True):
        y = m.state(f"{name}_lp_{a}", unit, f"Low-passed {name}, {a}", start)
        v = m.state(
            f"{name}_lp_rate_{a}", f"{unit}.s-1", f"Rate of the low-passed {name}, {a}", 0.0
        )
        m.derivative(f"{name}_lp_{a}", v)
        m.derivative(f"{name}_lp_rate_{a}", w * w * (s - y) - np.sqrt(2) * w * v)
        filtered.append(y)
    return filtered


def _delayed(m: ComponentBuilder, blocks: Blocks, readings: list[ca.SX]) -> list[ca.SX]:
    """Delayed samples while the delay is enabled, else the readings unchanged."""
    if not blocks.include("imu_delay"):
        return readings
    latency = blocks.apply(Latency(late=ca.SX(0), delay_s=ca.SX(0)))
    return [
        ca.if_else(latency.late, late(m, channel, unit, reading, latency, DELAY_SAMPLES), reading)
        for channel, unit, reading in zip(IMU_CHANNELS, _UNITS, readings, strict=True)
    ]


def _errors(m: ComponentBuilder, vehicle: Vehicle, blocks: Blocks, period: ca.SX) -> list[ca.SX]:
    """Noise of the six channels."""
    s = vehicle.sensors
    acc = noise_level(m, "acc", "m/s2", s.accel_noise_m_s2, s.accel_walk_m_s2)
    gyro = noise_level(m, "gyro", "rad/s", s.gyro_noise_rad_s, s.gyro_walk_rad_s)
    white = blocks.apply(ImuNoise(acc.white, gyro.white))
    levels = [NoiseLevel(white.acc, acc.walk)] * 3 + [NoiseLevel(white.gyro, gyro.walk)] * 3
    return [
        noise(m, channel, unit, level, period)
        for channel, unit, level in zip(IMU_CHANNELS, _UNITS, levels, strict=True)
    ]


def _frozen(
    m: ComponentBuilder, blocks: Blocks, readings: list[ca.SX], period: ca.SX
) -> list[ca.SX]:
    """Readings, of which a stuck one repeats its last value."""
    if not blocks.include("stuck_sensor"):
        return readings
    count = m.memory("samples", "1", "Sample instants so far")
    m.update("samples", count + 1)
    freezing = blocks.apply(Freezing(count * period, [ca.SX(0)] * len(readings)))
    outputs = []
    for channel, unit, reading, stuck in zip(
        IMU_CHANNELS, _UNITS, readings, freezing.stuck, strict=True
    ):
        frozen = m.memory(f"{channel}.frozen", "1", f"Whether {channel} stands undisturbed")
        last = m.memory(f"{channel}.last", unit, f"Value at which {channel} stands undisturbed")
        shown = ca.if_else(frozen, last, reading)
        m.update(f"{channel}.frozen", stuck)
        m.update(f"{channel}.last", shown)
        outputs.append(shown)
    return outputs
