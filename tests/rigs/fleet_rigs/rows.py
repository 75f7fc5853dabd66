"""A fleet as rows of its dataset, without a flight being flown."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from uavtwin.fleets.dataset import JobRows, write_dataset

AIRCRAFT, FLIGHTS = 8, 12
HEAVY, WORN = "A04", "A02"


def lines(seed: int = 0, planted: bool = True) -> Iterator[dict[str, Any]]:
    """Flights of eight aircraft over eight weeks, then a log that cannot be read.

    A04 is heavier, the battery of A02 wears out; each flight names a drag of the type, which those
    of A01 do not, and those of A04 a mass.
    """
    rng = np.random.default_rng(seed)
    usual = {a: 1.0 + 0.005 * rng.standard_normal() for a in range(1, AIRCRAFT + 1)}
    drag = {a: 0.35 + 0.03 * rng.standard_normal() for a in range(1, AIRCRAFT + 1)}
    for k in range(AIRCRAFT * FLIGHTS):
        number, day = k % AIRCRAFT + 1, 56 * k / (AIRCRAFT * FLIGHTS)
        aircraft, log, found = f"A{number:02d}", f"{k:04d}.parquet", JobRows(k)
        heavy = 0.08 * (planted and aircraft == HEAVY)
        worn = 1e-2 * day / 30 * (planted and aircraft == WORN)
        found.add(
            "flights",
            log=log,
            bytes=1000,
            status="fine",
            format="made",
            aircraft=aircraft,
            date_year=2026 + day / 365.25,
            fingerprint=f"{k:064x}",
            carried=usual[number] + heavy + 0.002 * rng.standard_normal(),
            battery_resistance_ohm=0.03 + worn + 5e-4 * rng.standard_normal(),
            vehicle="copter_default",
            hover_command=0.5,
            motor_1=0.04,
            motor_2=-0.04,
            hover_voltage_v=15.0 + 0.1 * rng.standard_normal(),
            verdict="named",
        )
        found.add(
            "channels",
            log=log,
            aircraft=aircraft,
            channel="acc_z",
            phase="whole flight",
            unit="m/s^2",
            horizon_s=0.0,
            n=900,
            rms=0.2,
            mean=0.01 * rng.standard_normal(),
        )
        told = {"log": log, "aircraft": aircraft, "verdict": "named", "probability": 0.98}
        if number != 1:
            value = drag[number] + 0.02 * rng.standard_normal()
            own = {"number": "k_xy_1_s", "value": value, "sd": 0.02, "unit": "1/s"}
            found.add("effects", **told, effect="rotor_drag", **own)
        else:
            found.add("effects", log=log, aircraft=aircraft, verdict="nothing")
        if heavy:
            own = {"number": "mass_kg", "value": 0.1 + 0.01 * rng.standard_normal()}
            found.add("effects", **told, effect="mass_offset", **own, sd=0.01, unit="kg")
        yield found.json()
    broken = JobRows(-1)
    broken.add("flights", log="broken.ulg", bytes=7, status="unreadable", error="cut off")
    yield broken.json()


def made_fleet(folder: Path, planted: bool = True) -> Path:
    """Its tables."""
    write_dataset(lines(planted=planted), folder)
    return folder
