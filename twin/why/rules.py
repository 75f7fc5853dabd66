"""Simple rules for failed rotors, as a baseline for the diagnosis.

Neither is a detector: the first fires in most normal flights that turn or brake, the second always.
They need only the commands, have no probability, and are often right when it is known that a rotor
has failed.
"""

from dataclasses import dataclass

import numpy as np

from .flight import Array, FlightFrame

PARTED = 0.15
"""Difference over the range of a command: 150 us of pulse width."""
SETTLED_S = 6.0
"""Flight time before which differences are ignored, s."""
FLIES = 0.15
"""Command from which all motors lift: 1150 us."""


@dataclass(frozen=True, slots=True)
class RuleReading:
    """Result of a rule.

    Attributes:
        rotor: Number of the rotor, from 1.
        t_s: Time, s; None: the rule has no time.
    """

    rotor: int
    t_s: float | None


def parted(t_s: Array, command: Array) -> RuleReading | None:
    """Rotor with the highest output when the outputs differ by 150 us after six seconds of flight.

    Args:
        t_s: Times, shape (n,).
        command: Command of each motor over its range, shape (n, rotors).

    Returns:
        None where they do not differ.
    """
    flying = np.flatnonzero(command.min(axis=1) > FLIES)
    if not len(flying):
        return None
    apart = (t_s > t_s[flying[0]] + SETTLED_S) & (np.ptp(command, axis=1) > PARTED)
    if not apart.any():
        return None
    k = int(np.argmax(apart))
    return RuleReading(int(np.argmax(command[k])) + 1, float(t_s[k]))


def parted_outputs(flight: FlightFrame) -> RuleReading | None:
    """Result of `parted` for the logged commands; None without them."""
    if flight.drive != "command":
        return None
    command = flight.signals["command"]
    return parted(command.t_s, command.values)


def highest_mean(flight: FlightFrame) -> RuleReading | None:
    """Rotor with the highest mean command in the air; without a time.

    Returns:
        None without commands, or without flight.
    """
    if flight.drive is None or not flight.airborne:
        return None
    rows = np.concatenate([np.arange(p.start, p.flown) for p in flight.airborne])
    return RuleReading(int(np.argmax(flight.grid[flight.drive][rows].mean(axis=0))) + 1, None)
