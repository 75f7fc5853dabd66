"""The numbers of one aircraft, in SI units, with the source of each.

Also: the joint result of all flights (`Calibration`), the uncertainty of a number, by its file or
by a word of its source (`Deviation`, `Known`), its sensors and the site of its flights.

Functions return the value of the rotors' thrust map, and its argument in hover.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from ..representation import ShortRepr

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Calibration(ShortRepr):
    """Joint uncertainty of calibrated numbers, and their day-to-day variation.

    Attributes:
        flights: Names of the flights used.
        numbers: Names "effect.number", in the unit of the effect.
        covariance: Covariance of these numbers, shape (n, n).
        days: Standard deviation between flights by "effect.number".
        constants: Standard deviation between flights of the unexplained constant, by channel of
            `twin.explain`, in its unit.
        records: Values of numbers that belong to records instead of a vehicle, by "effect.number":
            clocks, the frame of a pose.
        means: Mean residual over all flights of each channel of the balance of forces and moments,
            in its unit, and of "vibration", see `twin.explain.balance`.
        scatter: Sample standard deviation of these means between the flights.
        left: Rms of the residual of each channel of `twin.explain` that these numbers do not
            explain, without noise, in its unit.
    """

    flights: tuple[str, ...]
    numbers: tuple[str, ...]
    covariance: Array
    days: Mapping[str, float]
    constants: Mapping[str, float]
    records: Mapping[str, float] = field(default_factory=dict)
    means: Mapping[str, float] = field(default_factory=dict)
    scatter: Mapping[str, float] = field(default_factory=dict)
    left: Mapping[str, float] = field(default_factory=dict)


DEFAULT = "default: "
"""Start of the source text of a number that a file does not state."""
BEFORE = "; before: "
"""Separator in a source text before the source of an older number."""


@dataclass(frozen=True, slots=True)
class Deviation:
    """Standard deviation of the numbers of one key, as stated in a vehicle file.

    Attributes:
        share: Standard deviation over the value: root mean square of all numbers over that of their
            values, for inertia by its three moments, for positions over the arm. Infinite where the
            value is 0.
        numbers: Standard deviations in SI units, one for all numbers of the key or one for each in
            their order; None where the file states a share.
    """

    share: float
    numbers: tuple[float, ...] | None = None

    @classmethod
    def of(cls, numbers: Sequence[float], size: Sequence[float]) -> Self:
        """Deviation from standard deviations and the values to which they are relative, in the same
        unit."""
        own, whole = (math.sqrt(sum(x * x for x in of) / len(of)) for of in (numbers, size))
        return cls(own / whole if whole > 0 else math.inf, tuple(numbers))


class Known(NamedTuple):
    """Uncertainty of a number.

    Attributes:
        sd: Standard deviation over the value; for positions over the arm.
        stated: Whether the file states it as `sd`; else it is inferred from a word of the source.
    """

    sd: float
    stated: bool


@dataclass(frozen=True, slots=True)
class Word:
    """Uncertainty of a number by the words of its source.

    Attributes:
        share: Standard deviation over the value; for positions over the arm.
        words: Words that imply it, as whole words in any case, unless "not" or the like precedes.
        reason: Justification of the share.
    """

    share: float
    words: tuple[str, ...]
    reason: str


WORDS = (
    Word(0.30, ("made up",), "numbers out of the air are off by a third, more often than not less"),
    Word(
        0.20,
        ("estimate", "estimated", "guess", "guessed"),
        "scaled from a sister frame or from formulas: right to a fifth",
    ),
    Word(0.10, ("CAD",), "cables, glue and battery are not in the drawing: inertia 5 to 10 % off"),
    Word(0.05, ("identified",), "fits to flights of another day differ by this much"),
    Word(0.03, ("measured",), "rulers, pendulums and test stands repeat to a few percent"),
    Word(0.01, ("weighed",), "the scale is better, what is aboard is not always the same"),
)
"""Words of sources in order of doubt: the first row with a word in the source is used. Sizes by
judgement; those of maps and inertia as in the priors of `twin.effects`."""

GROUPS = {
    "rotors.thrust": ("rotors.thrust_from_speed", "rotors.thrust_from_command"),
    "rotors.torque": (
        "rotors.torque_from_speed",
        "rotors.torque_from_command",
        "rotors.torque_per_thrust",
    ),
    "rotors.lag": ("rotors.lag", "rotors.rate_up"),
}
"""Alternative keys for the same quantity, of which a file has one."""


def share_by_word(source: str) -> float | None:
    """Standard deviation over the value that the words of a source imply; None: no word does.

    The source of a previous number (after `BEFORE`) is ignored.
    """
    text = source.split(BEFORE)[0]
    for row in WORDS:
        word, negated = _patterns(row)
        if word.search(negated.sub("", text)):
            return row.share
    return None


@cache
def _patterns(row: Word) -> tuple[re.Pattern[str], re.Pattern[str]]:
    """Patterns for the words of a row, and for the same words after a "not"."""
    any_of = "|".join(word.replace(" ", r"[\s-]+") for word in row.words)
    word = rf"(?<!un-)(?<!non-)\b(?:{any_of})\b"
    negated = rf"\b(?:not|never|no|nor|without)\s+(?:\w+\s+)?{word}"
    return re.compile(word, re.IGNORECASE), re.compile(negated, re.IGNORECASE)


def relative_deviation(vehicle: "Vehicle", key: str) -> Known | None:
    """Uncertainty of the numbers of a key of a vehicle.

    Args:
        vehicle: Vehicle with the numbers.
        key: Key of the vehicle file, "body.mass" or "effects.NAME.NUMBER"; or of `GROUPS`, for
            alternative keys: "rotors.thrust", "rotors.torque", "rotors.lag".

    Returns:
        Standard deviation over the value, for "rotors.position" and other positions over the arm,
        and whether the file states it; None where nothing is known, as for every default.
    """
    for name in GROUPS.get(key, (key,)):
        source = vehicle.sources.get(name, DEFAULT)
        if source.startswith(DEFAULT):
            continue
        if name in vehicle.deviations:
            return Known(vehicle.deviations[name].share, True)
        share = share_by_word(source)
        return None if share is None else Known(share, False)
    return None


EARTH_FIELD_N_T = (2.11e-5, 1.5e-6, 4.384e-5)
"""Magnetic flux density, World Magnetic Model 2025 at 48 N, 11 E, 500 m, mid 2025, rounded."""
SEA_LEVEL_PRESSURE_PA = 101325.0
"""Static pressure, ISA at sea level, ICAO Doc 7488."""
SEA_LEVEL_TEMPERATURE_K = 288.15
"""Temperature, ISA at sea level, ICAO Doc 7488."""


def _number(key: str, stand_in: str = "", default: float = 0.0) -> Any:
    """Field for a number that the vehicle file has under a key.

    Args:
        key: Key in the file.
        stand_in: Default in words, where the file has no such key; default: no noise or no walk, by
            the key.
        default: Default as a number.
    """
    words = stand_in or f"no {key.rpartition('.')[2].rpartition('_')[2]}"
    return field(default=default, metadata={"key": key, "stand_in": words})


@dataclass(frozen=True, slots=True)
class Sensors(ShortRepr):
    """Noise of the sensors, and their readings at the origin of NED.

    Noise is the standard deviation of a reading, walk that of the bias after 1 s.

    Attributes:
        field_n_t: Magnetic flux density, NED, T.
        pressure_pa: Static pressure at the origin.
        temperature_k: Air temperature at the origin.
        position: Differences from a preset of `twin.physics.sensors.position`, by its attribute
            names.
    """

    accel_noise_m_s2: float = _number("imu.accel_noise")
    accel_walk_m_s2: float = _number("imu.accel_walk")
    gyro_noise_rad_s: float = _number("imu.gyro_noise")
    gyro_walk_rad_s: float = _number("imu.gyro_walk")
    mag_noise_t: float = _number("magnetometer.noise")
    mag_walk_t: float = _number("magnetometer.walk")
    baro_noise_pa: float = _number("barometer.noise")
    baro_walk_pa: float = _number("barometer.walk")
    field_n_t: tuple[float, ...] = EARTH_FIELD_N_T
    pressure_pa: float = _number(
        "site.pressure", f"{SEA_LEVEL_PRESSURE_PA:g} Pa", SEA_LEVEL_PRESSURE_PA
    )
    temperature_k: float = _number(
        "site.temperature", f"{SEA_LEVEL_TEMPERATURE_K:g} K", SEA_LEVEL_TEMPERATURE_K
    )
    position: Mapping[str, float | tuple[float, ...]] = field(default_factory=dict)


GRAVITY_M_S2 = 9.80665
"""Standard gravity, CGPM 1901."""
NOMINAL_CELL_V = 3.7
"""Voltage of one lithium polymer cell at half charge."""


@dataclass(frozen=True, slots=True)
class Battery:
    """A battery: open-circuit voltage, linear in charge, in series with a resistance."""

    full_voltage_v: float
    empty_voltage_v: float
    capacity_a_s: float
    resistance_ohm: float
    hover_current_a: float

    @property
    def mean_voltage_v(self) -> float:
        """Open-circuit voltage at half charge."""
        return (self.full_voltage_v + self.empty_voltage_v) / 2


@dataclass(frozen=True, slots=True)
class RotorAir:
    """Aerodynamics of one rotor that moves through the air, at its hub; all 0: none.

    With the rotor speed w, rad/s, and the velocity V of the hub through the air, m/s, body FRD:

        thrust += lift (V_x^2 + V_y^2) + inflow w V_z
        force   = -drag w [V_x, V_y, 0]
        moment  = flapping w [-V_y, V_x, 0] - rolling w [V_x, V_y, 0]

    Source: drag, inflow, lift and flapping (there with the opposite sign), Folk, Paulos & Kumar,
    RotorPy, arXiv 2306.04485; drag and rolling, Martin & Salaun, The True Role of Accelerometer
    Feedback in Quadrotor Control, ICRA 2010, in the form used by Gazebo.

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
    """Thrust and reaction torque over the advance ratio, as in propeller data.

    The advance ratio is the climb speed of the hub through the air over revolutions per second and
    diameter. Linear between the rows, constant beyond them.

    Source: Leishman, Principles of Helicopter Aerodynamics, sec. 2.3; UIUC propeller data.

    Attributes:
        diameter_m: Diameter of the rotor.
        thrust: Rows (advance ratio, thrust over that at rest); empty: always 1.
        torque: Rows (advance ratio, reaction torque over that at rest); empty: always 1.
    """

    diameter_m: float
    thrust: tuple[tuple[float, float], ...]
    torque: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class RunUp:
    """Response of a rotor to its command: `dw/dt = linear (u - w) + quadratic (u^2 - w^2)`.

    A motor with torque falling linearly with speed, loaded by an aerodynamic torque in proportion
    to the square of the speed, has this form.

    Attributes:
        linear_1_s: Coefficient of the difference of speeds.
        quadratic_1_rad: Coefficient of the difference of their squares.
    """

    linear_1_s: float
    quadratic_1_rad: float


