"""Manoeuvres that excite what a model may lack, and plans of a flight that joins them.

Manoeuvres are scaled to a vehicle. Each starts and ends at rest in a hover with the nose north, and
excites something that the others do not. A plan joins some of them between takeoff and landing. A
rehearsal is a plan flown by the twin with its effects, recorded with the columns and rates of given
flights.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..logs import Flight
from ..vehicle import GRAVITY_M_S2, Vehicle
from .closed_loop import STEP_S
from .control_laws import thrust_inverse
from .mission import FASTEST, HARDEST, SMALL_ARM_M, minimum_jerk, ramped_way
from .simulate_flight import Recorder, Stream, simulate_flight

Array = NDArray[np.float64]
HOVER_M = 1.5
"""Hover height above the take-off place, and unit of distances, m, made up; vehicles with short
arms fly everything at half the size, as in missions."""
PUSH, FASTEST_M_S2 = 0.4, 4.0
"""Share of the acceleration that the thrust-to-weight ratio allows, and its limit, m/s^2. Made
up."""
CLEARANCE_M, CLEARANCE_ARMS = 0.15, 0.7
"""Least clearance between legs and ground, m, and in arm lengths: a log must show that it flies.
Made up."""
OTHER_VOLTAGE = 0.1
"""Relative voltage difference between a charged and a nearly empty battery, as for LiPo cells."""
PAYLOAD, LIGHTEST_PAYLOAD = 0.5, 0.02
"""Payload as a share of the vehicle's mass, where thrust allows it, and its minimum. It is as large
as possible: explanations differ by half of the explained force, and laws are accurate only to a
seventh."""
PAUSE_S, SETTLE_S = 1.0, 6.0
"""Shortest hover after a manoeuvre, and after takeoff, in which the controller's integrators
settle, s. Made up."""
BLOCK_S = 2.0
"""Length, s, of which the span of each manoeuvre in a plan is a multiple."""
Move = Callable[[Array], Array]
"""Function of time, s, shape (n,), that returns north, east, down (m) and heading (rad) relative to
the hover, shape (n, 4)."""
Point = tuple[float, float, float, float, float]
"""Duration of the way to a point, s, then north, east, down in m and heading in rad, relative to
the hover."""
_GROUND_S, _TAKEOFF_S = 1.0, 3.0
"""Time on the ground and in the take-off of a suggested flight, s; by judgement."""


@dataclass(frozen=True, slots=True)
class Manoeuvre:
    """Manoeuvre that starts and ends in hover.

    Attributes:
        name: Identifier.
        description: Instruction for the pilot in one sentence.
        duration_s: Duration, s.
        move: Trajectory of setpoints.
        voltage: Battery voltage over that of the given flights.
        payload_kg: Known payload, kg, added to the vehicle's mass.
    """

    name: str
    description: str
    duration_s: float
    move: Move
    voltage: float = 1.0
    payload_kg: float = 0.0


@dataclass(frozen=True, slots=True)
class Plan:
    """Setpoints of a flight that starts and ends on the ground.

    Attributes:
        setpoints: Setpoints in the order of `closed_loop.SETPOINTS`, one row per `STEP_S`, shape
            (n, 11).
        phases: Phase of each row.
        spans: First and last time of each manoeuvre with the hover after it, s, integer multiples
            of the block length.
    """

    setpoints: Array
    phases: tuple[str, ...]
    spans: Mapping[str, tuple[float, float]]


def manoeuvres(vehicle: Vehicle, charged: bool = True) -> tuple[Manoeuvre, ...]:
    """All manoeuvres of a vehicle."""
    k = hover_height_m(vehicle) / HOVER_M
    inverse = thrust_inverse(vehicle)
    lift = inverse.full_n / inverse.hover_n
    climb, push = (
        max(0.3, min(PUSH * free * GRAVITY_M_S2, FASTEST_M_S2))
        for free in (lift - 1, math.sqrt(max(lift**2 - 1, 0.0)))
    )
    return (
        *_on_the_spot(charged),
        _payload_swap(vehicle, lift),
        *_vertical(vehicle, k, climb),
        *_sideways(k, push),
    )


def hover_height_m(vehicle: Vehicle) -> float:
    """Height of the hover in which manoeuvres start, m above the take-off place."""
    return HOVER_M * (0.5 if vehicle.arm_m < SMALL_ARM_M else 1.0)


def plan(
    vehicle: Vehicle,
    chosen: Sequence[Manoeuvre],
    block_s: float = BLOCK_S,
) -> Plan:
    """Plan of a flight: stand, take off, fly each manoeuvre, land."""
    height = hover_height_m(vehicle)
    pieces = [
        ("ground", np.zeros((_rows(_GROUND_S), 4))),
        ("takeoff", _sampled(_path((_TAKEOFF_S, 0, 0, -height, 0)), _TAKEOFF_S)),
    ]
    hover, spans, t = np.array([0.0, 0.0, -height, 0.0]), {}, 0.0
    before = _GROUND_S + _TAKEOFF_S
    for m in (Manoeuvre("", "", SETTLE_S, _path()), *chosen):
        blocks = math.ceil((before + m.duration_s + PAUSE_S) / block_s)
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


def _on_the_spot(charged: bool) -> list[Manoeuvre]:
    """Hovers and yaw turns."""
    turn = np.pi / 3
    other = "a nearly empty" if charged else "a freshly charged"
    voltage = 1 - OTHER_VOLTAGE if charged else 1 + OTHER_VOLTAGE
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


def _payload_swap(vehicle: Vehicle, lift: float) -> Manoeuvre:
    """Hover with a known payload, with which effects that scale a force grow, and added forces do
    not."""
    share = max(min(PAYLOAD, PUSH * (lift - 1)), LIGHTEST_PAYLOAD)
    payload_kg = float(f"{share * vehicle.mass_kg:.1g}")
    return Manoeuvre(
        "payload_swap",
        f"Strap a weight of {payload_kg:g} kg to the aircraft, as close to its centre of mass as "
        f"can be, and hover for 7 s; tell explain the weight of that flight.",
        7.0,
        _path(),
        payload_kg=payload_kg,
    )


def _vertical(vehicle: Vehicle, k: float, climb: float) -> list[Manoeuvre]:
    """Vertical manoeuvres: steps, long climbs, descent to the ground."""
    short, tall, fast = k, 4 * k, 2.5 * k
    step_s, tall_s = _time_s(short, climb), _time_s(tall, climb, fast)
    clearance = max(CLEARANCE_M, CLEARANCE_ARMS * vehicle.arm_m)
    low = hover_height_m(vehicle) - clearance
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
    """Horizontal manoeuvres: steps, fast legs, circle and eight."""
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
    """Manoeuvre from point to point."""
    return Manoeuvre(name, description, sum(p[0] for p in points), _path(*points))


def _path(*points: Point) -> Move:
    """Trajectory of minimum-jerk ramps from point to point, starting at the hover."""

    def move(t: Array) -> Array:
        """Setpoint at times t."""
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
    """One round that starts north; `east` maps the angle to the distance east; its rate ramps up
    and down."""
    ramp_s, total = 2.0, 2 * np.pi
    duration_s = total / rate + ramp_s

    def move(t: Array) -> Array:
        """Setpoint at times t."""
        a = ramped_way(t, total, rate, ramp_s)
        return np.column_stack([radius * np.sin(a), radius * east(a), 0 * t, 0 * t])

    return Manoeuvre(name, description, duration_s, move)


def _time_s(way_m: float, push_m_s2: float, fastest_m_s: float = np.inf) -> float:
    """Duration of a minimum-jerk ramp that stays below an acceleration and a speed, s."""
    slow = float(np.sqrt(HARDEST * way_m / push_m_s2))
    return round(max(slow, FASTEST * way_m / fastest_m_s), 1)


def _rows(duration_s: float) -> int:
    return round(duration_s / STEP_S)


def _sampled(move: Move, duration_s: float) -> Array:
    return move(STEP_S * np.arange(_rows(duration_s), dtype=np.float64))


# -- rehearsal -----------------------------------------------------------------------------


def rehearse(
    plan: Plan,
    vehicle: Vehicle,
    plant: Vehicle,
    like: Sequence[Flight],
    voltage: float = 1.0,
    rate_hz: float = 200.0,
) -> Flight:
    """Fly a plan in closed loop and record it without noise.

    Delays of command and pose appear in the record only, not in the loop of the controller. The
    record ends where the vehicle is lost.

    Args:
        plan: Setpoints.
        vehicle: Vehicle for which the controller is designed.
        plant: Simulated vehicle, with its effects.
        like: Flights whose columns and rates the record has, as far as the twin has the signals.
        voltage: Battery voltage over that of these flights.
        rate_hz: Highest rate of the record, Hz.
    """
    recorder = Recorder(
        streams=streams_of(like),
        rate_hz=rate_hz,
        sampled_hz=rate_hz,
        early_commands=True,
        until_lost=True,
    )
    volts = volts_of(like, vehicle) * voltage
    return simulate_flight(plan.setpoints, plan.phases, vehicle, plant, recorder, "next", volts)


def streams_of(flights: Sequence[Flight]) -> tuple[Stream, ...]:
    """All numeric columns of the flights, each at the highest rate among them."""
    periods: dict[str, list[float]] = {}
    for flight in flights:
        for column in (c for c in flight.table if c not in ("time", "phase") and flight.has(c)):
            t_s, _ = flight.signal([column])
            if len(t_s) > 1:
                periods.setdefault(column, []).append(float(np.median(np.diff(t_s))))
    return tuple(Stream((column,), min(found)) for column, found in periods.items())


def volts_of(flights: Sequence[Flight], vehicle: Vehicle) -> float:
    """Median battery voltage of the flights, V, or that of the vehicle where none was logged."""
    read = [f.signal(["vbat_v"])[1] for f in flights if f.has("vbat_v")]
    return float(np.median(np.concatenate(read))) if read else vehicle.voltage_v
