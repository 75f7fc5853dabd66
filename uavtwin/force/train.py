"""Training of a learned force: from flights to a model folder with its report."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from learning.force.model import (
    FILE,
    VEHICLE_FILE,
    ForceModel,
    load_force,
    save_force,
)
from twin.errors import TwinError
from twin.formatting import joined
from twin.frames import AXES
from twin.logs import Flight

from ..exports.parts import LearnedForce, imu_starts
from ..flights import check_names
from ..report.page import render
from ..vehicles import Vehicle
from .hover_noise import hover_noise
from .learn import ACCEPTED, ALONE_S, BETTER, WORSE, Progress, best, learn_force
from .memory import Memory

if TYPE_CHECKING:
    from ..learned import Wanted

REPORT = "report.html"  # in the folder of a law
_LEARNED = 0.95  # approximate share of work done when the law is learned
_SENSORS = ("model", "preset", "horizon", "rate_hz", "epochs", "device", "law")
"""Options of `train` that do not apply to a learned force."""


def check_force_options(wanted: "Wanted") -> None:
    """Refuse options that a learned force does not have.

    Raises:
        TwinError: Such an option is given.
    """
    usual = type(wanted)()
    for name in _SENSORS:
        if (value := getattr(wanted, name)) != getattr(usual, name):
            raise TwinError(
                f"{name.removesuffix('_hz')} {value}: protocol force has no such choice, its law "
                f"is chosen by flying it. Leave it out."
            )


def train_force(
    flights: Sequence[Flight],
    vehicle: Vehicle,
    seed: int,
    out: Path,
    memory: Memory,
    progress: Progress,
) -> list[str]:
    """Learn the residual force and moment of a vehicle, and write them as a model folder.

    Args:
        flights: Training flights.
        vehicle: Vehicle, explained or calibrated.
        seed: Random seed of the wind in the missions.
        out: Folder, which exists.
        memory: Results of steps that were done before.
        progress: Called with the share done, 0..1.

    Returns:
        Names of the files, the report first.

    Raises:
        TwinError: A flight cannot be used, or two have one name.
    """
    check_names(flights)
    model = learn_force(flights, vehicle, seed, memory, lambda done: progress(_LEARNED * done))
    unrest = partial(hover_noise, flights, vehicle, LearnedForce(model))
    noise = memory.array("noise of hovers and of readings", unrest)
    white = tuple(noise[:: len(AXES), 0].tolist())
    model = replace(model, law=replace(model.law, noise=noise[:, 1:]))
    if imu_starts(white):
        model = replace(model, imu_noise=white)
    save_force(model, out)
    (out / VEHICLE_FILE).write_text(vehicle.toml(), "utf-8")
    (out / REPORT).write_text(_page(model), encoding="utf-8")
    return [REPORT, FILE, VEHICLE_FILE]


def force_claim(out: Path) -> str:
    """Summary sentence of a learned force, from its folder."""
    return _claim(load_force(out))


def _parts(model: ForceModel) -> str:
    """Force and moment where a law has all their axes, else its outputs."""
    used = [name for name, output in model.outputs.items() if output.ridge]
    parts = []
    for part in ("force", "moment"):
        axes = [name for name in used if name.startswith(part)]
        parts += [part] if len(axes) == len(AXES) else axes
    return joined(parts)


def _claim(model: ForceModel) -> str:
    if model.law.module is not None:
        return (
            "force: a module of one's own, which no training has judged; alongside it the "
            "untrained observer."
        )
    if len(model.flights) == 1:
        return (
            "force: no law: one flight tells none from an accident; the untrained disturbance "
            "observer alone. Give two flights or more."
        )
    held, gone = model.acceptance, model.closed_loop
    if held.over_observer is None:
        law = "no law: under no ridge does one fly better on flights left out than none"
    else:
        fast = "" if held.fast is None else f", {held.fast:.2f} on fast ones (below 1 is asked)"
        law = (
            f"on flights left out {held.over_observer:.2f} of what the explained twin with the "
            f"untrained observer is off (at most {ACCEPTED:g} is asked; median), and "
            f"{held.over_last_motion:.2f} of the last motion in position and velocity after "
            f"{ALONE_S:g} s{fast}"
        )
        own = f"a law of {_parts(model)}, ridge {model.ridge:g}" if model.ridge else "no law"
        law = f"{own}: {law}"
    if (held.fast or 0.0) >= 1:
        law += "; on fast flights the last motion is closer"
    if gone.unsteady:
        law += f"; laws with which the twin does not come to rest in a hover: {gone.unsteady}"
    if gone.withdrawn:
        law += f"; laws with which missions were lost: {gone.withdrawn}"
    if model.ridge and gone.problem:
        law += f"; flown on no mission, as no controller can be designed: {gone.problem.strip('.')}"
    return f"force: {law}; alongside it the untrained observer."


def _page(model: ForceModel) -> str:
    return render(
        "force_training.html.j2",
        better=1 - BETTER,
        worse=WORSE,
        claim=_claim(model),
        used=best(model.tried),
        model=model,
    )
