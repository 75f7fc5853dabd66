"""The envelope: what is in it, what fades beyond, and what takes no part."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from learning.data.channels import CHANNELS, SENSORS
from learning.data.envelope import (
    INSIDE,
    UNLIMITED,
    Envelope,
    linear_share,
    network_share,
)
from learning.data.scaling import place_names, places_of

Array = NDArray[np.float64]
SEEN = [CHANNELS[i] for i in SENSORS.seen]
RESERVE = np.full(3, 0.1)


def wandering(seed: int, n: int = 2000, centre: float = 0.0) -> Array:
    """Inputs of which two go together."""
    rng = np.random.default_rng(seed)
    free = rng.normal(size=(n, 3))
    return np.column_stack([free[:, 0], free[:, 0] + 0.1 * free[:, 1], free[:, 2]]) + centre


def test_a_flight_is_inside_as_far_as_it_was_said() -> None:
    one = wandering(1)
    envelope = Envelope.of([one], RESERVE)
    assert np.mean(envelope.distance(one) <= 1) == pytest.approx(INSIDE, abs=1e-3)


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
    names = place_names(SENSORS, 4)
    assert places_of(raw, SENSORS).shape == (20, len(names))
    np.testing.assert_allclose(places_of(turned, SENSORS), places_of(raw, SENSORS), atol=1e-9)
