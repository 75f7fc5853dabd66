"""Laws that each of the six outputs may follow, fitted to flights.

| law | is |
|---|---|
| `none` | nothing: the equations are right, or no law was found that holds on another flight |
| `constant` | the mean over flights of what each has on average |
| `linear` | a sum over few of `FEATURES` |

How much flights that take no part in the fit speak for a law: each in turn is left out, and the
likelihood of its innovations, what is new from one sample to the next, is taken. With a single
flight its quarters take the place of flights. Which law is used is decided by the twin that flies
it (`uavtwin.force`).

No law may push along the velocity or turn along the rate that it depends on: such weights end at
zero.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from twin.errors import LogError
from twin.frames import AXES
from twin.physics.airframe import airframe
from twin.physics.residual_force import FEATURES, OUTPUTS, ForceLaw, power
from twin.representation import short_repr
from twin.residuals.channels import CHANNEL_HZ
from twin.vehicle import Vehicle

from ..data.envelope import BEYOND, TRIFLE, Envelope
from .forecast import Observer, observer_of
from .instants import Instants, inputs_of, linear_features
from .regression import (
    ORDER,
    Fit,
    Moments,
    least_squares,
    missed,
    moments_of,
    pieces_of,
    sparse,
    summed,
)

Array = NDArray[np.float64]
LAWS = ("none", "constant", "linear")
"""Names, the simplest first."""
QUARTERS = 4
"""Parts of a single flight that take the place of flights."""
LEAST_GAIN = 3.0
"""Nats that flights left out must speak for something before it is believed: odds of twenty."""
_TINY = 1e-30
"""Added to squares of offsets, so that a logarithm of none is finite."""
HALVES = (slice(0, 3), slice(3, 6))
"""Outputs that are force, and those that are moment."""
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
        features: `FEATURES`, constant first, each of the order of one: as force and as moment show
            them, shape (n, k) each.
        left: Shape (n, 6).
        piece: Number of the uninterrupted piece of flight of each row, shape (n,).
        moments: Of the features and three outputs, of force and of moment, each about its mean in
            this flight: an offset that is there today says nothing of a law.
    """

    features: tuple[Array, Array]
    left: Array
    piece: NDArray[np.intp]
    moments: tuple[Moments, Moments]

    __repr__ = short_repr

    @classmethod
    def of(cls, features: tuple[Array, Array], left: Array, piece: NDArray[np.intp]) -> "Design":
        """The design of these rows."""
        pieces = pieces_of(piece)
        both = (np.hstack([x, left[:, three]]) for x, three in zip(features, HALVES, strict=True))
        force, moment = (moments_of(columns - columns.mean(axis=0), pieces) for columns in both)
        return cls(features, left, piece, (force, moment))

    def prediction(self, weights: Array) -> Array:
        """What weights make of the features, shape (n, 6).

        Args:
            weights: Per output and feature, shape (6, k).
        """
        said = [x @ weights[three].T for x, three in zip(self.features, HALVES, strict=True)]
        return np.hstack(said)


@dataclass(frozen=True, slots=True)
class Candidate:
    """One law of one output.

    Attributes:
        law: Of `LAWS`.
        weights: Per feature, 0 where the law has none, shape (k,).
        gain: Log-likelihood of the flights left out over that of `none`, nats.
        observer: Of what the law leaves.
    """

    law: str
    weights: Array
    gain: float
    observer: Observer


def candidates(flights: Sequence[Design], output: int) -> dict[str, Candidate]:
    """Every law of one output, by its name.

    Args:
        flights: One or more.
        output: 0 to 5.
    """
    several = flights if len(flights) > 1 else quarters(flights[0])
    half, every = output // 3, flights[0].features[0].shape[1]
    columns = [*range(every), every + output % 3]
    parts = [f.moments[half].of(columns) for f in several if f.moments[half].rows]
    whole = summed([f.moments[half].of(columns) for f in flights])
    folds = [(whole, whole)]  # where it is too short to leave any of it out
    if len(parts) > 1:
        folds = [(summed([m for m in parts if m is not one]), one) for one in parts]
    linear, limits = [_linear(train, output) for train, _ in folds], _limits(every, output)
    found = {}
    for law in LAWS:
        gain = sum(
            _likelihood(_fitted(law, train, own, limits), test)
            for (train, test), own in zip(folds, linear, strict=True)
        )
        weights = _fitted(law, whole, _linear(whole, output), limits).weights
        offsets = np.array(
            [np.mean(f.left[:, output] - f.features[half] @ weights) for f in flights]
        )
        offset_gain = _offset_gain(offsets)
        if law == "constant" or (law != "none" and offset_gain > LEAST_GAIN):
            weights[0] = offsets.mean() / flights[0].features[half][0, 0]
            gain += offset_gain
        observer = observer_of(
            [(f.left[:, output] - f.features[half] @ weights, pieces_of(f.piece)) for f in flights]
        )
        found[law] = Candidate(law, weights, gain, observer)
    nothing = found[LAWS[0]].gain
    return {law: replace(c, gain=c.gain - nothing) for law, c in found.items()}


