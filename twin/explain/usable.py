"""Is a flight fit for a search at all? Reasons against it, in words, with the way out."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import LogError
from ..logs import Flight
from ..logs.columns import ACC, POS, VEL, motor_columns
from ..residuals.aligned import AlignedFlight, align_flight
from ..residuals.channels import GRID_HZ
from ..residuals.measured import Signal, agreement, differentiate, zero_phase
from ..vehicle import GRAVITY_M_S2, Vehicle
from .model.flight import channel_names
from .model.motion import FORCE, TORQUE
from .model.payload import Payloads, carrying
from .settings import DEFAULT, UsableSettings

Array = NDArray[np.float64]
_FELT = ("acc_", "gyro_rate_", *FORCE, *TORQUE)
"""What channels of force and torque begin with."""


def reasons_unusable(
    flight: Flight, vehicle: Vehicle, settings: UsableSettings = DEFAULT.usable
) -> list[str]:
    """Why nothing can be learnt from a flight about a vehicle; empty for a usable one.

    The vehicle is that which flew, a known mass aboard included.
    """
    try:
        aligned = align_flight(flight, vehicle, 1 / GRID_HZ)
    except LogError as error:
        return [str(error)]
    checks = (_too_short, _saturated, _fallen, _hit, _turning, _moving, _upward)
    return [
        f"{flight.name}: {reason}"
        for check in checks
        for reason in check(flight, aligned, settings)
    ]


def with_readings(
    flights: Sequence[Flight], vehicle: Vehicle, payloads: Payloads | None = None
) -> tuple[list[Flight], list[str]]:
    """Flights that have something to compare, and why the others have not.

    All flights of a search are compared in the channels that all have: one that shows nothing of
    force or torque would hide it in all.
    """
    kept: list[Flight] = []
    reasons: list[str] = []
    named: list[tuple[Flight, list[str]]] = []
    for flight in flights:
        try:
            named.append((flight, channel_names(flight, flown(flight, vehicle, payloads))))
        except LogError as error:
            reasons.append(str(error))
    told = [any(name.startswith(_FELT) for name in names) for _, names in named]
    for (flight, names), body in zip(named, told, strict=True):
        if not names:
            reasons.append(f"{flight.name}: no reading is known for long enough in the air")
        elif any(told) and not body:
            reasons.append(
                f"{flight.name}: neither accelerometer, gyroscope nor pose with attitude is known "
                f"for long enough in the air, as in other flights"
            )
        else:
            kept.append(flight)
    return kept, reasons


def flown(flight: Flight, vehicle: Vehicle, payloads: Payloads | None) -> Vehicle:
    """The vehicle of a flight, a known mass aboard included."""
    return carrying(vehicle, (payloads or {}).get(flight.name, 0.0))


def _too_short(flight: Flight, aligned: AlignedFlight, settings: UsableSettings) -> Iterator[str]:
    seconds = float(aligned.airborne.sum()) / GRID_HZ
    if seconds < settings.shortest_s:
        yield f"only {seconds:.1f} s in the air; at least {settings.shortest_s:g} s are needed"


def _saturated(flight: Flight, aligned: AlignedFlight, settings: UsableSettings) -> Iterator[str]:
    commands = motor_columns("cmd", sum(c.startswith("cmd_") for c in flight.table))
    if not commands or not flight.has(*commands):
        return
    values = Signal(*flight.signal(commands)).held(aligned.inputs.t_s[aligned.airborne])
    near = settings.at_limit
    at_limit = np.any((values <= near) | (values >= 1 - near), axis=1)
    if np.mean(at_limit) > settings.most_saturated:
        yield (
            f"a motor is at a limit for {100 * np.mean(at_limit):.0f} % of the time in the air: "
            f"commands no longer say what the motors do"
        )


def _fallen(flight: Flight, aligned: AlignedFlight, settings: UsableSettings) -> Iterator[str]:
    if aligned.motion.attitude is None:
        return
    t = aligned.inputs.t_s
    _, x, y, _ = aligned.motion.attitude.at(t).T
    upright = 1 - 2 * (x * x + y * y)  # cosine of the tilt
    over = aligned.airborne & (upright < 0)
    if np.sum(over) > settings.upside_down_s * GRID_HZ:
        yield f"upside down at {t[np.argmax(over)]:.1f} s: crashed, or aerobatics"
        return
    end = upright[np.isfinite(upright)][-round(GRID_HZ) :]
    if len(end) and np.median(end) < settings.tipped_cos:
        yield "lies on its side at the end of the record: crashed"


def _hit(flight: Flight, aligned: AlignedFlight, settings: UsableSettings) -> Iterator[str]:
    if not flight.has(*ACC):
        return
    signal = Signal(*flight.signal(ACC))
    force = np.linalg.norm(
        Signal(signal.t_s, zero_phase(signal, settings.impact_hz)).at(aligned.inputs.t_s), axis=1
    )
    hit = aligned.airborne & (force > settings.impact_m_s2)
    if hit.any():
        when, size = aligned.inputs.t_s[np.argmax(hit)], np.max(force[hit]) / GRAVITY_M_S2
        yield f"hits something at {when:.1f} s: {size:.0f} g"


def _turning(flight: Flight, aligned: AlignedFlight, settings: UsableSettings) -> Iterator[str]:
    """Attitude against gyroscope, with either of them late."""
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
    """Velocity against position."""
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
