"""Options, exit codes, and parsing of numbers, shared by the verbs of the command line."""

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from twin.errors import TwinError

COMPONENT_NAMES = (
    "airframe, imu, magnetometer, barometer, position, battery, environment, mission, controller, "
    "controller_px4"
)
"""`twin.flight.assembly.COMPONENTS` in words, for help without importing it."""


class Exit(IntEnum):
    """Exit codes."""

    FINE = 0
    FINDINGS = 1
    WRONG_USE = 2
    BROKEN = 3


_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|nan|[+-]?inf)\s*(.*?)\s*")
"""A number and its unit."""


def quantity(text: str, unit: str, bare: bool = True) -> float:
    """A number with a unit, such as "480mm" or "2 min", in the required unit.

    Args:
        text: Text of the command line.
        unit: Required unit, also of a number without one.
        bare: Whether a number without a unit is allowed.

    Raises:
        ValueError: It is no number, its unit is invalid or of another quantity, or the unit is
            missing.
    """
    from twin.vehicle_file.entries import unit_factor

    match = _QUANTITY.fullmatch(text)
    if match is None:
        raise ValueError(f"{text!r} is no number with a unit such as {unit}")
    number, given = match.groups()
    if not given and not bare:
        raise ValueError(f"{text!r} has no unit such as {unit}")
    try:
        scale = unit_factor(text, given or unit, unit)
    except TwinError as error:
        raise ValueError(str(error)) from error
    if scale is None:
        raise ValueError(f"{text!r}: {given} is no unit of the kind of {unit}")
    if scale == 1.0:
        return float(number)  # to the last bit
    return float(f"{float(number) * scale:.15g}")


def of_unit(unit: str, metavar: str, *names: str, help: str, panel: str | None = None) -> Any:
    """An option whose value is a number, with an optional unit of one quantity.

    Args:
        unit: Unit of a number without one.
        metavar: Placeholder for the value in the help.
        names: Names of the option; none: that of the parameter.
        help: Help text.
        panel: Panel of the help; None: that of all options.
    """

    def parser(text: Any) -> float:
        return quantity(text, unit) if isinstance(text, str) else float(text)

    return typer.Option(*names, help=help, parser=parser, metavar=metavar, rich_help_panel=panel)


def seconds(help: str, *names: str, panel: str | None = None) -> Any:
    """An option in seconds: 90, 90s, 1.5min, 20ms."""
    return of_unit("s", "SECONDS", *names, help=help, panel=panel)


def trained(help: str, kind: Callable[..., Any] = typer.Option) -> Any:
    """An option, or argument, whose value is the folder of a trained model.

    Args:
        help: Help text.
        kind: `typer.Option` or `typer.Argument`.
    """

    def parser(text: Any) -> Path:
        from ..exports.parts import model_folder

        return model_folder(text)

    said = f"{help} Or the name of a model that is shipped: copter_drag."
    return kind(help=said, parser=parser, metavar="MODEL")


def named_numbers(
    texts: Sequence[str], option: str, form: str, unit: str = "1"
) -> dict[str, float]:
    """Numbers from "NAME=NUMBER" texts, with the name up to the last equals sign.

    Args:
        texts: Texts of the command line.
        option: Name of the option.
        form: Description of its form.
        unit: Unit of the numbers; a number with another unit is converted.

    Raises:
        TwinError: A text has another form.
    """
    values = {}
    for text in texts:
        name, _, value = text.rpartition("=")
        try:
            values[name] = quantity(value, unit)
        except ValueError as error:
            raise TwinError(f"{option} {text}: {error}: write {form}.") from error
        if not name:
            raise TwinError(f"{option} {text}: write {form}.")
    return values


def times_real_time(text: str, most: float) -> float:
    """Value of the option `--speed`: a number, or `max`.

    Raises:
        TwinError: It is neither.
    """
    try:
        return most if text == "max" else float(text)
    except ValueError:
        raise TwinError(f"--speed {text}: a number, or max.") from None


def start_values(texts: Sequence[str] | None) -> dict[str, float]:
    """Start values of the option `--start`.

    Raises:
        TwinError: A text is not NAME=NUMBER.
    """
    return named_numbers(texts or (), "--start", "NAME=NUMBER")


Out = Annotated[Path, typer.Option("--out", help="Folder for the results.")]
Force = Annotated[bool, typer.Option("--force", help="Replace files that are there.")]


@dataclass(frozen=True, slots=True)
class Prints:
    """Content of `--json` of a verb, for the reference of JSON keys: follows `Json` in its type.

    Attributes:
        records: "MODULE:CLASS" of each kind of content.
        file: File with the same content; "": none.
        about: Additional description, in Markdown.
    """

    records: tuple[str, ...]
    file: str
    about: str

    def __init__(self, *records: str, file: str = "", about: str = "") -> None:
        object.__setattr__(self, "records", records)
        object.__setattr__(self, "file", file)
        object.__setattr__(self, "about", about)


Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]
Csv = Annotated[bool, typer.Option("--csv", help="Series as CSV, not Parquet.")]
Tables = Annotated[
    bool,
    typer.Option("--tables", help="The lists of the JSON as CSV too, for pandas: tables/."),
]
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
CallLimit = Annotated[float, seconds("Of one call into a foreign FMU, s.")]
MemoryLimit = Annotated[float, of_unit("GiB", "GIB", help="Of foreign FMUs, GiB.")]
Horizon = Annotated[float, seconds("Short horizon, s: restart from the measured state that often.")]
Engine = Annotated[
    Literal["local", "dask"], typer.Option(help="Processes here, or a Dask cluster.")
]
Workers = Annotated[
    int | None, typer.Option(help="Processes of the local engine. Default: one per core.")
]
Scheduler = Annotated[str | None, typer.Option(help="Of Dask: tcp://HOST:8786.")]
VEHICLE_VARIABLE = "UAVTWIN_VEHICLE"
"""Environment variable with the vehicle where a command names none."""
VehicleName = Annotated[
    str | None,
    typer.Option(
        "--vehicle",
        envvar=VEHICLE_VARIABLE,
        help="Vehicle file (TOML), or the name of a built-in vehicle.",
    ),
]
Payload = Annotated[
    list[str] | None,
    typer.Option(
        "--payload",
        help="Known mass aboard one of the flights: FLIGHT=KG, or FLIGHT=300g. May be repeated.",
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


def needed_vehicle(given: str | None, verb: str) -> str:
    """The vehicle of a command that needs one.

    Raises:
        TwinError: None is named.
    """
    if given:
        return given
    from twin.vehicle_file import builtin_vehicles

    raise TwinError(
        f"{verb}: --vehicle: which aircraft is it? A built-in one "
        f"({', '.join(builtin_vehicles())}), a vehicle file, or one drafted from a log and the "
        f"mass: uavtwin vehicle draft LOG --mass 1.2kg --out mine.toml. Without a vehicle: uavtwin "
        f"why LOG."
    )


def vehicle_named(given: str | None, default: str) -> str:
    """The vehicle of a command: as given, else from the environment, else a default."""
    return given or os.environ.get(VEHICLE_VARIABLE) or default
