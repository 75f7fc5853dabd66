"""Native FMUs: C source, one compiler call, one archive. Equal inputs give equal bytes.

Compiled libraries are cached with a hash of their content, only where no other user may write. A
truncated or replaced entry does not match its hash, counts as missing and is written again.
"""

import fcntl
import hashlib
import os
import re
import stat
import subprocess
import tempfile
import uuid
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from importlib import resources
from pathlib import Path

import platformdirs

from twin.errors import FmuError
from twin.scratch import scratch_file

from .archive import is_unsafe
from .description import build_description, model_description
from .documentation import documentation
from .model import FmuModel
from .names import shown
from .platforms import (
    DEFAULT,
    PLATFORMS,
    Compiler,
    Platform,
    compilers,
    select_platforms,
    universal_binary,
    without_link_time,
)
from .source import generated_sources

_HASH_BYTES = hashlib.sha256().digest_size  # at the start of a cache entry


def cache_folder() -> Path:
    """Folder for compiled libraries: `UAVTWIN_CACHE`, else in the user's cache folder.

    Raises:
        FmuError: It cannot be created, belongs to another user, or other users may write into it.
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
    """Cached content of a name; None: there is none, or it is damaged."""
    try:
        entry = (cache_folder() / name).read_bytes()
    except OSError:
        return None
    digest, content = entry[:_HASH_BYTES], entry[_HASH_BYTES:]
    return content if hashlib.sha256(content).digest() == digest else None


def cached_or_made(name: str, make: Callable[[], bytes]) -> bytes:
    """Cached content of a name, else newly made content, which is cached.

    Of several processes that need the same content at once one makes it, and the others wait.
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
    """Context with an exclusive lock on a name, across threads and processes.

    Names with the same first two letters share a lock, which limits the number of lock files. A
    lock ends with its process in any case. Its holder must not request another one.
    """
    folder = cache_folder() / "locks"
    folder.mkdir(mode=0o700, exist_ok=True)
    with open(folder / name[:2], "wb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def store(name: str, content: bytes) -> None:
    """Store content under a name atomically.

    If it cannot be written, on a full disk, it is made again the next time.
    """
    with suppress(OSError), scratch_file(cache_folder() / name) as partial:
        partial.write_bytes(hashlib.sha256(content).digest() + content)


CFLAGS = ("-std=c99", "-O3", "-ffp-contract=off", "-fno-math-errno", "-fPIC", "-fvisibility=hidden")
"""Flags without -ffast-math: results are bit-identical on every tested compiler."""

NAMESPACE = uuid.UUID("7f1f3f2e-8a4f-5d0b-9d57-0a1d1c7d6b55")  # of the FMUs' tokens; drawn once
_ENTRY = 3
"""Version of the format of cache entries."""
_INCLUDE = re.compile(r'^\s*#\s*include\s+"([^"]+)"', re.MULTILINE)
_HEADERS = {
    2: ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    3: ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
}  # of the FMI standard, by version


def build(model: FmuModel, path: Path, fmi: int = 2, platforms: Iterable[str] = DEFAULT) -> Path:
    """Build a co-simulation FMU with its sources inside.

    Args:
        model: Model of the FMU.
        path: File to write; its folder must exist.
        fmi: 2 or 3.
        platforms: Names from `fmus.platforms.PLATFORMS`, or `all`. linux64 alone is built by the
            machine's compiler, all others by zig (the extra `cross`).

    Returns:
        The path.

    Raises:
        FmuError: Unknown FMI version or platform, arrays in FMI 2, no compiler, or the compiler
            failed.
    """
    if fmi not in _HEADERS:
        raise FmuError(f"{model.name}: FMI {fmi} is not supported; choose 2 or 3.")
    if model.arrays and fmi != 3:
        raise FmuError(f"{model.name}: arrays are of FMI 3; FMI {fmi} has scalars alone.")
    chosen = select_platforms(platforms)
    sources = _sources(model, fmi)
    token = _token(model, fmi, sources)
    sources |= generated_sources(model, token)
    compiled = tuple(name for name in sorted(sources) if name.endswith(".c"))
    members = {
        "modelDescription.xml": model_description(model, fmi, token, compiled),
        **_binaries(model.name, fmi, chosen, sources, compiled),
        **{f"sources/{name}": text.encode() for name, text in sources.items()},
        **{f"resources/{name}": content for name, content in model.resources.items()},
        **documentation(model, fmi),
    }
    if fmi == 3:
        members["sources/buildDescription.xml"] = build_description(model, compiled)
    write_archive(path, members)
    return path


def _sources(model: FmuModel, fmi: int) -> dict[str, str]:
    """C files and headers of the FMU, without the token (which depends on the others)."""
    own = resources.files(__package__) / "c"
    headers = resources.files("fmpy") / "c-code"
    names = {"core.c", "core.h", "kernel.h", "noise.h", f"fmi{fmi}.c"}
    names |= {part.glue for part in model.parts}
    return {
        **{name: (own / name).read_text() for name in names},
        **{name: (headers / name).read_text() for name in _HEADERS[fmi]},
        **generated_sources(model, token=""),
    }


def _token(model: FmuModel, fmi: int, sources: Mapping[str, str]) -> str:
    """Instantiation token: equal for equal content, different for any other."""
    digest = hashlib.sha256(model_description(model, fmi, "", ()))
    for name in sorted(sources):
        digest.update(name.encode() + sources[name].encode())
    for name in sorted(model.resources):
        digest.update(name.encode() + model.resources[name])
    return str(uuid.uuid5(NAMESPACE, digest.hexdigest()))


def _binaries(
    name: str,
    fmi: int,
    platforms: tuple[Platform, ...],
    sources: Mapping[str, str],
    compiled: Sequence[str],
) -> dict[str, bytes]:
    """Archive members of the shared libraries."""
    made = {
        platform: compile_library(name, PLATFORMS[platform], compiler, sources, compiled)
        for platform, compiler in compilers(platforms).items()
    }
    members = {f"binaries/{p.folders[fmi]}/{name}{p.suffix}": made[p.name] for p in platforms}
    if fmi == 2 and {"darwin64", "darwin-arm64"} <= made.keys():
        # FMI 2 tools expect darwin64 on every Mac, so the binary there is universal.
        members[f"binaries/darwin64/{name}.dylib"] = universal_binary(
            made["darwin64"], made["darwin-arm64"]
        )
    return members


def compile_library(
    name: str,
    platform: Platform,
    compiler: Compiler,
    sources: Mapping[str, str],
    compiled: Sequence[str],
) -> bytes:
    """Shared library of the sources, from the cache if the same sources were compiled before.

    Objects are cached as well: twins of one vehicle share most of them, and so do both FMI
    versions, which differ in one file.
    """
    file = f"{name}{platform.suffix}"
    whole = _entry(file, compiler, sources, platform.suffix)
    if (binary := cached(whole)) is not None:
        return binary
    with tempfile.TemporaryDirectory() as folder:
        for source, text in sources.items():
            Path(folder, source).write_text(text)

        def compile_one(source: str) -> str:
            """Compile a source; returns the name of its object. Relative names: the binary contains
            nothing of this machine."""
            made = Path(folder, f"{Path(source).stem}.o")

            def make() -> bytes:
                """Call the compiler."""
                _run(name, [*compiler.command, *CFLAGS, "-c", source, "-o", made.name], folder)
                return made.read_bytes()

            part = _entry(source, compiler, _included(source, sources), ".o")
            made.write_bytes(cached_or_made(part, make))
            return made.name

        with ThreadPoolExecutor(max_workers=os.cpu_count()) as several:
            objects = list(several.map(compile_one, compiled))
        _run(name, [*compiler.command, "-shared", "-s", "-o", file, *objects, "-lm"], folder)
        binary = Path(folder, file).read_bytes()
    if platform.suffix == ".dll":
        binary = without_link_time(binary)
    store(whole, binary)
    return binary


def _included(source: str, sources: Mapping[str, str]) -> dict[str, str]:
    """A source with every header among the sources that it includes, directly or indirectly."""
    found: dict[str, str] = {}
    left = [source]
    while left:
        name = left.pop()
        if name in sources and name not in found:
            found[name] = sources[name]
            left += _INCLUDE.findall(sources[name])
    return found


def _entry(file: str, compiler: Compiler, sources: Mapping[str, str], suffix: str) -> str:
    """Name of the cache entry for these sources and a compiler, which determines the platform."""
    digest = hashlib.sha256(repr((_ENTRY, file, CFLAGS, compiler.identity)).encode())
    for source in sorted(sources):
        digest.update(source.encode() + sources[source].encode())
    return f"{digest.hexdigest()}{suffix}"


def _run(name: str, command: Sequence[str], folder: str) -> None:
    """One call of the compiler in a folder.

    Raises:
        FmuError: The compiler failed.
    """
    environment = {
        **os.environ,
        "ZIG_GLOBAL_CACHE_DIR": str(cache_folder().absolute() / "zig"),  # its system libraries
        "ZIG_LOCAL_CACHE_DIR": str(Path(folder, "zig")),
    }
    result = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    if result.returncode != 0:
        raise FmuError(f"{name}: the C compiler failed: {' '.join(command)}\n{result.stderr}")


def extend_archive(path: Path, members: Mapping[str, bytes]) -> None:
    """Add members to an archive of this project, replacing those of the same names.

    Raises:
        FmuError: A member would be written outside the folder on unpacking.
    """
    with zipfile.ZipFile(path) as archive:
        own = {name: archive.read(name) for name in archive.namelist()}
    write_archive(path, own | dict(members))


def write_archive(path: Path, members: Mapping[str, bytes]) -> None:
    """A zip archive whose bytes depend only on the members: sorted, fixed times, fixed modes.

    Raises:
        FmuError: A member would be written outside the folder on unpacking.
    """
    for name in members:
        if is_unsafe(name):
            raise FmuError(f"{path.name}: {shown(name)} is no name of a member; rename the part.")
    with (
        scratch_file(path) as partial,
        zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive,
    ):
        for name in sorted(members):
            info = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
            info.compress_type = zipfile.ZIP_DEFLATED
            info.create_system = 3
            info.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            archive.writestr(info, members[name])
