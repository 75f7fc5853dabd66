"""`uavtwin train` and `uavtwin evaluate`: the compensator of what no named effect explains."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal

import typer

from twin.errors import TwinError

from .options import Exit, Force, Json, Out, VehicleName
from .printing import STDOUT, print_damage, print_json, progress

Protocol = Literal["reconstruct", "track", "free"]


def train(
    flights: Annotated[list[Path], typer.Argument(help="PX4 ULogs or flight tables.")],
    vehicle: VehicleName,
    preset: Annotated[
        str,
        typer.Option(
            help="best: ours; paper: the paper's text; published: its code; linear: no network; "
            "mean, last, ...: docs/compensator.md."
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
    from ..output import write_run

    with _extra_learn():
        from ..training import plan_training, prepare, run_training, training_claim
    plan = plan_training(preset, protocol, horizon, epochs, seed, out, force)
    with progress("comparing") as step:
        read, residuals = prepare(flights, vehicle, rate, step)
    with progress("training") as step:
        written = run_training(plan, residuals, vehicle, out, step)
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


def evaluate(
    model: Annotated[Path, typer.Argument(help="Folder that `uavtwin train` wrote.")],
    flights: Annotated[list[Path], typer.Argument(help="Flights that it was not trained on.")],
    explained: Annotated[
        str | None,
        typer.Option(
            help="Vehicle file that `uavtwin explain` wrote, drawn beside the model's own."
        ),
    ] = None,
    out: Out = Path("evaluation"),
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Measure a compensator on other flights, beside trivial baselines."""
    from ..output import check_folder, results_folder, write_run

    with _extra_learn():
        from ..evaluation import (
            evaluate_model,
            evaluation_claim,
            evaluation_json,
            evaluation_table,
            write_evaluation,
        )
    check_folder(out, force)
    with progress("comparing") as step:
        read, found = evaluate_model(model, flights, explained, step)
    options = {
        "model": model.name,
        "explained": None if explained is None else Path(explained).name,
    }
    inputs = [*flights, model / "model.json", model / "weights.safetensors"]
    inputs += [Path(explained)] if explained and Path(explained).is_file() else []
    with results_folder(out, force) as folder:
        write_evaluation(found, folder)
        write_run(folder, "evaluate", options, inputs)
    if as_json:
        print_json(evaluation_json(found))
    else:
        STDOUT.print(evaluation_claim(found), style="bold", markup=False)
        STDOUT.print(evaluation_table(found))
        STDOUT.print(f"written: {out / 'report.html'}, evaluation.json, run.json")
    if print_damage(read):
        raise typer.Exit(Exit.FINDINGS)


@contextmanager
def _extra_learn() -> Iterator[None]:
    """Around an import that needs torch: a machine that only runs models has none."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise TwinError(
            f"{error.name} is not installed; training and evaluation need the extra `learn`: "
            "pip install 'uavtwin[learn]'"
        ) from error
