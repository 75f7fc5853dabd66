"""Sparse regression of one channel, whitened, scored on blocks of time that had no say in it.

The terms are picked by forward regression with orthogonal least squares, the number of terms by
what they gain out of sample. Picking is part of the fit: terms are picked anew
for every part of the time that is left out.

Source: Billings et al., Int. J. Control 49 (1989); Brunton, Proctor & Kutz, PNAS 113 (2016).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..inference.whitening import Block, Key
from ..settings import DEFAULT, UnnamedSettings

Array = NDArray[np.float64]
IntArray = NDArray[np.intp]
RIDGE = 1e-6
"""Share of the power of a column that is added, so that no combination of columns vanishes."""


@dataclass(frozen=True, slots=True)
class Sparse:
    """An equation of one channel.

    Attributes:
        picked: Columns, in the order of what they explain.
        coefficients: Of these, shape (k,).
        by_fold: The same fitted without each part of the time, shape (folds, p).
        gains: Log likelihood per block of time, out of sample.
    """

    picked: tuple[int, ...]
    coefficients: Array
    by_fold: Array
    gains: Mapping[Key, float]

    @property
    def gain(self) -> float:
        """Over all blocks."""
        return sum(self.gains.values())


def fold_of(
    keys: Sequence[Key], seed: int, settings: UnnamedSettings = DEFAULT.unnamed
) -> dict[Key, int]:
    """Which part of the time each block belongs to."""
    order = np.random.default_rng(seed).permutation(len(keys))
    return {keys[i]: int(n) % settings.folds for n, i in enumerate(order)}


def sparse(
    blocks: Mapping[Key, Block],
    folds: Mapping[Key, int],
    settings: UnnamedSettings = DEFAULT.unnamed,
) -> Sparse | None:
    """The best equation of up to `most_terms` terms; None where none gains anything.

    Args:
        blocks: Whitened sums of a channel over its candidate columns.
        folds: Part of the time of each block.
        settings: How many terms, and their price.
    """
    whole, most = _whole(blocks), settings.most_terms
    size = _size(whole)
    parts = [
        _sum([b for k, b in blocks.items() if folds[k] == f], len(size))
        for f in range(settings.folds)
    ]
    paths = []
    for part in parts:
        rest = Block(whole.gram - part.gram, whole.pull - part.pull, whole.power - part.power)
        paths.append(_path(rest, size, most))
    totals = []
    for n in range(most + 1):
        gains = [_gain(part, path[n]) for part, path in zip(parts, paths, strict=True)]
        totals.append(sum(gains) - settings.per_term * n)
    best = max(totals)
    if best <= 0:
        return None
    n = next(i for i, total in enumerate(totals) if total >= settings.most_of_it * best)
    by_fold = np.stack([path[n] for path in paths])
    final = _path(whole, size, most)[n]
    picked = np.flatnonzero(final)
    order = picked[np.argsort(-np.abs(final[picked] * size[picked]))]
    return Sparse(
        tuple(int(i) for i in order),
        final[order],
        by_fold,
        {k: _gain(b, by_fold[folds[k]]) for k, b in blocks.items()},
    )


def longest(blocks: Mapping[Key, Block], settings: UnnamedSettings = DEFAULT.unnamed) -> Array:
    """Coefficients of the equation with `most_terms` terms, fitted to everything, shape (p,)."""
    whole, most = _whole(blocks), settings.most_terms
    return _path(whole, _size(whole), most)[most]


def _size(block: Block) -> Array:
    """Root of the power of each column."""
    return np.sqrt(np.maximum(np.diag(block.gram), 1e-300))


def _whole(blocks: Mapping[Key, Block]) -> Block:
    """Sums over all time."""
    every = list(blocks.values())
    return _sum(every, len(every[0].pull))


def _sum(blocks: Sequence[Block], p: int) -> Block:
    """Sums over some blocks of `p` columns."""
    gram, pull = np.zeros((p, p)), np.zeros(p)
    for b in blocks:
        gram, pull = gram + b.gram, pull + b.pull
    return Block(gram, pull, sum(b.power for b in blocks))


def _gain(block: Block, coefficients: Array) -> float:
    return float(block.pull @ coefficients - 0.5 * coefficients @ block.gram @ coefficients)


def forward(gram: Array, pull: Array, most: int) -> IntArray:
    """Columns by what each explains beside those before it, the most first, shape (most,) or (p,).

    What the columns picked so far leave of the power and of the pull of each is told by the sums
    alone: picking is a Cholesky factorisation with pivots.

    Args:
        gram: Sums of products of the columns, shape (p, p).
        pull: Sums of their products with what is to be explained, shape (p,).
        most: How many are picked.
    """
    p = len(pull)
    power, left = np.diag(gram).copy(), pull.copy()
    factors, order = np.zeros((0, p)), np.zeros(0, dtype=np.intp)
    for _ in range(min(most, p)):
        explained = np.divide(left**2, power, out=np.zeros(p), where=power > 0)
        explained[order] = -1.0
        best = int(np.argmax(explained))
        factor = (gram[best] - factors.T @ factors[:, best]) / np.sqrt(power[best])
        left = left - factor * left[best] / np.sqrt(power[best])
        power = power - factor**2
        factors, order = np.vstack([factors, factor]), np.append(order, best)
    return order


def _path(block: Block, size: Array, most: int) -> list[Array]:
    """Coefficients with 0, 1, ... `most` terms, each of shape (p,)."""
    p = len(size)
    gram = block.gram / np.outer(size, size) + RIDGE * np.eye(p)
    pull = block.pull / size
    order = forward(gram, pull, most)
    path = []
    for n in range(most + 1):
        picked = np.sort(order[:n])
        coefficients = np.zeros(p)
        chosen = np.ix_(picked, picked)
        coefficients[picked] = np.linalg.solve(gram[chosen], pull[picked]) / size[picked]
        path.append(coefficients)
    return path
