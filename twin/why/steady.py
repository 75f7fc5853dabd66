"""What is there during the whole flight: the balance of the rotors, tilt of the board, compass,
battery.

A rotor that has lost thrust, a load at a place and a centre of mass that moved ask the rotors for
more, each in its own pattern over thrust, roll, pitch and yaw. Against normal flights of the same
aircraft these patterns compete; without any, aircraft of one type differ by more than a weak rotor
does, which is all that symmetry tells.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr, logsumexp
from scipy.stats import norm

from ..formatting import number
from ..vehicle.layouts import Layout
from .findings import Findings
from .flight import FlightFrame, moment_signs, rotations
from .records import Amount, Candidate, Event, NotVisible, Severity

Array = NDArray[np.float64]

CALM_S = 3.0
"""Left out after take-off, and before landing."""
LEAST_S = 3.0
"""Of calm flight."""
HIGH = 0.75
"""Share of the usual height above which no ground carries."""
DAY_SD = np.array([0.03, 0.006, 0.006, 0.008])
"""Standard deviation between flights of one aircraft of thrust, roll, pitch and yaw in the mean
logarithm of the commands. Chosen on CrazyPAD's E9."""
FLEET_SD = (0.05, 0.14)
"""The same between sound aircraft, of roll or pitch and of yaw (6 to 14 %), in the recorded
flights."""
DAYS = 4.0
"""Flights that the table above is worth against those that are given."""
VOLTAGE_SLOPE, SLOPE_SD, VOLTAGE_SD = -1.0, 0.3, 0.01
"""Logarithm of the commands by that of the voltage, its deviation between aircraft, and scatter of
a flight about it."""
LOSS_SD, MASS_SD, MOVED_SD, ALL_SD = 0.10, 0.04, 0.02, 0.05
"""Half-normal deviations of a loss and of a load per rotor; normal ones of a centre of mass that
moved, and of all rotors alike. In the logarithm of the command. By judgement."""
PRIOR = {"nothing": 0.4, "rotor": 0.25, "rotors": 0.05, "load": 0.15, "centre": 0.05, "all": 0.1}
"""Of who asks: something is as probable as nothing."""
NAMED, ALONE = 0.5, 0.95
"""Probability from which on something is named, and from which on one cause is named alone; below,
the two that lead, of different kinds: only yaw parts a rotor from a load at its arm. Chosen on
CrazyPAD's E9."""
LEAN_RAD, LEAN_SD_RAD = np.radians(4.0), np.radians(1.5)
"""Lean of the specific force in calm hover from which on the board, or the rotors, are tilted, and
how sharp that is. By judgement; no clean flight reaches it."""
BOARD_RAD, WIND_RAD = np.radians(3.0), np.radians(5.0)
"""Priors: tilt of a board that is mounted by hand; lean by a wind of 3 m/s on an aircraft that
brakes by 0.3 m/s2 for each m/s. Without a turn of the aircraft a wind hides a tilt of the board."""
CALM_M_S, CALM_TILT_RAD = 1.5, np.radians(8.0)
"""Speed and tilt of a hover: faster, drag leans the specific force."""
FIELD, FIELD_SD = 0.25, 0.05
"""Spread of the field's strength, over its mean, from which on a compass is disturbed, and how
sharp that is. By judgement; clean flights reach 0.25 where the autopilot mistrusts its compass."""
SAG, SAG_SD = 0.15, 0.03
"""Share of the voltage that the current takes away, from which on a battery is weak, and how sharp
that is; clean flights: 6 % at most."""


def steady(flight: FlightFrame, references: Sequence[FlightFrame] = ()) -> Findings:
    """Findings without an onset."""
    found = [_balance(flight, references), _lean(flight), _compass(flight), _battery(flight)]
    return Findings(
        events=[e for f in found for e in f.events],
        one_of_causes=found[0].one_of_causes,
        not_visible=[v for f in found for v in f.not_visible],
        nothing=float(np.prod([f.nothing for f in found])),
        notes=[n for f in found for n in f.notes],
    )


