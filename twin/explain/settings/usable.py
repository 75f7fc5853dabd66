"""Which flights are fit for a search."""

from dataclasses import dataclass

from ...vehicle import GRAVITY_M_S2
from .group import Group, setting


@dataclass(frozen=True, slots=True)
class UsableSettings(Group):
    """Of `twin.explain.usable`."""

    shortest_s: float = setting(3.0, "s", "time in the air at least", "made up")
    longest_s: float = setting(
        240.0,
        "s",
        "of a longer flight the part of this length is read in which it moves most",
        "made up: is searched in a minute",
    )
    block_s: float = setting(10.0, "s", "such a part begins at a multiple of this", "made up")
    impact_m_s2: float = setting(
        5 * GRAVITY_M_S2,
        "m/s²",
        "specific force, low-passed, that no flight reaches but a blow does",
        "made up",
    )
    impact_hz: float = setting(20.0, "Hz", "low-pass of that force", "made up")
    around_s: float = setting(
        1.0,
        "s",
        "left out before and after a blow, and beside the upright ends of a fall",
        "made up",
    )
    upside_down_s: float = setting(0.2, "s", "upside down for longer is a crash", "made up")
    tipped_cos: float = setting(
        0.5,
        "1",
        "cosine of the tilt in the last second under which it lies on its side",
        "made up",
        1.0,
    )
    latest_s: float = setting(
        0.5,
        "s",
        "attitude and gyroscope may be apart by so much: a delay is an effect like others",
        "made up",
    )
    slow_hz: float = setting(
        1.0, "Hz", "velocity and position are compared below this frequency", "made up"
    )
    slowest_m_s: float = setting(
        0.2, "m/s", "rms of the velocity from which on they are compared", "made up"
    )
    same_motion: float = setting(
        0.5,
        "1",
        "correlation from which on two signals are the same motion in the same axes",
        "made up",
        1.0,
    )
