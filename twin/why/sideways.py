"""Specific force across the thrust: it shows air and ropes, not rotors.

    y_a = -k v_a + R_a^T w + b + e_a,    a = x, y of the body

k: drag per mass; v: velocity; w: wind times drag, constant in NED; e: `noise`. Where velocity or
attitude is not logged, only offset and noise. A force or a gust that begins at an onset adds a
constant; a failed rotor does not.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import logsumexp

from ..vehicle import GRAVITY_M_S2
from .body import Body
from .causes import BLOW, CAUSES, PUSH
from .flight import Array, rotations
from .noise import PHI, TEMPER, Places, Whitened

FLOOR_M_S2 = 0.005
"""Least standard deviation of an innovation."""
SLOW_PHI = (*PHI, 0.998)
"""Candidate values of phi: wind changes over tens of seconds."""
MOVING_SD = (1.0, 3.0, 3.0)
"""Standard deviations of drag per mass, 1/s, and of the wind terms north and east, m/s^2."""
OFFSET_SD_M_S2, TRIM_SD_M_S2 = 1.0, 0.007 * GRAVITY_M_S2
"""Standard deviations of the offset, and of its change at any onset, as along z."""
STEP_SD_M_S2 = 0.15 * GRAVITY_M_S2
"""Standard deviation of a sudden force per mass, as along z."""
WITH_ROTOR = np.log((0.8, 0.1, 0.1))
"""Log prior that a rotor fails alone, with a force or with a gust across the thrust: its cause may
push as well, and a tumbling body has another drag."""
COINCIDENT = np.array([0.0, CAUSES[PUSH].log_odds, CAUSES[BLOW].log_odds])
COINCIDENT -= logsumexp(COINCIDENT)
"""Log prior that a change of mass, or of all rotors, is alone or with a second cause at the same
instant."""


@dataclass(frozen=True)
class Sideways:
    """The two axes across the thrust of one part of a flight."""

    body: Body

    @cached_property
    def _axes(self) -> tuple[Whitened, Whitened]:
        frame, part = self.body.frame, slice(self.body.start, self.body.end)
        ones, force = np.ones(len(self.body)), frame.grid["acc"][part]
        x, y = (self._whitened(self._moving(a), ones, force[:, a]) for a in range(2))
        return x, y

    def _moving(self, axis: int) -> Array:
        """Velocity, north and east along an axis of the body, shape (n, 3 or 0)."""
        grid, part = self.body.frame.grid, slice(self.body.start, self.body.end)
        if "vel" not in grid or "q" not in grid:
            return np.empty((len(self.body), 0))
        world = rotations(grid["q"][part])[:, :, axis]
        along = np.einsum("ti,ti->t", world, grid["vel"][part])
        return np.column_stack([along, world[:, :2]])

    def _whitened(self, moving: Array, ones: Array, force: Array) -> Whitened:
        columns = np.column_stack([moving, ones, force])
        share = (~self.body.low).astype(float)
        law, _, weight = self.body.noise_of(
            columns[:, :-1], force, FLOOR_M_S2, share, SLOW_PHI, swings=False
        )
        return Whitened.each(law, weight, columns[:, None])[0]

    def evidence(
        self, start: Places, onset: Places, end: Places, gusts_s: Sequence[float]
    ) -> tuple[Array, Array, Array]:
        """Log evidence of no event, of a permanent force, and of 1-cosine gusts with the impulse of
        constant ones of given lengths, shape (onsets,), (onsets,), (onsets, gusts)."""
        still, lasting = np.zeros(len(onset)), np.zeros(len(onset))
        passing = np.zeros((len(onset), len(gusts_s)))
        shapes = [one_cosine(max(self.body.places(s), 1)) for s in gusts_s]
        for axis in self._axes:
            joined, one = axis.joined(start, onset, end), axis.rows.shape[1] - 2
            still += _marginal(joined, one, [TRIM_SD_M_S2])
            lasting += _marginal(joined, one, [STEP_SD_M_S2])
            for i, shape in enumerate(shapes):
                blown = axis.pulsed(joined, shape, onset, end)
                passing[:, i] += _marginal(blown, one, [TRIM_SD_M_S2, STEP_SD_M_S2])
        return still, lasting, passing

    def least_gust(
        self, start: Places, onset: Places, end: Places, over_s: float, nats: float
    ) -> Array:
        """Specific force of the 1-cosine gust, with the impulse of a constant one of a length, that
        would have a number of nats over no event, along the least sensitive axis, m/s^2, shape
        (onsets,)."""
        shape, prior, known = one_cosine(max(self.body.places(over_s), 1)), STEP_SD_M_S2**-2, []
        for axis in self._axes:
            joined, one = axis.joined(start, onset, end), axis.rows.shape[1] - 2
            blown = axis.pulsed(joined, shape, onset, end)
            inside, cross = _changed(blown, one, [TRIM_SD_M_S2], 2 * (one + 2))
            own = TEMPER * blown[:, -1, -1]
            known.append(own - np.sum(cross * np.linalg.solve(inside, cross), axis=(1, 2)))
        each = np.array(known)
        asked = nats + 0.5 * np.log1p(each / prior).sum(axis=0)
        return np.asarray((np.sqrt(2 * asked * (each + prior)) / each).max(axis=0))

    def unchanged(self, start: Places, end: Places) -> Array:
        """Log evidence of no change, not even of the offset, shape (onsets,)."""
        return np.asarray(
            sum(
                _marginal(axis.gram[end] - axis.gram[start], axis.rows.shape[1] - 2, [])
                for axis in self._axes
            )
        )


def one_cosine(places: int) -> Array:
    """The 1-cosine gust: it rises and falls within twice the number of intervals, so that it has
    the impulse of a constant one of that length, shape (steps,). Source: MIL-F-8785C, 3.7.3."""
    phase = np.pi * (np.arange(2 * places) + 0.5) / places
    return np.asarray(0.5 * (1 - np.cos(phase)))


def alongside(each: tuple[Array, Array, Array], log_odds: Array) -> Array:
    """Log evidence of the axes over no event, where another cause acts on the body, shape
    (onsets,): from that of no event, of a force and of gusts, and their log odds."""
    still, lasting, passing = each
    blown = logsumexp(passing, axis=1) - np.log(passing.shape[1])
    either = np.stack([still, lasting, blown]) + log_odds[:, None]
    return np.asarray(logsumexp(either, axis=0) - still)


def _changed(gram: Array, one: int, changes: Sequence[float], last: int) -> tuple[Array, Array]:
    """Gram matrices of drag, wind, offset and its changes with their priors, and their products
    with a column, shapes (onsets, n, n) and (onsets, n, 1).

    Args:
        gram: Gram matrices of the columns as in `Whitened.joined` or `passing`, shape (onsets, m,
            m).
        one: Index of the constant.
        changes: Standard deviation of a step at the onset, and of a blow.
        last: Index of the column.
    """
    k = one + 2
    sd = _deviations(one, changes)
    picked = [*range(one + 1), *(k + one, 2 * k)[: len(changes)]]
    inside = TEMPER * gram[:, np.array(picked)[:, None], picked] + np.diag(1 / sd**2)
    return inside, TEMPER * gram[:, picked, last, None]


def _deviations(one: int, changes: Sequence[float]) -> Array:
    return np.array([*MOVING_SD[:one], OFFSET_SD_M_S2, *changes])


def _marginal(gram: Array, one: int, changes: Sequence[float]) -> Array:
    """Log evidence with drag, wind, offset and its changes marginalised, see `_changed`."""
    inside, cross = _changed(gram, one, changes, one + 1)
    left = TEMPER * gram[:, one + 1, one + 1]
    left = left - np.sum(cross * np.linalg.solve(inside, cross), axis=(1, 2))
    cost = np.log(_deviations(one, changes)).sum()
    return np.asarray(-0.5 * left - 0.5 * np.linalg.slogdet(inside)[1] - cost)
