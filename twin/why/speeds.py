"""Speed against thrust: where rotor speeds are logged beside commands, whether the speed of a rotor
that loses thrust falls with it.

    n_i = a_i + b_i c_i * lag + v

learned from the seconds before an onset, by rotor. A motor, its speed controller or its supply
lose speed; a propeller that breaks or slips loses thrust at a speed that stays, or rises, since it
takes less torque. Thrust goes with the square of the speed: a loss d by the motor takes
1 - sqrt(1 - d) of the speed.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from .flight import Array, FlightFrame

BEFORE_S, SETTLES_S, AFTER_S = 20.0, 0.3, 3.0
"""Before an onset, by which the speed by command is learned; after it, from when and until when it
is compared."""
LAGS_S = (0.0, 0.02, 0.04, 0.08, 0.15)
"""Of the speed behind the command, among which is chosen."""
SHARE = (0.3, 0.7)
"""Of the fall that the loss of thrust would ask for: below the first the speed stays, above the
second it falls with the thrust; between them it is not said."""
LEAST = 3.0
"""Deviations by which the two have to differ for anything to be told."""


@dataclass(frozen=True, slots=True)
class Speed:
    """What the speed of a rotor does at an onset.

    Attributes:
        lost: Share of the speed that its command asks for.
        sd: Deviation of that, by the other rotors and by the seconds before.
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
"""What the speed says, for the bench."""


def speed_of(flight: FlightFrame, rotor: int, onset_s: float, thrust_lost: float) -> Speed | None:
    """What the speed of a rotor does when it loses thrust.

    Args:
        flight: With commands and speeds.
        rotor: From 1.
        onset_s: When it loses thrust, s.
        thrust_lost: Share that it loses.

    Returns:
        None where commands or speeds are not logged, or too little is known.
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
    """Speed by command: a straight line of each rotor before the onset, at the best lag."""
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
