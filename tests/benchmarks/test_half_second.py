"""Half a second alone: what is compared, and a planted moment of the air."""

import numpy as np
import pytest

from benchmarks import half_second
from twin.residuals.short_horizon import READ
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import fly


def test_what_goes_straight_on_is_where_the_last_motion_has_it() -> None:
    start = np.zeros((1, len(READ)))
    start[0, READ.index("vel_x")], start[0, READ.index("q_w")] = 2.0, 1.0
    end = half_second.last_motion(start)
    assert end[0, READ.index("pos_x")] == 2.0 * half_second.HORIZON_S
    end[0, [READ.index("pos_y"), READ.index("pos_z")]] = 3.0, 4.0
    end[0, [READ.index("q_w"), READ.index("q_x")]] = np.cos(0.1), np.sin(0.1)
    away = half_second.off(end, start)
    assert away[0] == pytest.approx([np.sqrt(1.0 + 25.0), 0.0, 0.2, 0.0])
    assert half_second.rms(np.array([[3.0], [4.0]])) == pytest.approx(np.sqrt(12.5))


@pytest.mark.slow
def test_a_planted_moment_of_the_air_is_told_and_halves_what_a_twin_is_off() -> None:
    vehicle = load_vehicle("copter_default")
    k = 0.03 * vehicle.mass_kg * vehicle.gravity_m_s2 * vehicle.arm_m
    plant = vehicle.with_effects({"flapping_moment": {"k_n_s": k}})
    values = half_second.fitted([fly(vehicle, plant, 1)], vehicle)
    assert values["flapping_moment.k_n_s"] == pytest.approx(k, rel=0.1)
    rows = dict(half_second.scores(fly(vehicle, plant, 2), vehicle, values))
    assert rows["with it"][0] < 0.5 * rows["without the moment of the air"][0]
    assert rows["with it"][0] < rows["last motion"][0] < rows["last reading"][0]
