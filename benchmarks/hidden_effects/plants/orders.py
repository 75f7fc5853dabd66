"""What is to be flown, and the random numbers that go with it."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from .aircraft import Aircraft
from .missions import CONTROL_HZ, Setpoints
from .noise import Noise
from .own.parameters import Array, Parameters


@dataclass(frozen=True)
class Order:
    """One flight to be flown.

    Attributes:
        aircraft: What the controller believes to fly.
        plant: What flies, hidden effects included.
        setpoints: Mission.
        noise: Level of the sensors by the vehicle file.
        seed: Of every random number of this flight.
    """

    aircraft: Aircraft
    plant: Parameters
    setpoints: Setpoints
    noise: Noise
    seed: tuple[int, ...]


@dataclass(frozen=True)
class Draws:
    """Random numbers of the flights, drawn before they start; shape (k, ..., n)."""

    accel: Array
    gyro: Array
    pos: Array
    vel: Array
    attitude: Array
    gust: Array


def draw(orders: list[Order]) -> Draws:
    """Each flight from its own seed, whatever flies beside it."""
    columns: dict[str, list[Array]] = {}
    for order in orders:
        rng, noise, p = np.random.default_rng(order.seed), order.noise, order.plant
        k = len(order.setpoints.yaw)
        sizes = {
            "accel": noise.accel * p.noise_scale,
            "gyro": noise.gyro * p.noise_scale,
            "pos": noise.position,
            "vel": noise.velocity,
            "attitude": noise.attitude,
        }
        for name, size in sizes.items():
            columns.setdefault(name, []).append(size * rng.standard_normal((k, 3)))
        stay = float(np.exp(-1 / (CONTROL_HZ * p.gust_time)))
        kick = p.gust_sigma * np.sqrt(1 - stay**2) * rng.standard_normal((k, 3))
        kick[0] /= np.sqrt(1 - stay**2)
        columns.setdefault("gust", []).append(lfilter([1.0], [1.0, -stay], kick, axis=0))
    return Draws(**{name: np.stack(values, axis=-1) for name, values in columns.items()})


def between(gust: Array, k: int, share: float) -> Array:
    """Gust at a share of the way from sample k to the next."""
    return np.asarray(gust[k] + share * (gust[min(k + 1, len(gust) - 1)] - gust[k]))
