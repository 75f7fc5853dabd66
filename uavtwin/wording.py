"""Wording of effects, hover and channels: the same sentences in every verb."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from twin.effects import EFFECTS
from twin.effects.wording import Changes
from twin.formatting import joined, percent, quantity, title
from twin.physics.sensors.table import BODY, SENSORS, Sensor
from twin.residuals.flight_gap import HoverDiagnosis, Mean
from twin.residuals.gap import Channel
from twin.residuals.teacher_forced import COMMANDS, SPEEDS

if TYPE_CHECKING:
    from twin.explain.inference.detection import Detectable

MOST_BLIND = 3
"""Largest number of effects with a detection limit."""
SMALL = 0.25
"""Share of the largest change of its kind below which a change is not mentioned."""


def said(effect: str, change: Changes, since: bool) -> str:
    """Size of an effect, a clause with its own subject.

    Args:
        effect: Identifier.
        change: Change of each of its numbers, from no effect or from a calibration.
        since: Whether it is a change since a calibration; else a difference of the aircraft from
            its file.
    """
    return clause(effect, change, since) or _plain(effect, change)


def clause(effect: str, change: Changes, since: bool) -> str:
    """The clause of an effect; "" where there are only numbers. Arguments as in `said`."""
    wording = EFFECTS[effect].wording
    large = said_numbers(effect, change)
    return wording.clause(large, since) if wording and large else ""


def said_numbers(effect: str, change: Changes) -> dict[str, float]:
    """The changes that a clause gives as numbers: in each unit none that is small relative to the
    largest, and for an effect with one headline number only the largest."""
    wording = EFFECTS[effect].wording
    secondary = wording.secondary if wording else ()
    change = {n: v for n, v in change.items() if n not in secondary} or change
    units = {name: unit_of(effect, name) for name in change}
    most = {u: max(abs(v) for n, v in change.items() if units[n] == u) for u in units.values()}
    large = {n: v for n, v in change.items() if v and abs(v) > SMALL * most[units[n]]}
    if wording and wording.largest_alone and large:
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


_UNDETECTED = dict(
    sorted(
        (
            (name, e.wording.undetected)
            for name, e in EFFECTS.items()
            if e.wording and e.wording.undetected
        ),
        key=lambda item: item[1].place,
    )
)
"""Clauses on undetected effects, by effect."""
BLIND_ORDER = tuple(_UNDETECTED)
"""Effects with such a clause, in order."""


def blind_clause(effect: str, value: float, unit: str, since: bool) -> str:
    """Clause on the largest effect that would not be detected.

    Args:
        effect: One of `BLIND_ORDER`.
        value: Smallest detectable value, a change from no effect.
        unit: SI unit.
        since: Whether it is a change since a calibration.
    """
    size = percent(value) if unit == "1" else quantity(value, unit)
    text = _UNDETECTED[effect].text.format(size)
    return text.replace("that is off by", "that has changed by") if since else text


def drive_sentence(driven_by: Mapping[str, str]) -> str:
    """Text on the input of the twins of flights; "" without flights, or without a choice.

    Args:
        driven_by: Input of the twin, by flight; see `twin.residuals.teacher_forced.driven_by`.
    """
    flights = {w: [f for f, own in driven_by.items() if own == w] for w in driven_by.values() if w}
    if {*flights} == {COMMANDS}:
        return ""
    if len(flights) < 2:
        return "".join(f"The twin is driven by {what}." for what in flights)
    parts = [f"that of {joined(names)} by {what}" for what, names in flights.items()]
    return f"Twins are driven differently: {'; '.join(parts)}."


LEAST_M, LEAST_RAD, LEAST_LOSS = 5e-4, math.radians(0.5), 0.02
"""Smallest shift of the centre of mass, angle and loss that are mentioned."""


BY_BATTERY = ((3.5 / 3.85) ** 2, (4.2 / 3.85) ** 2)
"""Range of thrust at a command over that at half charge, 0.83 to 1.19: it is proportional to the
square of the speed (Leishman, Principles of Helicopter Aerodynamics, 2006, ch. 2.2), the speed to
the voltage: 3.5 V of an empty, 4.2 V of a full cell. A twin that carries a smaller or larger share
of its weight has another mass or thrust than the aircraft."""


def misfit(carried: float | None, vehicle: str, others: int = 0) -> str:
    """Reason why a vehicle file does not fit an aircraft; "" where it does, or is unknown.

    Args:
        carried: Thrust of the twin over its weight, at the commands of a flight.
        vehicle: Name of the file.
        others: Number of other flights that the file fits, if they are the majority.
    """
    if carried is None or BY_BATTERY[0] <= carried <= BY_BATTERY[1]:
        return ""
    way = (
        f"It fits the {others} others: check what was different, payload, rotors or battery."
        if others
        else "Correct its mass or thrust, or draft a file: uavtwin vehicle draft."
    )
    return (
        f"{vehicle} does not fit this {'flight' if others else 'aircraft'}: at the commands of the "
        f"flight it carries {100 * carried:.0f} % of its weight, and no charge of the battery "
        f"explains that. {way}"
    )


def weightless(acc_z: float, vehicle: str) -> str:
    """Reason why an accelerometer tells nothing about a vehicle's weight.

    Args:
        acc_z: Mean specific force along z in flight, m/s^2.
        vehicle: Name of the vehicle file.
    """
    return (
        f"The accelerometer is probably wrong, not {vehicle}: acc_z has a mean of {acc_z:.3g} m/s² "
        f"in flight, where an aircraft has about -9.8. Correct its sign (axes FRD) or its unit."
    )


def hover_sentence(vehicle: str, hover: HoverDiagnosis, driven_by: str = COMMANDS) -> str:
    """Text on the weight that a twin carries at the logged commands, the apparent centre of mass,
    and the tilt of the thrust; values within two standard errors of zero are omitted."""
    text = (
        f"At the {SPEEDS if driven_by == SPEEDS else 'logged commands'} {vehicle} "
        f"carries {100 * hover.carried.value:.0f} % of its weight"
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
        prefix: Prefix of the names of its channels.
        title: Title of its figures.
        axes: Names of its axes.
        words: Name of the kind in a sentence.
        axis: Words for an axis, by its letter.
    """

    prefix: str
    title: str
    axes: str = ""
    words: str = ""
    axis: Mapping[str, str] = field(default_factory=dict)


