"""Use of a vehicle file: positions of the rotors, mass, and reference values of its calibration.

The mean residuals of the twin, up to a sudden event, are compared with those of the calibration, by
the law of `explain --since`; sizes per mass or per thrust are then in kilograms or newtons.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from msgspec import structs

from ..effects import EFFECTS
from ..errors import LogError
from ..explain.balance import CAUSES, Normal, balance_of, trim_of
from ..explain.model.model import model_of
from ..formatting import number
from ..vehicle import Vehicle
from .balance import SURE, findings_of
from .findings import Findings
from .flight import FlightFrame, misfit
from .records import Event, Severity

CALM_S = 3.0
"""Time after take-off, and before landing or a loss of control, that is not used."""
LEAST_S = 8.0
"""Shortest part whose means are compared."""


class SinceCalibration:
    """Changes since a vehicle was calibrated.

    Attributes:
        vehicle: Vehicle of the file; without a calibration there are no reference values.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self.vehicle = vehicle

    def changed(self, flight: FlightFrame, until_s: float) -> Findings:
        """Balance of forces and moments, and notes on the file.

        Args:
            flight: Flight with the rotors of the file.
            until_s: Start of a sudden event; infinity: none.
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
        """Balance of the longest part under control, before a sudden event.

        Raises:
            LogError: The part does not determine the balance.
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
        """Events with sizes in newtons and kilograms."""
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
