"""`uavtwin hil`: the twin as the simulator that an autopilot flies."""

import math
import signal
import tempfile
from contextlib import closing
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated

import typer

from twin.errors import TwinError

from .options import (
    Effects,
    Exit,
    Gusts,
    Json,
    Prints,
    Starts,
    VehicleName,
    Wind,
    seconds,
    start_values,
)
from .printing import STDERR, STDOUT, print_json
from .simulate import three_numbers

if TYPE_CHECKING:
    from ..hil.flying import FlyingTwin
    from ..hil.session import HilOptions, HilStatus
    from ..simulation import Scenario
    from ..vehicles import Vehicle

Listen = Annotated[str, typer.Option(help="Where the autopilot connects to: tcpin:HOST:PORT.")]
Model = Annotated[
    Path | None,
    typer.Option(
        help="Folder of what train wrote: a learned force, or a compensator of the sensors that "
        "sees no measurement."
    ),
]
Rate = Annotated[float, typer.Option(help="HIL_SENSOR per second: 1000 over a whole number.")]
Speed = Annotated[str, typer.Option(help="Times real time at most, or max; in lockstep alone.")]
Patience = Annotated[float, seconds("So long an answer of the autopilot may take, s.")]
Duration = Annotated[float | None, seconds("End at this simulated time, s.")]
Place = Annotated[
    str | None,
    typer.Option(
        help="LATITUDE,LONGITUDE,HEIGHT of the start, degrees and m over WGS 84; the magnetic "
        "field is then that of the place. Default: 48,11,500, and the vehicle's own field."
    ),
]
_YEAR = 2025.5
"""Of the magnetic field, as in vehicle files that give none."""


def hil(
    vehicle: VehicleName,
    listen: Listen = "tcpin:127.0.0.1:4560",
    model: Model = None,
    rate: Rate = 250.0,
    speed: Speed = "1",
    patience: Patience = 10.0,
    duration: Duration = None,
    place: Place = None,
    wind: Wind = "0,0,0",
    gusts: Gusts = False,
    seed: Annotated[int, typer.Option(min=0, help="Of every noise.")] = 0,
    effect: Effects = None,
    start: Starts = None,
    as_json: Annotated[Json, Prints("uavtwin.hil.session:HilStatus")] = False,
) -> None:
    """Let an autopilot fly the twin: PX4's simulator interface, in lockstep.

    Waits for the autopilot, and ends with its connection, with Ctrl-C, or after --duration.
    """
    from ..hil.session import PLACE, HilOptions
    from ..live.datagrams import address
    from ..simulation import Scenario
    from ..vehicles import load_vehicle

    aircraft = load_vehicle(vehicle)
    where = PLACE if place is None else _place(place)
    options = HilOptions(
        address(listen, "tcpin", "--listen"),
        rate,
        _speed(speed),
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
            status = _fly(aircraft, twin, options)
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
    """The twin, with what was trained where something is given."""
    from learning.force.model import is_force

    from ..exports.parts import compensator, learned_force
    from ..hil.flying import flying_twin_of

    network = force = None
    if model is not None and is_force(model):
        force = learned_force(model)
    elif model is not None:
        network = compensator(model)
    return flying_twin_of(vehicle, folder, scenario, network, force, warn=_warn)


def _warn(text: str) -> None:
    STDERR.print(f"warning: {text}", style="yellow")


def _fly(vehicle: "Vehicle", twin: "FlyingTwin", options: "HilOptions") -> "HilStatus":
    """Fly until it ends; a line each second."""
    from ..hil.session import HilSession

    ended = False

    def end(_: int, __: FrameType | None) -> None:
        """Ctrl-C ends the flight, not its report."""
        nonlocal ended
        ended = True

    session: HilSession = HilSession(vehicle, twin, options)
    STDERR.print(f"waiting for an autopilot at {options.serve}")
    before = {name: signal.signal(name, end) for name in (signal.SIGINT, signal.SIGTERM)}
    try:
        return session.run(lambda: ended, lambda status: STDERR.print(status.line()))
    finally:
        for name, handler in before.items():
            signal.signal(name, handler)


def _speed(text: str) -> float:
    try:
        return math.inf if text == "max" else float(text)
    except ValueError:
        raise TwinError(f"--speed {text}: a number, or max.") from None


def _place(text: str) -> tuple[float, float, float]:
    """Latitude, longitude, rad, and height, m."""
    latitude, longitude, height_m = three_numbers(text, "--place")
    return math.radians(latitude), math.radians(longitude), height_m


def _field(place: tuple[float, float, float]) -> dict[str, float]:
    """Start values of the magnetometer at a place."""
    from twin.frames import AXES
    from twin.vehicle.earth import world_field

    names = (f"magnetometer.field_{a}" for a in AXES)
    return dict(zip(names, world_field(*place, _YEAR), strict=True))
