"""Statistics of a fleet against exact solutions, and against fleets in which nothing is planted."""

import numpy as np
import pytest
from scipy.stats import t as student

from uavtwin.fleets.statistics import DAYS, YEAR_D, adjusted, common_of, differing, trend_of


@pytest.mark.slow
def test_alike_aircraft_are_told_to_differ_as_seldom_as_said() -> None:
    """2000 fleets of 8: p of 5 % or less in 5 % of them at most, and not in far fewer."""
    rng, fleets = np.random.default_rng(1), 2000
    smallest = [differing(rng.standard_normal(8), np.zeros(8)).min() for _ in range(fleets)]
    rate = float(np.mean(np.array(smallest) <= 0.05))
    assert 0.02 < rate < 0.055, rate


def test_two_that_differ_do_not_hide_each_other() -> None:
    value = [1.0, 1.01, 0.99, 1.02, 0.98, 1.0, 1.01, 0.99, 1.5, 1.52]
    p = differing(value, np.zeros(10))
    assert (p[:8] > 0.05).all()
    assert (p[8:] < 1e-4).all()


def test_the_deviate_of_one_is_that_of_students_t() -> None:
    """One taken out of four: 4 times the two-sided probability of its studentised distance."""
    value = np.array([0.0, 1.0, 2.0, 9.0])
    rest = value[:3]
    t = (9.0 - rest.mean()) / np.sqrt(rest.var(ddof=1) * (1 + 1 / 3))
    assert differing(value, np.zeros(4))[3] == pytest.approx(4 * 2 * student.sf(t, 2))
    unsure = np.array([0.0, 0.0, 0.0, 100.0])  # known so badly that it may be anything
    assert differing(value, unsure)[3] > 0.5


def test_of_three_none_can_be_told() -> None:
    assert (differing([0.0, 0.0, 50.0], np.zeros(3)) == 1).all()


def test_a_slope_is_found_though_a_fifth_of_the_flights_is_nonsense() -> None:
    rng = np.random.default_rng(3)
    days = np.sort(rng.uniform(0, 60, 25))
    value = 0.03 + 0.01 * days / DAYS + 1e-3 * rng.standard_normal(25)
    value[::5] = rng.uniform(-1, 1, 5)
    found = trend_of(2026.0 + days / YEAR_D, value)
    assert found is not None
    assert found.low < 0.01 < found.high
    assert found.slope == pytest.approx(0.01, rel=0.15)
    assert found.p < 1e-3
    assert found.days == pytest.approx(np.ptp(days), rel=1e-6)


@pytest.mark.slow
def test_without_a_slope_the_probability_is_spread_evenly() -> None:
    rng = np.random.default_rng(4)
    p = [t.p for _ in range(500) if (t := trend_of(rng.random(12), rng.random(12))) is not None]
    assert len(p) == 500
    assert 0.02 < float(np.mean(np.array(p) <= 0.05)) < 0.08
    assert trend_of([2026.0] * 8, range(8)) is None  # all on one day
    assert trend_of(range(5), range(5)) is None  # too few


def test_of_many_tests_those_count_that_are_clear_among_so_many() -> None:
    assert adjusted([0.01] + [0.9] * 9)[0] == pytest.approx(0.1)  # 1 in 100, tried 10 times
    assert adjusted([0.01] * 10)[0] == pytest.approx(0.01)
    assert len(adjusted([])) == 0


def test_common_of_equally_known_values_is_the_analysis_of_variance() -> None:
    """All known to s: between = sample variance - s^2, mean of the plain mean."""
    y, s = np.array([1.0, 2.0, 4.0, 7.0]), 0.5
    found = common_of(y, np.full(4, s))
    assert found.mean == pytest.approx(y.mean())
    assert found.between**2 == pytest.approx(y.var(ddof=1) - s**2)
    assert found.sd == pytest.approx(np.sqrt(y.var(ddof=1) / 4))
    kept = found.between**2 / (found.between**2 + s**2)
    assert found.own == pytest.approx(y.mean() + kept * (y - y.mean()))
    half = student.ppf(0.975, 3) * found.sd
    assert (found.low, found.high) == pytest.approx((found.mean - half, found.mean + half))


def test_values_no_farther_apart_than_they_are_known_have_nothing_of_their_own() -> None:
    found = common_of([1.0, 1.1, 0.9], [0.5, 0.5, 0.5])
    assert found.between == 0
    assert found.own == pytest.approx([1.0, 1.0, 1.0])
    alone = common_of([3.0], [0.2])
    assert (alone.mean, alone.sd, alone.high) == (3.0, 0.2, np.inf)


def test_intervals_of_the_mean_hold_it_as_often_as_they_say() -> None:
    """600 fleets of 8 aircraft, known between 0.2 and 1 to a spread of 0.7."""
    rng, inside, closer = np.random.default_rng(6), 0, []
    for _ in range(600):
        sd = rng.uniform(0.2, 1.0, 8)
        true = 2.0 + 0.7 * rng.standard_normal(8)
        y = true + sd * rng.standard_normal(8)
        found = common_of(y, sd)
        inside += found.low <= 2.0 <= found.high
        closer.append(np.sum((found.own - true) ** 2) / np.sum((y - true) ** 2))
    assert 0.92 < inside / 600 < 0.98, inside
    assert float(np.mean(closer)) < 0.9  # drawn to the mean they are nearer to the truth
