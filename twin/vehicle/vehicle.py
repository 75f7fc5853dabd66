"""The numbers of one aircraft, in SI units, and where each comes from."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from ..representation import short_repr
from .calibration import Calibration
from .deviation import Deviation
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
class RotorAir:
    """What the air does to one rotor that moves through it, at its hub; all 0: nothing.

    With the rotor speed w, rad/s, and the velocity V of the hub through the air, m/s, body FRD:

        thrust += lift (V_x^2 + V_y^2) + inflow w V_z
        force   = -drag w [V_x, V_y, 0]
        moment  = flapping w [-V_y, V_x, 0] - rolling w [V_x, V_y, 0]

    Source: drag, inflow, lift and flapping (there with the opposite sign), Folk, Paulos & Kumar,
    RotorPy, arXiv 2306.04485; drag and rolling, Martin & Salaun, The True Role of Accelerometer
    Feedback in Quadrotor Control, ICRA 2010, as Gazebo has them.

    Attributes:
        drag_kg_rad: In-plane force per rotor speed and hub speed.
        inflow_kg_rad: Thrust lost per rotor speed and climb speed.
        lift_kg_m: Thrust gained per square of the in-plane hub speed.
        flapping_kg_m_rad: Moment that raises the leading edge, per rotor speed and hub speed.
        rolling_kg_m_rad: Moment against the hub's velocity, per rotor speed and hub speed.
    """

    drag_kg_rad: float = 0.0
    inflow_kg_rad: float = 0.0
    lift_kg_m: float = 0.0
    flapping_kg_m_rad: float = 0.0
    rolling_kg_m_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class Advance:
    """How thrust and reaction torque change with the advance ratio, as propellers are published.

    The advance ratio is the climb speed of the hub through the air over the turns per second and
    the diameter. Between the rows on straight lines, beyond them the first and last values.

    Source: Leishman, Principles of Helicopter Aerodynamics, sec. 2.3; UIUC propeller data.

    Attributes:
        diameter_m: Of the rotor.
        thrust: Rows (advance ratio, thrust over that at rest); empty: always 1.
        torque: The same of the reaction torque.
    """

    diameter_m: float
    thrust: tuple[tuple[float, float], ...]
    torque: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class RunUp:
    """How a rotor follows its command: `dw/dt = linear (u - w) + quadratic (u^2 - w^2)`.

    A motor whose torque falls with its speed, against a torque of the air that grows with the
    square of it, is of this kind.

    Attributes:
        linear_1_s: Of the difference of speeds.
        quadratic_1_rad: Of the difference of their squares.
    """

    linear_1_s: float
    quadratic_1_rad: float


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
        run_up: How the speed follows the command, rising and falling, in place of the lag; None:
            by the lag.
        reaction_inertia_kg_m2: Inertia of one rotor in the reaction to its own acceleration; 0:
            no reaction.
        air: What the air does to a moving rotor.
        advance: Thrust and torque in a climb; None: as at rest, but for `air`.
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
    run_up: tuple[RunUp, RunUp] | None = None
    reaction_inertia_kg_m2: float = 0.0
    air: RotorAir = RotorAir()
    advance: Advance | None = None

    __repr__ = short_repr

    @property
    def count(self) -> int:
        """Number of rotors."""
        return len(self.direction)

    @property
    def follows(self) -> bool:
        """Whether rotors follow their command with a delay of their own."""
        return self.lag_up_s > 0 or self.run_up is not None


@dataclass(frozen=True, slots=True)
class Vehicle:
    """One aircraft in SI units, body FRD about the centre of mass.

    Attributes:
        inertia_kg_m2: Inertia matrix, shape (3, 3).
        drag_linear_n_s_m: Per body axis, shape (3,).
        drag_quadratic_n_s2_m2: Per body axis, by its own speed, `c |v_i| v_i`, shape (3,).
        drag_parasitic_n_s2_m2: Per body axis, by the whole speed, `c |v| v_i`, shape (3,).
        drag_angular_n_m_s2: Moment per body axis, `c |omega_i| omega_i`, shape (3,).
        gravity_m_s2: Acceleration of free fall where it flies.
        leg_height_m: Centre of mass over the ground when standing.
        imu_position_m: Accelerometer from the centre of mass, shape (3,).
        sensors: Noise of the sensors, and the site.
        sources: Pedigree of each number, by its key in the file; "default: ..." where the file
            is silent and a default stands in.
        deviations: Standard deviations that the file states, by the same keys; what else is known
            of them, the sources say (`relative_deviation`).
        doubts: What looks odd but is not refused.
        effects: Effects that are switched on (`twin.effects`), each with all its parameters.
        calibration: Its numbers as determined from flights together; None: not calibrated.
        file: Name of the file that it was read from; "": none.
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
    drag_parasitic_n_s2_m2: Array = field(default_factory=lambda: np.zeros(3))
    drag_angular_n_m_s2: Array = field(default_factory=lambda: np.zeros(3))
    gravity_m_s2: float = GRAVITY_M_S2
    deviations: Mapping[str, Deviation] = field(default_factory=dict)
    calibration: Calibration | None = None
    file: str = field(default="", repr=False, compare=False)

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
        return self.mass_kg * self.gravity_m_s2 / self.rotors.count

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
