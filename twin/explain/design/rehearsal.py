"""A plan flown by a vehicle with its effects, recorded as the flights so far were."""

from collections.abc import Sequence

import numpy as np

from ...flight.simulate_flight import Recorder, Stream, simulate_flight
from ...logs import Flight
from ...residuals.channels import GRID_HZ
from ...vehicle import Vehicle
from .manoeuvres import Plan


def rehearse(
    plan: Plan, vehicle: Vehicle, plant: Vehicle, like: Sequence[Flight], voltage: float = 1.0
) -> Flight:
    """Fly a plan in closed loop and record it without noise.

    A late command is recorded early and a late pose late; neither reaches the controller. The
    record ends where the vehicle is lost.

    Args:
        plan: Setpoints.
        vehicle: What the controller is designed for.
        plant: What really flies, with its effects.
        like: Flights whose columns are recorded, at their rates, as far as the twin has them.
        voltage: Of the battery, over that of these flights.
    """
    recorder = Recorder(
        streams=streams_of(like),
        rate_hz=GRID_HZ,
        sampled_hz=GRID_HZ,
        early_commands=True,
        until_lost=True,
    )
    volts = volts_of(like, vehicle) * voltage
    return simulate_flight(plan.setpoints, plan.phases, vehicle, plant, recorder, "next", volts)


def streams_of(flights: Sequence[Flight]) -> tuple[Stream, ...]:
    """Every column of numbers that one of the flights has, as often as the fastest of them."""
    periods: dict[str, list[float]] = {}
    for flight in flights:
        for column in (c for c in flight.table if c not in ("time", "phase") and flight.has(c)):
            t_s, _ = flight.signal([column])
            if len(t_s) > 1:
                periods.setdefault(column, []).append(float(np.median(np.diff(t_s))))
    return tuple(Stream((column,), min(found)) for column, found in periods.items())


def volts_of(flights: Sequence[Flight], vehicle: Vehicle) -> float:
    """Median battery voltage of flights, that of the vehicle where none says it."""
    read = [f.signal(["vbat_v"])[1] for f in flights if f.has("vbat_v")]
    return float(np.median(np.concatenate(read))) if read else vehicle.voltage_v
