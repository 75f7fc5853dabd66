"""Residuals by frequency: sums per channel and band, from which any candidate model is evaluated.

The orthonormal discrete cosine transform (Ahmed, Natarajan & Rao, IEEE Trans. Computers C-23, 1974)
of each uninterrupted piece preserves sums of squares, and separates frequencies. The constant of a
flight is a band of its own, of one sample: it contains trims and day-to-day offsets.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from ...representation import ShortRepr
from ...residuals.channels import CHANNEL_HZ, Array, ChannelData

Flights = Sequence[Sequence[ChannelData]]
BANDS_HZ = np.array([0.0, 0.3, 0.8, 2.0, 4.5, 7.0, 10.0, 13.0, 16.0, 20.0, CHANNEL_HZ / 2 + 0.1])
"""Edges of the bands, Hz; the constant is separate."""
SHORTEST = 8
"""Least number of samples of a piece."""
OF_POSE, OF_POSE_HZ = "pose_", 10.0
"""Prefix of channels implied by a pose, and the frequency, Hz, up to which they count: above it
they contain noise aliased by decimation, see `POSE_PASSES` of `model.factors`."""
FORCE_CHANNELS = ("acc_", "gyro_rate_", "motion_acc_", "motion_rate_")
"""Prefixes of channels of specific force and of angular acceleration."""


@dataclass(frozen=True, slots=True)
class Rows(ShortRepr):
    """One channel of one flight after the transform.

    Attributes:
        band: Band of each row, shape (n,); 0: the constants, one per piece, weighted so that
            together they count as one sample.
        residual: Residual, shape (n,).
        active: Indices of the numbers that influence the channel, shape (m,).
        slopes: Slopes by these, shape (n, m).
    """

    band: NDArray[np.intp]
    residual: Array
    active: NDArray[np.intp]
    slopes: Array


@dataclass(frozen=True, slots=True)
class Spectrum(ShortRepr):
    """All channels of all flights, linearised at some values of the numbers.

    Attributes:
        channels: Names of the channels.
        rows: Rows per channel and flight.
        theta: Values of the numbers minus those of the nominal model, shape (k,).
        days: Day-to-day deviations of each flight, shape (flights, d).
        day_columns: Indices of the numbers with day-to-day variation, shape (d,).
    """

    channels: tuple[str, ...]
    rows: tuple[tuple[Rows, ...], ...]
    theta: Array
    days: Array
    day_columns: NDArray[np.intp]

    @classmethod
    def of(
        cls, flights: Flights, theta: Array, days: Array, day_columns: NDArray[np.intp]
    ) -> "Spectrum":
        """Transform channels with their slopes."""
        names = tuple(c.name for c in flights[0])
        rows = tuple(tuple(_rows(f[i]) for f in flights) for i in range(len(names)))
        return cls(names, rows, theta, days, day_columns)

    def _changed(
        self, change: Callable[[Rows, ChannelData], Rows], flights: Flights
    ) -> tuple[tuple[Rows, ...], ...]:
        """The rows, each changed by its channel."""
        return tuple(
            tuple(change(r, f[i]) for r, f in zip(own, flights, strict=True))
            for i, own in enumerate(self.rows)
        )

    def moved(self, flights: Flights, theta: Array, days: Array) -> "Spectrum":
        """The same slopes with residuals at other values."""

        def at(rows: Rows, channel: ChannelData) -> Rows:
            residual = transformed(channel, channel.residual[:, None])[0][:, 0]
            return replace(rows, residual=residual)

        return replace(self, rows=self._changed(at, flights), theta=theta, days=days)

    def renewed(self, flights: Flights, columns: NDArray[np.intp]) -> "Spectrum":
        """The same residuals with the slopes of some columns recomputed."""

        def again(rows: Rows, channel: ChannelData) -> Rows:
            full = np.zeros((len(rows.residual), len(self.theta)))
            full[:, rows.active] = rows.slopes
            full[:, columns] = transformed(channel, channel.slopes)[0]
            active = np.flatnonzero(np.any(full != 0, axis=0))
            return replace(rows, active=active, slopes=full[:, active])

        return replace(self, rows=self._changed(again, flights))

    def only(self, columns: NDArray[np.intp]) -> "Spectrum":
        """The spectrum with the slopes of some columns only."""
        rows = tuple(
            tuple(
                replace(r, active=r.active[keep], slopes=r.slopes[:, keep])
                for r in own
                for keep in [np.isin(r.active, columns)]
            )
            for own in self.rows
        )
        return replace(self, rows=rows)

    def extended(self, flights: Flights) -> "Spectrum":
        """The spectrum with additional columns, for numbers that are 0 here: all slopes of some
        channels."""
        k = len(self.theta) + np.arange(flights[0][0].slopes.shape[1])

        def wider(rows: Rows, channel: ChannelData) -> Rows:
            slopes = np.hstack([rows.slopes, transformed(channel, channel.slopes)[0]])
            return replace(rows, active=np.append(rows.active, k), slopes=slopes)

        rows = self._changed(wider, flights)
        return replace(self, rows=rows, theta=np.append(self.theta, 0.0 * k))

    def power(self) -> dict[tuple[int, int], tuple[float, int]]:
        """Sum of squares of the residual and number of rows, by channel and band."""
        found = {}
        for c, own in enumerate(self.rows):
            for b in range(len(BANDS_HZ)):
                inside = [r.residual[r.band == b] for r in own]
                if n := sum(map(len, inside)):
                    found[c, b] = sum(float(v @ v) for v in inside), n
        return found


def _rows(channel: ChannelData) -> Rows:
    both = np.column_stack([channel.residual, channel.slopes])
    values, band = transformed(channel, both)
    active = np.flatnonzero(np.any(values[:, 1:] != 0, axis=0))
    return Rows(band, values[:, 0], active, values[:, 1 + active])


def transformed(channel: ChannelData, values: Array) -> tuple[Array, NDArray[np.intp]]:
    """Transformed values of all long enough pieces of a channel, shape (n, m), and their bands, up
    to the Nyquist frequency of its logs; for channels implied by a pose, up to `OF_POSE_HZ`."""
    most_hz = min(channel.nyquist_hz, OF_POSE_HZ if channel.name.startswith(OF_POSE) else np.inf)
    out, bands = [], []
    ends = [0, *(np.flatnonzero(np.diff(channel.piece)) + 1).tolist(), len(channel.piece)]
    pieces = [slice(a, b) for a, b in pairwise(ends) if b - a >= SHORTEST]
    total = sum(p.stop - p.start for p in pieces)
    for p in pieces:
        part = values[p]
        some = np.any(part != 0, axis=0)
        band = _bands(len(part), most_hz)
        y = np.zeros((len(band), part.shape[1]))
        y[:, some] = dct(part[:, some], axis=0, norm="ortho")[: len(band)]
        y[0] /= np.sqrt(total)  # sqrt(n) for the mean, sqrt(n / total) for its share of the flight
        out.append(y)
        bands.append(band)
    if not out:
        return np.zeros((0, values.shape[1])), np.zeros(0, dtype=np.intp)
    return np.concatenate(out), np.concatenate(bands)


@lru_cache(maxsize=64)
def _bands(n: int, most_hz: float) -> NDArray[np.intp]:
    """Band of each frequency of a piece of n samples that is used."""
    hz = np.arange(n) * CHANNEL_HZ / 2 / n
    band = np.searchsorted(BANDS_HZ, hz, side="right")
    band[0] = 0
    return band[hz < most_hz]


def force_shares(
    spectrum: Spectrum, effects: Sequence[str], x: Array
) -> dict[str, tuple[float, str]]:
    """By effect, its largest share of the power of a force or moment channel, and the channel: one
    minus the ratio of the power with all effects to that without this one, in the linearisation. A
    constant, one row, has the power of all samples.

    Args:
        spectrum: Residuals with all effects, and slopes.
        effects: Effect of each slope column, shape (k,).
        x: Change of each of these numbers from the nominal model, shape (k,).
    """
    taken: dict[str, tuple[float, str]] = {}
    of = np.array(effects)
    for name, own in zip(spectrum.channels, spectrum.rows, strict=True):
        if not name.startswith(FORCE_CHANNELS):
            continue
        rows = [(r, np.where(r.band == 0, len(r.band), 1)) for r in own]
        left = sum(float(n @ r.residual**2) for r, n in rows)
        for effect in dict.fromkeys(effects):
            without = 0.0
            for r, n in rows:
                mine = r.active[of[r.active] == effect]
                row = r.residual + r.slopes[:, np.isin(r.active, mine)] @ x[mine]
                without += float(n @ row**2)
            share = max(0.0, 1 - left / without) if without > 0 else 0.0
            if share > taken.get(effect, (0.0, ""))[0]:
                taken[effect] = share, name
    return taken
