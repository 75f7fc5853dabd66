"""Aircraft that a controller flies through disturbances, and the logs of their flights.

The plant is the built-in quadrotor with inertia, lag, centre of mass, thrust and yaw torque drawn
from the priors of a calibration; the controller is designed on the file. Force and moment
are Ornstein-Uhlenbeck processes, as of turbulence, and nobody excites the aircraft on purpose. What
differs between days is drawn from its priors, too: centre of mass, constant force and moment. The
log holds what an autopilot logs of its setpoints: velocity of the mission, and an attitude that the
position loop asks for, disturbances in it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from twin.effects import EFFECTS, prior_of
from twin.effects.parameters import Normal
from twin.explain.inference.noise import constants_of_days
from twin.explain.settings import DEFAULT
from twin.flight.closed_loop import STEP_S
from twin.flight.control_laws import linearise
from twin.flight.lqr import design
from twin.flight.simulate_flight import Recorder, Stream, simulate_flight
from twin.logs import Flight
from twin.logs.autopilot import SETPOINT_S, Autopilot, setpoints_of_mission
from twin.logs.columns import ACC, GYRO, POS, QUAT, VEL, motor_columns
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import Waypoints, setpoints_along

Array = NDArray[np.float64]
VEHICLE = load_vehicle("copter_default")
_START: Waypoints = (("ground", 1.0, (0.0, 0.0, 0.0)), ("takeoff", 3.0, (0.0, 0.0, -1.5)))
"""A record that began with the rotors at speed would be taken for one that begins in the air."""
START_S = sum(duration_s for _, duration_s, _ in _START)
"""When the aircraft has taken off."""
MISSIONS: dict[str, Waypoints] = {
    "hover": (*_START, ("hover", 32.0, (0.0, 0.0, -1.5))),
    "tour": (
        *_START,
        *(
            ("forward", 2.0, (x, y, -1.5 - 0.3 * (k % 2)))
            for k, (x, y) in enumerate(4 * [(3.0, 0.0), (3.0, 2.0), (0.0, 2.0), (0.0, 0.0)])
        ),
    ),
}
LEAST = {"thrust_scale": 0.85}
"""Of the file: rotors that are weaker saturate on the way."""
LOG_S = 0.005
"""Between two rows of the log; a command in it is the mean of those until the next."""
FORCE_M_S2, FORCE_S = 0.5, 1.0
"""Deviation of the disturbance in force over mass, and its time constant."""
TURN_RAD_S2, TURN_S = (2.0, 2.0, 0.4), 0.15
"""Deviation of the disturbance in moment over inertia, and its time constant."""
TURNED_RAD, TURNED_HZ = 0.6, 0.2
"""Of the nose in the tour: half of the amplitude goes to and fro at twice the frequency."""


@dataclass(frozen=True, slots=True)
class Case:
    """One flight.

    Attributes:
        mission: Of `MISSIONS`.
        log: "imu" with accelerometer and gyroscope, "pose" without.
        seed: Of everything that is drawn.
    """

    mission: str
    log: str
    seed: int

    @property
    def name(self) -> str:
        """Of its file."""
        return f"{self.mission}_{self.log}_{self.seed}"


NUMBERS = {
    "inertia_error": ("scale_x", "scale_y"),
    "motor_lag": ("tau_s",),
    "cog_offset": ("x_m", "y_m"),
    "thrust_scale": ("scale",),
    "yaw_torque_scale": ("scale",),
}
"""What differs from the file, by effect."""


def planted(seed: int) -> dict[str, dict[str, float]]:
    """Numbers of an aircraft, by effect."""
    rng = np.random.default_rng([seed, 1])
    found: dict[str, dict[str, float]] = {}
    for effect, own in NUMBERS.items():
        about = {p.name: p.sized(VEHICLE) for p in EFFECTS[effect].parameters}
        numbers = {n: a.neutral or 0.0 for n, a in about.items()}
        for name in own:
            expected = _expected(effect, name)
            low, high = about[name].bounds
            low = max(low, LEAST.get(effect, low))
            while not low <= (value := _drawn(expected, about[name].neutral, rng)) <= high:
                pass
            numbers[name] = value
        found[effect] = numbers
    return found


def _expected(effect: str, name: str) -> Normal:
    """Prior of a number."""
    about = next(p for p in EFFECTS[effect].parameters if p.name == name)
    prior = prior_of(EFFECTS[effect])
    return prior.change(prior.of(name, False).sized(about, VEHICLE), VEHICLE)


def _on_its_day(
    planted: Mapping[str, Mapping[str, float]], rng: np.random.Generator
) -> dict[str, dict[str, float]]:
    """Numbers of one flight: those of the aircraft and what differs between days."""
    return {
        e: {n: v + _expected(e, n).day * float(rng.standard_normal()) for n, v in own.items()}
        for e, own in planted.items()
    }


def _drawn(expected: Normal, neutral: float | None, rng: np.random.Generator) -> float:
    """A number from its prior, a factor on a logarithmic scale."""
    off = expected.sd * float(rng.standard_normal())
    return float(np.exp(off)) if neutral == 1.0 else expected.mean + off


def flown(case: Case) -> Flight:
    """The log of a case."""
    day = np.random.default_rng([case.seed, 3])
    plant = VEHICLE.with_effects(_on_its_day(planted(case.seed), day))
    setpoints, phases = setpoints_along(VEHICLE, MISSIONS[case.mission])
    if case.mission == "tour":
        setpoints[:, 9] = _heading(np.asarray(STEP_S * np.arange(len(setpoints))))
    drives = motor_columns("cmd", VEHICLE.rotors.count)
    imu = (Stream(ACC, STEP_S, 0.05), Stream(GYRO, STEP_S, 0.005)) if case.log == "imu" else ()
    pose = Stream(POS, 0.01, 0.001), Stream(VEL, 0.01, 0.01), Stream(QUAT, 0.01, 0.0005)
    recorder = Recorder((Stream(drives, STEP_S), *imu, *pose), 1 / STEP_S, 1 / STEP_S, case.seed)
    courses = _disturbances(len(setpoints), np.random.default_rng([case.seed, 2]), day)
    flight = simulate_flight(
        setpoints, phases, VEHICLE, plant, recorder, case.name, courses=courses
    )
    every, table = round(LOG_S / STEP_S), flight.table
    means = table[list(drives)].rolling(every).mean().shift(1 - every)
    table = table.assign(**{c: means[c] for c in drives}).iloc[::every].iloc[:-1]
    flight = replace(flight, table=table.reset_index(drop=True))
    return replace(flight, autopilot=_with_feedback(flight, setpoints))


def _heading(t_s: Array) -> Array:
    """Nose to and fro, from the end of the climb on, rad."""
    since = np.clip(t_s - START_S, 0.0, None)
    return TURNED_RAD * np.sin(2 * np.pi * TURNED_HZ * since) ** 2


def _disturbances(
    n: int, rng: np.random.Generator, day: np.random.Generator
) -> Mapping[str, Array]:
    """Force, N, and moment, Nm, over the steps of a flight: turbulence, and the constants of the
    day."""
    weights = np.append(np.full(3, VEHICLE.mass_kg), np.diag(VEHICLE.inertia_kg_m2))
    sizes = np.append(np.full(3, FORCE_M_S2), TURN_RAD_S2)
    channels = [f"{kind}_{a}" for kind in ("acc", "gyro_rate") for a in "xyz"]
    constants = constants_of_days(channels, VEHICLE, DEFAULT.inference.evidence)
    found = {}
    for k, (weight, size, constant) in enumerate(zip(weights, sizes, constants, strict=True)):
        time_s, name = (FORCE_S, "force") if k < 3 else (TURN_S, "moment")
        moved = size * _process(n, time_s, rng) + constant * day.standard_normal()
        found[f"{name}_{'xyz'[k % 3]}"] = weight * moved
    return found


def _process(n: int, time_s: float, rng: np.random.Generator) -> Array:
    """Ornstein-Uhlenbeck process of deviation one, shape (n,)."""
    kept = np.exp(-STEP_S / time_s)
    noise = np.sqrt(1 - kept**2) * rng.standard_normal(n)
    return np.asarray(lfilter([1.0], [1.0, -kept], noise))


def _with_feedback(flight: Flight, setpoints: Array) -> Autopilot:
    """Velocity of the mission, and the attitude that the position loop asks for."""
    rows = setpoints[:: round(SETPOINT_S / STEP_S)].copy()
    t_s = SETPOINT_S * np.arange(len(rows))
    place, speed = (
        np.column_stack([np.interp(t_s, known_s, x) for x in values.T])
        for known_s, values in (flight.signal(POS), flight.signal(VEL))
    )
    gain = design(linearise(VEHICLE)).horizontal.gain
    rows[:, 6:8] += (VEHICLE.gravity_m_s2 / gain[3]) * (
        gain[1] * (rows[:, :2] - place[:, :2]) + gain[2] * (rows[:, 3:5] - speed[:, :2])
    )
    return setpoints_of_mission(rows, SETPOINT_S, VEHICLE.gravity_m_s2)
