"""Temporary files and folders whose names say whose they are, so that those of the dead are found.

A process that is killed leaves behind what it was writing. Whoever writes in the same place next
takes it away: by host, process and the time at which that process started, never by age.
"""

import os
import platform
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PREFIX = ".uavtwin-"
_HOST = re.sub(r"[^A-Za-z0-9.]", "_", platform.node())[:64] or "host"
_NAME = re.compile(rf"{re.escape(PREFIX + _HOST)}-([0-9]+)-([0-9]+)-\w+")


@contextmanager
def scratch_folder(place: Path) -> Iterator[Path]:
    """A folder in `place`, made after those of dead processes were taken away; gone at the end.

    Raises:
        OSError: Nothing can be written there.
    """
    sweep(place)
    with tempfile.TemporaryDirectory(
        prefix=_prefix(), dir=place, ignore_cleanup_errors=True
    ) as name:
        yield Path(name)


@contextmanager
def scratch_file(path: Path) -> Iterator[Path]:
    """A file beside `path` that takes its place at the end, at once and whole, if nothing failed.

    Raises:
        OSError: It cannot be written.
    """
    sweep(path.parent)
    handle, name = tempfile.mkstemp(prefix=_prefix(), dir=path.parent)
    os.close(handle)
    try:
        yield Path(name)
        os.chmod(name, 0o666 & ~umask())
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def leftovers(place: Path) -> Iterator[Path]:
    """What dead processes of this host left in a folder."""
    for found in place.glob(f"{PREFIX}*"):
        match = _NAME.fullmatch(found.name)
        if match is not None and started(int(match[1])) != int(match[2]):
            yield found


def sweep(place: Path) -> None:
    """Take away what dead processes of this host left in a folder."""
    for left in leftovers(place):
        if left.is_dir() and not left.is_symlink():
            shutil.rmtree(left, ignore_errors=True)
        else:
            left.unlink(missing_ok=True)


def started(process: int) -> int | None:
    """When a process started, in ticks since the machine did; None: there is none.

    Source: proc(5), /proc/PID/stat, field 22.
    """
    try:
        text = Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return None
    return int(text.rpartition(")")[2].split()[19])


def _prefix() -> str:
    return f"{PREFIX}{_HOST}-{os.getpid()}-{started(os.getpid())}-"


def umask() -> int:
    """Of this process, which cannot be read without being set."""
    found = os.umask(0o077)
    os.umask(found)
    return found
