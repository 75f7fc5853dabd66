"""Compiled libraries, cached with a hash of their content, only where nobody else may write.

An entry that is cut or was replaced does not fit its hash, counts as absent and is written again.
"""

import fcntl
import hashlib
import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import platformdirs

from twin.errors import FmuError
from twin.scratch import scratch_file

_HASH_BYTES = hashlib.sha256().digest_size


def cache_folder() -> Path:
    """Where compiled libraries are cached: `UAVTWIN_CACHE`, else the user's cache folder.

    Raises:
        FmuError: It cannot be made, it belongs to somebody else, or others may write into it.
    """
    folder = Path(os.environ.get("UAVTWIN_CACHE") or platformdirs.user_cache_dir("uavtwin"))
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.stat()
    except OSError as error:
        raise FmuError(
            f"{folder}: no folder for what was compiled: {error.strerror}. Set UAVTWIN_CACHE to "
            f"one that can be written."
        ) from error
    if found.st_uid != os.getuid():
        raise FmuError(
            f"{folder}: belongs to user {found.st_uid}, whose libraries would go into your FMUs. "
            f"Set UAVTWIN_CACHE to a folder of your own."
        )
    if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise FmuError(
            f"{folder}: others may write into it (mode {stat.S_IMODE(found.st_mode):o}), and their "
            f"libraries would go into your FMUs. chmod go-w {folder}, or set UAVTWIN_CACHE."
        )
    return folder


def cached(name: str) -> bytes | None:
    """What was cached under a name; None: nothing, or no longer what it was."""
    try:
        entry = (cache_folder() / name).read_bytes()
    except OSError:
        return None
    digest, content = entry[:_HASH_BYTES], entry[_HASH_BYTES:]
    return content if hashlib.sha256(content).digest() == digest else None


def cached_or_made(name: str, make: Callable[[], bytes]) -> bytes:
    """What was cached under a name, else what is made and cached now.

    Of several processes that want the same at once one makes it, and the others wait.
    """
    if (before := cached(name)) is not None:
        return before
    with _alone(name):
        if (meanwhile := cached(name)) is not None:
            return meanwhile
        content = make()
        store(name, content)
    return content


@contextmanager
def _alone(name: str) -> Iterator[None]:
    """While nobody else, another thread included, makes this.

    Names with the same first two letters share a lock, so that there are few files of them. A lock
    ends with its process, however that ends. Who holds one asks for no other.
    """
    folder = cache_folder() / "locks"
    folder.mkdir(mode=0o700, exist_ok=True)
    with open(folder / name[:2], "wb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def store(name: str, content: bytes) -> None:
    """Store content under a name; a reader finds all of it or nothing.

    Where it cannot be written, on a full disk, it is made again the next time.
    """
    with suppress(OSError), scratch_file(cache_folder() / name) as partial:
        partial.write_bytes(hashlib.sha256(content).digest() + content)
