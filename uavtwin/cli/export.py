"""`uavtwin export`: components, the whole twin, a replay, a compensator, as FMUs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from twin.errors import TwinError

from .options import (
    COMPONENT_NAMES,
    VEHICLE_VARIABLE,
    Force,
    Json,
    Out,
    Prints,
    start_values,
    trained,
    vehicle_named,
)
from .printing import STDOUT, print_files, print_json, progress

if TYPE_CHECKING:
    from fmus.compensator import NetworkFile
    from twin.physics.rotors import Drive
    from twin.physics.sensors.position import Kind

    from ..exports.parts import Controller, LearnedForce
    from ..exports.write import Exportable, WrittenFile
    from ..vehicles import Vehicle

COMPENSATOR, FUSED, REPLAY = "compensator", "corrected-twin", "replay"
"""Exportable objects besides the components."""
MISSION = "mission"
"""Component with a choice of missions."""
DRIVES = {
    "commands": "command",
    "rotor_speeds": "rotor_speed",
    MISSION: None,
}
"""Rotor inputs by the words of the option; None: no external input."""
_FOR = {
    "flight": (REPLAY,),
    "linear": (REPLAY,),
    "drive": ("airframe", FUSED),
    "mission": (MISSION, FUSED),
    "controller": (FUSED,),
    "position": ("position", FUSED),
    "observer": (FUSED,),
    "noise": (FUSED,),
    "model": (COMPENSATOR, FUSED),
}
"""Option -> objects that it affects."""
Components = Annotated[
    list[str],
    typer.Argument(
        help=f"{COMPONENT_NAMES}, replay, compensator; or corrected-twin: all of them fused into "
        "one FMU, and as .ssp."
    ),
]
Platforms = Annotated[
    str,
    typer.Option(
        help="linux64, aarch64-linux, win64, darwin64, darwin-arm64, separated by commas, or all. "
        "linux64 alone is built by the C compiler of the machine if it has one, all else by zig."
    ),
]
Starts = Annotated[
    list[str] | None,
    typer.Option(
        help="Start value baked into the FMU: NAME=VALUE, in the corrected twin PART.NAME=VALUE."
    ),
]
Evidence = Annotated[
    Path | None,
    typer.Option(
        help="Folder that `explain` wrote, whose vehicle.toml it is: what the card of "
        "credibility rests on."
    ),
]
Required = Annotated[
    list[str] | None,
    typer.Option(
        help="FACTOR=LEVEL, e.g. validation=2: refuse to export below it. Factors: those of "
        "the card."
    ),
]


def export(
    components: Components,
    vehicle: Annotated[
        str | None,
        typer.Option(
            help="Vehicle file (TOML), or the name of a built-in vehicle. Default: that of "
            f"--model, else of {VEHICLE_VARIABLE} in the environment, else copter_default."
        ),
    ] = None,
    model: Annotated[
        Path | None,
        trained("Folder that `train` wrote, for compensator and corrected-twin."),
    ] = None,
    fmi: Annotated[str, typer.Option(help="FMI versions: 2, 3 or 2,3.")] = "2",
    flight: Annotated[Path | None, typer.Option(help="Flight for the replay component.")] = None,
    linear: Annotated[
        str, typer.Option(help="Columns of the replay to interpolate linearly; others hold.")
    ] = "",
    drive: Annotated[
        str | None,
        typer.Option(
            help="Who turns the rotors: inputs commands or rotor_speeds, of the airframe and of a "
            "corrected-twin that replays a log; or, in the corrected-twin alone, the mission."
        ),
    ] = None,
    mission: Annotated[str, typer.Option(help="Of mission and corrected-twin.")] = "hover",
    controller: Annotated[str, typer.Option(help="Of corrected-twin: lqr or px4.")] = "lqr",
    position: Annotated[str, typer.Option(help="Position sensor: gnss or mocap.")] = "gnss",
    observer: Annotated[
        bool,
        typer.Option(
            "--observer",
            help="Of a corrected-twin that replays a log: what its equations lack while it follows "
            "acts on when it is left alone. With --model it always does.",
        ),
    ] = False,
    noise: Annotated[
        bool,
        typer.Option(
            "--noise",
            help="Of a corrected-twin with a learned force: a random force and moment, and white "
            "noise of accelerometer and gyroscope, as unrestful as the hovers of its flights. "
            "residual_force.seed and imu.seed draw them; residual_force.noise.enabled = 0 ends the "
            "first alone.",
        ),
    ] = False,
    int8: Annotated[
        bool,
        typer.Option("--int8", help="The compensator's weights in 8 bits: smaller and faster."),
    ] = False,
    python_slave: Annotated[
        bool,
        typer.Option("--python-slave", help="For prototypes: FMUs run by Python and pythonfmu."),
    ] = False,
    arrays: Annotated[
        bool,
        typer.Option(
            "--arrays",
            help="With --fmi 3: pos_x, pos_y, pos_z as one variable pos, and so on; no .ssp.",
        ),
    ] = False,
    outputs: Annotated[
        str,
        typer.Option(
            help="typed, or real: every output a real number, for importers that read no other; no "
            ".ssp."
        ),
    ] = "typed",
    platform: Platforms = "linux64",
    start: Starts = None,
    evidence: Evidence = None,
    require: Required = None,
    out: Out = Path("fmus_out"),
    force: Force = False,
    as_json: Annotated[
        Json, Prints("uavtwin.exports.write:WrittenFile", about="A list, one of each file.")
    ] = False,
) -> None:
    """Build components as native FMUs, FMI 2 and 3, and list what was written."""
    from ..output import check_folder, results_folder, write_run

    check_folder(out, force)
    choice = Choice(
        vehicle or _default(model, evidence),
        fmi,
        platform,
        drive,
        start or [],
        flight,
        linear,
        mission,
        controller,
        model,
        position,
        int8,
        python_slave,
        arrays,
        outputs,
        observer,
        noise,
        evidence,
        require or [],
    )
    plan = export_components(components, choice)
    with results_folder(out, force) as folder, progress("building") as step:
        written = plan(folder, step)
        write_run(
            folder, "export", {"components": components, **choice.recorded()}, choice.inputs()
        )
    if as_json:
        print_json(written)
    else:
        print_files(written)
        if not (python_slave or arrays):  # which hold no reference results
            STDOUT.print(f"next: uavtwin verify {out / Path(written[0].file).name}")


@dataclass(frozen=True, slots=True)
class Choice:
    """The options of the verb as given; the help of `export` describes each."""

    vehicle: str = "copter_default"
    fmi: str = "2"
    platform: str = "linux64"
    drive: str | None = None
    start: Sequence[str] = ()
    flight: Path | None = None
    linear: str = ""
    mission: str = "hover"
    controller: str = "lqr"
    model: Path | None = None
    position: str = "gnss"
    int8: bool = False
    python_slave: bool = False
    arrays: bool = False
    outputs: str = "typed"
    observer: bool = False
    noise: bool = False
    evidence: Path | None = None
    require: Sequence[str] = ()

    def recorded(self) -> dict[str, Any]:
        """Options for `run.json`, which lists input files separately."""
        read = {f.name: getattr(self, f.name) for f in fields(self)}
        chosen = {k: v for k, v in read.items() if k not in ("flight", "model", "evidence")}
        return {**chosen, "vehicle": Path(self.vehicle).name}

    def inputs(self) -> list[Path]:
        """Input files."""
        from fmus.compensator import FILE, INT8_FILE
        from learning.force.model import FILE as FORCE_FILE

        from ..exports.bands import FILE as ACCURACY

        files = (INT8_FILE if self.int8 else FILE, FORCE_FILE)
        trained = [] if self.model is None else [self.model / n for n in files]
        of_explain = ("explain.json", ACCURACY)
        proof = [] if self.evidence is None else [self.evidence / n for n in of_explain]
        given = (Path(self.vehicle), self.flight, *trained, *proof)
        return [p for p in given if p is not None and p.is_file()]


_DEFAULT = Choice()
"""Choice of a command without options."""


def export_components(
    names: Sequence[str], choice: Choice
) -> "Callable[[Path, Callable[[float], None]], list[WrittenFile]]":
    """Read and check all options, then return the function that writes into a folder.

    Raises:
        TwinError: An unknown component, FMI version, drive, platform or start value; a missing
            flight or compiler.
    """
    from twin.component import unknown_name
    from twin.flight.assembly import COMPONENTS

    from ..exports.credibility import credibility
    from ..exports.write import export_parts
    from ..vehicles import load_vehicle

    vehicle, known = load_vehicle(choice.vehicle), (*COMPONENTS, REPLAY, COMPENSATOR, FUSED)
    for name in names:
        if name not in known:
            raise TwinError(unknown_name("export", "component", name, known))
    versions = _versions(choice.fmi)
    _check_options(names, choice, versions)
    learned = _learned(names, choice, vehicle)
    parts = [_part(name, choice, vehicle, *learned) for name in dict.fromkeys(names)]
    platforms = [name.strip() for name in choice.platform.split(",")]
    starts = start_values(choice.start)
    forms = choice.python_slave, choice.arrays, choice.outputs == "real"
    card = credibility(vehicle, choice.evidence)
    return export_parts(parts, versions, platforms, starts, *forms, card, choice.require)


def _default(model: Path | None, evidence: Path | None) -> str:
    """Default vehicle: that of the evidence, else of the model, else a built-in one."""
    return default_vehicle(model) if evidence is None else str(evidence / "vehicle.toml")


def default_vehicle(model: Path | None) -> str:
    """Default vehicle: the one of a trained model, else a built-in one."""
    own = None if model is None else model / "vehicle.toml"
    if own is not None and own.is_file():
        return str(own)
    return vehicle_named(None, "copter_default")


def _check_options(names: Sequence[str], choice: Choice, versions: Sequence[int]) -> None:
    """Refuse options that contradict each other."""
    unused = {n for n, used_by in _FOR.items() if not set(used_by) & set(names)}
    if DRIVES.get(choice.drive or MISSION) is not None:  # a log, not a mission, provides inputs
        unused |= {"controller"} | ({"mission"} - set(names))
    for option in _FOR:
        if option in unused and getattr(choice, option) != getattr(_DEFAULT, option):
            raise TwinError(
                f"--{option} {getattr(choice, option)}: changes nothing of {', '.join(names)}: it "
                f"goes with {' and '.join(_FOR[option])}"
                + (f" that flies a mission, --drive {MISSION}." if FUSED in names else ".")
            )
    if choice.observer and DRIVES.get(choice.drive or MISSION) is None:
        raise TwinError("--observer: a twin that flies a mission has no motion to follow; --drive.")
    if choice.drive not in (None, *DRIVES):
        raise TwinError(f"--drive {choice.drive}: choose {', '.join(DRIVES)}.")
    if choice.drive == MISSION and FUSED not in names:
        raise TwinError(f"--drive {MISSION} goes with {FUSED}: a component flies none.")
    if REPLAY in names and choice.flight is None:
        raise TwinError("replay needs the flight to replay: --flight LOG.")
    if choice.python_slave and (list(versions) != [2] or {REPLAY, FUSED} & set(names)):
        raise TwinError("--python-slave: FMI 2 and single components only; leave the rest native.")
    if choice.model is None and COMPENSATOR in names:
        raise TwinError("compensator needs a trained model: --model FOLDER.")
    if choice.outputs not in ("typed", "real"):
        raise TwinError(f"--outputs {choice.outputs}: choose typed or real.")
    if choice.int8 and choice.model is None:
        raise TwinError("--int8 goes with --model: it is the form of a trained compensator.")


def _part(
    name: str,
    choice: Choice,
    vehicle: "Vehicle",
    network: "NetworkFile | None",
    force: "LearnedForce | None",
) -> "Exportable":
    """Object of a name."""
    from twin.logs import read_flight

    from ..exports import parts
    from ..exports.bands import read_accuracy

    drive = cast("Drive | None", DRIVES.get(choice.drive or MISSION))
    if name == FUSED:
        known = None if choice.evidence is None else read_accuracy(choice.evidence, vehicle)
        controller = cast("Controller", choice.controller)
        kind = cast("Kind", choice.position)
        return parts.twin(
            *(vehicle, choice.mission, controller, network, drive, force, kind),
            observer=choice.observer,
            noise=choice.noise,
            accuracy=known,
        )
    if name == REPLAY and choice.flight is not None:
        linear = [c.strip() for c in choice.linear.split(",") if c.strip()]
        return parts.replay(read_flight(choice.flight), linear)
    if name == COMPENSATOR and network is not None:
        return network
    return parts.component(
        name,
        vehicle,
        drive=drive,
        position=cast("Kind", choice.position),
        mission=choice.mission,
    )


def _learned(
    names: Sequence[str], choice: Choice, vehicle: "Vehicle"
) -> "tuple[NetworkFile | None, LearnedForce | None]":
    """Trained models; a compensator is checked against the vehicle here, a force by the twin."""
    from ..exports.parts import check_compensator, learned

    if choice.model is None:
        return None, None
    network, force = learned(choice.model, choice.int8)
    if network is None:
        if choice.int8:
            raise TwinError(
                f"{choice.model}: a learned force has no form of 8 bits; leave out --int8."
            )
        if COMPENSATOR in names:
            raise TwinError(
                f"{choice.model}: is a learned force, which acts inside the equations; it has no "
                f"FMU of its own. Export {FUSED}."
            )
    else:
        check_compensator(network, vehicle)
    return network, force


def _versions(fmi: str) -> list[int]:
    """FMI versions of the option."""
    try:
        versions = sorted({int(v) for v in fmi.split(",")})
    except ValueError:
        versions = []
    if not versions or not set(versions) <= {2, 3}:
        raise TwinError(f"--fmi {fmi}: choose 2, 3 or 2,3.")
    return versions
