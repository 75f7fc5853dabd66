"""Numbers of a draft: facts that are given, facts from flights, and usual ones of that size.

Each usual number is the geometric mean over published aircraft or propellers; its standard
deviation is that of one more of them: the scatter of the logarithms times sqrt(1 + 1/n). None was
fitted to an aircraft whose flights are used in tests of a draft (`feisi_x150` is omitted).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from ..logs import Flight
from ..logs.airframe import Airframe
from ..representation import ShortRepr
from ..vehicle import Array
from ..vehicle_file.write import Draft
from .hover import Hover

Kind = Literal["given", "log", "usual"]


@dataclass(frozen=True, slots=True)
class OwnerFacts:
    """Numbers of an aircraft that its owner gives.

    Attributes:
        name: Name of the vehicle file.
        mass_kg: Mass in flight, battery included.
        frame: Name in `twin.vehicle.layouts.FRAMES`; None: by the logs.
        arm_m: Distance from the centre to the farthest rotor; None: by the logs.
        diameter_m: Diameter of the propellers; None: usual.
        pitch_m: Pitch of the propellers; None: usual.
    """

    name: str
    mass_kg: float
    frame: str | None = None
    arm_m: float | None = None
    diameter_m: float | None = None
    pitch_m: float | None = None


@dataclass(frozen=True, slots=True)
class Fact:
    """A number of a draft in words.

    Attributes:
        what: Name of the quantity.
        value: Value with unit and standard deviation.
        source: Source of the value, as stated in the file.
    """

    what: str
    value: str
    source: str

    @property
    def kind(self) -> Kind:
        """Kind of the source."""
        return kind_of(self.source)


def kind_of(source: str) -> Kind:
    """Kind of a source: the owner, the logs, or usual numbers."""
    if source.startswith("given"):
        return "given"
    return "usual" if source.startswith(("usual", "estimate")) else "log"


@dataclass(slots=True)
class DraftState(ShortRepr):
    """State of a draft in progress.

    Attributes:
        known: Numbers given by the owner.
        flights: Flights of the aircraft.
        hovers: Hover of each flight.
        file: Entries and notes of the vehicle file.
        facts: Numbers of the draft in words.
        warnings: Contradictions that were found.
    """

    known: OwnerFacts
    flights: Sequence[Flight]
    hovers: Sequence[Hover]
    file: Draft
    facts: list[Fact] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    @property
    def airframe(self) -> Airframe:
        """Facts of the aircraft in the logs, each from the first log that contains it."""
        reported = [f.airframe for f in self.flights if f.airframe is not None]
        return Airframe.together(reported)

    @property
    def level(self) -> float:
        """Hover command, mean over the flights; speed where they have no commands."""
        return sum(h.level for h in self.hovers) / len(self.hovers)

    def say(self, what: str, value: str, source: str) -> None:
        """Add a number in words."""
        self.facts.append(Fact(what, value, source))


def rounded(value: float) -> float:
    """The value with as many digits as a draft justifies."""
    return float(f"{float(value):.5g}")


@dataclass(frozen=True, slots=True)
class Usual:
    """A usual number with its relative standard deviation.

    Attributes:
        value: Value in SI units, or a share.
        sd: Standard deviation over the value.
    """

    value: float
    sd: float


@dataclass(frozen=True, slots=True)
class PublishedBody:
    """Mass properties of a published quadrotor.

    Attributes:
        mass_kg: Total mass.
        arm_m: Distance from the centre to a rotor.
        inertia_kg_m2: Moments of inertia Ixx, Iyy, Izz.
        source: Publication with the numbers.
    """

    mass_kg: float
    arm_m: float
    inertia_kg_m2: tuple[float, float, float]
    source: str

    @property
    def gyration(self) -> Array:
        """Radii of gyration about x, y, z over the arm, shape (3,)."""
        return np.sqrt(np.array(self.inertia_kg_m2) / self.mass_kg) / self.arm_m


BODIES = (
    PublishedBody(1.4, 0.225, (0.0211, 0.0219, 0.0366), "built-in copter_default"),
    PublishedBody(0.027, 0.0396, (1.03e-5, 1.11e-5, 1.95e-5), "built-in crazyflie"),
    PublishedBody(0.028, 0.046, (1.657e-5, 1.666e-5, 2.926e-5), "Crazyflie, Foerster 2015"),
    PublishedBody(0.5, 0.17, (3.65e-3, 3.68e-3, 7.03e-3), "Hummingbird, RotorPy"),
    PublishedBody(0.716, 0.17, (7.0e-3, 7.0e-3, 1.2e-2), "Hummingbird, RotorS"),
    PublishedBody(1.0, 0.21, (0.01, 0.01, 0.02), "Pelican, RotorS"),
    PublishedBody(1.5, 0.2555, (0.029125, 0.029125, 0.055225), "Iris, PX4 Gazebo"),
    PublishedBody(2.0, 0.2461, (0.021667, 0.021667, 0.04), "X500, PX4 Gazebo"),
    PublishedBody(0.65, 0.23, (7.5e-3, 7.5e-3, 1.3e-2), "OS4, Bouabdallah 2007"),
)
"""Quadrotors with published mass properties: those of `twin.vehicle.plausibility` except
`feisi_x150`, and OS4. Two sources of one aircraft differ as much as two aircraft."""

PROPELLERS = (
    (0.2032, 0.17, "Hummingbird"),
    (0.254, 0.21, "Pelican"),
    (0.256, 0.2555, "Iris"),
    (0.254, 0.25, "X500"),
    (0.254, 0.225, "F450"),
    (0.3, 0.23, "OS4"),
    (0.046, 0.0396, "Crazyflie"),
    (0.127, 0.11, "racers of 220 mm with 5 inch"),
)
"""Diameter of the propellers, m, arm, m, and name of quadrotors."""

STATIC = (
    (0.254, 0.1194, 0.1185, 0.0480, "APC Slow Flyer 10x4.7, 2 blades"),
    (0.127, 0.09525, 0.1483, 0.1032, "DA4052 5x3.75, 3 blades"),
    (0.127, 0.0801, 0.1085, 0.0622, "NR640 5 inch, 15 degrees, 3 blades"),
    (0.127, 0.1016, 0.1799, 0.1174, "MicroInvent 5x4, 3 blades"),
)
"""Diameter, m, pitch, m, thrust and power coefficients at rest, mean over the measured speeds: UIUC
Propeller Data Site, vols. 1 and 2 (Brandt & Selig, AIAA 2011-1255)."""

_GUESSED_SD = 0.3
"""Relative standard deviation of a guessed inertia, as in the prior of `inertia_error`: the
published ones scatter less, but most are of simulators, which have Ixx = Iyy where aircraft do
not."""
_TORQUE_SD = 0.2
"""Relative standard deviation about the law: its propellers scatter by 5 %, those of other makers
by more; by judgement."""
_PITCH = Usual(0.55, 0.3)
"""Pitch over diameter: 0.33 for 15x5 to 0.9 for 5x4.5."""


def usual_inertia(mass_kg: float, arm_m: float) -> tuple[Array, float]:
    """Ixx, Iyy and Izz of an aircraft by its mass and arm, kg m2, and their relative sd."""
    gyration = [b.gyration for b in BODIES]
    across = _usual([float(np.sqrt(g[0] * g[1])) for g in gyration])
    upright = _usual([float(g[2]) for g in gyration])
    radii = np.array([across.value, across.value, upright.value])
    return mass_kg * (radii * arm_m) ** 2, max(2.0 * max(across.sd, upright.sd), _GUESSED_SD)


def usual_diameter_m(position_m: Array) -> Usual:
    """Usual propeller diameter by the distance of neighbouring rotor hubs, shape (n, 3), m."""
    share = _usual([d / (np.sqrt(2.0) * arm) for d, arm, _ in PROPELLERS])
    places = np.unique(np.round(position_m[:, :2], 6), axis=0)
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    return Usual(share.value * float(apart[apart > 0].min()), share.sd)


def usual_pitch_m(diameter: Usual) -> Usual:
    """Usual pitch of a propeller by its diameter."""
    return Usual(_PITCH.value * diameter.value, float(np.hypot(_PITCH.sd, diameter.sd)))


def usual_torque_per_thrust_m(pitch: Usual) -> Usual:
    """Reaction torque over thrust of a propeller at rest by its pitch, m.

    A propeller that moved through the air like a screw, without slip, would have pitch / (2 pi).
    """
    law = _usual([d * cp / (2.0 * np.pi * ct) / p for d, p, ct, cp, _ in STATIC])
    return Usual(law.value * pitch.value, float(np.hypot(_TORQUE_SD, pitch.sd)))


def _usual(values: Sequence[float]) -> Usual:
    """Geometric mean, and the relative scatter of one more value."""
    logs = np.log(values)
    n = len(logs)
    return Usual(float(np.exp(logs.mean())), float(logs.std(ddof=1) * np.sqrt(1.0 + 1.0 / n)))
