"""Our own plant against mathematics, and against the vehicle file that it hands out."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.polynomial.polynomial import polyval

from benchmarks.hidden_effects.plants.aircraft import AIRCRAFT, NOISE, Aircraft, vehicle_toml
from benchmarks.hidden_effects.plants.own import flight, physics
from benchmarks.hidden_effects.plants.own.parameters import (
    GRAVITY_M_S2,
    STEP_S,
    Array,
    Batch,
    Parameters,
)
from benchmarks.hidden_effects.plants.own.physics import (
    Layout,
    climb_slope,
    motion,
    rotation,
    thrust_ratio,
    to_ned,
)
from twin.vehicle_file import parse_vehicle

every_aircraft = pytest.mark.parametrize("aircraft", AIRCRAFT.values(), ids=list(AIRCRAFT))
LOAD_KG, ROPE_M = 0.2, 0.8


def powerless(**numbers: object) -> Parameters:
    """A tumbling body without rotors and air."""
    p = AIRCRAFT["quad_450"].nominal
    none = {"thrust_k": 0 * p.thrust_k, "torque_k": 0 * p.torque_k, "drag_linear": np.zeros(3)}
    return replace(p, **none, **numbers)  # type: ignore[arg-type]


def throw(p: Parameters, seconds: float, step_s: float = STEP_S) -> tuple[Array, Layout]:
    """States of a body thrown up high while it tumbles, one per step, shape (k, size)."""
    batch, layout = Batch([p]), Layout(len(p.hubs))
    x = np.zeros((layout.size, 1))
    x[layout.pos][2] = -100.0
    x[layout.vel][:, 0] = 3.0, -2.0, -5.0
    x[layout.q][0] = 1.0
    x[layout.omega][:, 0] = 2.0, -3.0, 1.5
    x[layout.rope][:, 0] = p.load_length * np.array([0.6, 0.0, 0.8])
    x[layout.swing][1] = 1.0
    x[layout.rotor] = p.speed_0
    x[layout.charge] = 1.0
    nothing, still = np.zeros((len(p.hubs), 1)), np.zeros((3, 1))
    course, before = [x[:, 0]], None
    for k in range(round(seconds / step_s)):
        at = motion(batch, layout, x, nothing, still, k * step_s)
        x, before = flight.advance(batch, layout, x, at, at.rate if before is None else before)
        course.append(x[:, 0])
    return np.array(course), layout


@pytest.mark.slow
def test_free_body_keeps_energy_and_angular_momentum() -> None:
    p = powerless()
    x, at = throw(p, 2.0)
    omega, vel = x[:, at.omega], x[:, at.vel]
    energy = (
        0.5 * p.mass * (vel**2).sum(1)
        + 0.5 * (p.inertia * omega**2).sum(1)
        - p.mass * GRAVITY_M_S2 * x[:, at.pos][:, 2]
    )
    momentum = to_ned(rotation(x[:, at.q].T), (p.inertia * omega).T).T
    assert np.ptp(energy) < 1e-5 * p.mass * GRAVITY_M_S2
    assert np.abs(momentum - momentum[0]).max() < 1e-5 * np.linalg.norm(momentum[0])


@pytest.mark.slow
def test_body_with_load_keeps_energy_and_momentum(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(physics, "_SWING_DAMPING_1_S", 0.0)
    monkeypatch.setattr(physics, "_ROPE_DAMPING", 0.0)
    p = powerless(load_mass=LOAD_KG, load_length=ROPE_M)
    x, at = throw(p, 2.0)
    vel, pos, rope = x[:, at.vel], x[:, at.pos], x[:, at.rope]
    load_vel, load_pos = vel + x[:, at.swing], pos + rope
    stretch = np.linalg.norm(rope, axis=1) - ROPE_M
    assert -0.5 * ROPE_M < stretch.min() < 0.0 < stretch.max() < 0.005  # it slackens, and is stiff
    energy = 0.5 * p.mass * (vel**2).sum(1) + 0.5 * LOAD_KG * (load_vel**2).sum(1)
    energy += 0.5 * LOAD_KG * (physics.ROPE_RAD_S * np.maximum(stretch, 0.0)) ** 2
    energy -= GRAVITY_M_S2 * (p.mass * pos[:, 2] + LOAD_KG * load_pos[:, 2])
    momentum = p.mass * vel + LOAD_KG * load_vel
    gained = (p.mass + LOAD_KG) * GRAVITY_M_S2 * STEP_S * np.arange(len(x))
    momentum[:, 2] -= gained
    assert np.ptp(energy) < 1e-4 * p.mass * GRAVITY_M_S2
    assert np.abs(momentum - momentum[0]).max() < 1e-4


@pytest.mark.slow
def test_steps_are_of_second_order(monkeypatch: pytest.MonkeyPatch) -> None:
    ends = []
    for step in (2e-3, 1e-3, 5e-4, 2.5e-4):
        monkeypatch.setattr(flight, "STEP_S", step)
        x, at = throw(powerless(drag_quadratic=np.array([0.1, 0.2, 0.3])), 0.5, step)
        ends.append(x[-1, : at.rope.start])
    errors = [np.linalg.norm(a - b) for a, b in pairwise(ends)]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all(orders > 1.8), orders


@every_aircraft
def test_hover_speed_carries_the_weight(aircraft: Aircraft) -> None:
    p = aircraft.nominal
    batch, layout = Batch([p]), Layout(len(p.hubs))
    x = np.zeros((layout.size, 1))
    x[layout.pos][2], x[layout.q][0], x[layout.charge] = -5.0, 1.0, 1.0
    x[layout.rotor] = p.hover_speed
    command = np.full((len(p.hubs), 1), (p.hover_speed - p.speed_0) / p.speed_1)
    at = motion(batch, layout, x, command, np.zeros((3, 1)), 0.0)
    moving = np.concatenate([at.rate[layout.vel], at.rate[layout.omega], at.rate[layout.rotor]])
    assert np.abs(moving).max() < 1e-9
    assert np.all((command > 0.3) & (command < 0.7))


@every_aircraft
def test_vehicle_file_has_the_maps_of_the_plant(aircraft: Aircraft) -> None:
    p = aircraft.nominal
    vehicle = parse_vehicle(vehicle_toml(aircraft, NOISE["medium"]), "vehicle.toml")
    rotors = vehicle.rotors
    command = np.linspace(0, 1, 11)
    speed = p.speed_0 + p.speed_1 * command
    argument = polyval(command, rotors.speed_rad_s) if rotors.speed_rad_s else command
    np.testing.assert_allclose(polyval(argument, rotors.thrust_n), p.thrust_k[0] * speed**2)
    np.testing.assert_allclose(polyval(argument, rotors.torque_n_m), p.torque_k[0] * speed**2)
    np.testing.assert_allclose(rotors.position_m, p.hubs)
    np.testing.assert_array_equal(rotors.direction, p.direction)
    assert vehicle.mass_kg == p.mass


@pytest.mark.parametrize("gain", [0.2, 0.7, 1.6])
def test_rotor_solves_blade_element_and_momentum_theory(gain: float) -> None:
    climb, along = np.meshgrid(np.linspace(-0.5, 1.5, 9), np.linspace(0.0, 2.0, 9))
    ratio = thrust_ratio(gain, climb, along)
    inflow = 1 - (ratio - 1) / gain
    momentum = (inflow - climb) * np.hypot(along, inflow)
    np.testing.assert_allclose(momentum, ratio, rtol=1e-10)
    assert thrust_ratio(gain, np.zeros(1), np.zeros(1))[0] == pytest.approx(1.0, abs=1e-14)


def test_climb_slope_is_the_derivative_of_the_thrust() -> None:
    h = 1e-5
    up, down = (float(thrust_ratio(0.7, np.array([c]), np.zeros(1))[0]) for c in (h, -h))
    assert (down - up) / (2 * h) == pytest.approx(climb_slope(0.7, 1.0), rel=1e-6)
