"""A known mass aboard: some flights of a vehicle carry one, others do not."""

from collections.abc import Mapping
from dataclasses import replace

from ...vehicle import Vehicle

Payloads = Mapping[str, float]
"""Mass on top of the vehicle's by name of the flight, kg; a flight that is not named has none."""


def carrying(vehicle: Vehicle, payload_kg: float) -> Vehicle:
    """The vehicle with a small heavy thing strapped on at its centre of mass: it turns as before.

    Args:
        vehicle: Without it.
        payload_kg: Weighed.
    """
    return replace(vehicle, mass_kg=vehicle.mass_kg + payload_kg)
