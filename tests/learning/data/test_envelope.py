"""The envelope: what is in it, what fades beyond, and what takes no part."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from learning.data.channels import CHANNELS
from learning.data.channels import FEATURE_CHANNELS as COLUMNS
from learning.data.envelope import (
    INSIDE,
    UNLIMITED,
    Envelope,
    linear_share,
    network_share,
)
from learning.data.scaling import place_names, places_of

Array = NDArray[np.float64]
SEEN = [CHANNELS[i] for i in COLUMNS]
RESERVE = np.full(3, 0.1)


def wandering(seed: int, n: int = 2000, centre: float = 0.0) -> Array:
    """Inputs of which two go together."""
    rng = np.random.default_rng(seed)
    free = rng.normal(size=(n, 3))
    return np.column_stack([free[:, 0], free[:, 0] + 0.1 * free[:, 1], free[:, 2]]) + centre


def test_a_flight_is_inside_as_far_as_it_was_said() -> None:
    """With the room that the next flight is expected to need: as much again, after one flight."""
    one = wandering(1)
    envelope = Envelope.of([one], RESERVE)
    assert np.mean(envelope.distance(one) <= 0.5) == pytest.approx(INSIDE, abs=1e-3)
    again = Envelope.of([one] * 10, RESERVE)
    assert np.mean(again.distance(one) <= 1 / 1.1) == pytest.approx(INSIDE, abs=1e-3)


def test_what_goes_together_is_far_where_it_does_not() -> None:
    """No box: each number is an everyday one."""
    envelope = Envelope.of([wandering(1)], RESERVE)
    along, across = envelope.distance(np.array([[1.5, 1.5, 0.0], [1.5, -1.5, 0.0]]))
    assert along < 1 < 5 * along < across


def test_flights_that_differ_reach_farther() -> None:
    alike = Envelope.of([wandering(1), wandering(2)], RESERVE)
    apart = Envelope.of([wandering(1), wandering(2, centre=3.0)], RESERVE)
    other = wandering(3, centre=4.0)
    assert apart.distance(other).mean() < 0.5 * alike.distance(other).mean()


def test_fast_turns_are_no_speed() -> None:
    """A vehicle that turned and stood still has not been to speeds, however fast it turned."""
    rng = np.random.default_rng(0)
    flights = [rng.normal(size=(2000, 3)) * [5.0, 0.002, 0.002] for _ in range(2)]
    envelope = Envelope.of(flights, RESERVE)
    turning, moving = envelope.distance(np.array([[9.0, 0.0, 0.0], [0.0, 0.5, 0.0]]))
    assert turning < 1 < 2 < moving


def test_where_one_flight_alone_has_been_is_reached_along_that_alone() -> None:
    """Turned in one flight of three: the others cannot know how far, and speed is what it was."""
    still = [wandering(k) * 0.1 for k in range(2)]
    turning = [*still, wandering(2) * 0.1 + [8.0, 8.0, 0.0]]
    before, after = Envelope.of(still, RESERVE), Envelope.of(turning, RESERVE)
    turn, speed = np.array([[8.0, 8.0, 0.0]]), np.array([[0.0, 0.0, 3.0]])
    assert before.distance(turn) > 10 and after.distance(turn) < 1
    assert after.distance(speed) > 0.5 * before.distance(speed) > 1


def test_what_training_never_knew_counts_for_nothing() -> None:
    blind = wandering(1)
    blind[:, 2] = np.nan
    envelope = Envelope.of([blind], RESERVE)
    assert envelope.scale[2] == UNLIMITED
    seen = wandering(2)
    np.testing.assert_allclose(envelope.distance(seen), envelope.distance(blind * 0 + seen), rtol=1)
    assert np.isfinite(envelope.distance(np.array([[0.0, 0.0, np.nan]]))).all()


def test_what_is_not_known_now_is_outside() -> None:
    envelope = Envelope.of([wandering(1)], RESERVE)
    assert np.isinf(envelope.distance(np.array([[np.nan, 0.0, 0.0]]))).all()


@given(d=st.floats(0, 10), step=st.floats(0, 0.01))
def test_nothing_fades_in_a_step(d: float, step: float) -> None:
    for share in (network_share, linear_share):
        before, after = share(np.array([d, d + step]))
        assert 0 <= before - after <= 2 * step + 1e-12
        assert (d > 1) or before == 1
        assert 0 <= after <= before <= 1
    assert network_share(np.array([d])) <= linear_share(np.array([d]))


@given(turn=st.floats(-3.0, 3.0), height=st.floats(-500, 500))
def test_neither_heading_nor_height_takes_part(turn: float, height: float) -> None:
    rng = np.random.default_rng(0)
    raw = rng.normal(size=(20, len(SEEN) + 4))
    turned = raw.copy()
    north, east = (SEEN.index(f"vel_{a}") for a in "xy")
    c, s = np.cos(turn), np.sin(turn)
    turned[:, north] = c * raw[:, north] - s * raw[:, east]
    turned[:, east] = s * raw[:, north] + c * raw[:, east]
    turned[:, [SEEN.index(f"mag_{a}") for a in "xyz"]] += 1.0
    turned[:, SEEN.index("pos_z")] += height
    names = place_names(4)
    assert places_of(raw).shape == (20, len(names))
    np.testing.assert_allclose(places_of(turned), places_of(raw), atol=1e-9)
