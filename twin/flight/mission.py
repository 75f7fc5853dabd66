"""Missions: smooth setpoints for a controller as a function of the mission's clock.

A mission starts and ends on the ground. It is a list of legs, each a displacement that begins at
zero; the setpoint is the sum of the completed legs and the displacement of the present one, its
velocity and acceleration are the derivatives. Straight legs are minimum-jerk polynomials; circle,
eight and cruise ramp their speed up and down by the same polynomial. Legs of one shape are one
equation, with the numbers of the present one.

| mission | after the takeoff | duration |
|---|---|---|
| `takeoff` | hovers for 3 s, then stays | 8 s |
| `hover` | hovers for 20 s, then stays | 25 s |
| `land` | hovers for 2 s, lands | 14 s |
| `forward` | out at cruise speed, turns round, back, lands | 46 s |
| `tour` | waypoints with changes of heading, circle, figure eight, lands | 51 s |

Source of the minimum-jerk displacement from rest to rest: Flash & Hogan, J. Neuroscience 5 (1985):
10 s^3 - 15 s^4 + 6 s^5.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import accumulate, combinations
from typing import Any, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..component import Component, ComponentBuilder, Enumeration
from ..component.portable import cosine, sine
from ..errors import ModelError
from ..frames import AXES, NED
from ..vehicle import Vehicle

Number = TypeVar("Number", ca.SX, NDArray[np.float64])
"""Arrays of any shape, or a symbol."""
FASTEST = 15 / 8
"""Largest speed of a minimum-jerk displacement of 1 in time 1."""
HARDEST = 10 / np.sqrt(3)
"""Largest acceleration of a minimum-jerk displacement of 1 in time 1."""


def minimum_jerk(s: Number) -> Number:
    """Share of the distance, 0..1, after a share of the time; at rest at both ends."""
    return s**3 * (10 + s * (-15 + 6 * s))


def minimum_jerk_speed(s: Number) -> Number:
    """Derivative of `minimum_jerk` by the share of the time."""
    return 30 * s**2 - 60 * s**3 + 30 * s**4


def minimum_jerk_acceleration(s: Number) -> Number:
    """Second derivative of `minimum_jerk` by the share of the time."""
    return 60 * s - 180 * s**2 + 120 * s**3


def ramped_way(t: Number, total: float | ca.SX, rate: float | ca.SX, ramp: float | ca.SX) -> Number:
    """Distance covered when its rate rises, is constant and falls by minimum-jerk ramps.

    Args:
        t: Time from the start; the total duration is `total / rate + ramp`.
        total: Total distance.
        rate: Constant rate between the ramps.
        ramp: Time of each ramp.
    """
    way: Number = rate * ramp * (_covered(t / ramp) - _covered((t - total / rate) / ramp))
    return way


def _covered(s: Number) -> Any:
    """Integral from -infinity to s of `minimum_jerk`, which is 0 before and 1 after the ramp."""
    of: Any = ca if isinstance(s, ca.SX) else np
    inside = of.fmin(of.fmax(s, 0.0), 1.0)
    return inside**4 * (2.5 + inside * (-3 + inside)) + of.fmax(s - 1, 0.0)


PHASES = {"ground": 0, "takeoff": 1, "hover": 2, "forward": 3, "tour": 4, "land": 5}
"""Codes of the output `phase`, in their order."""
SMALL_ARM_M = 0.06
"""Vehicles with shorter arms fly all missions at half the size and speed."""
WAYPOINTS = (
    (4.0, 0.0, 0.0, 0.0),
    (4.0, 4.0, -1.0, 1.5),
    (0.0, 4.0, 0.5, 3.0),
    (0.0, 0.0, 0.0, 0.0),
)
"""North, east, down (m) and heading (rad) of the tour's waypoints from the first hover."""
TURN_S = 4.0
"""Duration of a turn on the spot, s. Made up."""
_TURN = 2 * np.pi  # rad


Shape = Callable[..., list[ca.SX]]
"""Time since the start of a leg (s) and its numbers -> displacement north, east, down (m) and
change of heading (rad); zero at time 0."""


