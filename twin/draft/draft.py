"""Flights of an aircraft and what its owner knows of it -> the text of a vehicle file.

Three kinds of numbers: given by the owner, taken from the logs, and usual ones of aircraft and
propellers of that size. Each stands in the file with its source, and with its standard deviation
where `calibrate` and `explain` ask for it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from ..errors import ModelError
from ..logs import Flight
from ..logs.columns import MAX_MOTORS, MIN_MOTORS
from ..representation import short_repr
from ..vehicle.file import parse_vehicle
from ..vehicle.file.draft import Draft
from ..vehicle.file.write import with_effect_sections
from .body import draft_body
from .equipment import draft_battery, draft_sensors, draft_site
from .hover import LEAST_S, Hover, drives, hover_of
from .making import Fact, Known, Making
from .rotors import draft_rotors, rotor_effects

_LEVELS_APART = 1.25
"""Hover commands of one aircraft differ by less: sag takes a tenth."""


@dataclass(frozen=True, slots=True)
class Drafted:
    """A vehicle file in draft.

    Attributes:
        text: Of the file.
        hovers: What the flights tell of the hover, one each.
        level: Command at which they hover, mean over them; speed, rad/s, where they have no
            commands.
        facts: Its numbers in words.
        warnings: What does not fit together.
    """

    text: str
    hovers: tuple[Hover, ...]
    level: float
    facts: tuple[Fact, ...]
    warnings: tuple[str, ...]

    __repr__ = short_repr


def draft(flights: Sequence[Flight], known: Known) -> Drafted:
    """A vehicle file of the aircraft that flew.

    Args:
        flights: Of one aircraft.
        known: What its owner knows.

    Raises:
        ModelError: It is no multirotor, flights are of different ones, one is not in the air for
            2 s, or size or order of the rotors is not known; the text says what to give.
    """
    _check(flights)
    file = Draft(known.name, f"Drafted from {', '.join(f.name for f in flights)}", "")
    m = Making(known, flights, [_hover(f) for f in flights], file)
    _notes(m)
    gravity_m_s2 = draft_site(m)
    layout = draft_body(m)
    supply = draft_rotors(m, layout, gravity_m_s2)
    draft_sensors(m)
    draft_battery(m)
    vehicle = parse_vehicle(file.text(), f"{known.name}.toml")
    text = with_effect_sections(file.text(), vehicle, rotor_effects(m, vehicle, supply))
    return Drafted(text, tuple(m.hovers), m.level, tuple(m.facts), tuple(m.warnings))


def _check(flights: Sequence[Flight]) -> None:
    """Refuse what is no multirotor, or not one."""
    for flight in flights:
        if flight.airframe is not None and flight.airframe.no_multirotor:
            raise ModelError(
                f"{flight.name}: this is no multirotor: {flight.airframe.no_multirotor}. A vehicle "
                f"file describes {MIN_MOTORS} to {MAX_MOTORS} rotors that do not tilt."
            )
        if not drives(flight):
            raise ModelError(
                f"{flight.name}: has neither commands nor speeds of {MIN_MOTORS} or more rotors, "
                "so their thrust is not told. Log actuator_outputs or actuator_motors."
            )
    counts = {f.name: len(drives(f)) for f in flights}
    if len(set(counts.values())) > 1:
        reported = ", ".join(f"{name} {n}" for name, n in counts.items())
        raise ModelError(f"these are different aircraft, by their rotors: {reported}. Draft each.")


def _hover(flight: Flight) -> Hover:
    found = hover_of(flight)
    if found is None:
        raise ModelError(
            f"{flight.name}: it is in the air for less than {LEAST_S:g} s, so the thrust that "
            "carries its weight is not told. Give the log of a flight."
        )
    return found


def _notes(m: Making) -> None:
    """The head of the file, and doubts about flights that hardly are of one aircraft."""
    m.file.notes.append(
        "A draft: what flights and owner tell, and what is usual for an aircraft of this size. "
        "`uavtwin calibrate` and `explain` believe each number as far as its sd goes."
    )
    reported = m.airframe
    if reported.pulse_us is not None:
        low, high = reported.pulse_us.value
        m.file.notes.append(
            f"Commands 0 and 1 are pulses of {low:.0f} and {high:.0f} us: "
            f"{reported.pulse_us.source}."
        )
    if reported.filters:
        m.file.notes.append(
            f"Filters on board that the logged samples have not gone through: {reported.filters}."
        )
    m.file.notes.append("No drag: `explain` finds it in a flight that goes forward.")
    levels = {h.flight: h.level for h in m.hovers}
    if max(levels.values()) > _LEVELS_APART * min(levels.values()):
        each = ", ".join(f"{name} {level:.3g}" for name, level in levels.items())
        m.warnings.append(f"the flights hover at different commands: {each}. One aircraft?")