# -- the balance --------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Balance:
    """Mean logarithm of the command of each rotor in calm flight, shape (rotors,), and of the
    voltage; NaN: not logged."""

    level: Array
    voltage: float


@dataclass(frozen=True, slots=True)
class Pattern:
    """A cause of a changed balance.

    Attributes:
        kind: Key of `PRIOR`.
        cause: Name.
        rotors: Numbers of its rotors from 1.
        log_evidence: With its prior.
        size: Posterior mean, in the logarithm of the command; of the largest rotor.
        sd: Its standard deviation.
    """

    kind: str
    cause: str
    rotors: tuple[int, ...]
    log_evidence: float
    size: float
    sd: float

    @property
    def kind_of_change(self) -> str:
        """Whether rotors changed, or what they carry."""
        return "rotors" if self.rotors else "load"


def balance_of(flight: FlightFrame) -> Balance | None:
    """Balance of a flight; None without commands, places of the rotors, or calm flight."""
    if flight.drive is None or flight.layout is None:
        return None
    calm = _calm(flight)
    if calm.sum() * flight.dt_s < LEAST_S:
        return None
    level = np.log(np.clip(flight.grid[flight.drive][calm], 0.02, None)).mean(axis=0)
    volts = flight.grid["vbat"][calm, 0].mean() if "vbat" in flight.grid else np.nan
    return Balance(level, float(np.log(volts)) if volts > 0 else np.nan)


def _calm(flight: FlightFrame) -> NDArray[np.bool_]:
    """Where it flies under control, high above the ground."""
    on = np.zeros(len(flight.t_s), dtype=bool)
    edge = flight.places(CALM_S)
    for part in flight.airborne:
        on[part.start + edge : max(part.flown - edge, 0)] = True
    if "pos" in flight.grid and on.any():
        height = -flight.grid["pos"][:, 2]
        ground = np.percentile(height, 2)
        on &= height > ground + HIGH * (np.percentile(height[on], 75) - ground)
    return on


def _balance(flight: FlightFrame, references: Sequence[FlightFrame]) -> Findings:
    now = balance_of(flight)
    if now is None or flight.layout is None:
        return Findings()
    normal = [b for b in map(balance_of, references) if b is not None]
    normal = [b for b in normal if len(b.level) == len(now.level)]
    if not normal:
        return _by_symmetry(now, flight.layout)
    patterns = patterns_of(now, normal, flight.layout)
    total = logsumexp([p.log_evidence for p in patterns])
    ranked = [(p, float(np.exp(p.log_evidence - total))) for p in patterns]
    nothing = next(q for p, q in ranked if p.kind == "nothing")
    named = sorted((x for x in ranked if x[0].kind != "nothing"), key=lambda x: -x[1])
    if nothing >= NAMED:
        return Findings(nothing=nothing)
    first, own = named[0]
    second, other = next(x for x in named if x[0].kind_of_change != first.kind_of_change)
    others = tuple(_candidate(p, q) for p, q in named[1:4])
    if own >= ALONE:
        return Findings(events=[_weak(first, own, others)], nothing=nothing)
    if own + other >= NAMED:
        both = _candidate(first, own), _candidate(second, other)
        return Findings(one_of_causes=both, nothing=nothing)
    return Findings(nothing=nothing, notes=["the balance of the rotors changed; no cause leads"])


def patterns_of(now: Balance, normal: Sequence[Balance], layout: Layout) -> list[Pattern]:
    """Causes of the change of a balance against normal flights: Gaussian evidence of each.

    The change y of the modes (thrust, roll, pitch, yaw) is S x + e, e of the scatter between days,
    which the normal flights refine (conjugate to `DAYS` of the table); x half-normal for a loss or
    a load, normal else.
    """
    modes = _modes(layout)
    every = np.array([b.level for b in normal])
    volts = np.array([b.voltage for b in normal])
    slope = _slope(every, volts) if np.isfinite([*volts, now.voltage]).all() else 0.0
    every = every - slope * np.nan_to_num(volts)[:, None]
    change = modes @ (now.level - slope * np.nan_to_num(now.voltage) - every.mean(axis=0))
    scatter = (every - every.mean(axis=0)) @ modes.T
    freedom = DAYS + len(every) - 1
    variance = (DAYS * DAY_SD**2 + (scatter**2).sum(axis=0)) / freedom * (1 + 1 / len(every))
    return list(_weighed(change, variance, modes, layout))


