"""The spectrogram of a gyroscope or accelerometer: power over time and frequency."""

from base64 import b64encode
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.logs import AnyFlight
from twin.logs.autopilot import Sensor
from twin.logs.columns import ACC, GYRO
from twin.representation import short_repr
from twin.residuals.measured import signal_of

Array = NDArray[np.float64]
COLUMNS, ROWS = 180, 96
"""Pixels along time and frequency, at most."""
SEGMENT_S = 1.28
"""Of a column: lines 1 Hz apart are told apart, a climb of the rotors is followed."""
LEAST_RATE_HZ = 20.0
"""Slower signals show no vibration."""
_KNOWN = 0.7
"""Share of the samples of a segment that have to be there."""
_LOWEST, _HIGHEST = 5.0, 99.9
"""Percentiles of the power between which colours are spread."""


@dataclass(frozen=True, slots=True)
class Spectrogram:
    """Power of the three axes of a sensor together.

    Attributes:
        sensor: Which.
        start_s: Time of the left edge.
        end_s: Time of the right edge.
        rate_hz: Of the samples; the upper edge is half of it.
        power_db: Power spectral density, dB over 1 unit^2/Hz, shape (rows, columns), from 0 Hz up;
            NaN where samples are missing.
    """

    sensor: Sensor
    start_s: float
    end_s: float
    rate_hz: float
    power_db: Array

    __repr__ = short_repr

    @property
    def top_hz(self) -> float:
        """Half of the sampling rate."""
        return 0.5 * self.rate_hz

    def content(self, columns: int = COLUMNS) -> dict[str, object]:
        """As a page holds it: a byte a cell, 0 where unknown, 1 to 255 from `low` to `high`.

        Args:
            columns: At most; the strongest of neighbours is kept.
        """
        known = self.power_db[np.isfinite(self.power_db)]
        low, high = (float(v) for v in np.percentile(known, [_LOWEST, _HIGHEST]))
        high = max(high, low + 1.0)
        share = np.clip((self.power_db - low) / (high - low), 0.0, 1.0)
        if share.shape[1] > columns:
            starts = np.arange(columns) * share.shape[1] // columns
            share = np.fmax.reduceat(share, starts, axis=1)
        cells = np.where(np.isfinite(share), 1 + np.round(254 * np.nan_to_num(share)), 0)
        rows, columns = share.shape
        return {
            **{"start": self.start_s, "end": self.end_s, "top": self.top_hz},
            **{"rows": rows, "columns": columns, "low": round(low, 1), "high": round(high, 1)},
            "cells": b64encode(cells.astype(np.uint8).tobytes()).decode("ascii"),
        }


def spectrogram(flight: AnyFlight) -> Spectrogram | None:
    """Spectrogram of the gyroscope, of the accelerometer where that is missing or slower by half.

    Each column is a segment of `SEGMENT_S` about its middle: Hann window, mean removed, samples
    laid on their median rate. Of a long flight they lie apart, so that a column is a sample of it.

    Args:
        flight: As read, or left in its file.

    Returns:
        None where it has neither at `LEAST_RATE_HZ` for ten segments.
    """
    sensors: tuple[tuple[Sensor, tuple[str, ...]], ...] = (("gyro", GYRO), ("acc", ACC))
    found = [
        (name, signal_of(flight, columns)) for name, columns in sensors if flight.has(*columns)
    ]
    found = [(name, s) for name, s in found if s.rate_hz >= LEAST_RATE_HZ]
    if not found:
        return None
    sensor, signal = found[0]
    if len(found) > 1 and found[1][1].rate_hz > 2.0 * signal.rate_hz:
        sensor, signal = found[1]
    rate_hz = signal.rate_hz
    start_s, end_s = float(flight.time_s[0]), float(flight.time_s[-1])
    n = max(16, round(SEGMENT_S * rate_hz))
    length_s = n / rate_hz
    if end_s - start_s < 10.0 * length_s:
        return None
    columns = min(COLUMNS, int((end_s - start_s) / (0.25 * length_s)))
    edges = np.linspace(start_s, end_s, columns + 1)
    window = np.hanning(n)
    scale = 2.0 / (rate_hz * float((window**2).sum()))
    power = np.full((n // 2, columns), np.nan)
    for k, middle in enumerate((edges[1:] + edges[:-1]) / 2.0):
        first = min(max(middle - 0.5 * length_s, start_s), end_s - length_s)
        near = signal.between(first, first + length_s)
        if len(near.t_s) < _KNOWN * n:
            continue
        grid = first + np.arange(n) / rate_hz
        total = np.zeros(n // 2)
        for axis in near.values.T:
            values = np.interp(grid, near.t_s, axis)
            spectrum = np.fft.rfft(window * (values - values.mean()))
            total += scale * np.abs(spectrum[1 : n // 2 + 1]) ** 2
        power[:, k] = total
    if not np.isfinite(power).any():
        return None
    with np.errstate(divide="ignore"):
        power_db = 10.0 * np.log10(np.maximum(_pooled(power), 1e-30))
    return Spectrogram(sensor, start_s, end_s, rate_hz, power_db)


def _pooled(power: Array) -> Array:
    """The largest of neighbouring frequencies, so that a line stays one."""
    every = -(-len(power) // ROWS)
    starts = np.arange(0, len(power), every)
    return np.asarray(np.maximum.reduceat(power, starts, axis=0))
