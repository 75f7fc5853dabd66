"""A load on its rope: the observer that follows it, and the search that names it."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.fft import dct
from search_rigs.hypotheses import against, fit_set

from twin.effects import EFFECTS
from twin.effects.mass import (
    PLACE,
    SPEED,
    Course,
    hang_load,
    lifted_off,
    observe_swing,
    pace_of,
    rope_of,
)
from twin.explain.inference.fit import Problem
from twin.explain.model.numbers import with_effects
from twin.residuals.channels import CHANNEL_HZ, GRID_HZ
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import Waypoints, fly

Array = NDArray[np.float64]
STEP_S = 1 / 200
G = 9.80665
WAYPOINTS: Waypoints = (
    ("ground", 1.0, (0.0, 0.0, 0.0)),
    ("takeoff", 3.0, (0.0, 0.0, -2.0)),
    ("forward", 3.0, (5.0, 0.0, -2.0)),
    ("forward", 3.0, (5.0, 4.0, -2.5)),
    ("forward", 3.0, (0.0, 0.0, -2.0)),
    ("hover", 2.0, (0.0, 0.0, -2.0)),
)


def tilted(n: int, angle_rad: float) -> Array:
    """Specific force of a steady thrust that leans north."""
    return np.tile([G * np.sin(angle_rad), 0.0, -G * np.cos(angle_rad)], (n, 1))


def swing(free_n: Array, excess_n: Array, length_m: float) -> Course:
    """Of a load that is off the ground all the time."""
    return observe_swing(free_n, excess_n, length_m, STEP_S, np.ones(len(free_n), dtype=np.bool_))


def test_an_unobserved_load_swings_as_a_pendulum() -> None:
    along, rate, _ = swing(tilted(4000, 0.02), np.zeros((4000, 3)), 0.8)
    middle = along[:, 0] + np.sin(0.02)
    rises = np.flatnonzero((middle[:-1] < 0) & (middle[1:] >= 0))
    period = np.diff(rises).mean() * STEP_S
    assert period == pytest.approx(2 * np.pi * np.sqrt(0.8 / G), rel=2e-3)
    energy = 0.5 * 0.8 * np.sum(rate**2, axis=1) + np.sum(along * tilted(4000, 0.02), axis=1)
    assert np.ptp(energy) < 0.003 * G * (1 - np.cos(0.02))


def test_a_load_is_found_again_from_the_force_that_it_makes() -> None:
    """Its swing begins unknown: 40 degrees off, all of which is forgotten within 2 s."""
    free = tilted(2000, 0.0)
    free[:200] = tilted(200, 0.7)
    truth, rate, _ = swing(free, np.zeros((2000, 3)), 0.8)
    pull = 0.8 * np.sum(rate**2, axis=1) - np.sum(truth * free, axis=1)
    felt = 0.1 * pull[:, None] * truth
    blind, *_ = swing(tilted(1500, 0.0), np.zeros((1500, 3)), 0.8)
    found, *_ = swing(tilted(1500, 0.0), felt[500:], 0.8)
    late = slice(400, None)
    assert np.max(np.linalg.norm(blind[late] - truth[500:][late], axis=1)) > 0.3
    assert np.max(np.linalg.norm(found[late] - truth[500:][late], axis=1)) < 0.03


def test_a_force_that_lags_does_not_delay_the_load() -> None:
    """20 ms behind, as by a low-pass of 11 Hz: taken as it comes it costs 0.05 of the direction."""
    free = tilted(2000, 0.0)
    free[:200] = tilted(200, 0.7)
    truth, rate, hangs = swing(free, np.zeros((2000, 3)), 0.8)
    pull = 0.8 * np.sum(rate**2, axis=1) - np.sum(truth * free, axis=1)
    late = np.roll(0.1 * pull[:, None] * truth, 4, axis=0)
    late[:4] = 0.1 * np.array([0.0, 0.0, G])
    off = [
        np.abs(observe_swing(free, late, 0.8, STEP_S, hangs, lag_s=lag)[0] - truth).max()
        for lag in (0.0, 0.02)
    ]
    assert off[0] > 0.03 > 0.006 > off[1]


@pytest.mark.parametrize("length_m", [0.3, 0.8, 2.0])
def test_following_mere_noise_gains_what_the_integral_of_bode_says(length_m: float) -> None:
    """A load at rest, and white noise: ln |S| over the band of the channels."""
    n, share, observer = 40_000, 0.1, EFFECTS["slung_load"].observer
    noise = 0.01 * np.random.default_rng(0).standard_normal((n, 3))
    force = np.array([0.0, 0.0, share * G])
    assert observer is not None
    along, *_ = swing(tilted(n, 0.0), force + noise, length_m)
    left = noise[:, :2] - share * G * along[:, :2]
    inside = n * int(CHANNEL_HZ) // int(GRID_HZ)  # of the frequencies up to half the rate
    there, rest = (dct(v, axis=0, norm="ortho")[:inside] ** 2 for v in (noise[:, :2], left))
    gained = 0.5 * float(np.sum(np.log(there) - np.log(rest))) / 2
    small = load_vehicle("copter_default")
    said = 0.5 * observer.gain_1_s(small) * n * STEP_S * (1 - CHANNEL_HZ / GRID_HZ)
    assert gained == pytest.approx(said, rel=0.1)


def test_a_large_vehicle_is_followed_more_slowly() -> None:
    """By as much as its longer rope swings more slowly, so that less noise is followed."""
    small = load_vehicle("copter_default")
    large = replace(small, rotors=replace(small.rotors, position_m=4 * small.rotors.position_m))
    observer = EFFECTS["slung_load"].observer
    assert observer is not None
    assert pace_of(small) == 1.0
    expected = 0.7 * rope_of(large)
    assert expected == pytest.approx(3 * large.arm_m)
    assert pace_of(large) == pytest.approx(np.sqrt(0.7 / expected))
    assert observer.gain_1_s(large) == pytest.approx(pace_of(large) * observer.gain_1_s(small))
    n, hangs = 4000, np.ones(4000, dtype=np.bool_)
    noise = np.random.default_rng(0).standard_normal((n, 3)) * 0.01 + [0.0, 0.0, 1.0]
    fast, slow = (
        observe_swing(tilted(n, 0.0), noise, expected, STEP_S, hangs, pace)[0][:, 0].std()
        for pace in (1.0, pace_of(large))
    )
    assert slow < 0.85 * fast


def test_the_swing_does_not_look_ahead() -> None:
    rng = np.random.default_rng(0)
    free, felt = tilted(400, 0.1), rng.standard_normal((400, 3))
    other = np.where(np.arange(400)[:, None] < 200, felt, 5.0)
    assert np.array_equal(
        swing(free, felt, 1.0)[0][:201],
        swing(free, other, 1.0)[0][:201],
    )


def test_the_rope_is_stretched_by_its_tension() -> None:
    """At rest T / m = M g / (M + m) of thrust alone: what a vehicle that falls freely leaves."""
    names = ["vel_x", "vel_y", "vel_z", *PLACE, *SPEED]
    states = np.tile([1.0, 2.0, 3.0, *[0.0] * 6], (2, 1))
    hangs = np.ones(2, dtype=np.bool_)
    swung = np.tile([0.0, 0.0, 1.0], (2, 1)), np.tile([0.5, 0.0, 0.0], (2, 1)), hangs
    still = swung[0], np.zeros((2, 3)), hangs
    at_rest = hang_load(states, names, still, tilted(2, 0.0), 2.0, 0.25)
    assert (at_rest[0, 5] - 2.0) * (2 * np.pi * 5.0) ** 2 == pytest.approx(G / 1.25)
    moving = hang_load(states, names, swung, tilted(2, 0.0), 2.0, 0.0)
    assert (moving[0, 5] - 2.0) * (2 * np.pi * 5.0) ** 2 == pytest.approx(G + 2.0 * 0.5**2)
    assert moving[0, 6:].tolist() == [2.0, 2.0, 3.0]
    lying = hang_load(states, names, (*swung[:2], ~hangs), tilted(2, 0.0), 2.0, 0.0)
    assert lying[0, 5] < 2.0


def test_a_load_on_the_ground_pulls_where_the_log_says_so_alone() -> None:
    """A climb to 4 m with 2 m of rope: from the ground, and from a stand as high."""
    height = np.linspace(0.0, 4.0, 400)
    high = height > 2.0
    pull = np.tile([0.0, 0.0, 1.0], (400, 1))
    from_ground = pull * high[:, None] + [0.01, 0.0, 0.0]
    assert np.array_equal(lifted_off(from_ground, height, 2.0), high)
    assert lifted_off(pull, height, 2.0).all()
    assert lifted_off(from_ground, np.full(400, np.inf), 2.0).all()  # it never stood
    along, rate, _ = observe_swing(tilted(400, 0.3), pull, 2.0, STEP_S, high)
    assert np.array_equal(along[1:][~high[:-1]], np.tile([0.0, 0.0, 1.0], ((~high).sum(), 1)))
    assert np.abs(rate[high][1:]).max() > 0.1


def test_a_load_on_a_short_rope_stays_within_what_can_be_integrated() -> None:
    """Thrown about, a load 10 cm below turned ever faster, beyond the largest number."""
    rng, n = np.random.default_rng(0), 4000
    free = np.array([0.0, 0.0, -G]) + 25.0 * rng.standard_normal((n, 3))
    along, rate, _ = observe_swing(free, 0 * free, 0.1, STEP_S, np.ones(n, dtype=bool))
    assert np.linalg.norm(rate, axis=1).max() * STEP_S <= 0.5 + 1e-9
    np.testing.assert_allclose(np.linalg.norm(along, axis=1), 1.0)


def fitted(vehicle: Vehicle, plant: Vehicle, names: tuple[str, ...]) -> Problem:
    """Some effects against a flight of a plant."""
    return against(fly(vehicle, plant, 1, waypoints=WAYPOINTS), vehicle, *names)


SHORT: Waypoints = (
    ("ground", 1.0, (0.0, 0.0, 0.0)),
    ("takeoff", 2.0, (0.0, 0.0, -2.0)),
    ("forward", 2.5, (3.0, 0.0, -2.0)),
)


def test_slopes_include_what_the_observer_makes_of_a_number() -> None:
    """Mass and bias change the force from which the load is estimated, and its estimate with it."""
    vehicle = load_vehicle("copter_default")
    truth = {"mass_kg": 0.1 * vehicle.mass_kg, "length_m": 1.0}
    flight = fly(vehicle, vehicle.with_effects({"slung_load": truth}), 1, waypoints=SHORT)
    problem = against(flight, vehicle, "slung_load", "mass_offset", "accel_bias")
    names, x = problem.priors.names, np.zeros(len(problem.priors.now) + problem.rest.days.size)
    for number, value in truth.items():
        i = names.index(f"slung_load.{number}")
        x[i] = value - problem.priors.now[i]
    for number, small in (("mass_offset.mass_kg", 1e-4), ("accel_bias.x_m_s2", 1e-3)):
        i = names.index(number)
        x[i] = small
        more, less = x.copy(), x.copy()
        more[i], less[i] = x[i] + small, x[i] - small
        before, after = ({c.name: c for c in problem.channels(y)[0]} for y in (less, more))
        slopes = {c.name: c.slopes[:, 0] for c in problem.channels(x, [i])[0]}
        for channel in ("acc_x", "acc_z"):
            change = (before[channel].residual - after[channel].residual) / (2 * small)
            miss = np.abs(slopes[channel] - change).max()
            assert miss < 0.02 * np.abs(change).max(), (number, channel)


def test_slopes_cancel_where_all_that_is_heavy_grows_alike() -> None:
    """Newton: mass, load and thrust larger by a hundredth change no acceleration. Each
    alone moves the load that is followed far, the further the slacker its rope."""
    vehicle = load_vehicle("copter_default")
    truth = {"mass_kg": 0.1 * vehicle.mass_kg, "length_m": 0.7}
    legs: Waypoints = (*SHORT[:2], *(("forward", 2.0, (x, 0.0, -2.0)) for x in (3.0, 0.0, 3.0)))
    flight = fly(vehicle, vehicle.with_effects({"slung_load": truth}), 1, waypoints=legs)
    problem = against(flight, vehicle, "slung_load", "mass_offset", "thrust_scale")
    heavy = {
        "mass_offset.mass_kg": (1e-9, vehicle.mass_kg),
        "slung_load.mass_kg": (truth["mass_kg"], truth["mass_kg"]),
        "thrust_scale.scale": (1 + 1e-9, 1.0),
    }
    at = {name: value for name, (value, _) in heavy.items()} | {"slung_load.length_m": 0.7}
    b, x = problem.priors, np.zeros(len(problem.priors.now) + problem.rest.days.size)
    for name, value in at.items():
        x[b.names.index(name)] = value - b.now[b.names.index(name)]
    found = problem.channels(x, [b.names.index(name) for name in heavy])[0]
    for channel in (c for c in found if c.name in ("acc_x", "acc_y", "acc_z")):
        each = channel.slopes * [size for _, size in heavy.values()]
        assert np.std(each.sum(axis=1)) < 0.003 * np.std(each[:, 0]), channel.name


def test_the_tension_is_that_of_the_aircraft_as_heavy_as_it_is() -> None:
    vehicle = load_vehicle("copter_default")
    flight = fly(vehicle, vehicle, 1, waypoints=SHORT)
    problem = against(flight, vehicle, "slung_load", "mass_offset")
    (model,) = problem.model.flights
    names = [n.full for n in model.numbers]
    theta = np.array([n.now for n in model.numbers])
    theta[names.index("mass_offset.mass_kg")] = 0.25
    states, inputs = model.aligned.states, model.aligned.inputs.u
    physics = model._physics
    assert physics.driving(theta, states, inputs)[2] == pytest.approx(
        vehicle.mass_kg + 0.25, rel=1e-9
    )


@pytest.mark.slow
def test_a_gentle_flight_names_the_load_and_tells_mass_and_length() -> None:
    vehicle = load_vehicle("copter_default")
    truth = {"slung_load.mass_kg": 0.08 * vehicle.mass_kg, "slung_load.length_m": 1.0}
    plant = with_effects(vehicle, ["slung_load"], truth)
    problem = fitted(vehicle, plant, ("slung_load", "mass_offset", "steady_wind", "rotor_drag"))
    found = fit_set(problem, ["slung_load"])
    assert found.values["slung_load.mass_kg"] == pytest.approx(
        truth["slung_load.mass_kg"], rel=0.02
    )
    assert found.values["slung_load.length_m"] == pytest.approx(1.0, rel=0.03)
    for rival in (["mass_offset"], ["steady_wind"], ["mass_offset", "rotor_drag"]):
        assert found.gain > fit_set(problem, rival).gain + 50, rival


@pytest.mark.slow
@pytest.mark.parametrize("hidden", ["mass_offset", "rotor_drag"])
def test_what_is_no_load_is_not_taken_for_one(hidden: str) -> None:
    vehicle = load_vehicle("copter_default")
    heavier = replace(vehicle, mass_kg=1.08 * vehicle.mass_kg)
    dragged = with_effects(vehicle, ["rotor_drag"], {"rotor_drag.k_xy_1_s": 0.4})
    plant = heavier if hidden == "mass_offset" else dragged
    problem = fitted(vehicle, plant, ("slung_load", hidden))
    assert fit_set(problem, [hidden]).gain > fit_set(problem, ["slung_load"]).gain + 20
