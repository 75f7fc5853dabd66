"""`uavtwin vehicle ...`: creation of vehicle files."""

from itertools import takewhile
from pathlib import Path
from typing import Annotated

import typer

from twin.errors import TwinError

from .options import Exit, Force, Json, Prints, Rebuild, quantity
from .printing import STDOUT, print_damage, print_json, print_sections, warn

vehicle = typer.Typer(name="vehicle", no_args_is_help=True, help="Make a vehicle file.")


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
    """Write the vehicle file of an aircraft described by another simulator."""
    from ..output import check_file
    from ..vehicles import convert_vehicle

    check_file(out, force)
    found = convert_vehicle(file, name)
    STDOUT.print(
        f"{found.description}: {found.mass_kg:.4g} kg, {found.rotors.count} rotors",
        style="bold",
    )
    for line in takewhile(lambda line: line.startswith("#"), found.text.splitlines()):
        STDOUT.print(f"  {line.removeprefix('# ')}")
    found.save(out)
    STDOUT.print(f"written: {out}")


@vehicle.command()
def draft(
    logs: Annotated[
        list[Path], typer.Argument(help="Logs of any format, or flight tables, of one aircraft.")
    ],
    mass: Annotated[
        str | None,
        typer.Option(help="Mass as it flew, battery included: 1.3, 1.3kg or 1300g. Always needed."),
    ] = None,
    frame: Annotated[
        str | None,
        typer.Option(help="Shape: x, +, h, wide or betaflight-x. Default: as the log says."),
    ] = None,
    wheelbase: Annotated[
        str | None, typer.Option(help="Distance of two motors across: 480mm, 48cm, 0.48m.")
    ] = None,
    arm: Annotated[
        str | None, typer.Option(help="From the centre to a motor, in place of --wheelbase: 240mm.")
    ] = None,
    propeller: Annotated[
        str | None, typer.Option(help="Diameter and pitch in inches: 10x4.5.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="The vehicle file (TOML) to write.")] = Path(
        "my.toml"
    ),
    rebuild_commands: Rebuild = None,
    force: Force = False,
    as_json: Annotated[Json, Prints("uavtwin.vehicle_draft:DraftRecord")] = False,
) -> None:
    """Draft the vehicle file of the aircraft that flew: from its logs, its mass and its size."""
    from ..flights import read_flights
    from ..output import check_file
    from ..vehicle_draft import draft_vehicle

    check_file(out, force)
    if mass is None:
        raise TwinError(
            "vehicle draft: --mass is missing. A log tells force over mass alone: weigh the "
            "aircraft with its battery, --mass 1.3kg."
        )
    flights = read_flights(*logs, rebuild_commands=rebuild_commands)
    found = draft_vehicle(
        flights,
        _quantity(mass, "--mass", "kg", "1.3kg or 1300g", bare=True),
        frame=frame,
        wheelbase_m=_length(wheelbase, "--wheelbase"),
        arm_m=_length(arm, "--arm"),
        propeller=propeller,
        name=out.stem,
    )
    for warning in found.warnings:
        warn(warning)
    if as_json:
        print_json(found.written(out))
    else:
        print_sections((found.sentence, found.table()))
    found.vehicle.save(out)
    if not as_json:
        STDOUT.print(f"written: {out}")
        STDOUT.print(f"next: {found.next(str(out))}")
    if print_damage(flights):
        raise typer.Exit(Exit.FINDINGS)


def _length(text: str | None, option: str) -> float | None:
    """A length from text with a unit, m."""
    return None if text is None else _quantity(text, option, "m", "480mm or 0.48m", bare=False)


def _quantity(text: str, option: str, unit: str, form: str, bare: bool) -> float:
    """A positive number from text, in the SI unit.

    Raises:
        TwinError: It is invalid, or has no unit of this quantity.
    """
    try:
        found = quantity(text, unit, bare)
    except ValueError as error:
        raise TwinError(f"{option} {text}: {error}: write {form}.") from error
    if not 0 < found < float("inf"):
        raise TwinError(f"{option} {text}: must be a positive number: write {form}.")
    return found
