"""The law of what a vehicle's equations leave, chosen by the twin that flies it.

For each output the laws of `learning.force.candidates` are put into the FMU of the driven twin, one
after the other, and flights that took no part in their fit are replayed through it. A law is taken
where the twin is then less far off, beside its observer, and in no quantity farther.
"""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cosim.whole_twin import fused_model
from fmus import build
from learning.force.candidates import LAWS, Candidate
from learning.force.train import Prepared, prepare, without_waves
from twin.flight.assembly import driven_twin
from twin.logs import Flight
from twin.physics.residual_force import OUTPUTS, ForceLaw, weight_names
from twin.representation import short_repr
from twin.residuals.teacher_forced import choose_drive
from twin.vehicle import Vehicle

from .open_loop import Replay

Array = NDArray[np.float64]
AHEAD_S = (0.2, 0.5, 1.0)
"""Horizons at which laws are compared."""
BETTER = 0.01
"""Share by which a law must lower the error, in the geometric mean over quantities and horizons."""
WORSE = 1.02
"""No quantity at any of the horizons may grow by more."""
PART = "residual_force."


@dataclass(frozen=True, slots=True)
class Flown:
    """One law of one output, as flown.

    Attributes:
        law: Of `LAWS`.
        ratio: Error over that without it, geometric mean over quantities and horizons.
        worst: The largest of these ratios.
        gain: Nats, as of `learning.force.candidates.Candidate`.
    """

    law: str
    ratio: float
    worst: float
    gain: float


@dataclass(frozen=True, slots=True)
class LearnedForce:
    """A law, and how it was come by.

    Attributes:
        law: Its numbers.
        chosen: By output of `OUTPUTS`.
        flown: By output, every law that was tried.
        taken: Largest rate, 1/s, at which the linear part would have fed energy in; taken out.
        flights: Names.
    """

    law: ForceLaw
    chosen: tuple[Candidate, ...]
    flown: tuple[tuple[Flown, ...], ...]
    taken: float
    flights: tuple[str, ...]

    __repr__ = short_repr

    @property
    def observer_starts(self) -> dict[str, float]:
        """Parameters of the driven twin's airframe by which its observer is that of the law."""
        return observer_starts(self.chosen)


def learn_force(
    flights: Sequence[Flight],
    vehicle: Vehicle,
    seed: int = 0,
    progress: Callable[[float], None] = lambda _: None,
) -> LearnedForce:
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
    laws, flown = ["none"] * len(OUTPUTS), tuple(() for _ in OUTPUTS)
    if len(flights) > 1:
        laws, flown = _flown(flights, prepared, lambda done: progress(0.1 + 0.85 * done))
    every = prepared.candidates(range(len(flights)))
    chosen = tuple(c[name] for c, name in zip(every, laws, strict=True))
    law, taken = prepared.law(chosen)
    progress(1.0)
    return LearnedForce(without_waves(law), chosen, flown, taken, tuple(f.name for f in flights))


def observer_starts(chosen: Sequence[Candidate]) -> dict[str, float]:
    """Parameters of a driven twin by which its observer is that of the candidates."""
    starts = {"airframe.disturbance.enabled": 1.0}
    for (kind, a), candidate in zip(OUTPUTS, chosen, strict=True):
        starts[f"airframe.disturbance.lag.{kind}_{a}"] = candidate.observer.lag_s
        starts[f"airframe.disturbance.fade.{kind}_{a}"] = candidate.observer.fade_s
    return starts


def _flown(
    flights: Sequence[Flight], prepared: Prepared, progress: Callable[[float], None]
) -> tuple[list[str], tuple[tuple[Flown, ...], ...]]:
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
                starts = _starts(prepared.law(chosen)[0]) | observer_starts(chosen)
                squares.append(np.mean(replay.through(fmu, starts).off ** 2, axis=0))
            done += 1
            progress(done / steps)
            return np.mean(squares, axis=0)

        laws, found = ["none"] * len(OUTPUTS), []
        least = errors(laws)
        for i in range(len(OUTPUTS)):
            tried = {name: errors([*laws[:i], name, *laws[i + 1 :]]) for name in LAWS[1:]}
            ratios = {name: np.sqrt(e / least) for name, e in tried.items()}
            found.append(
                tuple(
                    Flown(
                        name,
                        float(np.exp(np.mean(np.log(r)))),
                        float(r.max()),
                        float(np.mean([every[i][name].gain for every in fitted])),
                    )
                    for name, r in ratios.items()
                )
            )
            laws[i] = _best(found[-1])
            least = tried.get(laws[i], least)
    return laws, tuple(found)


def _best(flown: Sequence[Flown]) -> str:
    """The simplest law within `BETTER` of the best of those that help and do no harm."""
    good = [f for f in flown if f.ratio < 1 - BETTER and f.worst <= WORSE]
    if not good:
        return "none"
    least = min(f.ratio for f in good)
    return next(f.law for f in good if f.ratio <= least + BETTER)


def _starts(law: ForceLaw) -> Mapping[str, float]:
    """The weights of a law as start values of the fused FMU."""
    names = [n for table in weight_names(law) for row in table for n in row]
    values = np.concatenate([law.linear.ravel(), law.waves.ravel()]).tolist()
    return {PART + n: v for n, v in zip(names, values, strict=True)}
