"""What is different about an aircraft, as one pilot says it to another."""

from collections.abc import Callable, Mapping

import numpy as np

from twin.effects import EFFECTS

from .figures import pretty_unit
from .gap import number, percent

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
    return known(change, since) if known and any(change.values()) else ""


def told_number(effect: str, name: str, value: float) -> str:
    """A number with its unit."""
    unit = next(
        (
            p.unit
            for p in (*EFFECTS[effect].parameters, *EFFECTS[effect].of_logs)
            if name == p.name or (p.per_rotor and name.startswith(p.name))
        ),
        "1",
    )
    return number(value) if unit == "1" else f"{number(value)} {pretty_unit(unit)}"


def joined(parts: list[str], word: str = "and") -> str:
    """Parts of a sentence in a row."""
    if len(parts) < 2:
        return "".join(parts)
    return f"{', '.join(parts[:-1])} {word} {parts[-1]}"


def _plain(effect: str, change: Changes) -> str:
    large = max(change.items(), key=lambda item: abs(item[1]), default=None)
    words = effect.replace("_", " ")
    return words if large is None else f"{words} ({large[0]} {told_number(effect, *large)})"


def _large(change: Changes) -> dict[str, float]:
    most = max((abs(v) for v in change.values()), default=0.0)
    return {k: v for k, v in change.items() if abs(v) > SMALL * most}


def _rotors(change: Changes, since: bool) -> str:
    losses = {k: v for k, v in change.items() if k.startswith("loss_")}
    parts = [
        f"rotor {k.removeprefix('loss_')} "
        + (
            f"has {'lost' if v > 0 else 'gained'} {percent(abs(v))} of its thrust"
            if since
            else f"gives {percent(abs(v))} {'less' if v > 0 else 'more'} thrust than the model"
        )
        for k, v in sorted(_large(losses).items(), key=lambda item: -abs(item[1]))
    ]
    return joined(parts)


def _mass(change: Changes, since: bool) -> str:
    kg = change.get("mass_kg", 0.0)
    if since:
        return f"it carries {number(kg)} kg more" if kg > 0 else f"it is {number(-kg)} kg lighter"
    return f"it is {number(abs(kg))} kg {'heavier' if kg > 0 else 'lighter'} than the model"


def _place(change: Changes, since: bool) -> str:
    parts = []
    for axis, *ways in AXES if since else PLACES:
        shift = _large(change).get(f"{axis}_m", 0.0)
        if shift:
            parts.append(f"{number(1e3 * abs(shift))} mm {ways[0 if shift > 0 else 1]}")
    if since:
        return f"its centre of mass has moved {joined(parts)}"
    return f"its centre of mass is {joined(parts)} than in the model"


def _load(change: Changes, since: bool) -> str:
    del since
    return f"a load of {number(change.get('mass_kg', 0.0))} kg hangs below it on a rope"


def _wind(change: Changes, since: bool) -> str:
    speed = f"{number(float(np.linalg.norm(list(change.values()))))} m/s"
    return f"the wind has changed by {speed}" if since else f"a wind of {speed}"


def _reads(what: str, unit: str) -> Clause:
    def made(change: Changes, since: bool) -> str:
        """See `Clause`."""
        more, less = ("more", "less") if since else ("too much", "too little")
        parts = []
        large = _large(change)
        for axis in "xyz":
            v = next((v for k, v in large.items() if k.startswith(f"{axis}_")), 0.0)
            if v:
                parts.append(f"{number(abs(v))} {unit} {more if v > 0 else less} in {axis}")
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
        for k, v in _large(change).items()
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
    "accel_bias": _reads("accelerometer", "m/s²"),
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