@dataclass(frozen=True, slots=True)
class _Leg:
    """One part of a mission.

    Attributes:
        phase: Name of its phase.
        duration: Duration, s.
        shape: Shape of the motion; None: no motion.
        numbers: Numbers of its shape.
        whole: Displacement at its end.
    """

    phase: str
    duration: ca.SX
    shape: Shape | None = None
    numbers: tuple[ca.SX, ...] = ()
    whole: tuple[ca.SX, ...] = (ca.SX(0),) * 4


def mission(vehicle: Vehicle, name: str) -> Component:
    """A mission as a component without inputs; sizes and speeds are its parameters.

    Args:
        vehicle: Vehicle; its leg height is the height of the start, its size scales the defaults.
        name: One of `mission_names()`.

    Raises:
        ModelError: There is no such mission.
    """
    m = ComponentBuilder("mission", f"Mission {name} for {vehicle.name}")
    legs, lands = _legs(_Sizes(m, 0.5 if vehicle.arm_m < SMALL_ARM_M else 1.0), name)
    rest = [
        m.parameter(f"start.{a}", start, "m", f"Where the vehicle stands at the start, NED {d}")
        for a, d, start in zip(AXES, NED, (0.0, 0.0, -vehicle.leg_height_m), strict=True)
    ]
    rest.append(m.parameter("start.yaw", 0.0, "rad", "Heading at the start"))
    clock = m.state("clock", "s", "Time since the start of the mission", 0.0)
    m.derivative("clock", 1.0)

    ends = list(accumulate(leg.duration for leg in legs))
    begins = [ca.SX(0), *ends[:-1]]
    phase, armed = ca.SX(PHASES["ground"]), clock >= ends[0]
    for leg, before, begin in zip(legs[1:], legs, begins[1:], strict=False):
        change = PHASES[leg.phase] - PHASES[before.phase]
        phase = phase + ca.if_else(clock >= begin, change, 0.0)
    if lands:
        armed = ca.logic_and(armed, clock < begins[-1])
    where = [ca.SX(r) for r in rest]
    for leg, end in zip(legs, ends, strict=True):
        where = [
            w + ca.if_else(clock >= end, d, 0.0) for w, d in zip(where, leg.whole, strict=True)
        ]
    speed, acceleration = [[ca.SX(0)] * 4 for _ in range(2)]
    moving = []
    for shape in dict.fromkeys(leg.shape for leg in legs if leg.shape):
        own = [row for row in zip(legs, begins, ends, strict=True) if row[0].shape is shape]
        now, way = _under_way(clock, shape, own)
        flag = m.flag(f"moving{shape.__name__}", now)
        moving.append((flag, now))
        way_speed = [ca.jacobian(d, clock) for d in way]
        gain = [ca.jacobian(v, clock) for v in way_speed]
        where, speed, acceleration = (
            [a + ca.if_else(flag, b, 0.0) for a, b in zip(so_far, more, strict=True)]
            for so_far, more in ((where, way), (speed, way_speed), (acceleration, gain))
        )
    _leave_out(m, moving)
    for i, (a, d) in enumerate(zip(AXES, NED, strict=True)):
        m.output(f"setpoint_pos_{a}", "m", f"Position setpoint, NED {d}", where[i])
    for i, (a, d) in enumerate(zip(AXES, NED, strict=True)):
        m.output(f"setpoint_vel_{a}", "m/s", f"Velocity setpoint, NED {d}", speed[i])
    for i, (a, d) in enumerate(zip(AXES, NED, strict=True)):
        m.output(
            f"setpoint_acc_{a}",
            "m/s2",
            f"Acceleration setpoint, NED {d}",
            acceleration[i],
        )
    m.output("setpoint_yaw", "rad", "Heading setpoint of the nose, from north to east", where[3])
    m.output("armed", "1", "Whether the motors may turn", armed, kind="boolean")
    kind = Enumeration("FlightPhase", tuple(PHASES))
    m.output("phase", "1", "Phase of the flight", phase, kind=kind)
    m.output("phase_code", "1", "Its code, for tools without enumerations", phase, kind="integer")
    return m.build()


def _leave_out(m: ComponentBuilder, moving: Sequence[tuple[ca.SX, ca.SX]]) -> None:
    """Let the equations of shapes without a present leg be skipped.

    Args:
        m: Builder of the mission.
        moving: Flag of each shape, and whether one of its legs is in progress.
    """
    for count in range(len(moving), 0, -1):
        for left_out in combinations(moving, count):
            idle = [ca.logic_not(now) for _, now in left_out]
            step = ca.SX.sym("step")
            m.idle_while(reduce(ca.logic_and, idle), step, [flag for flag, _ in left_out])


