"""Missions of a flight: setpoints over time, and the random numbers that go with them.

Setpoints of a flight: position, velocity, acceleration and heading over time.

Each mission takes its sizes from a random generator, so that no two flights are alike. Moves
between two places are minimum-jerk (Flash & Hogan, J. Neuroscience 5, 1985).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from .aircraft import Aircraft, Noise
from .own.parameters import Array, Parameters

CONTROL_HZ = 200
DURATION_S = 24.0
MISSIONS = ("hover", "takeoff", "land", "forward", "tour", "slow_circle")


@dataclass(frozen=True)
class Setpoints:
    """What the controller is asked for at its instants.

    Attributes:
        pos: NED, m, shape (k, 3).
        vel: m/s.
        acc: m/s2.
        yaw: rad, shape (k,).
        yaw_rate: rad/s.
        armed: Whether the motors may turn.
        phase: Name of the phase, shape (k,).
    """

    pos: Array
    vel: Array
    acc: Array
    yaw: Array
    yaw_rate: Array
    armed: np.ndarray[tuple[int], np.dtype[np.bool_]]
    phase: np.ndarray[tuple[int], np.dtype[np.str_]]


class _Path:
    """Position and heading, leg after leg, at the instants of the controller."""

    def __init__(self, start: Array) -> None:
        self._rows: list[Array] = [start[None]]
        self._phases: list[str] = ["ground"]
        self.armed_from, self.armed_to = 0, 10**9

    @property
    def here(self) -> Array:
        """North, east, down, heading at the end of the last leg."""
        return np.asarray(self._rows[-1][-1])

    @property
    def samples(self) -> int:
        """So far."""
        return len(self._phases)

    def add(self, phase: str, seconds: float, shape: Callable[[Array], Array]) -> None:
        """A leg: `shape` gives displacement and turn over time from 0 to 1, shape (m, 4)."""
        m = max(round(seconds * CONTROL_HZ), 1)
        self._rows.append(self.here + shape(np.arange(1, m + 1) / m))
        self._phases += [phase] * m

    def wait(self, phase: str, seconds: float) -> None:
        """Stay."""
        self.add(phase, seconds, lambda s: np.zeros((len(s), 4)))

    def go(self, phase: str, seconds: float, way: list[float]) -> None:
        """Minimum-jerk move by north, east, down, heading."""
        self.add(phase, seconds, lambda s: _smooth(s)[:, None] * np.array(way))

    def setpoints(self) -> Setpoints:
        """Cut or held at `DURATION_S`, with derivatives."""
        n = round(DURATION_S * CONTROL_HZ)
        rows = np.concatenate(self._rows)[:n]
        rows = np.concatenate([rows, np.repeat(rows[-1:], n - len(rows), axis=0)])
        phases = (self._phases + [self._phases[-1]] * n)[:n]
        vel = np.gradient(rows, 1 / CONTROL_HZ, axis=0)
        acc = np.gradient(vel, 1 / CONTROL_HZ, axis=0)
        k = np.arange(n)
        return Setpoints(
            rows[:, :3],
            vel[:, :3],
            acc[:, :3],
            rows[:, 3],
            vel[:, 3],
            (k >= self.armed_from) & (k < self.armed_to),
            np.array(phases),
        )


def mission(name: str, leg: float, pace: float, rng: np.random.Generator) -> Setpoints:
    """Setpoints of a mission.

    Args:
        name: One of `MISSIONS`.
        leg: Height of the centre of mass on the ground, m.
        pace: Factor on speeds and distances.
        rng: Draws sizes, directions and headings.
    """
    path = _Path(np.array([0.0, 0.0, -leg, 0.0]))
    height = float(rng.uniform(1.3, 1.8))
    path.wait("ground", 0.8)
    path.armed_from = path.samples - 40
    path.go("takeoff", 2.4, [0, 0, -height, 0])
    legs = {
        "hover": _hover,
        "takeoff": _low,
        "land": _land,
        "forward": _forward,
        "tour": _tour,
        "slow_circle": _slow_circle,
    }
    legs[name](path, height, pace, rng)
    return path.setpoints()


def _hover(path: _Path, height: float, pace: float, rng: np.random.Generator) -> None:
    path.wait("hover", DURATION_S)


def _low(path: _Path, height: float, pace: float, rng: np.random.Generator) -> None:
    path.wait("hover", 3.0)
    path.go("hover", 2.0, [0, 0, height - 0.25, 0])
    path.wait("hover", 3.0)
    path.go("hover", 2.0, [0, 0, -height, float(rng.uniform(-2, 2))])
    path.wait("hover", DURATION_S)


def _land(path: _Path, height: float, pace: float, rng: np.random.Generator) -> None:
    path.wait("hover", 4.0)
    _down(path, height)


def _down(path: _Path, height: float) -> None:
    """Descend, pause low over the ground, touch down, stop the motors."""
    path.go("land", 2.0, [0, 0, height - 0.25, 0])
    path.wait("land", 0.7)
    path.go("land", 1.2, [0, 0, 0.25, 0])
    path.wait("land", 0.4)
    path.armed_to = path.samples
    path.wait("ground", DURATION_S)


def _forward(path: _Path, height: float, pace: float, rng: np.random.Generator) -> None:
    heading, turn = (
        float(rng.uniform(-0.6, 0.6)),
        float(rng.choice([-1, 1]) * rng.uniform(1.0, 1.6)),
    )
    far = pace * float(rng.uniform(7.5, 9.5))
    seconds = 3.6
    path.wait("hover", 0.5)
    for sign, climb in ((1.0, -1.0), (-1.0, 1.0)):
        way = [sign * far * np.cos(heading), sign * far * np.sin(heading), pace * climb, 0.0]
        path.go("forward", seconds, way)
        path.wait("hover", 0.4)
        path.go("hover", 2.0, [0, 0, 0, turn])
    side = pace * float(rng.uniform(3, 4))
    path.go("forward", 2.4, [side * np.sin(heading), -side * np.cos(heading), 0, 0])
    path.wait("hover", 0.3)
    _down(path, height)


def _tour(path: _Path, height: float, pace: float, rng: np.random.Generator) -> None:
    path.wait("hover", 0.5)
    for _ in range(2):
        angle, far = float(rng.uniform(-np.pi, np.pi)), pace * float(rng.uniform(1.8, 2.8))
        up = -pace * float(rng.uniform(0.9, 1.3))
        yaw = float(rng.choice([-1, 1]) * rng.uniform(0.7, 1.3))
        path.go("tour", 1.9, [far * np.cos(angle), far * np.sin(angle), up, yaw])
        path.wait("tour", 0.2)
        path.go("tour", 1.8, [-far * np.cos(angle), far * np.sin(angle) * 0.4, -up, -0.5 * yaw])
        path.wait("tour", 0.2)
    radius, sense = pace * float(rng.uniform(0.9, 1.1)), float(rng.choice([-1, 1]))
    path.add("tour", 4.8, lambda s: _circle(s, radius, sense))
    path.wait("tour", 0.2)
    path.add("tour", 5.4, lambda s: _eight(s, 1.25 * radius, sense))
    path.wait("hover", DURATION_S)


def _slow_circle(path: _Path, height: float, pace: float, rng: np.random.Generator) -> None:
    """Twice round at a walk."""
    path.wait("hover", 1.0)
    radius, sense = pace * float(rng.uniform(1.0, 1.4)), float(rng.choice([-1, 1]))
    for _ in range(2):
        path.add("tour", 9.0, lambda s: _circle(s, radius, sense))
    path.wait("hover", DURATION_S)


def _circle(s: Array, radius: float, sense: float) -> Array:
    """Once round while the heading turns a third as far."""
    angle = 2 * np.pi * _smooth(s)
    east = sense * radius * (1 - np.cos(angle))
    return np.stack([radius * np.sin(angle), east, 0 * s, 0.35 * sense * angle], axis=1)


def _eight(s: Array, radius: float, sense: float) -> Array:
    """Lemniscate of Gerono, slim, rising and sinking."""
    angle = 2 * np.pi * _smooth(s)
    return np.stack(
        [
            radius * np.sin(angle),
            0.22 * sense * radius * np.sin(2 * angle),
            0.25 * radius * (np.cos(angle) - 1),
            0 * s,
        ],
        axis=1,
    )


def _smooth(s: Array) -> Array:
    """From 0 to 1 with vanishing speed and acceleration at both ends."""
    return s * s * s * (10 + s * (-15 + 6 * s))


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
