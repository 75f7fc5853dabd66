"""Selection of the law for a vehicle's residual force, by cross-validation in the driven twin.

Leave-one-out over flights: the other flights teach a law through the rollout, under each of
`learning.force.laws.RIDGES`; all of these laws are parameters of one FMU of the driven twin, and
the flight left out is replayed through it up to the horizon at which the twin without a law
tumbles. The strongest ridge that is as good as the best is taken, of the whole law or of one part
of it alone, if it reduces the error overall and increases it in no quantity. That law is compared
with predictions that need no law (`accepted`). Finally, the twin must settle in a hover and fly
missions in random wind (`closed_loop`). These flights select the law; its accuracy must be measured
on others.
"""

import hashlib
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.whole_twin import fused_model
from fmus import build
from learning.force.equations import Equations
from learning.force.laws import PARTS, RIDGES, Choice, Taught
from learning.force.model import Acceptance, ForceModel, RidgeScore, TrainingFlight
from learning.force.windows import FlightWindows
from twin.errors import TwinError
from twin.flight.assembly import driven_twin
from twin.logs import Flight
from twin.physics.residual_force import ForceLaw, parameter_values
from twin.physics.rotors import Drive
from twin.representation import ShortRepr
from twin.residuals.aligned import components_of
from twin.residuals.teacher_forced import choose_drive

from ..exports.parts import OBSERVER
from ..vehicles import Vehicle
from .closed_loop import flyable
from .memory import Memory
from .open_loop import HORIZONS_S, QUANTITIES, Replay

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Progress = Callable[[float], None]
TUMBLED_RAD = 1.0
"""Rms attitude error of the twin without a law, rad, from which on a horizon is not scored: how a
twin tumbles is no prediction. Not chosen on flights."""
ALONE_S = 0.5
"""Horizon of the comparison with constant velocity, s."""
BETTER = 0.01
"""Least relative reduction of the error by a law, in the geometric mean over flights, quantities
and horizons."""
WORSE = 1.02
"""Largest allowed error ratio of any quantity, in the geometric mean over flights and horizons."""
ACCEPTED = 0.9
"""Largest allowed median ratio of the error to that of the explained twin with the untrained
observer, so that the observer's effect is not credited to the law."""
FAST_M_S = 0.5
"""Median speed of a flight, m/s, from which on a law should predict better than constant velocity:
for an aircraft that hardly moves, constant velocity is the best prediction."""
ATTITUDE = [q for q, _ in QUANTITIES].index("attitude")
"""Index among the quantities."""
_PART = "residual_force."  # prefix of the parameters
_TINY = 1e-30
"""Added to mean squares, so that the ratio of two zeros is one."""
_UNTOUCHED = 1e-3
"""Relative change of the error below which a cell counts as unaffected by a law, such as rates by a
force."""
_TAUGHT, _CHOSEN = 0.4, 0.8
"""Approximate shares of the work done after the fits and after the selection."""


def in_force(law: ForceLaw) -> dict[str, float]:
    """Start values with which a fused FMU of the same envelope flies a law, with its observer
    enabled."""
    return {OBSERVER: 1.0} | {_PART + n: v for n, v in parameter_values(law).items()}


@dataclass(frozen=True, slots=True)
class Fold(ShortRepr):
    """Cross-validation fold: one flight that is left out.

    Attributes:
        replay: Replay of the flight.
        taught: Training data of the other flights.
        path: Laws that they teach over ridge parameters, as of `Taught.path`.
        fmu: Driven twin that flies any of these laws, given as start values.
        memory: Results of steps that were done before.
    """

    replay: Replay
    taught: Taught
    path: Array
    fmu: Path
    memory: Memory

    @property
    def fast(self) -> bool:
        """Whether the median speed of the flight is at least `FAST_M_S`."""
        return self.replay.speed_m_s >= FAST_M_S

    @property
    def last_motion(self) -> Array:
        """Mean square errors of constant velocity, shape (horizons, 4, 3)."""
        return np.asarray(np.mean(self.replay.last_motion().off ** 2, axis=0))

    def squares(self, choice: Choice | None) -> Array:
        """Mean square errors of the driven twin with a law, shape (horizons, 4, 3); `choice` None:
        without one."""
        starts = in_force(self.taught.law(self.path, choice))

        def flown() -> Array:
            """The same by simulation of the FMU."""
            return np.asarray(np.mean(self.replay.through(self.fmu, starts).off ** 2, axis=0))

        return self.memory.array(f"flown {self.fmu.stem} {choice}", flown)


