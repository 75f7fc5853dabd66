"""How an effect is seen in a flight: what a search looks at to find it.

| kind | what it leaves in a record |
|---|---|
| Equation | readings that its component, with it, predicts |
| Shift | signals that are apart in time |
| Average | a pose that is smoother than the motion |
| NoiseFloor | the flat part of a spectrum |
| Lines | lines of a spectrum, which follow the rotors or stand still |
| RandomForce | a slow random force that no curve explains |
| Repeats | readings that stand still |

The first three change a mean, and are fitted together; each of the others is found by its own rule.
Numbers are given by their names within the effect, signals as in `Effect.needs`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..vehicle import Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Observer:
    """Follows the states of an effect along a flight by the force that they exert.

    States that a flight does not measure are integrated along its motion. Where they forget
    nothing, such as those of a pendulum, an error of their start or their numbers never dies out:
    an observer pulls them towards what the flight shows, with what is past alone.

    Attributes:
        follow: `(free_n, excess_n, numbers, step_s) -> course`: the specific force, m/s^2, that is
            predicted without the effect, and what the accelerometer reads beyond that, zero where
            unknown, both NED, shape (n, 3), to whatever `place` needs. It uses the shapes alone of
            the numbers: those without a neutral value.
        place: `(states, names, course, free_n, numbers, vehicle) -> states`: the states of the
            airframe, shape (n, n_x), those of the effect filled in.
        channels: Readings by which it follows.
        gain_1_s: How fast what it follows answers to one of them.
    """

    follow: Callable[[Array, Array, Mapping[str, float], float], Any]
    place: Callable[[Array, Sequence[str], Any, Array, Mapping[str, float], Vehicle], Array]
    channels: tuple[str, ...]
    gain_1_s: float


@dataclass(frozen=True, slots=True)
class Equation:
    """In what its component predicts, by the derivatives of its equations.

    Every state that its term declares is integrated along the measured motion, again for other
    numbers.

    Attributes:
        observer: Follows its states instead.
        turns_pose: Number that turns the logged attitude about the vertical.
        mistaken_for: Effects that together do much of what one part of it does, so that no step
            from none of it on leads to it; where one of them is, each part is tried in the place
            of the first.
    """

    observer: Observer | None = None
    turns_pose: str | None = None
    mistaken_for: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Shift:
    """In time.

    Attributes:
        moves: Signals that each number, s, shifts.
        acts: Whether these signals act later than the record says; else what they show is older.
    """

    moves: Mapping[str, tuple[str, ...]]
    acts: bool = False


@dataclass(frozen=True, slots=True)
class Average:
    """In a pose that is an average over time, as far before each instant as after it.

    Attributes:
        spreads: Signals for which each number, s^2, is the variance of the weights.
    """

    spreads: Mapping[str, tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class NoiseFloor:
    """In the noise of readings against that of the vehicle file.

    Attributes:
        scale: Number that multiplies the noise of all of them.
        further: Number that adds noise to each signal.
    """

    scale: str
    further: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Lines:
    """In lines above the motion of the body.

    Attributes:
        frequency: Number: frequency with the rotors at hover, Hz.
        amplitudes: Number of the amplitude in each signal.
    """

    frequency: str
    amplitudes: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class RandomForce:
    """In a slow random force.

    Attributes:
        intensity: Numbers: standard deviation of the speed of the air along the mean wind, across
            it and down, m/s.
        length: Numbers: length scales of the same.
    """

    intensity: tuple[str, str, str]
    length: tuple[str, str, str]


@dataclass(frozen=True, slots=True)
class Repeats:
    """In a reading that stands still.

    Attributes:
        channel: Number: which of `channels`, from 1.
        since: Number: from when on, s.
        channels: Columns of the flight table that its component can hold still.
    """

    channel: str
    since: str
    channels: tuple[str, ...] = field(default=())


Observability = Equation | Shift | Average | NoiseFloor | Lines | RandomForce | Repeats
