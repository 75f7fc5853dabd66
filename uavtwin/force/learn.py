"""The law of what a vehicle's equations leave, chosen by the twin that flies it.

For each output the laws of `learning.force.candidates` by which flights left out are more probable
than without are put into the FMU of the driven twin, one after the other beside what was chosen
before, and flights that took no part in their fit are replayed through it. A law is taken where the
twin is then less far off, beside its observer, and in no quantity farther. Then all of them are
refined together by flying (`refinement`), and kept so on the same condition. These flights choose;
what the law is worth, others say.
"""

import hashlib
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cosim.whole_twin import fused_model
from fmus import build
from learning.force.candidates import LAWS, WORTH, Candidate
from learning.force.forecast import AHEAD_S
from learning.force.instants import instants
from learning.force.model import NETWORK_FOLDER, Flown, ForceModel, Output, Rival, Taught
from learning.force.train import Prepared, prepare, without_waves
from twin.errors import TwinError
from twin.flight.assembly import driven_twin
from twin.logs import Flight
from twin.physics.residual_force import OUTPUTS
from twin.physics.rotors import Drive
from twin.residuals.teacher_forced import choose_drive

from ..vehicles import Vehicle
from .choice import Fold, Steps, as_flown, best_law
from .network import NETWORK, flown_network, train_network
from .open_loop import Replay
from .refinement import REFINED, ROUNDS, refined, to_refine

Array = NDArray[np.float64]
Progress = Callable[[float], None]
_READING, _LAWS, _REFINED, _NETWORK = 0.1, 0.5, 0.7, 0.95
"""Shares of the work that are done after each part, about."""


def learn_force(
    flights: Sequence[Flight], vehicle: Vehicle, seed: int, folder: Path, progress: Progress
) -> ForceModel:
    """Learn what a vehicle's equations leave.

    Args:
        flights: One or more. One tells no law from an accident: nothing but the observer is
            learned then.
        vehicle: Explained or calibrated, so that nothing is learned that has a name.
        seed: Of the random features and of the network.
        folder: Where the network goes, if it is used.
        progress: Called with the share done.

    Raises:
        TwinError: A flight lacks the IMU or the motion, is too short, or has another drive than
            the others.
    """
    drive = _drive(flights, vehicle)
    seen = []
    for flight in flights:
        seen.append(instants(flight, vehicle))
        progress(_READING * len(seen) / len(flights))
    laws, used = ["none"] * len(OUTPUTS), [False] * len(OUTPUTS)
    flown: list[tuple[Flown, ...]] = [()] * len(OUTPUTS)
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        lesson = Lesson.of(seen, vehicle, drive, seed, place / "all.fmu")
        if len(flights) > 1:
            folds = []
            for k, flight in enumerate(flights):
                others = [s for s in seen if s is not seen[k]]
                taught = Lesson.of(others, vehicle, drive, seed, place / f"{k}.fmu")
                folds.append(Fold(Replay(flight, vehicle, AHEAD_S), seen[k], taught))
            laws, flown = _flown(folds, lesson, _part(progress, _READING, _LAWS))
            lesson, folds, refined_ = _refined(folds, lesson, laws, _part(progress, _LAWS, _REFINED))
            laws, flown = _taken(laws, flown, refined_)
            networks = flown_network(folds, laws, drive, seed, _part(progress, _REFINED, _NETWORK))
            used = [best_law([n]) == NETWORK for n in networks]
            flown = _with(flown, networks)
    prepared, chosen = lesson.prepared, lesson.chosen(laws)
    law, taken = prepared.law(chosen)
    if any(used):
        train_network(prepared, law, seed, folder / NETWORK_FOLDER)
    progress(1.0)
    return ForceModel(
        law=without_waves(law),
        rivals={name: _rival(prepared, [c[name] for c in every]) for name in LAWS},
        outputs=tuple(
            Output(c.law, c.observer, tried, on)
            for c, tried, on in zip(chosen, flown, used, strict=True)
        ),
        taken=taken,
        flights=tuple(Taught(f.name, f.fingerprint) for f in flights),
        vehicle=vehicle.name,
        vehicle_sha256=hashlib.sha256(vehicle.toml().encode()).hexdigest(),
        seed=seed,
    )


def _drive(flights: Sequence[Flight], vehicle: Vehicle) -> Drive:
    """What drives the rotors, the same in all flights."""
    drives = [choose_drive(flight, vehicle) for flight in flights]
    for flight, drive in zip(flights, drives, strict=True):
        if drive != drives[0]:
            raise TwinError(
                f"{flight.source or flight.name}: is driven by {drive}, {flights[0].name} by "
                f"{drives[0]}; a law is learned for one of them. Give flights that have the same "
                f"motor columns."
            )
    return drives[0]


def _rival(prepared: Prepared, chosen: Sequence[Candidate]) -> Rival:
    """Every output by one law, each with its own observer."""
    law = without_waves(prepared.law(chosen)[0])
    return Rival(law, tuple(c.observer for c in chosen))


def _part(progress: Progress, begins: float, ends: float) -> Progress:
    """Progress of a part of the work."""
    return lambda done: progress(begins + (ends - begins) * done)


def _flown(
    folds: Sequence[Fold],
    every: Sequence[Mapping[str, Candidate]],
    drive: Drive,
    progress: Progress,
) -> tuple[list[str], list[tuple[Flown, ...]]]:
    """Law of each output, output after output, and what each did.

    Args:
        folds: One per flight.
        every: Laws by name of each output, of all flights: they say which are worth a flight.
        drive: Of the twin.
        progress: Called with the share done.
    """
    steps = Steps(len(folds) + len(OUTPUTS) * (len(LAWS) - 1) + 1, progress)
    with tempfile.TemporaryDirectory() as folder:
        twins = []
        for k, fold in enumerate(folds):
            vehicle = fold.prepared.vehicle
            parts = driven_twin(vehicle, drive, (), fold.prepared.empty)
            fmu = build(fused_model(parts, vehicle.name), Path(folder, f"{k}.fmu"))
            twins.append((fold, fmu))
            steps.one()

        def squares(names: Sequence[str]) -> Array:
            """Mean squares of each flight left out, shape (flights, horizons, 4, 3)."""
            off = [fold.squares(fmu, fold.law(names)[1]) for fold, fmu in twins]
            steps.one()
            return np.stack(off)

        laws = ["none"] * len(OUTPUTS)
        found: list[tuple[Flown, ...]] = []
        least = squares(laws)
        for i in range(len(OUTPUTS)):
            gains = {name: every[i][name].gain for name in LAWS[1:]}
            tried = {
                name: squares([*laws[:i], name, *laws[i + 1 :]])
                for name, gain in gains.items()
                if gain > WORTH
            }
            found.append(
                tuple(
                    as_flown(name, gain, tried[name], least) if name in tried else Flown(name, gain)
                    for name, gain in gains.items()
                )
            )
            laws[i] = best_law(found[-1])
            least = tried.get(laws[i], least)
    return laws, found
