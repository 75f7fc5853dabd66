"""What a vehicle file adds: places of the rotors, mass, and what was usual when it was calibrated.

The mean residuals of the twin, up to a sudden event, are held against those of the calibration, by
the law of `explain --since`; what a log knows per mass or per thrust is then in kilograms or
newtons.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from msgspec import structs

from ..effects import EFFECTS
from ..errors import LogError
from ..explain.balance import CAUSES, Normal, balance_of, trim_of
from ..explain.model.model import model_of
from ..formatting import number
from ..logs import Flight
from ..logs.airframe import Airframe
from ..vehicle import Vehicle
from ..vehicle.layouts import Layout, frame, frames_of
from .balance import SURE, findings_of
from .findings import Findings
from .flight import FlightFrame
from .records import Event, Severity

CALM_S = 3.0
"""Left out after take-off, and before landing or a loss of control."""
LEAST_S = 8.0
"""Of a part whose means are compared."""
FIT_SHARE, FIT_LEAST = 0.5, 0.6
"""Share of the correlation of the best usual frame that the rotors of a vehicle file have to reach,
and the least correlation that judges. By judgement."""
MISFIT = (
    "this vehicle file does not fit: the aircraft turns as if its rotors were in the order of "
    "another frame. Correct [rotors], or draft a file: uavtwin vehicle draft."
)
"""Said where they do not reach it."""


def layout_of(vehicle: Vehicle) -> Layout:
    """Places and senses of a vehicle's rotors."""
    rotors = vehicle.rotors
    return Layout(rotors.position_m, rotors.direction, True, 0.0, "the vehicle file")


def of_vehicle(flight: Flight, vehicle: Vehicle) -> Flight:
    """The flight with the rotors of a vehicle file, whatever its log says of them."""
    known = Airframe() if flight.airframe is None else flight.airframe
    return replace(flight, airframe=replace(known, layout=layout_of(vehicle)))


def misfit(flight: FlightFrame) -> str:
    """Why the rotors of a flight are not those of the aircraft; "": they may be."""
    layout = flight.layout
    usual = () if layout is None else frames_of(layout.count)
    if layout is None or not usual:
        return ""
    best = max(flight.turning_explained(frame(name)) for name in usual)
    own = flight.turning_explained(layout)
    return MISFIT if best > FIT_LEAST and own < FIT_SHARE * best else ""


class Since:
    """What has changed since a vehicle was calibrated.

    Attributes:
        vehicle: The file; without a calibration nothing was usual.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self.vehicle = vehicle

    def changed(self, flight: FlightFrame, until_s: float) -> Findings:
        """Balance of forces and moments, and notes on the file.

        Args:
            flight: With the rotors of the file.
            until_s: When something sudden began; infinity: nothing did.
        """
        known, name = self.vehicle.calibration, self.vehicle.name
        found, note = Findings(), misfit(flight)
        if not note and (known is None or not known.means):
            note = f"{name} holds no calibration: nothing is known of what was usual before"
        if not note and known is not None:
            note = f"compared with the calibration of {name} on {len(known.flights)} flights"
            try:
                found = self._balance(flight, until_s)
            except LogError as error:
                note = f"not compared with the calibration of {name}: {error}"
        return replace(found, notes=(note,))

    def _balance(self, flight: FlightFrame, until_s: float) -> Findings:
        """Of the longest part under control, before something sudden.

        Raises:
            LogError: It does not show the balance.
        """
        spans = [(flight.t_s[p.start], flight.t_s[p.flown - 1]) for p in flight.airborne]
        calm = [(a + CALM_S, min(b, until_s) - CALM_S) for a, b in spans]
        start, end = max(calm, key=lambda span: span[1] - span[0], default=(0.0, 0.0))
        if end - start < LEAST_S:
            raise LogError(f"less than {LEAST_S:g} s of calm flight")
        effects = [EFFECTS[name] for name in (*CAUSES, "steady_wind")]
        flown = flight.flight.between(float(start), float(end))
        trim = trim_of(model_of([flown], self.vehicle, effects))
        if trim is None:
            raise LogError("the log does not show forces and moments")
        normal = Normal.of(trim, self.vehicle, bool(flight.flight.indoors))
        return findings_of(balance_of(trim, normal, SURE), "at the calibration", "kg")

    def sized(self, events: Sequence[Event]) -> tuple[Event, ...]:
        """Events whose sizes are in newtons and kilograms."""
        return tuple(self._sized(events))

    def _sized(self, events: Sequence[Event]) -> Iterator[Event]:
        v = self.vehicle
        units = {
            "thrust_lost": (v.mass_kg * v.gravity_m_s2 / v.rotors.count, "N"),
            "mass_change": (v.mass_kg, "kg"),
        }
        for event in events:
            s = event.severity
            of_one = (
                s is not None and s.unit == "1" and (event.rotor or s.quantity == "mass_change")
            )
            if s is None or s.quantity not in units or not of_one:
                yield event
                continue
            factor, unit = units[s.quantity]
            values = (factor * x for x in (s.value, s.low, s.high))
            value, low, high = values
            size = Severity(quantity=s.quantity, value=value, low=low, high=high, unit=unit)
            words = f"{event.text} ({number(size.value)} {unit})"
            yield structs.replace(event, severity=size, text=words)
