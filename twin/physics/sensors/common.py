"""Functions shared by the sensors: vectors of inputs, noise, drift, delayed samples."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import casadi as ca

from ...component import ComponentBuilder
from ...effects import Blocks, ComponentName, effects_of
from ...effects.stages import Latency
from ...frames import AXES, FRD, NED
from ...vehicle import Vehicle

BODY = tuple(f"body {d}" for d in FRD)  # names of the axes in a variable's description
EARTH = tuple(f"NED {d}" for d in NED)  # names of the axes in a variable's description


def sensor_blocks(
    m: ComponentBuilder, vehicle: Vehicle, component: ComponentName, effects: Iterable[str]
) -> Blocks:
    """The effects of a sensor: requested ones, switched off, and the vehicle's own, on."""
    wanted = {*effects, *vehicle.effects}
    return Blocks(m, vehicle, [e for e in effects_of(component) if e.name in wanted])


def vector_input(
    m: ComponentBuilder, stem: str, unit: str, meaning: str, directions: Sequence[str]
) -> list[ca.SX]:
    """Three inputs `stem_x`, `stem_y`, `stem_z`."""
    return [
        m.input(f"{stem}_{a}", unit, f"{meaning}, {d}")
        for a, d in zip(AXES, directions, strict=True)
    ]


def vector_parameter(
    m: ComponentBuilder,
    stem: str,
    start: Sequence[float],
    unit: str,
    meaning: str,
    directions: Sequence[str],
) -> list[ca.SX]:
    """Three parameters `stem_x`, `stem_y`, `stem_z`."""
    return [
        m.parameter(f"{stem}_{a}", float(s), unit, f"{meaning}, {d}")
        for a, s, d in zip(AXES, start, directions, strict=True)
    ]


def attitude_input(m: ComponentBuilder) -> list[ca.SX]:
    """The four inputs `q_w`, `q_x`, `q_y`, `q_z`, level at the start."""
    return [
        m.input(f"q_{a}", "1", f"Attitude quaternion body to NED, {a}", float(a == "w"))
        for a in "wxyz"
    ]


@dataclass(frozen=True, slots=True)
class NoiseLevel:
    """White noise, standard deviation, and the walk of the bias, standard deviation after 1 s."""

    white: ca.SX
    walk: ca.SX


def noise_level(m: ComponentBuilder, name: str, unit: str, white: float, walk: float) -> NoiseLevel:
    """Declare the parameters `name_noise` and `name_bias_walk`."""
    return NoiseLevel(
        m.parameter(
            f"{name}_noise", white, unit, f"Noise of {name}, standard deviation", minimum=0
        ),
        m.parameter(
            f"{name}_bias_walk",
            walk,
            unit,
            f"Walk of the bias of {name}, standard deviation after 1 s",
            minimum=0,
        ),
    )


def noise(m: ComponentBuilder, channel: str, unit: str, level: NoiseLevel, period: ca.SX) -> ca.SX:
    """White noise plus random walk of the bias of one channel, drawn at each sample instant."""
    drift = m.memory(f"{channel}.drift", unit, f"Walk of the bias of {channel}")
    white = m.memory(f"{channel}.noise", unit, f"Noise of {channel}")
    m.update(f"{channel}.drift", drift + ca.sqrt(period) * m.noise(level.walk))
    m.update(f"{channel}.noise", m.noise(level.white))
    return drift + white


def late(
    m: ComponentBuilder,
    channel: str,
    unit: str,
    signal: ca.SX,
    latency: Latency,
    samples: int,
) -> ca.SX:
    """A signal delayed by the latency, sampled at the sample instants and held."""
    held = m.memory(f"{channel}.late", unit, f"{channel}, late")
    m.update(f"{channel}.late", m.delayed(channel, signal, latency.delay_s, samples))
    return held
