"""`uavtwin vehicle ...`: making vehicle files."""

from itertools import takewhile
from pathlib import Path
from typing import Annotated

import typer

from .options import Force
from .printing import STDOUT

vehicle = typer.Typer(no_args_is_help=True, help="Make a vehicle file.")


@vehicle.command()
def convert(
    file: Annotated[
        Path,
        typer.Argument(
            help="SDF of Gazebo, params.toml of drone-models, NAME.yaml of PyFlyt, aircraft XML "
            "of JSBSim."
        ),
    ],
    out: Annotated[Path, typer.Option("--out", help="The vehicle file (TOML) to write.")],
    name: Annotated[
        str | None, typer.Option(help="Which aircraft, where the file holds several.")
    ] = None,
    force: Force = False,
) -> None:
    """Write the vehicle file of an aircraft that another simulator describes."""
    from ..output import check_file
    from ..vehicles import convert_vehicle

    check_file(out, force)
    found = convert_vehicle(file, name)
    found.save(out)
    STDOUT.print(
        f"{found.description}: {found.mass_kg:.4g} kg, {found.rotors.count} rotors",
        style="bold",
        markup=False,
    )
    for line in takewhile(lambda line: line.startswith("#"), found.text.splitlines()):
        STDOUT.print(f"  {line.removeprefix('# ')}", markup=False)
    STDOUT.print(f"written: {out}", markup=False)
