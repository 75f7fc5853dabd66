"""Faults of sensors and state estimate, by disagreement with other instruments, and their onset.

By their `disagreements`; frozen or missing readings are detected on their own. Steps that the
estimator makes in its own output and reports are removed. No motor command is needed.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from ..formatting import number
from ..logs.autopilot import Reset
from ..logs.columns import ACC, GYRO, MAG
from ..logs.samples import stretches_where
from ..residuals.measured import Signal
from .consistency import (
    FALSE_IN_10_H,
    Change,
    FalseAlarmBudget,
    Residual,
    changed_at,
    smallest_detectable,
)
from .disagreements import (
    NOISE,
    RESIDUALS,
    SENSOR_CAUSES,
    STEPPED_BY,
    Signals,
    within,
    without_resets,
)
from .findings import Findings
from .flight import Airborne, FlightFrame
from .records import Amount, Candidate, Event, EvidenceSeries, NotVisible, Severity

Array = NDArray[np.float64]

CLEAR_S, LANDING_S = 1.0, 3.0
"""Times after take-off and before landing that are not used."""
TOGETHER_S = 1.0
"""Largest distance of onsets of one cause: the windows of residuals differ."""
FOLLOWS_S = 10.0
"""Settling time of an estimator after a jump or a wrong reading: EKF2 and EKF3 reset after 5 to 10
s of rejected measurements."""
AROUND_S = 8.0
"""Times before and after an onset that are drawn."""
MOST_POINTS = 240
"""Largest number of points of a drawn signal."""


SELF_EVIDENT = ("stuck_sensor", "sensor_dropout")
"""Causes that are visible in the reading itself, without another instrument."""
OF_ESTIMATE = ("attitude_estimate", "velocity_estimate", "position_estimate")
"""Causes that belong to the estimate, not to an instrument."""


def sensors(flight: FlightFrame, references: Sequence[FlightFrame] = ()) -> Findings:
    """Events of sensors and state estimate in the air, each relative to the flight's own past."""
    events: list[Event] = []
    hidden: dict[str, NotVisible] = {}
    for part in flight.airborne:
        residuals, found = part_events(flight, part)
        events += found
        hidden |= _hidden(residuals, _budget(residuals))
    sound = np.prod([1.0 - e.probability for e in events if not e.consequence])
    return Findings(events=events, not_visible=tuple(hidden.values()), nothing=float(sound))


def part_events(flight: FlightFrame, part: Airborne) -> tuple[list[Residual], list[Event]]:
    """Residuals of a part in the air, and its events."""
    start = float(flight.t_s[part.start]) + CLEAR_S
    end = float(flight.t_s[part.flown - 1]) - (LANDING_S if part.lost is None else 0.0)
    signals, autopilot = within(flight.flight, start, end), flight.flight.autopilot
    resets = () if autopilot is None else autopilot.resets
    residuals = [without_resets(r, resets) for make in RESIDUALS for r in make(signals)]
    budget = _budget(residuals)
    found = [c for r in residuals if (c := changed_at(r, budget)) is not None]
    standing = [*frozen(signals, budget), *missing(signals, end)]
    events = grouped([*map(_of_change, found), *standing])
    return residuals, [_then_reset(e, resets) for e in events]


def _then_reset(event: Event, resets: Sequence[Reset]) -> Event:
    """An error of the estimate, with the reset that ends it if the autopilot reports one."""
    if event.cause not in OF_ESTIMATE:
        return event
    of = STEPPED_BY[event.cause]
    late = [r for r in resets if r.of in of and 0.0 <= r.t_s - _onset(event) <= FOLLOWS_S]
    if not late:
        return event
    r = min(late, key=lambda r: r.t_s)
    text = f"{event.text}, then the estimator resets its {r.of} at {r.t_s:.2f} s"
    return replace(event, text=text)


def _budget(residuals: Sequence[Residual]) -> FalseAlarmBudget:
    return FalseAlarmBudget(FALSE_IN_10_H, max(len(residuals), 1))


