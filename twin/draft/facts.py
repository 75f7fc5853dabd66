"""What a draft is made of: facts that are given, facts from flights, and usual ones of that size.

Each law of what is usual is the geometric mean over published aircraft or propellers, its standard
deviation that of one more of them: the scatter of the logarithms times sqrt(1 + 1/n). None has
been fitted to an aircraft whose flights are used in tests of a draft (`feisi_x150` is left out).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from ..logs import Flight
from ..logs.airframe import Airframe
from ..representation import short_repr
from ..vehicle import Array
from ..vehicle_file.write import Draft
from .hover import Hover

Kind = Literal["given", "log", "usual"]


@dataclass(frozen=True, slots=True)
class OwnerFacts:
    """What the owner of an aircraft knows of it.

    Attributes:
        name: Of the vehicle file.
        mass_kg: As it flew, battery included.
        frame: Of `twin.vehicle.layouts.FRAMES`; None: as the logs say.
        arm_m: From the centre to the farthest rotor; None: as the logs say.
        diameter_m: Of the propellers; None: usual.
        pitch_m: Of the propellers; None: usual.
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
        what: The quantity.
        value: With unit and standard deviation.
        source: Where it comes from, as it stands in the file.
    """

    what: str
    value: str
    source: str

    @property
    def kind(self) -> Kind:
        """Who says it."""
        return kind_of(self.source)


def kind_of(source: str) -> Kind:
    """Who says a number of a draft: its owner, the logs, or what is usual."""
    if source.startswith("given"):
        return "given"
    return "usual" if source.startswith(("usual", "estimate")) else "log"


@dataclass(slots=True)
class DraftState:
    """What is collected on the way.

    Attributes:
        known: By the owner.
        flights: Of the aircraft.
        hovers: Of the flights, one each.
        file: Entries and notes of the vehicle file.
        facts: The numbers in words.
        warnings: What does not fit together.
    """

    known: OwnerFacts
    flights: Sequence[Flight]
    hovers: Sequence[Hover]
    file: Draft
    facts: list[Fact] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    __repr__ = short_repr

    @property
    def airframe(self) -> Airframe:
        """What the logs say of the aircraft, each fact by the first log that holds it."""
        reported = [f.airframe for f in self.flights if f.airframe is not None]
        return Airframe.together(reported)

    @property
    def level(self) -> float:
        """Command of the hover, mean over the flights; speed where they have no commands."""
        return sum(h.level for h in self.hovers) / len(self.hovers)

    def say(self, what: str, value: str, source: str) -> None:
        """Add a number in words."""
        self.facts.append(Fact(what, value, source))


def rounded(value: float) -> float:
    """As many digits as a draft is worth."""
    return float(f"{float(value):.5g}")


@dataclass(frozen=True, slots=True)
class Usual:
    """A number that is usual.

    Attributes:
        value: In SI units, or a share.
        sd: Standard deviation over the value.
    """

    value: float
    sd: float


@dataclass(frozen=True, slots=True)
class PublishedBody:
    """Mass properties of a published quadrotor.

    Attributes:
        mass_kg: Of all of it.
        arm_m: From the centre to a rotor.
        inertia_kg_m2: Ixx, Iyy, Izz.
        source: Where they are published.
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
"""Quadrotors whose mass properties are published: those of `twin.vehicle.plausibility` but for
`feisi_x150`, and OS4. Two sources of one aircraft differ as two aircraft do."""

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
"""Diameter of the propellers, m, and arm, m, of quadrotors."""

STATIC = (
    (0.254, 0.1194, 0.1185, 0.0480, "APC Slow Flyer 10x4.7, 2 blades"),
    (0.127, 0.09525, 0.1483, 0.1032, "DA4052 5x3.75, 3 blades"),
    (0.127, 0.0801, 0.1085, 0.0622, "NR640 5 inch, 15 degrees, 3 blades"),
    (0.127, 0.1016, 0.1799, 0.1174, "MicroInvent 5x4, 3 blades"),
)
"""Diameter, m, pitch, m, thrust and power coefficients at rest, mean over the speeds that were
measured: UIUC Propeller Data Site, vols. 1 and 2 (Brandt & Selig, AIAA 2011-1255)."""

_GUESSED_SD = 0.3
"""Of a guessed inertia, as the prior of `inertia_error` has it: the published ones scatter by less,
but most are of simulators, which have Ixx = Iyy where aircraft do not."""
_TORQUE_SD = 0.2
"""Over the law: its propellers scatter by 5 %, those of other makers by more; by judgement."""
_PITCH = Usual(0.55, 0.3)
"""Pitch over diameter: 0.33 of 15x5 to 0.9 of 5x4.5."""


def usual_inertia(mass_kg: float, arm_m: float) -> tuple[Array, float]:
    """Ixx, Iyy and Izz of an aircraft by its mass and arm, kg m2, and their sd over the value."""
    gyration = [b.gyration for b in BODIES]
    across = _usual([float(np.sqrt(g[0] * g[1])) for g in gyration])
    upright = _usual([float(g[2]) for g in gyration])
    radii = np.array([across.value, across.value, upright.value])
    return mass_kg * (radii * arm_m) ** 2, max(2.0 * max(across.sd, upright.sd), _GUESSED_SD)


def usual_diameter_m(position_m: Array) -> Usual:
    """Of the propellers by the distance of neighbours, rotor hubs of shape (n, 3), m."""
    share = _usual([d / (np.sqrt(2.0) * arm) for d, arm, _ in PROPELLERS])
    places = np.unique(np.round(position_m[:, :2], 6), axis=0)
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    return Usual(share.value * float(apart[apart > 0].min()), share.sd)


def usual_pitch_m(diameter: Usual) -> Usual:
    """Of a propeller by its diameter."""
    return Usual(_PITCH.value * diameter.value, float(np.hypot(_PITCH.sd, diameter.sd)))


def usual_torque_per_thrust_m(pitch: Usual) -> Usual:
    """Reaction torque over thrust of a propeller at rest by its pitch, m.

    A propeller that slipped through the air like a screw would have pitch / (2 pi).
    """
    law = _usual([d * cp / (2.0 * np.pi * ct) / p for d, p, ct, cp, _ in STATIC])
    return Usual(law.value * pitch.value, float(np.hypot(_TORQUE_SD, pitch.sd)))


def _usual(values: Sequence[float]) -> Usual:
    """Geometric mean, and the scatter of one more."""
    logs = np.log(values)
    n = len(logs)
    return Usual(float(np.exp(logs.mean())), float(logs.std(ddof=1) * np.sqrt(1.0 + 1.0 / n)))
