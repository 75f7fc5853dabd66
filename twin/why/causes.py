"""Causes that move the body: what each is called, how probable it is before the flight is seen,
which sizes are tried, what is said and what is to be checked.

A cause is one entry of `CAUSES`; its likelihood stands in `evidence`, or it is told by the
commands (`cut`).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NOTHING = "nothing"
ROTOR, ALL, MASS, PUSH, BLOW, CUT = (
    "rotor_failure",
    "thrust_loss_all_rotors",
    "mass_change",
    "force_or_moment",
    "gust",
    "command_cut",
)

LOSSES = np.linspace(0.1, 1.0, 37)
"""Of the thrust of one rotor, alike probable: up to the full stop."""
COARSE_LOSSES = LOSSES[::4]
"""The same while an onset is looked for, and of a loss that grows."""
PAIR_LOSSES = np.linspace(0.1, 1.0, 10)
"""Of the thrust of each of two rotors."""
LOSSES_OF_ALL = np.array([0.06, *np.linspace(0.1, 0.5, 9), *np.linspace(0.6, 1.0, 5)])
"""Of the thrust of all rotors."""
MASSES = np.array([-0.5, *np.linspace(-0.4, -0.1, 7), -0.06, 0.06, *np.linspace(0.1, 0.4, 7), 0.5])
"""Change of the mass over the mass."""
LOADS = np.tile(MASSES, 2)
"""The same at the centre of mass, without a moment, and then elsewhere, alike probable."""
FORCES = np.array(
    [[1, 1, 1, 1, 1], [0, 1, 1, 0, 0], [1, 0, 0, 0, 1], [0, 0, 0, 0, 1]],
    dtype=bool,
)
"""Where a force or moment acts, alike probable: on the specific force along z, the turning about x,
y, z, and across the thrust. On all; as a mass that moves; as a rope at the centre of mass; across
the thrust alone. Without the third a rope was all rotors that lose thrust, with a force beside."""
BLOWS = np.array([[1, 1, 1, 1], [1, 0, 0, 0], [0, 0, 0, 0]], dtype=bool)
"""Where a blow acts besides across the thrust, alike probable, as of `FORCES`: on all; along the
thrust; across alone, as a gust at the centre of mass."""
GROWS_S = (0.4, 0.8, 1.6, 3.2)
"""In which a loss grows to its size, alike probable, s."""


@dataclass(frozen=True, slots=True)
class Cause:
    """A cause that moves the body.

    Attributes:
        text: What happened; `{rotor}`, `{value}`, `{t}` and `{grows}` are filled in.
        check: What to check on the bench.
        quantity: What its size is; "": it has none.
        log_odds: At an onset against nothing, all its rotors and sizes together.
        tail: Of the largest log odds over nothing in a normal flight: how often they pass zero,
            1/h, and their mean excess over it, nats; None: it is not weighed.
    """

    text: str
    check: str
    quantity: str = ""
    log_odds: float = 0.0
    tail: tuple[float, float] | None = None


CAUSES: Mapping[str, Cause] = {
    ROTOR: Cause(
        "Rotor {rotor} loses {value} of its thrust at {t} s",
        "Rotor {rotor}: propeller (cracked, loose, on the right way round), motor (bearing, "
        "windings, screws), speed controller and its cables.",
        "thrust_lost",
        -1.5,
        (4.0, 6.5),
    ),
    ALL: Cause(
        "All rotors lose {value} of their thrust at {t} s",
        "Battery (voltage under load, connector), power cables, all propellers.",
        "thrust_lost",
        -3.0,
        (4.0, 6.5),
    ),
    MASS: Cause(
        "The mass changes by {value} at {t} s",
        "What was lost or picked up: payload, battery strap, landing gear.",
        "mass_change",
        -3.0,
        (9.0, 6.5),
    ),
    PUSH: Cause(
        "A constant force or moment acts from {t} s on",
        "A rope or cable, a shifted battery, a bent arm; wind that set in.",
        log_odds=-5.0,
        tail=(12.0, 6.5),
    ),
    BLOW: Cause(
        "A short blow hits the aircraft at {t} s",
        "Marks of a collision; else a gust.",
        log_odds=-2.0,
        tail=(26.0, 6.5),
    ),
    CUT: Cause(
        "All commands drop to idle in the air at {t} s, for {value}, and the aircraft falls",
        "Failsafes and kill switch, link of the remote control, the battery's alarm, a land "
        "detector that fires in the air; else the pilot closed the throttle.",
        "duration",
    ),
}
"""All of them, by name. Tails: 0.8 h simulated with gusts, landings and throttle punches, 0.25 h
recorded (CrazyPAD, the excitations of crazyflie_motor_delay); none is scored for sudden events.
There a mass and a force that may act at the centre of mass pass zero 2.3 and 3 times as often as
those that bring a moment. A gust within a second of one that is there is none of its tail."""

FINAL = (ROTOR, ALL)
"""Causes after which the body is another one: what follows is no event of its own."""
AIR = (PUSH, BLOW)
"""Causes that act across the thrust as well."""


@dataclass(frozen=True, slots=True)
class Name:
    """A cause and its rotors.

    Attributes:
        cause: Key of `CAUSES`, or `NOTHING`.
        rotors: From 1; empty: of none.
        grows: Whether it begins at the onset and grows.
    """

    cause: str
    rotors: tuple[int, ...] = ()
    grows: bool = False


SHARE = {(1, False): 0.895, (2, False): 0.005, (1, True): 0.1}
"""Of losses of rotors, by how many rotors lose and whether the loss grows."""


@dataclass(frozen=True, slots=True)
class Losses:
    """Losses of the thrust of some rotors.

    Attributes:
        name: Whose.
        lost: Share of the thrust of each rotor, by size, shape (sizes, rotors).
    """

    name: Name
    lost: Array

    @property
    def sizes(self) -> Array:
        """Mean share that those that lose have lost, shape (sizes,)."""
        return np.asarray(self.lost.sum(axis=1) / len(self.name.rotors))


def losses_of_one(rotors: int, losses: Array, grows: bool = False) -> list[Losses]:
    """Each rotor by each loss."""
    each = np.eye(rotors)
    return [Losses(Name(ROTOR, (i + 1,), grows), losses[:, None] * each[i]) for i in range(rotors)]


def losses_of_two(rotors: int) -> list[Losses]:
    """Each two rotors by each two losses."""
    sizes, each = np.array(list(product(PAIR_LOSSES, repeat=2))), np.eye(rotors)
    return [
        Losses(Name(ROTOR, (i + 1, k + 1)), sizes @ each[[i, k]])
        for i, k in combinations(range(rotors), 2)
    ]
