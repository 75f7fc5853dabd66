"""What is different about an aircraft, as one pilot says it to another."""

import math
from collections.abc import Callable, Mapping

import numpy as np

from twin.effects import EFFECTS

from .figures import number, percent, pretty_unit

Changes = Mapping[str, float]
"""By number of an effect, by how much it differs."""
Clause = Callable[[Changes, bool], str]
"""A change of an effect as a clause, "" for one it has no words for; whether it is one since a
calibration."""
SMALL = 0.25
"""Share of the largest change of its kind below which one is not spoken of."""
AXES = (("x", "forward", "back"), ("y", "right", "left"), ("z", "down", "up"))
PLACES = (
    ("x", "further forward", "further back"),
    ("y", "further right", "further left"),
    ("z", "lower", "higher"),
)
"""Which way a positive and a negative number point, body frame, FRD."""
_READ_IN = {
    "T": ("µT", 1e6),
    "Pa": ("hPa", 1e-2),
    "rad": ("°", 180 / math.pi),
    "rad/s": ("°/s", 180 / math.pi),
}
"""Units in which a pilot reads a quantity, and the factor from SI."""
_SMALLER = {"m": 0.1, "s": 0.1, "kg": 0.1}
"""Quantities below which a pilot reads thousandths of the unit; of others, `_TINY`."""
_TINY, _PREFIXES = 1e-3, (("m", 1e3), ("µ", 1e6), ("n", 1e9))


def readable(unit: str, *values: float) -> tuple[tuple[float, ...], str]:
    """Values of one quantity in the unit that a pilot reads: degrees, µT, hPa, and milli, micro or
    nano of a unit where all values are small.

    Args:
        unit: SI, as in an FMU; "1" of a plain number.
        values: Share the unit.

    Returns:
        The values in that unit, and the unit as it is printed, "" of a plain number.
    """
    if unit in ("1", ""):
        return values, ""
    if unit in _READ_IN:
        name, factor = _READ_IN[unit]
        return tuple(factor * v for v in values), name
    largest = max((abs(v) for v in values if math.isfinite(v)), default=0.0)
    symbol = unit.partition("/")[0].partition(".")[0]
    if largest >= _SMALLER.get(unit, _TINY) or largest == 0 or not symbol.isalpha():
        return values, pretty_unit(unit)
    if unit == "kg":
        return tuple(1e3 * v for v in values), "g"
    prefix, factor = next((p for p in _PREFIXES if largest * p[1] >= 1), _PREFIXES[-1])
    scaled = tuple(factor * v if abs(factor * v) >= _TINY else 0.0 for v in values)
    return scaled, prefix + pretty_unit(unit)


def quantity(value: float, unit: str) -> str:
    """A value with its unit, as a pilot reads it."""
    (shown,), name = readable(unit, value)
    return f"{number(shown)}{name}" if name == "°" else f"{number(shown)} {name}".rstrip()


def said(effect: str, change: Changes, since: bool) -> str:
    """What an effect amounts to, a clause with its own subject.

    Args:
        effect: Identifier.
        change: Of its numbers, from no effect or from a calibration.
        since: Whether something has changed; else that is how the aircraft is, compared with its
            file.
    """
    return clause(effect, change, since) or _plain(effect, change)


def clause(effect: str, change: Changes, since: bool) -> str:
    """The same; "" where there are no words for it, but numbers alone. Arguments as of `said`."""
    known = _CLAUSES.get(effect)
    large = said_numbers(effect, change)
    return known(large, since) if known and large else ""


def said_numbers(effect: str, change: Changes) -> dict[str, float]:
    """Of some changes those that a clause about them gives: in each unit none that is small beside
    the largest, and a single one of an effect that is spoken of by its largest."""
    change = {n: v for n, v in change.items() if f"{effect}.{n}" not in _UNSAID} or change
    units = {name: unit_of(effect, name) for name in change}
    most = {u: max(abs(v) for n, v in change.items() if units[n] == u) for u in units.values()}
    large = {n: v for n, v in change.items() if v and abs(v) > SMALL * most[units[n]]}
    if effect in _BY_LARGEST and large:
        name = max(large, key=lambda n: abs(large[n]))
        return {name: large[name]}
    return large


def unit_of(effect: str, name: str) -> str:
    """Unit of a number of an effect."""
    every = (*EFFECTS[effect].parameters, *EFFECTS[effect].of_logs)
    own = (p for p in every if name == p.name or (p.per_rotor and name.startswith(p.name)))
    return next((p.unit for p in own), "1")


def joined(parts: list[str], word: str = "and") -> str:
    """Parts of a sentence in a row."""
    if len(parts) < 2:
        return "".join(parts)
    return f"{', '.join(parts[:-1])} {word} {parts[-1]}"


def _plain(effect: str, change: Changes) -> str:
    words = effect.replace("_", " ")
    texts = [
        f"{name} {quantity(value, unit_of(effect, name))}"
        for name, value in said_numbers(effect, change).items()
    ]
    return f"{words} ({', '.join(texts)})" if texts else words


def _rotors(change: Changes, since: bool) -> str:
    losses = {k: v for k, v in change.items() if k.startswith("loss_")}
    parts = [
        f"rotor {k.removeprefix('loss_')} "
        + (
            f"has {'lost' if v > 0 else 'gained'} {percent(abs(v))} of its thrust"
            if since
            else f"gives {percent(abs(v))} {'less' if v > 0 else 'more'} thrust than the model"
        )
        for k, v in sorted(losses.items(), key=lambda item: -abs(item[1]))
    ]
    return joined(parts)


