"""`uavtwin generate`: sensor signals that might have been."""

from pathlib import Path
from typing import Annotated

import typer

from ..options import Force
from ..printing import STDOUT


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

    from ...learned import check_extra_learn
    from ...learned import generate as generate_flight
    from ...output import check_file, output_file, write_run

    check_extra_learn()
    check_file(out, force)
    flight = generate_flight(model, mission, seed=seed)
    with output_file(out) as file:
        write_flight(flight, file)
    inputs = [model / n for n in ("vehicle.toml", "model.json", "weights.safetensors")]
    options = {"model": model.name, "mission": mission}
    write_run(out.parent, "generate", options, inputs, seed, file=f"{out.stem}.run.json")
    STDOUT.print(f"{flight.table['time'].iloc[-1]:.0f} s of {mission}, seed {seed}")
    STDOUT.print(f"written: {out}, {out.stem}.run.json")
