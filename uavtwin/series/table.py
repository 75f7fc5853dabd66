"""Series of a result: columns over time of one flight, what they are called and what they mean.

A column is SIDE.CHANNEL: `measured.acc_x`, `twin.acc_x`, `residual.acc_x`. Columns may be sampled
at times of their own; the table has a row for every time of any of them, NaN where a column has no
sample there. Times are the same if they are the same in nanoseconds.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from twin.logs.airframe import Place
from twin.representation import short_repr

Array = NDArray[np.float64]
NS = 1_000_000_000
"""Nanoseconds in a second."""
BLOCK_ROWS = 1 << 16
"""Rows that are put together at a time."""
MEASURED, TWIN, EXPLAINED, CORRECTED, DRAWN = (
    *("measured", "twin", "explained", "corrected"),
    "drawn",
)
SPREAD, MODEL = "spread", "model"
SIDES: Mapping[str, tuple[str, str]] = {
    MEASURED: ("gap, explain, evaluate", "of the flight, filtered as the twin's"),
    TWIN: ("gap, explain, evaluate", "of the vehicle that was given, on the flight's commands"),
    EXPLAINED: ("explain, evaluate", "of the vehicle with the named effects"),
    CORRECTED: ("evaluate", "of the twin with the compensator, or with the learned force"),
    DRAWN: ("evaluate", "of the twin with one draw of a model of the protocol `generate`"),
    "residual": ("gap, explain, evaluate", "`measured` minus `twin`"),
    "residual_SIDE": (
        "explain, evaluate",
        "`measured` minus that side: `residual_explained.acc_x`",
    ),
    SPREAD: ("evaluate", "standard deviation that the compensator expects of `residual_corrected`"),
    MODEL: ("evaluate", "`anomaly`: above 1 rarely; `inside` the envelope of the training: 0 or 1"),
}
"""What stands before the point in the name of a column: verbs that write it, and its meaning."""


@dataclass(frozen=True, slots=True)
class Column:
    """One quantity over time.

    Attributes:
        name: SIDE.CHANNEL.
        unit: SI unit, as printed; "1" or "" where there is none.
        t_s: From the start of the record, s, increasing, shape (n,).
        values: In the unit, shape (n,).
        about: What a reader has to know besides.
    """

    name: str
    unit: str
    t_s: Array
    values: Array
    about: str = ""

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class Series:
    """Columns over time of one flight.

    Attributes:
        name: Of the flight.
        columns: Each name once; those sampled together share the array of their times.
        facts: What they were made of, as text.
        origin: From where positions are counted; None: not known.
    """

    name: str
    columns: tuple[Column, ...]
    facts: Mapping[str, str] = field(default_factory=dict)
    origin: Place | None = None

    __repr__ = short_repr

    @property
    def names(self) -> tuple[str, ...]:
        """Of the columns."""
        return tuple(c.name for c in self.columns)

    def blocks(self, rows: int = BLOCK_ROWS) -> Iterator[tuple[NDArray[np.int64], list[Array]]]:
        """The table, some rows at a time, so that a long flight is never there as a whole.

        Args:
            rows: At most so many.

        Yields:
            Times in ns, increasing, shape (n,), and the values of each column there, (n,) each.
        """
        grids = {id(c.t_s): nanoseconds(c.t_s) for c in self.columns}
        every = np.unique(np.concatenate([*grids.values(), np.zeros(0, dtype=np.int64)]))
        for first in range(0, len(every), rows):
            t_ns = every[first : first + rows]
            places = {}
            for key, grid in grids.items():
                a, b = np.searchsorted(grid, [t_ns[0], t_ns[-1] + 1])
                places[key] = slice(a, b), np.searchsorted(t_ns, grid[a:b])
            found = []
            for column in self.columns:
                there, place = places[id(column.t_s)]
                values = np.full(len(t_ns), np.nan)
                values[place] = column.values[there]
                found.append(values)
            yield t_ns, found


def nanoseconds(t_s: Array) -> NDArray[np.int64]:
    """Times in whole nanoseconds."""
    return np.rint(np.asarray(t_s, dtype=np.float64) * NS).astype(np.int64)


def residual_of(side: str) -> str:
    """What the residual of a side is called."""
    return "residual" if side == TWIN else f"residual_{side}"


def compared(
    channel: str,
    unit: str,
    t_s: Array,
    measured: Array,
    sides: Mapping[str, Array],
    about: str = "",
) -> Iterator[Column]:
    """Columns of one channel: measured, what each side says of it, and the residuals.

    Args:
        channel: Its name.
        unit: Of all of them.
        t_s: Shape (n,).
        measured: Shape (n,).
        sides: By name, shape (n,) each.
        about: As of `Column`.
    """
    yield Column(f"{MEASURED}.{channel}", unit, t_s, measured, about)
    for side, values in sides.items():
        yield Column(f"{side}.{channel}", unit, t_s, values, about)
    for side, values in sides.items():
        yield Column(f"{residual_of(side)}.{channel}", unit, t_s, measured - values, about)
