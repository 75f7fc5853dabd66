"""`uavtwin demo`: the whole chain on built-in flights."""

from pathlib import Path
from typing import Annotated

import typer

from .options import Exit, Force, Json, Out, Prints
from .printing import (
    STDERR,
    STDOUT,
    print_explanation,
    print_incomplete,
    print_json,
    print_written,
    progress,
)


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
    from ..demo.chain import demo_record, run_demo, write_demo
    from ..output import OptionalSteps, check_folder, results_folder, write_run
    from ..vehicles import load_vehicle

    check_folder(out, force)
    model = load_vehicle(vehicle)
    with progress("flying, comparing, explaining") as step:
        chain = run_demo(model, seed, step)
    if as_json:
        print_json(demo_record(chain))
    else:
        STDOUT.print(chain.gap.claim, style="bold")
        print_explanation(chain.found)
    STDERR.print(chain.ending)
    steps, options = OptionalSteps(), {"vehicle": Path(vehicle).name}
    with results_folder(out, force) as folder, progress("building") as step:
        written = write_demo(chain, folder, steps, step)
        write_run(folder, "demo", options, seed=seed, incomplete=steps.incomplete)
    if not as_json:
        print_written(out, written)
    if print_incomplete(steps) or not chain.right:
        raise typer.Exit(Exit.FINDINGS)