def _under_way(
    clock: ca.SX, shape: Shape, legs: Sequence[tuple[_Leg, ca.SX, ca.SX]]
) -> tuple[ca.SX, list[ca.SX]]:
    """Whether a leg of one shape is in progress, and its displacement; zero without one.

    Args:
        clock: Time since the start of the mission.
        shape: Shape of all legs.
        legs: Legs, each with its start and end.
    """
    now = [ca.logic_and(clock >= begin, clock < end) for _, begin, end in legs]
    some = reduce(ca.logic_or, now)
    since = sum(
        (ca.if_else(on, clock - begin, 0.0) for on, (_, begin, _) in zip(now, legs, strict=True)),
        start=ca.SX(0),
    )
    numbers = []
    for column in zip(*(leg.numbers for leg, _, _ in legs), strict=True):
        chosen = (ca.if_else(on, n, 0.0) for on, n in zip(now, column, strict=True))
        numbers.append(sum(chosen, start=ca.if_else(some, 0.0, column[0])))  # all except one are 0
    return some, shape(since, *numbers)


def mission_names() -> tuple[str, ...]:
    """Names of the missions."""
    return tuple(_MISSIONS)


def mission_duration_s(name: str) -> float:
    """Duration of a mission at the default sizes, the same for every vehicle, s."""
    sizes = _Sizes(ComponentBuilder("mission", name), 1.0)
    legs, _ = _legs(sizes, name)
    total = sum((leg.duration for leg in legs), start=ca.SX(0))
    symbols, values = list(sizes.symbols.values()), list(sizes.starts.values())
    return float(ca.Function("duration", symbols, [total])(*values))


class _Sizes:
    """Parameters of a mission, declared on first use; lengths and speeds scaled."""

    def __init__(self, m: ComponentBuilder, scale: float) -> None:
        self._m, self._scale = m, scale
        self.symbols: dict[str, ca.SX] = {}
        self.starts: dict[str, float] = {}

    def __call__(self, name: str, start: float, unit: str, meaning: str) -> ca.SX:
        """Symbol of a parameter."""
        if name not in self.symbols:
            start *= self._scale if unit.startswith("m") else 1.0
            least = 1e-3 if unit in ("s", "m/s", "m/s2") else None
            self.symbols[name] = self._m.parameter(name, start, unit, meaning, minimum=least)
            self.starts[name] = start
        return self.symbols[name]


def _legs(size: _Sizes, name: str) -> tuple[list[_Leg], bool]:
    """Legs of a mission, and whether it ends on the ground with the motors off."""
    if name not in _MISSIONS:
        raise ModelError(f"there is no mission {name!r}. Known: {', '.join(_MISSIONS)}.")
    make, lands = _MISSIONS[name]
    wait = _hold("ground", size("wait", 1.0, "s", "Time on the ground before the takeoff"))
    legs = [wait, *_takeoff(size), *make(size)]
    return legs + (_land(size) if lands else []), lands


def _takeoff(size: _Sizes) -> list[_Leg]:
    height = size("height", 1.5, "m", "Height of the takeoff")
    time = size("takeoff_time", 4.0, "s", "Duration of the takeoff")
    return [_straight("takeoff", [ca.SX(0), ca.SX(0), -height, ca.SX(0)], time)]


def _land(size: _Sizes) -> list[_Leg]:
    height = size("height", 1.5, "m", "Height of the takeoff")
    time = size("land_time", 5.0, "s", "Duration of the descent")
    settle = size("settle", 1.0, "s", "Time on the ground before the motors stop, and after")
    down = _straight("land", [ca.SX(0), ca.SX(0), height, ca.SX(0)], time)
    return [down, _hold("land", settle), _hold("ground", settle)]


def _hover(start_s: float) -> Callable[[_Sizes], list[_Leg]]:
    def legs(size: _Sizes) -> list[_Leg]:
        return [_hold("hover", size("hover_time", start_s, "s", "Duration of the hover"))]

    return legs