def grouped(events: Sequence[Event]) -> list[Event]:
    """Each cause of a sensor once; consequences of another event are marked as such.

    Changes that begin within `TOGETHER_S` of the first have one cause: a frozen or missing reading
    is evident and comes first, then the most probable one. Changes that begin within `FOLLOWS_S`
    after that, or after its consequences, are consequences.
    """
    left = sorted(events, key=_onset)
    found: list[Event] = []
    while left:
        together = [e for e in left if _onset(e) - _onset(left[0]) <= TOGETHER_S]
        first = max(together, key=lambda e: (e.cause in SELF_EVIDENT, e.probability))
        follow = _chain(left, first)
        left = [e for e in left if e is not first and e not in follow]
        own = {(first.cause, first.sensor)}
        found.append(first)
        for e in follow:
            if (e.cause, e.sensor) not in own:
                own.add((e.cause, e.sensor))
                found.append(replace(e, consequence=True))
    return found


def _onset(event: Event) -> float:
    return -np.inf if event.onset_s is None else event.onset_s


def _chain(events: Sequence[Event], first: Event) -> list[Event]:
    """Events that begin shortly after the first, or after another one of the chain."""
    until, chain = max(_onset(events[0]), _onset(first)), []
    for e in events:
        if e is not first and _onset(e) - until <= FOLLOWS_S:
            until = max(until, _onset(e))
            chain.append(e)
    return chain


def _hidden(residuals: Sequence[Residual], budget: FalseAlarmBudget) -> dict[str, NotVisible]:
    """For each lasting cause, the smallest change that the worst axis or quantity would have shown,
    relative to the usual one."""
    least: dict[tuple[str, str, str], tuple[float, Residual]] = {}
    for r in residuals:
        key, size = (r.lasting, r.sensor, r.quantity), smallest_detectable(r, budget)
        if key not in least or size < least[key][0]:
            least[key] = size, r
    found: dict[str, NotVisible] = {}
    for size, r in sorted(least.values(), key=lambda x: x[0] / x[1].usual):
        if r.lasting not in OF_ESTIMATE:
            found[r.lasting] = _not_visible(r.lasting, size, r)
    return found


def _not_visible(cause: str, size: float, r: Residual) -> NotVisible:
    """A change that would not have been visible; of any size where no possible one would."""
    if not size <= r.largest:
        reason = "the instruments differ by more than any such change anyhow"
        if np.isinf(size):
            reason = "the flight is too short to know what is usual"
        amount = Amount(value=None, unit=r.unit)
        return NotVisible(cause=cause, smallest_detectable=amount, reason=reason)
    share = np.expm1(size) if cause == NOISE else size
    reason = "a smaller change is within what the instruments differ by anyhow"
    amount = Amount(value=float(share), unit=r.unit)
    return NotVisible(cause=cause, smallest_detectable=amount, reason=reason)


# -- as events ----------------------------------------------------------------------------------


def _of_change(change: Change) -> Event:
    r = change.residual
    quantity = "scale_change" if change.cause == r.scaled else r.quantity
    value, low, high = (_plain(r, v) for v in (change.size, change.low, change.high))
    return _event(
        change.cause,
        r.sensor,
        change.onset_s,
        Severity(quantity=quantity, value=value, low=low, high=high, unit=change.unit),
        change.probability,
        tuple(Candidate(cause=c, rotor=None, probability=p) for c, p in change.others),
        _drawn(change),
    )


def _plain(r: Residual, size: float) -> float:
    """A size in printed form: noise is a ratio, of which the residual is the logarithm."""
    return float(np.exp(size)) if r.quantity == "noise_ratio" else size


def _event(
    cause: str,
    sensor: str,
    onset_s: float,
    severity: Severity,
    probability: float,
    others: tuple[Candidate, ...] = (),
    evidence: tuple[EvidenceSeries, ...] = (),
) -> Event:
    about, size = SENSOR_CAUSES[cause], _size(severity)
    return Event(
        cause=cause,
        sensor=None if cause in OF_ESTIMATE else sensor,
        onset_s=onset_s,
        severity=severity,
        probability=probability,
        alternatives=others,
        text=about.text.format(sensor=sensor, size=size, t=f"{onset_s:.2f}"),
        bench_check=about.bench_check,
        evidence=evidence,
    )


def _size(severity: Severity) -> str:
    """A size in a sentence."""
    value = severity.value
    if severity.quantity == "noise_ratio":
        return f"{value:.1f} times"
    if severity.unit == "1":
        return f"{100 * value:.0f} %"
    return f"{number(value)} {severity.unit}"


