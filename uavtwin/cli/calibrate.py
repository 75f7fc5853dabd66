"""`uavtwin calibrate`: the numbers of one aircraft, from normal flights of it."""

from pathlib import Path
from typing import Annotated

import typer

from .explain import flight_payloads, site_record
from .options import (
    Exit,
    Force,
    Indoor,
    Json,
    Payload,
    Prints,
    Rebuild,
    TrustVehicle,
    VehicleName,
    needed_vehicle,
)
from .printing import STDOUT, print_damage, progress


def calibrate(
    flights: Annotated[
        list[Path],
        typer.Argument(help="Logs or flight tables in which nothing is wrong."),
    ],
    vehicle: VehicleName = None,
    payload: Payload = None,
    indoor: Indoor = None,
    out: Annotated[Path, typer.Option("--out", help="Vehicle file to write.")] = Path(
        "calibrated.toml"
    ),
    rebuild_commands: Rebuild = None,
    trust_vehicle: TrustVehicle = False,
    force: Force = False,
    as_json: Annotated[Json, Prints("uavtwin.calibration:CalibrateRecord")] = False,
) -> None:
    """Fit all numbers of one aircraft to normal flights of it, and write its vehicle file."""
    from .. import calibration
    from ..flights import read_alike
    from ..output import check_file, check_record, record_of, recorded_file
    from ..vehicles import load_vehicle
    from .results import print_result

    check_file(out, force)
    check_record(record_of(out), force)
    named = needed_vehicle(vehicle, "calibrate")
    draft = load_vehicle(named)
    read = read_alike(flights, rebuild_commands, trust_vehicle)
    payloads = flight_payloads(payload or [], [f.name for f in read])
    with progress("calibrating") as step:
        found = calibration.calibrate(read, draft, payloads=payloads, indoors=indoor, progress=step)
    options = {
        "vehicle": Path(named).name,
        "payload": payload or [],
        "rebuild_commands": rebuild_commands,
        "trust_vehicle": trust_vehicle,
        "indoors": {f.name: site_record(f, indoor) for f in read},
        "left_out": [f.name for f in read if f.name not in found.flights],
    }
    inputs = [p for p in (*flights, Path(named)) if p.is_file()]
    print_result(found, as_json)
    with recorded_file(out, force) as (file, note):
        found.vehicle.save(file)
        note("calibrate", options, inputs)
    if not as_json:
        STDOUT.print(f"written: {out}, {record_of(out).name}")
    if print_damage(read):
        raise typer.Exit(Exit.FINDINGS)
