"""The law of what a vehicle's equations leave, chosen by the twin that flies it.

First each output's observer has to bring the driven twin closer on flights that took no part in
its choice, and the envelope grows to where the twin goes by itself (`running`). Then the laws of
`learning.force.laws` by which flights left out are more probable than without are put into the FMU
of the driven twin, one after the other alongside what was chosen before, and flights that took no
part in their fit are replayed through it. A law is taken where the twin is then less far off,
together with its observer, and in no quantity farther. All of them together are then held against
what needs no law (`accepted`). Last, missions in random air withdraw what
makes the controller lose the vehicle (`closed_loop`). These flights choose; what the law is worth,
others say.
"""

import hashlib
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cosim.whole_twin import fused_model
from fmus import build
from learning.data.envelope import INSIDE
from learning.force.forecast import AHEAD_S, NO_OBSERVER, Observer
from learning.force.instants import Instants, instants
from learning.force.laws import LAWS, LEAST_GAIN, Candidate, Prepared, prepare
from learning.force.model import (
    Acceptance,
    ForceModel,
    LawScore,
    MissionCheck,
    Output,
    Rival,
    TrainingFlight,
    observer_starts,
)
from twin.errors import TwinError
from twin.flight.assembly import driven_twin
from twin.logs import Flight
from twin.physics.airframe import FADE_S, LAG_S
from twin.physics.residual_force import OUTPUTS, ForceLaw, parameter_values
from twin.physics.rotors import Drive
from twin.representation import short_repr
from twin.residuals.teacher_forced import choose_drive
from twin.vehicle import Vehicle as TwinVehicle

from ..vehicles import Vehicle
from .closed_loop import flyable
from .memory import Memory
from .open_loop import DISTANCE, Replay

Array = NDArray[np.float64]
ALONE_S = 0.5
"""So long a twin that is let go has to stay inside the envelope."""
WIDER = 2.0
"""Most by which the envelope grows for that: where a law has faded before, it has not been."""
_PART = "residual_force."  # in front of a parameter's name


@dataclass(frozen=True, slots=True)
class Lesson:
    """What some flights teach.

    Attributes:
        prepared: The flights.
        fitted: Laws by name of each output.
        drive: Of the twin.
        place: Where the twin is built, once it is to fly.
    """

    prepared: Prepared
    fitted: Sequence[Mapping[str, Candidate]]
    drive: Drive
    place: Path

    __repr__ = short_repr

    @classmethod
    def of(
        cls, flights: Sequence[Instants], vehicle: TwinVehicle, drive: Drive, place: Path
    ) -> "Lesson":
        """The lesson of these flights.

        Args:
            flights: One or more.
            vehicle: Whose equations leave something.
            drive: Of the twin.
            place: File of the twin.
        """
        prepared = prepare(flights, vehicle)
        return cls(prepared, prepared.candidates(), drive, place)

    @property
    def fmu(self) -> Path:
        """Driven twin that flies any of the laws: they are a matter of start values."""
        if not self.place.exists():
            vehicle = self.prepared.vehicle
            parts = driven_twin(vehicle, self.drive, (), self.prepared.empty)
            build(fused_model(parts, vehicle.name), self.place)
        return self.place

    def chosen(self, names: Sequence[str]) -> list[Candidate]:
        """Laws by their names, one per output."""
        return [every[name] for every, name in zip(self.fitted, names, strict=True)]

    def law(self, names: Sequence[str]) -> ForceLaw:
        """The law of these names, made passive."""
        return self.prepared.law(self.chosen(names))[0]

    def running(self, replays: Sequence[Replay], memory: Memory) -> "Lesson":
        """The same, its envelope as wide as the twin goes in half a second by itself.

        A twin that is let go does not stay where the aircraft was, and laws are chosen by where it
        goes: what is judged there is said there.

        Args:
            replays: Of its flights, at `AHEAD_S`.
            memory: Of the steps that were taken before.
        """
        starts = self.starts([LAWS[0]] * len(OUTPUTS))
        near = [i for i, s in enumerate(AHEAD_S) if s <= ALONE_S]

        def quantile() -> Array:
            """Of the distance at the end of the horizons, shape ()."""
            away = [r.through(self.fmu, starts, (DISTANCE,)).watched[:, near, 0] for r in replays]
            return np.asarray(np.quantile(np.concatenate(away), INSIDE))

        reach = memory.array(f"reach {self.place.stem}", quantile)
        wider = float(np.clip(reach, 1.0, WIDER))
        empty = replace(self.prepared.empty, reach=wider * self.prepared.empty.reach)
        place = self.place.with_stem(f"{self.place.stem}_running")
        return replace(self, prepared=replace(self.prepared, empty=empty), place=place)

    def unobserved(self, output: int) -> "Lesson":
        """The same without the observer of one output."""
        fitted = list(self.fitted)
        fitted[output] = {
            law: replace(c, observer=NO_OBSERVER) for law, c in fitted[output].items()
        }
        return replace(self, fitted=fitted)

    def starts(self, names: Sequence[str]) -> dict[str, float]:
        """Start values that make the FMU fly them, each alongside its observer."""
        return law_starts(self.prepared, self.chosen(names))