def _drawn(change: Change) -> tuple[EvidenceSeries, ...]:
    """The reading with the prediction of the other instrument, and their difference."""
    r = change.residual
    near = np.abs(r.t_s - change.onset_s) <= AROUND_S
    near &= np.isfinite(r.difference) & np.isfinite(r.reading)
    rows = np.flatnonzero(near)[:: max(1, int(near.sum()) // MOST_POINTS)]
    t, apart = r.t_s[rows], r.difference[rows] - change.middle
    series = [(r.sensor, r.reading[rows], r.reading[rows] - apart)]
    series.append(("difference", apart, np.zeros(len(rows))))
    return tuple(
        EvidenceSeries(
            name=what,
            unit=r.unit,
            t_s=tuple(t.tolist()),
            measured=tuple(measured.tolist()),
            expected=tuple(expected.tolist()),
        )
        for what, measured, expected in series
    )


# -- readings that stand still, or are missing ---------------------------------------------------

_READINGS: Mapping[str, tuple[str, Sequence[str], float]] = {
    "gyro": ("gyroscope", GYRO, 0.3),
    "acc": ("accelerometer", ACC, 0.3),
    "mag": ("compass", MAG, 3.0),
    "baro": ("barometer", ("baro_pa",), 5.0),
}
"""Sensors that may freeze: words, columns, and the shortest time, s, of a frozen reading."""


def frozen(signals: Signals, budget: FalseAlarmBudget) -> Iterator[Event]:
    """Readings that are exactly constant for longer than chance repetition explains.

    The frequency of repeated readings is counted in the flight; a run of them is correspondingly
    rare. A reading constant at the largest magnitude of the flight is clipped, not frozen, and
    ignored, unless it is the only reading of the flight.
    """
    for name, (words, columns, least_s) in _READINGS.items():
        if name in signals:
            asked = np.flatnonzero(~_unknown(signals, name)).tolist()
            each = [(_standing(signals[name], k, least_s, budget), columns[k]) for k in asked]
            hits = [(s, c) for s, c in each if s is not None]
            if hits:
                (begin, long, p), column = min(hits)
                which = words if len(hits) == len(columns) else column
                yield _event("stuck_sensor", which, begin, _duration(long), p)


def _unknown(signals: Signals, name: str) -> NDArray[np.bool_]:
    """Axes, shape (k,), with a single reading that proves no fault: a recorder writes 0 for
    unmeasured signals, and without noise a body at rest has constant readings. Gyroscope and
    accelerometer that read 0 on all axes while the body rotates are at fault."""
    values = signals[name].values
    still = np.ptp(values, axis=0) == 0.0
    others = [signals[n].values for n in ("q", "gyro", "mag") if n != name and n in signals]
    if not any(np.ptp(v, axis=0).any() for v in others):
        return np.asarray(still)
    empty = still & (values[0] == 0.0)
    return np.asarray(empty & (name not in ("gyro", "acc") or not empty.all()))


def _standing(
    signal: Signal, k: int, least_s: float, budget: FalseAlarmBudget
) -> tuple[float, float, float] | None:
    """Start, length and probability of the first frozen stretch of a reading; None without one."""
    t, v = signal.t_s, signal.values[:, k]
    same, top = np.diff(v) == 0.0, np.abs(v).max() if np.ptp(v) > 0.0 else np.inf
    runs = stretches_where(same)
    within = sum(b - a for a, b in runs if t[b] - t[a] > least_s)
    repeats = max((same.sum() - within) / max(len(same) - within, 1), 0.2)
    for a, b in runs:
        chance, long = float(repeats ** (b - a)), float(t[b] - t[a])
        if long > least_s and abs(v[a]) < top and chance < budget.chance(1.0 / signal.rate_hz):
            return float(t[a]), long, budget.probability(chance, 1.0 / signal.rate_hz)
    return None


def missing(signals: Signals, end_s: float) -> Iterator[Event]:
    """Sensors without a sample for a second and twenty of their periods, while others have some."""
    for name, (words, _, _) in _READINGS.items():
        if name not in signals:
            continue
        t = np.append(signals[name].t_s, end_s)
        gap = np.diff(t)
        others = [s.t_s for other, s in signals.items() if other != name]
        for k in np.flatnonzero(gap > max(1.0, 20.0 * float(np.median(gap)))):
            inside = [((s > t[k] + 0.1) & (s < t[k + 1] - 0.1)).sum() for s in others]
            if max(inside, default=0) > 5:
                yield _event("sensor_dropout", words, float(t[k]), _duration(float(gap[k])), 0.99)
                break


def _duration(seconds: float) -> Severity:
    return Severity(quantity="duration", value=seconds, low=seconds, high=seconds, unit="s")
