"""`uavtwin live`: the twin alongside a flying aircraft."""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from twin.errors import TwinError, install_command

from .hil import LISTEN as HIL_LISTEN
from .hil import (
    Effects,
    Gusts,
    Patience,
    Place,
    Rate,
    Seed,
    Speed,
    Starts,
    Wind,
    fly_hil,
    print_hil,
)
from .options import VEHICLE_VARIABLE, Exit, Horizon, Json, Prints, seconds, trained
from .printing import STDERR, STDOUT, interruptible, print_json

if TYPE_CHECKING:
    from ..compensators.running import RunningCompensator
    from ..live.page.feed import PageFeed
    from ..live.session import LiveOptions, LiveSession
    from ..live.status import LiveStatus, ModelStatus
    from ..vehicles import Vehicle as OwnVehicle

_DEMO_VEHICLE, _DEMO_PAGE, _DEMO_SILENT_S = "copter_default", "127.0.0.1:8080", 5.0
"""Vehicle and page of `--demo`, and the silence after which that and `--replay` end, s."""

Vehicle = Annotated[
    str | None,
    typer.Option(
        "--vehicle",
        envvar=VEHICLE_VARIABLE,
        help="Vehicle file (TOML), or the name of a built-in vehicle. With --demo it may be left "
        f"out: {_DEMO_VEHICLE}.",
    ),
]
Demo = Annotated[
    bool,
    typer.Option(
        "--demo",
        help="Without an aircraft: a simulated one is sent to --listen in real time, a rotor of "
        "which is damaged in mid-flight; with the page. With --hil, without an autopilot: a "
        "controller of ours behind its messages flies.",
    ),
]
Replayed = Annotated[
    Path | None,
    typer.Option(
        "--replay",
        help="Without an aircraft: this log is sent to --listen in real time. `uavtwin replay` "
        "sends it elsewhere, or with faults of a radio link.",
    ),
]
_LISTEN = "udpin:127.0.0.1:14550"
"""Usual address of ground stations."""
Listen = Annotated[
    str | None,
    typer.Option(
        help=f"Where the aircraft sends to: udpin:HOST:PORT. Default: {_LISTEN}; with --hil where "
        f"the autopilot connects to, {HIL_LISTEN}.",
        show_default=False,
    ),
]
Hil = Annotated[
    bool,
    typer.Option(
        "--hil",
        help="Let an autopilot fly the twin instead: PX4's simulator interface, in lockstep. Waits "
        "for the autopilot, and ends with its connection, with Ctrl-C, or after --duration.",
    ),
]
System = Annotated[
    int | None, typer.Option(help="System id of the aircraft. Default: the first that is heard.")
]
Record = Annotated[
    Path | None,
    typer.Option(
        "--out",
        "--record",
        help="Folder for raw.tlog, flight.parquet, residuals.parquet, alarms.jsonl. Default: "
        "nothing is recorded.",
    ),
]
Duration = Annotated[float | None, seconds("End after so long, s.")]
UntilSilent = Annotated[float | None, seconds("End when the aircraft is silent for so long, s.")]
Observer = Annotated[
    float | None,
    seconds(
        "Draw the twin that is shown and published to the measured state with this time "
        "constant, s, instead of restarting it; residuals stay those of --horizon."
    ),
]
Hold = Annotated[float, seconds("So long samples wait for others that were overtaken, s.")]
RequestRates = Annotated[
    bool,
    typer.Option(
        "--request-rates",
        help="Ask the aircraft for the streams that are needed (SET_MESSAGE_INTERVAL), the one "
        "command that is ever sent.",
    ),
]
Publish = Annotated[
    str | None, typer.Option(help="Send the twin as an aircraft of its own: udpout:HOST:PORT.")
]
PublishSystem = Annotated[int, typer.Option(help="System id of the twin, 1 to 255.")]
Serve = Annotated[
    str | None,
    typer.Option(help=f"Serve a page that shows both: HOST:PORT, {_DEMO_PAGE}, that of --demo."),
]
Token = Annotated[
    str | None,
    typer.Option(
        help="What viewers of the page must know: ?token=TEXT. Default: beyond loopback that of "
        "the store, else a new one, which is printed."
    ),
]
Flights = Annotated[
    Path | None,
    typer.Option(
        "--store",
        help="Folder of `uavtwin serve`: its flights are on the same site, and what --out records "
        "joins them at the end.",
    ),
]
Model = Annotated[
    Path | None,
    trained(
        "Folder of a compensator of the sensors, of train: its correction and its anomaly "
        "score each two seconds of flight. With --hil also a learned force; it acts on the twin."
    ),
]
Alarms = Annotated[
    bool,
    typer.Option(
        help="Say what goes wrong in flight, as `why` does of a log; costs some 20 % of a core."
    ),
]


@dataclass(frozen=True, slots=True)
class Shown:
    """Options of the page and its site.

    Attributes:
        serve: Address HOST:PORT.
        token: Token of viewers; None: the default.
        store: Folder of the flights of the site; None: it has none.
    """

    serve: str
    token: str | None
    store: Path | None