def _offset_gain(offsets: Array) -> float:
    """Nats by which the mean of the other flights foretells a flight's offset better than zero.

    Args:
        offsets: By flight, shape (f,); nothing speaks for that of a single one.
    """
    n = len(offsets)
    if n < 2:
        return 0.0
    others = (offsets.sum() - offsets) / (n - 1)
    apart, whole = np.sum((offsets - others) ** 2), np.sum(offsets**2)
    return float(n / 2 * np.log((whole + _TINY) / (apart + _TINY)))


def _linear(moments: Moments, output: int) -> list[int]:
    """Features of a linear law."""
    n = len(FEATURES)
    last = moments.products.shape[-1] - 1
    chosen, _ = sparse(moments.of([*range(1, n), last]), _limits(n, output)[1:])
    return sorted(c + 1 for c in chosen)


def _fitted(law: str, moments: Moments, linear: Sequence[int], most: Array) -> Fit:
    """A law, with a weight for every feature."""
    n, own = len(most), list(linear) if law == "linear" else []
    fit = least_squares(moments.of([*own, n]), most[own])
    weights = np.zeros(n)
    weights[own] = fit.weights
    return replace(fit, weights=weights)


def quarters(flight: Design) -> list[Design]:
    """A flight as several."""
    bounds = np.linspace(0, len(flight.left), QUARTERS + 1).astype(int).tolist()
    force, moment = flight.features
    return [
        Design.of((force[a:b], moment[a:b]), flight.left[a:b], flight.piece[a:b])
        for a, b in pairwise(bounds)
    ]


def _likelihood(fit: Fit, test: Moments) -> float:
    """Log-likelihood of what was left out, its noise of any size, nats."""
    return -test.rows / 2 * float(np.log(missed(test, fit.weights, fit.noise)))


def _limits(n: int, output: int) -> Array:
    """Largest weight of each feature."""
    most = np.full(n, np.inf)
    if n > 1:
        most[list(_AGAINST[output])] = 0.0
    return most


RESERVE = (*(0.5,) * 3, *(0.5,) * 3, 0.1, *(0.05,) * 3, 0.05, 0.3)
"""By input, what is no other place, in its unit: a flight with the battery half full is as good as
one with the full one, where training had only full ones."""
PASSIVE = 1e-6
"""Rate of energy fed in, 1/s, below which nothing is."""
HALVINGS = 30
"""In the search for what may stay of a law that feeds energy in."""


@dataclass(frozen=True, slots=True)
class Prepared:
    """Flights ready to be fitted.

    Attributes:
        vehicle: Whose equations leave something.
        empty: A law that says nothing: where the flights have been.
        seen: By flight.
        designs: By flight.
        size: Of each feature, by which those of the designs are divided, shape (k,).
        own: What the airframe itself takes of the energy of motion about hover, as `power`.
    """

    vehicle: Vehicle
    empty: ForceLaw
    flights: tuple[Instants, ...]
    designs: tuple[Design, ...]
    size: Array
    own: Array

    __repr__ = short_repr

    def design(self, flight: Instants) -> Design:
        """The design of a flight, of these or another."""
        force, moment = flight.filtered_features(linear_features())
        return Design.of((force / self.size, moment / self.size), flight.left, flight.piece)

    def candidates(self) -> list[dict[str, Candidate]]:
        """Laws by name of each output."""
        return [candidates(self.designs, output) for output in range(len(OUTPUTS))]

    def law(self, chosen: Sequence[Candidate]) -> tuple[ForceLaw, float]:
        """The law of six candidates, made passive; as `made_passive` returns it."""
        weights = np.stack([c.weights for c in chosen]) / self.size
        law, taken = made_passive(replace(self.empty, linear=weights), self.own)
        return replace(law, most=BEYOND * self.largest(law)), taken

    def largest(self, law: ForceLaw) -> Array:
        """What a law says at most in its flights, bounds aside, as sensors show it, shape (6,)."""
        weights = self.weights(law)
        said = [np.abs(d.prediction(weights)).max(axis=0) for d in self.designs]
        return np.asarray(np.max(said, axis=0))

    def weights(self, law: ForceLaw) -> Array:
        """Of a law, per output and feature of the designs, shape (6, k)."""
        return np.asarray(law.linear * self.size)


