"""Journal of the searches of `explain`: a run that was killed continues from this file."""

import hashlib
import json
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

import twin
from twin.explain.inference.search import Checkpoint, SearchPoint
from twin.explain.settings import DEFAULT, SearchSettings
from twin.topic_mapping import mapping_of

from .output import output_file, package_versions, sha256
from .vehicles import Vehicle

JOURNAL = "explain.part"
"""Name of the file."""


class _Content(msgspec.Struct, frozen=True):
    """Content of the journal file.

    Attributes:
        key: Key of the run that wrote it.
        points: State of each search that has started, as MessagePack.
    """

    key: str
    points: list[msgspec.Raw]


class ExplainJournal(Checkpoint):
    """The file of one run, rewritten after every move.

    Attributes:
        note: Whether the run is resumed or starts again, with the reason; "": there was no file.
    """

    def __init__(self, path: Path, key: str) -> None:
        """Read the file of an earlier run with the same key.

        Args:
            path: The journal file.
            key: Key of the run, see `run_key`.
        """
        self._path, self._key = path, key
        self._points: list[msgspec.Raw] = []
        self._search, self.note = 0, ""
        if path.is_file():
            self._read()

    def _read(self) -> None:
        """Take the points of the file, if they belong to this run."""
        try:
            content = msgspec.msgpack.decode(self._path.read_bytes(), type=_Content)
            if content.key != self._key:
                why = "is of other flights, vehicle, options or version"
                self.note = f"{self._path}: {why}; the search begins anew."
                return
            moves = sum(_point(p).moves for p in content.points)
        except (msgspec.MsgspecError, ValueError, TypeError) as error:
            self.note = f"{self._path}: is damaged ({error}); the search begins anew."
            return
        self._points = list(content.points)
        self.note = f"{self._path}: the search goes on, moves so far: {moves}."

    def resumed(self) -> SearchPoint | None:
        """State of a search that has started, as in `Checkpoint`."""
        self._search += 1
        known = len(self._points) >= self._search
        return _point(self._points[self._search - 1]) if known else None

    def keep(self, point: SearchPoint) -> SearchPoint:
        """Store the state of a search, as in `Checkpoint`. The point is returned as it was written:
        an interrupted run and an uninterrupted one continue with the same bits."""
        content = msgspec.Raw(msgspec.msgpack.encode(point, enc_hook=_packed))
        self._points[self._search - 1 :] = [content]
        with output_file(self._path) as file:
            file.write_bytes(msgspec.msgpack.encode(_Content(self._key, self._points)))
        return _point(content)

    def remove(self) -> None:
        """Delete the file at the end of the run."""
        self._path.unlink(missing_ok=True)


def run_key(
    flights: Iterable[Path],
    held: Iterable[Path],
    vehicle: Vehicle,
    options: Sequence[Any],
    settings: SearchSettings = DEFAULT,
) -> str:
    """Hash of all inputs of a run of `explain`.

    Args:
        flights: Logs to fit on.
        held: Logs held out.
        vehicle: The vehicle, unchanged.
        options: Other options of the call, as JSON.
        settings: Settings of the search.
    """
    logs = [[(p.stem, *map(sha256, _files(p))) for p in some] for some in (flights, held)]
    decides = [package_versions(), _sources_hash(), logs, vehicle.toml(), options, settings.hash]
    return hashlib.sha256(json.dumps(decides, sort_keys=True).encode()).hexdigest()


def _files(log: Path) -> list[Path]:
    """The files of a log: itself and the mapping of its topics, or those of its folder."""
    if log.is_dir():
        return sorted(p for p in log.rglob("*") if p.is_file())
    return [log, *filter(None, [mapping_of(log)])]


@cache
def _sources_hash() -> str:
    """Hash of the program's source: a checkout has many states with one version."""
    found, folder = hashlib.sha256(), Path(twin.__file__).parent
    for file in sorted(folder.rglob("*.py")):
        found.update(f"{file.relative_to(folder).as_posix()} {sha256(file)}\n".encode())
    return found.hexdigest()


def _point(content: msgspec.Raw) -> SearchPoint:
    """A point from its bytes.

    Raises:
        MsgspecError, ValueError, TypeError: The bytes are no point.
    """
    return msgspec.msgpack.decode(content, type=SearchPoint, dec_hook=_unpacked)


def _packed(value: Any) -> Any:
    """An array as type, shape, order and bytes; a number of numpy as one of Python.

    Raises:
        NotImplementedError: It is neither.
    """
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        order: Literal["F", "C"] = "F" if value.flags.fnc else "C"
        return value.dtype.str, value.shape, order, value.tobytes(order)
    raise NotImplementedError(f"{type(value).__name__} cannot be written.")


def _unpacked(_: Any, value: Any) -> Any:
    """An array from the result of `_packed`."""
    dtype, shape, order, content = value
    return np.frombuffer(content, dtype).reshape(shape, order=order).copy(order)
