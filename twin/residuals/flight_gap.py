"""The gap between a flight and its twin: teacher-forced, over short horizons, and in hover.

Teacher-forced: the twin's equations at the measured state, see `channels`. Short horizon: the twin
restarted from the measured state every horizon, compared at the end of each window.

The hover diagnosis, which all verbs print, consists of thrust level, centre of mass, thrust axis,
split of the motors, and a single weak rotor. In a hover forces and moments balance on average, so
the means of measured and simulated specific force and angular acceleration over it give, at the
commands of the flight,

| quantity | from |
|---|---|
| thrust of the twin over that of the flight | mean acc_z of both |
| centre of mass relative to that of the file | mean moments about pitch and roll, over the weight |
| thrust axis relative to -z of the body | mean residual of acc_x and acc_y, over mean acc_z |
| a single weak rotor in place of another centre of mass | the rotor in the direction of the shift |

The last two quantities from moments are one measurement: one hover cannot separate them. Standard
errors are those of means over blocks of one second.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..draft.hover import LEAST_S, LONGEST_STEP_S, Hover, hover_of
from ..errors import LogError
from ..frames import AXES, rotation_vector
from ..logs import AnyFlight
from ..logs.airframe import origin_of
from ..logs.columns import ACC, GYRO, POS, QUAT, VEL
from ..logs.samples import stretches_where
from ..representation import ShortRepr
from ..vehicle import Vehicle
from .aligned import BLOCK_ROWS, AlignedFlight, Alignment, Block, align_flight
from .channels import GRID_HZ, OF_IMU, SHORTEST_S, imu_channels
from .gap import Channel, FlightGap, weighs
from .measured import LONGEST_GAP_INTERVALS, LONGEST_GAP_S
from .short_horizon import READ, window_ends, window_starts
from .teacher_forced import GRID_S, driven_by

Array = NDArray[np.float64]
_BLOCK_S, _FEWEST_BLOCKS = 1.0, 2
"""Length of a block, s, longer than the correlation of residuals; smallest number of blocks for a
standard error. Made up."""
SURE = 2.0
"""Standard errors from which a value of the diagnosis differs from zero."""


@dataclass(frozen=True, slots=True)
class Mean:
    """A mean over a hover.

    Attributes:
        value: Value in its unit.
        sd: Standard error of the mean.
    """

    value: float
    sd: float

    @property
    def clear(self) -> bool:
        """Whether the mean differs from zero."""
        return abs(self.value) > SURE * self.sd


@dataclass(frozen=True, slots=True)
class WeakRotor:
    """A single rotor with less thrust than the others, as an alternative to another centre of mass.

    Attributes:
        rotor: Number of the rotor, from 1.
        loss: Lost share of its thrust.
    """

    rotor: int
    loss: Mean


@dataclass(frozen=True, slots=True)
class HoverDiagnosis(ShortRepr):
    """Comparison of a twin with a hover, at the motor commands of the flight.

    Attributes:
        flight: Name of the flight.
        where: Part of the flight, in words.
        seconds: Duration.
        carried: Thrust of the twin over that of the flight: 1 where it carries its weight.
        back_m: Backward shift of the centre of mass from that in the file for which the mean
            moments about pitch vanish, m; None: no body rates.
        right_m: Shift to the right, from the moments about roll, m.
        lean_forward_rad: Forward tilt of the flight's thrust relative to that of the twin, rad: of
            the rotors, or of the board with the accelerometer; None: unknown.
        lean_right_rad: Tilt to the right, rad.
        split: Command of each motor, else its speed, over the mean of all, less one.
        weakest: The rotor whose loss of thrust has the same effect as the shift of the centre of
            mass, if there is one.
    """

    flight: str
    where: str
    seconds: float
    carried: Mean
    back_m: Mean | None
    right_m: Mean | None
    lean_forward_rad: Mean | None
    lean_right_rad: Mean | None
    split: tuple[float, ...]
    weakest: WeakRotor | None


def diagnose(
    channels: Sequence[Channel], vehicle: Vehicle, hover: Hover | None
) -> HoverDiagnosis | None:
    """Diagnosis of a twin in hover.

    Args:
        channels: Teacher-forced channels of the flight; specific force along z is necessary.
        vehicle: Vehicle of the twin.
        hover: Hover of the flight, from `hover_of`.

    Returns:
        None: the flight does not hover, or has less than 2 s of plausible specific force along z
            there.
    """
    if hover is None or not hover.hovers:
        return None
    named = {c.name: c for c in channels if c.horizon_s == 0}
    lift = _both(named.get(ACC[2]), hover)
    if lift is None:
        return None
    t_s, measured, simulated = lift
    down, twin_down = float(measured.mean()), float(simulated.mean())
    if not weighs(down):
        return None
    ratio = twin_down / down
    carried = Mean(ratio, _standard_error(t_s, (simulated - ratio * measured) / down))
    arms = [_arm(named.get(n), hover, vehicle, axis, carried, down) for n, axis in _TURNS]
    leans = [_lean(named.get(name), hover, down) for name in ACC[:2]]
    back, right = arms
    return HoverDiagnosis(
        hover.flight,
        hover.where,
        hover.seconds,
        carried,
        back,
        right,
        leans[0],
        leans[1],
        hover.split,
        _weakest(vehicle, back, right),
    )


_TURNS = (("gyro_rate_y", 1), ("gyro_rate_x", 0))
"""Channel of the moment about an axis, and the axis of its lever arm."""


def _both(channel: Channel | None, hover: Hover) -> tuple[Array, Array, Array] | None:
    """Times, shape (n,), measured and simulated values of a channel in hover; None: no such
    channel, or less than 2 s of it."""
    if channel is None or len(channel.t_s) < 2:
        return None
    near = np.clip(np.searchsorted(hover.t_s, channel.t_s), 1, len(hover.t_s) - 1)
    apart = np.abs(channel.t_s[:, None] - hover.t_s[np.stack([near - 1, near], axis=1)]).min(axis=1)
    rows = (apart <= LONGEST_STEP_S) & np.isfinite(channel.residual)
    if np.count_nonzero(rows) * float(np.median(np.diff(channel.t_s))) < LEAST_S:
        return None
    return channel.t_s[rows], channel.measured[rows], channel.simulated[rows]


def _standard_error(t_s: Array, values: Array) -> float:
    """Standard error of a mean, from means over blocks of one second; from the values where there
    are too few blocks."""
    _, block = np.unique(np.floor(t_s / _BLOCK_S), return_inverse=True)
    count = np.bincount(block)
    means = np.bincount(block, values) / count
    full = means[count >= 0.5 * count.max()]
    if len(full) < _FEWEST_BLOCKS:
        return math.inf
    return float(full.std(ddof=1) / math.sqrt(len(full)))


def _arm(
    channel: Channel | None,
    hover: Hover,
    vehicle: Vehicle,
    axis: int,
    carried: Mean,
    down: float,
) -> Mean | None:
    """Mean residual moment about an axis over the weight, m."""
    turned = _both(channel, hover)
    if turned is None:
        return None
    t_s, measured, simulated = turned
    per_turn = float(vehicle.inertia_kg_m2[axis, axis]) / (-down * vehicle.mass_kg)
    missing = per_turn * (measured - simulated / carried.value)
    return Mean(float(missing.mean()), _standard_error(t_s, missing))


def _lean(channel: Channel | None, hover: Hover, down: float) -> Mean | None:
    """Angle between the flight's thrust and that of the twin along an axis, rad."""
    pushed = _both(channel, hover)
    if pushed is None:
        return None
    t_s, measured, simulated = pushed
    angle = (measured - simulated) / -down
    return Mean(float(angle.mean()), _standard_error(t_s, angle))


