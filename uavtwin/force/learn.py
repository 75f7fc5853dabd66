"""The law of what a vehicle's equations leave, chosen by the twin that flies it.

For each output the laws of `learning.force.candidates` are put into the FMU of the driven twin, one
after the other, and flights that took no part in their fit are replayed through it. A law is taken
where the twin is then less far off, beside its observer, and in no quantity farther.
"""

import hashlib
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cosim.whole_twin import fused_model
from fmus import build
from learning.force.candidates import LAWS, Candidate
from learning.force.model import (
    NETWORK_FOLDER,
    Flown,
    ForceModel,
    Output,
    Taught,
    fingerprint,
    observer_starts,
)
from learning.force.train import Prepared, prepare, without_waves
from twin.flight.assembly import driven_twin
from twin.logs import Flight
from twin.physics.residual_force import OUTPUTS
from twin.physics.rotors import Drive
from twin.residuals.teacher_forced import choose_drive

from ..vehicles import Vehicle
from .choice import AHEAD_S, as_flown, best_law, weight_starts
from .network import NETWORK, flown_network, train_network
from .open_loop import Replay

Array = NDArray[np.float64]
Progress = Callable[[float], None]


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
        TwinError: A flight lacks the IMU or the motion, or is too short.
    """
    prepared = prepare(flights, vehicle, seed, lambda done: progress(0.1 * done))
    laws = ["none"] * len(OUTPUTS)
    flown: list[tuple[Flown, ...]] = [()] * len(OUTPUTS)
    used = [False] * len(OUTPUTS)
    if len(flights) > 1:
        rows = range(len(flights))
        fitted = [prepared.candidates([i for i in rows if i != out]) for out in rows]
        replays = [Replay(f, prepared.vehicle, AHEAD_S) for f in flights]
        drive = choose_drive(flights[0], vehicle)
        laws, flown = _flown(
            prepared, fitted, replays, drive, lambda done: progress(0.1 + 0.5 * done)
        )
        best = [[c[name] for c, name in zip(f, laws, strict=True)] for f in fitted]
        networks = flown_network(
            prepared, best, replays, drive, seed, lambda done: progress(0.6 + 0.35 * done)
        )
        used = [best_law([n]) == NETWORK for n in networks]
        flown = [(*f, n) for f, n in zip(flown, networks, strict=True)]
    every = prepared.candidates(range(len(flights)))
    chosen = [c[name] for c, name in zip(every, laws, strict=True)]
    law, taken = prepared.law(chosen)
    if any(used):
        train_network(prepared, range(len(flights)), chosen, seed, folder / NETWORK_FOLDER)
    progress(1.0)
    return ForceModel(
        law=without_waves(law),
        rivals={
            name: without_waves(prepared.law([c[name] for c in every])[0]) for name in LAWS[1:]
        },
        outputs=tuple(
            Output(c.law, c.observer, tried, on)
            for c, tried, on in zip(chosen, flown, used, strict=True)
        ),
        taken=taken,
        flights=tuple(Taught(f.name, fingerprint(f)) for f in flights),
        vehicle=vehicle.name,
        vehicle_sha256=hashlib.sha256(vehicle.toml().encode()).hexdigest(),
        seed=seed,
    )


def _flown(
    prepared: Prepared,
    fitted: Sequence[Sequence[Mapping[str, Candidate]]],
    replays: Sequence[Replay],
    drive: Drive,
    progress: Progress,
) -> tuple[list[str], list[tuple[Flown, ...]]]:
    """Law of each output, output after output, and what each did."""
    steps, done = len(OUTPUTS) * (len(LAWS) - 1) + 1, 0
    with tempfile.TemporaryDirectory() as folder:
        parts = driven_twin(prepared.vehicle, drive, (), prepared.empty)
        fmu = build(fused_model(parts, prepared.vehicle.name), Path(folder, "twin.fmu"))

        def errors(laws: Sequence[str]) -> Array:
            """Mean squares over the flights left out, shape (horizons, 4, 3)."""
            nonlocal done
            squares = []
            for replay, every in zip(replays, fitted, strict=True):
                chosen = [c[name] for c, name in zip(every, laws, strict=True)]
                starts = weight_starts(prepared.law(chosen)[0])
                starts |= observer_starts([c.observer for c in chosen])
                squares.append(np.mean(replay.through(fmu, starts).off ** 2, axis=0))
            done += 1
            progress(done / steps)
            return np.asarray(np.mean(squares, axis=0))

        laws = ["none"] * len(OUTPUTS)
        found: list[tuple[Flown, ...]] = []
        least = errors(laws)
        for i in range(len(OUTPUTS)):
            tried = {name: errors([*laws[:i], name, *laws[i + 1 :]]) for name in LAWS[1:]}
            found.append(
                tuple(
                    as_flown(name, e / least, [every[i][name] for every in fitted])
                    for name, e in tried.items()
                )
            )
            laws[i] = best_law(found[-1])
            least = tried.get(laws[i], least)
    return laws, found
