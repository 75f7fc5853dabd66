"""Readings of a slow log on the grid."""

import numpy as np
import pytest

from twin.residuals.channels import (
    BAND_HZ,
    GRID_HZ,
    mean_over_step,
    measured,
    on_grid,
    rate_over_step,
)
from twin.residuals.measured import Signal

T_S = np.arange(6000, dtype=np.float64) / GRID_HZ


@pytest.mark.parametrize("rate_hz", [10.0, 25.0, 100.0])
@pytest.mark.parametrize("is_rate", [False, True])
def test_a_slow_log_shows_the_whole_of_a_signal_in_its_band(rate_hz: float, is_rate: bool) -> None:
    """Between samples there is no loss that a smaller scale of the sensor would explain."""
    omega = 2 * np.pi * np.linspace(0.02, 0.2, 10) * min(rate_hz, 25.0)
    phase = np.arange(10.0) ** 2
    stamps = np.arange(0.0, T_S[-1], 1 / rate_hz)
    reads = np.sin(stamps[:, None] * omega + phase).sum(axis=1, keepdims=True)
    truth = np.sin(T_S[:, None] * omega + phase).sum(axis=1, keepdims=True)
    values = on_grid(Signal(stamps, reads), T_S)
    if is_rate:
        change = (omega * np.cos(T_S[:, None] * omega + phase)).sum(axis=1, keepdims=True)
        values, truth = rate_over_step(values), mean_over_step(change)
    band, known = min(BAND_HZ, 0.35 * rate_hz), np.ones(len(T_S), dtype=bool)
    found = measured(("x",), "1", T_S, values, known, band, None, rate_hz / 2)
    assert found is not None
    shown, predicted = found.values[:, 0], found.predicted(truth)[:, 0]
    assert shown @ predicted / (predicted @ predicted) == pytest.approx(1.0, abs=0.005)


def test_two_samples_that_all_but_coincide_do_not_swing() -> None:
    stamps = np.sort(np.append(np.arange(0.0, T_S[-1], 0.01), [5.000001, 7.0001]))
    reads = np.random.default_rng(1).standard_normal((len(stamps), 1))
    values = on_grid(Signal(stamps, reads), T_S)
    assert np.nanmax(np.abs(values)) < 1.2 * np.max(np.abs(reads))
