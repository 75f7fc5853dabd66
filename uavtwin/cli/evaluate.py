"""`uavtwin evaluate`: a compensator on other flights than those of training."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import Csv, Force, Json, Mcap, Out, Prints, Rebuild, TrustVehicle, trained
from .printing import progress

if TYPE_CHECKING:
    from ..output import OptionalSteps


def evaluate(
    model: Annotated[Path, trained("Folder that `uavtwin train` wrote.", typer.Argument)],
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
    from ..output import check_folder
    from ..series.files import chosen_forms
    from ..vehicles import load_vehicle
    from .results import conclude, write_page

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
    inputs = [*flights, *(model / n for n in numbers)]
    inputs += [Path(p) for p in (explained, physics) if p]

    def write(folder: Path, steps: "OptionalSteps", _: Callable[[float], None]) -> list[str]:
        """Write page, numbers, model card."""
        written = write_page(found, folder, "evaluation.json")
        card = steps.run("model card", folder, lambda p: write_measured_card(model, found, read, p))
        return [*written, card] if card else written

    conclude(
        "evaluate",
        found,
        out,
        write,
        options,
        inputs,
        force=force,
        as_json=as_json,
        findings=False,
        flights=read,
        series=found.series(),
        forms=forms,
    )
