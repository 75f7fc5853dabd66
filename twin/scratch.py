"""Temporary files and folders whose leftovers are removed once their owner is proven dead.

A killed process leaves its unfinished files; the next writer in the same place removes them. Two
processes may share a folder without seeing each other: containers with separate PID namespaces,
machines on one network file system. So age and process number prove nothing; the kernel does. Each
scratch folder contains a file `lock` on which its owner has an exclusive flock(2) until the end,
which the kernel releases however the owner ends. The name identifies the owner:

    .uavtwin-HOST-BOOT-NAMESPACE-PID-START-RANDOM

A leftover of this boot is removed when its lock is free: one kernel manages the locks of all
namespaces. If its process is of this PID namespace, it must have ended as well. Everything else
remains:

- of another boot, of another machine or of this one before a restart: a lock of another
  kernel may be invisible here (NFS with `local_lock`, 9p, virtiofs);
- without a lock (not taken yet, or not supported by this file system), unless its process is of
  this PID namespace and has ended;
- a link, a file, a name of another form.

HOST is for human readers only. BOOT is the start of `/proc/sys/kernel/random/boot_id`, NAMESPACE
the inode of the PID namespace, START field 22 of `/proc/PID/stat`. The lock is taken before the
file gets its name: an owner between creating its folder and locking it has no file `lock`.
"""

import fcntl
import os
import platform
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PREFIX = ".uavtwin-"  # of all scratch folders
LOCK = "lock"
"""Name of the file in a scratch folder that its owner locks."""
_HOST = re.sub(r"[^A-Za-z0-9.]", "_", platform.node())[:16] or "host"
"""First 16 characters of the machine's name."""
_NAME = re.compile(
    rf"{re.escape(PREFIX)}[\w.]+-([0-9a-f]{{12}})-([0-9]+)-([0-9]+)-([0-9]+)-\w+", re.ASCII
)  # host, boot, process, its start, number
_UNKNOWN = "0" * 12
"""Boot identifier where the system has none: nothing is removed there."""


@contextmanager
def scratch_folder(place: Path) -> Iterator[Path]:
    """A new folder in `place`, removed at the end; leftovers there are removed first.

    It contains the file `lock`, which must not be changed.

    Raises:
        OSError: `place` cannot be written to.
    """
    sweep(place)
    folder = Path(tempfile.mkdtemp(prefix=_prefix(), dir=place))
    lock: int | None = None
    try:
        lock = _lock(folder)
        yield folder
    finally:
        _remove(folder, lock)


@contextmanager
def scratch_file(path: Path) -> Iterator[Path]:
    """A path of the same name in a scratch folder next to `path`.

    The file written there replaces `path` at the end, atomically, with permissions by the umask; on
    failure `path` is unchanged.

    Raises:
        OSError: The path cannot be written.
    """
    with scratch_folder(path.parent) as folder:
        inner = folder / "file"
        inner.mkdir()
        file = inner / path.name
        yield file
        file.chmod(0o666 & ~umask())
        file.replace(path)


def leftovers(place: Path) -> Iterator[Path]:
    """Scratch folders in `place` whose owner is proven dead, each locked during its use by the
    caller."""
    for found in sorted(place.glob(f"{PREFIX}*")):
        lock = _claimed(found)
        if lock is None:
            continue
        try:
            yield found
        finally:
            if lock >= 0:
                os.close(lock)


def sweep(place: Path) -> None:
    """Remove the leftovers in `place`."""
    for left in leftovers(place):
        _remove(left, None)


def started(process: int) -> int | None:
    """Start time of a process, in clock ticks since boot; None: there is no such process.

    Source: proc(5), /proc/PID/stat, field 22.
    """
    try:
        text = Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return None
    return int(text.rpartition(")")[2].split()[19])


def umask() -> int:
    """Umask of this process, which can only be read by setting it."""
    found = os.umask(0o077)
    os.umask(found)
    return found


def _prefix() -> str:
    pid = os.getpid()
    return f"{PREFIX}{_HOST}-{_boot()}-{_namespace()}-{pid}-{started(pid) or 0}-"


def _boot() -> str:
    """The first 48 bits of the boot id, which no two running kernels share."""
    try:
        text = Path("/proc/sys/kernel/random/boot_id").read_text()
    except OSError:
        return _UNKNOWN
    return text.replace("-", "")[:12]


def _namespace() -> int:
    """Inode of the PID namespace; 0 where there is none."""
    try:
        return os.stat("/proc/self/ns/pid").st_ino
    except OSError:
        return 0


def _lock(folder: Path) -> int | None:
    """Take the lock of a new folder; None where the file system has no locks.

    The file gets its name after it is locked.
    """
    handle, name = tempfile.mkstemp(prefix=f"{LOCK}-", dir=folder)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        return None
    os.rename(name, folder / LOCK)
    return handle


def _claimed(left: Path) -> int | None:
    """Lock of a folder whose owner is proven dead, -1 where it has none; None: another folder."""
    match = _NAME.fullmatch(left.name)
    if match is None or match[1] != _boot() or match[1] == _UNKNOWN:
        return None
    if left.is_symlink() or not left.is_dir():
        return None
    ours = int(match[2]) == _namespace()
    if ours and not _gone(int(match[3]), int(match[4])):
        return None
    try:
        lock = os.open(left / LOCK, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError:
        return -1 if ours else None
    except OSError:
        return None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(lock)
        return None
    return lock


def _gone(process: int, start: int) -> bool:
    """Whether a process of this namespace has ended; `/proc` may show another namespace's."""
    try:
        shown = os.readlink("/proc/self") == str(os.getpid())
    except OSError:
        return False
    return shown and started(process) != start


def _remove(folder: Path, lock: int | None) -> None:
    """Remove a folder, holding its lock until it is empty; on NFS an open file may keep a name."""
    shutil.rmtree(folder, ignore_errors=True)
    if lock is not None:
        os.close(lock)
        shutil.rmtree(folder, ignore_errors=True)
