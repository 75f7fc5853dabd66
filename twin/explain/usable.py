"""Selection of the part of a flight that a search uses.

*Longest part*: of a long flight the contiguous part with most motion is used.

*Usability*: the record is split at impacts and falls, and the longer part is used; while a motor is
saturated, torque and thrust are not compared, but lateral specific force is. A flight is rejected
where too little remains, or where its signals contradict each other.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from ..errors import LogError
from ..logs import AnyFlight, Flight
from ..logs.columns import ACC, POS, QUAT, VEL, motor_columns
from ..logs.samples import stretches_where
from ..physics.sensors.table import sensor_of
from ..residuals.aligned import AlignedFlight, align_flight
from ..residuals.channels import GRID_HZ, Array
from ..residuals.measured import Signal, agreement, differentiate, zero_phase
from ..vehicle import GRAVITY_M_S2, Vehicle
from .model.factors import FORCE, TORQUE
from .model.model import channel_names
from .model.numbers import Payloads, carrying
from .settings import DEFAULT, UsableSettings

READ = "{}: {:.0f} to {:.0f} s of {:.0f} s are read, where it moves most; cut the log for others"
"""Text: flight, first and last second that is used, and its length, s."""
BLOCK_S = 10.0
"""The part of a long flight begins at a multiple of this, s; by judgement."""


def part_read(
    flight: AnyFlight, settings: UsableSettings = DEFAULT.usable
) -> tuple[Flight, str | None]:
    """The part of a flight that is used, and a text on it; None: all of it is used."""
    time = flight.time_s
    whole_s = float(time[-1] - time[0]) if len(time) else 0.0
    if whole_s <= settings.longest_s:
        return flight if isinstance(flight, Flight) else flight.between(-np.inf, np.inf), None
    edges = np.arange(time[0], time[-1], BLOCK_S)
    moves = np.sum([*_movement(flight, edges)], axis=0)  # (blocks,)
    length = round(settings.longest_s / BLOCK_S)
    together = np.convolve(moves, np.ones(length), mode="valid")
    start = float(edges[int(np.argmax(together))])
    end = min(start + settings.longest_s, float(time[-1]))
    return flight.between(start, end), READ.format(flight.name, start, end, whole_s)


def _movement(flight: AnyFlight, edges: Array) -> Iterator[Array]:
    """Change of each signal within each time block, with mean 1 over the blocks."""
    yield np.zeros(len(edges))
    rotors = sum(c.startswith("cmd_") for c in flight.columns)
    for columns in (VEL, QUAT, motor_columns("cmd", rotors)):
        if not columns or not flight.has(*columns):
            continue
        t_s, values = flight.signal(columns)
        block = np.searchsorted(edges, t_s, side="right") - 1
        count = np.maximum(np.bincount(block, minlength=len(edges)), 1)
        spread = np.zeros(len(edges))
        for column in values.T:
            mean = np.bincount(block, column, len(edges)) / count
            spread += np.bincount(block, (column - mean[block]) ** 2, len(edges)) / count
        if spread.any():
            yield spread / spread.mean()


# -- fit for a search ----------------------------------------------------------------------


_BODY_CHANNELS = ("acc_", "gyro_rate_", *FORCE, *TORQUE)
"""Prefixes of the channels of force and torque."""
Event = tuple[float, float, str]
"""Start and end of an event, s, and its description."""


def usable_part(
    flight: Flight, vehicle: Vehicle, settings: UsableSettings = DEFAULT.usable
) -> tuple[Flight, list[str], list[str]]:
    """The part of a flight that contains information about a vehicle.

    Returns:
        The part; texts on what is left out, when and why; reasons why nothing can be estimated,
        empty for a usable flight.
    """
    try:
        aligned = align_flight(flight, vehicle, 1 / GRID_HZ)
        part, left_out = _longest(flight, aligned, settings)
        if part is not flight:
            aligned = align_flight(part, vehicle, 1 / GRID_HZ)
    except LogError as error:
        return flight, [], [str(error)]
    left_out += _saturated(aligned)
    reasons = [
        reason
        for check in (_too_short, _turning, _moving, _upward)
        for reason in check(part, aligned, settings)
    ]
    if reasons and left_out:
        reasons = [f"{reason} (left out: {'; '.join(left_out)})" for reason in reasons]
    left_out, reasons = (
        [f"{flight.name}: {text}" for text in texts] for texts in (left_out, reasons)
    )
    return part, left_out, reasons


def with_readings(
    flights: Sequence[Flight], vehicle: Vehicle, payloads: Payloads | None = None
) -> tuple[list[Flight], list[str]]:
    """Flights with channels to compare, and the reasons why the others have none: a flight without
    force or torque would remove it in all."""
    retained, reasons, named = list[Flight](), list[str](), list[tuple[Flight, list[str]]]()
    for flight in flights:
        try:
            named.append((flight, channel_names(flight, flown(flight, vehicle, payloads))))
        except LogError as error:
            reasons.append(str(error))
    complete = [any(name.startswith(_BODY_CHANNELS) for name in names) for _, names in named]
    every = {n for _, names in named for n in names if n.startswith(_BODY_CHANNELS)}
    made_of = {n: s.columns for n in sorted(every) if (s := sensor_of(n)) is not None}
    for (flight, names), body in zip(named, complete, strict=True):
        if not names:
            reasons.append(f"{flight.name}: no reading is known for long enough in the air")
        elif any(complete) and not body:
            reasons.append(
                f"{flight.name}: neither accelerometer, gyroscope nor pose with attitude is known "
                f"for long enough in the air, as in other flights"
            )
        elif lost := [n for n, c in made_of.items() if n not in names and flight.has(*c)]:
            reasons.append(
                f"{flight.name}: {', '.join(lost)} are not known for long enough with no motor at "
                f"a limit, as in other flights"
            )
        else:
            retained.append(flight)
    return retained, reasons


def flown(flight: Flight, vehicle: Vehicle, payloads: Payloads | None) -> Vehicle:
    """The vehicle of a flight, including a known payload."""
    return carrying(vehicle, (payloads or {}).get(flight.name, 0.0))


def _too_short(flight: Flight, aligned: AlignedFlight, settings: UsableSettings) -> Iterator[str]:
    seconds = float(aligned.airborne.sum()) / GRID_HZ
    if seconds < settings.shortest_s:
        yield f"only {seconds:.1f} s in the air; at least {settings.shortest_s:g} s are needed"


def _saturated(aligned: AlignedFlight) -> list[str]:
    """Text on how long torque and thrust are not compared."""
    at_limit = aligned.saturated & aligned.airborne
    if not at_limit.any():
        return []
    seconds, share = np.sum(at_limit) / GRID_HZ, np.sum(at_limit) / np.sum(aligned.airborne)
    return [
        f"{seconds:.1f} s ({100 * share:.0f} % of the time in the air) of gyro_rate and acc_z, in "
        f"which a motor is at a limit"
    ]


def _longest(
    flight: Flight, aligned: AlignedFlight, settings: UsableSettings
) -> tuple[Flight, list[str]]:
    """The longest part of a flight between impacts and falls, and texts on what is left out."""
    t = aligned.inputs.t_s
    events = sorted([*_falls(aligned, settings), *_blows(flight, aligned, settings)])
    if not events:
        return flight, []
    free, since = [], float(t[0])
    for start, end, _ in events:
        if start > since:
            free.append((since, start))
        since = max(since, end)
    if since < t[-1]:
        free.append((since, float(t[-1])))
    if not free:
        raise LogError(f"{flight.name}: {events[0][2]}.")
    first, last = max(free, key=lambda span: _in_air(aligned, *span))
    left_out = []
    if first > t[0]:
        why = [what for _, end, what in events if end <= first][-1]
        seconds = _in_air(aligned, float(t[0]), first)
        left_out.append(f"up to {first:.1f} s ({seconds:.1f} s in the air): {why}")
    if last < t[-1]:
        why = next(what for start, _, what in events if start >= last)
        seconds = _in_air(aligned, last, float(t[-1]))
        left_out.append(f"from {last:.1f} s on ({seconds:.1f} s in the air): {why}")
    return flight.between(first, last), left_out


def _in_air(aligned: AlignedFlight, first_s: float, last_s: float) -> float:
    """Time in the air within a span, s."""
    t = aligned.inputs.t_s
    return float(np.sum(aligned.airborne & (t >= first_s) & (t <= last_s))) / GRID_HZ


def _falls(aligned: AlignedFlight, settings: UsableSettings) -> Iterator[Event]:
    """Spans in which the vehicle is upside down, from when it was last upright until it is again,
    or lies on its side at the end."""
    if aligned.motion.attitude is None:
        return
    t, margin = aligned.inputs.t_s, settings.around_s
    _, x, y, _ = aligned.motion.attitude.at(t).T
    upright = 1 - 2 * (x * x + y * y)  # cosine of the tilt
    standing = np.flatnonzero(upright >= settings.tipped_cos)

    def around(k: int) -> tuple[float, float]:
        """Time when it was last upright before a row, and when it is again, s."""
        place = int(np.searchsorted(standing, k))
        before = t[standing[place - 1]] if place else t[0]
        after = t[standing[place]] if place < len(standing) else t[-1]
        return float(before) - margin, float(after) + margin

    over = aligned.airborne & (upright < 0)
    fallen = False
    for first, end in stretches_where(over):
        if end - first > settings.upside_down_s * GRID_HZ:
            fallen = True
            yield *around(first), f"upside down at {t[first]:.1f} s, a crash or aerobatics"
    known = np.flatnonzero(np.isfinite(upright))
    end_rows = known[-round(GRID_HZ) :]
    if not fallen and len(end_rows) and np.median(upright[end_rows]) < settings.tipped_cos:
        start, _ = around(int(end_rows[-1]))
        yield start, float(t[-1]), "it lies on its side at the end of the record, a crash"


def _blows(flight: Flight, aligned: AlignedFlight, settings: UsableSettings) -> Iterator[Event]:
    """Spans in which the specific force is larger than in any flight."""
    if not flight.has(*ACC):
        return
    signal, t = Signal(*flight.signal(ACC)), aligned.inputs.t_s
    force = np.linalg.norm(Signal(signal.t_s, zero_phase(signal, settings.impact_hz)).at(t), axis=1)
    hit = np.flatnonzero(aligned.airborne & (force > settings.impact_m_s2))
    for rows in np.split(hit, np.flatnonzero(np.diff(hit) > settings.around_s * GRID_HZ) + 1):
        if len(rows):
            size = np.max(force[rows]) / GRAVITY_M_S2
            yield (
                float(t[rows[0]]) - settings.around_s,
                float(t[rows[-1]]) + settings.around_s,
                f"hits something at {t[rows[0]]:.1f} s, {size:.0f} g",
            )


def _turning(flight: Flight, aligned: AlignedFlight, settings: UsableSettings) -> Iterator[str]:
    """Texts on contradictions between attitude and gyroscope, with either of them delayed."""
    attitude, rates = aligned.motion.attitude, aligned.motion.rates
    if attitude is None or rates is None or not aligned.motion.rates_measured:
        return
    late = np.linspace(-settings.latest_s, settings.latest_s, 21)
    found = [agreement(attitude, rates, s) for s in late]
    same = [f for f in found if f is not None]
    if same and (max(same) < settings.same_motion or -min(same) > max(same)):
        yield (
            f"attitude and gyroscope do not turn together (correlation {max(same):.2f} at best): "
            f"check that q is [w, x, y, z], body to NED, and that both use forward-right-down axes"
        )


def _moving(flight: Flight, aligned: AlignedFlight, settings: UsableSettings) -> Iterator[str]:
    """Texts on contradictions between velocity and position."""
    if not flight.has(*POS) or not flight.has(*VEL):
        return
    position, velocity = (Signal(*flight.signal(c)) for c in (POS, VEL))
    moved = Signal(position.t_s, zero_phase(position, settings.slow_hz))
    a = Signal(moved.t_s, differentiate(moved)).at(aligned.inputs.t_s)
    b = Signal(velocity.t_s, zero_phase(velocity, settings.slow_hz)).at(aligned.inputs.t_s)
    known = np.all(np.isfinite(a) & np.isfinite(b), axis=1)
    for axis, x, y in zip("xyz", a[known].T, b[known].T, strict=True):
        if len(y) == 0 or np.sqrt(np.mean(y * y)) < settings.slowest_m_s:
            continue
        same = float(np.sum(x * y) / np.sqrt(np.sum(x * x) * np.sum(y * y) + 1e-30))
        if same < settings.same_motion:
            yield (
                f"vel_{axis} is not the rate of change of pos_{axis} (correlation {same:.2f}): "
                f"check that both are north-east-down"
            )


def _upward(flight: Flight, aligned: AlignedFlight, settings: UsableSettings) -> Iterator[str]:
    if not flight.has(*ACC):
        return
    down = Signal(*flight.signal(ACC)).at(aligned.inputs.t_s[aligned.airborne])[:, 2]
    mean = float(np.mean(down[np.isfinite(down)])) if np.isfinite(down).any() else 0.0
    if mean > 0:
        yield (
            f"acc_z is {mean:+.1f} m/s² on average in the air, forward-right-down axes read about "
            f"{-GRAVITY_M_S2:.1f}: check the axes"
        )
