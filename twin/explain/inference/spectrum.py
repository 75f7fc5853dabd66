"""Residuals by frequency: sums per channel and band, in which any set of numbers can be judged.

The orthonormal discrete cosine transform (Ahmed, Natarajan & Rao, IEEE Trans. Computers C-23, 1974)
of each uninterrupted piece keeps sums of squares, and parts what is slow from what is fast. The
constant of a flight is a band of its own, of one sample: what a trim or a day does.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from ...representation import short_repr
from ...residuals.channels import CHANNEL_HZ, Array, ChannelData

Flights = Sequence[Sequence[ChannelData]]
BANDS_HZ = np.array([0.0, 0.3, 0.8, 2.0, 4.5, 7.0, 10.0, 13.0, 16.0, 20.0, CHANNEL_HZ / 2 + 0.1])
"""Edges of the bands; the constant is apart."""
SHORTEST = 8
"""Samples of a piece at least."""
OF_POSE, OF_POSE_HZ = "pose_", 10.0
"""How channels begin of what a pose implies, and the frequency up to which they count: beyond it
they are noise that thinning out has mirrored, see `POSE_PASSES` of `model.factors`."""
FORCE_CHANNELS = ("acc_", "gyro_rate_", "motion_acc_", "motion_rate_")
"""How channels of specific force and of angular acceleration begin."""


@dataclass(frozen=True, slots=True)
class Rows:
    """One channel of one flight, transformed.

    Attributes:
        band: Of each row, shape (n,); 0: the constants, one per piece, weighted so that all of
            them count as one sample.
        residual: Shape (n,).
        active: Columns that the channel answers to, shape (m,).
        slopes: Of these, shape (n, m).
    """

    band: NDArray[np.intp]
    residual: Array
    active: NDArray[np.intp]
    slopes: Array

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class Spectrum:
    """All channels of all flights about some values of the numbers.

    Attributes:
        channels: Names.
        rows: Per channel, per flight.
        theta: Values of the numbers less those of the model as it stands, shape (k,).
        days: Of each flight beyond these, shape (flights, d).
        day_columns: Which numbers these are of, shape (d,).
    """

    channels: tuple[str, ...]
    rows: tuple[tuple[Rows, ...], ...]
    theta: Array
    days: Array
    day_columns: NDArray[np.intp]

    __repr__ = short_repr

    @classmethod
    def of(
        cls, flights: Flights, theta: Array, days: Array, day_columns: NDArray[np.intp]
    ) -> "Spectrum":
        """Transform channels with their slopes."""
        names = tuple(c.name for c in flights[0])
        rows = tuple(tuple(_rows(f[i]) for f in flights) for i in range(len(names)))
        return cls(names, rows, theta, days, day_columns)

    def moved(self, flights: Flights, theta: Array, days: Array) -> "Spectrum":
        """The same slopes with residuals taken elsewhere."""
        rows = tuple(
            tuple(
                replace(r, residual=transformed(f[i], f[i].residual[:, None])[0][:, 0])
                for r, f in zip(own, flights, strict=True)
            )
            for i, own in enumerate(self.rows)
        )
        return replace(self, rows=rows, theta=theta, days=days)

    def renewed(self, flights: Flights, columns: NDArray[np.intp]) -> "Spectrum":
        """The same residuals with the slopes of some columns taken anew."""
        rows = tuple(
            tuple(
                _with_slopes(r, len(self.theta), columns, transformed(f[i], f[i].slopes)[0])
                for r, f in zip(own, flights, strict=True)
            )
            for i, own in enumerate(self.rows)
        )
        return replace(self, rows=rows)

    def only(self, columns: NDArray[np.intp]) -> "Spectrum":
        """The same with the slopes of some columns alone."""
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
        """The same with more columns, of numbers that are 0 here: all slopes of some channels."""
        k = len(self.theta) + np.arange(flights[0][0].slopes.shape[1])
        rows = tuple(
            tuple(
                replace(
                    r,
                    active=np.append(r.active, k),
                    slopes=np.hstack([r.slopes, transformed(f[i], f[i].slopes)[0]]),
                )
                for r, f in zip(own, flights, strict=True)
            )
            for i, own in enumerate(self.rows)
        )
        return replace(self, rows=rows, theta=np.append(self.theta, 0.0 * k))

    def power(self) -> dict[tuple[int, int], tuple[float, int]]:
        """Sum of squares of the residual and number of rows, by channel and band."""
        found = {}
        for c, own in enumerate(self.rows):
            for b in range(len(BANDS_HZ)):
                inside = [r.residual[r.band == b] for r in own]
                n = sum(map(len, inside))
                if n:
                    found[c, b] = sum(float(v @ v) for v in inside), n
        return found


def _rows(channel: ChannelData) -> Rows:
    both = np.column_stack([channel.residual, channel.slopes])
    values, band = transformed(channel, both)
    active = np.flatnonzero(np.any(values[:, 1:] != 0, axis=0))
    return Rows(band, values[:, 0], active, values[:, 1 + active])


def _with_slopes(rows: Rows, width: int, columns: NDArray[np.intp], slopes: Array) -> Rows:
    full = np.zeros((len(rows.residual), width))
    full[:, rows.active] = rows.slopes
    full[:, columns] = slopes
    active = np.flatnonzero(np.any(full != 0, axis=0))
    return replace(rows, active=active, slopes=full[:, active])


def transformed(channel: ChannelData, values: Array) -> tuple[Array, NDArray[np.intp]]:
    """Rows of all long enough pieces of a channel with values at its samples, shape (n, m), and
    their bands; of what a pose implies those up to `OF_POSE_HZ`."""
    out, bands = [], []
    ends = [0, *(np.flatnonzero(np.diff(channel.piece)) + 1).tolist(), len(channel.piece)]
    pieces = [slice(a, b) for a, b in pairwise(ends) if b - a >= SHORTEST]
    total = sum(p.stop - p.start for p in pieces)
    for p in pieces:
        part = values[p]
        some = np.any(part != 0, axis=0)
        band = _bands(len(part), channel.name.startswith(OF_POSE))
        y = np.zeros((len(band), part.shape[1]))
        y[:, some] = dct(part[:, some], axis=0, norm="ortho")[: len(band)]
        y[0] /= np.sqrt(total)  # sqrt(n) for the mean, sqrt(n / total) for its share of the flight
        out.append(y)
        bands.append(band)
    if not out:
        return np.zeros((0, values.shape[1])), np.zeros(0, dtype=np.intp)
    return np.concatenate(out), np.concatenate(bands)


@lru_cache(maxsize=64)
def _bands(n: int, of_pose: bool) -> NDArray[np.intp]:
    """Band of each frequency that counts of a piece of n samples."""
    hz = np.arange(n) * CHANNEL_HZ / 2 / n
    band = np.searchsorted(BANDS_HZ, hz, side="right")
    band[0] = 0
    return band[hz < (OF_POSE_HZ if of_pose else np.inf)]


def force_shares(
    spectrum: Spectrum, effects: Sequence[str], x: Array
) -> dict[str, tuple[float, str]]:
    """By effect, the largest share of the power of a force or moment channel that it takes, and the
    channel: one minus the power with all effects over that without this one, in the linearisation.
    A constant, one row, has the power of all samples.

    Args:
        spectrum: Residuals with all effects, and slopes.
        effects: Effect of each column of the slopes, shape (k,).
        x: Change of each of these numbers from the model as it stands, shape (k,).
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
