"""`uavtwin gap`: flights against their twin."""

from pathlib import Path
from typing import Annotated

import typer

from .options import (
    Csv,
    Force,
    Horizon,
    Json,
    Mcap,
    Out,
    Prints,
    Rebuild,
    Tables,
    TrustVehicle,
    VehicleName,
    needed_vehicle,
)
from .printing import progress


def gap(
    logs: Annotated[list[Path], typer.Argument(help="Logs of any format, or flight tables.")],
    vehicle: VehicleName = None,
    out: Out = Path("gap"),
    horizon: Horizon = 0.5,
    rebuild_commands: Rebuild = None,
    trust_vehicle: TrustVehicle = False,
    csv: Csv = False,
    mcap: Mcap = False,
    tables: Tables = False,
    force: Force = False,
    as_json: Annotated[
        Json,
        Prints(
            "uavtwin.gaps:GapRecord",
            file="gap.json",
            about="What the numbers mean: [the gap](../guide/gap.md).",
        ),
    ] = False,
) -> None:
    """Fly the twin on the commands of real flights and report where the two disagree."""
    from .. import gaps
    from ..flights import open_alike
    from ..output import check_folder
    from ..series.files import chosen_forms
    from ..vehicles import load_vehicle
    from .results import conclude, write_page

    check_folder(out, force)
    forms = chosen_forms(csv, mcap)
    named = needed_vehicle(vehicle, "gap")
    model = load_vehicle(named)
    flights = open_alike(logs, rebuild_commands, trust_vehicle)
    with progress("comparing") as step:
        found = gaps.gap(flights, model, horizon_s=horizon, progress=step)
    options = {
        "vehicle": Path(named).name,
        "horizon": horizon,
        "rebuild_commands": rebuild_commands,
        "trust_vehicle": trust_vehicle,
        "series": list(forms),
    }
    conclude(
        "gap",
        found,
        out,
        lambda folder, _, __: write_page(found, folder, "gap.json"),
        options,
        [*logs, Path(named)],
        force=force,
        as_json=as_json,
        findings=not found.record.worst,
        flights=flights,
        series=found.series(),
        forms=forms,
        tables=tables,
    )
