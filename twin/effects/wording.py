"""Words for effects: clauses of a report, what would not show, and what to fly."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ..formatting import joined, number, percent, quantity
from ..vehicle import GRAVITY_M_S2

Changes = Mapping[str, float]
"""By number of an effect, by how much it differs."""
Clause = Callable[[Changes, bool], str]
"""A change of an effect as a clause with its own subject, "" for one it has no words for; whether
it is one since a calibration, else that is how the aircraft is, compared with its file."""
AXES = (("x", "forward", "back"), ("y", "right", "left"), ("z", "down", "up"))
"""Axis of the body, FRD, and the words for its two ways."""
PLACES = (
    ("x", "further forward", "further back"),
    ("y", "further right", "further left"),
    ("z", "lower", "higher"),
)
"""Which way a positive and a negative number point, body frame, FRD."""


@dataclass(frozen=True, slots=True)
class Undetected:
    """A clause about the largest effect that would not show.

    Attributes:
        place: In the list of those, 1 first.
        text: With {} for the size.
    """

    place: int
    text: str


@dataclass(frozen=True, slots=True)
class Wording:
    """How a report speaks of an effect.

    Attributes:
        clause: A change of it.
        undetected: What would not show; None: nothing is said of that.
        largest_alone: Whether of several numbers the largest alone is given.
        secondary: Numbers that are given only where the others have not changed.
    """

    clause: Clause
    undetected: Undetected | None = None
    largest_alone: bool = False
    secondary: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Advice:
    """What to fly where numbers are undetermined.

    Attributes:
        topic: What the numbers are about.
        fly: Manoeuvres.
    """

    topic: str
    fly: str


FLY_FOR_THRUST = Advice(
    "thrust and mass",
    "climb and sink briskly for half a minute, and weigh the aircraft (sd of body.mass), or "
    "fly once with a known mass aboard (--payload)",
)
"""For thrust and mass, which no flight tells apart."""
FLY_FOR_DRAG = Advice("drag", "fast straight legs, 10 s each way, forward and sideways")
"""How to fly for it."""
FLY_FOR_YAW_TORQUE = Advice("yaw torque", "yaw steps of 90°, quick ones, each way")
"""How to fly for it."""
FLY_FOR_INERTIA = Advice("inertia and lag", "sharp roll and pitch doublets, five of each")
"""How to fly for it."""
FLY_FOR_BATTERY_SAG = Advice("battery sag", "one flight that takes the battery from full to low")
"""How to fly for it."""
FLY_FOR_CENTRE_OF_MASS = Advice(
    "centre of mass", "hover for a minute, and turn on the spot meanwhile"
)
FLY_FOR_COMPASS = Advice("compass", "turn through a full circle in hover, slowly, twice")
"""How to fly for it."""
ADVICE = (
    FLY_FOR_THRUST,
    FLY_FOR_DRAG,
    FLY_FOR_YAW_TORQUE,
    FLY_FOR_INERTIA,
    FLY_FOR_BATTERY_SAG,
    FLY_FOR_CENTRE_OF_MASS,
    FLY_FOR_COMPASS,
)
"""All of it, in the order in which it is given."""


def rotor_clause(change: Changes, since: bool) -> str:
    """Thrust lost by single rotors. See `Clause`."""
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
    """Another mass. See `Clause`."""
    kg = change.get("mass_kg", 0.0)
    size = quantity(abs(kg), "kg")
    if since:
        return f"it carries {size} more" if kg > 0 else f"it is {size} lighter"
    return f"it is {size} {'heavier' if kg > 0 else 'lighter'} than the model"


def place_clause(change: Changes, since: bool) -> str:
    """Another centre of mass. See `Clause`."""
    parts = []
    for axis, *ways in AXES if since else PLACES:
        shift = change.get(f"{axis}_m", 0.0)
        if shift:
            parts.append(f"{number(1e3 * abs(shift))} mm {ways[0 if shift > 0 else 1]}")
    if since:
        return f"its centre of mass has moved {joined(parts)}"
    return f"its centre of mass is {joined(parts)} than in the model"


def payload_clause(change: Changes, since: bool) -> str:
    """A load strapped on. See `Clause`."""
    del since
    kg = change.get("mass_kg", 0.0)
    moment = [change.get(f"moment_{a}_kg_m", 0.0) for a in "xyz"]
    away = [
        f"{number(1e3 * abs(m) / kg)} mm {ways[0 if m > 0 else 1]}"
        for m, (_, *ways) in zip(moment, AXES, strict=True)
        if kg > 0 and m
    ]
    if kg > 0:
        return f"it carries {quantity(kg, 'kg')} more" + (f", {joined(away)}" if away else "")
    sides = [ways[0 if m > 0 else 1] for m, (_, *ways) in zip(moment, AXES, strict=True) if m]
    return f"it carries a load {joined(sides)} of the centre of mass" if sides else ""


def load_clause(change: Changes, since: bool) -> str:
    """A slung load. See `Clause`."""
    del since
    return f"a load of {quantity(change.get('mass_kg', 0.0), 'kg')} hangs below it on a rope"


def wind_clause(change: Changes, since: bool) -> str:
    """A steady wind. See `Clause`."""
    speed = f"{number(float(np.linalg.norm(list(change.values()))))} m/s"
    return f"the wind has changed by {speed}" if since else f"a wind of {speed}"


def reading_clause(what: str, unit: str) -> Clause:
    """A bias of a sensor with three axes. See `Clause`."""

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


def delay_clause(what: str) -> Clause:
    """Something that comes late. See `Clause`."""

    def made(change: Changes, since: bool) -> str:
        """See `Clause`."""
        delay = max(change.values(), key=abs, default=0.0)
        way = "later" if delay > 0 else "earlier"
        before = "at calibration" if since else "modelled"
        return f"{what} {number(1e3 * abs(delay))} ms {way} than {before}"

    return made


def heading_clause(change: Changes, since: bool) -> str:
    """An error of the heading. See `Clause`."""
    turn = np.degrees(max(change.values(), key=abs, default=0.0))
    return f"its heading is off by {'another ' * since}{number(float(turn))}°"


def factor_clause(what: str, noun: str) -> Clause:
    """A factor on what the rotors give. See `Clause`."""

    def made(change: Changes, since: bool) -> str:
        """See `Clause`."""
        v = max(change.values(), key=abs, default=0.0)
        more = "more" if v > 0 else "less"
        return f"{what} {percent(abs(v))} {more} {noun} than {'before' if since else 'the model'}"

    return made


def inertia_clause(change: Changes, since: bool) -> str:
    """Another inertia. See `Clause`."""
    axes = {"scale_x": "roll", "scale_y": "pitch", "scale_z": "yaw"}
    parts = [
        f"{percent(abs(v))} {'larger' if v > 0 else 'smaller'} in {axes[k]}"
        for k, v in change.items()
    ]
    return f"its inertia is {joined(parts)} than {'before' if since else 'that of the model'}"


def drag_clause(change: Changes, since: bool) -> str:
    """Linear drag. See `Clause`."""
    parts = [
        f"{number(change[name])} (m/s²)/(m/s) {what}"
        for name, what in (("k_xy_1_s", "horizontal"), ("k_z_1_s", "vertical"))
        if change.get(name)
    ]
    return f"{'linear drag has changed by ' * since}{joined(parts)}" if parts else ""


def flapping_clause(change: Changes, since: bool) -> str:
    """Discs that tilt back, by the drag that this is in hover. See `Clause`."""
    if not (tilt := change.get("k_rad_s_m")):
        return ""
    drag = f"{number(tilt * GRAVITY_M_S2)} (m/s²)/(m/s) horizontal"
    return f"{'drag by flapping has changed by ' * since}{drag}"


def cant_clause(change: Changes, since: bool) -> str:
    """A constant yaw moment of canted rotors. See `Clause`."""
    del since
    yaw = change.get("yaw_m", 0.0)
    way = "clockwise" if yaw > 0 else "counter-clockwise"
    return (
        f"its rotors are canted and turn it {way} by {number(1e3 * abs(yaw))} mN m per N of thrust"
    )


def sag_clause(change: Changes, since: bool) -> str:
    """Thrust lost with battery voltage. See `Clause`."""
    slope = change.get("slope", 0.0)
    more = "more" if slope > 0 else "less"
    before = "before" if since else "the model's"
    return f"each 1 % of battery voltage costs {number(abs(slope))} % {more} thrust than {before}"
