"""Laws that each of the six outputs may follow, fitted to flights.

| law | is |
|---|---|
| `none` | nothing: the equations are right, or no law was found that holds on another flight |
| `constant` | the mean |
| `linear` | a sum over `FEATURES` |
| `waves` | the same and random Fourier features of the motion: any smooth function |

How strongly weights are held at zero is decided by flights that take no part in the fit: each in
turn is left out, and its innovations, what is new from one sample to the next, are to be as
probable as can be. With a single flight its quarters take the place of flights. Which law is used
is decided by the twin that flies it (`uavtwin.force`).

No law may push along the velocity or turn along the rate that it depends on: such weights end at
zero.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from twin.physics.residual_force import FEATURES

from .forecast import Observer, observer_of
from .regression import noise_of, pieces_of, ridge

Array = NDArray[np.float64]
LAWS = ("none", "constant", "linear", "waves")
PENALTIES = (1.0, 10.0, 100.0, 1000.0)
"""Prior precisions tried, of a weight over a feature of size one, in units of innovations."""
QUARTERS = 4
_AGAINST = tuple(
    tuple(FEATURES.index(stem + a) for stem in stems)
    for stems in (("air_", "speed air_"), ("omega_",))
    for a in "xyz"
)
"""By output, the features that are motion along it."""


@dataclass(frozen=True, slots=True)
class Design:
    """What explains one flight, and its six outputs.

    Attributes:
        features: `FEATURES` and then random ones, constant first, shape (n, k), each of the order
            of one.
        left: Shape (n, 6).
        piece: Number of the uninterrupted piece of flight of each row, shape (n,).
    """

    features: Array
    left: Array
    piece: NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Candidate:
    """One law of one output.

    Attributes:
        law: Of `LAWS`.
        penalty: Of its weights; 0 of a law without.
        weights: Per feature, 0 where the law has none, shape (k,).
        gain: Log-likelihood of the flights left out over that of `none`, nats.
        observer: Of what the law leaves.
    """

    law: str
    penalty: float
    weights: Array
    gain: float
    observer: Observer


def candidates(flights: Sequence[Design], output: int) -> dict[str, Candidate]:
    """Every law of one output, by its name.

    Args:
        flights: One or more.
        output: 0 to 5.
    """
    folds = _folds(flights)
    nothing = sum(_likelihood(fold, output, "none", 0.0) for fold in folds)
    found = {}
    for law in LAWS:
        tried = PENALTIES if law in ("linear", "waves") else (0.0,)
        said = [sum(_likelihood(fold, output, law, p) for fold in folds) for p in tried]
        best = int(np.argmax(said))
        weights = np.zeros(flights[0].features.shape[1])
        fit = _fitted(flights, output, law, tried[best])
        weights[: len(fit)] = fit
        observer = observer_of(
            [(f.left[:, output] - f.features @ weights, pieces_of(f.piece)) for f in flights]
        )
        found[law] = Candidate(law, tried[best], weights, said[best] - nothing, observer)
    return found


def _folds(flights: Sequence[Design]) -> list[tuple[list[Design], Design]]:
    """All but one, and that one; of a single flight its quarters."""
    if len(flights) == 1:
        flights = _quarters(flights[0])
    return [([f for f in flights if f is not one], one) for one in flights]


def _quarters(flight: Design) -> list[Design]:
    bounds = np.linspace(0, len(flight.left), QUARTERS + 1).astype(int).tolist()
    return [
        Design(flight.features[a:b], flight.left[a:b], flight.piece[a:b])
        for a, b in pairwise(bounds)
    ]


def _likelihood(
    fold: tuple[Sequence[Design], Design], output: int, law: str, penalty: float
) -> float:
    """Log-likelihood of the flight that was left out, its noise of any size, nats."""
    train, test = fold
    y, pieces = _stacked(train, output)
    noise = noise_of(y - y.mean(), pieces)
    weights = _fitted(train, output, law, penalty)
    left = test.left[:, output] - test.features[:, : len(weights)] @ weights
    new = noise.whitened(left, pieces_of(test.piece))
    return float(-len(new) / 2 * np.log(np.mean(new**2)))


def _fitted(flights: Sequence[Design], output: int, law: str, penalty: float) -> Array:
    """Weights of a law, as many as it has."""
    n = {
        "none": 0,
        "constant": 1,
        "linear": len(FEATURES),
        "waves": flights[0].features.shape[1],
    }[law]
    if n == 0:
        return np.zeros(0)
    y, pieces = _stacked(flights, output)
    features = np.vstack([f.features[:, :n] for f in flights])
    strength, most = np.full(n, penalty), np.full(n, np.inf)
    strength[0] = 0.0
    if n > 1:
        most[list(_AGAINST[output])] = 0.0
    return ridge(features, y, pieces, strength, most).weights


def _stacked(flights: Sequence[Design], output: int) -> tuple[Array, list[slice]]:
    """An output of all flights, and their pieces."""
    numbers: list[NDArray[np.intp]] = []
    first = 0
    for flight in flights:
        numbers.append(flight.piece - flight.piece[0] + first)
        first = int(numbers[-1][-1]) + 1
    y = np.concatenate([f.left[:, output] for f in flights])
    return y, pieces_of(np.concatenate(numbers))
