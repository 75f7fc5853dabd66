"""Where ArduPilot's motors sit and how they turn, by FRAME_CLASS and FRAME_TYPE.

The order of the motors is that of the frame: motor i is `cmd_i` and `rotor_i` of the flight table.
Source: ArduPilot, libraries/AP_Motors/AP_MotorsMatrix.cpp and the documentation of connecting
motors, https://ardupilot.org/copter/docs/connect-escs-and-motors.html.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..flight import Array

Sense = Literal["ccw", "cw"]


@dataclass(frozen=True, slots=True)
class Geometry:
    """Rotors of a frame, motor 1 first.

    Attributes:
        frame: FRAME_CLASS and FRAME_TYPE by name, such as `quad x`.
        direction: Forward and right of the centre, the farthest rotor at 1, shape (n, 2).
        sense: Of each rotor, seen from above.
        below: Whether a rotor sits below another one, coaxially.
    """

    frame: str
    direction: Array
    sense: tuple[Sense, ...]
    below: tuple[bool, ...]

    @property
    def count(self) -> int:
        """Number of rotors."""
        return len(self.sense)

    @property
    def turn(self) -> Array:
        """+1 for a rotor that turns counter-clockwise, -1 for the others, shape (n,)."""
        return np.array([1.0 if s == "ccw" else -1.0 for s in self.sense])


CLASSES = {
    1: "quad",
    2: "hexa",
    3: "octa",
    4: "octaquad",
    5: "y6",
    7: "tri",
    12: "dodecahexa",
    14: "deca",
}
NO_MULTIROTOR = {6: "helicopter", 8: "singlecopter", 9: "coaxcopter", 11: "dual helicopter"} | {
    13: "quad helicopter"
}
"""FRAME_CLASS whose motors, as SERVOn_FUNCTION calls them, are swash plates and flaps."""
TYPES = {
    0: "plus",
    1: "x",
    2: "v",
    3: "h",
    4: "vtail",
    5: "atail",
    6: "plusrev",
    10: "y6b",
    11: "y6f",
    12: "bf_x",
    13: "dji_x",
    14: "cw_x",
    15: "i",
    16: "nyt_plus",
    17: "nyt_x",
    18: "bf_x_rev",
}

# clockwise from the front, degrees, and the sense: + counter-clockwise, - clockwise
_CIRCLES: dict[tuple[str, str], str] = {
    ("quad", "plus"): "90+ -90+ 0- 180-",
    ("quad", "x"): "45+ -135+ -45- 135-",
    ("quad", "v"): "45+ -135+ -45- 135-",
    ("quad", "h"): "45- -135- -45+ 135+",
    ("quad", "plusrev"): "90- -90- 0+ 180+",
    ("quad", "bf_x"): "135- 45+ -135+ -45-",
    ("quad", "bf_x_rev"): "135+ 45- -135- -45+",
    ("quad", "dji_x"): "45+ -45- -135+ 135-",
    ("quad", "cw_x"): "45+ 135- -135+ -45-",
    ("hexa", "plus"): "0- 180+ -120- 60+ -60+ 120-",
    ("hexa", "x"): "90- -90+ -30- 150+ 30+ -150-",
    ("hexa", "dji_x"): "30+ -30- -90+ -150- 150+ 90-",
    ("hexa", "cw_x"): "30+ 90- 150+ -150- -90+ -30-",
    ("octa", "plus"): "0- 180- 45+ 135+ -45+ -135+ -90- 90-",
    ("octa", "x"): "22.5- -157.5- 67.5+ 157.5+ -22.5+ -112.5+ -67.5- 112.5-",
    ("octa", "dji_x"): "22.5+ -22.5- -67.5+ -112.5- -157.5+ 157.5- 112.5+ 67.5-",
    ("octa", "cw_x"): "22.5+ 67.5- 112.5+ 157.5- -157.5+ -112.5- -67.5+ -22.5-",
    ("octaquad", "plus"): "0+ -90- 180+ 90- -90+ 0- 90+ 180-",
    ("octaquad", "x"): "45+ -45- -135+ 135- -45+ 45- 135+ -135-",
    ("octaquad", "v"): "45+ -45- -135+ 135- -45+ 45- 135+ -135-",
    ("octaquad", "h"): "45- -45+ -135- 135+ -45- 45+ 135- -135+",
    ("dodecahexa", "plus"): "0+ 0- 60- 60+ 120+ 120- 180- 180+ -120+ -120- -60- -60+",
    ("dodecahexa", "x"): "30+ 30- 90- 90+ 150+ 150- -150- -150+ -90+ -90- -30- -30+",
}
# forward and right instead, in the units of the mixer, and the sense
_PLACES: dict[tuple[str, str], str] = {
    ("hexa", "h"): "0,1- 0,-1+ 1,-1- -1,1+ 1,1+ -1,-1-",
    ("octa", "v"): ".34,-.83- -.32,.67- -.32,-.67+ -1,.5+ 1,-1+ .34,.83+ 1,1- -1,-.5-",
    ("octa", "h"): "1,1- -1,-1- .333,1+ -1,1+ 1,-1+ -.333,-1+ .333,-1- -.333,1-",
    ("octa", "i"): "-1,-.333- 1,.333- -1,-1+ 1,-.333+ -1,.333+ 1,1+ -1,1- 1,-1-",
    ("y6", "y6b"): ".5,1- .5,1+ -1,0- -1,0+ .5,-1- .5,-1+",
    ("y6", "y6f"): "-1,0+ .5,1+ .5,-1+ -1,0- .5,1- .5,-1-",
    ("y6", ""): ".666,1+ .666,-1- .666,-1+ -1.333,0- .666,1- -1.333,0+",
}


def geometry(frame_class: int, frame_type: int) -> Geometry | None:
    """Rotors of a frame; None where it is not known here, or has no fixed places or senses."""
    kind, form = CLASSES.get(frame_class, ""), TYPES.get(frame_type, "")
    if kind == "y6" and (kind, form) not in _PLACES:
        form = ""
    if told := _CIRCLES.get((kind, form)):
        angles = np.radians([float(t[:-1]) for t in told.split()])
        places = np.column_stack([np.cos(angles), np.sin(angles)])
    elif told := _PLACES.get((kind, form)):
        places = np.array([[float(v) for v in t[:-1].split(",")] for t in told.split()])
        places = places / np.linalg.norm(places, axis=1).max()
    else:
        return None
    sense: tuple[Sense, ...] = tuple("ccw" if t.endswith("+") else "cw" for t in told.split())
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    below = tuple(bool((apart[k, :k] < 1e-6).any()) for k in range(len(places)))
    return Geometry(f"{kind} {form}".strip(), np.round(places, 6), sense, below)


def frame_name(frame_class: int, frame_type: int) -> str:
    """FRAME_CLASS and FRAME_TYPE by name as far as they are known, else by number."""
    kind = CLASSES.get(frame_class, f"FRAME_CLASS {frame_class}")
    return f"{kind} {TYPES.get(frame_type, f'FRAME_TYPE {frame_type}')}"