def _weakest(vehicle: Vehicle, back: Mean | None, right: Mean | None) -> WeakRotor | None:
    """The rotor in the direction of the apparent centre of mass; None where the shift is not
    significant, or in the direction of no rotor within its standard error.

    A rotor at p that has lost the share l of its thrust gets a higher command; the twin, without
    that loss, then has the moment of a centre of mass shifted by the share r = l / (n - (n - 1) l)
    of p, for n rotors.
    """
    if back is None or right is None or not (back.clear or right.clear):
        return None
    place = np.array([-back.value, right.value])
    sd = np.array([back.sd, right.sd])
    centre = vehicle.rotors.position_m[:, :2].mean(axis=0)
    rotors = vehicle.rotors.position_m[:, :2] - centre
    reach = rotors @ place / np.sum(rotors**2, axis=1)
    rotor = int(np.argmax(reach))
    unit = rotors[rotor] / np.linalg.norm(rotors[rotor])
    across = np.array([-unit[1], unit[0]])
    if abs(across @ place) > SURE * float(np.linalg.norm(across * sd)):
        return None
    count, share = len(rotors), float(reach[rotor])
    thrust = 1 + (count - 1) * share
    sd_share = float(np.linalg.norm(unit * sd)) / float(np.linalg.norm(rotors[rotor]))
    return WeakRotor(rotor + 1, Mean(count * share / thrust, count * sd_share / thrust**2))