def prepare(flights: Sequence[Instants], vehicle: Vehicle) -> Prepared:
    """What may explain what a vehicle's equations leave, as far as these flights say.

    Args:
        seen: One or more flights.
        vehicle: As of `instants`.

    Raises:
        LogError: A flight is too short.
    """
    per_push, per_motion = _slopes(vehicle)
    empty = _empty(flights, np.asarray(np.linalg.inv(per_push)))
    size = np.std(np.vstack([f.filtered_features(linear_features())[1] for f in flights]), axis=0)
    sizes, own = np.where(size > TRIFLE, size, 1.0), _symmetric(empty.units @ per_motion)
    unsized = Prepared(vehicle, empty, tuple(flights), (), sizes, own)
    prepared = replace(unsized, designs=tuple(unsized.design(f) for f in flights))
    for design, flight in zip(prepared.designs, flights, strict=True):
        if not design.moments[0].rows:
            raise LogError(
                f"{flight.name}: no uninterrupted piece of more than {2 * ORDER / CHANNEL_HZ:g} s "
                f"in the air with both sensors of the IMU. Give a longer flight."
            )
    return prepared


def _empty(flights: Sequence[Instants], units: Array) -> ForceLaw:
    """A law that says nothing yet: where the flights have been."""
    places = [inputs_of(f) for f in flights]
    envelope = Envelope.of(places, np.array(RESERVE))
    return ForceLaw(
        linear=np.zeros((6, len(FEATURES))),
        centre=envelope.centre,
        scale=envelope.scale,
        whitening=envelope.whitening,
        reach=envelope.reach,
        most=np.zeros(len(OUTPUTS)),
        units=units,
    )


def made_passive(law: ForceLaw, own: Array) -> tuple[ForceLaw, float]:
    """The law without what would feed energy in about hover, beyond what the airframe takes.

    What couples one motion with a force along another is lessened until nothing is fed in; a push
    against its own motion, which feeds nothing in, stays. Velocities count by the root of the mass,
    body rates by that of the inertia.

    Args:
        law: As it was fitted.
        own: What the airframe itself takes, as `power`.

    Returns:
        The law, and the largest rate at which it would have fed energy in, 1/s; 0: it did not.
    """
    back = np.linalg.inv(np.linalg.cholesky(_symmetric(law.units)))

    def fed(lessened: ForceLaw) -> float:
        """Largest rate at which energy is fed in, 1/s."""
        both = back @ (power(lessened) + own) @ back.T
        return float(np.linalg.eigvalsh(both)[-1])

    allowed = max(float(np.linalg.eigvalsh(back @ own @ back.T)[-1]), 0.0) + PASSIVE
    gained = fed(law) - allowed
    if gained <= 0:
        return law, 0.0
    least, most = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = (least + most) / 2
        least, most = (middle, most) if fed(_lessened(law, middle)) <= allowed else (least, middle)
    return _lessened(law, least), gained


def _lessened(law: ForceLaw, share: float) -> ForceLaw:
    """The law with a share of what couples motions."""
    linear = law.linear.copy()
    of_motion = linear[:, 1:7]
    damping = np.diag(np.minimum(np.diag(of_motion), 0.0))
    linear[:, 1:7] = damping + share * (of_motion - damping)
    return replace(law, linear=linear)


def _symmetric(form: Array) -> Array:
    """The symmetric part."""
    return np.asarray((form + form.T) / 2)


def _slopes(vehicle: Vehicle) -> tuple[Array, Array]:
    """Slopes of specific force and angular acceleration in hover: by force and moment from outside,
    and by velocity and body rates, shape (6, 6) each."""
    body = airframe(vehicle)
    p, u0 = body.parameter_values({"ground.enabled": 0.0}), body.input_values()
    x0 = body.initial(u0, p)
    x, u = ca.SX.sym("x", len(body.states)), ca.SX.sym("u", len(u0))
    y = body.outputs(x, u, p)
    stems = ("specific_force", "angular_acceleration")
    acceleration = ca.vertcat(
        *[y[body.output_names.index(f"{s}_{a}")] for s in stems for a in AXES]
    )
    states = [s.name for s in body.states]
    pushes = [body.input_names.index(f"{kind}_{a}") for kind, a in OUTPUTS]
    motions = [states.index(f"{stem}_{a}") for stem in ("vel", "omega") for a in AXES]
    by = [ca.jacobian(acceleration, u)[:, pushes], ca.jacobian(acceleration, x)[:, motions]]
    per_push, per_motion = ca.Function("slopes", [x, u], by)(x0, u0)
    return np.asarray(per_push, dtype=np.float64), np.asarray(per_motion, dtype=np.float64)