def _modes(layout: Layout) -> Array:
    """Thrust, roll, pitch and yaw of the logarithm of the commands, shape (4, rotors)."""
    signs = moment_signs(layout) * np.array([-1.0, 1.0, 1.0, 1.0])[:, None]
    return np.asarray(signs / np.abs(signs).max(axis=1, keepdims=True) / layout.count)


def _slope(levels: Array, volts: Array) -> float:
    """Logarithm of the commands by that of the voltage, with its prior."""
    worth = float(volts.std() ** 2 * len(volts) / VOLTAGE_SD**2) if len(volts) > 2 else 0.0
    seen = float(np.polyfit(volts, levels.mean(axis=1), 1)[0]) if worth > 0.3 else 0.0
    worth = worth if worth > 0.3 else 0.0
    prior = 1.0 / SLOPE_SD**2
    return (worth * seen + prior * VOLTAGE_SLOPE) / (worth + prior)


def _weighed(change: Array, variance: Array, modes: Array, layout: Layout) -> Iterator[Pattern]:
    n = layout.count

    def pattern(
        kind: str, cause: str, rotors: tuple[int, ...], slopes: Array, sd: Array, many: int
    ) -> Pattern:
        positive = kind in ("rotor", "rotors", "load")
        log, mean, spread = _evidence(change, variance, slopes, sd, positive)
        k = int(np.argmax(np.abs(mean))) if len(mean) else 0
        size, own = (float(mean[k]), float(spread[k])) if len(mean) else (0.0, 0.0)
        return Pattern(kind, cause, rotors, log + np.log(PRIOR[kind] / many), size, own)

    yield pattern("nothing", "", (), np.zeros((4, 0)), np.zeros(0), 1)
    for kind, count in (("rotor", 1), ("rotors", 2)):
        groups = list(combinations(range(n), count))
        for group in groups:
            numbers = tuple(i + 1 for i in group)
            sd = np.full(count, LOSS_SD)
            cause = "rotor_efficiency_loss"
            yield pattern(kind, cause, numbers, modes[:, list(group)], sd, len(groups))
    places = [p for p in product(np.linspace(-1.2, 1.2, 7), repeat=2) if any(p)]
    loads = [
        pattern("load", "payload_cg", (), _load(x, y, modes, layout), np.array([MASS_SD]), 1)
        for x, y in places
    ]
    best = max(loads, key=lambda p: p.log_evidence)
    log = float(logsumexp([p.log_evidence for p in loads])) - np.log(len(loads))
    yield Pattern("load", "payload_cg", (), log, best.size, best.sd)
    both = np.full(2, MOVED_SD)
    yield pattern("centre", "cog_offset", (), np.eye(4)[:, 1:3], both, 1)
    yield pattern("all", "mass_offset", (), np.eye(4)[:, :1], np.array([ALL_SD]), 1)


def _load(x: float, y: float, modes: Array, layout: Layout) -> Array:
    """Modes that a load at a place asks for, shape (4, 1): each rotor carries its share."""
    near = layout.position[:, :2] / np.abs(layout.position[:, :2]).max()
    carried = 1.0 + near @ np.array([x, y])
    asked = modes @ carried
    asked[3] = 0.0
    return np.asarray(asked[:, None])


def _evidence(
    change: Array, variance: Array, slopes: Array, sd: Array, positive: bool
) -> tuple[float, Array, Array]:
    """Log evidence of the modes, mean and deviation of the numbers; half-normal ones are positive:
    their share of the normal posterior, over that of the prior."""
    covariance = np.diag(variance) + (slopes * sd**2) @ slopes.T
    solved = np.linalg.solve(covariance, change)
    log = -0.5 * float(change @ solved) - 0.5 * float(np.linalg.slogdet(covariance)[1])
    mean = sd**2 * (slopes.T @ solved)
    inner = np.linalg.solve(covariance, slopes * sd**2)
    spread = np.sqrt(np.maximum(sd**2 - np.diag((slopes * sd**2).T @ inner), 1e-12))
    if positive:
        log += float(np.sum(log_ndtr(mean / spread) + np.log(2.0)))
    return log, mean, spread


