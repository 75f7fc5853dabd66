"""`uavtwin generate`: sensor signals that might have been."""

from pathlib import Path
from typing import Annotated

import typer

from .options import Force
from .printing import STDOUT


def generate(
    model: Annotated[
        Path, typer.Argument(help="Folder that `uavtwin train --protocol generate` wrote.")
    ],
    mission: Annotated[str, typer.Option(help="hover, takeoff, tour, forward or land.")] = "hover",
    seed: Annotated[int, typer.Option(min=0, help="Of all that is drawn.")] = 0,
    out: Annotated[
        Path, typer.Option("--out", help="Flight table to write, .parquet or .csv.")
    ] = Path("generated.parquet"),
    force: Force = False,
) -> None:
    """Fly a mission with the twin, and draw what its sensors would have read besides.

    The result is a flight table, as `uavtwin check`, `gap` and `explain` read it.
    """
    from twin.logs import write_flight

    from ..learned import check_extra_learn
    from ..learned import generate as generate_flight
    from ..output import check_file, check_record, record_of, recorded_file

    check_extra_learn()
    check_file(out, force)
    check_record(record_of(out), force)
    flight = generate_flight(model, mission, seed=seed)
    inputs = [model / n for n in ("vehicle.toml", "model.json", "weights.safetensors")]
    options = {"model": model.name, "mission": mission}
    with recorded_file(out, force) as (file, note):
        write_flight(flight, file)
        note("generate", options, inputs, seed)
    STDOUT.print(f"{flight.table['time'].iloc[-1]:.0f} s of {mission}, seed {seed}")
    STDOUT.print(f"written: {out}, {record_of(out).name}")
