"""The numbers of one aircraft, in SI units, and where each comes from."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from ..representation import short_repr
from .sensors import Sensors

Array = NDArray[np.float64]
GRAVITY_M_S2 = 9.80665
"""Standard gravity, CGPM 1901."""
NOMINAL_CELL_V = 3.7
"""Voltage of one lithium polymer cell, half full."""


@dataclass(frozen=True, slots=True)
class Battery:
    """A battery as open-circuit voltage, falling linearly with charge, behind a resistance."""

    full_voltage_v: float
    empty_voltage_v: float
    capacity_a_s: float
    resistance_ohm: float
    hover_current_a: float

    @property
    def mean_voltage_v(self) -> float:
        """Open-circuit voltage when half full."""
        return (self.full_voltage_v + self.empty_voltage_v) / 2


@dataclass(frozen=True, slots=True)
class Rotors:
    """Rotors of one aircraft, all alike but for place and sense of rotation.

    Polynomials are ascending coefficients: of the rotor speed in rad/s, or of the command 0..1.

    Attributes:
        position_m: Hubs from the centre of mass, body FRD, shape (n, 3).
        direction: +1 clockwise seen from above, -1 counter-clockwise, shape (n,).
        thrust_n: Thrust polynomial, of the speed if `from_speed`, else of the command.
        torque_n_m: Reaction torque polynomial of the same argument.
        speed_rad_s: Speed polynomial of the command; None for a vehicle known by rotor speed.
        lag_up_s: Time constant when speeding up; 0 without lag.
        lag_down_s: Time constant when slowing down; 0 without lag.
        spin_inertia_kg_m2: Of one rotor about its axis; 0 when unknown.
        reference_voltage_v: Voltage at which the maps of the command hold; None: ignored.
        voltage_exponent: Power of (voltage / reference) that multiplies the command.
    """

    position_m: Array
    direction: Array
    from_speed: bool
    thrust_n: tuple[float, ...]
    torque_n_m: tuple[float, ...]
    speed_rad_s: tuple[float, ...] | None
    lag_up_s: float
    lag_down_s: float
    spin_inertia_kg_m2: float
    reference_voltage_v: float | None
    voltage_exponent: float

    __repr__ = short_repr

    @property
    def count(self) -> int:
        """Number of rotors."""
        return len(self.direction)


@dataclass(frozen=True, slots=True)
class Vehicle:
    """One aircraft in SI units, body FRD about the centre of mass.

    Attributes:
        inertia_kg_m2: Inertia matrix, shape (3, 3).
        drag_linear_n_s_m: Per body axis, shape (3,).
        drag_quadratic_n_s2_m2: Per body axis, shape (3,).
        leg_height_m: Centre of mass over the ground when standing.
        imu_position_m: Accelerometer from the centre of mass, shape (3,).
        sensors: Noise of the sensors, and the site.
        sources: Pedigree of each number, by its key in the file; "default: ..." where the file
            is silent and a default stands in.
        doubts: What looks odd but is not refused.
        effects: Effects that are switched on (`twin.effects`), each with all its parameters.
    """

    name: str
    description: str
    mass_kg: float
    inertia_kg_m2: Array
    drag_linear_n_s_m: Array
    drag_quadratic_n_s2_m2: Array
    leg_height_m: float
    rotors: Rotors
    imu_position_m: Array
    accel_cutoff_hz: float | None
    gyro_cutoff_hz: float | None
    battery: Battery | None
    sources: Mapping[str, str]
    doubts: tuple[str, ...] = ()
    sensors: Sensors = field(default_factory=Sensors)
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    __repr__ = short_repr

    @property
    def drive(self) -> Literal["command", "rotor_speed"]:
        """What the vehicle's rotors are driven by when nothing else is asked for."""
        return (
            "rotor_speed" if self.rotors.from_speed and not self.rotors.speed_rad_s else "command"
        )

    @property
    def hover_thrust_n(self) -> float:
        """Thrust of one rotor in hover, equally shared."""
        return self.mass_kg * GRAVITY_M_S2 / self.rotors.count

    @property
    def arm_m(self) -> float:
        """Distance of the farthest rotor from the centre of mass in the rotor plane."""
        return float(np.linalg.norm(self.rotors.position_m[:, :2], axis=1).max())

    @property
    def states_voltage(self) -> bool:
        """Whether the numbers say anything about a voltage."""
        return self.rotors.reference_voltage_v is not None or self.battery is not None

    @property
    def voltage_v(self) -> float:
        """Voltage at which the maps hold; else of the battery, of battery_sag, or of one cell."""
        if self.rotors.reference_voltage_v is not None:
            return self.rotors.reference_voltage_v
        if self.battery is not None:
            return self.battery.mean_voltage_v
        return self.effects.get("battery_sag", {}).get("reference_v", NOMINAL_CELL_V)

    def with_effects(self, effects: Mapping[str, Mapping[str, float]]) -> Self:
        """The same vehicle with these effects, each with all its parameters, and no others."""
        return replace(self, effects=effects)

    def with_mass(self, mass_kg: float) -> Self:
        """The same vehicle with another mass."""
        return replace(self, mass_kg=mass_kg)
