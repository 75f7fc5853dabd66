"""What a hover says of a twin, from flights of a plant that differs from it by known numbers."""

import numpy as np
import pytest

from twin.residuals.flight_gap import means_of
from twin.residuals.gap import Channel
from twin.residuals.means import HoverMeans, hover_means
from twin.vehicle.file import load_vehicle
from uavtwin.demo.flights import Waypoints, fly
from uavtwin.report.hover import hover_sentence

HOVER: Waypoints = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 3.0, (0.0, 0.0, -1.5)),
    ("hover", 6.0, (0.0, 0.0, -1.5)),
)


@pytest.mark.slow
def test_weight_and_centre_of_mass_come_back() -> None:
    """A plant of 1.2 times the mass, its centre 11 mm further back and 5 mm further to the left."""
    vehicle = load_vehicle("copter_default")
    moved = {"cog_offset": {"x_m": -0.011, "y_m": -0.005, "z_m": 0.0}}
    plant = vehicle.with_mass(1.2 * vehicle.mass_kg).with_effects(moved)
    means = means_of(fly(vehicle, plant, 1, waypoints=HOVER), vehicle)
    assert means is not None
    assert means.carried == pytest.approx(1.2, abs=0.01)
    assert means.back_m == pytest.approx(0.011, abs=1e-3)
    assert means.right_m == pytest.approx(-0.005, abs=1e-3)
    text = hover_sentence("it", means)
    assert text.startswith("At the logged commands it carries 120 % of its weight, and turns as if")
    assert "mm further back and " in text
    assert text.endswith("mm further to the left.")


def test_means_need_two_seconds_of_hover() -> None:
    """Made: the twin pushes with 0.8 of what is felt, and rolls where the flight does not."""
    vehicle, t = load_vehicle("copter_default"), np.arange(0.0, 10.0, 0.02)
    phase = np.where(t < 4.0, "hover", "forward")

    def channel(name: str, measured: float, simulated: float, hover: str = "hover") -> Channel:
        flown, twin = np.full(len(t), measured), np.full(len(t), simulated)
        return Channel(name, "1", 0.0, t, flown, twin, np.where(phase == "hover", hover, phase))

    lift, roll = channel("acc_z", -9.8, -0.8 * 9.8), channel("gyro_rate_x", 0.0, 4.0)
    means = hover_means([lift, roll], vehicle)
    assert means is not None
    assert means.carried == pytest.approx(0.8)
    assert means.back_m is None
    # x 1 / 0.8, moment over weight, by hand
    assert means.right_m == pytest.approx(-0.0211 * 5.0 / (1.4 * 9.8), rel=1e-6)
    assert hover_means([channel("acc_z", -9.8, -9.8, "land")], vehicle) is None
    assert hover_means([roll], vehicle) is None


def test_small_numbers_are_not_said() -> None:
    text = hover_sentence("it", HoverMeans(1.004, 2e-4, -3e-4))
    assert text == "At the logged commands it carries 100 % of its weight."
