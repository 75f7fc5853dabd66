"""`uavtwin live --hil`: the twin as the simulator of an autopilot."""

import math
import tempfile
from contextlib import closing, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import Exit, seconds, start_values, times_real_time
from .printing import STDERR, STDOUT, interruptible, print_json, warn
from .simulate import three_numbers

if TYPE_CHECKING:
    from ..hil.flying import FlyingTwin
    from ..hil.session import HilOptions, HilStatus
    from ..simulation import Scenario
    from ..vehicles import Vehicle

_PANEL = "With --hil"
"""Panel of the help with options for this mode only."""
LISTEN = "tcpin:127.0.0.1:4560"
"""Address at which PX4 expects its simulator."""
Rate = Annotated[
    float,
    typer.Option(rich_help_panel=_PANEL, help="HIL_SENSOR per second: 1000 over a whole number."),
]
Speed = Annotated[
    str,
    typer.Option(
        rich_help_panel=_PANEL, help="Times real time at most, or max; in lockstep alone."
    ),
]
Patience = Annotated[
    float, seconds("So long an answer of the autopilot may take, s.", panel=_PANEL)
]
Place = Annotated[
    str | None,
    typer.Option(
        rich_help_panel=_PANEL,
        help="LATITUDE,LONGITUDE,HEIGHT of the start, degrees and m over WGS 84; the magnetic "
        "field is then that of the place. Default: 48,11,500, and the vehicle's own field.",
    ),
]
Wind = Annotated[
    str, typer.Option(rich_help_panel=_PANEL, help="Velocity of the air NED, m/s: 5,0,0.")
]
Gusts = Annotated[bool, typer.Option("--gusts", rich_help_panel=_PANEL, help="Dryden turbulence.")]
Seed = Annotated[int, typer.Option(min=0, rich_help_panel=_PANEL, help="Of every noise.")]
Effects = Annotated[
    list[str] | None,
    typer.Option(
        "--effect",
        rich_help_panel=_PANEL,
        help="Effect to switch on; may be given several times.",
    ),
]
Starts = Annotated[
    list[str] | None,
    typer.Option("--start", rich_help_panel=_PANEL, help="Start value PART.NAME=VALUE."),
]
_YEAR = 2025.5
"""Year of the magnetic field, the default of vehicle files."""


def fly_hil(
    vehicle: str,
    model: Path | None,
    demo: bool,
    listen: str,
    duration: float | None,
    rate: float,
    speed: str,
    patience: float,
    place: str | None,
    wind: str,
    gusts: bool,
    seed: int,
    effect: list[str] | None,
    start: list[str] | None,
) -> "HilStatus":
    """Let an autopilot fly the twin; the arguments are the options of `live --hil`."""
    from ..hil.session import PLACE, HilOptions
    from ..simulation import Scenario
    from ..sockets import address
    from ..vehicles import load_vehicle

    aircraft = load_vehicle(vehicle)
    where = PLACE if place is None else _place(place)
    options = HilOptions(
        address(listen, "tcpin", "--listen"),
        rate,
        times_real_time(speed, math.inf),
        patience,
        duration,
        place=where,
    )
    given = {} if place is None else _field(where)
    scenario = Scenario(
        "hil",
        aircraft,
        "lqr",
        three_numbers(wind, "--wind"),
        gusts,
        seed,
        tuple(effect or ()),
        given | start_values(start),
    )
    with tempfile.TemporaryDirectory() as folder:
        STDERR.print("building the twin")
        with closing(_twin(aircraft, Path(folder), scenario, model)) as twin:
            return _fly(aircraft, twin, options, demo)


def print_hil(status: "HilStatus", as_json: bool) -> None:
    """Print the result of the flight, and end with its exit code."""
    if as_json:
        print_json(status)
    else:
        STDOUT.print(status.line())
    if status.clipped or status.unknown:
        text = f"{status.clipped} motor commands were outside 0..1, {status.unknown} no number"
        STDERR.print(text, style="yellow")
    STDERR.print(status.ended, style=None if status.fine else "red")
    if not status.fine:
        raise typer.Exit(Exit.FINDINGS)


def _twin(
    vehicle: "Vehicle", folder: Path, scenario: "Scenario", model: Path | None
) -> "FlyingTwin":
    """The twin, with a trained model where one is given."""
    from ..exports.parts import learned
    from ..hil.flying import flying_twin_of

    network, force = (None, None) if model is None else learned(model)
    return flying_twin_of(vehicle, folder, scenario, network, force, warn=warn)


def _fly(vehicle: "Vehicle", twin: "FlyingTwin", options: "HilOptions", demo: bool) -> "HilStatus":
    """Simulate until the end; prints a line each second."""
    from ..demo.autopilot import Pilot, flown_meanwhile
    from ..demo.flights import WAYPOINTS
    from ..hil.session import HilSession
    from ..sockets import Address

    pilot = Pilot(vehicle, WAYPOINTS) if demo else None
    if pilot is not None and options.duration_s is None:
        options = replace(options, duration_s=pilot.seconds)
    session: HilSession = HilSession(vehicle, twin, options)
    simulator = Address(options.serve.host, session.link.port)
    STDERR.print(f"waiting for an autopilot at {options.serve}")
    flies = nullcontext() if pilot is None else flown_meanwhile(pilot, simulator, options.place)
    with interruptible() as ended, flies:
        return session.run(ended, lambda status: STDERR.print(status.line()))


def _place(text: str) -> tuple[float, float, float]:
    """Latitude, longitude, rad, and height, m, from text."""
    latitude, longitude, height_m = three_numbers(text, "--place")
    return math.radians(latitude), math.radians(longitude), height_m


def _field(place: tuple[float, float, float]) -> dict[str, float]:
    """Start values of the magnetometer at a place."""
    from twin.frames import AXES
    from twin.vehicle.earth import world_field

    names = (f"magnetometer.field_{a}" for a in AXES)
    return dict(zip(names, world_field(*place, _YEAR), strict=True))
