"""Hypotheses of a change in flight, and the numbers that decide when an alarm is raised."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...effects import BEGINNINGS, EFFECTS, Begins, Equation, prior_of
from ...effects.parameters import Prior
from ...errors import ModelError
from ...representation import short_repr
from ...vehicle import Vehicle
from ..inference.priors import parameter_of
from ..model.numbers import Number, numbers_of
from ..setting_group import Group, setting

_TUNED = "chosen on: the tuning flights of benchmarks/live_alarms, seeds below 1000"
"""Origin of a setting, see `Setting`."""


@dataclass(frozen=True, slots=True)
class RunningSettings(Group):
    """Of `twin.explain.running`."""

    quiet_s: float = setting(
        8.0,
        "s",
        "in the air, from which noise and standing offset are learned at first",
        "physics: 16 frames tell a power of 6 degrees of freedom each (CELL of "
        "twin.explain.running.alarms) to 15 %",
    )
    settle_s: float = setting(1.5, "s", "after the lift-off that count for nothing", "made up")
    forget_s: float = setting(
        120.0, "s", "after which what was learned of the standing model counts a third", "made up"
    )
    standing: float = setting(
        0.5,
        "share",
        "of the prior deviation of a number, by which the standing model may be off",
        "made up: calibrated vehicles are known better than files",
    )
    noise_s: float = setting(20.0, "s", "over which noise levels follow the flight", "made up")
    burst: float = setting(
        4.0,
        "1",
        "power over the noise level that counts in full towards it",
        "physics: by chance a power exceeds it once in 22 with one degree of freedom, less often "
        "with more",
    )
    together: float = setting(
        2.0,
        "1",
        "power of means over two seconds over that of means over a frame, at least: turbulence "
        "lasts about a second, and a quiet start is too short to show it",
        _TUNED,
    )
    level: float = setting(
        4.0, "degrees of freedom", "with which the noise level of a frame is known", "made up"
    )
    tempered: float = setting(
        0.5, "share", "of its samples that a band above the mean counts as", _TUNED, 1.0
    )
    rough: float = setting(
        0.02,
        "share",
        "of the amplitude of a band that no law explains: see EvidenceSettings.rough",
        "as EvidenceSettings.rough",
        1.0,
    )
    floor: float = setting(
        0.5,
        "share",
        "of the constant that a day may bring (EvidenceSettings.trim_*): least deviation of the "
        "mean of a frame",
        _TUNED,
    )
    oldest_s: float = setting(60.0, "s", "ago that a change may have begun at most", "made up")
    every_s: float = setting(1800.0, "s", "between two changes, before anything is seen", "made up")
    bar: float = setting(
        15.0, "nats", "log odds of any change over none from which an alarm is raised", _TUNED
    )
    clear: float = setting(
        0.7, "probability", "of one effect among all from which on it is named at once", _TUNED, 1.0
    )
    patience_s: float = setting(
        3.0, "s", "after which an alarm names the likeliest, and those it may be as well", _TUNED
    )
    settled_s: float = setting(
        15.0,
        "s",
        "after its beginning from which a change belongs to the standing model",
        "made up",
    )
    repeats: int = setting(
        6, "samples", "all the same, from which on a reading does not enter the evidence", "made up"
    )
    repeat_nats: float = setting(
        0.3, "nats", "for a reading that stands still, of one more sample just as before", "made up"
    )
    least_frames: int = setting(
        2, "frames", "that a change has to last: a bump is over by then", "made up"
    )
    loudest: float = setting(
        30.0, "1", "power over that of the quiet start that counts in full", "made up"
    )
    level_nats: float = setting(
        3.0, "nats", "that a level costs which is estimated, per sub-band that is louder", "made up"
    )
    louder: float = setting(
        2.0, "1", "power over that of the quiet start from which on a shake is one", _TUNED
    )

    __repr__ = short_repr


RUNNING = RunningSettings()
"""As shipped."""


Array = NDArray[np.float64]
MONITORED_EFFECTS = tuple(BEGINNINGS)
"""Effects of which a pilot is warned in flight."""


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One thing that may begin.

    Attributes:
        effect: Identifier.
        part: Of which rotor, "1"; "" for a whole effect.
        columns: Positions of its numbers.
        mean: Expected change of each.
        sd: Standard deviation of that.
        odds: Log prior odds, up to a constant that all share.
        only_more: Whether it can but add.
    """

    effect: str
    part: str
    columns: tuple[int, ...]
    mean: Array
    sd: Array
    odds: float
    only_more: bool

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class Library:
    """Numbers of the standing model, and hypotheses of a change of some of them.

    Attributes:
        effects: All effects with numbers, those that act by equations.
        numbers: Every number of these, shapes among them.
        columns: Positions, among the numbers, of those that may be off.
        standing: Deviation by which the standing model may be off in each of the columns.
        hypotheses: What may begin; columns count within `columns`.
        silent: Effects that change no mean, which have rules of their own.
    """

    effects: tuple[str, ...]
    numbers: tuple[Number, ...]
    columns: tuple[int, ...]
    standing: Array
    hypotheses: tuple[Hypothesis, ...]
    silent: tuple[str, ...]

    __repr__ = short_repr

    def name(self, column: int) -> Number:
        """Number of a column."""
        return self.numbers[self.columns[column]]