DEFAULT_HORIZON_S = 0.5
"""Short horizon, s: residuals grow to centimetres and do not diverge yet. Made up."""


def flight_gap(
    flight: AnyFlight,
    vehicle: Vehicle,
    horizon_s: float = DEFAULT_HORIZON_S,
    progress: Callable[[float], None] = lambda _: None,
    block_rows: int = BLOCK_ROWS,
) -> FlightGap:
    """Residuals of one flight against one vehicle.

    Args:
        flight: Flight from `twin.logs.read_flight`, or `twin.logs.open_flight` for one that stays
            in its file.
        vehicle: Vehicle from `twin.vehicle_file.load_vehicle`.
        horizon_s: Short horizon; a multiple of 1 ms, at least 10 ms.
        progress: Called with the completed share, 0..1.
        block_rows: Number of milliseconds in memory at a time; the result does not depend on it.

    Raises:
        LogError: The flight cannot be compared with this vehicle.
    """
    if not 0.01 <= horizon_s < np.inf or abs(horizon_s / GRID_S - round(horizon_s / GRID_S)) > 1e-6:
        raise LogError(f"horizon {horizon_s:g} s: needs a multiple of 1 ms of at least 10 ms.")
    # the coarse grid is freed before the fine one is built: both together need more memory
    alignment = Alignment(flight, vehicle)
    kinds, why = comparable(flight)
    if not kinds:
        raise LogError(f"{flight.name}: {why}.")
    channels = imu_channels(
        flight, vehicle, align_flight(flight, vehicle, 1 / GRID_HZ, motion=alignment.motion)
    )
    progress(0.2)
    short, notes = _short_horizon(
        alignment, horizon_s, block_rows, lambda done: progress(0.2 + 0.8 * done)
    )
    warnings = [f"{f.where}: {f.message}" for f in flight.findings if f.severity != "info"]
    progress(1.0)
    return FlightGap(
        flight=flight.name,
        vehicle=vehicle.name,
        channels=tuple(channels + short),
        phases=alignment.spans(),
        warnings=tuple([*alignment.notes, *notes, *warnings]),
        facts=dict(flight.facts),
        hover=diagnose(channels, vehicle, hover_of(flight)),
        origin=origin_of(flight.airframe),
        driven_by=driven_by(flight, vehicle),
    )


