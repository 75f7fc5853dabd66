"""From flights to laws of what the equations leave of force and moment."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

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
from .candidates import Candidate, Design, candidates
from .instants import Instants, inputs_of, linear_features
from .regression import ORDER

Array = NDArray[np.float64]
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
    seen: tuple[Instants, ...]
    designs: tuple[Design, ...]
    size: Array
    own: Array

    __repr__ = short_repr

    def design(self, flight: Instants) -> Design:
        """The design of a flight, of these or another."""
        force, moment = flight.seen(linear_features())
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
        said = [np.abs(d.says(weights)).max(axis=0) for d in self.designs]
        return np.asarray(np.max(said, axis=0))

    def weights(self, law: ForceLaw) -> Array:
        """Of a law, per output and feature of the designs, shape (6, k)."""
        return np.asarray(law.linear * self.size)


def prepare(seen: Sequence[Instants], vehicle: Vehicle) -> Prepared:
    """What may explain what a vehicle's equations leave, as far as these flights say.

    Args:
        seen: One or more flights.
        vehicle: As of `instants`.

    Raises:
        LogError: A flight is too short.
    """
    per_push, per_motion = _slopes(vehicle)
    empty = _empty(seen, np.asarray(np.linalg.inv(per_push)))
    size = np.std(np.vstack([f.seen(linear_features())[1] for f in seen]), axis=0)
    sizes, own = np.where(size > TRIFLE, size, 1.0), _symmetric(empty.units @ per_motion)
    unsized = Prepared(vehicle, empty, tuple(seen), (), sizes, own)
    prepared = replace(unsized, designs=tuple(unsized.design(f) for f in seen))
    for design, flight in zip(prepared.designs, seen, strict=True):
        if not design.moments[0].rows:
            raise LogError(
                f"{flight.name}: no uninterrupted piece of more than {2 * ORDER / CHANNEL_HZ:g} s "
                f"in the air with both sensors of the IMU. Give a longer flight."
            )
    return prepared


def _empty(seen: Sequence[Instants], units: Array) -> ForceLaw:
    """A law that says nothing yet: where the flights have been."""
    places = [inputs_of(f) for f in seen]
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
    kept = np.diag(np.minimum(np.diag(of_motion), 0.0))
    linear[:, 1:7] = kept + share * (of_motion - kept)
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
    felt = ca.vertcat(*[y[body.output_names.index(f"{s}_{a}")] for s in stems for a in AXES])
    states = [s.name for s in body.states]
    pushes = [body.input_names.index(f"{kind}_{a}") for kind, a in OUTPUTS]
    motions = [states.index(f"{stem}_{a}") for stem in ("vel", "omega") for a in AXES]
    by = [ca.jacobian(felt, u)[:, pushes], ca.jacobian(felt, x)[:, motions]]
    per_push, per_motion = ca.Function("slopes", [x, u], by)(x0, u0)
    return np.asarray(per_push, dtype=np.float64), np.asarray(per_motion, dtype=np.float64)
