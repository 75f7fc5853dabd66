"""What may have happened to a calibrated aircraft before its last flight."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..hiding.effect import Number, Truth, direction, vector
from ..plants.aircraft import Aircraft
from ..plants.kinds import EFFECTS
from ..plants.own.parameters import Parameters

Happened = tuple[Parameters, dict[str, Truth]]
Defect = Callable[[Parameters, Aircraft, np.random.Generator], Happened]


def _rotor(p: Parameters, a: Aircraft, rng: np.random.Generator) -> Happened:
    """One rotor loses thrust, and as much of its torque."""
    i, loss = int(rng.integers(len(p.hubs))), float(rng.uniform(0.05, 0.3))
    left = np.ones(len(p.hubs))
    left[i] -= loss
    hurt = replace(p, thrust_k=p.thrust_k * left, torque_k=p.torque_k * left)
    return hurt, {"rotor_efficiency_loss": {f"loss_{i + 1}": Number(loss, "1")}}


def _payload(p: Parameters, a: Aircraft, rng: np.random.Generator) -> Happened:
    """A point mass fixed below, off the centre: mass, centre of mass and inertia follow."""
    extra = float(rng.uniform(0.05, 0.25)) * p.mass
    place = direction(rng, float(rng.uniform(0.2, 0.5)) * a.arm, axes=2)
    place[2] = float(rng.uniform(0.05, 0.2)) * a.arm
    centre = extra / (p.mass + extra) * place
    reduced = extra * p.mass / (p.mass + extra)
    loaded = replace(
        p,
        mass=p.mass + extra,
        inertia=p.inertia + reduced * (place @ place - place**2),
        hubs=p.hubs - centre,
        imu_arm=p.imu_arm - centre,
        marker=p.marker - centre,
    )
    return loaded, {
        "mass_offset": {"mass_kg": Number(extra, "kg")},
        "cog_offset": vector("{}_m", centre[:2], "m"),
    }


def _library(name: str, smallest: float, largest: float) -> Defect:
    """An effect of the library of a size between two."""

    def happen(p: Parameters, a: Aircraft, rng: np.random.Generator) -> Happened:
        """The plant with it."""
        changed, truth = EFFECTS[name].hide(p, a, float(rng.uniform(smallest, largest)), rng)
        return changed, {name: truth}

    return happen


DEFECTS: dict[str, Defect] = {
    "rotor": _rotor,
    "payload": _payload,
    "slung": _library("slung_load", 0.05, 0.2),
    "accelerometer": _library("accel_bias", 0.25, 0.8),
    "gyroscope": _library("gyro_bias", 0.01, 0.06),
    "none": lambda p, a, rng: (p, {}),
}
"""By class; sizes of biases are above those of days, twice to eight times."""