def _of_sensor(sensor: Sensor) -> list[Kind]:
    """Kinds of the rates of change and the readings of a sensor."""
    if len(sensor.columns) == 1:
        axes, axis = "", {}
    elif sensor.rate is not None:
        axes, axis = _ROLL, TURNS
    else:
        axes, axis = _FRD if sensor.group == BODY else "body axes", _BODY
    of_rate = [] if sensor.rate is None else [("rate_", sensor.rate.title, sensor.rate.words)]
    return [
        Kind(f"{sensor.signal}_{rate}", title, axes, words, axis)
        for rate, title, words in (*of_rate, ("", sensor.title, sensor.words))
    ]


_BODY = {"x": "forward axis", "y": "right axis", "z": "down axis"}  # words for axes
TURNS = {"x": "roll", "y": "pitch", "z": "yaw"}
"""Words for rotations, by axis."""
_EARTH = {"x": "north", "y": "east", "z": "down"}
"""Words for axes, by letter: body, rotations, NED."""
_FRD, _ROLL = "body axes: x forward, y right, z down", "body axes: x roll, y pitch, z yaw"
"""Titles of the axes of figures in body axes."""
_NED = "x north, y east, z down"
"""Titles of the axes of figures in NED."""
KINDS = (
    *(kind for s in SENSORS if s.group == BODY for kind in _of_sensor(s)),
    Kind("vel_", "Velocity", _NED, "velocity", _EARTH),
    Kind("pos_", "Position", _NED, "position", _EARTH),
    Kind("att_", "Attitude", "x roll, y pitch, z yaw", "attitude", TURNS),
    Kind("q_", "Attitude (quaternion)", "body to NED"),
    *(kind for s in SENSORS if s.group != BODY for kind in _of_sensor(s)),
    Kind("", "Other channels"),
)
"""Kinds in the order of the pages; the first one with a matching prefix is used."""


