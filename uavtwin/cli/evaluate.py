"""`uavtwin evaluate`: a compensator on flights of its own."""

from pathlib import Path
from typing import Annotated

import typer

from .options import Csv, Exit, Force, Json, Mcap, Out, Prints, Rebuild, TrustVehicle
from .printing import (
    print_damage,
    print_incomplete,
    print_json,
    print_sections,
    print_written,
    progress,
)


def evaluate(
    model: Annotated[Path, typer.Argument(help="Folder that `uavtwin train` wrote.")],
    flights: Annotated[list[Path], typer.Argument(help="Flights that it was not trained on.")],
    explained: Annotated[
        str | None,
        typer.Option(help="Vehicle file that `uavtwin explain` wrote, drawn with the model's own."),
    ] = None,
    physics: Annotated[
        str | None,
        typer.Option(
            help="Of a learned force: vehicle file before it was explained, flown with it."
        ),
    ] = None,
    out: Out = Path("evaluation"),
    rebuild_commands: Rebuild = None,
    trust_vehicle: TrustVehicle = False,
    csv: Csv = False,
    mcap: Mcap = False,
    force: Force = False,
    as_json: Annotated[
        Json,
        Prints(
            "uavtwin.compensators.evaluation:EvaluationRecord",
            "uavtwin.force.evaluate:ForceRecord",
            file="evaluation.json",
            about="Of a compensator of sensors, then of a learned force: "
            "[the compensator](../guide/compensator.md).",
        ),
    ] = False,
) -> None:
    """Measure a compensator on other flights, against trivial baselines.

    A learned force is measured by replaying them through exported FMUs.
    """
    from learning.force.model import FILE

    from ..flights import read_alike
    from ..learned import check_extra_learn, write_measured_card
    from ..learned import evaluate as evaluate_folder
    from ..output import OptionalSteps, check_folder, results_folder, write_json, write_run
    from ..series.files import chosen_forms, write_all_series
    from ..vehicles import load_vehicle

    check_extra_learn()
    check_folder(out, force)
    forms = chosen_forms(csv, mcap)
    others = {
        name: load_vehicle(path)
        for name, path in (("explained", explained), ("physics", physics))
        if path is not None
    }
    read = read_alike(flights, rebuild_commands, trust_vehicle)
    with progress("comparing") as step:
        found = evaluate_folder(model, read, **others, progress=step)
    options = {
        "model": model.name,
        "explained": None if explained is None else Path(explained).name,
        "physics": None if physics is None else Path(physics).name,
        "rebuild_commands": rebuild_commands,
        "trust_vehicle": trust_vehicle,
        "series": list(forms),
    }
    numbers = ("vehicle.toml", "model.json", "weights.safetensors", FILE)
    inputs = [*flights, *(model / n for n in numbers if (model / n).is_file())]
    inputs += [Path(p) for p in (explained, physics) if p and Path(p).is_file()]
    if as_json:
        print_json(found.record)
    else:
        print_sections(found.sections())
    steps = OptionalSteps()
    with results_folder(out, force) as folder:
        write_json(folder / "evaluation.json", found.json())
        found.report(folder / "report.html")
        written, series = ["evaluation.json"], found.series()
        card = steps.run("model card", folder, lambda p: write_measured_card(model, found, read, p))
        written += [card] if card else []
        if steps.run("series", folder, lambda place: write_all_series(series, place, forms)):
            written.append("series/")
        write_run(folder, "evaluate", options, inputs, incomplete=steps.incomplete)
    if not as_json:
        print_written(out, ["report.html", *written])
    damaged = print_damage(read)
    if print_incomplete(steps) or damaged:
        raise typer.Exit(Exit.FINDINGS)