def _candidate(pattern: Pattern, probability: float) -> Candidate:
    return Candidate(cause=pattern.cause, rotor=pattern.rotors or None, probability=probability)


def _weak(pattern: Pattern, probability: float, others: tuple[Candidate, ...]) -> Event:
    """The event of a balance that changed."""
    rotors = " and ".join(map(str, pattern.rotors))
    texts = {
        "rotor": f"Rotor {rotors} works harder than in normal flights",
        "rotors": f"Rotors {rotors} work harder than in normal flights",
        "load": "It carries a load that normal flights do not",
        "centre": "The centre of mass has moved since the normal flights",
        "all": "It is heavier than in normal flights, or all rotors give less",
    }
    checks = {
        "load": "Weigh the aircraft; look what was added, and where.",
        "centre": "Balance the aircraft on two fingers; look at the place of the battery.",
        "all": "Weigh the aircraft; look at the charge of the battery and all propellers.",
    }
    rotor = "Look for cuts and dirt on the propeller, and turn the motor by hand."
    size, wide = pattern.size, 1.645 * pattern.sd
    severity = Severity(
        quantity="command_share", value=size, low=size - wide, high=size + wide, unit="1"
    )
    return Event(
        cause=pattern.cause,
        rotor=pattern.rotors or None,
        severity=severity,
        probability=probability,
        alternatives=others,
        text=texts[pattern.kind],
        bench_check=checks.get(pattern.kind, rotor),
    )


def _by_symmetry(now: Balance, layout: Layout) -> Findings:
    """What the balance tells without normal flights: next to nothing, and how large it is."""
    share = np.exp(now.level - now.level.mean()) - 1.0
    most = int(np.argmax(share))
    turn, twist = FLEET_SD
    note = (
        f"rotor {most + 1} is asked for {number(100 * float(share[most]))} % more than the mean; "
        f"between sound aircraft of one type roll and pitch differ by {100 * turn:.0f} %, yaw by "
        f"{100 * twist:.0f} %: without normal flights (--reference) a weak rotor, a load and a "
        "centre of mass are not told apart"
    )
    hidden = NotVisible(
        cause="rotor_efficiency_loss",
        smallest_detectable=Amount(value=None, unit="1"),
        reason="aircraft of one type differ as much; give normal flights with --reference",
    )
    return Findings(notes=(note,), not_visible=(hidden,))


# -- board, compass, battery --------------------------------------------------------------------


def _lean(flight: FlightFrame) -> Findings:
    """Angle of the mean specific force in hover from the z axis of the board.

    Wind leans it as well, towards one side of the earth: only by turns is that told from a board
    that is tilted. The lean is the sum of one of the board and one of the earth, each with a prior.
    """
    if "acc" not in flight.grid or "vel" not in flight.grid or flight.tilt_rad is None:
        return Findings()
    slow = np.linalg.norm(flight.grid["vel"], axis=1) < CALM_M_S
    calm = _calm(flight) & slow & (flight.tilt_rad < CALM_TILT_RAD)
    if calm.sum() * flight.dt_s < 2 * LEAST_S:
        return Findings()
    lean, sd = _board(flight.grid["acc"][calm], rotations(flight.grid["q"][calm]), flight.dt_s)
    size = float(np.hypot(*lean))
    side = int(np.argmax(np.abs(lean)))
    where = (("forward", "back"), ("right", "left"))[side][int(lean[side] < 0)]
    return _beyond(
        "imu_tilt",
        size,
        LEAN_RAD,
        float(np.hypot(LEAN_SD_RAD, sd)),
        ("angle", "rad"),
        f"In hover the thrust leans {number(float(np.degrees(size)))} degrees {where} in the axes "
        "of the board: the board, or the rotors, are tilted",
        "Put a level on the frame and compare with the attitude that the ground station shows.",
    )