def library_of(
    vehicle: Vehicle,
    effects: Sequence[str],
    standing_effects: Sequence[str],
    settings: RunningSettings,
) -> Library:
    """Numbers and hypotheses for a vehicle.

    Args:
        vehicle: The calibrated model.
        effects: What may begin.
        standing_effects: By which the standing model may be off as well.
        settings: How far it may be off.

    Raises:
        ModelError: There is no such effect, or none that begins so.
    """
    for name in (*effects, *standing_effects):
        if name not in EFFECTS:
            raise ModelError(f"there is no effect {name!r}; see docs/reference/effects.md.")
    unforeseen = [n for n in effects if n not in BEGINNINGS]
    if unforeseen:
        raise ModelError(
            f"{', '.join(unforeseen)}: nothing is known of how it begins in flight. Give some of "
            f"{', '.join(BEGINNINGS)}."
        )
    every = [*effects, *(b for b in standing_effects if b not in effects)]
    own = tuple(e for e in every if isinstance(EFFECTS[e].observable_as, Equation))
    numbers = tuple(numbers_of((EFFECTS[e] for e in own), vehicle))
    columns = tuple(i for i, n in enumerate(numbers) if not n.shape)
    standing = np.array([_standing(numbers[i], vehicle) for i in columns])
    found = []
    for effect in (e for e in effects if e in own):
        mine = [k for k, i in enumerate(columns) if numbers[i].effect == effect]
        parts = {numbers[columns[k]].name: [k] for k in mine}
        several = numbers[columns[mine[0]]].about.per_rotor
        for name, chosen in parts.items() if several else [("", mine)]:
            expected = [_expected(BEGINNINGS[effect], numbers[columns[k]], vehicle) for k in chosen]
            share = -np.log(len(mine)) if several else 0.0
            found.append(
                Hypothesis(
                    effect,
                    name.rpartition("_")[2] if several else "",
                    tuple(chosen),
                    np.array([m for m, _ in expected]),
                    np.array([s for _, s in expected]),
                    BEGINNINGS[effect].odds + float(share),
                    all(_only_adds(numbers[columns[k]]) for k in chosen),
                )
            )
    silent = tuple(e for e in effects if e not in own)
    return Library(own, numbers, columns, settings.standing * standing, tuple(found), silent)


def _standing(number: Number, vehicle: Vehicle) -> float:
    """Standard deviation by which the calibrated model may be off in a number."""
    effect = EFFECTS[number.effect]
    share = effect.alarm.quiet_share if isinstance(effect.alarm, Begins) else 1.0
    return share * _expected(prior_of(effect), number, vehicle)[1]


def _expected(prior: Prior, number: Number, vehicle: Vehicle) -> tuple[float, float]:
    """Expected value and deviation of a number, for a vehicle."""
    about, stem = parameter_of(number)
    expected = prior.of(stem, indoors=False).sized(about, vehicle)
    return expected.mean, expected.sd


def _only_adds(number: Number) -> bool:
    """Whether a number has nothing below its neutral value."""
    about, _ = parameter_of(number)
    return about.bounds[0] == about.neutral
