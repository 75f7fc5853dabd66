"""Thrust, torque, lag and sag of the rotors, for a draft."""

from dataclasses import dataclass

import numpy as np

from ..effects import EFFECTS
from ..effects.priors import PRIORS, prior_of
from ..vehicle import Array, Deviation, Vehicle
from ..vehicle.file.write import Written
from ..vehicle.layouts import Layout
from . import scaling, thrust
from .making import Making, percent, rounded

_HOVER_SD = 0.03
"""Of thrust in hover, over it: density of the air, warm motors; by judgement."""
_FLOWN_SD = 0.08
"""The same where the aircraft never hovers."""
_VOLT_SD = 0.01
"""Of a measured battery voltage, over it."""
_FACTOR_SD = 0.2
"""Of the elasticity where the owner has set the thrust curve of the autopilot; by judgement."""


@dataclass(frozen=True, slots=True)
class Supply:
    """How thrust follows from command and voltage in hover, beyond what the keys of a file say.

    Attributes:
        elasticity: Relative thrust per relative command; None: not driven by commands.
        sag: Relative thrust per relative voltage; None: the keys say it, or no voltage is logged.
        reference_v: Voltage at which the maps hold.
    """

    elasticity: thrust.Estimate | None
    sag: thrust.Estimate | None
    reference_v: float


def draft_rotors(m: Making, layout: Layout, gravity_m_s2: float) -> Supply:
    """Add maps, torque and lag; returns what is left to say of command and voltage."""
    weight = m.known.mass_kg * gravity_m_s2
    e = _elasticity(m) if all(h.cmd is not None for h in m.hovers) else None
    volts = [float(np.median(h.voltage_v)) for h in m.hovers if h.voltage_v is not None]
    reference = round(float(np.mean(volts)), 2) if volts else 0.0
    sag = thrust.sag(m.hovers, e.value, reference, m.level) if volts and e is not None else None
    supply = Supply(e, sag, reference)
    if all(h.rotor_rad_s is not None for h in m.hovers):
        _speed_map(m, weight, supply)
        supply = Supply(e, None, reference)
    else:
        _command_map(m, weight, supply)
    _torque(m, layout)
    prior = PRIORS["motor_lag"]
    lag, source = prior.of("tau_s", False), f"usual: {prior.reason}"
    m.file.number("rotors.lag", lag.mean, "s", source, percent(lag.sd / lag.mean))
    m.say("motor lag", f"{1e3 * lag.mean:.0f} ms, sd {percent(lag.sd / lag.mean)}", source)
    return supply


def rotor_effects(m: Making, vehicle: Vehicle, supply: Supply) -> dict[str, dict[str, Written]]:
    """Effects for what the keys have no place for: doubt of the curve, sag, spin of the rotors."""
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
        source = f"estimate by thrust and arm; {PRIORS['rotor_inertia_torque'].reason}"
        effects[name] = {about.name: _written(expected.mean, expected.sd, source)}
    value = f"{expected.mean:.3g} N m s a rotor in hover, sd {percent(expected.sd / expected.mean)}"
    m.say("rotor momentum", value, "estimate by thrust and arm")
    return effects


def _elasticity(m: Making) -> thrust.Estimate:
    curve = m.airframe.thrust
    if curve is None or m.level <= curve.value.start:
        return thrust.elasticity(m.flights, m.hovers, m.level)
    return thrust.Estimate(curve.value.elasticity(m.level), _FACTOR_SD, curve.source)


def _command_map(m: Making, weight_n: float, supply: Supply) -> None:
    """Thrust by command, such that it hovers as logged."""
    e, k = supply.elasticity, supply.sag
    assert e is not None
    slope, reference = (0.0, None) if k is None else (k.value, supply.reference_v)
    each = np.array(
        [thrust.hover_thrust_n(h, weight_n, e.value, slope, reference, m.level) for h in m.hovers]
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


def _speed_map(m: Making, weight_n: float, supply: Supply) -> None:
    """Thrust by measured speed, and the speed by command where there are commands."""
    each = np.array([thrust.speed_coefficient(h, weight_n) for h in m.hovers])
    value, sd = float(np.exp(np.log(each).mean())), _thrust_sd(m, each)
    source = f"{_carries(m)} at the measured rotor speeds"
    unit = "N*s^2/rad^2"
    m.file.number("rotors.thrust_from_speed", rounded(value), unit, source, percent(sd))
    m.say("thrust", f"{value:.4g} {unit}, sd {percent(sd)}", source)
    e, k = supply.elasticity, supply.sag
    if e is None:
        return
    line = np.array([rounded(c) for c in thrust.speed_line(m.hovers, e.value)])
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


def _thrust_sd(m: Making, each: Array) -> float:
    """Over the value: of one flight, and the scatter of several."""
    own = _HOVER_SD if all(h.hovers for h in m.hovers) else _FLOWN_SD
    scatter = float(np.log(each).std(ddof=1)) if len(each) > 1 else 0.0
    return float(np.hypot(own, scatter))


def _torque(m: Making, layout: Layout) -> None:
    """Reaction torque over thrust by the propeller, or by what fits between the rotors."""
    diameter, pitch = m.known.diameter_m, m.known.pitch_m
    if diameter is not None:
        size, words = scaling.Usual(diameter, 0.0), f"diameter {diameter:.4g} m given, pitch usual"
    else:
        size = scaling.diameter_m(layout.position)
        words = f"diameter {size.value:.3g} m and pitch usual for rotors so far apart"
    steep = scaling.pitch_m(size)
    if pitch is not None:
        steep, words = scaling.Usual(pitch, 0.0), f"pitch {pitch:.4g} m given"
    torque = scaling.torque_per_thrust_m(steep)
    source = (
        f"estimate: {words}; torque over thrust by pitch as of {len(scaling.STATIC)} propellers of "
        "the UIUC data site"
    )
    m.file.number(
        "rotors.torque_per_thrust", rounded(torque.value), "m", source, percent(torque.sd)
    )
    value = f"{1e3 * torque.value:.1f} mm, sd {percent(torque.sd)}"
    m.say("torque over thrust", value, f"estimate: {words}")


def _carries(m: Making) -> str:
    """Which parts of which flights carry the weight."""
    parts = "; ".join(f"{h.flight}, {h.where}" for h in m.hovers)
    return f"carries the weight as logged ({parts})"


def _written(value: float, sd: float, source: str) -> Written:
    value, sd = rounded(value), float(f"{sd:.3g}")
    return Written(value, source, Deviation.of([sd], [value]))