def _board(force: Array, R_nb: Array, dt_s: float) -> tuple[Array, float]:
    """Lean that turns with the board, forward and right, rad, and its standard deviation."""
    leans = force[:, :2] / np.maximum(-force[:, 2].mean(), 1e-9)
    yaw = np.arctan2(R_nb[:, 1, 0], R_nb[:, 0, 0])
    c, s, one = np.cos(yaw), np.sin(yaw), np.ones(len(yaw))
    rows = np.stack([[one, 0 * one, c, s], [0 * one, one, -s, c]]).transpose(2, 0, 1)
    worth = dt_s / CALM_S / float(np.var(leans - leans.mean(axis=0)) + 1e-6)
    precision = worth * np.einsum("nij,nik->jk", rows, rows)
    precision += np.diag(np.array([BOARD_RAD, BOARD_RAD, WIND_RAD, WIND_RAD]) ** -2.0)
    found = np.linalg.solve(precision, worth * np.einsum("nij,ni->j", rows, leans))
    covariance = np.linalg.inv(precision)
    return found[:2], float(np.sqrt(covariance[:2, :2].trace() / 2))


def _compass(flight: FlightFrame) -> Findings:
    """Spread of the strength of the field in flight."""
    calm = _calm(flight)
    if "mag" not in flight.grid or calm.sum() * flight.dt_s < 2 * LEAST_S:
        return Findings()
    strength = np.linalg.norm(flight.grid["mag"][calm], axis=1)
    if strength.mean() < 1e-6:
        return Findings()
    spread = float(strength.std() / strength.mean())
    return _beyond(
        "mag_disturbance",
        spread,
        FIELD,
        FIELD_SD,
        ("field_strength_spread", "1"),
        f"The strength of the field at the compass varies by {100 * spread:.0f} % in flight; that "
        "of the earth does not",
        "Move the compass away from power cables and steel, and calibrate it with motors running.",
    )


def _battery(flight: FlightFrame) -> Findings:
    """Share of the voltage that the current takes away, by a straight line through both."""
    calm = np.zeros(len(flight.t_s), dtype=bool)
    for part in flight.airborne:
        calm[part.start : part.flown] = True
    if not {"vbat", "ibat"} <= flight.grid.keys() or calm.sum() * flight.dt_s < 2 * LEAST_S:
        return Findings()
    volts, amps = flight.grid["vbat"][calm, 0], flight.grid["ibat"][calm, 0]
    if amps.std() < 0.02 * max(abs(float(amps.mean())), 1e-9):
        return Findings()
    columns = np.column_stack([amps, flight.t_s[calm], np.ones(len(amps))])
    ohm = -float(np.linalg.lstsq(columns, volts, rcond=None)[0][0])
    taken = ohm * float(np.percentile(amps, 90)) / float(volts.mean())
    found = _beyond(
        "battery_sag",
        taken,
        SAG,
        SAG_SD,
        ("voltage_taken", "1"),
        f"The battery loses {100 * taken:.0f} % of its voltage to its own resistance",
        "Measure the resistance of each cell; look at plugs and solder.",
    )
    size = f"{number(1e3 * ohm)} mOhm, with the wires"
    note = f"battery: {size}, take {100 * taken:.1f} % of its voltage"
    return found if found.events else Findings(nothing=found.nothing, notes=(note,))


def _beyond(
    cause: str,
    value: float,
    limit: float,
    sd: float,
    named: tuple[str, str],
    text: str,
    bench_check: str,
) -> Findings:
    """An event where a size is beyond what sound aircraft have."""
    probability = float(norm.cdf((value - limit) / sd))
    if probability < NAMED:
        return Findings(nothing=1.0 - probability)
    quantity, unit = named
    wide = 1.645 * sd
    severity = Severity(
        quantity=quantity, value=value, low=max(value - wide, 0.0), high=value + wide, unit=unit
    )
    event = Event(
        cause=cause,
        severity=severity,
        probability=probability,
        text=text,
        bench_check=bench_check,
    )
    return Findings(events=(event,), nothing=1.0 - probability)
