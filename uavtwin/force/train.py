"""Training of a learned force: flights to a model folder with its page."""

from collections.abc import Sequence
from pathlib import Path

from learning.force.forecast import NEVER_S
from learning.force.laws import LAWS
from learning.force.model import (
    FILE,
    VEHICLE_FILE,
    ForceModel,
    load_force,
    save_force,
)
from twin.errors import TwinError
from twin.formatting import number, percent
from twin.logs import Flight
from twin.physics.residual_force import OUTPUTS

from ..flights import check_names
from ..report.page import render
from ..vehicles import Vehicle
from .learn import ACCEPTED, BETTER, OBSERVER, WORSE, Progress, learn_force
from .memory import Memory

REPORT = "report.html"  # in the folder of a law
_DEFAULTS = {
    "model": None,
    "preset": None,
    "horizon": 1,
    "rate": None,
    "epochs": None,
    "device": "cpu",
}
"""Options of `train` that a learned force has not."""
NAMES = tuple(f"{kind} {a}" for kind, a in OUTPUTS)
"""Of the outputs, for a reader."""


def check_force_options(
    model: str | None,
    preset: str | None,
    horizon: int,
    rate: float | None,
    epochs: int | None,
    device: str,
) -> None:
    """Refuse options of a training that has none of them.

    Raises:
        TwinError: One is given.
    """
    given = {
        "model": model,
        "preset": preset,
        "horizon": horizon,
        "rate": rate,
        "epochs": epochs,
        "device": device,
    }
    for name, value in given.items():
        if value != _DEFAULTS[name]:
            raise TwinError(
                f"{name} {value}: protocol force has no such choice, its laws are chosen by flying "
                f"them. Leave it out."
            )


def train_force(
    flights: Sequence[Flight],
    vehicle: Vehicle,
    seed: int,
    out: Path,
    memory: Memory,
    progress: Progress,
) -> list[str]:
    """Learn what a vehicle's equations leave, and write it.

    Args:
        flights: To learn from.
        vehicle: Explained or calibrated.
        seed: Of the air of the missions.
        out: Folder, which is there.
        memory: Of the steps that were taken before.
        progress: Called with the share done.

    Returns:
        Names of the files, the page first.

    Raises:
        TwinError: A flight cannot be learned from, or two have one name.
    """
    check_names(flights)
    model = learn_force(flights, vehicle, seed, memory, progress)
    save_force(model, out)
    (out / VEHICLE_FILE).write_text(vehicle.toml(), "utf-8")
    (out / REPORT).write_text(_page(model), encoding="utf-8")
    return [REPORT, FILE, VEHICLE_FILE]


def force_claim(out: Path) -> str:
    """One sentence on a learned force, from its folder."""
    return _claim(load_force(out))


def _claim(model: ForceModel) -> str:
    used = [
        f"{name} {output.law}"
        for name, output in zip(NAMES, model.outputs, strict=True)
        if output.law != LAWS[0]
    ]
    if len(model.flights) == 1:
        return (
            "force: one flight tells no law from an accident; a disturbance observer alone. Give "
            "two flights or more."
        )
    law = (
        f"laws that fly better on flights left out: {', '.join(used)}"
        if used
        else "no law: none flies better on flights left out than none"
    )
    held = model.acceptance
    if held.withdrawn:
        law = (
            f"no law: {', '.join(held.withdrawn)} fly better than none, but on flights left out "
            f"{held.over_observer:.2f} of the explained twin with the untrained observer "
            f"(at most {ACCEPTED:g} is asked), {held.over_last_motion:.2f} of the last motion "
            f"in position and velocity (below 1)"
        )
    gone = model.closed_loop.withdrawn
    lost = f"; withdrawn, as missions were lost with it: {', '.join(gone)}" if gone else ""
    observed = [n for n, o in zip(NAMES, model.outputs, strict=True) if o.observer.lag_s < NEVER_S]
    observer = "an observer of what is left"
    if len(observed) < len(NAMES):
        observer = f"{observer} of {', '.join(observed)}" if observed else "no observer"
    return f"force: {law}{lost}; alongside it {observer}."


def _page(model: ForceModel) -> str:
    return render(
        "force_training.html.j2",
        {"number": number, "percent": percent},
        better=1 - BETTER,
        worse=WORSE,
        claim=_claim(model),
        model=model,
        laws=(OBSERVER, *LAWS[1:]),
        outputs=[
            {
                "name": name,
                "law": output.law,
                "learns": output.observer.lag_s < NEVER_S,
                "observer": output.observer,
                "tried": {f.law: f for f in output.tried},
            }
            for name, output in zip(NAMES, model.outputs, strict=True)
        ],
    )
