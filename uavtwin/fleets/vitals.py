"""Numbers of one flight that tell how an aircraft does: battery, rotors, sensors."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from twin.draft import Hover
from twin.logs import AnyFlight
from twin.logs.columns import GYRO, QUAT
from twin.residuals.hover import HoverDiagnosis

from .columns import MOTORS

Array = NDArray[np.float64]
LEAST_S = 5.0
"""Flight of which a battery or a gyroscope is told."""
LEAST_A = 0.02
"""Share of its mean by which a current has to vary."""
LEAST_V = 1.0
"""Below it no battery is connected."""
WINDOW_S = 0.5
"""Over which the attitude turns, for the bias of the gyroscope: noise of an attitude of 1 mrad is
3 mrad/s in one window, and little in the median of all."""


def vitals_of(
    flight: AnyFlight, hover: Hover | None, diagnosis: HoverDiagnosis | None
) -> dict[str, float | None]:
    """All that are told, by the names of their columns.

    Args:
        flight: As read.
        hover: Its hover; None: it has none.
        diagnosis: Of the twin in it; None: none.
    """
    told: dict[str, float | None] = {"battery_resistance_ohm": battery_resistance(flight)}
    bias = gyro_bias(flight)
    if bias is not None:
        told |= {f"gyro_bias_{a}_rad_s": float(b) for a, b in zip("xyz", bias, strict=True)}
    if diagnosis is not None:
        back, right = diagnosis.back_m, diagnosis.right_m
        told |= {
            "carried": diagnosis.carried.value,
            "back_m": None if back is None else back.value,
            "right_m": None if right is None else right.value,
        }
    return told | ({} if hover is None else _of_hover(hover))


def _of_hover(hover: Hover) -> dict[str, float | None]:
    told: dict[str, float | None] = {}
    if hover.cmd is not None:
        told["hover_command"] = hover.level
    if hover.rotor_rad_s is not None:
        told["hover_speed_rad_s"] = float(np.median(hover.rotor_rad_s.mean(axis=1)))
    if hover.voltage_v is not None:
        told["hover_voltage_v"] = float(np.median(hover.voltage_v))
    return told | {f"motor_{i}": s for i, s in enumerate(hover.split[:MOTORS], start=1)}


def battery_resistance(flight: AnyFlight) -> float | None:
    """Resistance of a battery, ohm: least squares of V = a + b t - R I over a flight.

    What a fall of the voltage within seconds of a change of the current adds to the resistance of
    the first instant is in it; what the charge takes, which is slow, is in b.

    Returns:
        None: voltage or current are not logged, or the current does not vary.

    Valid for: one flight on one battery.
    """
    if not flight.has("vbat_v", "ibat_a"):
        return None
    t_v, volts = (x.ravel() for x in flight.signal(("vbat_v",)))
    t_i, amps = (x.ravel() for x in flight.signal(("ibat_a",)))
    inside = (t_v >= t_i[0]) & (t_v <= t_i[-1]) & (volts > LEAST_V)
    t, v = t_v[inside], volts[inside]
    if len(t) < 20 or t[-1] - t[0] < LEAST_S:
        return None
    i = np.interp(t, t_i, amps)
    flying = i > 0.3 * np.percentile(i, 90)
    t, v, i = t[flying], v[flying], i[flying]
    if len(t) < 20 or np.std(i) < LEAST_A * abs(np.mean(i)):
        return None
    a = np.column_stack([np.ones_like(t), t - t.mean(), -i])
    return float(np.linalg.lstsq(a, v, rcond=None)[0][2])


def gyro_bias(flight: AnyFlight) -> Array | None:
    """Bias of a gyroscope, rad/s, body FRD, shape (3,): its mean over windows of half a second
    minus the rate at which the attitude turns over each, the median of all.

    Turns about an axis that moves itself are counted to second order: the angle of a window is
    a + 1/2 int (a(t) x da), a the integral of the rates from its begin on.

    Source: Bortz, IEEE Trans. Aerosp. Electron. Syst. 7 (1971) 61-66.

    Returns:
        None: no attitude, no gyroscope, or too short.
    """
    if not flight.has(*GYRO, *QUAT):
        return None
    t_w, omega = flight.signal(GYRO)
    t_q, q = flight.signal(QUAT)
    edges = np.arange(max(t_q[0], t_w[0]), min(t_q[-1], t_w[-1]), WINDOW_S)
    if len(edges) * WINDOW_S < LEAST_S:
        return None
    at = np.unique(np.clip(np.searchsorted(t_q, edges), 0, len(t_q) - 1))
    t = t_q[at]
    turned = Rotation.from_quat(q[at], scalar_first=True)
    rate = (turned[:-1].inv() * turned[1:]).as_rotvec() / np.diff(t)[:, None]
    steps = np.diff(t_w)[:, None]
    angle = np.vstack([np.zeros(3), np.cumsum(0.5 * (omega[1:] + omega[:-1]) * steps, axis=0)])
    twist = np.cross(0.5 * (angle[1:] + angle[:-1]), np.diff(angle, axis=0))
    twist = np.vstack([np.zeros(3), np.cumsum(twist, axis=0)])
    a, c = (np.column_stack([np.interp(t, t_w, x[:, k]) for k in range(3)]) for x in (angle, twist))
    da = np.diff(a, axis=0)
    mean = (da + 0.5 * (np.diff(c, axis=0) - np.cross(a[:-1], da))) / np.diff(t)[:, None]
    whole = np.diff(t) < 2 * WINDOW_S
    return np.asarray(np.median((mean - rate)[whole], axis=0)) if whole.sum() >= 10 else None


MISFIT = 0.15
"""Deviation from 1 of the share of its weight that the twin carries, from which on the vehicle file
does not fit the aircraft."""


def misfit(carried: float | None, vehicle: str) -> str:
    """Why a vehicle file does not fit the hover of a flight; "" where it does, or is unknown.

    Args:
        carried: Thrust of the twin over the weight, in hover.
        vehicle: Name of the file.
    """
    if carried is None or not abs(carried - 1) > MISFIT:
        return ""
    return (
        f"in hover the thrust of {vehicle} is {100 * carried:.0f} % of the weight that it gives: "
        f"mass, thrust constant or battery voltage of the file are not those of this aircraft. "
        f"Correct them, or draft a file: uavtwin vehicle draft."
    )
