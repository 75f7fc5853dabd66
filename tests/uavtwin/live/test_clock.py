"""The aircraft's clock against one that was planted."""

import math

import numpy as np
import pytest

from uavtwin.live.datagrams import ClockWatch

BOOT_S = 1234.5


def watched(
    offset_s: float, ppm: float, jitter_s: float, delay_s: float, seed: int, sync: bool, s: float
) -> ClockWatch:
    """A watch over 100 messages a second and, where it is answered, two TIMESYNC."""
    rng, watch = np.random.default_rng(seed), ClockWatch()
    for k in range(round(100 * s)):
        ours = 5000.0 + 0.01 * k
        stamp_s = BOOT_S + 0.01 * k * (1 + 1e-6 * ppm)
        late = delay_s + jitter_s * rng.random()
        watch.came(stamp_s, ours + offset_s + late)
        if sync and k % 50 == 0:
            back = delay_s + jitter_s * rng.random()
            watch.answered(ours + offset_s - back, stamp_s, ours + offset_s + late)
    return watch


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(
    ("offset_s", "ppm", "jitter_s", "delay_s"),
    [(0.0, 0.0, 0.0, 0.0), (9e3, 20.0, 0.03, 0.0), (-5.0, -100.0, 0.05, 0.1)],
)
def test_offset_and_drift_with_timesync(
    offset_s: float, ppm: float, jitter_s: float, delay_s: float, seed: int
) -> None:
    """Half a minute of jitter: 2 ms, however long the way is."""
    watch = watched(offset_s, ppm, jitter_s, delay_s, seed, True, 30.0)
    found = watch.estimate()
    assert found is not None and found.source == "TIMESYNC"
    t = 0.01 * (round(100 * 30.0) - 1)
    true = 5000.0 + t + offset_s - (BOOT_S + t * (1 + 1e-6 * ppm))
    assert abs(found.offset_s - true) < 0.002
    assert abs(found.drift_ppm - ppm) < 1.0 + 3000 * jitter_s
    assert found.width_s >= 2 * delay_s - 1e-6


def test_without_timesync_the_shortest_delay_is_in_the_offset() -> None:
    found = watched(10.0, 20.0, 0.03, 0.005, 1, False, 60.0).estimate()
    assert found is not None and found.source == "arrivals" and math.isinf(found.width_s)
    true = 5000.0 + 59.99 + 10.0 - (BOOT_S + 59.99 * (1 + 20e-6))
    assert 0.004 < found.offset_s - true < 0.007
    assert abs(found.drift_ppm - 20.0) < 20.0


def test_a_short_time_says_nothing_of_the_drift() -> None:
    found = watched(0.0, 50.0, 0.01, 0.0, 1, False, 2.0).estimate()
    assert found is not None and math.isnan(found.drift_ppm)


def test_nothing_came() -> None:
    assert ClockWatch().estimate() is None


def test_what_is_old_is_forgotten() -> None:
    """A clock whose drift changes is followed."""
    watch = ClockWatch()
    for k in range(20_000):
        t = 0.01 * k
        watch.came(t, t + (100e-6 * t if t < 100 else 0.01 - 50e-6 * (t - 100)))
    found = watch.estimate()
    assert found is not None
    assert found.drift_ppm == pytest.approx(50.0, abs=1.0)
    assert len(watch._above) < 130
