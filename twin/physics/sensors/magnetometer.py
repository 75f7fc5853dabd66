"""Magnetometer: the field of the Earth in body axes, plus noise.

    mag = R_nb^T B_n + n

At each sample instant n, white noise plus a random walk, is drawn; between the instants it is held
while the rest follows the attitude. Iron, currents and a rotated field are effects
(`twin.effects`). Source: Titterton & Weston, Strapdown Inertial Navigation Technology, ch. 13.
"""

from collections.abc import Iterable

import casadi as ca

from ...component import Component, ComponentBuilder
from ...effects.stages import EarthField, MagReading
from ...frames import AXES, to_body
from ...vehicle import Vehicle
from .common import (
    BODY,
    EARTH,
    attitude_input,
    noise,
    noise_level,
    sensor_blocks,
    vector_parameter,
)

SAMPLE_PERIOD_S = 0.02
"""Time between two draws of the noise, s. Made up."""


def magnetometer(vehicle: Vehicle, effects: Iterable[str] = ()) -> Component:
    """The magnetometer of a vehicle as a component.

    Args:
        vehicle: Numbers of the aircraft, and the effects that are switched on.
        effects: Effects to build in, switched off: identifiers of `twin.effects.EFFECTS`; those of
            other components are ignored.
    """
    m = ComponentBuilder("magnetometer", f"Magnetometer of {vehicle.name}")
    period = m.sampled(SAMPLE_PERIOD_S, "Time between two draws of the noise")
    blocks = sensor_blocks(m, vehicle, "magnetometer", effects)
    q_nb = attitude_input(m)
    current = ca.SX(0)
    if blocks.include("mag_current_coupling"):
        current = m.input("ibat_a", "A", "Battery current")
    sensors = vehicle.sensors
    earth = vector_parameter(m, "field", sensors.field_n_t, "T", "Magnetic flux density", EARTH)
    field_n = blocks.apply(EarthField(earth)).field_n
    reading = blocks.apply(MagReading(to_body(q_nb, field_n), current))
    level = noise_level(m, "mag", "T", sensors.mag_noise_t, sensors.mag_walk_t)
    for a, d, b in zip(AXES, BODY, reading.field_b, strict=True):
        error = noise(m, f"mag_{a}", "T", level, period)
        m.output(f"mag_{a}", "T", f"Magnetic flux density read, {d}", b + error)
    blocks.idle()
    return m.build()