@dataclass(frozen=True, slots=True)
class Fold:
    """A flight that is left out.

    Attributes:
        replay: Of the flight.
        lesson: Of the others.
        memory: Of the steps that were taken before.
    """

    replay: Replay
    lesson: Lesson
    memory: Memory

    __repr__ = short_repr

    def unobserved(self, output: int) -> "Fold":
        """The same without the observer of one output."""
        return replace(self, lesson=self.lesson.unobserved(output))

    def squares(self, fmu: Path, starts: Mapping[str, float]) -> Array:
        """Mean squares of what a twin is off in the flight left out, shape (horizons, 4, 3)."""
        return np.asarray(np.mean(self.replay.through(fmu, starts).off ** 2, axis=0))

    def squares_of(self, laws: Sequence[str]) -> Array:
        """Those of the twin that flies these laws."""
        return self.memory.array(
            f"{self.lesson.place.stem} {' '.join(laws)}",
            lambda: self.squares(self.lesson.fmu, self.lesson.starts(laws)),
        )


def running(folds: Sequence[Fold], lesson: Lesson, memory: Memory) -> tuple[list[Fold], Lesson]:
    """Envelopes as wide as each twin goes in half a second by itself, in the flights it knows.

    Args:
        folds: One per flight.
        lesson: Of all flights.
        memory: Of the steps that were taken before.
    """
    wider = []
    for fold in folds:
        others = [f.replay for f in folds if f is not fold]
        wider.append(replace(fold, lesson=fold.lesson.running(others, memory)))
    return wider, lesson.running([f.replay for f in folds], memory)


def law_starts(prepared: Prepared, chosen: Sequence[Candidate]) -> dict[str, float]:
    """Weights and observers as start values of the fused FMU.

    Args:
        prepared: Flights that the laws were fitted to.
        chosen: One law per output.
    """
    of_law = in_force(prepared.law(chosen)[0])
    return of_law | observer_starts([c.observer for c in chosen])


def in_force(law: ForceLaw) -> dict[str, float]:
    """Start values by which a fused FMU of the same envelope flies a law."""
    return {_PART + n: v for n, v in parameter_values(law).items()}


OBSERVER = "observer"
"""Its name alongside those of the laws."""
BETTER = 0.01
"""Share by which an observer or a law must lower the error, in the geometric mean over flights,
quantities and horizons."""
WORSE = 1.02
"""No quantity may grow by more, in the geometric mean over flights and horizons."""
_TINY = 1e-30
"""Added to mean squares, so that the ratio of two that are zero is one."""


