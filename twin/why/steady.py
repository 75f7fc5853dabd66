"""Lasting states of a whole flight: balance of the rotors, tilt of the board, compass, battery.

A rotor that has lost thrust, a load at a position and a shifted centre of mass increase commands,
each in its own pattern over thrust, roll, pitch and yaw. Relative to normal flights of the same
aircraft these patterns compete; without any, aircraft of one type differ by more than the effect of
a weak rotor, and symmetry is the only reference.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from ..formatting import number, percent
from .findings import Findings
from .flight import LEAST_COMMAND, FlightFrame, rotations
from .motion import misnumbered
from .records import Amount, Event, NotVisible, Severity

Array = NDArray[np.float64]

CALM_S = 3.0
"""Time after take-off, and before landing, that is not used."""
LEAST_S = 3.0
"""Shortest calm flight, s."""
HIGH = 0.75
"""Share of the usual height above which the ground has no effect."""
FLEET_SD = (0.05, 0.14)
"""Standard deviation between intact aircraft of roll or pitch, and of yaw (6 to 14 %), in the mean
logarithm of the commands of the recorded flights."""
NAMED = 0.5
"""Probability from which a cause is named."""
LEAN_RAD, LEAN_SD_RAD = np.radians(4.0), np.radians(1.5)
"""Lean of the specific force in calm hover from which the board, or the rotors, are tilted, and
width of that threshold. By judgement; no clean flight reaches it."""
BOARD_RAD, WIND_RAD = np.radians(3.0), np.radians(5.0)
"""Priors: tilt of a manually mounted board; lean by a wind of 3 m/s on an aircraft with drag of 0.3
m/s2 per m/s. Without a turn of the aircraft wind hides a tilt of the board."""
CALM_M_S, CALM_TILT_RAD = 1.5, np.radians(8.0)
"""Largest speed and tilt of a hover: faster, drag leans the specific force."""
FIELD, FIELD_SD = 0.25, 0.05
"""Spread of the field's strength, over its mean, from which a compass is disturbed, and width of
that threshold. By judgement; clean flights reach 0.25 where the autopilot rejects its compass."""
SAG, SAG_SD = 0.15, 0.03
"""Share of the voltage lost under load from which a battery is weak, and width of that threshold;
clean flights: 6 % at most."""


def steady(flight: FlightFrame, references: Sequence[FlightFrame] = ()) -> Findings:
    """Findings without an onset."""
    return joined_findings([_balance(flight, references), lasting(flight)])


def lasting(flight: FlightFrame, references: Sequence[FlightFrame] = ()) -> Findings:
    """Findings without an onset, except for the balance of the rotors."""
    return joined_findings([_lean(flight), _compass(flight), _battery(flight)])


def joined_findings(found: Sequence[Findings]) -> Findings:
    """Findings of several finders as one."""
    return Findings(
        events=[e for f in found for e in f.events],
        one_of_causes=next((f.one_of_causes for f in found if f.one_of_causes), ()),
        not_visible=[v for f in found for v in f.not_visible],
        nothing=float(np.prod([f.nothing for f in found])),
        notes=[n for f in found for n in f.notes],
        undecided=any(f.undecided for f in found),
    )


# -- the balance --------------------------------------------------------------------------------


def _calm(flight: FlightFrame) -> NDArray[np.bool_]:
    """Mask of controlled flight, high above the ground."""
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
    """Balance relative to normal flights where there are some, else to symmetry; none where the
    motor numbers are unknown."""
    calm = _calm(flight)
    if flight.drive is None or flight.layout is None or calm.sum() * flight.dt_s < LEAST_S:
        return Findings()
    if {"gyro", "acc"} <= flight.grid.keys() and misnumbered(flight):
        return Findings()
    normal = [(r, _calm(r)) for r in references]
    short = [r.flight.name for r, on in normal if r.drive is None or on.sum() * r.dt_s < LEAST_S]
    left_out = [
        f"normal flight {name} is not used: it has less than {LEAST_S:g} s of calm flight with "
        "motor commands"
        for name in short
    ]
    found = None
    if references:
        from .balance import changed  # imports `explain`, half a second

        found = changed(flight, calm, normal)
    if found is None:
        found = _by_symmetry(flight.grid[flight.drive][calm])
    return joined_findings([Findings(notes=left_out), found])


def _by_symmetry(command: Array) -> Findings:
    """Balance without normal flights: hardly informative, with the size of the asymmetry."""
    level = np.log(np.clip(command, LEAST_COMMAND, None)).mean(axis=0)
    share = np.exp(level - level.mean()) - 1.0
    most = int(np.argmax(share))
    turn, twist = FLEET_SD
    note = (
        f"rotor {most + 1} is asked for {percent(float(share[most]))} more than the mean; "
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

    Wind leans it as well, in one direction relative to the Earth: only turns separate it from a
    tilted board. The lean is the sum of one fixed to the board and one fixed to the Earth, each
    with a prior.
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
    """Lean fixed to the board, forward and right, rad, and its standard deviation."""
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
    """Share of the voltage lost under load, by a straight line of voltage over current."""
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
    """An event where a size exceeds that of intact aircraft."""
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
