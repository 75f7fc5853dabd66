"""A flight in memory: the table of `docs/guide/flight_table.md` plus what its reader doubts."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..errors import LogError
from ..representation import short_repr
from .airframe import Airframe

Array = NDArray[np.float64]
Severity = Literal["info", "warning", "error"]


@dataclass(frozen=True, slots=True)
class Finding:
    """Something a reader counted, dropped, filled or doubts."""

    severity: Severity
    where: str
    message: str
    count: int = 1


@dataclass(frozen=True, slots=True)
class Site:
    """Where a flight took place, as far as it matters to the air around it.

    Attributes:
        indoors: Within walls: no wind, and a compass among metal.
        source: What says so.
    """

    indoors: bool
    source: str

    def __str__(self) -> str:
        return f"{'indoors' if self.indoors else 'outdoors'}: {self.source}"


@dataclass(frozen=True, slots=True)
class Flight:
    """One recorded flight on one clock, SI, NED, FRD, quaternions `[w, x, y, z]`.

    Attributes:
        name: Short name, usually the stem of the file.
        table: Flight table; `time` in s from 0, strictly increasing; NaN where a signal has no
            sample in that row. `phase` is a text column, "" where unknown.
        findings: What the reader counted or doubts, in the order of reading.
        facts: What the log says about itself (vehicle, firmware, rates, match of rebuilt
            commands), printable key by key.
        source: File it came from.
        site: Indoors or outdoors, and how that is known; None: not known.
        airframe: What the log says of the aircraft itself; None: nothing, as of flight tables.
    """

    name: str
    table: pd.DataFrame
    findings: tuple[Finding, ...] = ()
    facts: dict[str, str] = field(default_factory=dict)
    source: Path | None = None
    site: Site | None = None
    airframe: Airframe | None = None

    __repr__ = short_repr

    @property
    def indoors(self) -> bool | None:
        """Whether it flew within walls; None: not known."""
        return None if self.site is None else self.site.indoors

    @property
    def fingerprint(self) -> str:
        """Hash of all its numbers, whatever its file is called and however columns are ordered."""
        digest = hashlib.sha256()
        for column in sorted(self.table):
            values = self.table[column]
            digest.update(f"{column}\0".encode())
            if values.dtype.kind in "fiub":
                digest.update(values.to_numpy(dtype=np.float64).tobytes())
            else:
                digest.update("\0".join(values.astype(str)).encode())
        return digest.hexdigest()

    def has(self, *columns: str) -> bool:
        """Whether every column is there with at least one finite sample."""
        return all(c in self.table and bool(self.table[c].notna().any()) for c in columns)

    def signal(self, columns: Sequence[str]) -> tuple[Array, Array]:
        """Samples at the rows where all the columns are finite.

        Args:
            columns: Names of flight-table columns that are sampled together.

        Returns:
            Times in s, shape (n,), and values, shape (n, len(columns)).

        Raises:
            LogError: A column is missing or has no finite sample.
        """
        missing = [c for c in columns if not self.has(c)]
        if missing:
            raise LogError(
                f"{self.name}: no samples of {', '.join(missing)}. "
                f"The flight has: {', '.join(c for c in self.table if self.has(c))}."
            )
        rows = self.table[["time", *columns]].dropna().to_numpy(dtype=np.float64)
        return rows[:, 0], rows[:, 1:]
