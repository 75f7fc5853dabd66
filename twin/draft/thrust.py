"""How thrust follows from command and voltage, by what a hover tells, and what is usual.

With the command u, that of hover u_h and s = u / u_h, a rotor gives

    T = T_h ((2 - e) s + (e - 1) s^2) (1 + k (U / U_h - 1))

e is the relative thrust per relative command in hover, k that per relative voltage U. Autopilots
linearise with the same parabola (PX4's THR_MDL_FAC, ArduPilot's MOT_THST_EXPO).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.signal import butter, lfilter, sosfiltfilt

from ..effects.priors import PRIORS
from ..logs import Flight
from ..logs.airframe import ThrustCurve
from ..logs.columns import ACC
from .hover import Hover, sampled

Array = NDArray[np.float64]

_ARDUPILOT_EXPO = 0.65
_EXPO_SD = 0.5
"""Of e: two of them to 2.5, of simulators whose motors do not start at 0, and to a flat curve."""
_EXTREMES = (0.9, 2.8)
_GRID_S = 0.01
_SLOW_HZ = 2.0
_LAG_S = PRIORS["motor_lag"].of("tau_s", False).mean
_LEAST_CORRELATION = 0.7
_LEAST_S = 5.0
_LAG_SD = 0.08
"""Of e over its value: lags of 15 to 75 ms instead of 30 change the gain at 1 Hz by so much."""
_MEAN_S = 0.1
_BLOCK_S = 2.0
_LEAST_BLOCKS = 4
_DRIFT = 0.01
"""Of thrust along a hover, over it, by what else changes with time: warm motors; by judgement."""
_LEAST_SAG = 0.01
"""Relative range of the voltage from which on it tells something."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number with its standard deviation and where it comes from."""

    value: float
    sd: float
    source: str

    def with_prior(self, prior: "Estimate") -> "Estimate":
        """Both together, by their precisions."""
        a, b = self.sd**-2, prior.sd**-2
        value = (a * self.value + b * prior.value) / (a + b)
        return Estimate(value, float((a + b) ** -0.5), f"{self.source}; {prior.source}")


def thrust_shape(e: float, s: Array) -> Array:
    """Thrust over that in hover by the command over that in hover."""
    return np.maximum((2.0 - e) * s + (e - 1.0) * s**2, 0.0)


def usual_elasticity(command: float) -> Estimate:
    """What is usual where nothing is known."""
    e = ThrustCurve(_ARDUPILOT_EXPO).elasticity(command)
    source = f"usual {e:.2f}, that of ArduPilot's MOT_THST_EXPO {_ARDUPILOT_EXPO} in hover"
    return Estimate(e, _EXPO_SD, source)


def elasticity(flights: Sequence[Flight], hovers: Sequence[Hover], command: float) -> Estimate:
    """e from how the accelerometer follows the commands in hover, and from what is usual.

    Below 2 Hz, specific force against command, each regressed on the other: with noise in both,
    the truth is between the two slopes.
    """
    usual = usual_elasticity(command)
    found = [e for f, h in zip(flights, hovers, strict=True) if (e := _followed(f, h))]
    if not found:
        return usual
    weights = np.array([e.sd for e in found]) ** -2
    value = float(np.average([e.value for e in found], weights=weights))
    estimate = Estimate(
        value,
        float(np.hypot(weights.sum() ** -0.5, _LAG_SD * value)),
        f"accelerometer against commands in hover {value:.2f}",
    ).with_prior(usual)
    low, high = _EXTREMES
    return Estimate(min(max(estimate.value, low), high), estimate.sd, estimate.source)


def _followed(flight: Flight, hover: Hover) -> Estimate | None:
    """e of one flight; None where commands and accelerometer do not go together."""
    if hover.cmd is None or not hover.hovers or hover.seconds < _LEAST_S or not flight.has(*ACC):
        return None
    grid = np.arange(hover.t_s[0], hover.t_s[-1], _GRID_S)
    row = np.clip(np.searchsorted(hover.t_s, grid, side="right") - 1, 0, len(hover.t_s) - 2)
    inside = np.diff(hover.t_s)[row] < 0.5
    command = _lagged(np.interp(grid, hover.t_s, hover.cmd.mean(axis=1)))
    down = sampled(flight, ACC[2], grid)
    assert down is not None
    low_pass = butter(2, _SLOW_HZ * 2.0 * _GRID_S, output="sos")
    x, y = (sosfiltfilt(low_pass, values)[inside] for values in (command, -down))
    x, y = x / x.mean() - 1.0, y / y.mean() - 1.0
    both = float(np.mean(x * y))
    correlation = both / max(float(x.std() * y.std()), 1e-12)
    if correlation < _LEAST_CORRELATION:
        return None
    slopes = both / float(np.mean(x * x)), float(np.mean(y * y)) / both
    return Estimate(float(np.sqrt(slopes[0] * slopes[1])), max(float(np.ptp(slopes)) / 2, 0.01), "")