def describe(channel: str) -> str:
    """A channel's name in words: `acc_z` is the specific force on the down axis."""
    name = channel.split("@")[0]
    kind = kind_of(name)
    axis = kind.axis.get(name.removeprefix(kind.prefix))
    return ", ".join(filter(None, (kind.words or name.replace("_", " "), axis)))


def kind_of(channel: str) -> Kind:
    """The quantity of a channel."""
    return next(kind for kind in KINDS if channel.startswith(kind.prefix))


def grouped(channels: Sequence[Channel]) -> list[tuple[Kind, list[Channel]]]:
    """Channels that share a figure: same quantity, same horizon; in the order of `KINDS`."""
    found: dict[tuple[int, float], list[Channel]] = {}
    for channel in channels:
        place = KINDS.index(kind_of(channel.name)), channel.horizon_s
        found.setdefault(place, []).append(channel)
    return [(KINDS[i], found[i, horizon_s]) for i, horizon_s in sorted(found)]


def mode(horizon_s: float) -> str:
    """Kind of comparison between twin and flight, in words; 0: at each instant."""
    return "teacher-forced" if horizon_s == 0 else f"short horizon, {horizon_s:g} s"


def undetermined(none: Sequence[str], unsized: Sequence[str]) -> str:
    """Sentences on effects without a number for a headline; with a leading blank.

    Args:
        none: Effects whose intervals contain "no effect".
        unsized: Effects whose numbers depend more on the prior than on the flights.
    """
    text = ""
    if none:
        them = "it" if len(none) == 1 else "them"
        names = joined([title(e) for e in none])
        text += f" {names.capitalize()} may be zero: these flights do not determine {them}."
    if unsized:
        names, verb = joined([title(e) for e in unsized]), "is" if len(unsized) == 1 else "are"
        text += f" These flights do not determine how large {names} {verb}."
    return text


def undetectable(smallest: "Mapping[str, Detectable]", usual: Mapping[str, float]) -> str:
    """Effects that flights would not show at a usual size; with a leading blank, "" for none.

    Args:
        smallest: Smallest detectable change, by effect.
        usual: Prior standard deviation, by "effect.number".
    """
    parts = [
        f"{title(e)} of any size"
        if d.value is None
        else blind_clause(e, d.value, d.unit, since=False)
        for e in BLIND_ORDER
        if (d := smallest.get(e)) and (d.value is None or d.value > usual[d.number])
    ]
    return _would_not_show(parts)


def blind(smallest: "Mapping[str, Detectable]", since: bool, axes: str = "") -> str:
    """Detection limits of effects, and undetermined numbers; with a leading blank, "" where nothing
    is known.

    Args:
        smallest: Smallest detectable change, by effect.
        since: Whether it is a change since a calibration.
        axes: Axes of "xyz" about which no flight has rotations.
    """
    known = {e: smallest[e] for e in BLIND_ORDER if e in smallest}
    texts = [
        blind_clause(e, d.value, d.unit, since) for e, d in known.items() if d.value is not None
    ]
    text = _would_not_show(texts[:MOST_BLIND])
    if axes:
        turns = joined([TURNS[a] for a in axes])
        text += f" These flights do not tell how the aircraft answers in {turns}: "
        text += "nothing asks for it."
    return text


def _would_not_show(effects: list[str]) -> str:
    """A sentence with a leading blank, "" for none."""
    text = joined(effects, "or")
    return f" {text[0].upper()}{text[1:]} would not show in these flights." if text else ""
