"""The law of what a vehicle's equations leave, chosen by the twin that flies it.

Each flight in turn is left out. The others teach a law through the rollout, under each of
`learning.force.laws.RIDGES`; all of them are put into the FMU of the driven twin, and the flight
that was left out is replayed through it, as long as the twin without a law does not tumble. The
strongest ridge that is as good as the best is taken, of the whole law or of one part of it alone,
where the twin is less far off than without, and in no quantity farther. That law is held against
what needs none (`accepted`). Last, the twin has to rest in a hover and to fly missions in random
air (`closed_loop`). These flights choose; what the law is worth, others say.
"""

import hashlib
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

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
from twin.representation import short_repr
from twin.residuals.aligned import components_of
from twin.residuals.teacher_forced import choose_drive
from twin.vehicle import Vehicle as TwinVehicle

from ..exports.parts import OBSERVER
from ..vehicles import Vehicle
from .closed_loop import flyable
from .memory import Memory
from .open_loop import HORIZONS_S, QUANTITIES, Replay

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Progress = Callable[[float], None]
TUMBLED_RAD = 1.0
"""Attitude that the twin without a law is off (rms), from which on no law is worse than that: how a
twin tumbles is no forecast. Not chosen on flights."""
ALONE_S = 0.5
"""That of the comparison with the last motion, s."""
BETTER = 0.01
"""Share by which a law must lower the error, in the geometric mean over flights, quantities and
horizons."""
WORSE = 1.02
"""No quantity may grow by more, in the geometric mean over flights and horizons."""
ACCEPTED = 0.9
"""Share of the error of the explained twin with the untrained observer that a law may leave, in the
median of cells: what an observer does is none of its own."""
FAST_M_S = 0.5
"""Median speed of a flight from which on it has to be flown better than by the last motion: an
aircraft that hardly moves is foretold best by that, whatever the twin."""
ATTITUDE = [q for q, _ in QUANTITIES].index("attitude")
"""Place among the quantities."""
_PART = "residual_force."  # in front of a parameter's name
_TINY = 1e-30
"""Added to mean squares, so that the ratio of two that are zero is one."""
_UNTOUCHED = 1e-3
"""Share of its error by which a cell that a law leaves alone differs, as a force does rates."""
_TAUGHT, _CHOSEN = 0.4, 0.8
"""Shares of the work that are done after the fits and after the choice, about."""


def in_force(law: ForceLaw) -> dict[str, float]:
    """Start values by which a fused FMU of the same envelope flies a law, its observer on."""
    return {OBSERVER: 1.0} | {_PART + n: v for n, v in parameter_values(law).items()}


@dataclass(frozen=True, slots=True)
class Fold:
    """A flight that is left out.

    Attributes:
        replay: Of the flight.
        taught: By the others.
        path: What they teach, as of `Taught.path`.
        fmu: Driven twin that flies any of these laws: they are a matter of start values.
        memory: Of the steps that were taken before.
    """

    replay: Replay
    taught: Taught
    path: Array
    fmu: Path
    memory: Memory

    __repr__ = short_repr

    @property
    def fast(self) -> bool:
        """Whether it flies at `FAST_M_S` or more, in the median."""
        return self.replay.speed_m_s >= FAST_M_S

    @property
    def last_motion(self) -> Array:
        """Mean squares of what the last motion is off, shape (horizons, 4, 3)."""
        return np.asarray(np.mean(self.replay.last_motion().off ** 2, axis=0))

    def squares(self, choice: Choice | None) -> Array:
        """Those of what the driven twin is off with a law; None: without one."""
        starts = in_force(self.taught.law(self.path, choice))

        def flown() -> Array:
            """By the FMU."""
            return np.asarray(np.mean(self.replay.through(self.fmu, starts).off ** 2, axis=0))

        return self.memory.array(f"flown {self.fmu.stem} {choice}", flown)


@contextmanager
def left_out(
    flights: Sequence[Flight],
    windows: Sequence[FlightWindows],
    vehicle: TwinVehicle,
    drive: Drive,
    memory: Memory,
    progress: Progress,
) -> Iterator[list[Fold]]:
    """Every flight as one that is left out.

    Args:
        flights: Two or more.
        windows: Of each.
        vehicle: Whose twin.
        drive: Of the twin.
        memory: Of the steps that were taken before.
        progress: Called with the share done.
    """
    equations, folds = Equations(vehicle, components_of(vehicle, drive)[0]), []
    with tempfile.TemporaryDirectory() as place:
        for k, flight in enumerate(flights):
            taught = Taught.by([w for i, w in enumerate(windows) if i != k], equations)
            path = memory.array(f"without {flight.name}", taught.path)
            fmu = Path(place, f"{k}.fmu")
            build(fused_model(driven_twin(vehicle, drive, (), taught.empty), vehicle.name), fmu)
            folds.append(Fold(Replay(flight, vehicle), taught, path, fmu, memory))
            progress((k + 1) / len(flights))
        yield folds


