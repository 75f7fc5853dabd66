"""`uavtwin train`: a compensator of what no named effect explains."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from .options import Exit, Force, Out, VehicleName
from .printing import STDOUT, print_damage, progress

Protocol = Literal["reconstruct", "track", "free"]


def train(
    flights: Annotated[list[Path], typer.Argument(help="PX4 ULogs or flight tables.")],
    vehicle: VehicleName,
    preset: Annotated[
        str,
        typer.Option(
            help="best: ours; paper: the paper's text; published: its code; linear: no network; "
            "mean, last, ...: docs/guide/compensator.md."
        ),
    ] = "best",
    protocol: Annotated[
        Protocol,
        typer.Option(
            help="track: it sees residuals as old as the horizon; free: none; reconstruct: the "
            "present one, for comparison with the paper."
        ),
    ] = "track",
    horizon: Annotated[int, typer.Option(min=1, help="Of track, samples.")] = 1,
    rate: Annotated[float, typer.Option(help="Samples per second: 1000 over an integer.")] = 100,
    epochs: Annotated[int | None, typer.Option(min=1, help="Default: the preset's.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of everything that is drawn.")] = 0,
    out: Out = Path("model"),
    force: Force = False,
) -> None:
    """Train a compensator on what a vehicle model leaves unexplained in flights.

    A training that was interrupted goes on where it was when the same command is given again.
    """
    from twin.logs import read_flight

    from ..learned import extra_learn
    from ..output import write_run
    from ..vehicles import load_vehicle

    with extra_learn():
        from ..training import plan_training, prepare, run_training, training_claim
    plan = plan_training(preset, protocol, horizon, epochs, seed, out, force)
    model = load_vehicle(vehicle)
    read = [read_flight(path) for path in flights]
    with progress("comparing") as step:
        residuals = prepare(read, model, rate, step)
    with progress("training") as step:
        written = run_training(plan, residuals, model, out, step)
    options = {
        "vehicle": Path(vehicle).name,
        "preset": preset,
        "protocol": protocol,
        "horizon": plan.horizon,
        "rate": rate,
        "epochs": plan.epochs,
    }
    write_run(out, "train", options, [p for p in (*flights, Path(vehicle)) if p.is_file()], seed)
    STDOUT.print(training_claim(out), style="bold", markup=False)
    STDOUT.print(f"written: {out / written[0]}, {', '.join(written[1:])}, run.json")
    if print_damage(read):
        raise typer.Exit(Exit.FINDINGS)