def taught_by(flights: Sequence[Flight], vehicle: Vehicle) -> Taught:
    """Training data and envelope of flights.

    Raises:
        TwinError: A flight lacks the motion, is too short, or has a different drive from the
            others.
    """
    equations = Equations(vehicle, components_of(vehicle, drive_of(flights, vehicle))[0])
    return Taught.by([FlightWindows.of(f, vehicle, equations) for f in flights], equations)


def origin(flights: Sequence[Flight], vehicle: Vehicle, seed: int) -> dict[str, Any]:
    """Provenance of a law that these flights teach, fields of `Origin`."""
    return {
        "flights": tuple(TrainingFlight(f.name, f.fingerprint) for f in flights),
        "vehicle": vehicle.name,
        "vehicle_sha256": hashlib.sha256(vehicle.toml().encode()).hexdigest(),
        "seed": seed,
    }


@contextmanager
def left_out(
    flights: Sequence[Flight],
    taught: Taught,
    vehicle: Vehicle,
    memory: Memory,
    progress: Progress,
) -> Iterator[list[Fold]]:
    """Yield the folds of the leave-one-out cross-validation.

    Args:
        flights: Two or more flights.
        taught: Training data of all of them.
        vehicle: Vehicle of the twin.
        memory: Results of steps that were done before.
        progress: Called with the share done, 0..1.
    """
    drive, folds = drive_of(flights, vehicle), []
    with tempfile.TemporaryDirectory() as place:
        for k, flight in enumerate(flights):
            rest = [w for i, w in enumerate(taught.flights) if i != k]
            others = Taught.by(rest, taught.equations)
            path = memory.array(f"without {flight.name}", others.path)
            fmu = Path(place, f"{k}.fmu")
            build(fused_model(driven_twin(vehicle, drive, (), others.empty), vehicle.name), fmu)
            folds.append(Fold(Replay(flight, vehicle), others, path, fmu, memory))
            progress((k + 1) / len(flights))
        yield folds


def mean_squares(folds: Sequence[Fold], choice: Choice | None) -> Array:
    """Mean square errors of the twin with a law in each flight left out, shape (flights, horizons,
    4)."""
    return np.stack([f.squares(choice).sum(-1) for f in folds])


def score(choice: Choice, squares: Array, without: Array) -> RidgeScore:
    """Score of a law.

    Args:
        choice: The law: ridge and part.
        squares: Mean square errors with the law, as of `mean_squares`.
        without: Mean square errors without it.
    """
    logs = np.log((squares + _TINY) / (without + _TINY)) / 2
    worst = logs[upright(without)].mean(axis=0).max()
    return RidgeScore(*choice, float(np.exp(logs.mean())), float(np.exp(worst)))


def upright(without: Array) -> BoolArray:
    """Horizons of flights that are scored, where the twin does not tumble without a law, shape
    (flights, horizons); all, where it tumbles everywhere.

    Args:
        without: Mean square errors of the twin without a law, as of `mean_squares`.
    """
    stands = without[..., ATTITUDE] < TUMBLED_RAD**2
    return np.asarray(stands if stands.any() else ~stands)


def best(tried: Sequence[RidgeScore]) -> Choice | None:
    """The strongest ridge within `BETTER` of the best score, among laws that help and do no harm;
    None: there is none."""
    good = [t for t in tried if t.ratio < 1 - BETTER and t.worst <= WORSE]
    least = min((t.ratio for t in good), default=0.0)
    return next(((t.part, t.ridge) for t in good if t.ratio <= least + BETTER), None)


