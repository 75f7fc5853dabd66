"""Built-in flights of `uavtwin demo` with a hidden effect.

The plant is the airframe of a built-in vehicle with one change that the twin does not know; a
controller designed on the twin flies it, and noisy sensors record it as a flight table.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.effects.air import ROTOR_DRAG
from twin.effects.mass import COG_OFFSET, INERTIA_ERROR, MASS_OFFSET
from twin.effects.propulsion import THRUST_SCALE
from twin.flight.closed_loop import STEP_S
from twin.flight.mission import (
    minimum_jerk,
    minimum_jerk_acceleration,
    minimum_jerk_speed,
)
from twin.flight.simulate_flight import Recorder, Stream, simulate_flight
from twin.logs import Flight
from twin.logs.columns import ACC, GYRO, POS, QUAT, VEL, motor_columns
from twin.vehicle import Vehicle

Array = NDArray[np.float64]
IMU_S, POSE_S = 0.005, 0.01
"""Sample periods of IMU and pose in the generated flights, s."""
ACC_NOISE_M_S2, GYRO_NOISE_RAD_S = 0.05, 0.005  # made up: a quiet MEMS IMU
POS_NOISE_M, VEL_NOISE_M_S, ATT_NOISE = 0.001, 0.01, 0.0005  # made up: motion capture

Waypoints = tuple[tuple[str, float, tuple[float, float, float]], ...]
WAYPOINTS: Waypoints = (
    ("ground", 1.0, (0.0, 0.0, 0.0)),
    ("takeoff", 3.0, (0.0, 0.0, -1.5)),
    ("hover", 4.0, (0.0, 0.0, -1.5)),
    ("forward", 3.0, (6.0, 0.0, -1.5)),
    ("forward", 3.0, (6.0, 5.0, -2.0)),
    ("forward", 3.0, (0.0, 5.0, -2.0)),
    ("forward", 3.0, (0.0, 0.0, -1.5)),
    ("hover", 3.0, (0.0, 0.0, -1.5)),
    ("land", 3.0, (0.0, 0.0, 0.0)),
    ("ground", 1.0, (0.0, 0.0, 0.0)),
)
"""Phase, duration in s, and position reached at its end (m NED from the resting place)."""


@dataclass(frozen=True, slots=True)
class Hidden:
    """An effect in the plant: its identifier, and a description in words."""

    effect: str
    text: str
    plant: Vehicle


def hide(vehicle: Vehicle, seed: int) -> Hidden:
    """Draw one effect and its size."""
    rng = np.random.default_rng(seed)
    effect = str(rng.choice(sorted(_HIDERS)))
    return _HIDERS[effect](vehicle, rng)


def fly(
    vehicle: Vehicle,
    plant: Vehicle,
    seed: int,
    name: str = "demo",
    waypoints: Waypoints = WAYPOINTS,
    imu_s: float = IMU_S,
) -> Flight:
    """Fly the waypoints with the plant under the twin's controller and record the sensors.

    Args:
        vehicle: Vehicle for which the controller was designed.
        plant: Vehicle that flies.
        seed: Seed of the sensor noise.
        name: Name of the flight.
        waypoints: Phase, duration and position of each leg.
        imu_s: Time between two rows of the table, with commands and IMU in each.
    """
    setpoints, phases = setpoints_along(plant, waypoints)
    recorder = recorder_of(plant, seed, imu_s)
    return simulate_flight(setpoints, phases, vehicle, plant, recorder, name)


def recorder_of(plant: Vehicle, seed: int, imu_s: float) -> Recorder:
    """Settings of motion capture and a low-noise IMU; arguments as in `fly`."""
    drives = motor_columns("cmd" if plant.drive == "command" else "rotor", plant.rotors.count)
    return Recorder(
        streams=(
            Stream(drives, imu_s),
            Stream(ACC, imu_s, ACC_NOISE_M_S2),
            Stream(GYRO, imu_s, GYRO_NOISE_RAD_S),
            Stream(POS, POSE_S, POS_NOISE_M),
            Stream(VEL, POSE_S, VEL_NOISE_M_S),
            Stream(QUAT, POSE_S, ATT_NOISE),
        ),
        rate_hz=1 / imu_s,
        sampled_hz=1 / STEP_S,
        seed=seed,
    )


def setpoints_along(plant: Vehicle, waypoints: Waypoints) -> tuple[Array, list[str]]:
    """Setpoints along waypoints (minimum-jerk, nose north), shape (n, 11), and phases."""
    here = np.array([0.0, 0.0, -plant.leg_height_m])
    rest = here.copy()
    rows, phases = [], []
    for phase, duration, place in waypoints:
        there = rest + np.array(place)
        s: Array = (
            np.arange(round(duration / STEP_S), dtype=np.float64)[:, None] * STEP_S / duration
        )
        speed = minimum_jerk_speed(s) / duration
        push = minimum_jerk_acceleration(s) / duration**2
        yaw, armed = np.zeros_like(s), np.full_like(s, phase != "ground")
        leg = there - here
        rows.append(np.hstack([here + minimum_jerk(s) * leg, speed * leg, push * leg, yaw, armed]))
        phases += [phase] * len(s)
        here = there
    return np.vstack(rows), phases


# -- effects --------------------------------------------------------------------------------


def _mass_offset(vehicle: Vehicle, rng: np.random.Generator) -> Hidden:
    share = rng.uniform(0.05, 0.15)
    plant = replace(vehicle, mass_kg=vehicle.mass_kg * (1 + share))
    return Hidden(MASS_OFFSET.name, f"{share * vehicle.mass_kg * 1e3:.0f} g of extra mass", plant)


def _rotor_drag(vehicle: Vehicle, rng: np.random.Generator) -> Hidden:
    k = rng.uniform(0.3, 0.7)
    drag = vehicle.drag_linear_n_s_m + k * vehicle.mass_kg * np.array([1.0, 1.0, 0.0])
    return Hidden(
        ROTOR_DRAG.name,
        f"rotor drag of {k:.2f} 1/s along x and y",
        replace(vehicle, drag_linear_n_s_m=drag),
    )


def _cog_offset(vehicle: Vehicle, rng: np.random.Generator) -> Hidden:
    arm = float(np.linalg.norm(vehicle.rotors.position_m[0, :2]))
    shift = rng.uniform(0.03, 0.08) * arm * np.array([1.0, rng.choice([-1.0, 1.0]), 0.0])
    rotors = replace(vehicle.rotors, position_m=vehicle.rotors.position_m - shift)
    text = f"centre of mass moved by {1e3 * shift[0]:.1f}, {1e3 * shift[1]:.1f} mm forward, right"
    return Hidden(COG_OFFSET.name, text, replace(vehicle, rotors=rotors))


def _thrust_scale(vehicle: Vehicle, rng: np.random.Generator) -> Hidden:
    share = rng.uniform(0.06, 0.15)
    rotors = replace(
        vehicle.rotors, thrust_n=tuple((1 - share) * c for c in vehicle.rotors.thrust_n)
    )
    return Hidden(
        THRUST_SCALE.name,
        f"rotors give {100 * share:.0f} % less thrust",
        replace(vehicle, rotors=rotors),
    )


def _inertia_error(vehicle: Vehicle, rng: np.random.Generator) -> Hidden:
    share = rng.uniform(0.3, 0.6)
    inertia = vehicle.inertia_kg_m2 * (1 + share)
    return Hidden(
        INERTIA_ERROR.name,
        f"{100 * share:.0f} % more inertia",
        replace(vehicle, inertia_kg_m2=inertia),
    )


_HIDERS: dict[str, Callable[[Vehicle, np.random.Generator], Hidden]] = {
    MASS_OFFSET.name: _mass_offset,
    ROTOR_DRAG.name: _rotor_drag,
    COG_OFFSET.name: _cog_offset,
    THRUST_SCALE.name: _thrust_scale,
    INERTIA_ERROR.name: _inertia_error,
}
"""Function that draws the numbers of an effect and changes the vehicle, by effect."""
