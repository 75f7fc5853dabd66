"""Seconds in the air are those of the flight, whatever the vehicle file says of thrust and mass."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.errors import LogError
from twin.logs import Flight
from twin.residuals.aligned import align_flight, carry
from twin.residuals.channels import GRID_HZ
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import Waypoints, fly

COPTER = load_vehicle("copter_default")
TOUR: Waypoints = (
    ("ground", 1.5, (0.0, 0.0, 0.0)),
    ("takeoff", 2.0, (0.0, 0.0, -1.5)),
    ("tour", 2.0, (1.5, 0.0, -1.0)),
    ("tour", 2.0, (0.0, 0.0, -2.0)),
)
POSE = tuple(f"{s}_{a}" for s in ("pos", "vel", "q") for a in ("w", "x", "y", "z"))


@pytest.fixture(scope="module")
def tour() -> Flight:
    return fly(COPTER, COPTER, seed=4, name="tour", waypoints=TOUR)


def wrong(thrust: float, mass: float) -> Vehicle:
    """The same aircraft with a wrong file."""
    law = tuple(thrust * c for c in COPTER.rotors.thrust_n)
    rotors = replace(COPTER.rotors, thrust_n=law)
    return replace(COPTER, rotors=rotors, mass_kg=mass * COPTER.mass_kg)


WRONG = ((0.5, 1.0), (2.0, 1.0), (1.0, 0.5), (1.0, 2.0), (0.7, 1.2), (2.5, 0.7))


@pytest.mark.slow
@pytest.mark.parametrize(("thrust", "mass"), WRONG)
@pytest.mark.parametrize("lacks", ["", "land detector", "pose"])
def test_a_wrong_file_flies_as_long_as_the_right_one(
    tour: Flight, thrust: float, mass: float, lacks: str
) -> None:
    flight = tour
    if lacks:
        flight = replace(flight, table=flight.table.assign(phase=""))
    if lacks == "pose":
        table = flight.table.drop(columns=[c for c in POSE if c in flight.table])
        flight = replace(flight, table=table)
    right, found = (align_flight(flight, v, 1 / GRID_HZ) for v in (COPTER, wrong(thrust, mass)))
    assert found.airborne.sum() == pytest.approx(right.airborne.sum(), abs=0.1 * GRID_HZ)
    share = 100 * thrust / mass
    (said,) = [n for n in found.notes if "of its weight" in n]
    assert float(said.split("carry ")[1].split(" %")[0]) == pytest.approx(share, rel=0.06)
    assert not any("of its weight" in n for n in right.notes)


def test_what_idles_on_the_ground_does_not_fly(tour: Flight) -> None:
    """Ten seconds of idling rotors, a height that drifts by meters, nothing that says ground."""
    n = 2000
    t = np.arange(n) / GRID_HZ
    rng = np.random.default_rng(3)
    table = tour.table.iloc[:1].reindex(range(n)).assign(time=t, phase="")
    table[["q_w", "q_x", "q_y", "q_z"]] = [1.0, 0.0, 0.0, 0.0]
    for i in range(1, 5):
        table[f"cmd_{i}"] = 0.1 + 0.01 * np.sin(t)
    table[["pos_x", "pos_y", "vel_x", "vel_y", "vel_z"]] = 0.0
    table["pos_z"] = 3 * np.sin(0.3 * t)
    for axis, at_rest in zip("xyz", (0.0, 0.0, -9.81), strict=True):
        table[f"acc_{axis}"] = at_rest + 0.2 * rng.standard_normal(n)
        table[f"gyro_{axis}"] = 0.01 * rng.standard_normal(n)
    with pytest.raises(LogError, match="never airborne"):
        align_flight(replace(tour, table=table), COPTER, 1 / GRID_HZ)


def test_a_vehicle_too_weak_by_far_is_named(tour: Flight) -> None:
    """Land detector and height say that it flies, at commands that carry next to nothing."""
    weak = tour.table.assign(
        **{c: 0.3 * tour.table[c] for c in ("cmd_1", "cmd_2", "cmd_3", "cmd_4")}
    )
    with pytest.raises(LogError, match=r"carries \d+\.?\d* % of its weight .* vehicle draft"):
        align_flight(replace(tour, table=weak), COPTER, 1 / GRID_HZ)


@pytest.mark.slow
@settings(deadline=None)
@given(st.floats(0.05, 20.0), st.integers(0, 1000))
def test_the_thrust_that_carries_scales_with_the_file(factor: float, seed: int) -> None:
    """By each kind of evidence; and specific force that does not follow the thrust is none."""
    rng = np.random.default_rng(seed)
    n, step_s = 4000, 1 / GRID_HZ
    slow = np.repeat(rng.standard_normal(n // 100), 100)
    thrust = np.where(np.arange(n) < 800, 1.0, 10.0 + slow)
    grounded, height = np.arange(n) < 800, np.where(np.arange(n) < 900, 0.0, 2.0)
    never, nowhere = np.zeros(n, dtype=np.bool_), np.full(n, np.nan)

    def of(down: np.ndarray, up: np.ndarray, force: np.ndarray) -> float | None:
        return carry(factor * thrust, down, up, lambda: force, step_s)

    expected = pytest.approx(10.0 * factor, rel=0.2)
    assert of(grounded, nowhere, np.zeros(0)) == expected
    assert of(never, height, np.zeros(0)) == expected
    assert of(never, nowhere, thrust + 0.1 * rng.standard_normal(n)) == expected
    assert of(never, nowhere, np.zeros(0)) is None
    assert of(never, nowhere, 9.81 + 0.1 * rng.standard_normal(n)) is None
