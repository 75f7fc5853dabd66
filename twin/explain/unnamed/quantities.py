"""What an equation may be made of: quantities of a flight on its grid, with units.

Each is known without the reading that it is to explain: motion from the pose, turning from the
gyroscope, load from the equations of the rotors. An accelerometer explains nothing here.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...frames import to_body
from ...residuals.channels import GRID_HZ
from ...vehicle import GRAVITY_M_S2
from ...vehicle.thrust_map import hover_level
from ..model.flight import FlightModel

Array = NDArray[np.float64]
Unit = Mapping[str, int]
"""Powers of base units."""
PLAIN: Unit = {}
SPEED: Unit = {"m": 1, "s": -1}
TURNING: Unit = {"rad": 1, "s": -1}


@dataclass(frozen=True, slots=True)
class Quantity:
    """One quantity of one flight.

    Attributes:
        unit: Powers of base units.
        values: On the grid, shape (n,).
        degree: 2: it may be multiplied with others; 1: it stands alone.
    """

    unit: Unit
    values: Array
    degree: int = 2


def quantities(flight: FlightModel) -> dict[str, Quantity]:
    """By symbol; what the flight does not hold is left out."""
    aligned, t = flight.aligned, flight.aligned.inputs.t_s
    motion = aligned.motion
    found = _of_rotors(flight)
    if motion.velocity is not None and motion.attitude is not None:
        q = list(motion.attitude.at(t).T)
        speed = np.stack(to_body(q, list(motion.velocity.at(t).T)))
        found |= {f"v_{a}": Quantity(SPEED, v) for a, v in zip("xyz", speed, strict=True)}
        found["|v|"] = Quantity(SPEED, np.sqrt((speed**2).sum(axis=0)))
    if motion.rates is not None:
        rates = motion.rates.at(t).T
        found |= {f"omega_{a}": Quantity(TURNING, r) for a, r in zip("xyz", rates, strict=True)}
    if motion.attitude is not None:
        q = list(motion.attitude.at(t).T)
        for name, way in (("north", (1, 0, 0)), ("east", (0, 1, 0)), ("down", (0, 0, 1))):
            along = to_body(q, [np.full(len(t), float(w)) for w in way])
            for a, value in zip("xyz", along, strict=True):
                found[f"{name}_{a}"] = Quantity(PLAIN, np.asarray(value), degree=1)
    if motion.position is not None:
        found["height"] = Quantity({"m": 1}, -motion.position.at(t)[:, 2])
    if "vbat_v" in aligned.airframe.input_names and flight.flight.has("vbat_v"):
        u = aligned.inputs.u[:, aligned.airframe.input_names.index("vbat_v")]
        found["voltage"] = Quantity({"V": 1}, u)
    found["time"] = Quantity({"s": 1}, t - t[0], degree=1)
    return found


def _of_rotors(flight: FlightModel) -> dict[str, Quantity]:
    """Thrust over the weight, and commands over that of hover: whole, and front over rear, right
    over left, clockwise over counter-clockwise."""
    aligned, vehicle = flight.aligned, flight.vehicle
    body, u = aligned.airframe, aligned.inputs.u
    rotors = vehicle.rotors
    y = body.outputs_along(aligned.states, u, {"ground.enabled": 0.0}).T
    names = [f"thrust_{i + 1}" for i in range(rotors.count)]
    weight = vehicle.mass_kg * GRAVITY_M_S2
    thrust = y[[body.output_names.index(n) for n in names]] / weight
    drives = [i for i, n in enumerate(body.input_names) if n.startswith(("cmd_", "rotor_"))]
    level = hover_level(vehicle)
    if not rotors.from_speed or body.input_names[drives[0]].startswith("rotor_"):
        command = u[:, drives].T / level
    else:
        assert rotors.speed_rad_s is not None
        grid = np.linspace(0, 1, 2001)
        reached = np.polynomial.polynomial.polyval(grid, rotors.speed_rad_s)
        command = u[:, drives].T / max(float(grid[int(np.argmin(np.abs(reached - level)))]), 1e-3)
    place = rotors.position_m / vehicle.arm_m
    found = {}
    for stem, values, degree in (
        ("thrust", thrust.sum(axis=0), 2),
        ("command", command.mean(0), 1),
    ):
        found[stem] = Quantity(PLAIN, values, degree)
    for side, sign in (("front", place[:, 0]), ("right", place[:, 1]), ("spin", rotors.direction)):
        share = sign / max(float(np.abs(sign).sum()), 1e-9)
        found[f"thrust_{side}"] = Quantity(PLAIN, rotors.count * share @ thrust)
        found[f"command_{side}"] = Quantity(PLAIN, share @ command, degree=1)
    return found


def later(quantity: Quantity, by_s: float) -> Quantity:
    """The same, late: what it was a while ago."""
    shift = round(by_s * GRID_HZ)
    values = np.concatenate([np.full(shift, quantity.values[0]), quantity.values[:-shift]])
    return Quantity(quantity.unit, values, quantity.degree)