@dataclass(frozen=True, slots=True)
class Rotors(ShortRepr):
    """Rotors of one aircraft, equal except for position and direction of rotation.

    Polynomials are ascending coefficients: of the rotor speed in rad/s, or of the command 0..1.

    Attributes:
        position_m: Positions of the hubs from the centre of mass, body FRD, shape (n, 3).
        direction: +1 clockwise seen from above, -1 counter-clockwise, shape (n,).
        thrust_n: Thrust polynomial, of the speed if `from_speed`, else of the command.
        torque_n_m: Reaction torque polynomial of the same argument.
        speed_rad_s: Speed polynomial of the command; None for a vehicle whose input is rotor speed.
        lag_up_s: Time constant when speeding up; 0 without lag.
        lag_down_s: Time constant when slowing down; 0 without lag.
        spin_inertia_kg_m2: Moment of inertia of one rotor about its axis; 0 when unknown.
        reference_voltage_v: Voltage for which the maps over the command are valid; None: ignored.
        voltage_exponent: Power of (voltage / reference) that multiplies the command.
        run_up: Response of the speed to the command, rising and falling, in place of the lag; None:
            by the lag.
        reaction_inertia_kg_m2: Moment of inertia of one rotor in the reaction to its own
            acceleration; 0: no reaction.
        air: Aerodynamics of a moving rotor.
        advance: Thrust and torque in a climb; None: as at rest, except for `air`.
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

    @property
    def count(self) -> int:
        """Number of rotors."""
        return len(self.direction)

    @property
    def follows(self) -> bool:
        """Whether rotors follow their command with a lag of their own."""
        return self.lag_up_s > 0 or self.run_up is not None


@dataclass(frozen=True, slots=True)
class Vehicle(ShortRepr):
    """One aircraft in SI units, body FRD about the centre of mass.

    Attributes:
        inertia_kg_m2: Inertia matrix, shape (3, 3).
        drag_linear_n_s_m: Linear drag per body axis, shape (3,).
        drag_quadratic_n_s2_m2: Drag per body axis, by the speed along it, `c |v_i| v_i`, shape
            (3,).
        drag_parasitic_n_s2_m2: Drag per body axis, by the total speed, `c |v| v_i`, shape (3,).
        drag_angular_n_m_s2: Moment per body axis, `c |omega_i| omega_i`, shape (3,).
        gravity_m_s2: Acceleration of free fall at the site of flight.
        leg_height_m: Height of the centre of mass over the ground when standing.
        imu_position_m: Position of the accelerometer from the centre of mass, shape (3,).
        sensors: Noise of the sensors, and the site.
        sources: Source of each number, by its key in the file; "default: ..." where the file does
            not state it and a default is used.
        deviations: Standard deviations that the file states, by the same keys; the words of the
            sources imply others (`relative_deviation`).
        doubts: Implausible values that are not refused.
        effects: Effects that are switched on (`twin.effects`), each with all its parameters.
        calibration: Numbers determined jointly from flights; None: not calibrated.
        file: Name of the file from which it was read; "": none.
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

    @property
    def drive(self) -> Literal["command", "rotor_speed"]:
        """Input of the vehicle's rotors where the caller does not choose."""
        return (
            "rotor_speed" if self.rotors.from_speed and not self.rotors.speed_rad_s else "command"
        )

    @property
    def hover_thrust_n(self) -> float:
        """Thrust of one rotor in hover, equal for all rotors."""
        return self.mass_kg * self.gravity_m_s2 / self.rotors.count

    @property
    def arm_m(self) -> float:
        """Distance of the farthest rotor from the centre of mass in the rotor plane."""
        return float(np.linalg.norm(self.rotors.position_m[:, :2], axis=1).max())

    @property
    def states_voltage(self) -> bool:
        """Whether the numbers include a voltage."""
        return self.rotors.reference_voltage_v is not None or self.battery is not None

    @property
    def voltage_v(self) -> float:
        """Voltage for which the maps are valid; else that of the battery, of battery_sag, or of one
        cell."""
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


