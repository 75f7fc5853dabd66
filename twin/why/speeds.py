"""Speed against thrust: whether the speed of a rotor that loses thrust falls with it, where rotor
speeds are logged as well as commands.

    n_i = a_i + b_i c_i * lag + v

learned for each rotor from the seconds before an onset. With a fault of motor, speed controller or
supply the speed falls; with a broken or slipping propeller thrust falls at constant or rising
speed, since its torque is smaller. Thrust is proportional to the square of the speed: a loss d by
the motor reduces the speed by 1 - sqrt(1 - d).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from .flight import Array, FlightFrame

BEFORE_S, SETTLES_S, AFTER_S = 20.0, 0.3, 3.0
"""Time before an onset for learning the speed by command; times after it from and until which it is
compared."""
LAGS_S = (0.0, 0.02, 0.04, 0.08, 0.15)
"""Candidate lags of the speed behind the command."""
SHARE = (0.3, 0.7)
"""Share of the expected drop of speed: below the first the speed is constant, above the second it
falls with the thrust; between them nothing is reported."""
LEAST = 3.0
"""Standard deviations by which the two must differ for a conclusion."""


@dataclass(frozen=True, slots=True)
class Speed:
    """Change of a rotor's speed at an onset.

    Attributes:
        lost: Lost share of the speed that corresponds to its command.
        sd: Standard deviation of that share, by the other rotors and by the seconds before.
        tells: "motor", "propeller", or "" where that is not clear.
    """

    lost: float
    sd: float
    tells: Literal["motor", "propeller", ""]


CHECKS = {
    "motor": "Rotor {rotor}: its speed falls with its thrust, so motor (bearing, windings), speed "
    "controller and cables; not the propeller.",
    "propeller": "Rotor {rotor}: its speed stays, so the propeller (broken, loose, slipping); not "
    "the motor.",
    "": "",
}
"""Bench check by the faulty part."""


def speed_of(flight: FlightFrame, rotor: int, onset_s: float, thrust_lost: float) -> Speed | None:
    """Change of a rotor's speed when it loses thrust.

    Args:
        flight: Flight with commands and speeds.
        rotor: Number of the rotor, from 1.
        onset_s: Time of the loss of thrust, s.
        thrust_lost: Lost share of thrust.

    Returns:
        None where commands or speeds are not logged, or the data are insufficient.
    """
    if not {"command", "rotor_speed"} <= flight.grid.keys():
        return None
    command, speed = flight.grid["command"], flight.grid["rotor_speed"]
    if command.shape != speed.shape:
        return None
    t = flight.t_s
    before = (t > onset_s - BEFORE_S) & (t < onset_s - flight.dt_s)
    after = (t > onset_s + SETTLES_S) & (t < onset_s + AFTER_S)
    if before.sum() < 4 / flight.dt_s or after.sum() < 2:
        return None
    ratio = speed / np.maximum(_expected(command, speed, before, flight.dt_s), 1e-3)
    lost = 1 - np.median(ratio[after], axis=0)
    others = np.delete(lost, rotor - 1)
    sd = float(np.hypot(np.std(others), np.std(ratio[before, rotor - 1])) + 1e-3)
    mine = float(lost[rotor - 1] - np.median(others))
    asked = 1 - np.sqrt(1 - min(thrust_lost, 1.0))
    clear = asked > LEAST * sd
    tells = "motor" if mine > SHARE[1] * asked else "propeller" if mine < SHARE[0] * asked else ""
    return Speed(mine, sd, tells if clear else "")  # type: ignore[arg-type]


def _expected(command: Array, speed: Array, before: NDArray[np.bool_], dt_s: float) -> Array:
    """Speed by command: a straight line for each rotor before the onset, at the best lag."""
    found: dict[float, Array] = {}
    for lag in LAGS_S:
        k = 1 - np.exp(-dt_s / lag) if lag else 1.0
        c = lfilter([k], [1, k - 1], command - command[0], axis=0) + command[0]
        mean_c, mean_n = c[before].mean(axis=0), speed[before].mean(axis=0)
        off = c[before] - mean_c
        slope = np.sum(off * (speed[before] - mean_n), axis=0) / (np.sum(off**2, axis=0) + 1e-9)
        line = mean_n + slope * (c - mean_c)
        found[float(np.mean((speed - line)[before] ** 2))] = line
    return found[min(found)]
