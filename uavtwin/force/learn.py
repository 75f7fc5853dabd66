"""The law of what a vehicle's equations leave, chosen by the twin that flies it.

First each output's observer has to bring the driven twin closer on flights that took no part in
its choice, and the envelope grows to where the twin goes by itself (`fold`). Then the laws of
`learning.force.laws` by which flights left out are more probable than without are put into
the FMU of the driven twin, one after the other beside what was chosen before, and flights that took
no part in their fit are replayed through it. A law is taken where the twin is then less far off,
beside its observer, and in no quantity farther. Last, missions in random air withdraw what makes
the controller lose the vehicle (`closed_loop`). These flights choose; what the law is worth, others
say.
"""

import hashlib
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from learning.force.forecast import AHEAD_S
from learning.force.instants import instants
from learning.force.laws import LAWS
from learning.force.model import Checked, ForceModel, Output, Rival, Taught
from twin.errors import TwinError
from twin.logs import Flight
from twin.physics.residual_force import OUTPUTS
from twin.physics.rotors import Drive
from twin.residuals.teacher_forced import choose_drive

from ..vehicles import Vehicle
from .choice import Choice, chosen_laws, chosen_observers
from .closed_loop import kept
from .fold import Fold, Lesson, running
from .memory import Memory
from .open_loop import Replay

Progress = Callable[[float], None]
_READING, _OBSERVERS, _LAWS = 0.1, 0.3, 0.8
"""Shares of the work that are done after each part, about."""


def learn_force(
    flights: Sequence[Flight],
    vehicle: Vehicle,
    seed: int,
    memory: Memory,
    progress: Progress,
) -> ForceModel:
    """Learn what a vehicle's equations leave.

    Args:
        flights: One or more. One tells no law from an accident: nothing but the observer is
            learned then.
        vehicle: Explained or calibrated, so that nothing is learned that has a name.
        seed: Of the air of the missions.
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
        lesson = Lesson.of(seen, vehicle, drive, Path(name, "all.fmu"))
        choice = Choice.nothing()
        if len(flights) > 1:
            folds = []
            for k, flight in enumerate(flights):
                others = [s for s in seen if s is not seen[k]]
                taught = Lesson.of(others, vehicle, drive, Path(name, f"{k}.fmu"))
                folds.append(Fold(Replay(flight, vehicle, AHEAD_S), seen[k], taught, memory))
            part = _part(progress, _READING, _OBSERVERS)
            folds, lesson, observers = chosen_observers(folds, lesson, part)
            folds, lesson = running(folds, lesson, memory)
            choice = chosen_laws(folds, lesson, _part(progress, _OBSERVERS, _LAWS))
            choice = choice.tried_too(observers)
    rivals = {name: _rival(lesson, name) for name in LAWS}

    def model(laws: Sequence[str]) -> ForceModel:
        """With these laws."""
        chosen = lesson.chosen(laws)
        law, taken = lesson.prepared.law(chosen)
        return ForceModel(
            law=law,
            rivals=rivals,
            outputs=tuple(
                Output(c.law, c.observer, tried)
                for c, tried in zip(chosen, choice.tried, strict=True)
            ),
            closed_loop=Checked.nothing(),
            taken=taken,
            flights=tuple(Taught(f.name, f.fingerprint) for f in flights),
            vehicle=vehicle.name,
            vehicle_sha256=hashlib.sha256(vehicle.toml().encode()).hexdigest(),
            seed=seed,
        )

    part = _part(progress, _LAWS, 1.0)
    return kept(model(choice.laws), model, vehicle, memory, part)


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
    return Rival(lesson.law(names), observers)


def _part(progress: Progress, begins: float, ends: float) -> Progress:
    """Progress of a part of the work."""
    return lambda done: progress(begins + (ends - begins) * done)
