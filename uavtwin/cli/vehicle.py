"""`uavtwin vehicle ...`: making vehicle files."""

import re
from itertools import takewhile
from pathlib import Path
from typing import Annotated

import typer

from twin.errors import TwinError

from .options import Exit, Force, Json, Rebuild
from .printing import STDERR, STDOUT, print_damage, print_json, print_sections

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
    )
    for line in takewhile(lambda line: line.startswith("#"), found.text.splitlines()):
        STDOUT.print(f"  {line.removeprefix('# ')}")
    STDOUT.print(f"written: {out}")


@vehicle.command()
def draft(
    logs: Annotated[list[Path], typer.Argument(help="PX4 ULogs or flight tables of one aircraft.")],
    mass: Annotated[
        str | None,
        typer.Option(help="Mass as it flew, battery included: 1.3, 1.3kg or 1300g. Always needed."),
    ] = None,
    frame: Annotated[
        str | None,
        typer.Option(help="x, +, h, wide or betaflight-x. Default: as the log says."),
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
    as_json: Json = False,
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
        _in_si(mass, "--mass", _KILOGRAMS, "1.3kg or 1300g", "kg"),
        frame=frame,
        wheelbase_m=_length(wheelbase, "--wheelbase"),
        arm_m=_length(arm, "--arm"),
        propeller=propeller,
        name=out.stem,
    )
    found.vehicle.save(out)
    for warning in found.warnings:
        STDERR.print(f"warning: {warning}", style="yellow")
    if as_json:
        print_json({**found.json(), "file": str(out), "next": found.next(str(out))})
    else:
        print_sections((found.sentence, found.table()))
        STDOUT.print(f"written: {out}")
        STDOUT.print(f"next: {found.next(str(out))}")
    if print_damage(flights):
        raise typer.Exit(Exit.FINDINGS)


_METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}
_KILOGRAMS = {"g": 1e-3, "kg": 1.0}
_QUANTITY = re.compile(r"\s*(\d*\.?\d+)\s*([a-z]*)\s*")


def _length(text: str | None, option: str) -> float | None:
    """A length with its unit, m."""
    return None if text is None else _in_si(text, option, _METRES, "480mm or 0.48m")


def _in_si(
    text: str, option: str, units: dict[str, float], form: str, default: str | None = None
) -> float:
    """A number with its unit in the SI unit.

    Raises:
        TwinError: It is none, or the unit is none of these.
    """
    found = _QUANTITY.fullmatch(text)
    factor = units.get((found[2] or default or "") if found else "")
    if found is None or factor is None:
        raise TwinError(f"{option} {text}: write {form}; units: {', '.join(units)}.")
    return round(float(found[1]) * factor, 9)
