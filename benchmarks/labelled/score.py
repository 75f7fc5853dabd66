"""Figures of a method on flights with a label."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .flights import NORMAL, Labelled
from .methods import Answer

BINS = 5
"""Of probabilities, for their reliability."""
SURE = 0.9
"""Probability from which on a wrong answer does harm."""


@dataclass(frozen=True, slots=True)
class Said:
    """A flight with the answer of a method, None where it could not be asked, and hours in the
    air."""

    flight: Labelled
    answer: Answer | None
    hours: float


@dataclass(frozen=True, slots=True)
class Score:
    """Figures of one method on one set.

    Attributes:
        asked: Flights on which it could be asked.
        answered: Those of them on which it says something.
        flights: All of them.
        right: Label right, "this or that" included.
        rotors: Rotors exact, and of how many answers to flights that have some in the label.
        onset_s: Median error of the onset; None: none is said.
        false: Classes named in normal flights.
        others: Events of no class in normal flights: of instruments, of the estimate, a force.
        hours: Of normal flight.
        wrong_and_sure: Said with `SURE` or more, and wrong.
        brier: Mean square of probability less truth; None: no probabilities.
        calibration: Expected calibration error; None: no probabilities.
    """

    asked: int
    answered: int
    flights: int
    right: int
    rotors: tuple[int, int]
    onset_s: float | None
    false: int
    others: int
    hours: float
    wrong_and_sure: int
    brier: float | None
    calibration: float | None


def is_right(said: Said) -> bool:
    """Whether the answer holds the truth."""
    return said.answer is not None and said.flight.label in (
        said.answer.label,
        said.answer.or_else,
    )


def score(rows: Sequence[Said]) -> Score:
    """All figures."""
    asked = [(r, r.answer) for r in rows if r.answer is not None]
    with_rotors = [(r, a) for r, a in asked if r.flight.rotors and a.label]
    late = [
        abs(a.onset_s - r.flight.onset_s)
        for r, a in asked
        if a.onset_s is not None and r.flight.onset_s is not None and is_right(r)
    ]
    normal = [(r, a) for r, a in asked if r.flight.label == NORMAL]
    stated = [(a.probability, is_right(r)) for r, a in asked if a.probability is not None]
    p, hit = (
        (np.array(x, dtype=np.float64) for x in zip(*stated, strict=True)) if stated else _none()
    )
    return Score(
        asked=len(asked),
        answered=sum(bool(a.label) for _, a in asked),
        flights=len(rows),
        right=sum(is_right(r) for r, _ in asked),
        rotors=(sum(a.rotors == r.flight.rotors for r, a in with_rotors), len(with_rotors)),
        onset_s=float(np.median(late)) if late else None,
        false=sum(a.label not in ("", NORMAL) for _, a in normal),
        others=sum(a.others for _, a in normal),
        hours=sum(r.hours for r, _ in normal),
        wrong_and_sure=int(((p >= SURE) & (hit == 0)).sum()),
        brier=float(np.mean((p - hit) ** 2)) if len(p) else None,
        calibration=calibration_error(p, hit) if len(p) else None,
    )


def _none() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return np.zeros(0), np.zeros(0)


def calibration_error(p: NDArray[np.float64], hit: NDArray[np.float64]) -> float:
    """Expected calibration error: mean distance of probability and share of hits, over bins."""
    place = np.minimum((p * BINS).astype(int), BINS - 1)
    return float(
        sum(
            (place == k).mean() * abs(p[place == k].mean() - hit[place == k].mean())
            for k in np.unique(place)
        )
    )
