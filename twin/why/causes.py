"""Causes that move the body: name, prior, candidate sizes, text and bench check of each.

A cause is one entry of `CAUSES`; its likelihood is computed in `evidence`, or it is detected from
the commands (`cut`).
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
"""Losses of thrust of one rotor, equally probable: up to the full stop."""
COARSE_LOSSES = LOSSES[::4]
"""Coarser grid of losses for the search of an onset, and for a growing loss."""
PAIR_LOSSES = np.linspace(0.1, 1.0, 10)
"""Losses of thrust of each of two rotors."""
LOSSES_OF_ALL = np.array([0.06, *np.linspace(0.1, 0.5, 9), *np.linspace(0.6, 1.0, 5)])
"""Losses of thrust of all rotors."""
MASSES = np.array([-0.5, *np.linspace(-0.4, -0.1, 7), -0.06, 0.06, *np.linspace(0.1, 0.4, 7), 0.5])
"""Relative changes of the mass."""
LOADS = np.tile(MASSES, 2)
"""Relative changes of the mass at the centre of mass, without a moment, and then elsewhere, equally
probable."""
FORCES = np.array(
    [[1, 1, 1, 1, 1], [0, 1, 1, 0, 0], [1, 0, 0, 0, 1], [0, 0, 0, 0, 1]],
    dtype=bool,
)
"""Channels on which a force or moment acts, equally probable: specific force along z, rotation
about x, y, z, and across the thrust. On all; as a moving mass; as a rope at the centre of mass;
across the thrust only. Without the third, a rope was explained as a loss of thrust of all rotors
together with a force."""
BLOWS = np.array([[1, 1, 1, 1], [1, 0, 0, 0], [0, 0, 0, 0]], dtype=bool)
"""Channels of a blow in addition to across the thrust, equally probable, as in `FORCES`: on all;
along the thrust; across only, as a gust at the centre of mass."""
GROWS_S = (0.4, 0.8, 1.6, 3.2)
"""Times in which a loss grows to its size, equally probable, s."""


@dataclass(frozen=True, slots=True)
class Cause:
    """A cause that moves the body.

    Attributes:
        text: Text on the event; `{rotor}`, `{value}`, `{t}` and `{grows}` are filled in.
        check: Check on the bench.
        quantity: Quantity of its size; "": it has none.
        log_odds: Log odds at an onset against no event, over all its rotors and sizes.
        tail: Tail of the largest log odds over no event in normal flight: rate of crossing zero,
            1/h, and mean excess over it, nats; None: it is not weighed.
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
"""All causes by name. Tails: 0.8 h simulated with gusts, landings and throttle punches, 0.25 h
recorded (CrazyPAD, the excitations of crazyflie_motor_delay); none is scored for sudden events.
There a mass and a force that may act at the centre of mass pass zero 2.3 and 3 times as often as
those with a moment. A gust within a second of a known one is not counted."""

FINAL = (ROTOR, ALL)
"""Causes that change the body: later changes are no events of their own."""
AIR = (PUSH, BLOW)
"""Causes that also act across the thrust."""


@dataclass(frozen=True, slots=True)
class Name:
    """A cause and its rotors.

    Attributes:
        cause: Key of `CAUSES`, or `NOTHING`.
        rotors: Numbers of the rotors, from 1; empty: none.
        grows: Whether it begins at the onset and grows.
    """

    cause: str
    rotors: tuple[int, ...] = ()
    grows: bool = False


SHARE = {(1, False): 0.895, (2, False): 0.005, (1, True): 0.1}
"""Prior share among losses of rotors, by number of rotors and whether the loss grows."""


@dataclass(frozen=True, slots=True)
class Losses:
    """Losses of the thrust of some rotors.

    Attributes:
        name: Name with the rotors.
        lost: Lost share of thrust of each rotor, by size, shape (sizes, rotors).
    """

    name: Name
    lost: Array

    @property
    def sizes(self) -> Array:
        """Mean lost share over the rotors that lose thrust, shape (sizes,)."""
        return np.asarray(self.lost.sum(axis=1) / len(self.name.rotors))


def losses_of_one(rotors: int, losses: Array, grows: bool = False) -> list[Losses]:
    """Each rotor with each loss."""
    each = np.eye(rotors)
    return [Losses(Name(ROTOR, (i + 1,), grows), losses[:, None] * each[i]) for i in range(rotors)]


def losses_of_two(rotors: int) -> list[Losses]:
    """Each pair of rotors with each pair of losses."""
    sizes, each = np.array(list(product(PAIR_LOSSES, repeat=2))), np.eye(rotors)
    return [
        Losses(Name(ROTOR, (i + 1, k + 1)), sizes @ each[[i, k]])
        for i, k in combinations(range(rotors), 2)
    ]
