"""The residual channels, their groups, and the phases that condition them."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from twin.flight.mission import PHASES
from twin.frames import AXES
from twin.physics.residual_force import INPUTS, OUTPUTS, SEEN
from twin.representation import short_repr

_SENSORS = (
    ("gyro", "rad/s"),
    ("acc", "m/s²"),
    ("mag", "T"),
    ("pos", "m"),
    ("vel", "m/s"),
)
CHANNELS = tuple(f"{sensor}_{axis}" for sensor, _ in _SENSORS for axis in AXES)
"""Gyroscope, accelerometer, magnetometer, position, velocity: flight-table columns, in order."""
UNITS = tuple(unit for _, unit in _SENSORS for _ in AXES)
GROUPS = MappingProxyType(
    {sensor: slice(3 * i, 3 * i + 3) for i, (sensor, _) in enumerate(_SENSORS)}
)
"""Columns of each sensor."""


@dataclass(frozen=True, slots=True)
class Channels:
    """What a compensator corrects, and what it looks at.

    Attributes:
        names: Of the channels.
        units: Of the channels.
        groups: Columns of each sensor, or of whatever belongs together.
        seen: Columns of what the twin gives that are features.
        commands: Names of the other features; (): what drives the rotors.
        place: Physical inputs of the envelope besides those: places among `seen`, each one alone or
            the length of two; (): there is no envelope.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    groups: Mapping[str, slice]
    seen: tuple[int, ...]
    commands: tuple[str, ...] = ()
    place: tuple[tuple[int, ...], ...] = ()

    __repr__ = short_repr

    def __len__(self) -> int:
        return len(self.names)


_SEEN = tuple(c for c in CHANNELS if c not in ("pos_x", "pos_y"))
_PLACE = (("gyro_x",), ("gyro_y",), ("gyro_z",), ("vel_x", "vel_y"), ("vel_z",))
SENSORS = Channels(
    CHANNELS,
    UNITS,
    dict(GROUPS),
    seen=tuple(CHANNELS.index(c) for c in _SEEN),
    place=tuple(tuple(_SEEN.index(c) for c in some) for some in _PLACE),
)
"""Of the sensors. All that the twin reads is looked at but the place over ground, on which no
effect depends. Heading and height take no part in the envelope: rates, speed over ground and
climb do, and what drives the rotors."""
FORCES = Channels(
    tuple(f"left_{kind}_{a}" for kind, a in OUTPUTS),
    tuple("m/s²" if kind == "force" else "rad/s²" for kind, _ in OUTPUTS),
    {"left_force": slice(0, 3), "left_moment": slice(3, 6)},
    seen=(),
    commands=tuple(SEEN + name for name, _ in INPUTS),
)
"""Specific force and angular acceleration that the equations lack, by the motion it comes with."""


def channels_named(names: Iterable[str]) -> Channels:
    """The channels of these names.

    Raises:
        ValueError: There are none.
    """
    wanted = tuple(names)
    for known in (SENSORS, FORCES):
        if known.names == wanted:
            return known
    raise ValueError(f"channels {', '.join(wanted)}: this version knows none of these")


UNKNOWN_PHASE = len(PHASES)
PHASE_CODES = MappingProxyType({**PHASES, "unknown": UNKNOWN_PHASE})
"""Phases of a mission by their codes, and where a flight says nothing."""
N_PHASES = len(PHASE_CODES)


def phase_codes(phases: Iterable[object]) -> NDArray[np.intp]:
    """Codes of phases by their names, shape (n,); of a name that is none `UNKNOWN_PHASE`."""
    return np.array([PHASE_CODES.get(str(p), UNKNOWN_PHASE) for p in phases], dtype=np.intp)
