"""Numbers of one flight of our own plant; everything that may be hidden is neutral by default."""

from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
STEP_S = 5e-4
"""Step of the plant; delays are multiples of it."""
AIR_DENSITY_KG_M3 = 1.225
GRAVITY_M_S2 = 9.80665
FIELD_T = (20.6e-6, 1.3e-6, 43.5e-6)
"""Magnetic flux density at the site, NED; made up, close to that of central Europe."""
GROUND_PRESSURE_PA, GROUND_TEMPERATURE_K = 101325.0, 288.15


def _zero3() -> Array:
    return np.zeros(3)


def _one3() -> Array:
    return np.ones(3)


@dataclass(frozen=True)
class Parameters:
    """One flight; `stack` gives every number a last axis over flights.

    Vectors are body FRD, SI units; names end in their unit where a reader could doubt. Numbers
    from `thrust_exponent` on describe hidden effects and leave the flight alone by default.
    """

    # -- what the vehicle file tells ---------------------------------------------------------
    mass: float
    inertia: Array  # (3,) about the centre of mass
    hubs: Array  # (r, 3) from the centre of mass
    direction: Array  # (r,) +1 clockwise seen from above
    thrust_k: Array  # (r,) N s2/rad2
    torque_k: Array  # (r,) N m s2/rad2
    speed_0: float  # rad/s at no command
    speed_1: float  # rad/s per command
    lag: float  # s
    hover_speed: float  # rad/s, of the aircraft as the file has it
    radius: float  # m, of a rotor
    leg: float  # m
    drag_linear: Array  # (3,) N s/m
    drag_quadratic: Array  # (3,) N s2/m2
    accel_cutoff_hz: float
    imu_arm: Array = field(default_factory=_zero3)
    full_v: float = 16.8
    empty_v: float = 13.2
    resistance: float = 0.03
    capacity: float = 4000.0  # A s
    hover_current: float = 16.0  # A
    charge: float = 1.0  # at the start
    # -- propulsion --------------------------------------------------------------------------
    thrust_exponent: float = 1.0  # thrust over hover thrust = (speed over hover speed)^2 to this
    voltage_exponent: float = 0.0  # speed grows with (voltage / reference)^this
    reference_v: float = 15.4
    spin_inertia_gyro: float = 0.0  # kg m2, in omega x h
    spin_inertia_yaw: float = 0.0  # kg m2, in the reaction to the rotor's acceleration
    tilt: Array = field(default_factory=_zero3)  # of the thrust, forward, right, unused
    # -- air ---------------------------------------------------------------------------------
    wind: Array = field(default_factory=_zero3)  # NED
    gust_sigma: float = 0.0
    gust_time: float = 1.0
    inflow_gain: float = 0.0  # relative thrust per relative inflow of the blade element
    inflow_axial: float = 0.0  # 1: the rotor feels climb
    inflow_forward: float = 0.0  # 1: the rotor feels speed along the disc
    rotor_h: float = 0.0  # N s2/(rad m): force per rotor speed and speed along the disc
    flap: float = 0.0  # tilt of the disc per advance ratio
    flap_height: float = 0.0  # m, disc over the centre of mass
    parasitic: float = 0.0  # N s2/m2
    ground_effect: float = 0.0  # multiple of Cheeseman and Bennett's (R / 4z)^2
    # -- mass --------------------------------------------------------------------------------
    marker: Array = field(default_factory=_zero3)  # what position sensors see, from the CoM
    load_mass: float = 0.0
    load_length: float = 1.0
    # -- sensors -----------------------------------------------------------------------------
    accel_bias: Array = field(default_factory=_zero3)
    accel_scale: Array = field(default_factory=_one3)
    accel_turn: Array = field(default_factory=_zero3)  # rotation vector of the sensor
    gyro_bias: Array = field(default_factory=_zero3)
    gyro_scale: Array = field(default_factory=_one3)
    noise_scale: float = 1.0
    shake_accel: float = 0.0  # m/s2 by one rotor in hover
    shake_gyro: float = 0.0  # rad/s by one rotor in hover
    stuck_channel: float = 0.0  # 1..6: acc_x .. gyro_z; 0: none
    stuck_time: float = 0.0
    mag_hard: Array = field(default_factory=_zero3)  # T
    mag_soft: Array = field(default_factory=lambda: np.eye(3))
    mag_per_current: Array = field(default_factory=_zero3)  # T/A
    heading: float = 0.0  # shown minus true
    baro_bias: float = 0.0
    baro_dynamic: float = 0.0
    # -- timing, in steps of the plant -------------------------------------------------------
    imu_delay: int = 0
    position_delay: int = 0
    late_attitude: float = 0.0  # 1: the position sensor gives the attitude as well
    command_delay: int = 0
    # -- outside the library of effects ------------------------------------------------------
    duct_leak: Array = field(default_factory=_zero3)  # N per mean command of the front rotors
    drag_cubic: float = 0.0  # N s3/m3
    shudder: Array = field(default_factory=_zero3)  # N, amplitude of a periodic force
    shudder_hz: float = 1.0
    pitch_per_yaw: float = 0.0  # N m s
    lee_drag: float = 0.0  # N s/m, along y, for air from the right alone

    @property
    def hover_thrust(self) -> Array:
        """Thrust of one rotor at the hover speed of the file, N."""
        return np.asarray(self.thrust_k * self.hover_speed**2)


class Batch:
    """Parameters of many flights of aircraft with equally many rotors.

    Attributes:
        p: Parameters, each with a last axis over flights.
        n: Number of flights.
        rotors: Number of rotors.
    """

    def __init__(self, flights: list[Parameters]) -> None:
        self.p = stack(flights)
        self.n = len(flights)
        self.rotors = len(flights[0].hubs)

    def on(self, name: str) -> bool:
        """Whether a number is other than zero in any flight."""
        return bool(self._on[name])

    @cached_property
    def _on(self) -> dict[str, bool]:
        return {f.name: bool(np.any(getattr(self.p, f.name))) for f in fields(self.p)}


def stack(flights: list[Parameters]) -> Parameters:
    """Every number of the flights side by side along a last axis."""
    columns: dict[str, Any] = {
        f.name: np.stack([np.asarray(getattr(p, f.name)) for p in flights], axis=-1)
        for f in fields(flights[0])
    }
    return replace(flights[0], **columns)
