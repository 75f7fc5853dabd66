"""The command line: `uavtwin VERB ...`. Exit 0 fine, 1 findings, 2 used wrongly.

Results go to stdout, progress and warnings to stderr. Heavy modules are imported by the verb that
needs them.
"""

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import IntEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from twin.errors import TwinError

if TYPE_CHECKING:
    from twin.flightlog import Flight
    from twin.residuals import FlightGap

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Hybrid digital twin of a multirotor, as FMI co-simulation components.",
)
_stdout = Console(highlight=False, soft_wrap=True)
_stderr = Console(stderr=True, highlight=False, soft_wrap=True)


class Exit(IntEnum):
    """Exit codes."""

    FINE = 0
    FINDINGS = 1
    WRONG_USE = 2


Out = Annotated[Path, typer.Option("--out", help="Folder for the results.")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite what the folder holds.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]
VehicleName = Annotated[
    str, typer.Option("--vehicle", help="Vehicle file (TOML), or the name of a built-in vehicle.")
]


def main() -> None:
    """Entry point: errors a user can mend become one line and exit code 2."""
    try:
        app()
    except TwinError as error:
        _stderr.print(f"error: {error}", style="red", markup=False)
        sys.exit(Exit.WRONG_USE)
    except OSError as error:
        _stderr.print(
            f"error: {error.filename or 'output'}: {error.strerror}", style="red", markup=False
        )
        sys.exit(Exit.WRONG_USE)
    except (KeyboardInterrupt, SystemError) as error:
        if isinstance(error, SystemError) and not isinstance(error.__cause__, KeyboardInterrupt):
            raise  # an interrupt inside CasADi comes out as a SystemError
        _stderr.print("interrupted")
        sys.exit(130)


@app.command()
def check(
    files: Annotated[list[Path], typer.Argument(help="Logs, flight tables, FMUs, vehicle files.")],
    as_json: Json = False,
) -> None:
    """Say what a file holds, what is wrong with it and what it is good for."""
    from .check import check_file

    reports = [check_file(path) for path in files]
    if as_json:
        _print_json([r.as_json() for r in reports])
    else:
        for report in reports:
            report.print(_stdout)
    if any(r.problems for r in reports):
        raise typer.Exit(Exit.FINDINGS)