def _mass(change: Changes, since: bool) -> str:
    kg = change.get("mass_kg", 0.0)
    size = quantity(abs(kg), "kg")
    if since:
        return f"it carries {size} more" if kg > 0 else f"it is {size} lighter"
    return f"it is {size} {'heavier' if kg > 0 else 'lighter'} than the model"


def _place(change: Changes, since: bool) -> str:
    parts = []
    for axis, *ways in AXES if since else PLACES:
        shift = change.get(f"{axis}_m", 0.0)
        if shift:
            parts.append(f"{number(1e3 * abs(shift))} mm {ways[0 if shift > 0 else 1]}")
    if since:
        return f"its centre of mass has moved {joined(parts)}"
    return f"its centre of mass is {joined(parts)} than in the model"


def _load(change: Changes, since: bool) -> str:
    del since
    return f"a load of {quantity(change.get('mass_kg', 0.0), 'kg')} hangs below it on a rope"


def _wind(change: Changes, since: bool) -> str:
    speed = f"{number(float(np.linalg.norm(list(change.values()))))} m/s"
    return f"the wind has changed by {speed}" if since else f"a wind of {speed}"


def _reads(what: str, unit: str) -> Clause:
    def made(change: Changes, since: bool) -> str:
        """See `Clause`."""
        more, less = ("more", "less") if since else ("too much", "too little")
        parts = []
        for axis in "xyz":
            v = next((v for k, v in change.items() if k.startswith(f"{axis}_")), 0.0)
            if v:
                parts.append(f"{quantity(abs(v), unit)} {more if v > 0 else less} in {axis}")
        return f"its {what} reads {joined(parts)}" + (" than it did" if since else "")

    return made


def _late(what: str) -> Clause:
    def made(change: Changes, since: bool) -> str:
        """See `Clause`."""
        delay = max(change.values(), key=abs, default=0.0)
        way = "later" if delay > 0 else "earlier"
        than = "they did" if what.endswith("s") else "it did"
        return f"{what} {number(1e3 * abs(delay))} ms {way} than {than if since else 'modelled'}"

    return made


def _heading(change: Changes, since: bool) -> str:
    turn = np.degrees(max(change.values(), key=abs, default=0.0))
    return f"its heading is off by {'another ' * since}{number(float(turn))}°"


def _factor(what: str, noun: str) -> Clause:
    def made(change: Changes, since: bool) -> str:
        """See `Clause`."""
        v = max(change.values(), key=abs, default=0.0)
        more = "more" if v > 0 else "less"
        return f"{what} {percent(abs(v))} {more} {noun} than {'before' if since else 'the model'}"

    return made


def _inertia(change: Changes, since: bool) -> str:
    axes = {"scale_x": "roll", "scale_y": "pitch", "scale_z": "yaw"}
    parts = [
        f"{percent(abs(v))} {'larger' if v > 0 else 'smaller'} in {axes[k]}"
        for k, v in change.items()
    ]
    return f"its inertia is {joined(parts)} than {'before' if since else 'that of the model'}"


def _drag(change: Changes, since: bool) -> str:
    parts = [
        f"{number(change[name])} m/s²{' more' * since} for each m/s of {what}"
        for name, what in (("k_xy_1_s", "airspeed"), ("k_z_1_s", "climb"))
        if change.get(name)
    ]
    return f"it brakes by {joined(parts)}" if parts else ""


def _sag(change: Changes, since: bool) -> str:
    slope = change.get("slope", 0.0)
    return f"each 1 % of battery voltage costs {number(slope)} %{' more' * since} thrust"


_CLAUSES: dict[str, Clause] = {
    "rotor_efficiency_loss": _rotors,
    "mass_offset": _mass,
    "cog_offset": _place,
    "slung_load": _load,
    "steady_wind": _wind,
    "accel_bias": _reads("accelerometer", "m/s2"),
    "gyro_bias": _reads("gyroscope", "rad/s"),
    "imu_delay": _late("its IMU reads"),
    "position_delay": _late("its position arrives"),
    "command_delay": _late("its motors get their commands"),
    "motor_lag": _late("its rotors follow"),
    "heading_offset": _heading,
    "thrust_scale": _factor("its rotors give", "thrust"),
    "yaw_torque_scale": _factor("its rotors give", "yaw torque"),
    "inertia_error": _inertia,
    "rotor_drag": _drag,
    "battery_sag": _sag,
}
_BY_LARGEST = ("heading_offset", "position_delay")
_UNSAID = ("rotor_drag.height_m",)
"""Effects of several numbers whose clause gives the largest, and numbers that are given only where
the others have not changed."""
_BLIND: dict[str, str] = {
    "rotor_efficiency_loss": "a loss below {} of the thrust of one rotor",
    "thrust_scale": "thrust that is off by less than {}",
    "mass_offset": "a mass that is off by less than {}",
    "cog_offset": "a centre of mass that is off by less than {}",
    "inertia_error": "inertia that is off by less than {}",
    "slung_load": "a slung load below {}",
    "rotor_drag": "rotor drag below {}",
    "steady_wind": "a steady wind below {}",
}
"""What would not show, by effect, in the order in which it is said."""


def blind_clause(effect: str, value: float, unit: str, since: bool) -> str:
    """A clause about the largest effect that would not show.

    Args:
        effect: One of `BLIND_ORDER`.
        value: The smallest one that would show, a change from no effect.
        unit: SI.
        since: Whether it is a change since a calibration.
    """
    size = percent(value) if unit == "1" else quantity(value, unit)
    text = _BLIND[effect].format(size)
    return text.replace("that is off by", "that has changed by") if since else text


BLIND_ORDER = tuple(_BLIND)
