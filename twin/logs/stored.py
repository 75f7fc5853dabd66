"""Parquet files of users, and a long flight whose table stays in such a file."""

import hashlib
import io
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from ..errors import LogError
from ..representation import ShortRepr
from .columns import Columns, over
from .flight import Array, Flight, Notes, finite_rows, missing_signal

# -- opening a file -----------------------------------------------------------------------------
#
# The one way by which Parquet files of users are opened.
#
# pyarrow holds a footer in memory some ten times over, takes names that are not UTF-8, and raises
# exceptions of many kinds. Here a footer has a bound, and what cannot be read is a `LogError`.

_MAGIC = b"PAR1"  # first and last bytes of Parquet
_TAIL = 8  # bytes: length of the footer and magic
MOST_FOOTER = 16 << 20
"""Largest footer, bytes: 10,000 columns in 8 row groups take 8 MB."""
_MOST_TEXT = 4 << 20  # bytes of a text in a footer
_MOST_ENTRIES = 100_000
"""Largest number of entries of one text and one list in the footer."""


@contextmanager
def as_log_error(name: str) -> Iterator[None]:
    """Turn exceptions of pyarrow into a `LogError` that names the file."""
    try:
        yield
    except (pa.ArrowException, OSError, ValueError, KeyError, NotImplementedError) as error:
        reason = (
            "a column name is not UTF-8" if isinstance(error, UnicodeDecodeError) else str(error)
        )
        raise LogError(
            f"{name}: damaged Parquet file ({reason[:300]}). A Parquet file cut short cannot be "
            f"read at all: copy it again."
        ) from None


def opened(
    source: Path | bytes,
    name: str,
    as_dictionary: Sequence[str] = (),
    metadata: pq.FileMetaData | None = None,
) -> pq.ParquetFile:
    """Open a Parquet file; nothing but its footer is read.

    Args:
        source: The file, or its content.
        name: Name of the file, for errors.
        as_dictionary: Text columns in which each distinct value is held in memory once.
        metadata: Footer of the file, where it was read before.

    Raises:
        LogError: The file is damaged, or its footer is larger than that of any table of numbers.
    """
    if metadata is None:
        _check_footer(source, name)
    with as_log_error(name):
        # In this thread: one of pyarrow's that still runs when the interpreter ends aborts it,
        # 50 times in 360 short reads on a busy machine.
        file = pq.ParquetFile(
            io.BytesIO(source) if isinstance(source, bytes) else source,
            metadata=metadata,
            read_dictionary=list(as_dictionary) or None,
            pre_buffer=False,
            thrift_string_size_limit=_MOST_TEXT,
            thrift_container_size_limit=_MOST_ENTRIES,
        )
        _ = file.schema_arrow.names  # decodes them
    return file


def _check_footer(source: Path | bytes, name: str) -> None:
    """Refuse a footer out of bounds, before pyarrow takes memory for it.

    Raises:
        LogError: As in `opened`.
    """
    with as_log_error(name):
        if isinstance(source, bytes):
            tail, size = source[-_TAIL:], len(source)
        else:
            with source.open("rb") as file:
                size = file.seek(0, io.SEEK_END)
                file.seek(max(size - _TAIL, 0))
                tail = file.read(_TAIL)
    footer = int.from_bytes(tail[:4], "little")
    if tail[4:] == _MAGIC and footer > MOST_FOOTER:
        raise LogError(
            f"{name}: the footer of this Parquet file has {footer} of its {size} bytes; at most "
            f"{MOST_FOOTER} are read. Write the table again, without metadata and in row groups of "
            f"some 10,000 rows."
        )


# -- a flight that stays in its file ------------------------------------------------------------
#
# A long flight whose table stays in its file: columns, and rows of them, are read on demand,
# and nothing is stored but what had to be mended.

_BATCH = 1 << 16
"""Rows that are unpacked at a time."""
_CACHE_BYTES = 200_000_000
"""Size of the cache of recently read columns: neighbouring blocks of rows share a row group."""


