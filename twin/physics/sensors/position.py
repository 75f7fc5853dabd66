"""Position sensor: a GNSS receiver or a motion capture system.

    position = F (p_n + R_nb r) + f + n_p        velocity = F (v_n + R_nb (omega x r)) + n_v
    attitude = q_F * q_nb * [1, theta / 2]       theta white noise, about the body axes

with the antenna (or the origin of the markers) at r, and the sensor's own frame rotated by F about
the vertical and shifted by f. All signals are sampled at the sample instants, output after the
delay and held. An additional delay is an effect (`twin.effects`).

Outputs are the columns of the flight table with prefix `meas_`: `meas_pos_x` is `pos_x`.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Literal

import casadi as ca

from ...component import Component, ComponentBuilder
from ...component.portable import cosine, sine
from ...effects.stages import Latency
from ...frames import AXES, cross, multiply, to_ned
from ...vehicle import Vehicle
from .common import (
    BODY,
    EARTH,
    NoiseLevel,
    attitude_input,
    late,
    noise,
    sensor_blocks,
    vector_input,
    vector_parameter,
)

Kind = Literal["gnss", "mocap"]
DELAY_SAMPLES = 128
"""Number of stored samples: the longest delay is one sample period less."""


@dataclass(frozen=True, slots=True)
class PositionErrors:
    """Numbers of a position sensor; noise as standard deviations, NED.

    Attributes:
        source: Source of the numbers.
        period_s: Time between two samples.
        delay_s: Delay from the motion to the output.
        noise_m: White noise of the position.
        walk_m: Random walk of the position error, standard deviation after 1 s.
        velocity_noise_m_s: White noise of the velocity.
        attitude_noise_rad: White noise of the attitude, per axis; None: no attitude output.
        antenna_m: Position of the antenna from the centre of mass, body FRD.
    """

    source: str
    period_s: float
    delay_s: float
    noise_m: tuple[float, ...]
    walk_m: tuple[float, ...]
    velocity_noise_m_s: tuple[float, ...]
    attitude_noise_rad: float | None
    antenna_m: tuple[float, ...] = (0.0, 0.0, 0.0)


PRESETS: dict[Kind, PositionErrors] = {
    "gnss": PositionErrors(
        "period and noise of the velocity: u-blox NEO-M8 data sheet, UBX-15031086; noise of the "
        "position, 1.5 times as much downwards, and delay: PX4's assumptions, EKF2_GPS_P_NOISE and "
        "EKF2_GPS_DELAY; walk: made up, 1 m after 100 s",
        period_s=0.1,
        delay_s=0.11,
        noise_m=(0.5, 0.5, 0.75),
        walk_m=(0.1, 0.1, 0.15),
        velocity_noise_m_s=(0.05, 0.05, 0.05),
        attitude_noise_rad=None,
    ),
    "mocap": PositionErrors(
        "noise of the position: Merriaux et al., A Study of Vicon System Positioning Performance, "
        "Sensors 17 (2017) 1591; attitude: that over markers 0.1 m apart; velocity: that of the "
        "difference of two samples; period and delay: made up",
        period_s=0.01,
        delay_s=0.01,
        noise_m=(1.5e-4, 1.5e-4, 1.5e-4),
        walk_m=(0.0, 0.0, 0.0),
        velocity_noise_m_s=(0.02, 0.02, 0.02),
        attitude_noise_rad=1.5e-3,
    ),
}
"""Usual errors of each kind of position sensor; the first text of each is their source."""


def position_sensor(
    vehicle: Vehicle, effects: Iterable[str] = (), kind: Kind = "gnss"
) -> Component:
    """The position sensor of a vehicle as a component named "position".

    Args:
        vehicle: Numbers of the aircraft, those of its sensor in preference to those of the kind,
            and the effects that are switched on.
        effects: Effects to build in, switched off: identifiers of `twin.effects.EFFECTS`; those of
            other components are ignored.
        kind: "gnss": position and velocity; "mocap": attitude as well.
    """
    changes: dict[str, Any] = dict(vehicle.sensors.position)
    if PRESETS[kind].attitude_noise_rad is None:
        changes.pop("attitude_noise_rad", None)
    data = replace(PRESETS[kind], **changes)
    m = ComponentBuilder("position", f"Position sensor of {vehicle.name}, {kind}")
    period = m.sampled(data.period_s, "Time between two samples")
    blocks = sensor_blocks(m, vehicle, "position", effects)
    delay = m.parameter("delay", data.delay_s, "s", "From the motion to the output", minimum=0)
    latency = blocks.apply(Latency(late=ca.SX(1), delay_s=delay))

    def taken(channel: str, unit: str, signal: ca.SX) -> ca.SX:
        return late(m, channel, unit, signal, latency, DELAY_SAMPLES)

    position, velocity, attitude = _measured_pose(m, data)
    sized = (
        ("pos", "m", "Position", position, data.noise_m, data.walk_m),
        ("vel", "m/s", "Velocity", velocity, data.velocity_noise_m_s, (0.0,) * 3),
    )
    for stem, unit, meaning, signal, white, walk in sized:
        levels = _levels(m, stem, unit, white, walk)
        for a, d, value, level in zip(AXES, EARTH, signal, levels, strict=True):
            channel = f"meas_{stem}_{a}"
            reading = taken(channel, unit, value) + noise(m, channel, unit, level, period)
            m.output(channel, unit, f"{meaning} measured, {d}", reading)
    if data.attitude_noise_rad is not None:
        held = [taken(f"meas_q_{a}", "1", c) for a, c in zip("wxyz", attitude, strict=True)]
        for a, c in zip("wxyz", _shaken(m, data.attitude_noise_rad, held), strict=True):
            m.output(f"meas_q_{a}", "1", f"Attitude measured, body to NED, {a}", c)
    blocks.idle()
    return m.build()


def _measured_pose(
    m: ComponentBuilder, data: PositionErrors
) -> tuple[list[ca.SX], list[ca.SX], list[ca.SX]]:
    """Position, velocity and attitude in the frame of the sensor."""
    pos_n = vector_input(m, "pos", "m", "Position", EARTH)
    vel_n = vector_input(m, "vel", "m/s", "Velocity", EARTH)
    q_nb = attitude_input(m)
    omega_b = vector_input(m, "omega", "rad/s", "Body rate", BODY)
    meaning = "Antenna or markers from the centre of mass"
    arm_b = vector_parameter(m, "antenna", data.antenna_m, "m", meaning, BODY)
    meaning = "Origin of NED in the frame of the sensor"
    shift = vector_parameter(m, "frame", (0.0, 0.0, 0.0), "m", meaning, EARTH)
    yaw = m.parameter("frame_yaw", 0.0, "rad", "Heading read in that frame minus true heading")
    turn = [cosine(yaw / 2), ca.SX(0), ca.SX(0), sine(yaw / 2)]
    place = [p + r for p, r in zip(pos_n, to_ned(q_nb, arm_b), strict=True)]
    speed = [v + r for v, r in zip(vel_n, to_ned(q_nb, cross(omega_b, arm_b)), strict=True)]
    return (
        [p + f for p, f in zip(to_ned(turn, place), shift, strict=True)],
        to_ned(turn, speed),
        multiply(turn, q_nb),
    )


def _levels(
    m: ComponentBuilder,
    stem: str,
    unit: str,
    white: tuple[float, ...],
    walk: tuple[float, ...],
) -> list[NoiseLevel]:
    """Noise along north, east and down."""
    return [
        NoiseLevel(
            m.parameter(f"{stem}_noise_{a}", w, unit, f"Noise of {stem}_{a}", minimum=0),
            m.parameter(
                f"{stem}_walk_{a}",
                k,
                unit,
                f"Walk of the error of {stem}_{a}, after 1 s",
                minimum=0,
            ),
        )
        for a, w, k in zip(AXES, white, walk, strict=True)
    ]


def _shaken(m: ComponentBuilder, white: float, q_nb: list[ca.SX]) -> list[ca.SX]:
    """The attitude with small random rotations about the body axes, at unit length."""
    size = m.parameter(
        "attitude_noise", white, "rad", "Noise of the attitude about each body axis", minimum=0
    )
    half = []
    for a in AXES:
        angle = m.memory(f"meas_q.noise_{a}", "rad", f"Noise of the attitude about body {a}")
        m.update(f"meas_q.noise_{a}", m.noise(size))
        half.append(angle / 2)
    q = multiply(q_nb, [ca.SX(1), *half])
    length = ca.sqrt(sum((c * c for c in q), start=ca.SX(_SMALLEST)))
    return [c / length for c in q]


_SMALLEST = 1e-30
"""Lower bound of the length of an interpolated attitude, for a delay between q and -q."""