def comparable(flight: AnyFlight) -> tuple[tuple[str, ...], str]:
    """Kinds of residuals for which a flight has the samples, whatever the vehicle, in words; and
    the reason where there are none.

    These are the conditions of `flight_gap` on a flight, independent of its vehicle. Teacher-forced
    residuals need an accelerometer or a gyroscope for `SHORTEST_S` off the ground without a gap,
    the short horizon needs attitude and velocity or position for one horizon.
    """
    known = {
        name: _longest_s(flight, columns)
        for name, columns in (
            *((s.signal, s.columns) for s in OF_IMU),
            ("q", QUAT),
            ("vel", VEL),
            ("pos", POS),
        )
        if flight.has(*columns)
    }
    kinds = []
    if forced := [name for s in OF_IMU if known.get(name := s.signal, 0.0) >= SHORTEST_S]:
        kinds.append(f"teacher-forced: {' and '.join(forced)}")
    moving = max(known.get("vel", 0.0), known.get("pos", 0.0))
    if min(known.get("q", 0.0), moving) > DEFAULT_HORIZON_S:
        kinds.append("at a short horizon: attitude, rates, velocity")
    if kinds:
        return tuple(kinds), ""
    if not known:
        return (), "no acc, gyro or q with vel or pos"
    codes, names = flight.phase_codes
    if np.all(names[codes] == "ground"):
        return (), "never airborne: the whole flight is in phase ground"
    parts = ", ".join(f"{name} {seconds:.2g} s" for name, seconds in known.items())
    return (), (
        f"too short: longest stretch off the ground without a gap: {parts}; acc or gyro is needed "
        f"for {SHORTEST_S:g} s, or q with vel or pos for {DEFAULT_HORIZON_S:g} s"
    )


def _longest_s(flight: AnyFlight, columns: Sequence[str]) -> float:
    """The longest time off the ground without a gap in a signal, s."""
    t_s = flight.signal(columns)[0]
    if len(t_s) < 2:
        return 0.0
    codes, names = flight.phase_codes
    grounded = (names == "ground")[codes[np.searchsorted(flight.time_s, t_s)]]
    steps = np.diff(t_s)
    usual_s = float(np.median(steps))
    longest_s = min(LONGEST_GAP_INTERVALS * usual_s, max(LONGEST_GAP_S, 1.5 * usual_s))
    whole = (steps <= longest_s) & ~grounded[1:] & ~grounded[:-1]
    lengths = [t_s[b] - t_s[a] for a, b in stretches_where(whole)]
    return float(max(lengths, default=0.0))


def diagnosis_of(
    flight: AnyFlight, vehicle: Vehicle, hover: Hover | None = None
) -> HoverDiagnosis | None:
    """Diagnosis of a twin in the hover of a flight, without the rest of the gap.

    Args:
        flight: Flight as read.
        vehicle: Vehicle of the twin.
        hover: Hover of the flight, where it is known already.

    Raises:
        LogError: The flight cannot be compared with this vehicle.
    """
    hover = hover or hover_of(flight)
    if hover is None or not hover.hovers:
        return None
    aligned = align_flight(flight, vehicle, 1 / GRID_HZ)
    return diagnose(imu_channels(flight, vehicle, aligned), vehicle, hover)


def _short_horizon(
    alignment: Alignment, horizon_s: float, block_rows: int, progress: Callable[[float], None]
) -> tuple[list[Channel], list[str]]:
    """Channels at the ends of all windows, and notes on them.

    The blocks of the flight are processed twice: its times in the air are known only at its end.
    """
    known = np.zeros(alignment.rows, dtype=np.bool_)
    first: list[Block] = []  # stored if it is the only one

    def noted() -> Iterator[Block]:
        """All blocks, with their known data recorded."""
        edges = alignment.edges(block_rows)
        for block in alignment.blocks(edges):
            known[block.first : block.end] = np.all(np.isfinite(block.states), axis=1)
            if len(edges) == 2:
                first.append(block)
            yield block
            progress(0.4 * block.end / alignment.rows)

    airborne = alignment.airborne(noted())
    notes = alignment.left_out(airborne)
    motion = alignment.motion
    if not motion.restarts:
        return [], [
            *notes,
            "no short-horizon residuals: they need attitude, velocity and body rates",
        ]
    steps = round(horizon_s / GRID_S)
    starts = window_starts(airborne & known, steps)
    if not len(starts):
        why = f"no stretch of {horizon_s:g} s of measured flight for short-horizon residuals"
        return [], [*notes, why]
    parts = []
    edges = [0, *_cuts(starts, steps, block_rows), alignment.rows]
    blocks = first if len(edges) == len(first) + 1 else alignment.blocks(edges)
    before: Block | None = None
    for block in blocks:
        whole = block if before is None else _joined(before, block)
        rows = slice(whole.first, whole.end)
        aligned = alignment.piece(whole, airborne[rows], alignment.phases(rows.start, rows.stop))
        here = starts[(starts >= rows.start) & (starts + steps < rows.stop)] - rows.start
        if len(here):
            predicted = window_ends(aligned, here, steps, tail=0)[:, 0]
            parts.append(end_channels(aligned, here + steps, predicted, horizon_s))
        before = _tail(block)
        progress(0.4 + 0.6 * rows.stop / alignment.rows)
    return [_chained(same) for same in zip(*parts, strict=True)], notes


