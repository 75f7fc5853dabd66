"""`gap` and `explain` say the same of a flight: one definition of a residual, one pipeline."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twin.explain.holdout import compare_holdout
from twin.explain.model.model import candidates, model_of
from twin.logs import Flight, read_flight
from twin.residuals.flight_gap import flight_gap
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import Waypoints, fly
from uavtwin.gaps import gap_record

COPTER, FEISI = load_vehicle("copter_default"), load_vehicle("feisi_x150")
LEGS: Waypoints = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 2.0, (0.0, 0.0, -1.5)),
    ("forward", 3.0, (4.0, 2.0, -2.0)),
    ("hover", 2.0, (4.0, 2.0, -2.0)),
)
OF_IMU = [f"{stem}_{a}" for stem in ("acc", "gyro_rate") for a in "xyz"]
WHOLE_FLIGHT_S = 60.0
"""A horizon longer than the flight: no windows."""


def simulated() -> Flight:
    """15 % heavier than the twin."""
    return fly(COPTER, replace(COPTER, mass_kg=1.15 * COPTER.mass_kg), 1, waypoints=LEGS)


def gap_of(flight: Flight, vehicle: Vehicle) -> dict[str, dict[str, object]]:
    channels: dict[str, dict[str, object]] = gap_record(
        [flight_gap(flight, vehicle, WHOLE_FLIGHT_S)]
    ).json()["channels"]
    return {k: v for k, v in channels.items() if v["horizon_s"] == 0}


def assert_same_gap(flight: Flight, vehicle: Vehicle) -> None:
    before = {g.name: g for g in compare_holdout([flight], vehicle, [], {}).gaps}
    ours = gap_of(flight, vehicle)
    assert list(ours) == OF_IMU
    for name, channel in ours.items():
        assert channel["unit"] == before[name].unit
        assert channel["n"] == before[name].n
        assert channel["rms"] == pytest.approx(before[name].before, rel=1e-12), name


@pytest.mark.slow
def test_the_gap_of_a_held_out_flight_is_what_explain_says_before() -> None:
    assert_same_gap(simulated(), COPTER)


@pytest.mark.slow
def test_the_gap_of_a_real_flight_is_what_explain_says_before(data_dir: Path) -> None:
    assert_same_gap(read_flight(data_dir / "rflysimdt" / "real_3.ulg"), FEISI)


@pytest.mark.slow
@pytest.mark.parametrize(
    "change",
    [
        lambda v: replace(v, accel_cutoff_hz=30.0, gyro_cutoff_hz=20.0),
        lambda v: v.with_effects({"imu_delay": {"delay_s": 0.012}}),
        lambda v: v.with_effects({"position_delay": {"delay_s": 0.05}}),
        lambda v: v.with_effects({"command_delay": {"delay_s": 0.03}}),
        lambda v: v.with_effects(
            {
                "accel_bias": {"x_m_s2": 0.3, "y_m_s2": -0.1, "z_m_s2": 0.2},
                "motor_lag": {"tau_s": 0.1},
            }
        ),
    ],
    ids=["low-pass", "imu late", "pose late", "commands late", "bias and lag"],
)
def test_the_same_of_a_vehicle_with_effects(change: Callable[[Vehicle], Vehicle]) -> None:
    """Sample by sample, and not that of the vehicle without them."""
    dragged = replace(COPTER, drag_linear_n_s_m=np.array([1.0, 1.0, 0.0]))  # feels the pose
    flight, vehicle = simulated(), change(dragged)
    model = model_of([flight], vehicle, candidates([flight]))
    searched = {c.name: c for c in model.channels([])[0]}
    plain = {c.name: c for c in flight_gap(flight, dragged, WHOLE_FLIGHT_S).channels}
    differ = []
    for channel in flight_gap(flight, vehicle, WHOLE_FLIGHT_S).channels:
        other = searched[channel.name]
        np.testing.assert_array_equal(channel.t_s, other.t_s)
        np.testing.assert_allclose(channel.residual, other.residual, rtol=0, atol=1e-10)
        differ.append(np.abs(channel.residual - plain[channel.name].residual).max())
    assert max(differ) > 1e-3