def polynomial(coefficients: Sequence[Any], argument: Any) -> Any:
    """Value of a polynomial with ascending coefficients (Horner)."""
    value = coefficients[-1]
    for c in coefficients[-2::-1]:
        value = c + argument * value
    return value


def hover_level(vehicle: Vehicle) -> float:
    """Argument of the thrust map, rad/s or command, at which equal rotors carry the weight.

    Approximate: the next value of a grid of 2001. The end of the grid where none carries it.
    """
    rotors, high = vehicle.rotors, 1.0
    if rotors.from_speed:
        high = 10.0
        while polynomial(rotors.thrust_n, high) < vehicle.hover_thrust_n and high < 1e6:
            high *= 2
    return first_reaching(rotors.thrust_n, vehicle.hover_thrust_n, high)


def voltage_power(vehicle: Vehicle) -> float:
    """Exponent of the battery voltage in the hover thrust of a command, by the maps; 0 where they
    do not depend on voltage."""
    rotors = vehicle.rotors
    if rotors.reference_voltage_v is None or vehicle.drive != "command":
        return 0.0
    command = level = hover_level(vehicle)
    slope = 1.0
    if rotors.speed_rad_s:
        command = first_reaching(rotors.speed_rad_s, level, 1.0)
        slope = _slope(rotors.speed_rad_s, command)
    growth = slope * _slope(rotors.thrust_n, level) / polynomial(rotors.thrust_n, level)
    return float(rotors.voltage_exponent * command * growth)


def _slope(coefficients: Sequence[float], argument: float) -> float:
    """Derivative of a polynomial."""
    return float(np.polynomial.Polynomial(coefficients).deriv()(argument))


def first_reaching(coefficients: Sequence[float], value: float, high: float) -> float:
    """First argument from 0 to `high`, on a grid of 2001, where a polynomial reaches a value."""
    grid = np.linspace(0.0, high, 2001)
    reached = np.polynomial.polynomial.polyval(grid, coefficients) >= value
    return float(grid[int(np.argmax(reached))] if reached.any() else high)


def most_thrust_n(vehicle: Vehicle) -> float:
    """Largest thrust of one rotor over all commands, N; on a grid of 201."""
    rotors, command = vehicle.rotors, np.linspace(0.0, 1.0, 201)
    level = polynomial(rotors.speed_rad_s, command) if rotors.speed_rad_s else command
    return float(np.max(polynomial(rotors.thrust_n, level)))