def _forward(size: _Sizes) -> list[_Leg]:
    pause = _hold("hover", size("hover_time", 2.0, "s", "Duration of each hover"))
    distance = size("distance", 40.0, "m", "Length of the way out")
    speed = size("speed", 5.0, "m/s", "Cruise speed")
    ramp = size("ramp_time", 4.0, "s", "Time to reach the cruise speed, and to stop")
    turn = _straight("hover", [ca.SX(0)] * 3 + [ca.SX(np.pi)], ca.SX(TURN_S))

    def cruise(sign: float) -> _Leg:
        """Leg out with +1, back with -1."""
        numbers = (ca.SX(sign), distance, speed, ramp)
        whole = (sign * distance, ca.SX(0), ca.SX(0), ca.SX(0))
        return _Leg("forward", distance / speed + ramp, _cruise, numbers, whole)

    return [pause, cruise(1.0), pause, turn, cruise(-1.0), pause]


def _tour(size: _Sizes) -> list[_Leg]:
    pause = _hold("hover", size("hover_time", 1.0, "s", "Duration of each hover"))
    speed = size("speed", 2.0, "m/s", "Top speed of the tour")
    strongest = size("acceleration", 2.0, "m/s2", "Largest acceleration between waypoints")
    radius = size("radius", 1.5, "m", "Radius of the circle, half the length of the eight")
    ramp = size("ramp_time", 2.0, "s", "Time to reach the top speed of circle and eight")
    legs, before = [pause], [ca.SX(0)] * 4
    for k, place in enumerate(WAYPOINTS, start=1):
        here = [
            size(f"waypoint_{k}.{n}", v, unit, f"Waypoint {k} from the first hover, {d}")
            for n, v, unit, d in zip(
                (*AXES, "yaw"), place, ("m", "m", "m", "rad"), (*NED, "heading"), strict=True
            )
        ]
        way = [b - a for a, b in zip(before, here, strict=True)]
        far = ca.sqrt(way[0] ** 2 + way[1] ** 2 + way[2] ** 2)
        fast = ca.sqrt(HARDEST * far / strongest)
        legs.append(_straight("tour", way, ca.fmax(ca.fmax(FASTEST * far / speed, fast), 0.1)))
        before = here
    rate = speed / radius
    # The eight is fastest at its middle, sqrt(2) times the radius per radian.
    circle, eight = (
        _Leg("tour", _TURN / r + ramp, _curve, (r, ramp, radius, ca.SX(is_eight)))
        for r, is_eight in ((rate, 0), (rate / np.sqrt(2), 1))
    )
    home = [-b for b in before]
    return [*legs, pause, circle, pause, eight, pause, _straight("tour", home, ca.SX(TURN_S))]


_MISSIONS: dict[str, tuple[Callable[[_Sizes], list[_Leg]], bool]] = {
    "takeoff": (_hover(3.0), False),
    "hover": (_hover(20.0), False),
    "land": (_hover(2.0), True),
    "forward": (_forward, True),
    "tour": (_tour, True),
}
"""Legs of each mission between take-off and landing, and whether it lands; hovers in s."""


def _hold(phase: str, duration: ca.SX) -> _Leg:
    return _Leg(phase, duration)


def _straight(phase: str, way: Sequence[ca.SX], duration: ca.SX) -> _Leg:
    return _Leg(phase, duration, _straight_on, (duration, *way), tuple(way))


def _straight_on(t: ca.SX, duration: ca.SX, *way: ca.SX) -> list[ca.SX]:
    share = minimum_jerk(t / duration)
    return [share * w for w in way]


def _cruise(t: ca.SX, sign: ca.SX, distance: ca.SX, speed: ca.SX, ramp: ca.SX) -> list[ca.SX]:
    return [sign * ramped_way(t, distance, speed, ramp), ca.SX(0), ca.SX(0), ca.SX(0)]


def _curve(t: ca.SX, rate: ca.SX, ramp: ca.SX, radius: ca.SX, is_eight: ca.SX) -> list[ca.SX]:
    """A circle to the right, or a lemniscate of Gerono along north from its middle; both start
    north and end at their start."""
    angle = ramped_way(t, _TURN, rate, ramp)
    sin, cos = sine(angle), cosine(angle)
    east = ca.if_else(is_eight, radius * sin * cos, radius * (1 - cos))
    return [radius * sin, east, ca.SX(0), ca.SX(0)]
