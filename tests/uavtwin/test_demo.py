"""The built-in flights: the plant follows the waypoints, and a seed gives the same bits."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twin.logs import Flight
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle, parse_vehicle
from uavtwin.demo.flights import (
    ACC_NOISE_M_S2,
    ATT_NOISE,
    IMU_S,
    POSE_S,
    WAYPOINTS,
    fly,
    hide,
)

EFFECTS = ("cog_offset", "inertia_error", "mass_offset", "rotor_drag", "thrust_scale")
FEISI = load_vehicle("feisi_x150")


@pytest.fixture(scope="module")
def flight() -> Flight:
    """Nothing hidden, seed 0."""
    return fly(FEISI, FEISI, seed=0)


def places(flight: Flight, plant: Vehicle) -> dict[int, np.ndarray]:
    """Measured position from the resting place at the end of each waypoint."""
    t, pos = flight.signal(["pos_x", "pos_y", "pos_z"])
    ends = np.cumsum([duration for _, duration, _ in WAYPOINTS])
    rest = np.array([0.0, 0.0, -plant.leg_height_m])
    return {i: pos[np.searchsorted(t, end - 0.02)] - rest for i, end in enumerate(ends)}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["copter_default", "crazyflie", "feisi_x150"])
def test_plant_equal_to_the_twin_follows_the_waypoints(name: str) -> None:
    vehicle = load_vehicle(name)
    flight = fly(vehicle, vehicle, seed=3)
    reached = places(flight, vehicle)
    wanted = {i: np.array(place) for i, (_, _, place) in enumerate(WAYPOINTS)}
    miss = {i: float(np.linalg.norm(reached[i] - wanted[i])) for i in reached}
    assert max(miss.values()) < 1.1, miss  # at the corners it lags behind
    assert miss[2] < 0.1, miss  # settled hover
    assert miss[7] < 0.25, miss
    assert miss[len(WAYPOINTS) - 1] < 0.25, miss  # back on the ground
    # Flying, not saturated: no more than 0.2 s at a bound.
    flying = flight.table[~flight.table["phase"].isin(["ground"])]
    commands = flying[[f"cmd_{i}" for i in range(1, 5)]].to_numpy()
    at_bound = np.any((commands <= 0.0) | (commands >= 1.0), axis=1)
    assert at_bound.sum() * IMU_S < 0.2


@pytest.mark.slow
def test_flight_table_holds_what_it_says(flight: Flight) -> None:
    t = flight.table["time"].to_numpy()
    seconds = sum(duration for _, duration, _ in WAYPOINTS)
    assert t[0] == 0.0
    assert t[-1] == pytest.approx(seconds, abs=0.01)
    np.testing.assert_allclose(np.diff(t), IMU_S, rtol=1e-9)
    t_pose, q = flight.signal(["q_w", "q_x", "q_y", "q_z"])
    np.testing.assert_allclose(np.diff(t_pose), POSE_S, rtol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, rtol=1e-12)
    assert list(dict.fromkeys(flight.table["phase"])) == [
        "ground",
        "takeoff",
        "hover",
        "forward",
        "land",
    ]
    still = flight.table[flight.table["time"].between(0.5, 1.0, inclusive="left")]
    assert still["acc_z"].mean() == pytest.approx(-9.80665, abs=0.03)
    assert still["acc_x"].std() == pytest.approx(ACC_NOISE_M_S2, rel=0.3)
    assert still["q_x"].std() == pytest.approx(ATT_NOISE, rel=0.4)


@pytest.mark.slow
def test_a_seed_gives_the_same_flight_and_another_seed_other_noise(flight: Flight) -> None:
    one, same, other = flight, *(fly(FEISI, FEISI, seed=s) for s in (0, 8))
    assert one.table.equals(same.table)
    commands = [f"cmd_{i}" for i in range(1, 5)]
    assert one.table[commands].equals(other.table[commands])  # noise is not fed back
    gap = (one.table["acc_x"] - other.table["acc_x"]).std()
    assert gap == pytest.approx(np.sqrt(2) * ACC_NOISE_M_S2, rel=0.05)


def test_hidden_effects_are_drawn_by_the_seed_and_all_of_them_come() -> None:
    drawn = [hide(FEISI, seed) for seed in range(60)]
    assert {h.effect for h in drawn} == set(EFFECTS)
    assert [h.text for h in drawn] == [hide(FEISI, seed).text for seed in range(60)]
    for hidden in drawn:  # one thing is changed, and only that
        plant, changed = hidden.plant, set()
        if plant.mass_kg != FEISI.mass_kg:
            changed.add("mass_offset")
        if not np.array_equal(plant.inertia_kg_m2, FEISI.inertia_kg_m2):
            changed.add("inertia_error")
        if not np.array_equal(plant.drag_linear_n_s_m, FEISI.drag_linear_n_s_m):
            changed.add("rotor_drag")
        if not np.array_equal(plant.rotors.position_m, FEISI.rotors.position_m):
            changed.add("cog_offset")
        if plant.rotors.thrust_n != FEISI.rotors.thrust_n:
            changed.add("thrust_scale")
        assert changed == {hidden.effect}


def test_the_text_of_a_hidden_effect_is_its_size() -> None:
    by_effect = {(h := hide(FEISI, seed)).effect: h for seed in range(60)}
    grams = 1e3 * (by_effect["mass_offset"].plant.mass_kg - FEISI.mass_kg)
    assert by_effect["mass_offset"].text == f"{grams:.0f} g of extra mass"
    shift = 1e3 * (FEISI.rotors.position_m - by_effect["cog_offset"].plant.rotors.position_m)[0]
    assert f"{shift[0]:.1f}, {shift[1]:.1f} mm forward, right" in by_effect["cog_offset"].text


@pytest.mark.slow
@pytest.mark.parametrize("effect", EFFECTS)
def test_the_controller_flies_a_plant_it_does_not_know(effect: str) -> None:
    hidden = next(h for h in (hide(FEISI, seed) for seed in range(60)) if h.effect == effect)
    flight = fly(FEISI, hidden.plant, seed=1)
    reached = places(flight, hidden.plant)
    for i in (2, 7, len(WAYPOINTS) - 1):
        assert np.linalg.norm(reached[i] - np.array(WAYPOINTS[i][2])) < 0.5, (i, reached[i])
    flying = flight.table[~flight.table["phase"].isin(["ground"])]
    commands = flying[[f"cmd_{i}" for i in range(1, 5)]].to_numpy()
    assert np.any((commands <= 0) | (commands >= 1), axis=1).sum() * IMU_S < 0.2


@pytest.mark.slow
def test_low_passes_of_the_imu_are_in_the_record(flight: Flight) -> None:
    """Filtered readings follow the unfiltered ones, later by sqrt(2) / w, with the same noise."""
    filtered = replace(FEISI, accel_cutoff_hz=20.0, gyro_cutoff_hz=20.0)
    one, two = flight, fly(filtered, filtered, seed=0)
    assert not one.table["gyro_y"].equals(two.table["gyro_y"])
    t, gyro = one.signal(["gyro_y"])
    late_s = np.sqrt(2) / (2 * np.pi * 20.0)
    follows = np.interp(t - late_s, t, gyro[:, 0]) - two.table["gyro_y"].to_numpy()
    flying = (t > 1.5) & (t < 25.0)
    assert np.std(follows[flying]) < 0.02
    assert np.std(gyro[flying, 0]) > 0.1
    means = [float(f.table["acc_z"][flying].mean()) for f in (one, two)]
    assert means[1] == pytest.approx(means[0], abs=0.01)


@pytest.mark.slow
def test_a_vehicle_driven_by_rotor_speeds_records_them() -> None:
    """That of the page on vehicle files, whose rotors have no map from a command."""
    page = (Path(__file__).parents[2] / "docs" / "guide" / "vehicle.md").read_text()
    vehicle = parse_vehicle(page.split("```toml\n")[1].split("```")[0], "paper.toml")
    assert vehicle.drive == "rotor_speed"
    flight = fly(vehicle, vehicle, seed=1)
    assert flight.has("rotor_1", "rotor_4") and not flight.has("cmd_1")
    reached = places(flight, vehicle)
    assert np.linalg.norm(reached[2] - np.array(WAYPOINTS[2][2])) < 0.1  # settled hover
