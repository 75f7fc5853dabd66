"""The residual channels, their groups, the features, and the phases that condition them."""

from collections.abc import Iterable
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from twin.errors import ModelError
from twin.flight.mission import PHASES
from twin.frames import AXES
from twin.physics.sensors.table import SENSORS

_LEARNED = {s.signal: s.unit for s in SENSORS if s.learned} | {"pos": "m", "vel": "m/s"}
"""Unit of each signal."""
_ORDER = ("gyro", "acc", "mag", "pos", "vel")
"""Of the channels, in which models are stored."""
if {*_ORDER} != {*_LEARNED}:
    raise ModelError(
        f"a compensator learns {', '.join(sorted(_LEARNED))}, its channels are "
        f"{', '.join(_ORDER)}: give each sensor that is learned a place in "
        f"learning/data/channels.py."
    )
_SENSORS = tuple((signal, _LEARNED[signal]) for signal in _ORDER)  # signal and unit
CHANNELS = tuple(f"{sensor}_{axis}" for sensor, _ in _SENSORS for axis in AXES)
"""Gyroscope, accelerometer, magnetometer, position, velocity: flight-table columns, in order."""
UNITS = tuple(unit for _, unit in _SENSORS for _ in AXES)
"""Of each channel."""
GROUPS = MappingProxyType(
    {sensor: slice(3 * i, 3 * i + 3) for i, (sensor, _) in enumerate(_SENSORS)}
)
"""Columns of each sensor."""


FEATURE_CHANNELS = tuple(i for i, c in enumerate(CHANNELS) if c not in ("pos_x", "pos_y"))
"""Channels whose virtual readings are features: all but the place over ground, on which no effect
depends."""
_PLACES = (("gyro_x",), ("gyro_y",), ("gyro_z",), ("vel_x", "vel_y"), ("vel_z",))
"""Channels by name."""
PLACES = tuple(tuple(FEATURE_CHANNELS.index(CHANNELS.index(c)) for c in some) for some in _PLACES)
"""Physical inputs of the envelope, alongside what drives the rotors: places among
`FEATURE_CHANNELS`, each one alone or the length of two. These are rates, speed over ground and
climb; neither heading nor height."""


def check_channels(names: Iterable[str]) -> None:
    """Raise ValueError unless these are `CHANNELS`."""
    if (given := tuple(names)) != CHANNELS:
        raise ValueError(f"channels {', '.join(given)}: this version has {', '.join(CHANNELS)}")


UNKNOWN_PHASE = len(PHASES)
"""Code of a phase that no name stands for."""
PHASE_CODES = MappingProxyType({**PHASES, "unknown": UNKNOWN_PHASE})
"""Phases of a mission by their codes, and where a flight says nothing."""
N_PHASES = len(PHASE_CODES)  # phases of flight


def phase_codes(phases: Iterable[object]) -> NDArray[np.intp]:
    """Codes of phases by their names, shape (n,); of a name that is none `UNKNOWN_PHASE`."""
    return np.array([PHASE_CODES.get(str(p), UNKNOWN_PHASE) for p in phases], dtype=np.intp)
