"""The residual channels, their sensor groups, the features, and the phases."""

from collections.abc import Iterable
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from twin.errors import ModelError
from twin.flight.mission import PHASES
from twin.frames import AXES
from twin.physics.sensors.table import SENSORS

_LEARNED = {s.signal: s.unit for s in SENSORS if s.learned} | {"pos": "m", "vel": "m/s"}
"""Unit of each learned signal."""
_ORDER = ("gyro", "acc", "mag", "pos", "vel")
"""Order of the sensors' channels in stored models."""
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
"""Unit of each channel."""
GROUPS = MappingProxyType(
    {sensor: slice(3 * i, 3 * i + 3) for i, (sensor, _) in enumerate(_SENSORS)}
)
"""Channel indices of each sensor."""


FEATURE_CHANNELS = tuple(i for i, c in enumerate(CHANNELS) if c not in ("pos_x", "pos_y"))
"""Channels whose virtual readings are features: all except the horizontal position, on which no
effect depends."""
_PLACES = (("gyro_x",), ("gyro_y",), ("gyro_z",), ("vel_x", "vel_y"), ("vel_z",))
"""Channels of the envelope's inputs, by name."""
PLACES = tuple(tuple(FEATURE_CHANNELS.index(CHANNELS.index(c)) for c in some) for some in _PLACES)
"""Physical inputs of the envelope besides the drive of the rotors: indices in `FEATURE_CHANNELS`,
each one alone or the norm of two. These are rates, ground speed and climb rate; neither heading nor
height."""


def check_channels(names: Iterable[str]) -> None:
    """Raise ValueError unless the names are `CHANNELS`."""
    if (given := tuple(names)) != CHANNELS:
        raise ValueError(f"channels {', '.join(given)}: this version has {', '.join(CHANNELS)}")


UNKNOWN_PHASE = len(PHASES)
"""Code of an unknown phase."""
PHASE_CODES = MappingProxyType({**PHASES, "unknown": UNKNOWN_PHASE})
"""Codes of the phases of a mission, and of an unknown one."""
N_PHASES = len(PHASE_CODES)  # number of phases


def phase_codes(phases: Iterable[object]) -> NDArray[np.intp]:
    """Codes of phases by name, shape (n,); `UNKNOWN_PHASE` for an unknown name."""
    return np.array([PHASE_CODES.get(str(p), UNKNOWN_PHASE) for p in phases], dtype=np.intp)
