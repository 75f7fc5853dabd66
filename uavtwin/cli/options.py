"""What the verbs of the command line share: options, exit codes, texts read into numbers."""

import os
from collections.abc import Sequence
from enum import IntEnum
from pathlib import Path
from typing import Annotated, Literal

import typer

from twin.errors import TwinError


class Exit(IntEnum):
    """Exit codes."""

    FINE = 0
    FINDINGS = 1
    WRONG_USE = 2
    BROKEN = 3


def named_numbers(texts: Sequence[str], option: str, form: str) -> dict[str, float]:
    """Numbers of "NAME=NUMBER" texts, the name up to the last equals sign.

    Args:
        texts: As given on the command line.
        option: By which they were given.
        form: How to write it.

    Raises:
        TwinError: A text is not of that form.
    """
    values = {}
    for text in texts:
        name, _, value = text.rpartition("=")
        try:
            values[name] = float(value)
        except ValueError:
            name = ""
        if not name:
            raise TwinError(f"{option} {text}: write {form}.")
    return values


def start_values(texts: Sequence[str] | None) -> dict[str, float]:
    """Start values of the option `--start`.

    Raises:
        TwinError: A text is not NAME=NUMBER.
    """
    return named_numbers(texts or (), "--start", "NAME=NUMBER")


Out = Annotated[Path, typer.Option("--out", help="Folder for the results.")]
Force = Annotated[bool, typer.Option("--force", help="Replace files that are there.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]
Csv = Annotated[bool, typer.Option("--csv", help="Series as CSV, not Parquet.")]
Mcap = Annotated[
    bool, typer.Option("--mcap", help="Series as MCAP, for Foxglove and PlotJuggler, not Parquet.")
]
Wind = Annotated[str, typer.Option(help="Velocity of the air NED, m/s: 5,0,0.")]
Gusts = Annotated[bool, typer.Option("--gusts", help="Dryden turbulence.")]
Controller = Annotated[str, typer.Option(help="lqr or px4.")]
Effects = Annotated[
    list[str] | None,
    typer.Option("--effect", help="Effect to switch on; may be given several times."),
]
Starts = Annotated[list[str] | None, typer.Option("--start", help="Start value PART.NAME=VALUE.")]
CallLimit = Annotated[float, typer.Option(help="Of one call into a foreign FMU, s.")]
MemoryLimit = Annotated[float, typer.Option(help="Of foreign FMUs, GiB.")]
Engine = Annotated[
    Literal["local", "dask"], typer.Option(help="Processes here, or a Dask cluster.")
]
Workers = Annotated[
    int | None, typer.Option(help="Processes of the local engine. Default: one per core.")
]
Scheduler = Annotated[str | None, typer.Option(help="Of Dask: tcp://HOST:8786.")]
VEHICLE_VARIABLE = "UAVTWIN_VEHICLE"
"""Of the environment: the vehicle where a command names none."""
VehicleName = Annotated[
    str,
    typer.Option(
        "--vehicle",
        envvar=VEHICLE_VARIABLE,
        help="Vehicle file (TOML), or the name of a built-in vehicle.",
    ),
]
Payload = Annotated[
    list[str] | None,
    typer.Option(
        "--payload", help="Known mass aboard one of the flights, FLIGHT=KG. May be repeated."
    ),
]
Indoor = Annotated[
    bool | None,
    typer.Option(
        "--indoor/--outdoor",
        help="Whether the flights were within walls. Default: as each log says, else outdoors.",
        show_default=False,
    ),
]
Rebuild = Annotated[
    bool | None,
    typer.Option(
        "--rebuild-commands/--logged-commands",
        help="Rebuild motor commands at full rate from gyro and setpoints. Default: where a log "
        "needs it, and where what is rebuilt is what was flown in all of them.",
        show_default=False,
    ),
]
TrustVehicle = Annotated[
    bool,
    typer.Option(
        "--trust-vehicle",
        help="Compare although the log states other rotors (number, order, places, senses) than "
        "the vehicle file.",
    ),
]


def vehicle_named(given: str | None, default: str) -> str:
    """The vehicle of a command: as given, else that of the environment, else a default."""
    return given or os.environ.get(VEHICLE_VARIABLE) or default
