"""The one way by which Parquet files of users are opened.

pyarrow holds a footer in memory some ten times over, takes names that are not UTF-8, and raises
exceptions of many kinds. Here a footer has a bound, and what cannot be read is a `LogError`.
"""

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from ...errors import LogError

_MAGIC = b"PAR1"
_TAIL = 8
MOST_FOOTER = 16 << 20
"""Bytes: 10,000 columns in 8 row groups take 8 MB."""
_MOST_TEXT = 4 << 20
_MOST_ENTRIES = 100_000
"""Of one text and one list in the footer."""


@contextmanager
def damage_told(name: str) -> Iterator[None]:
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
        name: Of the file, for errors.
        as_dictionary: Columns of text of which each value is held once.
        metadata: Its footer, where it has been read before.

    Raises:
        LogError: It is damaged, or its footer is larger than that of any table of numbers.
    """
    if metadata is None:
        _check_footer(source, name)
    with damage_told(name):
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
        LogError: As of `opened`.
    """
    with damage_told(name):
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
            f"{MOST_FOOTER} are read. Write the table anew, without metadata and in row groups of "
            f"some 10,000 rows."
        )
