"""The law of what a vehicle's equations leave, chosen by the twin that flies it.

First each output's observer has to bring the driven twin closer on flights that took no part in
its choice, and the envelope grows to where the twin goes by itself (`fold`). Then the laws of
`learning.force.candidates` by which flights left out are more probable than without are put into
the FMU of the driven twin, one after the other beside what was chosen before, and flights that took
no part in their fit are replayed through it. A law is taken where the twin is then less far off,
beside its observer, and in no quantity farther. Then all of them are refined together by flying
(`refinement`), and kept so on the same condition. Last, missions in random air withdraw what makes
the controller lose the vehicle (`closed_loop`). These flights choose; what the law is worth, others
say.
"""

import hashlib
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from learning.force.candidates import LAWS
from learning.force.forecast import AHEAD_S
from learning.force.instants import instants
from learning.force.model import NETWORK_FOLDER, Checked, ForceModel, Output, Rival, Taught
from learning.force.train import without_waves
from twin.errors import TwinError
from twin.logs import Flight
from twin.physics.residual_force import OUTPUTS
from twin.physics.rotors import Drive
from twin.residuals.teacher_forced import choose_drive

from ..vehicles import Vehicle
from .choice import Choice, best_law, chosen_laws, chosen_observers
from .closed_loop import kept
from .fold import Fold, Lesson, running
from .memory import Memory
from .network import NETWORK, flown_network, train_network
from .open_loop import Replay
from .refinement import refine

Progress = Callable[[float], None]
_READING, _OBSERVERS, _LAWS, _REFINED, _NETWORK = 0.1, 0.2, 0.45, 0.65, 0.9
"""Shares of the work that are done after each part, about."""


def learn_force(
    flights: Sequence[Flight],
    vehicle: Vehicle,
    seed: int,
    folder: Path,
    memory: Memory,
    progress: Progress,
) -> ForceModel:
    """Learn what a vehicle's equations leave.

    Args:
        flights: One or more. One tells no law from an accident: nothing but the observer is
            learned then.
        vehicle: Explained or calibrated, so that nothing is learned that has a name.
        seed: Of the random features and of the network.
        folder: Where the network goes, if it is used.
        memory: Of the steps that were taken before.
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
    with tempfile.TemporaryDirectory() as name:
        lesson = Lesson.of(seen, vehicle, drive, seed, Path(name, "all.fmu"))
        choice, used = Choice.nothing(), [False] * len(OUTPUTS)
        if len(flights) > 1:
            folds = []
            for k, flight in enumerate(flights):
                others = [s for s in seen if s is not seen[k]]
                taught = Lesson.of(others, vehicle, drive, seed, Path(name, f"{k}.fmu"))
                folds.append(Fold(Replay(flight, vehicle, AHEAD_S), seen[k], taught, memory))
            part = _part(progress, _READING, _OBSERVERS)
            folds, lesson, observers = chosen_observers(folds, lesson, part)
            folds, lesson = running(folds, lesson, memory)
            choice = chosen_laws(folds, lesson, _part(progress, _OBSERVERS, _LAWS))
            choice = choice.tried_too(observers)
            folds, lesson, choice = refine(folds, lesson, choice, _part(progress, _LAWS, _REFINED))
            part = _part(progress, _REFINED, _NETWORK)
            networks = flown_network(folds, choice.laws, drive, seed, part)
            choice, used = choice.tried_too(networks), [best_law([n]) == NETWORK for n in networks]
        if any(used):
            law = lesson.law(choice.laws)
            train_network(lesson.prepared, law, seed, folder / NETWORK_FOLDER, memory)
    rivals = {name: _rival(lesson, name) for name in LAWS}

    def model(laws: Sequence[str], networks: Sequence[bool]) -> ForceModel:
        """With these laws, and the network on these outputs."""
        chosen = lesson.chosen(laws)
        law, taken = lesson.prepared.law(chosen)
        return ForceModel(
            law=without_waves(law),
            rivals=rivals,
            outputs=tuple(
                Output(c.law, c.observer, tried, network)
                for c, tried, network in zip(chosen, choice.tried, networks, strict=True)
            ),
            closed_loop=Checked.nothing(),
            taken=taken,
            flights=tuple(Taught(f.name, f.fingerprint) for f in flights),
            vehicle=vehicle.name,
            vehicle_sha256=hashlib.sha256(vehicle.toml().encode()).hexdigest(),
            seed=seed,
        )

    part = _part(progress, _NETWORK, 1.0)
    return kept(model(choice.laws, used), model, folder, vehicle, memory, part)


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


def _rival(lesson: Lesson, name: str) -> Rival:
    """Every output by one law, each with its own observer."""
    names = [name] * len(OUTPUTS)
    observers = tuple(c.observer for c in lesson.chosen(names))
    return Rival(without_waves(lesson.law(names)), observers)


def _part(progress: Progress, begins: float, ends: float) -> Progress:
    """Progress of a part of the work."""
    return lambda done: progress(begins + (ends - begins) * done)
