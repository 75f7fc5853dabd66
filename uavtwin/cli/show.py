"""`uavtwin show`: the equations of a component, with its numbers."""

from typing import Annotated

import typer

from .options import COMPONENT_NAMES, Effects, Json, Prints, start_values, vehicle_named
from .printing import STDOUT, print_json


def show(
    name: Annotated[
        str,
        typer.Argument(help=f"One of {COMPONENT_NAMES}."),
    ] = "airframe",
    vehicle: Annotated[
        str | None,
        typer.Option(help="Vehicle file (TOML), or the name of a built-in vehicle."),
    ] = None,
    effect: Effects = None,
    start: Annotated[
        list[str] | None, typer.Option(help="Value of a parameter of the component: NAME=VALUE.")
    ] = None,
    contact: Annotated[
        bool, typer.Option("--contact", help="With the forces of the ground, which flight lacks.")
    ] = False,
    as_json: Annotated[
        Json, Prints("fmus.equations:Equation", about="A list, one of each.")
    ] = False,
) -> None:
    """Print the equations of a component as they are assembled, with the vehicle's numbers.

    Terms of effects that are off are omitted. `d x/dt` is the derivative of a state, `next x` its
    value after a sample instant, `t1` a part that several equations share.
    """
    from fmus.equations import equations_of

    from ..exports.parts import component
    from ..vehicles import load_vehicle

    shown = component(name, load_vehicle(vehicle_named(vehicle, "copter_default")))
    values = {f"{e}.enabled": 1.0 for e in effect or ()} | start_values(start)
    equations = equations_of(shown, values, contact)
    if as_json:
        print_json(equations)
        return
    width = max(len(e.left) for e in equations)
    STDOUT.print(shown.description)
    for e in equations:
        note = f"  [{e.unit}] {e.description}" if e.unit else ""
        STDOUT.print(f"{e.left:{width}} = {e.right}{note}")
