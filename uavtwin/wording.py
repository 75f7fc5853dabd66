"""What is different about an aircraft, as one pilot says it to another."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from twin.effects import EFFECTS
from twin.physics.sensors.table import BODY, SENSORS, Sensor
from twin.residuals.flight_gap import HoverDiagnosis, Mean
from twin.residuals.gap import Channel

from .formatting import joined, number, percent, quantity

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


LEAST_M, LEAST_RAD, LEAST_LOSS = 5e-4, math.radians(0.5), 0.02
"""A centre of mass, an angle, a loss below these is not said."""


def hover_sentence(vehicle: str, hover: HoverDiagnosis) -> str:
    """The weight that a twin carries at the logged commands, where its centre of mass seems to be,
    and how its thrust leans; what is within two standard errors of zero is left out."""
    text = (
        f"At the logged commands {vehicle} carries {100 * hover.carried.value:.0f} % of its weight"
    )
    off = _parts(
        (
            (hover.back_m, "further back", "further forward"),
            (hover.right_m, "further to the right", "further to the left"),
        ),
        1e3,
        LEAST_M,
        " mm",
    )
    if off:
        text += f", and turns as if the centre of mass were {joined(off)}"
        if (weak := hover.weakest) is not None and weak.loss.value >= LEAST_LOSS:
            text += f", or as if rotor {weak.rotor} gave {_size(weak.loss, 100, ' %')} less thrust"
    leans = _parts(
        (
            (hover.lean_forward_rad, "forward", "back"),
            (hover.lean_right_rad, "to the right", "to the left"),
        ),
        180 / math.pi,
        LEAST_RAD,
        "°",
    )
    if leans:
        text += f"; the thrust leans {joined(leans)} of where the twin's points"
    return f"{text}."


def _parts(
    means: Sequence[tuple[Mean | None, str, str]], factor: float, least: float, unit: str
) -> list[str]:
    """Each mean that differs from zero, with its direction."""
    return [
        f"{_size(mean, factor, unit)} {forth if mean.value > 0 else back}"
        for mean, forth, back in means
        if mean is not None and mean.clear and abs(mean.value) >= least
    ]


def _size(mean: Mean, factor: float, unit: str) -> str:
    """A mean with twice its standard error."""
    return f"{factor * abs(mean.value):.1f} ± {factor * 2 * mean.sd:.1f}{unit}"


@dataclass(frozen=True, slots=True)
class Kind:
    """A physical quantity.

    Attributes:
        prefix: Its channels begin with it.
        title: Of its figures.
        axes: Names of its axes.
        words: It in a sentence.
        axis: Words for an axis, by its letter.
    """

    prefix: str
    title: str
    axes: str = ""
    words: str = ""
    axis: Mapping[str, str] = field(default_factory=dict)


def _of_sensor(sensor: Sensor) -> Kind:
    """Kind of the readings of a sensor beside the IMU."""
    vector = len(sensor.columns) > 1
    axes, axis = ("body axes", _BODY) if vector else ("", {})
    return Kind(f"{sensor.signal}_", sensor.title, axes, sensor.words, axis)


_BODY = {"x": "forward axis", "y": "right axis", "z": "down axis"}
_TURN = {"x": "roll", "y": "pitch", "z": "yaw"}
_EARTH = {"x": "north", "y": "east", "z": "down"}
_FRD, _ROLL = "body axes: x forward, y right, z down", "body axes: x roll, y pitch, z yaw"
_NED = "x north, y east, z down"
KINDS = (
    Kind("acc_", "Specific force (accelerometer)", _FRD, "specific force", _BODY),
    Kind("gyro_rate_", "Angular acceleration", _ROLL, "angular acceleration", _TURN),
    Kind("gyro_", "Body rates", _ROLL, "body rate", _TURN),
    Kind("vel_", "Velocity", _NED, "velocity", _EARTH),
    Kind("pos_", "Position", _NED, "position", _EARTH),
    Kind("att_", "Attitude", "x roll, y pitch, z yaw", "attitude", _TURN),
    Kind("q_", "Attitude (quaternion)", "body to NED"),
    *(_of_sensor(s) for s in SENSORS if s.group != BODY),
    Kind("", "Other channels"),
)


def describe(channel: str) -> str:
    """A channel's name in words: `acc_z` is the specific force on the down axis."""
    name = channel.split("@")[0]
    kind = kind_of(name)
    axis = kind.axis.get(name.removeprefix(kind.prefix))
    return ", ".join(filter(None, (kind.words or name.replace("_", " "), axis)))


def kind_of(channel: str) -> Kind:
    """The quantity that a channel is of."""
    return next(kind for kind in KINDS if channel.startswith(kind.prefix))


def grouped(channels: Sequence[Channel]) -> list[tuple[Kind, list[Channel]]]:
    """Channels that share a figure: same quantity, same horizon; in the order of `KINDS`."""
    found: dict[tuple[int, float], list[Channel]] = {}
    for channel in channels:
        place = KINDS.index(kind_of(channel.name)), channel.horizon_s
        found.setdefault(place, []).append(channel)
    return [(KINDS[i], found[i, horizon_s]) for i, horizon_s in sorted(found)]


def mode(horizon_s: float) -> str:
    """How the twin was held against the flight, in words; 0: at each instant."""
    return "teacher-forced" if horizon_s == 0 else f"short horizon, {horizon_s:g} s"
