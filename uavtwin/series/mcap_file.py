"""MCAP files of JSON messages, as Foxglove and PlotJuggler read them.

Needs the package `mcap`, imported where a file is written. Format: https://mcap.dev/spec. The same
messages give the same bytes with the same versions of `mcap` and `zstandard`.
"""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twin.errors import TwinError, install_command

from .table import NS

if TYPE_CHECKING:
    from mcap.writer import Writer

Schema = dict[str, Any]


def check_mcap() -> None:
    """Refuse to write MCAP where it cannot be, before anything long is done.

    Raises:
        TwinError: The package is not installed; the text says how to install it.
    """
    _writer()


def _writer() -> "type[Writer]":
    """The class that writes.

    Raises:
        TwinError: It is not installed.
    """
    try:
        from mcap.writer import Writer
    except ModuleNotFoundError as error:
        raise TwinError(
            f"{error.name} is not installed; MCAP needs it: {install_command('mcap')}. Parquet and "
            f"CSV need nothing."
        ) from error
    return Writer


class McapFile:
    """Topics and messages of one file, written as they come."""

    def __init__(self, file: IO[bytes]) -> None:
        """Begin a file; `mcap_file` ends it."""
        self._file = _writer()(file)
        self._schemas: dict[str, int] = {}
        self._topics: dict[str, int] = {}
        self._counts: dict[str, int] = {}
        self._file.start(profile="", library="uavtwin")

    def topic(self, name: str, schema: Schema) -> None:
        """Declare a topic.

        Args:
            name: Begins with "/".
            schema: JSON schema of its messages; its `title` is the name by which tools know it.
        """
        title = schema["title"]
        if title not in self._schemas:
            data = _json(schema)
            self._schemas[title] = self._file.register_schema(title, "jsonschema", data)
        self._topics[name] = self._file.register_channel(name, "json", self._schemas[title])
        self._counts[name] = 0

    def write(self, topic: str, t_ns: int, message: Mapping[str, Any]) -> None:
        """Write a message.

        Args:
            topic: Declared before.
            t_ns: Time of the log and of publishing, from the start of the record.
            message: Fits the schema; every number finite.
        """
        data = _json(message)
        count = self._counts[topic]
        self._file.add_message(self._topics[topic], t_ns, data, t_ns, count)
        self._counts[topic] = count + 1

    def note(self, name: str, texts: Mapping[str, str]) -> None:
        """Write a record of metadata."""
        self._file.add_metadata(name, dict(texts))

    def end(self) -> None:
        """Write the index."""
        self._file.finish()  # type: ignore[no-untyped-call]


def _json(content: Mapping[str, Any]) -> bytes:
    text = json.dumps(content, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return text.encode("utf-8", "backslashreplace")


@contextmanager
def mcap_file(path: Path) -> Iterator[McapFile]:
    """A file that is whole at the end.

    Args:
        path: An existing one is replaced.

    Raises:
        TwinError: The package `mcap` is not installed.
    """
    _writer()
    with path.open("wb") as file:
        written = McapFile(file)
        yield written
        written.end()


def timestamp(t_ns: int) -> dict[str, int]:
    """A time as a message has it."""
    return {"sec": t_ns // NS, "nsec": t_ns % NS}


def check_times(name: str, first_ns: int) -> None:
    """Refuse times that MCAP has no room for.

    Raises:
        TwinError: One is negative.
    """
    if first_ns < 0:
        raise TwinError(
            f"{name}: begins {-first_ns / NS:g} s before the start of its record; times of MCAP "
            "are not negative. Write .parquet or .csv, or let `time` begin at 0."
        )


def plot_schema(title: str, units: Mapping[str, str]) -> Schema:
    """Schema of messages of plain numbers, each left out where it has no sample.

    Args:
        title: Of the schema.
        units: By field.
    """
    fields = {name: {"type": "number", "description": unit} for name, unit in units.items()}
    return {"title": title, "type": "object", "properties": fields, "additionalProperties": False}


class PlotTopics:
    """Topics of plain numbers: columns that go together in one message where they are sampled."""

    def __init__(self, file: McapFile, topics: Mapping[str, Mapping[str, tuple[str, str]]]) -> None:
        """Declare them.

        Args:
            file: To write into.
            topics: Fields by topic: by column, the name of its field and its unit.
        """
        self._file, self._topics = file, topics
        for topic, fields in topics.items():
            units = dict(fields.values())
            file.topic(topic, plot_schema("uavtwin" + topic.replace("/", "."), units))

    def rows(
        self, columns: Mapping[str, NDArray[np.float64]]
    ) -> Iterator[list[tuple[str, dict[str, float]]]]:
        """Messages of some rows.

        Args:
            columns: Values by column, all of one length.

        Yields:
            Of each row, topics and messages; none where nothing is sampled.
        """
        parts = []
        for topic, fields in self._topics.items():
            values = np.column_stack([columns[c] for c in fields])
            known = np.isfinite(values)
            names = [name for name, _ in fields.values()]
            parts.append(
                (topic, names, values.tolist(), known.tolist(), np.any(known, axis=1).tolist())
            )
        for row in range(len(parts[0][2]) if parts else 0):
            found = []
            for topic, names, values, known, there in parts:
                if there[row]:
                    each = zip(names, values[row], known[row], strict=True)
                    found.append((topic, {n: v for n, v, ok in each if ok}))
            yield found
