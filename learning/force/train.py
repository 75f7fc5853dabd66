"""From flights to laws of what the equations leave of force and moment."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from twin.logs import Flight
from twin.physics.airframe import AXES, airframe
from twin.physics.residual_force import FEATURES, INPUTS, OUTPUTS, ForceLaw, power
from twin.representation import short_repr
from twin.vehicle import Vehicle

from .candidates import Candidate, Design, candidates
from .instants import Instants, inputs_of, instants, linear_features, random_features

Array = NDArray[np.float64]
WAVES = 64
"""Random features."""
LENGTH = 4.0
"""Over which they change, in standard deviations of the inputs; two instants are 4.9 apart on
average. Neither number was chosen on flights."""
_RATES = tuple(i for i, (name, _) in enumerate(INPUTS) if name.startswith("omega_"))
"""Inputs that no wave depends on: what the controller does with the rates would pass for a law of
them, and a wave of a rate can feed energy in where a linear law is kept from it."""
RESERVE = (*(0.5,) * 3, *(0.5,) * 3, 0.1, *(0.05,) * 3, 0.05, 0.3)
"""By input, what is no other place, in its unit: a flight with the battery half full is as good as
one with the full one, where training had only full ones."""
INSIDE = 0.995
"""Share of the training that is inside the envelope."""
TRIFLE = 1e-6
"""An input that moves by less did not move."""


@dataclass(frozen=True, slots=True)
class Prepared:
    """Flights ready to be fitted.

    Attributes:
        vehicle: Whose equations leave something.
        empty: A law that says nothing: where the flights have been, and the random features.
        seen: By flight.
        designs: By flight.
        size: Of each feature, by which those of the designs are divided, shape (k,).
    """

    vehicle: Vehicle
    empty: ForceLaw
    seen: tuple[Instants, ...]
    designs: tuple[Design, ...]
    size: Array

    __repr__ = short_repr

    def candidates(self, flights: Sequence[int]) -> list[dict[str, Candidate]]:
        """Laws by name of each output, fitted to some of the flights."""
        chosen = [self.designs[i] for i in flights]
        return [candidates(chosen, output) for output in range(len(OUTPUTS))]

    def law(self, chosen: Sequence[Candidate]) -> tuple[ForceLaw, float]:
        """The law of six candidates, made passive; as `made_passive` returns it."""
        weights = np.stack([c.weights for c in chosen]) / self.size
        n = len(FEATURES)
        law = replace(self.empty, linear=weights[:, :n], waves=weights[:, n:])
        return made_passive(law, self.vehicle)


def prepare(
    flights: Sequence[Flight],
    vehicle: Vehicle,
    seed: int = 0,
    progress: Callable[[float], None] = lambda _: None,
) -> Prepared:
    """What a vehicle's equations leave of flights, and what may explain it.

    Args:
        flights: One or more.
        vehicle: Explained or calibrated, so that nothing is learned that has a name.
        seed: Of the random features.
        progress: Called with the share done.

    Raises:
        LogError: A flight lacks the IMU or the motion, or never flies.
    """
    seen: list[Instants] = []
    for flight in flights:
        seen.append(instants(flight, vehicle))
        progress(len(seen) / len(flights))
    empty = _empty(seen, vehicle, seed)
    plain, wavy = linear_features(), random_features(empty)
    raw = [np.hstack([f.seen(plain), f.seen(wavy)]) for f in seen]
    size = np.std(np.vstack(raw), axis=0)
    size = np.where(size > TRIFLE, size, 1.0)
    designs = (Design.of(x / size, f.left, f.piece) for x, f in zip(raw, seen, strict=True))
    return Prepared(vehicle, empty, tuple(seen), tuple(designs), size)


def without_waves(law: ForceLaw) -> ForceLaw:
    """The law without random features where none of them has a weight."""
    if law.waves.any():
        return law
    frequencies = np.zeros((0, len(INPUTS)))
    return replace(law, waves=np.zeros((6, 0)), frequencies=frequencies, phases=np.zeros(0))


def _empty(seen: Sequence[Instants], vehicle: Vehicle, seed: int) -> ForceLaw:
    """A law that says nothing yet: where the flights have been, and the random features."""
    rng = np.random.default_rng(seed)
    x = inputs_of(seen)
    centre, spread = x.mean(axis=0), x.std(axis=0)
    scale = np.where(spread > TRIFLE, spread, 1.0)
    z = (x - centre) / scale
    metric = np.cov(z.T) + np.diag((np.array(RESERVE) / scale) ** 2)
    whitening = np.linalg.inv(np.linalg.cholesky(metric))
    frequencies = rng.normal(size=(WAVES, len(INPUTS))) / LENGTH
    frequencies[:, list(_RATES)] = 0.0
    away = np.sqrt(np.mean((z @ whitening.T) ** 2, axis=1))
    return ForceLaw(
        linear=np.zeros((6, len(FEATURES))),
        waves=np.zeros((6, WAVES)),
        frequencies=frequencies,
        phases=rng.uniform(0, 2 * np.pi, WAVES),
        centre=centre,
        scale=scale,
        whitening=whitening,
        reach=float(np.quantile(away, INSIDE)),
        units=np.asarray(np.linalg.inv(_agility(vehicle))),
    )


def made_passive(law: ForceLaw, vehicle: Vehicle) -> tuple[ForceLaw, float]:
    """The law without what would feed energy in about hover, beyond what the airframe takes.

    Left out is the least of the linear part, in rates: velocities count by the root of the mass,
    body rates by that of the inertia.

    Returns:
        The law, and the largest rate that was left out, 1/s; 0: none was.
    """
    own = _own_power(vehicle)
    root = np.linalg.cholesky((law.units + law.units.T) / 2)
    back = np.linalg.inv(root)
    rates, ways = np.linalg.eigh(back @ (power(law) + own) @ back.T)
    allowed = max(float(np.linalg.eigvalsh(back @ own @ back.T)[-1]), 0.0)
    gained = np.maximum(rates - allowed - TRIFLE, 0.0)
    if not gained.any():
        return law, 0.0
    excess = root @ (ways * gained) @ ways.T @ root.T
    linear = law.linear.copy()
    linear[:, 1:7] -= np.linalg.solve(law.units, excess)
    return replace(law, linear=linear), float(gained.max())


def _agility(vehicle: Vehicle) -> Array:
    """Specific force and angular acceleration per force and moment from outside, (6, 6)."""
    return _slopes(vehicle, [f"{kind}_{a}" for kind, a in OUTPUTS], of_inputs=True)


def _own_power(vehicle: Vehicle) -> Array:
    """What the airframe itself takes of the energy of motion about hover, as `power`."""
    states = [f"vel_{a}" for a in AXES] + [f"omega_{a}" for a in AXES]
    per_motion = np.linalg.solve(_agility(vehicle), _slopes(vehicle, states, of_inputs=False))
    return np.asarray((per_motion + per_motion.T) / 2)


def _slopes(vehicle: Vehicle, names: Sequence[str], of_inputs: bool) -> Array:
    """Slopes of specific force and angular acceleration in hover, shape (6, len(names))."""
    body = airframe(vehicle)
    p, u0 = body.parameter_values({"ground.enabled": 0.0}), body.input_values()
    x0 = body.initial(u0, p)
    x, u = ca.SX.sym("x", len(body.states)), ca.SX.sym("u", len(u0))
    y = body.outputs(x, u, p)
    stems = ("specific_force", "angular_acceleration")
    felt = ca.vertcat(*[y[body.output_names.index(f"{s}_{a}")] for s in stems for a in AXES])
    known = list(body.input_names) if of_inputs else [s.name for s in body.states]
    columns = [known.index(n) for n in names]
    slopes = ca.Function("slopes", [x, u], [ca.jacobian(felt, u if of_inputs else x)[:, columns]])
    return np.asarray(slopes(x0, u0), dtype=np.float64)
