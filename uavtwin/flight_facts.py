"""What a colleague reads first in a log: the kind of aircraft, its hover, its battery."""

from typing import Any

import numpy as np

from twin.draft import Hover, drives
from twin.errors import LogError
from twin.logs import AnyFlight
from twin.residuals.flight_gap import diagnosis_of
from twin.residuals.hover import HoverDiagnosis
from twin.vehicle import Vehicle
from twin.vehicle.layouts import Layout

from .report.hover import hover_sentence
from .vehicle_draft import hover_drive

_FLOWN_V = 1.0
_LEAST_SPLIT = 1.5
"""Percent between sides from which on it is said."""


def aircraft_facts(flight: AnyFlight, hover: Hover | None) -> dict[str, str]:
    """Kind of aircraft, command in hover, split between the motors, voltage; what is told.

    Args:
        flight: The flight.
        hover: Its hover; None: it has none.
    """
    facts = {"kind": _kind(flight)}
    if hover is not None:
        facts["hover"] = f"{_level(hover)} ({hover.where})"
        facts["motors"] = _split(hover, flight.airframe.layout if flight.airframe else None)
    elif drives(flight):
        facts["hover"] = "none: less than 2 s in the air"
    if flight.has("vbat_v"):
        facts["battery"] = _voltage(flight, hover)
    return facts


def hover_json(hover: Hover, diagnosis: HoverDiagnosis | None) -> dict[str, Any]:
    """A hover as numbers, and the diagnosis of a twin in it."""
    volts = hover.voltage_v
    return {
        "drive": "command" if hover.cmd is not None else "rotor_speed",
        "level": hover.level,
        "each": list(hover.each),
        "split": list(hover.split),
        "seconds": hover.seconds,
        "hovers": hover.hovers,
        "voltage_v": None if volts is None else float(np.median(volts)),
        "twin": None if diagnosis is None else diagnosis.json(),
    }


def hover_beside(
    flight: AnyFlight, hover: Hover | None, vehicle: Vehicle
) -> tuple[dict[str, str], HoverDiagnosis | None]:
    """The hover of a flight beside that of a vehicle, and the diagnosis of its twin.

    Raises:
        LogError: The flight cannot be compared with the vehicle.
    """
    if hover is None:
        return {f"hover of {vehicle.name}": "nothing to compare: the flight has none"}, None
    if hover.motors != vehicle.rotors.count:
        raise LogError(
            f"{flight.name}: {hover.motors} rotors; {vehicle.name} has {vehicle.rotors.count}."
        )
    facts = {}
    driven = "command" if hover.cmd is not None else "rotor_speed"
    if vehicle.drive == driven:
        own, told = hover_drive(vehicle), hover.level
        facts[f"hover of {vehicle.name}"] = (
            f"{own:.3g} for its {vehicle.mass_kg:.4g} kg; the flight {told:.3g}"
        )
    diagnosis = diagnosis_of(flight, vehicle, hover)
    if diagnosis is not None:
        facts["side by side"] = hover_sentence(vehicle.name, diagnosis)
    return facts, diagnosis


def _kind(flight: AnyFlight) -> str:
    """What flew, and what says so."""
    told, motors = flight.airframe, len(drives(flight))
    if told is not None and told.no_multirotor:
        return f"this is no multirotor: {told.no_multirotor}"
    if told is None:
        return f"{motors} rotors, by the columns" if motors else "not known"
    if told.rotors is None:
        return f"{motors} rotors, by the outputs" if motors else "not known"
    kind = f"multirotor with {told.rotors.value} rotors ({told.rotors.source})"
    return kind if told.layout is None else f"{kind}; {told.layout.source}"


def _level(hover: Hover) -> str:
    """Median of the mean of the motors."""
    if hover.cmd is not None:
        return f"command {hover.level:.3f}"
    return f"rotor speed {hover.level:.4g} rad/s"


def _split(hover: Hover, layout: Layout | None) -> str:
    """How much each motor does over their mean, and pairs of them over the others."""
    each = np.array(hover.split)
    shares = (f"{k} {round(100 * u):+d} %" for k, u in enumerate(each, start=1))
    text = f"motor {', '.join(shares)} from their mean"
    if layout is None or layout.count != len(each):
        return text
    x, y = layout.position[:, 0], layout.position[:, 1]
    for side, names in (
        (-x, ("rear", "front")),
        (y, ("right", "left")),
        (layout.direction, ("clockwise ones", "counter-clockwise ones")),
    ):
        more = 100 * float(each[side > 0].mean() - each[side < 0].mean())
        if abs(more) >= _LEAST_SPLIT:
            high, low = names if more > 0 else names[::-1]
            text += f"; {high} {abs(more):.0f} % above {low}"
    return text


def _voltage(flight: AnyFlight, hover: Hover | None) -> str:
    """Range of what was logged with a battery connected, and in hover."""
    volts = flight.signal(("vbat_v",))[1][:, 0]
    volts = volts[volts > _FLOWN_V]
    if not len(volts):
        return "none: never above 1 V"
    text = f"{volts.min():.2f} to {volts.max():.2f} V"
    if hover is not None and hover.voltage_v is not None:
        text += f", {np.median(hover.voltage_v):.2f} V in hover"
    cells = flight.airframe.cells if flight.airframe is not None else None
    return text if cells is None else f"{text}; {cells.value.count} cells ({cells.source})"
