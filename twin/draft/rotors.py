"""Thrust, torque, lag and voltage sag of the rotors, for a draft.

With the command u, the hover command u_h and s = u / u_h, a rotor has the thrust

    T = T_h ((2 - e) s + (e - 1) s^2) (1 + k (U / U_h - 1))

e is the relative thrust per relative command in hover, k that per relative voltage U. Autopilots
linearise with the same parabola (PX4's THR_MDL_FAC, ArduPilot's MOT_THST_EXPO).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from ..effects import EFFECTS, prior_of
from ..formatting import percent
from ..logs import Flight
from ..logs.airframe import ThrustCurve
from ..logs.columns import ACC
from ..vehicle import Deviation, Vehicle
from ..vehicle.layouts import Layout
from ..vehicle_file.write import Written
from .facts import (
    STATIC,
    DraftState,
    Usual,
    rounded,
    usual_diameter_m,
    usual_pitch_m,
    usual_torque_per_thrust_m,
)
from .hover import Hover, sampled

Array = NDArray[np.float64]

_ARDUPILOT_EXPO = 0.65
"""Default of ArduPilot's MOT_THST_EXPO."""
_EXPO_SD = 0.5
"""Standard deviation of e: two of them reach 2.5, for simulators whose motors do not start at 0,
and a flat curve."""
_EXTREMES = (0.9, 2.8)
"""Smallest and largest elasticity of thrust over command in a draft; by judgement."""
_GRID_S = 0.01
"""Time step for the comparison of commands and specific force, s."""
_SLOW_HZ = 2.0
"""Cut-off of the low-pass before the thrust curve is fitted, Hz: below vibration."""
_LAG_S = prior_of(EFFECTS["motor_lag"]).of("tau_s", False).mean
"""Usual motor lag, s: mean of its prior."""
_LEAST_CORRELATION = 0.7
"""Correlation of thrust and command below which the usual slope is used; by judgement."""
_LEAST_S = 5.0
"""Shortest hover for a fit of the thrust curve, s; by judgement."""
_LAG_SD = 0.08
"""Relative standard deviation of e by the lag: 15 to 75 ms instead of 30 change the gain at 1 Hz by
that much."""
_MEAN_S = 0.1
"""Averaging time of commands and voltage, s."""
_BLOCK_S = 2.0
"""Length of the blocks of a hover for the fit of the sag, s."""
_LEAST_BLOCKS = 4
"""Smallest number of blocks for a fit of voltage slope and drift."""
_DRIFT = 0.01
"""Relative drift of thrust along a hover by other slow causes, such as warm motors; by
judgement."""
_LEAST_SAG = 0.01
"""Relative range of the voltage from which it is informative."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number with its standard deviation and source."""

    value: float
    sd: float
    source: str

    def with_prior(self, prior: "Estimate") -> "Estimate":
        """This estimate combined with a prior estimate, weighted by their precisions."""
        a, b = self.sd**-2, prior.sd**-2
        value = (a * self.value + b * prior.value) / (a + b)
        return Estimate(value, float((a + b) ** -0.5), f"{self.source}; {prior.source}")


def thrust_shape(e: float, s: Array) -> Array:
    """Thrust over that in hover by the command over that in hover."""
    return np.maximum((2.0 - e) * s + (e - 1.0) * s**2, 0.0)


def usual_elasticity(command: float) -> Estimate:
    """Usual elasticity where nothing is known."""
    e = ThrustCurve(_ARDUPILOT_EXPO).elasticity(command)
    source = f"usual {e:.2f}, that of ArduPilot's MOT_THST_EXPO {_ARDUPILOT_EXPO} in hover"
    return Estimate(e, _EXPO_SD, source)


