"""Which logs a fleet has: files, patterns, and folders with all logs in them."""

import glob
import hashlib
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from twin.errors import LogError
from twin.logs.formats import FORMATS

from ..flights import counted_key, what_is_there

MOST_LOGS = 10_000_000


@dataclass(frozen=True, slots=True)
class Log:
    """One file.

    Attributes:
        path: Absolute.
        name: From the folder that all have in common.
        bytes: Its size.
        changed_ns: When it was changed last.
    """

    path: str
    name: str
    bytes: int
    changed_ns: int

    @property
    def job(self) -> int:
        """Number by which it is known again, 63 bits: other content has another one."""
        text = f"{self.path}\0{self.bytes}\0{self.changed_ns}"
        return job_number(text)


def job_number(text: str) -> int:
    """63 bits of a hash."""
    return int.from_bytes(hashlib.sha256(text.encode("utf-8", "surrogateescape")).digest()[:8]) >> 1


def found_logs(given: Sequence[str | Path]) -> list[Log]:
    """All logs of files, patterns and folders, by name, each once.

    Args:
        given: Of a folder those files, at any depth, that end as logs do.

    Raises:
        LogError: There are none where some should be.
    """
    paths = sorted({p for one in given for p in _of(str(one))}, key=counted_key)
    if not paths:
        raise LogError("fleet: no log is given.")
    if len(paths) > MOST_LOGS:
        raise LogError(f"fleet: {len(paths)} logs, at most {MOST_LOGS} are taken at once.")
    above = os.path.commonpath([os.path.dirname(p) for p in paths])
    found = []
    for path in paths:
        stat = os.stat(path)
        name = Path(os.path.relpath(path, above)).as_posix()
        found.append(Log(path, name, stat.st_size, stat.st_mtime_ns))
    return found


def _of(text: str) -> Iterator[str]:
    """Absolute paths that are meant."""
    if os.path.isdir(text):
        suffixes = {s for f in FORMATS for s in f.suffixes}
        inside = [
            os.path.join(folder, name)
            for folder, _, names in os.walk(text)
            for name in names
            if os.path.splitext(name)[1].lower() in suffixes and not name.startswith(".")
        ]
        if not inside:
            raise LogError(
                f"{text}: the folder holds no logs. Files that end in "
                f"{', '.join(sorted(suffixes))} are looked for."
            )
    elif os.path.isfile(text) or not glob.has_magic(text):
        if not os.path.exists(text):
            raise LogError(f"{text}: there is no such file. {what_is_there(Path(text))}")
        inside = [text]
    else:
        inside = [p for p in glob.glob(text, recursive=True) if os.path.isfile(p)]
        if not inside:
            raise LogError(f"{text}: no log matches this pattern. {what_is_there(Path(text))}")
    yield from (os.path.abspath(p) for p in inside)
