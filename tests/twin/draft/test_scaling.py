"""What is usual for an aircraft of some mass and size."""

import numpy as np
import pytest

from twin.draft import facts
from twin.vehicle.earth import normal_gravity_m_s2
from twin.vehicle.layouts import FRAMES, frame
from twin.vehicle_file import load_vehicle


def test_inertia_scales_with_mass_and_the_square_of_the_arm() -> None:
    one, sd = facts.usual_inertia(1.0, 0.2)
    assert facts.usual_inertia(2.0, 0.6)[0] == pytest.approx(18 * one)
    assert 0.2 < sd < 0.5
    assert one[2] < one[0] + one[1]


@pytest.mark.parametrize("body", facts.BODIES, ids=lambda b: b.source)
def test_published_bodies_lie_within_two_deviations(body: facts.PublishedBody) -> None:
    usual, sd = facts.usual_inertia(body.mass_kg, body.arm_m)
    off = np.abs(np.array(body.inertia_kg_m2) / usual - 1.0) / sd
    assert np.all(off < 2.0), off


def test_no_law_knows_the_aircraft_that_tests_a_draft() -> None:
    feisi = load_vehicle("feisi_x150")
    for body in facts.BODIES:
        assert body.mass_kg != feisi.mass_kg
        assert body.arm_m != pytest.approx(feisi.arm_m, rel=1e-3)


def test_propellers_of_more_rotors_are_smaller() -> None:
    four, six = (
        facts.usual_diameter_m(frame(name).sized(0.25, "given").position) for name in ("x", "hex x")
    )
    assert four.value == pytest.approx(0.28, abs=0.02)  # a frame of 500 mm takes 10 to 11 inches
    assert six.value == pytest.approx(four.value / np.sqrt(2), rel=1e-3)


def test_torque_over_thrust_is_that_of_a_measured_propeller() -> None:
    """APC Slow Flyer 10x4.7: 16.4 mm, of the UIUC data site."""
    told = facts.usual_torque_per_thrust_m(facts.Usual(4.7 * 0.0254, 0.0))
    assert told.value == pytest.approx(0.0164, rel=0.05)


@pytest.mark.parametrize("name", list(FRAMES))
def test_a_frame_can_be_flown(name: str) -> None:
    """Its rotors lift, roll, pitch and yaw, and equal ones turn it about no axis."""
    rotors = frame(name)
    x, y = rotors.position[:, 0], rotors.position[:, 1]
    effect = np.vstack([np.ones(rotors.count), -y, x, -rotors.direction])
    assert np.linalg.matrix_rank(effect) == 4
    assert effect[[1, 3]].sum(axis=1) == pytest.approx([0.0, 0.0], abs=1e-5)


def test_gravity_of_the_ellipsoid() -> None:
    """WGS 84 at the equator and at the poles, NIMA TR8350.2 table 3.4."""
    assert normal_gravity_m_s2(0.0, 0.0) == pytest.approx(9.7803253359, abs=1e-9)
    assert normal_gravity_m_s2(np.pi / 2, 0.0) == pytest.approx(9.8321849378, abs=1e-8)
    assert normal_gravity_m_s2(0.8, 1000.0) < normal_gravity_m_s2(0.8, 0.0) - 3e-3