def thrust_elasticity(
    flights: Sequence[Flight], hovers: Sequence[Hover], command: float
) -> Estimate:
    """e from the response of the accelerometer to the commands in hover, and from usual values.

    Below 2 Hz, specific force against command, each regressed on the other: with noise in both, the
    true slope is between the two.
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
    """e from one flight; None where commands and accelerometer are not correlated."""
    if hover.cmd is None or not hover.hovers or hover.seconds < _LEAST_S or not flight.has(*ACC):
        return None
    grid = np.arange(hover.t_s[0], hover.t_s[-1], _GRID_S)
    row = np.clip(np.searchsorted(hover.t_s, grid, side="right") - 1, 0, len(hover.t_s) - 2)
    inside = np.diff(hover.t_s)[row] < 0.5
    command = _lagged(np.interp(grid, hover.t_s, hover.cmd.mean(axis=1)))
    down = sampled(flight, ACC[2], grid)
    assert down is not None
    low_pass = scipy.signal.butter(2, _SLOW_HZ * 2.0 * _GRID_S, output="sos")
    x, y = (scipy.signal.sosfiltfilt(low_pass, values)[inside] for values in (command, -down))
    x, y = x / x.mean() - 1.0, y / y.mean() - 1.0
    both = float(np.mean(x * y))
    correlation = both / max(float(x.std() * y.std()), 1e-12)
    if correlation < _LEAST_CORRELATION:
        return None
    slopes = both / float(np.mean(x * x)), float(np.mean(y * y)) / both
    return Estimate(float(np.sqrt(slopes[0] * slopes[1])), max(float(np.ptp(slopes)) / 2, 0.01), "")


def _lagged(command: Array) -> Array:
    """The command after the usual lag of a motor, on the grid."""
    keep = np.exp(-_GRID_S / _LAG_S)
    return np.asarray(
        scipy.signal.lfilter([1.0 - keep], [1.0, -keep], command - command[0]) + command[0]
    )


def voltage_sag(hovers: Sequence[Hover], e: float, reference_v: float, command: float) -> Estimate:
    """k from the hover commands at different voltages, and from usual values."""
    prior = prior_of(EFFECTS["battery_sag"]).of("slope", False)
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
    """Mean voltage, and thrust over weight by the map without sag, for each block of 2 s."""
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
    """Commands low-passed as the rotors follow them, mean over several lags, shape (n, motors)."""
    assert hover.cmd is not None
    step_s = float(np.median(np.diff(hover.t_s)))
    width = max(round(_MEAN_S / step_s), 1)
    return np.asarray(scipy.ndimage.uniform_filter1d(hover.cmd, width, axis=0, mode="nearest"))


def hover_thrust_n(
    hover: Hover, weight_n: float, e: float, k: float, reference_v: float | None, command: float
) -> float:
    """T_h of the map for which the mean thrust of a hover equals its load, N."""
    shape = thrust_shape(e, _followed_by_rotors(hover) / command).sum(axis=1)
    if reference_v is not None and hover.voltage_v is not None:
        shape = shape * np.maximum(1.0 + k * (hover.voltage_v / reference_v - 1.0), 0.0)
    return weight_n * hover.load / float(shape.mean())


def speed_coefficient(hover: Hover, weight_n: float) -> float:
    """Thrust over the square of the rotor speed, N s2/rad2, from measured speeds."""
    assert hover.rotor_rad_s is not None
    return weight_n * hover.load / float(np.mean(np.sum(hover.rotor_rad_s**2, axis=1)))


def speed_line(hovers: Sequence[Hover], e: float) -> Array:
    """Rotor speed over command, ascending coefficients of a straight line through the hovers.

    Its slope is the one for which thrust, proportional to the square of the speed, has the
    elasticity e.
    """
    speed = float(np.mean([h.rotor_rad_s.mean() for h in hovers if h.rotor_rad_s is not None]))
    command = float(np.mean([h.cmd.mean() for h in hovers if h.cmd is not None]))
    return np.array([(1.0 - e / 2.0) * speed, e / 2.0 * speed / command])


_HOVER_SD = 0.03
"""Relative standard deviation of hover thrust: density of the air, warm motors; by judgement."""
_FLOWN_SD = 0.08
"""Relative standard deviation of thrust where the aircraft never hovers."""
_VOLT_SD = 0.01
"""Relative standard deviation of a measured battery voltage."""
_FACTOR_SD = 0.2
"""Standard deviation of the elasticity where the owner has set the autopilot's thrust curve; by
judgement."""


@dataclass(frozen=True, slots=True)
class Supply:
    """Dependence of thrust on command and voltage in hover, beyond the keys of a file.

    Attributes:
        elasticity: Relative thrust per relative command; None: the inputs are not commands.
        sag: Relative thrust per relative voltage; None: given by the keys, or no voltage is logged.
        reference_v: Voltage at which the maps are valid.
    """

    elasticity: Estimate | None
    sag: Estimate | None
    reference_v: float


def draft_rotors(m: DraftState, layout: Layout, gravity_m_s2: float) -> Supply:
    """Add maps, torque and lag; returns the dependence on command and voltage that no key
    covers."""
    weight = m.known.mass_kg * gravity_m_s2
    e = _elasticity(m) if all(h.cmd is not None for h in m.hovers) else None
    volts = [float(np.median(h.voltage_v)) for h in m.hovers if h.voltage_v is not None]
    reference = round(float(np.mean(volts)), 2) if volts else 0.0
    sag = voltage_sag(m.hovers, e.value, reference, m.level) if volts and e is not None else None
    supply = Supply(e, sag, reference)
    if all(h.rotor_rad_s is not None for h in m.hovers):
        _speed_map(m, weight, supply)
        supply = Supply(e, None, reference)
    else:
        _command_map(m, weight, supply)
    _torque(m, layout)
    prior = prior_of(EFFECTS["motor_lag"])
    lag, source = prior.of("tau_s", False), f"usual: {prior.reason}"
    m.file.number("rotors.lag", lag.mean, "s", source, percent(lag.sd / lag.mean))
    m.say("motor lag", f"{1e3 * lag.mean:.0f} ms, sd {percent(lag.sd / lag.mean)}", source)
    return supply


def rotor_effects(m: DraftState, vehicle: Vehicle, supply: Supply) -> dict[str, dict[str, Written]]:
    """Effects for numbers without a key: uncertainty of the curve, sag, spin of the rotors."""
    effects: dict[str, dict[str, Written]] = {}
    e, k = supply.elasticity, supply.sag
    if e is not None:
        doubt = f"given by the map; its doubt is that of {e.value:.2f} +- {e.sd:.2f}: {e.source}"
        effects["thrust_curve"] = {"slope": _written(0.0, e.sd / e.value, doubt)}
    if k is not None:
        effects["battery_sag"] = {
            "slope": _written(k.value, k.sd, k.source),
            "reference_v": _written(
                supply.reference_v, _VOLT_SD * supply.reference_v, "battery voltage in hover"
            ),
        }
        value = f"{k.value:.2f} % thrust per % voltage, sd {k.sd:.2f}; at {supply.reference_v:g} V"
        m.say("battery sag", value, k.source)
    for name in ("rotor_inertia_torque", "gyroscopic_torque"):
        (about,) = EFFECTS[name].parameters
        expected = prior_of(EFFECTS[name]).of(about.name, False).sized(about, vehicle)
        source = f"estimate by thrust and arm; {prior_of(EFFECTS['rotor_inertia_torque']).reason}"
        effects[name] = {about.name: _written(expected.mean, expected.sd, source)}
    value = f"{expected.mean:.3g} N m s a rotor in hover, sd {percent(expected.sd / expected.mean)}"
    m.say("rotor momentum", value, "estimate by thrust and arm")
    return effects


def _elasticity(m: DraftState) -> Estimate:
    curve = m.airframe.thrust
    if curve is None or m.level <= curve.value.start:
        return thrust_elasticity(m.flights, m.hovers, m.level)
    return Estimate(curve.value.elasticity(m.level), _FACTOR_SD, curve.source)


def _command_map(m: DraftState, weight_n: float, supply: Supply) -> None:
    """Add thrust over command, scaled to hover at the logged command."""
    e, k = supply.elasticity, supply.sag
    assert e is not None
    slope, reference = (0.0, None) if k is None else (k.value, supply.reference_v)
    each = np.array(
        [hover_thrust_n(h, weight_n, e.value, slope, reference, m.level) for h in m.hovers]
    )
    value, sd = float(np.exp(np.log(each).mean())), _thrust_sd(m, each)
    shape = np.array([0.0, (2.0 - e.value) / m.level, (e.value - 1.0) / m.level**2])
    coefficients = np.array([rounded(c) for c in value * shape])
    source = f"{_carries(m)} at command {m.level:.3f}; curve: {e.source}"
    m.file.polynomial("rotors.thrust_from_command", coefficients, "N", source, sd=percent(sd))
    m.say(
        "thrust", f"{value:.4g} N a rotor at command {m.level:.3f}, sd {percent(sd)}", _carries(m)
    )
    m.say("thrust curve", f"{e.value:.2f} % thrust per % command, sd {e.sd:.2f}", e.source)


def _speed_map(m: DraftState, weight_n: float, supply: Supply) -> None:
    """Add thrust over measured speed, and the speed over command where there are commands."""
    each = np.array([speed_coefficient(h, weight_n) for h in m.hovers])
    value, sd = float(np.exp(np.log(each).mean())), _thrust_sd(m, each)
    source = f"{_carries(m)} at the measured rotor speeds"
    unit = "N*s^2/rad^2"
    m.file.number("rotors.thrust_from_speed", rounded(value), unit, source, percent(sd))
    m.say("thrust", f"{value:.4g} {unit}, sd {percent(sd)}", source)
    e, k = supply.elasticity, supply.sag
    if e is None:
        return
    line = np.array([rounded(c) for c in speed_line(m.hovers, e.value)])
    source = f"measured rotor speeds and commands of the hover; slope: {e.source}"
    m.file.polynomial("rotors.speed_from_command", line, "rad/s", source, sd=percent(_HOVER_SD))
    m.say("rotor speed", f"{line[0]:.4g} + {line[1]:.4g} command, rad/s", source)
    if k is not None:
        measured = "battery voltage in hover"
        volts, exponent = supply.reference_v, rounded(k.value / e.value)
        m.file.number("rotors.reference_voltage", volts, "V", measured, percent(_VOLT_SD))
        sd_exponent = rounded(k.sd / e.value)
        m.file.number("rotors.voltage_exponent", exponent, "1", k.source, sd_exponent)
        m.say("voltage", f"{supply.reference_v:g} V, exponent {k.value / e.value:.2f}", k.source)


def _thrust_sd(m: DraftState, each: Array) -> float:
    """Relative standard deviation of thrust: of one flight, and the scatter of several."""
    own = _HOVER_SD if all(h.hovers for h in m.hovers) else _FLOWN_SD
    scatter = float(np.log(each).std(ddof=1)) if len(each) > 1 else 0.0
    return float(np.hypot(own, scatter))


def _torque(m: DraftState, layout: Layout) -> None:
    """Add reaction torque over thrust by the propeller, or by the largest one that fits between the
    rotors."""
    diameter, pitch = m.known.diameter_m, m.known.pitch_m
    if diameter is not None:
        size, words = Usual(diameter, 0.0), f"diameter {diameter:.4g} m given, pitch usual"
    else:
        size = usual_diameter_m(layout.position)
        words = f"diameter {size.value:.3g} m and pitch usual for rotors so far apart"
    steep = usual_pitch_m(size)
    if pitch is not None:
        steep, words = Usual(pitch, 0.0), f"pitch {pitch:.4g} m given"
    torque = usual_torque_per_thrust_m(steep)
    source = (
        f"estimate: {words}; torque over thrust by pitch as of {len(STATIC)} propellers of "
        "the UIUC data site"
    )
    m.file.number(
        "rotors.torque_per_thrust", rounded(torque.value), "m", source, percent(torque.sd)
    )
    value = f"{1e3 * torque.value:.1f} mm, sd {percent(torque.sd)}"
    m.say("torque over thrust", value, f"estimate: {words}")


def _carries(m: DraftState) -> str:
    """Text on the parts of the flights in which the rotors carry the weight."""
    parts = "; ".join(f"{h.flight}, {h.where}" for h in m.hovers)
    return f"carries the weight as logged ({parts})"


def _written(value: float, sd: float, source: str) -> Written:
    value, sd = rounded(value), float(f"{sd:.3g}")
    return Written(value, source, Deviation.of([sd], [value]))
