"""Battery: open-circuit voltage that falls linearly with charge, behind an internal resistance."""

from .component import Component
from .component_builder import ComponentBuilder
from .errors import ModelError
from .vehicle import Vehicle


def battery(vehicle: Vehicle) -> Component:
    """The battery of a vehicle as a component: current in, terminal voltage out.

    Source: Rint model, Hu, Li & Peng, J. Power Sources 198 (2012), sec. 2.

    Raises:
        ModelError: The vehicle file has no [battery].
    """
    data = vehicle.battery
    if data is None:
        raise ModelError(f"{vehicle.name}: the vehicle file has no [battery]; see docs/vehicle.md.")
    m = ComponentBuilder("battery", f"Battery of {vehicle.name}")
    current = m.input("ibat_a", "A", "Current drawn", data.hover_current_a)
    full = m.parameter("full_voltage", data.full_voltage_v, "V", "Open-circuit voltage when full")
    empty = m.parameter(
        "empty_voltage", data.empty_voltage_v, "V", "Open-circuit voltage when empty"
    )
    capacity = m.parameter(
        "capacity", data.capacity_a_s, "A.s", "Charge from full to empty", minimum=1.0
    )
    resistance = m.parameter(
        "resistance", data.resistance_ohm, "Ohm", "Internal resistance", minimum=0
    )
    start = m.parameter(
        "initial.charge", 1.0, "1", "Initial state of charge", minimum=0, maximum=1, fixed=True
    )
    charge = m.state("charge", "1", "State of charge", start)
    m.derivative("charge", -current / capacity)
    m.output("charge", "1", "State of charge, 1 full, 0 empty", charge)
    m.output(
        "vbat_v", "V", "Terminal voltage", empty + (full - empty) * charge - resistance * current
    )
    return m.build()