def accepted(folds: Sequence[Fold], own: Array, without: Array) -> Acceptance:
    """Acceptance test of a law: flights left out must be predicted better than by the explained
    twin with the untrained observer, which is what remains without a law. Whether they are
    predicted better than by constant velocity in position and velocity is reported.

    Args:
        folds: Folds of the cross-validation.
        own: Mean square errors with the law, as of `mean_squares`.
        without: Mean square errors without it.
    """
    over = np.sqrt((own + _TINY) / (without + _TINY))[upright(without)]
    touched = over[np.abs(over - 1) > _UNTOUCHED]
    over_observer = float(np.median(touched)) if len(touched) else 1.0
    last = np.stack([f.last_motion for f in folds]).sum(-1)
    at = HORIZONS_S.index(ALONE_S)
    ratios = np.log((own[:, at, :2] + _TINY) / (last[:, at, :2] + _TINY)) / 2
    quick = [f.fast for f in folds]
    fast = float(np.exp(ratios[quick].mean())) if any(quick) else None
    return Acceptance(
        over_observer, float(np.exp(ratios.mean())), fast, refused=over_observer > ACCEPTED
    )


def ranked(tried: Sequence[RidgeScore]) -> list[Choice]:
    """The best choice, then those to try if it does not fly."""
    left, found = list(tried), []
    while (choice := best(left)) is not None:
        found.append(choice)
        left = [t for t in left if (t.part, t.ridge) != choice]
    return found


def learn_force(
    flights: Sequence[Flight],
    vehicle: Vehicle,
    seed: int,
    memory: Memory,
    progress: Progress,
) -> ForceModel:
    """Learn the residual force and moment of a vehicle's equations.

    Args:
        flights: One or more flights. A single flight cannot separate a law from chance: nothing is
            learned then.
        vehicle: Vehicle, explained or calibrated, so that no known effect is learned.
        seed: Random seed of the wind in the missions.
        memory: Results of steps that were done before.
        progress: Called with the share done, 0..1.

    Raises:
        TwinError: As `taught_by`.
    """
    taught = taught_by(flights, vehicle)
    nothing = ForceModel(law=taught.empty, **origin(flights, vehicle, seed))
    if len(flights) < 2:
        return nothing
    part = _part(progress, 0.0, _TAUGHT)
    with left_out(flights, taught, vehicle, memory, part) as folds:
        part = _part(progress, _TAUGHT, _CHOSEN)
        without, flown = mean_squares(folds, None), dict[Choice, Array]()
        for ridge, kind in product(RIDGES, PARTS):
            flown[kind, ridge] = mean_squares(folds, (kind, ridge))
            part(len(flown) / (len(RIDGES) * len(PARTS)))
        tried = tuple(score(choice, squares, without) for choice, squares in flown.items())
        held = [(choice, accepted(folds, flown[choice], without)) for choice in ranked(tried)]
    judged = replace(nothing, tried=tried, acceptance=held[0][1] if held else Acceptance())
    fine = [(choice, a) for choice, a in held if not a.refused]
    if not fine:
        return judged
    path = memory.array("all flights", taught.path)
    laws = [
        replace(judged, law=taught.law(path, choice), ridge=choice[1], acceptance=a)
        for choice, a in fine
    ]
    return flyable(laws, judged, vehicle, memory, _part(progress, _CHOSEN, 1.0))


def _part(progress: Progress, begins: float, ends: float) -> Progress:
    """Progress callback of a part of the work, scaled to [begins, ends]."""
    return lambda done: progress(begins + (ends - begins) * done)


def drive_of(flights: Sequence[Flight], vehicle: Vehicle) -> Drive:
    """Drive of the rotors, the same in all flights."""
    drives = [choose_drive(flight, vehicle) for flight in flights]
    for flight, drive in zip(flights, drives, strict=True):
        if drive != drives[0]:
            raise TwinError(
                f"{flight.source or flight.name}: is driven by {drive}, {flights[0].name} by "
                f"{drives[0]}; a law is learned for one of them. Give flights that have the same "
                f"motor columns."
            )
    return drives[0]
