"""The aircraft of our own plant, the vehicle file that describes each exactly, and sensor noise.

All numbers are made up, of the size of: a 450 class quadrotor, a 150 mm indoor quadrotor, a
hexacopter with 12 inch rotors.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .own.parameters import FIELD_T, GRAVITY_M_S2, GROUND_PRESSURE_PA, Array, Parameters


@dataclass(frozen=True)
class Noise:
    """White noise of one reading.

    Attributes:
        accel: m/s2.
        gyro: rad/s.
        position: m.
        velocity: m/s.
        attitude: rad, about each body axis.
        mag: T.
        baro: Pa.
        voltage: V.
        quantised: Whether readings of the IMU are multiples of the last bit.
    """

    accel: float
    gyro: float
    position: float
    velocity: float
    attitude: float
    mag: float
    baro: float
    voltage: float
    quantised: bool = True


NOISE = {
    "none": Noise(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, quantised=False),
    "low": Noise(0.02, 0.001, 5e-4, 0.005, 5e-4, 1e-7, 2.0, 0.002),
    "medium": Noise(0.08, 0.004, 2e-3, 0.02, 1.5e-3, 3e-7, 5.0, 0.01),
    "high": Noise(0.3, 0.012, 1e-2, 0.06, 4e-3, 1e-6, 12.0, 0.03),
}
"""Made up: a good, a usual and a poor set of sensors; "none" is for tests."""
ACCEL_BIT_M_S2 = 16 * 9.80665 / 2**15
"""Last bit of a 16-bit accelerometer of +-16 g."""
GYRO_BIT_RAD_S = 2000.0 / 2**15 * 0.017453292519943295
"""Last bit of a 16-bit gyroscope of +-2000 deg/s."""


_X = np.array([[1.0, 1, 0], [-1, -1, 0], [1, -1, 0], [-1, 1, 0]])
_HEX = [[np.cos(a), np.sin(a), 0.0] for a in np.arange(6) * np.pi / 3]
_SPIN = np.array([-1.0, -1.0, 1.0, 1.0])
_MADE_UP = "made up"


@dataclass(frozen=True)
class Aircraft:
    """An aircraft.

    Attributes:
        name: What the vehicle file calls it.
        nominal: Its numbers with nothing hidden.
        by_command: Whether the vehicle file gives thrust against the command, not the speed.
        pace: Speeds of its missions over those of the largest aircraft.
        spin_inertia: Of one rotor about its axis, kg m2; it acts only where it is hidden.
        thrust_of_rpm: Ascending coefficients, N, where thrust is not k times speed squared.
        torque_of_rpm: The same of the reaction torque, N m.
        speed_of_command: Ascending coefficients, rad/s, where the speed is no straight line.
        known: Effects that the plant has with nothing hidden and that the vehicle file has, too.
    """

    name: str
    nominal: Parameters
    by_command: bool
    pace: float
    spin_inertia: float
    thrust_of_rpm: tuple[float, ...] | None = None
    torque_of_rpm: tuple[float, ...] | None = None
    speed_of_command: tuple[float, ...] | None = None
    known: tuple[str, ...] = ()

    @property
    def arm(self) -> float:
        """Largest distance of a hub from the centre of mass, m."""
        return float(np.linalg.norm(self.nominal.hubs[:, :2], axis=1).max())


def _aircraft(
    name: str,
    hubs: Array,
    direction: Array,
    thrust_k: float,
    torque_k: float,
    by_command: bool,
    pace: float,
    spin_inertia: float,
    **numbers: object,
) -> Aircraft:
    r = len(hubs)
    hover = float(np.sqrt(float(numbers["mass"]) * GRAVITY_M_S2 / (r * thrust_k)))  # type: ignore[arg-type]
    nominal = Parameters(
        hubs=hubs,
        direction=direction,
        thrust_k=np.full(r, thrust_k),
        torque_k=np.full(r, torque_k),
        hover_speed=hover,
        **numbers,  # type: ignore[arg-type]
    )
    return Aircraft(name, nominal, by_command, pace, spin_inertia)


AIRCRAFT = {
    a.name: a
    for a in (
        _aircraft(
            "quad_450",
            0.159 * _X + [0, 0, -0.03],
            _SPIN,
            1.105e-5,
            1.779e-7,
            False,
            1.0,
            6e-5,
            mass=1.4,
            inertia=np.array([0.0211, 0.0219, 0.0366]),
            speed_0=80.0,
            speed_1=900.0,
            lag=0.035,
            radius=0.127,
            leg=0.12,
            drag_linear=np.array([0.28, 0.28, 0.36]),
            drag_quadratic=np.zeros(3),
            accel_cutoff_hz=60.0,
            imu_arm=np.array([0.02, -0.01, -0.015]),
        ),
        _aircraft(
            "quad_150",
            0.053 * _X,
            _SPIN,
            2.17e-7,
            2.6e-9,
            True,
            0.8,
            8e-7,
            mass=0.32,
            inertia=np.array([5.2e-4, 6.9e-4, 8.8e-4]),
            speed_0=300.0,
            speed_1=3000.0,
            lag=0.025,
            radius=0.038,
            leg=0.04,
            drag_linear=np.array([0.06, 0.06, 0.08]),
            drag_quadratic=np.array([0.012, 0.012, 0.02]),
            accel_cutoff_hz=80.0,
            full_v=8.4,
            empty_v=6.6,
            reference_v=7.7,
            capacity=1500.0,
            hover_current=9.0,
        ),
        _aircraft(
            "hexa_600",
            0.3 * np.array(_HEX),
            np.array([1.0, -1.0] * 3),
            1.6e-5,
            2.6e-7,
            False,
            1.0,
            6e-5,
            mass=2.6,
            inertia=np.array([0.045, 0.047, 0.082]),
            speed_0=60.0,
            speed_1=850.0,
            lag=0.045,
            radius=0.14,
            leg=0.15,
            drag_linear=np.array([0.5, 0.5, 0.7]),
            drag_quadratic=np.array([0.01, 0.01, 0.02]),
            accel_cutoff_hz=50.0,
            imu_arm=np.array([0.0, 0.0, -0.03]),
            capacity=9000.0,
            hover_current=26.0,
            resistance=0.02,
        ),
    )
}


class _File:
    """A vehicle file in the making."""

    def __init__(self, deviations: Mapping[str, str]) -> None:
        self.lines: list[str] = []
        self._section, self._deviations = "", deviations

    def section(self, name: str) -> None:
        """Begin a section."""
        self._section = name
        self.lines += ["", f"[{name}]"]

    def add(self, key: str, value: object, unit: str) -> None:
        """Add a number or a list."""
        self._entry(key, f'value = {_text(value)}, unit = "{unit}"')

    def polynomial(self, key: str, coefficients: Sequence[float], unit: str, of: str = "") -> None:
        """Add a map with its coefficients."""
        argument = f', of = "{of}"' if of else ""
        self._entry(key, f'coefficients = {_text([*coefficients])}, unit = "{unit}"{argument}')

    def _entry(self, key: str, value: str) -> None:
        known = self._deviations.get(f"{self._section}.{key}")
        deviation = f", sd = {known}" if known else ""
        self.lines.append(f'{key} = {{ {value}, source = "{_MADE_UP}"{deviation} }}')


def vehicle_toml(
    aircraft: Aircraft, noise: Noise, sd: Mapping[str, str] | None = None, by_speed: bool = False
) -> str:
    """The vehicle file that a user of this aircraft believes in (docs/guide/vehicle.md).

    Args:
        aircraft: With the numbers that the user believes.
        noise: Of its sensors.
        sd: Standard deviations of entries as TOML, by "section.key".
        by_speed: Whether measured rotor speeds drive it: nothing is said about commands.
    """
    p, file = aircraft.nominal, _File(sd or {})
    file.lines += [f'name = "{aircraft.name}"', 'description = "Aircraft of a benchmark"']
    file.section("body")
    file.add("mass", p.mass, "kg")
    file.add("inertia", p.inertia, "kg*m^2")
    file.add("drag_linear", p.drag_linear, "N*s/m")
    file.add("drag_quadratic", p.drag_quadratic, "N*s^2/m^2")
    file.add("leg_height", p.leg, "m")
    _add_rotors(file, aircraft, by_speed)
    _add_sensors(file, p, noise)
    momentum = p.spin_inertia_yaw * p.hover_speed
    for effect in aircraft.known:
        file.section(f"effects.{effect}")
        file.add("momentum_n_m_s", momentum, "N*m*s")
    return "\n".join(file.lines) + "\n"


def _add_rotors(file: _File, aircraft: Aircraft, by_speed: bool) -> None:
    p = aircraft.nominal
    file.section("rotors")
    file.add("position", p.hubs, "m")
    names = ["cw" if d > 0 else "ccw" for d in p.direction]
    file.lines.append(f'direction = {{ value = {_text(names)}, source = "{_MADE_UP}" }}')
    k, q, a, b = float(p.thrust_k[0]), float(p.torque_k[0]), p.speed_0, p.speed_1
    if aircraft.by_command and not by_speed:
        file.polynomial("thrust_from_command", [k * a * a, 2 * k * a * b, k * b * b], "N")
        file.add("torque_per_thrust", q / k, "m")
    elif aircraft.thrust_of_rpm and aircraft.torque_of_rpm:
        file.polynomial("thrust_from_speed", aircraft.thrust_of_rpm, "N", of="rpm")
        file.polynomial("torque_from_speed", aircraft.torque_of_rpm, "N*m", of="rpm")
        if not by_speed:
            file.polynomial("speed_from_command", [a, b], "rad/s")
    else:
        file.add("thrust_from_speed", k, "N*s^2/rad^2")
        file.add("torque_from_speed", q, "N*m*s^2/rad^2")
        if not by_speed:
            file.polynomial("speed_from_command", aircraft.speed_of_command or [a, b], "rad/s")
    if not by_speed:
        file.add("lag", p.lag, "s")


def _add_sensors(file: _File, p: Parameters, noise: Noise) -> None:
    file.section("imu")
    file.add("position", p.imu_arm, "m")
    file.add("accel_cutoff", p.accel_cutoff_hz, "Hz")
    file.add("accel_noise", noise.accel, "m/s^2")
    file.add("gyro_noise", noise.gyro, "rad/s")
    file.section("battery")
    file.add("full_voltage", p.full_v, "V")
    file.add("empty_voltage", p.empty_v, "V")
    file.add("capacity", p.capacity, "A*s")
    file.add("resistance", p.resistance, "ohm")
    file.add("hover_current", p.hover_current, "A")
    file.section("magnetometer")
    file.add("field", list(FIELD_T), "T")
    file.add("noise", noise.mag, "T")
    file.section("barometer")
    file.add("noise", noise.baro, "Pa")
    file.section("position")
    file.add("period", 0.01, "s")
    file.add("delay", 0.0, "s")
    file.add("noise", [noise.position] * 3, "m")
    file.add("velocity_noise", [noise.velocity] * 3, "m/s")
    file.add("attitude_noise", noise.attitude, "rad")
    file.section("site")
    file.add("pressure", GROUND_PRESSURE_PA, "Pa")


def _text(value: object) -> str:
    """A number, a text or nested lists of them as TOML."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list):
        return "[" + ", ".join(_text(v) for v in value) + "]"
    return f'"{value}"' if isinstance(value, str) else repr(float(value))  # type: ignore[arg-type]