def mean_squares(folds: Sequence[Fold], choice: Choice | None) -> Array:
    """Of what the twin with a law is off in each flight left out, (flights, horizons, 4)."""
    return np.stack([f.squares(choice).sum(-1) for f in folds])


def score(choice: Choice, squares: Array, without: Array) -> RidgeScore:
    """What a law does.

    Args:
        choice: Which.
        squares: As of `mean_squares`.
        without: The same without it.
    """
    logs = np.log((squares + _TINY) / (without + _TINY)) / 2
    worst = logs[upright(without)].mean(axis=0).max()
    return RidgeScore(*choice, float(np.exp(logs.mean())), float(np.exp(worst)))


def upright(without: Array) -> BoolArray:
    """Horizons of flights at which a law may be worse, shape (flights, horizons); all where it
    could nowhere.

    Args:
        without: Mean squares of the twin without a law, as of `mean_squares`.
    """
    stands = without[..., ATTITUDE] < TUMBLED_RAD**2
    return np.asarray(stands if stands.any() else ~stands)


def best(tried: Sequence[RidgeScore]) -> Choice | None:
    """The first, of the strongest ridge, within `BETTER` of the best of those that help and do no
    harm; None: none."""
    good = [t for t in tried if t.ratio < 1 - BETTER and t.worst <= WORSE]
    least = min((t.ratio for t in good), default=0.0)
    return next(((t.part, t.ridge) for t in good if t.ratio <= least + BETTER), None)


def accepted(folds: Sequence[Fold], own: Array, without: Array) -> Acceptance:
    """What a law does that twins without one do not: flights left out have to be flown better than
    by the explained twin with the untrained observer, and fast ones better than by the last motion
    in position and velocity.

    Args:
        folds: Flights left out.
        own: As of `mean_squares`, with the law.
        without: The same without it.
    """
    over = np.sqrt((own + _TINY) / (without + _TINY))[upright(without)]
    touched = over[np.abs(over - 1) > _UNTOUCHED]
    over_observer = float(np.median(touched)) if len(touched) else 1.0
    last = np.stack([f.last_motion for f in folds]).sum(-1)
    at = HORIZONS_S.index(ALONE_S)
    ratios = np.log((own[:, at, :2] + _TINY) / (last[:, at, :2] + _TINY)) / 2
    quick = [f.fast for f in folds]
    fast = float(np.exp(ratios[quick].mean())) if any(quick) else None
    refused = over_observer > ACCEPTED or (fast is not None and fast >= 1)
    return Acceptance(over_observer, float(np.exp(ratios.mean())), fast, refused)


def ranked(tried: Sequence[RidgeScore]) -> list[Choice]:
    """The best, and those that follow where it does not fly."""
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
    """Learn what a vehicle's equations leave.

    Args:
        flights: One or more. One tells no law from an accident: nothing is learned then.
        vehicle: Explained or calibrated, so that nothing is learned that has a name.
        seed: Of the air of the missions.
        memory: Of the steps that were taken before.
        progress: Called with the share done.

    Raises:
        TwinError: A flight lacks the motion, is too short, or has another drive than the others.
    """
    drive = drive_of(flights, vehicle)
    equations = Equations(vehicle, components_of(vehicle, drive)[0])
    windows = [FlightWindows.of(flight, vehicle, equations) for flight in flights]
    taught = Taught.by(windows, equations)
    nothing = ForceModel(
        law=taught.empty,
        flights=tuple(TrainingFlight(f.name, f.fingerprint) for f in flights),
        vehicle=vehicle.name,
        vehicle_sha256=hashlib.sha256(vehicle.toml().encode()).hexdigest(),
        seed=seed,
    )
    if len(flights) < 2:
        return nothing
    part = _part(progress, 0.0, _TAUGHT)
    with left_out(flights, windows, vehicle, drive, memory, part) as folds:
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
    """Progress of a part of the work."""
    return lambda done: progress(begins + (ends - begins) * done)


def drive_of(flights: Sequence[Flight], vehicle: Vehicle) -> Drive:
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