@dataclass(frozen=True, slots=True)
class Choice:
    """Which laws are used.

    Attributes:
        laws: Name of that of each output.
        tried: What each law of each output did.
    """

    laws: tuple[str, ...]
    tried: tuple[tuple[LawScore, ...], ...]

    @classmethod
    def nothing(cls) -> "Choice":
        """No law, and none tried."""
        return cls((LAWS[0],) * len(OUTPUTS), ((),) * len(OUTPUTS))

    def tried_too(self, flown: Sequence[LawScore]) -> "Choice":
        """The same laws, and one more tried of each output."""
        return Choice(self.laws, tuple((*t, f) for t, f in zip(self.tried, flown, strict=True)))


class Steps:
    """Progress by counted steps."""

    def __init__(self, total: int, progress: Callable[[float], None]) -> None:
        self._total, self._done, self._progress = total, 0, progress

    def one(self) -> None:
        """Another one is done."""
        self._done += 1
        self._progress(self._done / self._total)


def as_flown(law: str, gain: float, squares: Array, without: Array) -> LawScore:
    """What a law or an observer does.

    Args:
        law: Its name.
        gain: Nats.
        squares: Mean squares with it, shape (flights, horizons, 4, 3).
        without: The same without it.
    """
    logs = np.log((squares + _TINY) / (without + _TINY)) / 2
    worst = logs.mean(axis=(0, 1)).max()
    return LawScore(law, gain, float(np.exp(logs.mean())), float(np.exp(worst)))


def best_law(flown: Sequence[LawScore]) -> str:
    """The simplest law within `BETTER` of the best of those that help and do no harm."""
    good = [
        (f.law, f.ratio)
        for f in flown
        if f.ratio is not None and f.worst is not None and f.ratio < 1 - BETTER and f.worst <= WORSE
    ]
    if not good:
        return "none"
    least = min(ratio for _, ratio in good)
    return next(law for law, ratio in good if ratio <= least + BETTER)


def chosen_observers(
    folds: Sequence[Fold], lesson: Lesson, progress: Callable[[float], None]
) -> tuple[list[Fold], Lesson, list[LawScore]]:
    """Observer of each output, one after the other alongside those of the others, no law used yet.

    It is kept where the twin is closer with it in the mean. That no quantity is farther is asked of
    laws alone: where two disturbances hid each other, the other one shows when one is taken away.

    Args:
        folds: One per flight.
        lesson: Of all flights.
        progress: Called with the share done.

    Returns:
        The same without the observers that do not fly better, and what each did.
    """
    used, laws, found = list(folds), Choice.nothing().laws, []
    steps = Steps(len(OUTPUTS) + 1, progress)
    least = left_out(used, laws)
    steps.one()
    for i in range(len(OUTPUTS)):
        silent = [fold.unobserved(i) for fold in used]
        without = left_out(silent, laws)
        found.append(as_flown(OBSERVER, 0.0, least, without))
        ratio = found[-1].ratio
        if ratio is None or ratio >= 1 - BETTER:
            used, lesson, least = silent, lesson.unobserved(i), without
        steps.one()
    return used, lesson, found


def chosen_laws(folds: Sequence[Fold], lesson: Lesson, progress: Callable[[float], None]) -> Choice:
    """Law of each output, output after output.

    Args:
        folds: One per flight.
        lesson: Of all flights: it says which laws are worth a flight.
        progress: Called with the share done.
    """
    steps = Steps(len(OUTPUTS) * (len(LAWS) - 1) + 1, progress)
    laws, found = list(Choice.nothing().laws), []
    least = left_out(folds, laws)
    steps.one()
    for i in range(len(OUTPUTS)):
        flown, squares = [], {laws[i]: least}
        for name in LAWS[1:]:
            gain = lesson.fitted[i][name].gain
            steps.one()
            if gain <= LEAST_GAIN:
                flown.append(LawScore(name, gain))
                continue
            squares[name] = left_out(folds, [*laws[:i], name, *laws[i + 1 :]])
            flown.append(as_flown(name, gain, squares[name], least))
        laws[i] = best_law(flown)
        least = squares[laws[i]]
        found.append(tuple(flown))
    return Choice(tuple(laws), tuple(found))


