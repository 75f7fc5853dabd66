"""Platforms of an FMU: the folder of each binary and its compiler."""

import importlib.metadata
import os
import shutil
import struct
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache

from twin.component import unknown_name
from twin.errors import FmuError


@dataclass(frozen=True, slots=True)
class Platform:
    """Platform on which an FMU runs.

    Attributes:
        folders: Folder below `binaries`, by FMI version. FMI 2 defines x86 only; for ARM the tuple
            of FMI 3 is used.
        suffix: Extension of the shared library.
        target: Target of zig, with the oldest supported system.
    """

    name: str
    folders: Mapping[int, str]
    suffix: str
    target: str


PLATFORMS = {
    p.name: p
    for p in (
        Platform("linux64", {2: "linux64", 3: "x86_64-linux"}, ".so", "x86_64-linux-gnu.2.17"),
        Platform(
            "aarch64-linux",
            {2: "aarch64-linux", 3: "aarch64-linux"},
            ".so",
            "aarch64-linux-gnu.2.17",
        ),
        Platform("win64", {2: "win64", 3: "x86_64-windows"}, ".dll", "x86_64-windows-gnu"),
        Platform("darwin64", {2: "darwin64", 3: "x86_64-darwin"}, ".dylib", "x86_64-macos.11.0"),
        Platform(
            "darwin-arm64",
            {2: "aarch64-darwin", 3: "aarch64-darwin"},
            ".dylib",
            "aarch64-macos.11.0",
        ),
    )
}  # by name
DEFAULT = ("linux64",)  # default platforms


@dataclass(frozen=True, slots=True)
class Compiler:
    """Compiler call for one platform.

    Attributes:
        command: Program and leading arguments.
        identity: Text that identifies compilers with identical output.
    """

    command: tuple[str, ...]
    identity: str


def select_platforms(names: Iterable[str]) -> tuple[Platform, ...]:
    """The platforms of these names, without duplicates and in table order; `all` stands for every
    one.

    Raises:
        FmuError: An unknown name, or none at all.
    """
    wanted = set(names)
    for name in sorted(wanted - {"all"}):
        if name not in PLATFORMS:
            raise FmuError(unknown_name("FMU", "platform", name, (*PLATFORMS, "all")))
    if not wanted:
        raise FmuError(f"FMU: no platform given. Known: {', '.join(PLATFORMS)}, all.")
    return tuple(p for p in PLATFORMS.values() if p.name in wanted or "all" in wanted)


def compilers(platforms: tuple[Platform, ...]) -> dict[str, Compiler]:
    """Compiler of each platform: the machine's own for linux64 alone where there is one, else zig
    for all of them.

    So all binaries of one FMU are built by one compiler.

    Raises:
        FmuError: `CC` names a compiler that is not on the path.
    """
    own = machine_compiler() if tuple(p.name for p in platforms) == DEFAULT else None
    if own is not None:
        return {DEFAULT[0]: own}
    version = importlib.metadata.version("ziglang")
    zig = (sys.executable, "-m", "ziglang", "cc", "-target")
    return {p.name: Compiler((*zig, p.target), f"zig {version} {p.target}") for p in platforms}


def universal_binary(x86_64: bytes, arm64: bytes) -> bytes:
    """One Mach-O file of two architectures (as from `lipo -create`).

    Source: Apple, mach-o/fat.h; big endian, slices aligned to the page of ARM, 2**14 bytes.
    """
    align = 14
    content = b""
    header = struct.pack(">II", 0xCAFEBABE, 2)
    for binary in (x86_64, arm64):
        cpu_type, cpu_subtype = struct.unpack_from("<II", binary, 4)
        content += b"\0" * (-len(content) % 2**align)
        offset = 2**align + len(content)
        header += struct.pack(">IIIII", cpu_type, cpu_subtype, offset, len(binary), align)
        content += binary
    return header.ljust(2**align, b"\0") + content


def without_link_time(dll: bytes) -> bytes:
    """A Windows library without its time of linking: two builds are identical.

    Source: Microsoft, PE Format: the offset of the header is at 0x3c, the time 8 bytes after it.
    """
    (header,) = struct.unpack_from("<I", dll, 0x3C)
    at = header + 8
    return dll[:at] + bytes(4) + dll[at + 4 :]


def machine_compiler() -> Compiler | None:
    """Compiler of `CC`, else `cc`; None where the machine has none."""
    name = os.environ.get("CC", "cc")
    found = shutil.which(name)
    if found is not None:
        return Compiler((found,), _compiler_version(found))
    if "CC" in os.environ:
        raise FmuError(
            f"No C compiler: CC is {name!r}, which is not on the path. Correct CC, or unset it: "
            f"without a C compiler zig is used, which uavtwin brings."
        )
    return None


@lru_cache
def _compiler_version(compiler: str) -> str:
    return subprocess.run(
        [compiler, "--version"], capture_output=True, text=True, check=False
    ).stdout
