"""Rules of one line about failed rotors: what a method has to beat, and stands next to it.

Neither is a detector: the first fires in most normal flights that turn or brake, the second always.
They need nothing but the commands, know no probability, and are right surprisingly often when it is
known that a rotor has failed.
"""

from dataclasses import dataclass

import numpy as np

from .flight import Array, FlightFrame

PARTED = 0.15
"""Of the range of a command: 150 us of pulse width."""
SETTLED_S = 6.0
"""Of flight, before which outputs may part."""
FLIES = 0.15
"""Command from which on all motors lift: 1150 us."""


@dataclass(frozen=True, slots=True)
class RuleReading:
    """What a rule reads.

    Attributes:
        rotor: Number from 1.
        t_s: When, s; None: it knows no time.
    """

    rotor: int
    t_s: float | None


def parted(t_s: Array, command: Array) -> RuleReading | None:
    """When the outputs part by 150 us after six seconds of flight, the highest is the failed rotor.

    Args:
        t_s: Times, shape (n,).
        command: Of each motor over its range, shape (n, rotors).

    Returns:
        None where they do not part.
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
    """`parted` of the commands as logged; None without them."""
    if flight.drive != "command":
        return None
    command = flight.signals["command"]
    return parted(command.t_s, command.values)


def highest_mean(flight: FlightFrame) -> RuleReading | None:
    """The rotor with the highest mean command in the air is the weak one; without a time.

    Returns:
        None without commands, or where nothing flies.
    """
    if flight.drive is None or not flight.airborne:
        return None
    rows = np.concatenate([np.arange(p.start, p.flown) for p in flight.airborne])
    return RuleReading(int(np.argmax(flight.grid[flight.drive][rows].mean(axis=0))) + 1, None)
