"""Experiment design: the manoeuvre that best discriminates between two explanations.

*Manoeuvres* are scaled to a vehicle. Each starts and ends at rest in a hover with the nose north,
and excites something that the others do not; a plan joins some of them between takeoff and landing.
A *rehearsal* is a plan flown by the twin with its effects, recorded with the columns and rates of
the given flights.

*Discrimination*: each of the two explanations in turn is assumed true. The twin with its effects
flies every manoeuvre in closed loop; the other explanation, with its numbers free within their
posterior, predicts the same readings. The difference of the predictions, in the whitened metric of
the search, is the expected log likelihood ratio; noise has no influence on it, so none is drawn.
Both predictions are those of `FlightModel`, so discretisation errors cancel.

Source: discrimination between rival models, Hunter & Reiner, Technometrics 7 (1965); Atkinson &
Fedorov, Biometrika 62 (1975).
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..effects import EFFECTS
from ..errors import TwinError
from ..flight.closed_loop import STEP_S
from ..flight.control_laws import thrust_inverse
from ..flight.mission import FASTEST, HARDEST, SMALL_ARM_M, minimum_jerk, ramped_way
from ..flight.simulate_flight import Recorder, Stream, simulate_flight
from ..logs import Flight
from ..representation import short_repr
from ..residuals.channels import GRID_HZ, Array
from ..vehicle import GRAVITY_M_S2, Vehicle
from .inference.evidence import Factored, best_inside
from .inference.fit import Fit
from .inference.selection import Naming
from .inference.whitening import Block, blocks_of
from .model.model import Model, model_of
from .model.numbers import carrying, with_effects
from .settings import DEFAULT

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
ENOUGH_NAT = 5.0
"""Expected log likelihood ratio, nats, below which a manoeuvre does not discriminate: odds of 150
to 1."""
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
    block_s: float = DEFAULT.inference.likelihood.block_s,
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
    plan: Plan, vehicle: Vehicle, plant: Vehicle, like: Sequence[Flight], voltage: float = 1.0
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
    """
    recorder = Recorder(
        streams=streams_of(like),
        rate_hz=GRID_HZ,
        sampled_hz=GRID_HZ,
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


# -- discrimination between two explanations -----------------------------------------------


@dataclass(frozen=True, slots=True)
class Suggestion:
    """Suggested manoeuvre that discriminates between two sets of effects.

    Attributes:
        manoeuvre: Identifier.
        description: Instruction for the pilot.
        separates: The two sets, the more probable first; an empty one: no effect is missing.
        separation: Expected log likelihood ratio in favour of the true one, nats, mean over both.
    """

    manoeuvre: str
    description: str
    separates: tuple[tuple[str, ...], tuple[str, ...]]
    separation: float

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class Held:
    """Constraints on the numbers of an explanation: precision by the given flights and priors,
    shape (k, k); largest changes down and up, shape (k,)."""

    precision: Array
    low: Array
    high: Array


def next_manoeuvre(naming: Naming, vehicle: Vehicle) -> Suggestion | None:
    """The manoeuvre that best discriminates between the two leading explanations; None where the
    name is certain, or where no manoeuvre helps."""
    if naming.verdict != "cannot_tell" and not naming.undecided:
        return None
    best = suggestions(naming, vehicle)[0]
    return best if best.separation >= ENOUGH_NAT else None


def suggestions(
    naming: Naming, vehicle: Vehicle, among: Sequence[str] | None = None
) -> list[Suggestion]:
    """Discrimination between the two leading explanations by each manoeuvre, or by each of `among`,
    the best first."""
    block_s = naming.whitened.settings.block_s
    rivals, flights = naming.fitted[:2], _flights(naming)
    listed = [m for m in _flyable(naming, vehicle) if among is None or m.name in among]
    leads = {m.name: 0.0 for m in listed}
    held = [_held(naming, f) for f in rivals]
    rounds = [(i, *k) for i in (0, 1) for k in sorted({(m.voltage, m.payload_kg) for m in listed})]
    for i, voltage, payload_kg in rounds:
        loaded = carrying(vehicle, payload_kg)
        chosen = [m for m in listed if (m.voltage, m.payload_kg) == (voltage, payload_kg)]
        flown = plan(loaded, chosen, block_s)
        plant = with_effects(loaded, rivals[i].effects, rivals[i].values)
        try:
            flight = rehearse(flown, loaded, plant, flights, voltage)
            blocks = _parting(naming, flight, loaded, rivals[i], rivals[1 - i])
        except TwinError:  # numbers with which the twin cannot fly
            continue
        for name, (first, last) in flown.spans.items():
            if last <= flight.table["time"].iloc[-1]:
                inside = [b for (_, k), b in blocks.items() if first <= k * block_s < last]
                leads[name] += lead(inside, held[1 - i]) / 2
    pair = (rivals[0].effects, rivals[1].effects)
    found = [Suggestion(m.name, m.description, pair, leads[m.name]) for m in listed]
    return sorted(found, key=lambda s: -s.separation)


# -- what is left between two explanations --------------------------------------------------


def _parting(
    naming: Naming, flight: Flight, vehicle: Vehicle, truth: Fit, other: Fit
) -> dict[tuple[int, int], Block]:
    """Difference between the predictions of two explanations for a flight, by blocks of time."""
    union = {*truth.effects, *other.effects}
    model = model_of([flight], vehicle, [e for e in EFFECTS.values() if e.name in union])
    known = naming.whitened.model.channels([])[0]
    noise = {c.name: n for c, n in zip(known, naming.whitened.noise, strict=True)}
    true = {c.name: c.residual for c in model.channels([], truth.values)[0]}
    rows = [
        replace(c, residual=c.residual - true[c.name])
        for c in model.channels(_columns(model, other), other.values)[0]
        if c.name in noise
    ]
    even = [replace(noise[c.name], weights=(np.ones(len(c.t_s)),)) for c in rows]
    return blocks_of([rows], even, naming.whitened.settings) if rows else {}


def lead(blocks: Sequence[Block], held: Held) -> float:
    """Log likelihood by which an explanation falls behind, with its numbers refitted."""
    if not blocks:
        return 0.0
    total = sum(blocks[1:], blocks[0])
    if not total.pull.size:
        return 0.5 * total.power
    gram = total.gram + held.precision
    best = best_inside(Factored.of(gram), total.pull, held.low, held.high)
    return float(0.5 * (total.power - 2 * total.pull @ best + best @ gram @ best))


def _held(naming: Naming, fitted: Fit) -> Held:
    """Posterior constraints on the numbers of an explanation by the given flights and priors."""
    whitened = naming.whitened
    own, at = _columns(whitened.model, fitted), fitted.values
    answers = whitened.model.channels(own, at)
    blocks = blocks_of(answers, whitened.noise, whitened.settings).values()
    numbers = [whitened.model.numbers[i] for i in own]
    prior = np.diag([1 / n.sd**2 for n in numbers])
    return Held(
        np.sum([b.gram for b in blocks], axis=0) + prior,
        np.array([n.about.bounds[0] - at[n.full] for n in numbers]),
        np.array([n.about.bounds[1] - at[n.full] for n in numbers]),
    )


def _columns(model: Model, fitted: Fit) -> list[int]:
    """Indices of the numbers of an explanation, including shape parameters."""
    return [i for i, n in enumerate(model.numbers) if n.full in fitted.values]


# -- flying ---------------------------------------------------------------------------------


def _flyable(naming: Naming, vehicle: Vehicle) -> list[Manoeuvre]:
    """Manoeuvres that differ from each other for this vehicle: the battery ones only where its
    voltage matters."""
    flights = _flights(naming)
    charged = volts_of(flights, vehicle) >= vehicle.voltage_v
    listed = manoeuvres(vehicle, charged)
    effects = {e for f in naming.fitted[:2] for e in f.effects} | {*vehicle.effects}
    voltage_matters = vehicle.rotors.reference_voltage_v is not None
    voltage_matters = voltage_matters or any("vbat" in EFFECTS[e].needs for e in effects)
    if voltage_matters and all(f.has("vbat_v") for f in flights):
        return list(listed)
    return [m for m in listed if m.voltage == 1]


def _flights(naming: Naming) -> list[Flight]:
    return [m.flight for m in naming.whitened.model.flights]
