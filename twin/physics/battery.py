"""Battery: open-circuit voltage, linear in charge, in series with an internal resistance.

The drop over the resistance follows the current with a short lag, that of the capacitors next to
the motor controllers: without it the terminal voltage would be in an algebraic loop with motors
whose current depends on it.
"""

from ..component import Component, ComponentBuilder
from ..errors import ModelError
from ..vehicle import Vehicle

LAG_S = 0.02
"""Time constant of the voltage drop. Made up: 1 mF behind 20 mOhm, through long leads."""


def battery(vehicle: Vehicle) -> Component:
    """The battery of a vehicle as a component: current in, terminal voltage out.

    Source: Rint model with the RC of a Thevenin model, Hu, Li & Peng, J. Power Sources 198
    (2012), sec. 2.

    Raises:
        ModelError: The vehicle file has no [battery].
    """
    data = vehicle.battery
    if data is None:
        raise ModelError(
            f"{vehicle.name}: the vehicle file has no [battery]; see docs/guide/vehicle.md."
        )
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
    lag = m.parameter("lag", LAG_S, "s", "Time constant of the voltage drop", minimum=1e-3)
    before = m.parameter(
        "initial.current", data.hover_current_a, "A", "Current before the start", fixed=True
    )
    start = m.parameter(
        "initial.charge", 1.0, "1", "Initial state of charge", minimum=0, maximum=1, fixed=True
    )
    charge = m.state("charge", "1", "State of charge", start)
    m.derivative("charge", -current / capacity)
    drop = m.state("drop", "V", "Voltage over the resistance", resistance * before)
    m.derivative("drop", (resistance * current - drop) / lag)
    m.output("charge", "1", "State of charge, 1 full, 0 empty", charge)
    m.output("vbat_v", "V", "Terminal voltage", empty + (full - empty) * charge - drop)
    return m.build()