@app.command()
def gap(
    logs: Annotated[list[Path], typer.Argument(help="PX4 ULogs or flight tables.")],
    vehicle: VehicleName,
    out: Out = Path("gap"),
    horizon: Annotated[
        float, typer.Option(help="Short horizon in s: restart from the measured state that often.")
    ] = 0.5,
    rebuild_commands: Annotated[
        bool | None,
        typer.Option(
            "--rebuild-commands/--logged-commands",
            help="Rebuild motor commands at full rate from gyro and setpoints. "
            "Default: where the log needs it.",
        ),
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Fly the twin on the commands of real flights and report where the two disagree."""
    from twin.flightlog import read_flight
    from twin.vehicle_file import load_vehicle

    from .gap import flight_gap
    from .output import check_folder, make_folder, write_run

    check_folder(out, force)
    model = load_vehicle(vehicle)
    flights = [read_flight(path, rebuild_commands=rebuild_commands) for path in logs]
    gaps = []
    with _progress("comparing") as step:
        for i, flight in enumerate(flights):

            def share(done: float, i: int = i) -> None:
                step((i + done) / len(flights))

            gaps.append(flight_gap(flight, model, horizon, share))
    make_folder(out)
    _write_gap(gaps, out)
    options = {
        "vehicle": Path(vehicle).name,
        "horizon": horizon,
        "rebuild_commands": rebuild_commands,
    }
    inputs = [*logs, Path(vehicle)] if Path(vehicle).is_file() else logs
    write_run(out, "gap", options, inputs)
    _print_gap(gaps, out, as_json)
    damaged = _print_damage(flights)
    if damaged or not any(g.channels for g in gaps):
        raise typer.Exit(Exit.FINDINGS)


@app.command()
def demo(
    seed: Annotated[
        int, typer.Option(min=0, help="Draws the hidden effect and the sensor noise.")
    ] = 1,
    vehicle: VehicleName = "copter_default",
    out: Out = Path("demo"),
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Fly a built-in flight in which an effect is hidden, and show the gap report."""
    from twin.flightlog.table import write_flight
    from twin.vehicle_file import load_vehicle

    from .demo import fly, hide
    from .gap import flight_gap
    from .output import check_folder, make_folder, write_json, write_run

    check_folder(out, force)
    model = load_vehicle(vehicle)
    hidden = hide(model, seed)
    flight = fly(model, hidden.plant, seed)
    with _progress("comparing") as step:
        gaps = [flight_gap(flight, model, progress=step)]
    make_folder(out)
    write_flight(flight, out / "flight.parquet")
    _write_gap(gaps, out)
    write_json(out / "truth.json", {"effect": hidden.effect, "text": hidden.text})
    write_run(out, "demo", {"vehicle": Path(vehicle).name}, seed=seed)
    _print_gap(gaps, out, as_json)
    _stderr.print(f"hidden in this flight: {hidden.text} ({hidden.effect})")


@app.command()
def export(
    components: Annotated[list[str], typer.Argument(help="airframe, imu, battery, replay.")],
    vehicle: VehicleName = "copter_default",
    fmi: Annotated[str, typer.Option(help="FMI versions: 2, 3 or 2,3.")] = "2",
    flight: Annotated[Path | None, typer.Option(help="Flight for the replay component.")] = None,
    drive: Annotated[
        str | None, typer.Option(help="Airframe inputs: command or rotor_speed.")
    ] = None,
    platform: Annotated[
        str,
        typer.Option(
            help="linux64, aarch64-linux, win64, darwin64, darwin-arm64, separated by commas, or "
            "all. Anything but linux64 alone is built by zig, the extra `cross`."
        ),
    ] = "linux64",
    start: Annotated[
        list[str] | None, typer.Option(help="Start value baked into the FMU: NAME=VALUE.")
    ] = None,
    out: Out = Path("fmus_out"),
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Build components as native FMUs, FMI 2 and 3, and list what was written."""
    from .export import export_components
    from .output import check_folder, make_folder, write_run

    check_folder(out, force)
    plan = export_components(components, vehicle, fmi, flight, drive, start or [], platform)
    make_folder(out)
    written = plan(out)
    options = {"components": components, "vehicle": Path(vehicle).name, "fmi": fmi, "drive": drive,
               "platform": platform, "start": start or []}  # fmt: skip
    inputs = [p for p in (Path(vehicle), flight) if p is not None and p.is_file()]
    write_run(out, "export", options, inputs)
    if as_json:
        _print_json(written)
        return
    for row in written:
        platforms = ",".join(row["platforms"])
        _stdout.print(f"{row['file']}  FMI {row['fmi']}  {platforms}  {row['bytes']} bytes")
        _stdout.print(f"  sha256 {row['sha256']}")


@app.command()
def bench(as_json: Json = False) -> None:
    """Measure the speed figures of the README, here and now."""
    from .bench import run_bench

    with _progress("measuring") as step:
        rows = run_bench(step)
    if as_json:
        _print_json([row.as_json() for row in rows])
        return
    table = Table("what", "value", "unit", "goal", box=None)
    for row in rows:
        table.add_row(row.what, f"{row.value:.3g}", row.unit, row.goal)
    _stdout.print(table)


@app.command("version")
def show_version() -> None:
    """Print the version."""
    from importlib.metadata import version

    _stdout.print(version("uavtwin"))


# -- printing -------------------------------------------------------------------------------


@contextmanager
def _progress(what: str) -> Iterator[Callable[[float], None]]:
    """A bar on stderr; the function takes the share done, 0..1."""
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(
        *columns, console=_stderr, transient=True, disable=not _stderr.is_terminal
    ) as bar:
        task = bar.add_task(what, total=1.0)
        yield lambda done: bar.update(task, completed=done)


def _print_json(content: Any) -> None:
    sys.stdout.write(json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def _write_gap(gaps: "list[FlightGap]", out: Path) -> None:
    from twin.residuals import gap_json

    from .output import write_json
    from .report import write_gap_report

    write_json(out / "gap.json", gap_json(gaps))
    write_gap_report(gaps, out / "report.html")


def _print_gap(gaps: "list[FlightGap]", out: Path, as_json: bool) -> None:
    from twin.residuals import gap_json, rank, summaries

    from .report import claim

    if as_json:
        _print_json(gap_json(gaps))
        return
    pooled = summaries(gaps)
    _stdout.print(claim(rank(pooled)), style="bold", markup=False)
    table = Table("channel", "unit", "horizon s", "n", "rms", "mean", "share of signal", box=None)
    for name, s in pooled.items():
        t = s.total
        table.add_row(name, s.unit, f"{s.horizon_s:g}", str(t.n), f"{t.rms:.4g}", f"{t.mean:.4g}",
                      f"{100 * t.share:.0f} %")  # fmt: skip
    _stdout.print(table)
    for g in gaps:
        if "commands_match" in g.facts:
            _stdout.print(f"{g.flight}: commands {g.facts['commands_match']}", markup=False)
        for warning in g.warnings:
            _stderr.print(f"{g.flight}: {warning}", style="yellow", markup=False)
    _stdout.print(f"written: {out / 'report.html'}, gap.json, run.json", markup=False)


def _print_damage(flights: "list[Flight]") -> int:
    """Print what the readers found damaged; how many."""
    errors = [(f.name, x) for f in flights for x in f.findings if x.severity == "error"]
    for name, finding in errors:
        _stderr.print(
            f"finding: {name}: {finding.where}: {finding.message} ({finding.count})",
            style="red",
            markup=False,
        )
    return len(errors)
