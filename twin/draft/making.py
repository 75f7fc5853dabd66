"""A draft in the making: what is known, the flights, the file, and its numbers in words."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from ..logs import Flight
from ..logs.airframe import Airframe
from ..representation import short_repr
from ..vehicle.file.draft import Draft
from .hover import Hover

Kind = Literal["given", "log", "usual"]


@dataclass(frozen=True, slots=True)
class Known:
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
class Making:
    """What is collected on the way.

    Attributes:
        known: By the owner.
        flights: Of the aircraft.
        hovers: Of the flights, one each.
        file: Entries and notes of the vehicle file.
        facts: The numbers in words.
        warnings: What does not fit together.
    """

    known: Known
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


def percent(share: float) -> str:
    """A share as a file and a person have it."""
    return f"{100 * share:.2g} %"
