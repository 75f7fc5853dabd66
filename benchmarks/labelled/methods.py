"""Methods that answer about one flight: rules of one line, two of others, and ours."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pyulog import ULog

from twin.logs import Flight
from twin.why.diagnose import NAMED, diagnose
from twin.why.flight import FlightFrame, lift, moment_signs
from twin.why.rules import RuleReading, highest_mean, parted_outputs

from .flights import NORMAL, class_of

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Answer:
    """What a method says of a flight.

    Attributes:
        label: A class, `NORMAL`, or "" where it cannot tell.
        rotors: Numbers from 1.
        onset_s: From the start of the log; None: none is said.
        probability: Of the answer; None: it knows none.
        or_else: A second class, of an answer "this or that".
        others: Events that are no class: of instruments, of the estimate, a force.
    """

    label: str
    rotors: frozenset[int] = frozenset()
    onset_s: float | None = None
    probability: float | None = None
    or_else: str = ""
    others: int = 0


@dataclass(frozen=True, slots=True)
class Asked:
    """A flight with all that a method may look at.

    Attributes:
        flight: As read.
        frame: On its grid.
        references: Normal flights of the same aircraft, on theirs.
        file: Where it was read from.
    """

    flight: Flight
    frame: FlightFrame
    references: Sequence[Flight]
    file: Path


Method = Callable[[Asked], Answer | None]
"""None: the method needs what the log lacks."""


def _of_rule(read: RuleReading | None) -> Answer:
    if read is None:
        return Answer(NORMAL)
    return Answer("rotor_failure", frozenset([read.rotor]), read.t_s)


def parted(asked: Asked) -> Answer | None:
    """Outputs part by 150 us after six seconds of flight: the highest failed."""
    return None if asked.frame.drive != "command" else _of_rule(parted_outputs(asked.frame))


def highest(asked: Asked) -> Answer | None:
    """The highest mean command is the weak rotor."""
    read = highest_mean(asked.frame)
    return None if read is None else Answer("propeller", frozenset([read.rotor]))


# -- recursive least squares ---------------------------------------------------------------------

FORGETS = 0.98
"""Forgetting factor per sample."""
PAST = 3
"""Samples of input and output by which the next output is predicted."""
WARM_S = 5.0
"""Of flight, before which nothing is reported: weights and thresholds settle."""
SIGMAS, IN_A_ROW = 20.0, 5
"""Threshold in running deviations of the error, and samples in a row beyond it: the best of ten
pairs on the very flights of the tables, which favours it."""


def recursive_least_squares(asked: Asked) -> Answer | None:
    """Prediction of roll, pitch and yaw rate from past ones and what the commands ask for.

    Source: Keipour, Mousaei & Scherer, Automatic real-time anomaly detection for autonomous aerial
    vehicles, ICRA 2019: weights by recursive least squares, an anomaly where the error of the
    prediction leaves its own running statistics. It detects and names nothing: the highest output
    at the detection is the failed rotor here, as in the rule above.
    """
    frame = asked.frame
    if frame.drive is None or frame.layout is None or "gyro" not in frame.grid:
        return None
    moments = lift(frame.grid[frame.drive]) @ moment_signs(frame.layout)[1:].T
    hits = []
    for part in frame.airborne:
        rows = slice(part.start, part.end)
        for j in range(3):
            k = _anomaly(frame.grid["gyro"][rows, j], moments[rows, j], frame.places(WARM_S))
            if k is not None:
                hits.append(part.start + k)
    if not hits:
        return Answer(NORMAL)
    first = min(hits)
    rotor = int(np.argmax(frame.grid[frame.drive][first])) + 1
    return Answer("rotor_failure", frozenset([rotor]), float(frame.t_s[first]))


def _anomaly(output: Array, asked: Array, warm: int) -> int | None:
    """First sample at which the error of the prediction leaves its statistics; None without one."""
    n = 2 * PAST + 1
    weights, P = np.zeros(n), 1e3 * np.eye(n)
    mean = variance = 0.0
    beyond = 0
    for k in range(PAST, len(output)):
        x = np.concatenate([output[k - PAST : k], asked[k - PAST : k], [1.0]])
        error = float(output[k] - weights @ x)
        gain = P @ x / (FORGETS + x @ P @ x)
        weights = weights + gain * error
        P = (P - np.outer(gain, x @ P)) / FORGETS
        off = abs(error - mean) > SIGMAS * np.sqrt(variance) + 1e-9
        beyond = beyond + 1 if off and k > warm else 0
        if beyond >= IN_A_ROW:
            return k - IN_A_ROW + 1
        share = max(1.0 / (k - PAST + 1), 1.0 - FORGETS)
        if not off or k <= warm:
            variance = (1 - share) * (variance + share * (error - mean) ** 2)
            mean += share * (error - mean)
    return None


# -- current of the motors -----------------------------------------------------------------------

SLOPE_A, OFFSET_A, LASTS_S = 35.0, 10.0, 1.0
"""MOTFAIL_C2T, MOTFAIL_LOW_OFF and _HIGH_OFF, MOTFAIL_TIME of PX4, as delivered."""


def motor_current(asked: Asked) -> Answer | None:
    """PX4's residual of the motor current: beyond slope times thrust by an offset, for a second.

    Source: PX4's parameters MOTFAIL_*. As `mfd_fit` of PX4 does, the slope is fitted to the flight;
    the offset is in the proportion to it of the parameters as delivered.
    """
    read = _currents(asked.file)
    command = asked.frame.signals.get("command")
    if read is None or command is None or not asked.frame.airborne:
        return None
    t, amps = read
    count = min(amps.shape[1], command.values.shape[1])
    thrust = lift(np.stack([np.interp(t, command.t_s, c) for c in command.values.T[:count]], 1))
    flown = np.zeros(len(t), dtype=bool)
    for part in asked.frame.airborne:
        flown |= (t >= asked.frame.t_s[part.start]) & (t <= asked.frame.t_s[part.end - 1])
    amps, thrust, t = amps[flown, :count], thrust[flown], t[flown]
    if len(t) < 10:
        return None
    slope = float(np.median(amps / np.maximum(thrust, 0.05)))
    off = np.abs(amps - slope * thrust) > slope * OFFSET_A / SLOPE_A
    hits = [(k, i) for i in range(count) if (k := _lasting(t, off[:, i])) is not None]
    if not hits:
        return Answer(NORMAL)
    k, i = min(hits)
    return Answer("rotor_failure", frozenset([i + 1]), float(t[k]))


def _currents(file: Path) -> tuple[Array, Array] | None:
    """Times from the start of a ULog, s, and current of each motor, A; None: not logged."""
    if file.suffix != ".ulg":
        return None
    log = ULog(str(file), ["esc_status"])
    for data in log.data_list:
        names = [f"esc[{i}].esc_current" for i in range(4)]
        if all(n in data.data for n in names):
            amps = np.column_stack([data.data[n] for n in names]).astype(np.float64)
            t = (data.data["timestamp"].astype(np.float64) - log.start_timestamp) * 1e-6
            return (t, amps) if amps.max() > 0 else None
    return None


def _lasting(t: Array, on: NDArray[np.bool_]) -> int | None:
    """First sample from which on it holds for `LASTS_S`."""
    begin: int | None = None
    for k, now in enumerate(on):
        begin = (k if begin is None else begin) if now else None
        if begin is not None and t[k] - t[begin] >= LASTS_S:
            return begin
    return None


# -- ours ----------------------------------------------------------------------------------------


def why(asked: Asked) -> Answer:
    """`uavtwin why`, with normal flights of the aircraft where the index has them."""
    found = diagnose(asked.flight, asked.references)
    causes = [e for e in found.events if not e.consequence and e.probability >= NAMED]
    others = sum(class_of(e.cause) == "other" for e in causes)
    if len(found.one_of_causes) == 2:
        first, second = sorted(found.one_of_causes, key=lambda c: -c.probability)
        rotors = frozenset(first.rotor or second.rotor or ())
        both = first.probability + second.probability
        return Answer(class_of(first.cause), rotors, None, both, class_of(second.cause), others)
    named = [e for e in found.events if class_of(e.cause) != "other"]
    if named and found.verdict == "found":
        best = max(named, key=lambda e: e.probability)
        rotors = frozenset(best.rotor or ())
        return Answer(class_of(best.cause), rotors, best.onset_s, best.probability, others=others)
    if found.verdict == "cannot_tell":
        return Answer("", others=others)
    return Answer(NORMAL, probability=found.probability, others=others)


METHODS: Mapping[str, Method] = {
    "outputs part by 150 µs": parted,
    "highest mean command": highest,
    "recursive least squares": recursive_least_squares,
    "motor current, PX4": motor_current,
    "uavtwin why": why,
}
"""By name, in the order of tables."""
