"""Time stamps of a ULog held against the order of its messages in the file.

The logger writes what it receives as it comes, so that the stamps of neighbours are of about the
same moment whatever their topic.
"""

import struct
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from .definitions import messages

_NEIGHBOURS = 101
_MANY = 0.2


def data_places(blob: bytes) -> dict[int, NDArray[np.int64]]:
    """Places of each subscription's samples among all samples of the file, by message id."""
    number = struct.Struct("<H").unpack_from
    ids = [
        number(blob, start)[0]
        for kind, start, end in messages(blob)
        if kind == ord("D") and end - start >= 2
    ]
    each = np.array(ids, dtype=np.int64)
    return {int(k): np.flatnonzero(each == k) for k in np.unique(each)}


def out_of_place(
    places: Sequence[NDArray[np.int64]], stamps_us: Iterable[NDArray[np.int64]]
) -> list[NDArray[np.int64]]:
    """How far each stamp is from the median of its neighbours in the file, us.

    Args:
        places: Per topic, where its samples stand in the file, each of shape (n,).
        stamps_us: Their stamps, each of the same shape.

    Returns:
        Per topic, shape (n,); positive: stamped later than what was written beside it.
    """
    if not places:
        return []
    stamps = list(stamps_us)
    place, stamp = np.concatenate(places), np.concatenate(stamps)
    owner = np.repeat(np.arange(len(places)), [len(p) for p in places])
    order = np.argsort(place, kind="stable")
    place, stamp, owner = place[order], stamp[order], owner[order]
    every = _clock(stamp)
    out = []
    for k, (own_place, own_stamp) in enumerate(zip(places, stamps, strict=True)):
        others = owner != k
        if len(own_place) > _MANY * len(place) and others.any():  # it would outvote the others
            clock = np.interp(own_place, place[others], _clock(stamp[others]))
        else:
            clock = np.interp(own_place, place, every)
        out.append(own_stamp - np.round(clock).astype(np.int64))
    return out


def _clock(stamp_us: NDArray[np.int64]) -> NDArray[np.float64]:
    """Median of each stamp and its neighbours, us."""
    return np.asarray(median_filter(stamp_us, _NEIGHBOURS, mode="nearest"), dtype=np.float64)
