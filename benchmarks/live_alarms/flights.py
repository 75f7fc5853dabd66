"""Simulated flights in which an effect begins, and others in which nothing does.

The built-in vehicles in closed loop along random waypoints, in a steady wind with first-order
turbulence, with the sensors of the benchmark of hidden effects at their medium noise; sizes are
those of that benchmark. Seeds below 1000 are for tuning, the others for the score.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from benchmarks.hidden_effects.plants.aircraft import NOISE
from twin.flight.closed_loop import STEP_S
from twin.flight.simulate_flight import Later, Recorder, Stream, simulate_flight
from twin.logs import Flight
from twin.logs.columns import ACC, GYRO, POS, QUAT, VEL, motor_columns
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import Waypoints, setpoints_along

Array = NDArray[np.float64]
Numbers = Mapping[str, float]
AIRCRAFT = ("copter_default", "crazyflie", "feisi_x150")
DRAG_1_S = 0.3
"""Of vehicles whose file gives none, over their mass: else no wind would be felt."""
LAG_S = 0.02
"""Of rotors whose file gives none."""
SIZES: dict[str, tuple[float, float, float]] = {
    "rotor_efficiency_loss": (0.05, 0.1, 0.18),
    "battery_sag": (0.5, 1.0, 2.0),
    "mass_offset": (0.03, 0.08, 0.16),
    "cog_offset": (0.01, 0.03, 0.07),
    "motor_lag": (0.008, 0.02, 0.045),
    "steady_wind": (1.5, 3.5, 7.0),
    "accel_bias": (0.1, 0.25, 0.6),
    "gyro_bias": (0.01, 0.025, 0.06),
    "mag_hard_iron": (2e-6, 5e-6, 12e-6),
    "baro_bias": (20.0, 60.0, 200.0),
    "stuck_sensor": (1.0, 1.0, 1.0),
    "vibration": (0.3, 1.0, 3.0),
}
"""Small, medium, large: benchmarks/hidden_effects/hiding; a stuck reading has no size."""
MAGNITUDES = ("small", "medium", "large")
SAG, SAG_S = 0.1, 2.0
"""Share of its voltage that a failing battery loses, and how fast. Made up."""
AFTER_S = 15.0
"""Flown on after an effect has begun."""


@dataclass(frozen=True)
class Case:
    """One flight.

    Attributes:
        effect: What begins; "" for nothing.
        magnitude: small, medium or large; "none" where nothing begins.
        seed: Of everything that is drawn.
        seconds: How long it flies where nothing begins.
    """

    effect: str
    magnitude: str
    seed: int
    seconds: float = 0.0

    @property
    def name(self) -> str:
        """For files."""
        return f"{self.effect or 'nothing'}_{self.magnitude}_{self.seed}"

    @property
    def aircraft(self) -> str:
        """Which flies."""
        return AIRCRAFT[self.seed % len(AIRCRAFT)]

    @property
    def rng(self) -> np.random.Generator:
        """Fresh generator."""
        return np.random.default_rng([self.seed, *self.effect.encode()])


def aircraft(name: str) -> Vehicle:
    """A built-in vehicle with drag and lag, which its model has as well."""
    v = load_vehicle(name)
    if not v.drag_linear_n_s_m.any():
        v = replace(v, drag_linear_n_s_m=DRAG_1_S * v.mass_kg * np.ones(3))
    if not v.rotors.follows:
        v = replace(v, rotors=replace(v.rotors, lag_up_s=LAG_S, lag_down_s=LAG_S))
    return v


def flown(case: Case) -> tuple[Flight, float]:
    """The flight, and when its effect begins; infinity where none does."""
    rng, vehicle = case.rng, aircraft(case.aircraft)
    begins_s = float(rng.uniform(22.0, 30.0)) if case.effect else np.inf
    seconds = begins_s + AFTER_S if case.effect else case.seconds
    setpoints, phases = setpoints_along(vehicle, waypoints(vehicle, seconds, rng))
    later = None
    if case.effect:
        size = SIZES[case.effect][MAGNITUDES.index(case.magnitude)]
        later = Later({case.effect: numbers(case.effect, size, vehicle, rng)}, begins_s)
    courses = air(len(setpoints), rng)
    courses["vbat_v"] = voltage(
        vehicle, len(setpoints), begins_s if case.effect == "battery_sag" else np.inf
    )
    recorder = recorder_of(vehicle, int(rng.integers(2**31)))
    flight = simulate_flight(
        setpoints, phases, vehicle, vehicle, recorder, case.name, later=later, courses=courses
    )
    return flight, begins_s


def numbers(effect: str, size: float, v: Vehicle, rng: np.random.Generator) -> Numbers:
    """Numbers of an effect of a size, signs and directions drawn."""
    sign = float(rng.choice([-1.0, 1.0]))
    angle = float(rng.uniform(0, 2 * np.pi))
    across = (np.cos(angle), np.sin(angle))
    space = rng.standard_normal(3)
    space /= np.linalg.norm(space)
    rotors = range(1, v.rotors.count + 1)
    lost = int(rng.integers(1, v.rotors.count + 1))
    table: dict[str, dict[str, float]] = {
        "rotor_efficiency_loss": {
            **{f"loss_{i}": size * (i == lost) for i in rotors},
            "torque_share": 1.0,
        },
        "battery_sag": {"slope": size, "reference_v": v.voltage_v},
        "mass_offset": {"mass_kg": sign * size * v.mass_kg},
        "cog_offset": {
            "x_m": size * v.arm_m * across[0],
            "y_m": size * v.arm_m * across[1],
            "z_m": 0.0,
        },
        "motor_lag": {"tau_s": size},
        "steady_wind": {
            "north_m_s": size * across[0],
            "east_m_s": size * across[1],
            "down_m_s": 0.0,
        },
        "accel_bias": {f"{a}_m_s2": size * x for a, x in zip("xyz", space, strict=True)},
        "gyro_bias": {f"{a}_rad_s": size * x for a, x in zip("xyz", space, strict=True)},
        "mag_hard_iron": {f"{a}_t": size * x for a, x in zip("xyz", space, strict=True)},
        "baro_bias": {"pa": sign * size},
        "stuck_sensor": {"channel": float(rng.integers(1, 7)), "time_s": 0.0},
        "vibration": {
            "frequency_hz": float(rng.uniform(30.0, 90.0)),
            "accel_m_s2": size,
            "gyro_rad_s": 0.02 * size,
        },
    }
    return {k: float(x) for k, x in table[effect].items()}


def waypoints(v: Vehicle, seconds: float, rng: np.random.Generator) -> Waypoints:
    """Take-off, a hover, then legs and hovers by chance until the time is over."""
    reach = 1.5 if v.arm_m < 0.06 else 5.0
    legs = [
        ("ground", 1.0, (0.0, 0.0, 0.0)),
        ("takeoff", 3.0, (0.0, 0.0, -1.5)),
        ("hover", 4.0, (0.0, 0.0, -1.5)),
    ]
    here = np.array([0.0, 0.0, -1.5])
    while sum(leg[1] for leg in legs) < seconds:
        if rng.uniform() < 0.3:
            legs.append(("hover", float(rng.uniform(2.0, 4.0)), (here[0], here[1], here[2])))
            continue
        there = np.array([*rng.uniform(-reach, reach, 2), rng.uniform(-3.0, -1.2)])
        fast = float(np.linalg.norm(there - here)) / (0.3 * reach)
        legs.append(("forward", max(2.0, fast * float(rng.uniform(0.7, 1.3))), (*there,)))
        here = there
    return tuple((p, float(s), (float(x), float(y), float(z))) for p, s, (x, y, z) in legs)


def air(n: int, rng: np.random.Generator) -> dict[str, Array]:
    """Wind: steady, level, up to 3 m/s, and turbulence about it, shape (n,) each."""
    speed, angle = float(rng.uniform(0.0, 3.0)), float(rng.uniform(0, 2 * np.pi))
    steady = (speed * np.cos(angle), speed * np.sin(angle), 0.0)
    sigma, time = float(rng.uniform(0.1, 0.5)), float(rng.uniform(0.4, 1.2))
    stay = float(np.exp(-STEP_S / time))
    kicks = sigma * np.sqrt(1 - stay**2) * rng.standard_normal((n, 3)) * (1.0, 1.0, 0.5)
    gust = lfilter([1.0], [1.0, -stay], kicks, axis=0)
    return {f"wind_{a}": steady[i] + gust[:, i] for i, a in enumerate("xyz")}


def voltage(v: Vehicle, n: int, fails_s: float) -> Array:
    """A battery that loses 2 % in five minutes, and much more once it fails."""
    t = STEP_S * np.arange(n)
    since = np.clip(t - fails_s, 0.0, None)
    charged = 1 - 0.02 * t / 300.0
    return np.asarray(v.voltage_v * charged * (1 - SAG * (1 - np.exp(-since / SAG_S))))


def recorder_of(v: Vehicle, seed: int) -> Recorder:
    """What is recorded of a flight, with medium noise."""
    noise = NOISE["medium"]
    drives = motor_columns("cmd" if v.drive == "command" else "rotor", v.rotors.count)
    streams = (
        Stream(drives, 0.005),
        Stream(ACC, 0.005, noise.accel),
        Stream(GYRO, 0.005, noise.gyro),
        Stream(("mag_x", "mag_y", "mag_z"), 0.02, noise.mag),
        Stream(("baro_pa",), 0.02, noise.baro),
        Stream(POS, 0.01, noise.position),
        Stream(VEL, 0.01, noise.velocity),
        Stream(QUAT, 0.01, noise.attitude / 2),
        Stream(("vbat_v",), 0.1, 0.001 * v.voltage_v),
    )
    return Recorder(streams, 200.0, 200.0, seed)
