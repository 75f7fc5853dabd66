"""The law of what a vehicle's equations leave, chosen by the twin that flies it.

For each output the laws of `learning.force.candidates` are put into the FMU of the driven twin, one
after the other, and flights that took no part in their fit are replayed through it. A law is taken
where the twin is then less far off, beside its observer, and in no quantity farther.
"""

import hashlib
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cosim.whole_twin import fused_model
from fmus import build
from learning.force.candidates import LAWS, Candidate
from learning.force.model import (
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
from twin.physics.residual_force import OUTPUTS, ForceLaw, weight_names
from twin.residuals.teacher_forced import choose_drive

from ..vehicles import Vehicle
from .open_loop import Replay

Array = NDArray[np.float64]
Progress = Callable[[float], None]
AHEAD_S = (0.2, 0.5, 1.0)
"""Horizons at which laws are compared."""
BETTER = 0.01
"""Share by which a law must lower the error, in the geometric mean over quantities and horizons."""
WORSE = 1.02
"""No quantity may grow by more, in the geometric mean over the horizons."""
PART = "residual_force."


def learn_force(
    flights: Sequence[Flight],
    vehicle: Vehicle,
    seed: int = 0,
    progress: Progress = lambda _: None,
) -> ForceModel:
    """Learn what a vehicle's equations leave.

    Args:
        flights: One or more. One tells no law from an accident: nothing but the observer is
            learned then.
        vehicle: Explained or calibrated, so that nothing is learned that has a name.
        seed: Of the random features.
        progress: Called with the share done.

    Raises:
        TwinError: A flight lacks the IMU or the motion, or is too short.
    """
    prepared = prepare(flights, vehicle, seed, lambda done: progress(0.1 * done))
    laws = ["none"] * len(OUTPUTS)
    flown: list[tuple[Flown, ...]] = [()] * len(OUTPUTS)
    if len(flights) > 1:
        laws, flown = _flown(flights, prepared, lambda done: progress(0.1 + 0.85 * done))
    every = prepared.candidates(range(len(flights)))
    chosen = [c[name] for c, name in zip(every, laws, strict=True)]
    law, taken = prepared.law(chosen)
    progress(1.0)
    return ForceModel(
        law=without_waves(law),
        rivals={
            name: without_waves(prepared.law([c[name] for c in every])[0]) for name in LAWS[1:]
        },
        outputs=tuple(
            Output(c.law, c.observer, tried) for c, tried in zip(chosen, flown, strict=True)
        ),
        taken=taken,
        flights=tuple(Taught(f.name, fingerprint(f)) for f in flights),
        vehicle=vehicle.name,
        vehicle_sha256=hashlib.sha256(vehicle.toml().encode()).hexdigest(),
        seed=seed,
    )


def _flown(
    flights: Sequence[Flight], prepared: Prepared, progress: Progress
) -> tuple[list[str], list[tuple[Flown, ...]]]:
    """Law of each output, output after output, and what each did."""
    rows = range(len(flights))
    fitted = [prepared.candidates([i for i in rows if i != out]) for out in rows]
    replays = [Replay(f, prepared.vehicle, AHEAD_S) for f in flights]
    steps, done = len(OUTPUTS) * (len(LAWS) - 1) + 1, 0
    with tempfile.TemporaryDirectory() as folder:
        drive = choose_drive(flights[0], prepared.vehicle)
        parts = driven_twin(prepared.vehicle, drive, (), prepared.empty)
        fmu = build(fused_model(parts, prepared.vehicle.name), Path(folder, "twin.fmu"))

        def errors(laws: Sequence[str]) -> Array:
            """Mean squares over the flights left out, shape (horizons, 4, 3)."""
            nonlocal done
            squares = []
            for replay, every in zip(replays, fitted, strict=True):
                chosen = [c[name] for c, name in zip(every, laws, strict=True)]
                starts = _starts(prepared.law(chosen)[0])
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
                    _as_flown(name, e / least, [every[i][name] for every in fitted])
                    for name, e in tried.items()
                )
            )
            laws[i] = _best(found[-1])
            least = tried.get(laws[i], least)
    return laws, found


def _as_flown(name: str, squares: Array, fitted: Sequence[Candidate]) -> Flown:
    """A law from its mean squares over those without it, shape (horizons, 4, 3)."""
    cells = np.exp(np.mean(np.log(squares), axis=0) / 2)
    return Flown(
        law=name,
        ratio=float(np.exp(np.mean(np.log(cells)))),
        worst=float(cells.max()),
        gain=float(np.mean([c.gain for c in fitted])),
    )


def _best(flown: Sequence[Flown]) -> str:
    """The simplest law within `BETTER` of the best of those that help and do no harm."""
    good = [f for f in flown if f.ratio < 1 - BETTER and f.worst <= WORSE]
    if not good:
        return "none"
    least = min(f.ratio for f in good)
    return next(f.law for f in good if f.ratio <= least + BETTER)


def _starts(law: ForceLaw) -> dict[str, float]:
    """The weights of a law as start values of the fused FMU."""
    names = [n for table in weight_names(law) for row in table for n in row]
    values = np.concatenate([law.linear.ravel(), law.waves.ravel()]).tolist()
    return {PART + n: v for n, v in zip(names, values, strict=True)}
