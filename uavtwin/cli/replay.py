"""`uavtwin replay`: a log played as a MAVLink aircraft."""

from pathlib import Path
from typing import Annotated

import typer

from twin.errors import TwinError

from .options import Json, Prints, Rebuild, of_unit, seconds, times_real_time
from .printing import STDOUT, print_json, progress


def replay(
    log: Annotated[Path, typer.Argument(help="Log of any format that is read, or flight table.")],
    to: Annotated[
        str, typer.Option("--to", help="Where to: udpout:HOST:PORT.")
    ] = "udpout:127.0.0.1:14550",
    speed: Annotated[
        str, typer.Option(help="Times real time, or max: in step with uavtwin live.")
    ] = "1",
    begin: Annotated[float, seconds("Begin so far into the flight, s.", "--begin")] = 0.0,
    end: Annotated[float | None, seconds("End so far into the flight, s.", "--end")] = None,
    loss: Annotated[float, typer.Option(help="Share of messages that are lost, 0..1.")] = 0.0,
    jitter: Annotated[float, seconds("Each is late by up to so much, s.")] = 0.0,
    drift: Annotated[
        float,
        of_unit("1", "SHARE", help="By how much the aircraft's clock is faster: 20ppm or 2e-5."),
    ] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="Of loss and jitter.")] = 0,
    system: Annotated[int, typer.Option(help="System id of the aircraft, 1 to 255.")] = 1,
    rebuild_commands: Rebuild = None,
    as_json: Annotated[Json, Prints("uavtwin.live.replay:Played")] = False,
) -> None:
    """Play a log as a MAVLink aircraft, with optional faults of a radio link."""
    from twin.logs import read_flight

    from ..live.replay import MAX_SPEED, Faults, Replay
    from ..sockets import address

    where = address(to, "udpout", "--to")
    faults = Faults(loss, jitter, drift, seed)
    flight = read_flight(log, rebuild_commands=rebuild_commands)
    part = flight.between(begin, flight.time_s[-1] if end is None else end)
    if len(part.table) < 2:
        raise TwinError(
            f"{log.name}: nothing between --begin and --end; it lasts from "
            f"{flight.time_s[0]:.1f} s to {flight.time_s[-1]:.1f} s."
        )
    aircraft = Replay(where, times_real_time(speed, MAX_SPEED), faults, system)
    try:
        with progress("replaying") as step:
            report = aircraft.play(part, step)
    finally:
        aircraft.close()
    if as_json:
        print_json(report)
    else:
        STDOUT.print(
            f"sent to {where}: {report.messages} messages of {report.seconds:.1f} s of flight in "
            f"{report.wall_s:.1f} s; {report.lost} of them lost on purpose",
        )
