"""Manoeuvres that a designer of experiments picks from, sized for a vehicle.

Each starts and ends at rest in a hover with the nose north, and excites something that the others
do not. A flight strings some of them together between takeoff and landing.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...flight.closed_loop import STEP_S
from ...flight.control.hover import thrust_inverse
from ...flight.minimum_jerk import FASTEST, HARDEST, minimum_jerk, ramped_way
from ...flight.mission import SMALL_ARM_M
from ...vehicle import GRAVITY_M_S2, Vehicle
from ..settings import DEFAULT, DesignSettings

Array = NDArray[np.float64]
Move = Callable[[Array], Array]
"""Time from the start, shape (n,) -> north, east, down (m) and heading (rad) off the hover,
shape (n, 4)."""
Point = tuple[float, float, float, float, float]
"""Time to get there in s, then north, east, down in m and heading in rad, off the hover."""
_GROUND_S, _TAKEOFF_S = 1.0, 3.0


@dataclass(frozen=True, slots=True)
class Manoeuvre:
    """Something to fly out of a hover and back into it.

    Attributes:
        name: Identifier.
        description: One sentence that a pilot can follow.
        duration_s: How long it takes.
        move: Where it goes.
        voltage: Battery voltage over that of the flights so far.
        payload_kg: Known mass aboard, on top of the vehicle's.
    """

    name: str
    description: str
    duration_s: float
    move: Move
    voltage: float = 1.0
    payload_kg: float = 0.0


@dataclass(frozen=True, slots=True)
class Plan:
    """Setpoints of a flight that starts and ends standing on the ground.

    Attributes:
        setpoints: In the order of `closed_loop.SETPOINTS`, one row per `STEP_S`, shape (n, 11).
        phases: Of each row.
        spans: Of each manoeuvre with the hover after it, first and last time in s, whole multiples
            of a block of time.
    """

    setpoints: Array
    phases: tuple[str, ...]
    spans: Mapping[str, tuple[float, float]]


def manoeuvres(
    vehicle: Vehicle, charged: bool = True, settings: DesignSettings = DEFAULT.design
) -> tuple[Manoeuvre, ...]:
    """All there are.

    Args:
        vehicle: Its arms scale the ways, its thrust over weight the accelerations.
        charged: Whether the flights so far had a charged battery.
        settings: Sizes.
    """
    k = hover_height_m(vehicle, settings) / settings.hover_m
    lift = thrust_inverse(vehicle).full_n / vehicle.hover_thrust_n
    share, fastest = settings.push, settings.fastest_m_s2
    climb = min(share * (lift - 1) * GRAVITY_M_S2, fastest)
    push = min(share * float(np.sqrt(max(lift**2 - 1, 0.0))) * GRAVITY_M_S2, fastest)
    climb, push = max(climb, 0.3), max(push, 0.3)
    return (
        *_on_the_spot(charged, settings.other_voltage),
        _payload_swap(vehicle, lift, settings),
        *_vertical(vehicle, k, climb, settings),
        *_sideways(k, push),
    )


def hover_height_m(vehicle: Vehicle, settings: DesignSettings = DEFAULT.design) -> float:
    """Over the resting place, where manoeuvres start."""
    return settings.hover_m * (0.5 if vehicle.arm_m < SMALL_ARM_M else 1.0)


def plan(
    vehicle: Vehicle,
    chosen: Sequence[Manoeuvre],
    settings: DesignSettings = DEFAULT.design,
    block_s: float = DEFAULT.inference.likelihood.block_s,
) -> Plan:
    """A flight: stand, take off, fly each manoeuvre, land.

    Args:
        vehicle: Says where it stands and how high it hovers.
        chosen: In this order.
        settings: Sizes.
        block_s: Blocks of time that flights are judged in.
    """
    height = hover_height_m(vehicle, settings)
    pieces = [
        ("ground", np.zeros((_rows(_GROUND_S), 4))),
        ("takeoff", _sampled(_path((_TAKEOFF_S, 0, 0, -height, 0)), _TAKEOFF_S)),
    ]
    hover, spans, t = np.array([0.0, 0.0, -height, 0.0]), {}, 0.0
    before = _GROUND_S + _TAKEOFF_S
    for m in (Manoeuvre("", "", settings.settle_s, _path()), *chosen):
        blocks = math.ceil((before + m.duration_s + settings.pause_s) / block_s)
        last = t + block_s * blocks
        pieces.append(("tour", hover + _sampled(m.move, m.duration_s)))
        pieces.append(("hover", np.tile(hover, (_rows(last - t - before - m.duration_s), 1))))
        spans[m.name] = (t, last)
        t, before = last, 0.0
    del spans[""]
    pieces.append(("land", hover + _sampled(_path((_TAKEOFF_S, 0, 0, height, 0)), _TAKEOFF_S)))
    pieces.append(("ground", np.zeros((_rows(_GROUND_S), 4))))
    phases = tuple(phase for phase, rows in pieces for _ in rows)
    where = np.vstack([rows for _, rows in pieces])
    where[:, 2] -= vehicle.leg_height_m
    speed = np.gradient(where[:, :3], STEP_S, axis=0)
    push = np.gradient(speed, STEP_S, axis=0)
    armed = np.array([phase != "ground" for phase in phases], dtype=np.float64)
    return Plan(np.column_stack([where[:, :3], speed, push, where[:, 3], armed]), phases, spans)


# -- the list -------------------------------------------------------------------------------


def _on_the_spot(charged: bool, other_voltage: float) -> list[Manoeuvre]:
    """Hovers and turns."""
    turn = np.pi / 3
    other = "a nearly empty" if charged else "a freshly charged"
    voltage = 1 - other_voltage if charged else 1 + other_voltage
    return [
        Manoeuvre("hover", "Hover for 7 s without moving.", 7.0, _path()),
        Manoeuvre("other_voltage", f"Hover for 7 s with {other} battery.", 7.0, _path(), voltage),
        _pointwise(
            "yaw_steps",
            "In hover turn the nose by 60 degrees to the right within 0.8 s, stop, turn it back, "
            "then the same to the left; twice.",
            [(s, 0, 0, 0, a) for a in (turn, 0, -turn, 0) for s in (0.8, 0.4)] * 2,
        ),
        _pointwise(
            "four_headings",
            "Hover for 2 s each with the nose east, south, west and north, turning in 1.5 s.",
            [(s, 0, 0, 0, i * np.pi / 2) for i in range(1, 5) for s in (1.5, 2.0)],
        ),
    ]


def _payload_swap(vehicle: Vehicle, lift: float, settings: DesignSettings) -> Manoeuvre:
    """Hover with a mass that is known: what scales a force acts on it, what adds one does not."""
    share = max(min(settings.payload, settings.push * (lift - 1)), settings.lightest_payload)
    payload_kg = float(f"{share * vehicle.mass_kg:.1g}")
    return Manoeuvre(
        "payload_swap",
        f"Strap a weight of {payload_kg:g} kg to the aircraft, as close to its centre of mass as "
        f"can be, and hover for 7 s; tell explain the weight of that flight.",
        7.0,
        _path(),
        payload_kg=payload_kg,
    )


def _vertical(
    vehicle: Vehicle, k: float, climb: float, settings: DesignSettings
) -> list[Manoeuvre]:
    """Up and down: in steps, for long, to the ground."""
    short, tall, fast = k, 4 * k, 2.5 * k
    step_s, tall_s = _time_s(short, climb), _time_s(tall, climb, fast)
    clearance = max(settings.clearance_m, settings.clearance_arms * vehicle.arm_m)
    low = hover_height_m(vehicle, settings) - clearance
    return [
        _pointwise(
            "vertical_steps",
            f"From hover climb {short:g} m within {step_s:.1f} s, stop, sink back as fast; "
            f"three times.",
            [(s, 0, 0, z, 0) for z in (-short, 0) for s in (step_s, 0.4)] * 3,
        ),
        _pointwise(
            "climb_and_sink",
            f"From hover climb {tall:g} m at up to {fast:g} m/s, sink back as fast; twice.",
            [(tall_s, 0, 0, z, 0) for z in (-tall, 0)] * 2,
        ),
        _pointwise(
            "near_ground",
            f"From hover sink until the legs are {clearance:.2f} m above the ground, hover there "
            f"for 4 s, climb back.",
            [(2.0, 0, 0, low, 0), (4.0, 0, 0, low, 0), (2.0, 0, 0, 0, 0)],
        ),
    ]


def _sideways(k: float, push: float) -> list[Manoeuvre]:
    """Jumps, legs at speed, circle and eight."""
    hop, way, fast, radius = 0.8 * k, 10 * k, 5 * k, 1.5 * k
    hop_s, leg_s = _time_s(hop, push), _time_s(way, push, fast)
    there = ((0, 1), (0, -1), (1, 0), (-1, 0))
    jumps = [(hop_s, i * n * hop, i * e * hop, 0, 0) for n, e in there for i in (1, 0)]
    legs = [
        (s, north, 0, 0, yaw)
        for yaw in (0, np.pi / 2)
        for s, north in ((1.5, 0), (leg_s, way), (1.0, way), (leg_s, 0))
    ]
    rate = float(np.sqrt(0.5 * push / radius))
    laps = f"{radius:g} m radius at {rate * radius:.1f} m/s, nose north."
    return [
        _pointwise(
            "doublets",
            f"In hover jump {hop:g} m to the right within {hop_s:.1f} s, back, to the left, back, "
            f"then the same forward and backward; twice.",
            jumps * 2,
        ),
        _pointwise(
            "forward_legs",
            f"Fly {way:g} m north at up to {FASTEST * way / leg_s:.1f} m/s, nose first, and back "
            f"tail first; then the same with the nose east, sideways.",
            [*legs, (1.5, 0, 0, 0, 0)],
        ),
        _rounds("circle", f"Fly a circle of {laps}", radius, rate, lambda a: 1 - np.cos(a)),
        _rounds(
            "eight", f"Fly a figure eight of {laps}", radius, rate, lambda a: np.sin(a) * np.cos(a)
        ),
    ]


# -- how they move --------------------------------------------------------------------------


def _pointwise(name: str, description: str, points: Sequence[Point]) -> Manoeuvre:
    """From point to point."""
    return Manoeuvre(name, description, sum(p[0] for p in points), _path(*points))


def _path(*points: Point) -> Move:
    """Minimum-jerk ramps from point to point, starting at the hover."""

    def move(t: Array) -> Array:
        """Where it is."""
        where, begin, here = np.zeros((len(t), 4)), 0.0, np.zeros(4)
        for duration, *place in points:
            s = np.clip((t - begin) / duration, 0, 1)[:, None]
            where += minimum_jerk(s) * (np.array(place) - here)
            begin, here = begin + duration, np.array(place, dtype=np.float64)
        return where

    return move


def _rounds(
    name: str, description: str, radius: float, rate: float, east: Callable[[Array], Array]
) -> Manoeuvre:
    """One round that starts north, the angle to the way east; its rate ramps up and down."""
    ramp_s, total = 2.0, 2 * np.pi
    duration_s = total / rate + ramp_s

    def move(t: Array) -> Array:
        """Where it is."""
        a = ramped_way(t, total, rate, ramp_s)
        return np.column_stack([radius * np.sin(a), radius * east(a), 0 * t, 0 * t])

    return Manoeuvre(name, description, duration_s, move)


def _time_s(way_m: float, push_m_s2: float, fastest_m_s: float = np.inf) -> float:
    """Time of a minimum-jerk ramp that stays below an acceleration and a speed."""
    slow = float(np.sqrt(HARDEST * way_m / push_m_s2))
    return round(max(slow, FASTEST * way_m / fastest_m_s), 1)


def _rows(duration_s: float) -> int:
    return round(duration_s / STEP_S)


def _sampled(move: Move, duration_s: float) -> Array:
    return move(STEP_S * np.arange(_rows(duration_s), dtype=np.float64))
