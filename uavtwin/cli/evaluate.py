"""`uavtwin evaluate`: a compensator on flights of its own."""

from pathlib import Path
from typing import Annotated

import typer

from .options import Exit, Force, Json, Out
from .printing import STDOUT, print_damage, print_json, print_table, progress


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
    from twin.logs import read_flight

    from ..learned import extra_learn
    from ..output import check_folder, results_folder, write_run
    from ..vehicles import load_vehicle

    with extra_learn():
        from ..evaluation import evaluate_model, evaluation_table, write_evaluation
    check_folder(out, force)
    other = None if explained is None else load_vehicle(explained)
    read = [read_flight(path) for path in flights]
    with progress("comparing") as step:
        found = evaluate_model(model, read, other, step)
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
        print_json(found.json())
    else:
        STDOUT.print(found.claim, style="bold", markup=False)
        print_table(evaluation_table(found))
        STDOUT.print(f"written: {out / 'report.html'}, evaluation.json, run.json")
    if print_damage(read):
        raise typer.Exit(Exit.FINDINGS)
