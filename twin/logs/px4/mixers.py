"""Multirotor geometries of PX4's mixers and the airframes that use them."""

import numpy as np

from ...vehicle.layouts import FRAMES
from ..flight import Array

_MOMENT = 0.05
_GEOMETRIES = {"quad_x": "x", "quad_wide": "wide", "quad_plus": "+", "hex_x": "hex x"}
"""Mixers whose commands are rebuilt, and the frame of each."""
_AIRFRAMES = {4001: "quad_x", 4010: "quad_x", 4011: "quad_x", 10016: "quad_wide"}


def airframe_mixer(autostart: float) -> str | None:
    """Name of the mixer of a SYS_AUTOSTART airframe, None where it is not known here."""
    return _AIRFRAMES.get(int(autostart))


def frame_of_mixer(name: str) -> str:
    """Frame of a known mixer, of `twin.vehicle.layouts.FRAMES`."""
    return _GEOMETRIES[name]


def mixer_names(motors: int) -> list[str]:
    """Known mixers for a number of motors."""
    return [name for name, of in _GEOMETRIES.items() if len(FRAMES[of][0]) == motors]


def mixer_scale(name: str) -> Array:
    """Share of roll, pitch, yaw and thrust in each motor of a known mixer, shape (motors, 4)."""
    forward, right, clockwise = np.array(FRAMES[_GEOMETRIES[name]][0]).T
    return geometry_scale(np.column_stack([forward, right, -clockwise]))


def geometry_scale(rotors: Array) -> Array:
    """Share of roll, pitch, yaw and thrust in each motor, shape (motors, 4).

    Pseudo-inverse of the map from rotor thrusts to moments and thrust, then normalised.

    Args:
        rotors: Position forward and right, direction (+1 counter-clockwise), shape (motors, 3).

    Source: PX4 v1.12, lib/mixer/MultirotorMixer/geometries/tools/px_generate_mixers.py.
    """
    x, y, turn = rotors.T
    effect = np.vstack([-y, x, _MOMENT * turn, np.ones(len(rotors))])
    scale = np.linalg.pinv(effect)
    size = np.linalg.norm(scale, axis=0)
    roll_pitch = max(size[0], size[1]) / np.sqrt(len(rotors) / 2.0)
    size = np.array([roll_pitch, roll_pitch, np.abs(scale[:, 2]).max(), scale[:, 3].mean()])
    return np.asarray(scale / size)