class ParquetColumns(Columns):
    """Columns of numbers and the phase of a Parquet file, each read on demand."""

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        """Open a file; only its phase is read.

        Args:
            path: Parquet file.
            names: Columns: `phase` is text, all others are numbers.

        Raises:
            LogError: The file is damaged.
        """
        self._path, self._names = path, tuple(names)
        with opened(path, path.name) as file:
            self._metadata = file.metadata
        groups = range(self._metadata.num_row_groups)
        sizes = [self._metadata.row_group(g).num_rows for g in groups]
        self._edges = np.concatenate([[0], np.cumsum(sizes)]).astype(np.intp)
        self._cached: OrderedDict[tuple[int, str], Array] = OrderedDict()
        self.phase_codes, self.phase_names = self._phase()

    @property
    def rows(self) -> int:
        """Number of rows."""
        return int(self._edges[-1])

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in self:
            raise KeyError(name)
        if name == "phase":
            return self.phase_names[self.phase_codes]
        return self._unpacked(range(len(self._edges) - 1), name)

    def __iter__(self) -> Iterator[str]:
        yield from self._names
        yield "phase"

    def __len__(self) -> int:
        return len(self._names) + 1

    def __contains__(self, name: object) -> bool:
        return name == "phase" or name in self._names

    def part(self, name: str, first: int, end: int) -> NDArray[Any]:
        """Rows `first` to before `end` of a column."""
        if name == "phase":
            return self.phase_names[self.phase_codes[first:end]]
        found = np.empty(max(end - first, 0))
        for group in range(len(self._edges) - 1):
            a, b = max(first, self._edges[group]), min(end, self._edges[group + 1])
            if a < b:
                there = self._group(group, name)
                found[a - first : b - first] = there[a - self._edges[group] :][: b - a]
        return found

    def has_sample(self, name: str) -> bool:
        """Whether a column has a finite value."""
        batches = self._batches(range(len(self._edges) - 1), name)
        return any(np.isfinite(b.to_numpy(zero_copy_only=False)).any() for b in batches)

    def _group(self, group: int, name: str) -> Array:
        """A column in one row group; recently read ones stay in a cache."""
        key = group, name
        if key not in self._cached:
            self._cached[key] = self._unpacked(range(group, group + 1), name)
            cached = self._cached
            while len(cached) > 1 and sum(v.nbytes for v in cached.values()) > _CACHE_BYTES:
                cached.popitem(last=False)
        self._cached.move_to_end(key)
        return self._cached[key]

    def _unpacked(self, groups: range, name: str) -> Array:
        """A column in neighbouring row groups."""
        found = np.empty(int(self._edges[groups.stop] - self._edges[groups.start]))
        first = 0
        for batch in self._batches(groups, name):
            found[first : first + len(batch)] = batch.to_numpy(zero_copy_only=False)
            first += len(batch)
        return found

    def _phase(self) -> tuple[NDArray[np.int8], NDArray[np.object_]]:
        """Phase of each row as an index into a list of names, and the list."""
        codes, names = np.zeros(self.rows, dtype=np.int8), [""]
        if "phase" not in self._metadata.schema.to_arrow_schema().names:
            return codes, np.array(names, dtype=object)
        first = 0
        for batch in self._batches(range(len(self._edges) - 1), "phase"):
            code, kinds = pd.factorize(batch.to_pandas())
            words = [*map(str, kinds), ""]  # missing: code -1, the last
            names += [n for n in dict.fromkeys(words) if n not in names]
            if len(names) > np.iinfo(np.int8).max:
                raise LogError(f"{self._path.name}: {len(names)} kinds of phase.")
            place = np.array([names.index(n) for n in words], dtype=np.int8)
            codes[first : first + len(batch)] = place[code]
            first += len(batch)
        return codes, np.array(names, dtype=object)

    def _batches(self, groups: Sequence[int], name: str) -> Iterator[pa.Array]:
        """A column of some row groups, some thousand rows at a time."""
        name_of_file = self._path.name
        with opened(self._path, name_of_file, metadata=self._metadata) as file:
            batches = file.iter_batches(
                _BATCH, row_groups=list(groups), columns=[name], use_threads=False
            )
            while True:
                with as_log_error(name_of_file):
                    batch = next(batches, None)
                if batch is None:
                    return
                yield batch.column(0)


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class StoredFlight(Notes, ShortRepr):
    """One recorded flight as `Flight`, with its table in the file that it came from.

    Attributes:
        name: Short name, usually the stem of the file.
        stored: Columns as they are in the file.
        mended: Columns whose values were corrected and differ from those of the file.
        source: Path of the file.
        time_s: Times of the rows, s, strictly increasing, shape (n,).
        known: Columns with a finite sample.
    """

    name: str
    stored: ParquetColumns
    mended: dict[str, Array]
    source: Path
    time_s: Array
    known: frozenset[str]

    @property
    def columns(self) -> Columns:
        """The table by column, each read on demand."""
        return over({**self.mended, "time": self.time_s}, self.stored)

    @property
    def phase_codes(self) -> tuple[NDArray[np.int8], NDArray[np.object_]]:
        """Phase of each row as an index into a list of names, and the list."""
        return self.stored.phase_codes, self.stored.phase_names

    @property
    def fingerprint(self) -> str:
        """Hash of the file: files of equal content are the same flight."""
        with self.source.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def has(self, *columns: str) -> bool:
        """Whether the table has every column with at least one finite sample."""
        return self.known.issuperset(columns)

    def signal(self, columns: Sequence[str]) -> tuple[Array, Array]:
        """Samples at the rows where all the columns are finite, as in `Flight.signal`."""
        missing = [c for c in columns if not self.has(c)]
        if missing:
            raise missing_signal(self.name, missing, [c for c in self.columns if self.has(c)])
        return self._rows(columns, 0, len(self.time_s))

    def around(
        self, columns: Sequence[str], start_s: float, end_s: float
    ) -> tuple[Array, Array, int]:
        """Samples from two before a span of time to two after it, as far as available, and a row
        number before which there are none of them."""
        first, end = (int(i) for i in np.searchsorted(self.time_s, [start_s, end_s], side="right"))
        reach = 16
        while True:
            low, high = max(first - reach, 0), min(end + reach, len(self.time_s))
            t_s, values = self._rows(columns, low, high)
            before = low == 0 or np.count_nonzero(t_s <= start_s) >= 2
            after = high == len(self.time_s) or np.count_nonzero(t_s > end_s) >= 2
            if before and after:
                return t_s, values, low
            reach *= 8

    def rows_of(self, t_s: Array, first: int) -> NDArray[np.intp]:
        """Row numbers of times of this flight, `first` or later."""
        end = int(np.searchsorted(self.time_s, t_s[-1], side="right")) if len(t_s) else first
        return first + np.searchsorted(self.time_s[first:end], t_s)

    def between(self, start_s: float, end_s: float) -> Flight:
        """The part of the flight within a span of time, both ends included, in memory."""
        first = int(np.searchsorted(self.time_s, start_s, side="left"))
        end = int(np.searchsorted(self.time_s, end_s, side="right"))
        of_file = {c: None for c in (*self.stored, *self.mended) if c != "phase"}
        names = list(of_file)
        table: dict[str, Any] = {c: self._part(c, first, end) for c in names}
        table["phase"] = pd.Series(self.stored.part("phase", first, end), dtype=object)
        return Flight(self.name, pd.DataFrame(table, copy=False), self.source, **self.notes)

    def _rows(self, columns: Sequence[str], first: int, end: int) -> tuple[Array, Array]:
        """Times and values of the rows at which all columns are finite."""
        values = np.empty((end - first, len(columns)))
        for k, column in enumerate(columns):
            values[:, k] = self._part(column, first, end)
        return finite_rows(self.time_s[first:end], values)

    def _part(self, column: str, first: int, end: int) -> Array:
        """Rows of a column."""
        if column == "time":
            return self.time_s[first:end].copy()
        if column in self.mended:
            return self.mended[column][first:end].copy()
        if end - first == len(self.time_s):
            return self.stored[column]
        return self.stored.part(column, first, end)


AnyFlight = Flight | StoredFlight
"""A flight in memory, or in its file."""


def rows_before(flight: AnyFlight, t_s: Array) -> NDArray[np.intp]:
    """The last row of the table at or before each time."""
    rows = np.searchsorted(flight.time_s, t_s + 1e-9, side="right") - 1
    return np.asarray(np.maximum(rows, 0))


def phases_at(flight: AnyFlight, t_s: Array) -> NDArray[np.str_]:
    """Phase of flight at each time: that of the last row of the table at or before it, "" where the
    flight has none."""
    codes, names = flight.phase_codes
    return np.asarray(names.astype("<U8")[codes[rows_before(flight, t_s)]])