def _cuts(starts: NDArray[np.intp], steps: int, block_rows: int) -> list[int]:
    """First rows of blocks: at ends of windows, about the given number of rows apart where windows
    are shorter."""
    cuts: list[int] = []
    since = 0
    for end in (starts + steps + 1).tolist():
        if end - since >= block_rows and end <= int(starts[-1]) + steps:
            cuts.append(end)
            since = end
    return cuts


def _tail(block: Block) -> Block:
    """The last row of a block: the next window begins at the end of the previous one."""
    u, rotors = block.inputs.u[-1:].copy(), block.inputs.rotor_states[-1:].copy()
    inputs = replace(block.inputs, t_s=block.inputs.t_s[-1:], u=u, rotor_states=rotors)
    return Block(block.end - 1, inputs, block.states[-1:].copy())


def _joined(before: Block, block: Block) -> Block:
    """Two consecutive blocks as one."""
    a, b = before.inputs, block.inputs
    inputs = replace(
        b,
        t_s=np.concatenate([a.t_s, b.t_s]),
        u=np.vstack([a.u, b.u]),
        rotor_states=np.vstack([a.rotor_states, b.rotor_states]),
    )
    return Block(before.first, inputs, np.vstack([before.states, block.states]))


def _chained(parts: Sequence[Channel]) -> Channel:
    """The channel of consecutive spans of time as one."""
    if len(parts) == 1:
        return parts[0]
    return replace(
        parts[0],
        t_s=np.concatenate([c.t_s for c in parts]),
        measured=np.concatenate([c.measured for c in parts]),
        simulated=np.concatenate([c.simulated for c in parts]),
        phase=np.concatenate([c.phase for c in parts]),
    )


def end_channels(
    aligned: AlignedFlight, ends: NDArray[np.intp], predicted: Array, horizon_s: float
) -> list[Channel]:
    """Channels of the short horizon: position, velocity, attitude and gyroscope.

    Attitude is compared relative to the level attitude with heading north, in body axes.

    Args:
        aligned: Flight on the grid of its twin.
        ends: Grid points at which the windows end, shape (w,).
        predicted: Predicted values of `short_horizon.READ` there, shape (w, 13).
        horizon_s: Length of the windows.
    """
    t, phase = aligned.inputs.t_s[ends], aligned.phases[ends]
    states = [s.name for s in aligned.airframe.states]

    def measured(names: Sequence[str]) -> Array:
        columns = np.array([states.index(n) for n in names], dtype=np.intp)
        return aligned.states[np.ix_(ends, columns)]

    def simulated(names: Sequence[str]) -> Array:
        return predicted[:, [READ.index(n) for n in names]]

    level = np.zeros((len(ends), 4))
    level[:, 0] = 1.0
    attitude = rotation_vector(measured(QUAT), level)
    turned = rotation_vector(measured(QUAT), simulated(QUAT))
    groups = [
        (VEL, "m/s", measured(VEL), simulated(VEL)),
        (tuple(f"att_{a}" for a in AXES), "rad", attitude, attitude - turned),
        (GYRO, "rad/s", measured([f"omega_{a}" for a in AXES]), simulated(GYRO)),
    ]
    if aligned.motion.position is not None:
        groups.insert(0, (POS, "m", measured(POS), simulated(POS)))
    return [
        Channel(name, unit, horizon_s, t, flown[:, i], twin[:, i], phase)
        for names, unit, flown, twin in groups
        for i, name in enumerate(names)
    ]
