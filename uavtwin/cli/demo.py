"""`uavtwin demo`: the whole chain on built-in flights."""

from pathlib import Path
from typing import Annotated

import typer

from .options import Force, Json, Out, Prints
from .printing import progress


def demo(
    seed: Annotated[
        int, typer.Option(min=0, help="Draws the hidden effect and the sensor noise.")
    ] = 1,
    vehicle: Annotated[
        str, typer.Option(help="Vehicle file (TOML), or the name of a built-in vehicle.")
    ] = "copter_default",
    out: Out = Path("demo"),
    force: Force = False,
    as_json: Annotated[Json, Prints("uavtwin.demo.chain:DemoRecord")] = False,
) -> None:
    """Hide an effect in built-in flights; find, name and add it, and show that the gap shrinks."""
    from ..demo.chain import run_demo, write_demo
    from ..output import check_folder
    from ..vehicles import load_vehicle
    from .results import conclude

    check_folder(out, force)
    model = load_vehicle(vehicle)
    with progress("flying, comparing, explaining") as step:
        chain = run_demo(model, seed, step)
    conclude(
        "demo",
        chain,
        out,
        lambda folder, steps, step: write_demo(chain, folder, steps, step),
        {"vehicle": Path(vehicle).name},
        (),
        force=force,
        as_json=as_json,
        findings=not chain.right,
        seed=seed,
    )
