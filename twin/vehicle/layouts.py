"""Positions and directions of the rotors of usual frames, in the order of their motors.

PX4 and ArduPilot number the motors of these frames in the same order.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from . import Array

CW, CCW = 1.0, -1.0
"""Direction of rotation of a rotor, seen from above: clockwise, counter-clockwise."""
_D = 0.707107
"""sqrt(1/2) in six digits."""
_S3 = 0.866025
"""sqrt(3)/2 in six digits."""
_MIXER = "PX4's MultirotorMixer"  # source of positions
_ARDUPILOT = "ArduPilot's AP_MotorsMatrix"  # source of positions


@dataclass(frozen=True, slots=True)
class Layout:
    """Rotors of an aircraft in the order of its motor commands.

    Attributes:
        position: Hubs, body FRD from the centre of mass, shape (n, 3); in m, or in any unit.
        direction: +1 clockwise seen from above, -1 counter-clockwise, shape (n,).
        metric: Whether positions are in m.
        sd: Standard deviation of a coordinate over the arm, for a known size.
        source: Source of the layout.
        places_known: Whether the positions were stated, not assumed.
        senses_known: Whether the directions of rotation were stated, not assumed.
        place_keys: Parameter for the position of a rotor, `{}` for its number from 0; "": the
            source.
        sense_keys: Parameter for the direction of a rotor, in the same form.
    """

    position: Array
    direction: Array
    metric: bool
    sd: float
    source: str
    places_known: bool = True
    senses_known: bool = True
    place_keys: str = ""
    sense_keys: str = ""

    @property
    def count(self) -> int:
        """Number of rotors."""
        return len(self.direction)

    def place_key(self, rotor: int) -> str:
        """Source of the position of a rotor, numbered from 0."""
        return self.place_keys.format(rotor) or self.source

    def sense_key(self, rotor: int) -> str:
        """Source of the direction of a rotor, numbered from 0."""
        return self.sense_keys.format(rotor) or self.source

    @property
    def arm(self) -> float:
        """Distance of the farthest rotor from the centre, in the unit of the positions."""
        return float(np.linalg.norm(self.position[:, :2], axis=1).max())

    def sized(self, arm_m: float, source: str) -> Self:
        """The layout scaled so that its farthest rotor is at a distance, m."""
        scale = arm_m / self.arm
        return replace(
            self,
            position=self.position * scale,
            metric=True,
            source=f"{self.source}; {source}",
        )


def _ring(*motors: tuple[float, float]) -> tuple[tuple[float, float, float], ...]:
    """Rotors on a circle at equal angles from the nose, degrees to the right."""
    return tuple(
        (round(np.cos(np.radians(a)), 6), round(np.sin(np.radians(a)), 6), way) for a, way in motors
    )


RotorRows = tuple[tuple[float, float, float], ...]
FRAMES: dict[str, tuple[RotorRows, float, str]] = {
    "x": (((_D, _D, CCW), (-_D, -_D, CCW), (_D, -_D, CW), (-_D, _D, CW)), 0.05, _MIXER),
    "+": (((0.0, 1.0, CCW), (0.0, -1.0, CCW), (1.0, 0.0, CW), (-1.0, 0.0, CW)), 0.05, _MIXER),
    "h": (((_D, _D, CW), (-_D, -_D, CW), (_D, -_D, CCW), (-_D, _D, CCW)), 0.05, _ARDUPILOT),
    "wide": (
        (
            (0.1515, 0.245, CCW),
            (-0.1515, -0.1875, CCW),
            (0.1515, -0.245, CW),
            (-0.1515, 0.1875, CW),
        ),
        0.2,
        _MIXER,
    ),
    "hex x": (
        (
            (0.0, 1.0, CW),
            (0.0, -1.0, CCW),
            (_S3, -0.5, CW),
            (-_S3, 0.5, CCW),
            (_S3, 0.5, CCW),
            (-_S3, -0.5, CW),
        ),
        0.05,
        _MIXER,
    ),
    "hex +": (
        _ring((0, CW), (180, CCW), (-120, CW), (60, CCW), (-60, CCW), (120, CW)),
        0.05,
        _ARDUPILOT,
    ),
    "octo x": (
        _ring(
            (22.5, CW),
            (-157.5, CW),
            (67.5, CCW),
            (157.5, CCW),
            (-22.5, CCW),
            (-112.5, CCW),
            (-67.5, CW),
            (112.5, CW),
        ),
        0.05,
        _ARDUPILOT,
    ),
    "octo +": (
        _ring(
            (0, CW),
            (180, CW),
            (45, CCW),
            (135, CCW),
            (-45, CCW),
            (-135, CCW),
            (-90, CW),
            (90, CW),
        ),
        0.05,
        _ARDUPILOT,
    ),
    "betaflight x": (
        ((-_D, _D, CW), (_D, _D, CCW), (-_D, -_D, CCW), (_D, -_D, CW)),
        0.05,
        "Betaflight, propellers not reversed",
    ),
    "crazyflie x": (
        ((_D, _D, CCW), (-_D, _D, CW), (-_D, -_D, CCW), (_D, -_D, CW)),
        0.05,
        "the Crazyflie's firmware",
    ),
}
"""Rotors by forward and right coordinates and direction; standard deviation of a real frame of that
name, over the arm (by judgement; `wide` stands for frames of any proportions); source."""


def frame(name: str, source: str = "") -> Layout:
    """The layout of a frame by its name, with an arm of any length.

    Args:
        name: Name in `FRAMES`.
        source: Source that states this frame.
    """
    rows, sd, order = FRAMES[name]
    table = np.array(rows)
    position = np.column_stack([table[:, :2], np.zeros(len(table))])
    source = f"{source or f'frame {name}'}, motor numbers of {order}"
    return Layout(position, table[:, 2].copy(), False, sd, source)


def frames_of(motors: int) -> list[str]:
    """Names of the frames with a number of motors."""
    return [name for name, (rows, _, _) in FRAMES.items() if len(rows) == motors]