def left_out(folds: Sequence[Fold], laws: Sequence[str]) -> Array:
    """Mean squares of what the twin with these laws is off in each flight left out, shape
    (flights, horizons, 4, 3)."""
    return np.stack([f.squares_of(laws) for f in folds])


UNTRAINED = (Observer(LAG_S, FADE_S),) * len(OUTPUTS)
"""Observers as the airframe has them, of no flight."""
ACCEPTED = 0.9
"""Share of the error of the explained twin with the untrained observer that laws with their
observers may leave, in the median of cells: what an observer does is none of theirs."""


def accepted(folds: Sequence[Fold], choice: Choice) -> tuple[Choice, Acceptance]:
    """The chosen laws, or none: flights left out have to be flown better than by the explained twin
    with the untrained observer, and position and velocity better than by the last motion.

    Args:
        folds: One per flight.
        choice: Laws that each improve on what was chosen before them.
    """
    used = _names(choice.laws)
    if not used:
        return choice, Acceptance()
    own = left_out(folds, choice.laws).sum(-1)  # (flights, horizons, 4)
    observed, nothing = [], [LAWS[0]] * len(OUTPUTS)
    for fold in folds:
        starts = fold.lesson.starts(nothing) | observer_starts(UNTRAINED)
        place = fold.lesson.place.stem
        observed.append(
            fold.memory.array(
                f"untrained observer {place}", partial(fold.squares, fold.lesson.fmu, starts)
            ).sum(-1)
        )
    last = [np.mean(fold.replay.last_motion().off ** 2, axis=0).sum(-1) for fold in folds]
    over_observer = float(np.median(np.sqrt((own + _TINY) / (np.stack(observed) + _TINY))))
    at = AHEAD_S.index(ALONE_S)
    ratios = (own[:, at, :2] + _TINY) / (np.stack(last)[:, at, :2] + _TINY)
    over_motion = float(np.exp(np.mean(np.log(ratios)) / 2))
    good = over_observer <= ACCEPTED and over_motion < 1
    laws = choice.laws if good else Choice.nothing().laws
    return Choice(laws, choice.tried), Acceptance(over_observer, over_motion, () if good else used)


def _names(laws: Sequence[str]) -> tuple[str, ...]:
    """Of the laws that are used."""
    both = zip(OUTPUTS, laws, strict=True)
    return tuple(f"{kind} {a} {law}" for (kind, a), law in both if law != LAWS[0])


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
    instants_of_flights = []
    for flight in flights:
        instants_of_flights.append(instants(flight, vehicle))
        progress(_READING * len(instants_of_flights) / len(flights))
    with tempfile.TemporaryDirectory() as name:
        lesson = Lesson.of(instants_of_flights, vehicle, drive, Path(name, "all.fmu"))
        choice, acceptance = Choice.nothing(), Acceptance()
        if len(flights) > 1:
            folds = []
            for k, flight in enumerate(flights):
                others = [s for s in instants_of_flights if s is not instants_of_flights[k]]
                taught = Lesson.of(others, vehicle, drive, Path(name, f"{k}.fmu"))
                folds.append(Fold(Replay(flight, vehicle, AHEAD_S), taught, memory))
            part = _part(progress, _READING, _OBSERVERS)
            folds, lesson, observers = chosen_observers(folds, lesson, part)
            folds, lesson = running(folds, lesson, memory)
            choice = chosen_laws(folds, lesson, _part(progress, _OBSERVERS, _LAWS))
            choice, acceptance = accepted(folds, choice)
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
            acceptance=acceptance,
            closed_loop=MissionCheck.nothing(),
            taken=taken,
            flights=tuple(TrainingFlight(f.name, f.fingerprint) for f in flights),
            vehicle=vehicle.name,
            vehicle_sha256=hashlib.sha256(vehicle.toml().encode()).hexdigest(),
            seed=seed,
        )

    part = _part(progress, _LAWS, 1.0)
    return flyable(model(choice.laws), model, vehicle, memory, part)


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