_BOTH = {"vehicle", "model", "demo", "hil", "listen", "duration", "as_json"}
"""Parameters for both modes, with and without `--hil`."""
_OF_HIL = {"rate", "speed", "patience", "place", "wind", "gusts", "seed", "effect", "start"}
"""Parameters for `--hil` only."""


def live(
    given: typer.Context,
    vehicle: Vehicle = None,
    model: Model = None,
    demo: Demo = False,
    replay: Replayed = None,
    listen: Listen = None,
    system: System = None,
    out: Record = None,
    duration: Duration = None,
    until_silent: UntilSilent = None,
    horizon: Horizon = 0.5,
    observer: Observer = None,
    hold: Hold = 0.15,
    request_rates: RequestRates = False,
    publish: Publish = None,
    publish_system: PublishSystem = 2,
    serve: Serve = None,
    token: Token = None,
    store: Flights = None,
    alarms: Alarms = True,
    hil: Hil = False,
    rate: Rate = 250.0,
    speed: Speed = "1",
    patience: Patience = 10.0,
    place: Place = None,
    wind: Wind = "0,0,0",
    gusts: Gusts = False,
    seed: Seed = 0,
    effect: Effects = None,
    start: Starts = None,
    as_json: Annotated[
        Json,
        Prints(
            "uavtwin.live.status:LiveStatus",
            "uavtwin.hil.session:HilStatus",
            about="The second table is that of `--hil`.",
        ),
    ] = False,
) -> None:
    """Listen to a flying aircraft, fly the twin alongside, report and record where they differ.

    Ends with Ctrl-C, after --duration, or --until-silent. Nothing is sent to the aircraft but
    questions for its time (TIMESYNC), unless --request-rates is given.
    """
    from ..live.session import LiveOptions
    from ..sockets import address

    _check_mode(given, hil)
    if vehicle is None and not demo:
        raise TwinError("--vehicle: which aircraft is it? Give its vehicle file, or --demo.")
    if replay is not None and demo:
        raise TwinError(f"--replay {replay}: --demo simulates a flight instead. Choose one.")
    if hil:
        own = {name: given.params[name] for name in _OF_HIL}
        name = vehicle or _DEMO_VEHICLE
        flown = fly_hil(name, model, demo, listen or HIL_LISTEN, duration, **own)
        print_hil(flown, as_json)
        return
    options = LiveOptions(
        address(listen or _LISTEN, "udpin", "--listen"),
        system,
        out,
        horizon,
        hold,
        duration,
        _DEMO_SILENT_S if (demo or replay) and until_silent is None else until_silent,
        request_rates,
        None if publish is None else address(publish, "udpout", "--publish"),
        publish_system,
        observer,
    )
    if serve is None and (demo or store is not None):
        serve = _usual_page(store is not None)
    elif serve is None and token is not None:
        raise TwinError("live --token: there is no page. Add --serve HOST:PORT, or --store DIR.")
    shown = None if serve is None else Shown(serve, token, store)
    status = _fly(vehicle or _DEMO_VEHICLE, options, shown, alarms, demo, replay, model)
    if as_json:
        print_json(status)
    else:
        _print(status, out)
    if demo:
        _print_truth(status)
    if status.link.system is None or status.waits_for or status.errors:
        raise typer.Exit(Exit.FINDINGS)


def _check_mode(given: typer.Context, hil: bool) -> None:
    """Refuse options of the other mode."""
    for parameter in given.command.params:
        name = parameter.name or ""
        wrong = name not in (_BOTH | _OF_HIL) if hil else name in _OF_HIL
        source = given.get_parameter_source(name)
        if wrong and source is not None and source.name == "COMMANDLINE":
            text = "listens to an aircraft; leave it out" if hil else "is for --hil; add that"
            raise TwinError(f"live {'--hil ' * hil}{parameter.opts[0]}: {text}.")


def _usual_page(with_flights: bool) -> str | None:
    """Default address of the page; None, with a message, where it cannot be used."""
    from ..serve.opened import lacking

    if lacking(with_flights):
        STDERR.print(f"no page: it needs {install_command('serve')}", style="yellow")
        return None
    return _DEMO_PAGE


def _print_model(model: "ModelStatus", units: Mapping[str, str]) -> None:
    """Print the state of the compensator."""
    old = f"residuals of {model.horizon_s:g} s ago" if isfinite(model.horizon_s) else "no residuals"
    unusual = f"above 1 in {model.unusual:.1%} of the flight, " if isfinite(model.unusual) else ""
    STDOUT.print(
        f"compensator, which sees {old}: {unusual}inside its training in {model.inside:.0%}"
    )
    for name, (before, after) in model.rms.items():
        text = f"  {name}: rms {before:.4g}, corrected {after:.4g} {units.get(name, '')}"
        STDOUT.print(text.rstrip())


