"""Wording of effects: clauses of a report, undetected sizes, and advice on manoeuvres."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ..formatting import joined, number, percent, quantity
from ..vehicle import GRAVITY_M_S2

_NEAREST_M = 1e-3
"""Distance of a load from the centre of mass below which none is told: made up."""
Changes = Mapping[str, float]
"""Difference of each number of an effect."""
Clause = Callable[[Changes, bool], str]
"""Clause on a change of an effect, with its own subject, "" without words for it; the flag is True
for a change since a calibration, False for a difference of the aircraft from its file."""
AXES = (("x", "forward", "back"), ("y", "right", "left"), ("z", "down", "up"))
"""Body axis, FRD, and the words for its two directions."""
PLACES = (
    ("x", "further forward", "further back"),
    ("y", "further right", "further left"),
    ("z", "lower", "higher"),
)
"""Body axis, FRD, and the directions of a positive and a negative number."""


@dataclass(frozen=True, slots=True)
class Undetected:
    """Clause on the largest effect that would not be detected.

    Attributes:
        place: Position in the list of such clauses, 1 first.
        text: Text, with {} for the size.
    """

    place: int
    text: str


@dataclass(frozen=True, slots=True)
class Wording:
    """Wording of an effect in a report.

    Attributes:
        clause: Clause on a change of the effect.
        undetected: Clause on an undetected size; None: none.
        largest_alone: Whether only the largest of several numbers is reported.
        secondary: Numbers that are reported only where the others have not changed.
    """

    clause: Clause
    undetected: Undetected | None = None
    largest_alone: bool = False
    secondary: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Advice:
    """Manoeuvre to fly where numbers are undetermined.

    Attributes:
        topic: Subject of the numbers.
        fly: Manoeuvres.
    """

    topic: str
    fly: str


FLY_FOR_THRUST = Advice(
    "thrust and mass",
    "climb and sink briskly for half a minute, and weigh the aircraft (sd of body.mass), or "
    "fly once with a known mass aboard (--payload)",
)
"""Manoeuvre for thrust and mass, which no flight separates."""
FLY_FOR_DRAG = Advice("drag", "fast straight legs, 10 s each way, forward and sideways")
"""Manoeuvre that determines drag."""
FLY_FOR_YAW_TORQUE = Advice("yaw torque", "yaw steps of 90°, quick ones, each way")
"""Manoeuvre that determines yaw torque."""
FLY_FOR_INERTIA = Advice("inertia and lag", "sharp roll and pitch doublets, five of each")
"""Manoeuvre that determines inertia and lag."""
FLY_FOR_BATTERY_SAG = Advice("battery sag", "one flight that takes the battery from full to low")
"""Manoeuvre that determines battery sag."""
FLY_FOR_CENTRE_OF_MASS = Advice(
    "centre of mass", "hover for a minute, and turn on the spot meanwhile"
)
FLY_FOR_COMPASS = Advice("compass", "turn through a full circle in hover, slowly, twice")
"""Manoeuvre that determines compass errors."""
ADVICE = (
    FLY_FOR_THRUST,
    FLY_FOR_DRAG,
    FLY_FOR_YAW_TORQUE,
    FLY_FOR_INERTIA,
    FLY_FOR_BATTERY_SAG,
    FLY_FOR_CENTRE_OF_MASS,
    FLY_FOR_COMPASS,
)
"""All advice, in the order in which it is printed."""


def rotor_clause(change: Changes, since: bool) -> str:
    """Clause on thrust lost by single rotors."""
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


def mass_clause(change: Changes, since: bool) -> str:
    """Clause on a change of mass."""
    kg = change.get("mass_kg", 0.0)
    size = quantity(abs(kg), "kg")
    if since:
        return f"it carries {size} more" if kg > 0 else f"it is {size} lighter"
    return f"it is {size} {'heavier' if kg > 0 else 'lighter'} than the model"


def place_clause(change: Changes, since: bool) -> str:
    """Clause on a change of the centre of mass."""
    parts = []
    for axis, *ways in AXES if since else PLACES:
        shift = change.get(f"{axis}_m", 0.0)
        if shift:
            parts.append(f"{number(1e3 * abs(shift))} mm {ways[0 if shift > 0 else 1]}")
    if since:
        return f"its centre of mass has moved {joined(parts)}"
    return f"its centre of mass is {joined(parts)} than in the model"


def payload_clause(change: Changes, since: bool) -> str:
    """Clause on a load strapped on."""
    del since
    kg = change.get("mass_kg", 0.0)
    moment = [change.get(f"moment_{a}_kg_m", 0.0) for a in "xyz"]
    away = [
        f"{number(1e3 * abs(m) / kg)} mm {ways[0 if m > 0 else 1]}"
        for m, (_, *ways) in zip(moment, AXES, strict=True)
        if kg > 0 and abs(m) >= kg * _NEAREST_M
    ]
    if kg > 0:
        return f"it carries {quantity(kg, 'kg')} more" + (f", {joined(away)}" if away else "")
    sides = [ways[0 if m > 0 else 1] for m, (_, *ways) in zip(moment, AXES, strict=True) if m]
    return f"it carries a load {joined(sides)} of the centre of mass" if sides else ""


def load_clause(change: Changes, since: bool) -> str:
    """Clause on a slung load."""
    del since
    return f"a load of {quantity(change.get('mass_kg', 0.0), 'kg')} hangs below it on a rope"


def wind_clause(change: Changes, since: bool) -> str:
    """Clause on a steady wind."""
    speed = f"{number(float(np.linalg.norm(list(change.values()))))} m/s"
    return f"the wind has changed by {speed}" if since else f"a wind of {speed}"


def reading_clause(what: str, unit: str) -> Clause:
    """Function for clauses on the bias of a sensor with three axes."""

    def made(change: Changes, since: bool) -> str:
        """Clause on a bias."""
        more, less = ("more", "less") if since else ("too much", "too little")
        parts = []
        for axis in "xyz":
            v = next((v for k, v in change.items() if k.startswith(f"{axis}_")), 0.0)
            if v:
                parts.append(f"{quantity(abs(v), unit)} {more if v > 0 else less} in {axis}")
        return f"its {what} reads {joined(parts)}" + (" than it did" if since else "")

    return made


def delay_clause(what: str) -> Clause:
    """Function for clauses on a late signal."""

    def made(change: Changes, since: bool) -> str:
        """Clause on a delay."""
        delay = max(change.values(), key=abs, default=0.0)
        way = "later" if delay > 0 else "earlier"
        before = "at calibration" if since else "modelled"
        return f"{what} {number(1e3 * abs(delay))} ms {way} than {before}"

    return made


def heading_clause(change: Changes, since: bool) -> str:
    """Clause on an error of the heading."""
    turn = np.degrees(max(change.values(), key=abs, default=0.0))
    return f"its heading is off by {'another ' * since}{number(float(turn))}°"


def factor_clause(what: str, noun: str) -> Clause:
    """Function for clauses on a factor on thrust or torque of the rotors."""

    def made(change: Changes, since: bool) -> str:
        """Clause on a factor."""
        v = max(change.values(), key=abs, default=0.0)
        more = "more" if v > 0 else "less"
        return f"{what} {percent(abs(v))} {more} {noun} than {'before' if since else 'the model'}"

    return made


def inertia_clause(change: Changes, since: bool) -> str:
    """Clause on a change of inertia."""
    axes = {"scale_x": "roll", "scale_y": "pitch", "scale_z": "yaw"}
    parts = [
        f"{percent(abs(v))} {'larger' if v > 0 else 'smaller'} in {axes[k]}"
        for k, v in change.items()
    ]
    return f"its inertia is {joined(parts)} than {'before' if since else 'that of the model'}"


def drag_clause(change: Changes, since: bool) -> str:
    """Clause on linear drag."""
    parts = [
        f"{number(change[name])} (m/s²)/(m/s) {what}"
        for name, what in (("k_xy_1_s", "horizontal"), ("k_z_1_s", "vertical"))
        if change.get(name)
    ]
    return f"{'linear drag has changed by ' * since}{joined(parts)}" if parts else ""


def flapping_clause(change: Changes, since: bool) -> str:
    """Clause on discs that tilt back, by the equivalent drag in hover."""
    if not (tilt := change.get("k_rad_s_m")):
        return ""
    drag = f"{number(tilt * GRAVITY_M_S2)} (m/s²)/(m/s) horizontal"
    return f"{'drag by flapping has changed by ' * since}{drag}"


def cant_clause(change: Changes, since: bool) -> str:
    """Clause on a constant yaw moment of canted rotors."""
    del since
    yaw = change.get("yaw_m", 0.0)
    way = "clockwise" if yaw > 0 else "counter-clockwise"
    return (
        f"its rotors are canted and turn it {way} by {number(1e3 * abs(yaw))} mN m per N of thrust"
    )


def sag_clause(change: Changes, since: bool) -> str:
    """Clause on thrust lost with battery voltage."""
    slope = change.get("slope", 0.0)
    more = "more" if slope > 0 else "less"
    before = "before" if since else "the model's"
    return f"each 1 % of battery voltage costs {number(abs(slope))} % {more} thrust than {before}"
