"""`uavtwin export` and `uavtwin simulate`: FMUs of the twin, and flights of them."""

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from twin.errors import TwinError

from .options import Force, Json, Out, VehicleName
from .printing import STDERR, STDOUT, print_files, print_json, progress

Algorithm = Literal["jacobi", "settled", "gauss_seidel"]


def export(
    components: Annotated[
        list[str],
        typer.Argument(
            help="airframe, imu, magnetometer, barometer, position, battery, environment, "
            "mission, controller, controller_px4, replay, compensator; or corrected-twin: all of "
            "them fused into one FMU, and as .ssp."
        ),
    ],
    vehicle: Annotated[
        str | None,
        typer.Option(
            help="Vehicle file (TOML), or the name of a built-in vehicle. Default: that of "
            "--model, else copter_default."
        ),
    ] = None,
    model: Annotated[
        Path | None,
        typer.Option(help="Folder of a trained compensator, for compensator and corrected-twin."),
    ] = None,
    fmi: Annotated[str, typer.Option(help="FMI versions: 2, 3 or 2,3.")] = "2",
    flight: Annotated[Path | None, typer.Option(help="Flight for the replay component.")] = None,
    linear: Annotated[
        str, typer.Option(help="Columns of the replay to interpolate linearly; others hold.")
    ] = "",
    drive: Annotated[
        str | None, typer.Option(help="Airframe inputs: command or rotor_speed.")
    ] = None,
    mission: Annotated[str, typer.Option(help="Of mission and corrected-twin.")] = "hover",
    controller: Annotated[str, typer.Option(help="Of corrected-twin: lqr or px4.")] = "lqr",
    position: Annotated[str, typer.Option(help="Position sensor: gnss or mocap.")] = "gnss",
    python_slave: Annotated[
        bool,
        typer.Option("--python-slave", help="For prototypes: FMUs run by Python and pythonfmu."),
    ] = False,
    platform: Annotated[
        str,
        typer.Option(
            help="linux64, aarch64-linux, win64, darwin64, darwin-arm64, separated by commas, or "
            "all. Anything but linux64 alone is built by zig, the extra `cross`."
        ),
    ] = "linux64",
    start: Annotated[
        list[str] | None,
        typer.Option(
            help="Start value baked into the FMU: NAME=VALUE, in the corrected twin "
            "PART.NAME=VALUE."
        ),
    ] = None,
    out: Out = Path("fmus_out"),
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Build components as native FMUs, FMI 2 and 3, and list what was written."""
    from fmus.compensator import FILE

    from ..export import Choice, default_vehicle, export_components
    from ..output import check_folder, results_folder, write_run

    check_folder(out, force)
    vehicle = vehicle or default_vehicle(model)
    choice = Choice(
        vehicle,
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
        python_slave,
    )
    plan = export_components(components, choice)
    options = {
        "components": components,
        "vehicle": Path(vehicle).name,
        "fmi": fmi,
        "drive": drive,
        "linear": linear,
        "mission": mission,
        "controller": controller,
        "position": position,
        "python_slave": python_slave,
        "platform": platform,
        "start": start or [],
    }
    trained = None if model is None else model / FILE
    inputs = [p for p in (Path(vehicle), flight, trained) if p is not None and p.is_file()]
    with results_folder(out, force) as folder, progress("building") as step:
        written = plan(folder, step)
        write_run(folder, "export", options, inputs)
    if as_json:
        print_json(written)
    else:
        print_files(written)


def simulate(
    scenario: Annotated[
        str, typer.Argument(help="hover, takeoff, tour, forward, land, or an .ssp file.")
    ],
    vehicle: VehicleName = "copter_default",
    wind: Annotated[str, typer.Option(help="Velocity of the air NED, m/s: 5,0,0.")] = "0,0,0",
    gusts: Annotated[bool, typer.Option("--gusts", help="Dryden turbulence.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Of every noise.")] = 0,
    controller: Annotated[str, typer.Option(help="lqr or px4.")] = "lqr",
    effect: Annotated[
        list[str] | None, typer.Option(help="Effect to switch on; may be given several times.")
    ] = None,
    start: Annotated[list[str] | None, typer.Option(help="Start value PART.NAME=VALUE.")] = None,
    stop: Annotated[float | None, typer.Option(help="Stop time, s.")] = None,
    step: Annotated[float | None, typer.Option(help="Communication step, s.")] = None,
    interval: Annotated[float | None, typer.Option(help="Time between recorded rows, s.")] = None,
    algorithm: Annotated[Algorithm, typer.Option(help="How the parts exchange values.")] = "jacobi",
    fused: Annotated[bool, typer.Option("--fused", help="Run the twin as one FMU.")] = False,
    realtime: Annotated[bool, typer.Option("--realtime", help="As fast as the clock.")] = False,
    csv: Annotated[bool, typer.Option("--csv", help="Recording as CSV, not Parquet.")] = False,
    out: Out = Path("simulation"),
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Fly a scenario, or run an .ssp, and record every output."""
    import tempfile

    from cosim.slave.interface import read_interface

    from ..output import check_folder, results_folder, write_json, write_run
    from ..report.simulation import write_simulation_report
    from ..simulate import Scenario, run_scenario, scenario_system, summary

    check_folder(out, force)
    plan = Scenario(
        scenario,
        vehicle,
        controller,
        _three(wind, "--wind"),
        gusts,
        seed,
        tuple(effect or ()),
        tuple(start or ()),
        fused,
    )
    with tempfile.TemporaryDirectory(prefix="uavtwin-") as build_folder:
        with progress("building") as done:
            system = scenario_system(plan, Path(build_folder), done)
        with progress("flying") as done:
            recording = run_scenario(
                system, stop, step, interval, algorithm, 1.0 if realtime else None, done
            )
        interfaces = {k: read_interface(path) for k, path in system.fmus.items()}
    units = {f"{k}.{p.name}": p.unit or "" for k, i in interfaces.items() for p in i.ports.values()}
    figures = summary(recording)
    claim = _flight_claim(Path(scenario).name, recording.time_s[-1], figures)
    options = {
        "scenario": Path(scenario).name,
        "vehicle": Path(vehicle).name,
        "wind": wind,
        "gusts": gusts,
        "controller": controller,
        "effect": effect or [],
        "start": start or [],
        "stop": stop,
        "step": step,
        "interval": interval,
        "algorithm": algorithm,
        "fused": fused,
    }
    inputs = [p for p in (Path(scenario), Path(vehicle)) if p.is_file()]
    with results_folder(out, force) as folder:
        recording.write(folder / ("recording.csv" if csv else "recording.parquet"))
        write_json(folder / "summary.json", figures)
        facts = {k: v for k, v in options.items() if v not in (None, [], "", False)}
        write_simulation_report(
            recording, units, claim, facts, Path(scenario).name, folder / "report.html"
        )
        write_run(folder, "simulate", options, inputs, seed)
    if as_json:
        print_json(figures)
        return
    STDOUT.print(claim, style="bold", markup=False)
    if realtime:
        STDERR.print(f"at most {1e3 * recording.lateness_s:.1f} ms behind the clock")
    STDOUT.print(f"written: {out / 'report.html'}, recording, summary.json, run.json")


def _three(text: str, option: str) -> tuple[float, float, float]:
    """Three numbers separated by commas."""
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise TwinError(f"{option} {text}: write three numbers, e.g. 5,0,0.") from None
    return x, y, z


def _flight_claim(scenario: str, duration_s: float, figures: dict[str, Any]) -> str:
    """One sentence on a simulation."""
    if not figures:
        return f"{scenario}: {duration_s:g} s simulated"
    return (
        f"{scenario}: {duration_s:g} s flown, {figures['tracking_rms_m']:.2f} m rms from the "
        f"setpoint, {figures['tracking_worst_m']:.2f} m at worst"
    )