def _print_truth(status: "LiveStatus") -> None:
    """Print the fault of a demonstration's aircraft, once it has occurred."""
    from ..demo.in_flight import BEGINS_S, ending

    if status.flight_s > BEGINS_S:
        STDERR.print(ending())


def _fly(
    name: str,
    options: "LiveOptions",
    shown: "Shown | None",
    alarms: bool,
    demo: bool,
    replay: Path | None,
    model: Path | None,
) -> "LiveStatus":
    """Open the page if requested, and receive."""
    from twin.logs import read_flight
    from twin.why.watch import Watch

    from ..demo.in_flight import damaged_flight, sent_meanwhile
    from ..live.session import LiveSession
    from ..vehicles import load_vehicle

    twin = load_vehicle(name)
    with ExitStack() as opened:
        flight = None if replay is None else read_flight(replay)
        if demo:
            STDERR.print(f"simulating a flight of {twin.name}, some seconds")
            flight = damaged_flight(twin)
        feed = None
        if shown is not None:
            feed = opened.enter_context(_page(shown, twin, options))
        session = LiveSession(
            twin,
            options,
            (lambda: Watch(twin)) if alarms else lambda: None,
            feed,
            None if model is None else opened.enter_context(_compensator(model, twin)),
        )
        STDERR.print(f"listening at {options.listen}")
        if flight is not None:
            opened.enter_context(sent_meanwhile(flight, options.listen))
        return _run(session, feed)


@contextmanager
def _page(shown: Shown, twin: "OwnVehicle", options: "LiveOptions") -> "Iterator[PageFeed]":
    """The site with the page of this flight; at the end the recording is added to its flights."""
    from ..live.page.view import LiveView
    from ..serve.opened import open_site

    view = LiveView(twin, options.following, shown.store is not None)
    with open_site(shown.serve, "--serve", shown.store, live=view, token=shown.token) as (
        server,
        add,
    ):
        STDERR.print(f"page: {server.start().url}")
        yield view.feed
        if add is not None and options.record is not None:
            for file in sorted(options.record.glob("flight*.parquet")):
                add(file, f"{options.record.name}_{file.name}")
                STDERR.print(f"{file} joins the flights of {shown.store}")


@contextmanager
def _compensator(folder: Path, vehicle: "OwnVehicle") -> "Iterator[RunningCompensator]":
    """The compensator of a folder, checked against the vehicle and built."""
    from learning.force.model import is_force

    from ..compensators.running import RunningCompensator, compiled_compensator
    from ..exports.parts import check_compensator

    if is_force(folder):
        raise TwinError(
            f"--model {folder}: a learned force acts inside the equations and says nothing of "
            f"readings; give a compensator of the sensors. `live --hil` flies a learned force."
        )
    with compiled_compensator(folder) as compiled:
        check_compensator(compiled.network, vehicle)
        with closing(RunningCompensator(compiled.fmu, compiled.network, vehicle)) as running:
            yield running


def _run(session: "LiveSession", feed: "PageFeed | None") -> "LiveStatus":
    """Run until the end; prints a line each second."""
    said: set[tuple[Any, ...]] = set()
    failed: set[str] = set()

    def say(status: "LiveStatus") -> None:
        """Print a line, and alarms that are new or have ended."""
        STDERR.print(status.line())
        for alarm in status.alarms:
            key = alarm["section"], alarm["cause"], alarm["raised_s"], alarm["closed_s"]
            if key not in said:
                said.add(key)
                late = f"{alarm['delay_s']:.1f} s after it could be known"
                STDERR.print(f"ALARM: {alarm['text']}; raised {late}", style="bold red")
        if status.misfit and status.misfit not in failed:
            failed.add(status.misfit)
            STDERR.print(status.misfit, style="bold red")
        for error in status.errors:
            if error not in failed:
                failed.add(error)
                STDERR.print(f"{error}. The rest goes on.", style="bold red")
        if feed is not None:
            feed.known(status)

    with interruptible() as ended:
        return session.run(ended, say)


def _print(status: "LiveStatus", out: Path | None) -> None:
    """Print the final status."""
    from ..live.worker import ERRORS

    STDOUT.print(status.line())
    for name, value in status.rms.items():
        STDOUT.print(f"  {name}: rms {value:.4g} {status.units[name]}")
    for alarm in status.alarms:
        STDOUT.print(f"alarm: {alarm['text']}")
    if status.misfit:
        STDOUT.print(status.misfit)
    if status.model is not None and status.model.rms:
        _print_model(status.model, status.units)
    for error in status.errors:
        STDERR.print(f"in flight {error}", style="red")
    if status.errors and out is not None:
        STDERR.print(f"tracebacks: {out / ERRORS}", style="red")
    for text in status.missing.values():
        STDERR.print(text, style="yellow")
    for who, count in status.link.others.items():
        STDERR.print(f"left out: {count} messages of {who}", style="yellow")
    if out is not None:
        names = ", ".join(sorted(p.name for p in out.iterdir()))
        STDOUT.print(f"written: {out}: {names}")
