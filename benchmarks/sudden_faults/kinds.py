"""Kinds of sudden faults, three sizes each: what changes in a plant, and what `why` should say."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.hidden_effects.plants.own.parameters import GRAVITY_M_S2, Array, Parameters

GROWS_S = 2.0
"""In which a loss that grows reaches its size."""
GUST_S = 0.4
"""Standard deviation of the envelope of a gust."""
SECOND = 0.8
"""Loss of the second of two rotors over that of the first."""


def _nothing(p: Parameters, size: float, rotors: tuple[int, ...]) -> Parameters:
    return p


@dataclass(frozen=True)
class Kind:
    """One kind.

    Attributes:
        cause: What `why` should name; "": nothing.
        sizes: Small, medium, large.
        unit: Of the sizes.
        rotors: How many rotors fail.
        body: Parameters of the plant once it has failed, from those before, size and rotors.
        grows_s: In which it comes, s; 0: at once.
        quantity: Factor from a size to the number that is said; None: no number is scored.
        speed: What the speed of the failed rotor does, where it is logged.
    """

    cause: str
    sizes: tuple[float, float, float]
    unit: str = "1"
    rotors: int = 0
    body: Callable[[Parameters, float, tuple[int, ...]], Parameters] = field(default=_nothing)
    grows_s: float = 0.0
    quantity: float | None = None
    speed: str = ""


def _losing(p: Parameters, size: float, rotors: tuple[int, ...]) -> Parameters:
    """Rotors with less thrust and torque; the second of two loses `SECOND` of the first."""
    left = np.ones(len(p.hubs))
    for rotor, share in zip(rotors, (1.0, SECOND), strict=False):
        left[rotor] -= size * share
    return replace(p, thrust_k=p.thrust_k * left, torque_k=p.torque_k * left)


def _all_losing(p: Parameters, size: float, rotors: tuple[int, ...]) -> Parameters:
    return replace(p, thrust_k=p.thrust_k * (1 - size), torque_k=p.torque_k * (1 - size))


def _heavier(p: Parameters, size: float, rotors: tuple[int, ...]) -> Parameters:
    """What comes or goes sits at the centre of mass."""
    return replace(p, mass=p.mass * (1 + size))


def _shifted(p: Parameters, size: float, rotors: tuple[int, ...]) -> Parameters:
    """The centre of mass moves by a share of the arm, forward and to the right alike."""
    arm = float(np.linalg.norm(p.hubs[:, :2], axis=1).max())
    return replace(p, hubs=p.hubs - size * arm * np.array([0.8, 0.6, 0.0]))


KINDS: Mapping[str, Kind] = {
    "propeller": Kind("rotor_failure", (0.15, 0.3, 0.6), rotors=1, body=_losing, quantity=1.0),
    "motor": Kind("rotor_failure", (0.4, 0.7, 1.0), rotors=1, body=_losing, quantity=1.0),
    "fading rotor": Kind(
        "rotor_failure", (0.2, 0.4, 0.7), rotors=1, body=_losing, grows_s=GROWS_S, quantity=1.0
    ),
    "two rotors": Kind(
        "rotor_failure", (0.25, 0.4, 0.6), rotors=2, body=_losing, quantity=(1 + SECOND) / 2
    ),
    "battery": Kind("thrust_loss_all_rotors", (0.1, 0.2, 0.3), body=_all_losing, quantity=1.0),
    "load lost": Kind("mass_change", (-0.1, -0.2, -0.3), body=_heavier, quantity=1.0),
    "load gained": Kind("mass_change", (0.1, 0.2, 0.3), body=_heavier, quantity=1.0),
    "rope": Kind("force_or_moment", (0.1, 0.2, 0.3)),
    "load shifted": Kind("force_or_moment", (0.05, 0.1, 0.2), body=_shifted),
    "gust": Kind("gust", (4.0, 8.0, 12.0), "m/s"),
    "commands cut": Kind("command_cut", (0.25, 0.5, 0.8), "s", quantity=1.0),
    "gyroscope": Kind("gyro_bias", (0.03, 0.06, 0.12), "rad/s"),
    "accelerometer": Kind("accel_bias", (0.5, 1.0, 2.0), "m/s^2"),
    "compass": Kind("mag_hard_iron", (5e-6, 1e-5, 2e-5), "T"),
}
"""All of them. Sizes: shares of thrust of a rotor (of the first of two), of the mass, of the
weight, of the arm, and of units; made up, from what is hard to see to what is not to be missed."""
NOTHING = Kind("", (0.0, 0.0, 0.0))
"""A flight in which nothing fails."""


@dataclass(frozen=True)
class Fault:
    """A fault of one flight, with all that is drawn.

    Attributes:
        kind: What fails.
        size: How much.
        rotors: Which fail, from 0.
        begins_s: When; infinity: nothing does.
        toward: Unit vector of a force, a gust or a bias.
        before: Parameters of the plant.
    """

    kind: Kind
    size: float
    rotors: tuple[int, ...]
    begins_s: float
    toward: Array
    before: Parameters

    @property
    def after(self) -> Parameters:
        """Parameters once it has come."""
        return self.kind.body(self.before, self.size, self.rotors)

    @property
    def push(self) -> Array:
        """Force of a rope, NED, N."""
        rope = self.kind is KINDS["rope"]
        return self.size * rope * float(self.before.mass) * GRAVITY_M_S2 * self.toward

    def share(self, t: float) -> float:
        """Of it that has come."""
        if t < self.begins_s:
            return 0.0
        return min((t - self.begins_s) / self.kind.grows_s, 1.0) if self.kind.grows_s else 1.0

    def blow(self, t: float) -> Array:
        """Wind of a gust, NED, m/s."""
        if self.kind is not KINDS["gust"]:
            return np.zeros(3)
        return self.size * float(np.exp(-0.5 * ((t - self.begins_s) / GUST_S) ** 2)) * self.toward

    def bias(self, kind: str) -> Array:
        """Of an instrument from the onset on, body axes."""
        return self.size * self.toward * (self.kind is KINDS[kind])