def _lagged(command: Array) -> Array:
    """Behind the usual lag of a motor, on the grid."""
    keep = np.exp(-_GRID_S / _LAG_S)
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], command - command[0]) + command[0])


def sag(hovers: Sequence[Hover], e: float, reference_v: float, command: float) -> Estimate:
    """k from the commands that a hover took at different voltages, and from what is usual."""
    prior = PRIORS["battery_sag"].of("slope", False)
    usual = Estimate(
        prior.mean, prior.sd, f"usual {prior.mean:g} of motor controllers without compensation"
    )
    blocks = [b for h in hovers for b in _blocks(h, e, command)]
    volts = np.array([v for v, _ in blocks]) / reference_v
    if len(blocks) < _LEAST_BLOCKS or np.ptp(volts) < _LEAST_SAG:
        return usual
    x, y = np.log(volts), np.log([s for _, s in blocks])
    x, y = x - x.mean(), y - y.mean()
    slope = -float(x @ y / (x @ x))
    scatter = float(np.sqrt(np.sum((y + slope * x) ** 2) / (len(x) - 2) / (x @ x)))
    estimate = Estimate(
        slope,
        float(np.hypot(scatter, _DRIFT / np.ptp(volts))),
        f"hover commands from {volts.min() * reference_v:.2f} to "
        f"{volts.max() * reference_v:.2f} V say {slope:.1f} +- {scatter:.1f}",
    ).with_prior(usual)
    return Estimate(min(max(estimate.value, 0.0), 4.0), estimate.sd, estimate.source)


def _blocks(hover: Hover, e: float, command: float) -> list[tuple[float, float]]:
    """Mean voltage, and thrust over weight that the map would give without sag, each 2 s."""
    if hover.cmd is None or hover.voltage_v is None or not hover.hovers:
        return []
    shape = thrust_shape(e, _followed_by_rotors(hover) / command).mean(axis=1) / hover.load
    number = ((hover.t_s - hover.t_s[0]) / _BLOCK_S).astype(np.int64)
    retained = [k for k in np.unique(number) if np.ptp(hover.t_s[number == k]) > 0.5 * _BLOCK_S]
    return [
        (float(hover.voltage_v[number == k].mean()), float(shape[number == k].mean()))
        for k in retained
    ]


def _followed_by_rotors(hover: Hover) -> Array:
    """Commands as far as rotors follow them, means over some of their lags, shape (n, motors)."""
    assert hover.cmd is not None
    step_s = float(np.median(np.diff(hover.t_s)))
    width = max(round(_MEAN_S / step_s), 1)
    return np.asarray(uniform_filter1d(hover.cmd, width, axis=0, mode="nearest"))


def hover_thrust_n(
    hover: Hover, weight_n: float, e: float, k: float, reference_v: float | None, command: float
) -> float:
    """T_h of the map by which the mean thrust of a hover carries what it carried, N."""
    shape = thrust_shape(e, _followed_by_rotors(hover) / command).sum(axis=1)
    if reference_v is not None and hover.voltage_v is not None:
        shape = shape * np.maximum(1.0 + k * (hover.voltage_v / reference_v - 1.0), 0.0)
    return weight_n * hover.load / float(shape.mean())


def speed_coefficient(hover: Hover, weight_n: float) -> float:
    """Thrust over the square of the rotor speed, N s2/rad2, by measured speeds."""
    assert hover.rotor_rad_s is not None
    return weight_n * hover.load / float(np.mean(np.sum(hover.rotor_rad_s**2, axis=1)))


def speed_line(hovers: Sequence[Hover], e: float) -> Array:
    """Rotor speed by command, ascending coefficients of a straight line through the hovers.

    Its slope is the one by which thrust, with the square of the speed, follows the command as e
    says.
    """
    speed = float(np.mean([h.rotor_rad_s.mean() for h in hovers if h.rotor_rad_s is not None]))
    command = float(np.mean([h.cmd.mean() for h in hovers if h.cmd is not None]))
    return np.array([(1.0 - e / 2.0) * speed, e / 2.0 * speed / command])
