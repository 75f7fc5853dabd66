"""The slow part of the accelerometer residuals, and what no curve explains of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from ...frames import to_body
from ...logs.columns import ACC
from ...residuals.aligned import AlignedFlight
from ...residuals.channels import CHANNEL_HZ, GRID_HZ, ChannelData
from ..settings import DEFAULT, SlowForceSettings
from .spectral import Piece, cells_of, level

Array = NDArray[np.float64]
SLOW_HZ = 10.0
"""Rate of the slow part."""
RIDGES = (1e-3, 1e-2, 1e-1, 1.0, 10.0)
"""Variance of a coefficient's prior in units of noise over one sample, tried in turn."""


@dataclass(frozen=True, slots=True)
class Slow:
    """Slow part of the accelerometer residuals of one piece of flight.

    Attributes:
        t_s: Shape (n,), at `SLOW_HZ`.
        residual: m/s2, shape (n, 3).
        features: What may explain it, per axis, shape (n, 3, k).
        drag: Answer to north, east and down wind, 1/s, shape (n, 3, 3); empty without any.
        speed_m_s: Of the vehicle, shape (n,).
        floor: Density of the white floor per axis, (m/s2)^2/Hz, shape (3,).
    """

    t_s: Array
    residual: Array
    features: Array
    drag: Array
    speed_m_s: Array
    floor: Array


def slow_parts(
    aligned: AlignedFlight,
    channels: Sequence[ChannelData],
    winds: Sequence[int],
    settings: SlowForceSettings = DEFAULT.stochastic.slow_force,
) -> list[Slow]:
    """Slow parts of one flight.

    Args:
        twin: The flight on its grid.
        channels: Its channels, with slopes.
        winds: Columns of the slopes that answer to the steady wind: north, east, down.
        settings: Which part is slow.
    """
    acc = [c for c in channels if c.name in ACC]
    motion = aligned.motion
    if len(acc) < 3 or motion.velocity is None or motion.attitude is None:
        return []
    found = []
    every = round(CHANNEL_HZ / SLOW_HZ)
    sos = butter(2, settings.band_hz, "bandpass", fs=CHANNEL_HZ, output="sos")
    spin, force = aligned.predicted("spin_", "specific_force_")
    for k in np.unique(acc[0].piece):
        rows = np.flatnonzero(acc[0].piece == k)
        if len(rows) < (settings.window_s + 1) * CHANNEL_HZ:
            continue
        t = acc[0].t_s[rows]
        residual = np.stack([c.residual[rows] for c in acc], axis=-1)
        slopes = np.stack([c.slopes[rows] for c in acc], axis=1)  # (n, 3, k)
        at = np.rint((t - aligned.inputs.t_s[0]) * GRID_HZ).astype(np.intp)
        curves = _curves(aligned, at, spin, force)  # (n, c)
        features = np.concatenate([slopes, np.repeat(curves[:, None, :], 3, axis=1)], axis=2)
        speed = np.linalg.norm(motion.velocity.at(t), axis=1)
        found.append(
            Slow(
                t[::every],
                sosfiltfilt(sos, residual, axis=0)[::every],
                sosfiltfilt(sos, features, axis=0)[::every],
                slopes[::every][:, :, list(winds)],
                speed[::every],
                _floor(t, residual, settings),
            )
        )
    return found


def _curves(aligned: AlignedFlight, at: NDArray[np.intp], spin: Array, force: Array) -> Array:
    """Speed, thrust and turning, and products of them, shape (n, c)."""
    assert aligned.motion.velocity is not None
    column = {s.name: i for i, s in enumerate(aligned.airframe.states)}
    q, v, w = (
        aligned.states[at][:, [column[n] for n in names]]
        for names in (
            [f"q_{a}" for a in "wxyz"],
            [f"vel_{a}" for a in "xyz"],
            [f"omega_{a}" for a in "xyz"],
        )
    )
    body = np.stack(to_body(list(q.T), list(v.T)), axis=-1)
    size = np.linalg.norm(body, axis=1, keepdims=True)
    thrust = force[at][:, 2:]
    load = spin[at] ** 2
    height = np.exp(aligned.states[at][:, [column["pos_z"]]])
    return np.concatenate(
        [
            body,
            np.abs(body),
            size * body,
            size**2 * body,
            thrust * body,
            load,
            w,
            np.abs(w),
            body * np.roll(w, 1, axis=1),
            body * np.roll(w, 2, axis=1),
            height,
        ],
        axis=1,
    )


def _floor(t_s: Array, residual: Array, settings: SlowForceSettings) -> Array:
    """White floor of the channels per axis, from where nothing else is, shape (3,)."""
    c = cells_of(Piece(t_s, residual), CHANNEL_HZ, settings.window_s, "hann")
    low, high = settings.floor_hz
    inside = (c.f_hz >= low) & (c.f_hz <= high)
    return level(c.power[:, :, inside], (0, 2))


def left_over(
    pieces: Sequence[Slow], settings: SlowForceSettings = DEFAULT.stochastic.slow_force
) -> list[Array]:
    """What a ridge regression, fitted on other blocks of time, leaves of each piece, (n, 3)."""
    blocks = [np.floor(p.t_s / settings.fold_s).astype(int) for p in pieces]
    fold = [(b + i) % settings.folds for i, b in enumerate(blocks)]
    folds = np.concatenate(fold)
    left = []
    for axis in range(3):
        y = np.concatenate([p.residual[:, axis] for p in pieces])
        x = np.nan_to_num(np.concatenate([p.features[:, axis] for p in pieces]))
        size = np.sqrt(np.mean(x * x, axis=0))
        x = x[:, size > 1e-9 * max(float(size.max(initial=0.0)), 1e-9)]
        x = x / np.maximum(np.sqrt(np.mean(x * x, axis=0)), 1e-300)
        tries = [y]
        for ridge in RIDGES:
            out = np.array(y)
            for k in range(settings.folds):
                test, train = folds == k, folds != k
                gram = x[train].T @ x[train] + ridge * train.sum() * 1e-2 * np.eye(x.shape[1])
                out[test] -= x[test] @ np.linalg.solve(gram, x[train].T @ y[train])
            tries.append(out)
        left.append(min(tries, key=lambda e: float(np.median(e * e))))
    rest = np.stack(left, axis=-1)
    return np.split(rest, np.cumsum([len(p.t_s) for p in pieces])[:-1])
