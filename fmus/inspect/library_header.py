"""Shared libraries by their headers alone: for which processor and system, whether all is there.

Nothing is loaded. Sources: System V ABI, ELF header; Microsoft, PE format; Apple, mach-o/loader.h
and mach-o/fat.h.
"""

import struct
from dataclasses import dataclass

_ARCHITECTURES = (
    *("x86", "x86_64", "aarch32", "aarch64"),
    *("riscv32", "riscv64", "ppc32", "ppc64"),
)
_SYSTEMS = {"linux": ".so", "windows": ".dll", "darwin": ".dylib"}
_PLATFORMS = {
    "linux32": ("linux", {"x86"}),
    "linux64": ("linux", {"x86_64"}),
    "win32": ("windows", {"x86"}),
    "win64": ("windows", {"x86_64"}),
    "darwin64": ("darwin", {"x86_64", "aarch64"}),  # FMI 2 names no other folder for a Mac
    **{f"{a}-{system}": (system, {a}) for a in _ARCHITECTURES for system in _SYSTEMS},
}
"""Folder below `binaries` -> system and processors; FMI 2, 2.1.1, and FMI 3, 2.5.1.4.2."""
_ELF_MACHINES = {3: "x86", 62: "x86_64", 40: "aarch32", 183: "aarch64", 20: "ppc32", 21: "ppc64"}
_ELF_RISCV = 243
_PE_MACHINES = {0x14C: "x86", 0x8664: "x86_64", 0x1C4: "aarch32", 0xAA64: "aarch64"}
_MACH_CPUS = {7: "x86", 0x01000007: "x86_64", 12: "aarch32", 0x0100000C: "aarch64"}
_MAX_SLICES, _MAX_COMMANDS = 16, 10_000


@dataclass(frozen=True, slots=True)
class _Header:
    """What a file says that it is.

    Attributes:
        system: Of `_SYSTEMS`.
        processors: Those that run it; several in a universal binary.
        shared: Whether it can be loaded as a library.
        end: Bytes that it must have.
    """

    system: str
    processors: frozenset[str]
    shared: bool
    end: int


def library_suffix(platform: str) -> str | None:
    """Of shared libraries in a folder below `binaries`; None: no platform that is known."""
    known = _PLATFORMS.get(platform)
    return None if known is None else _SYSTEMS[known[0]]


def library_problem(content: bytes, platform: str) -> str | None:
    """Why a file is no shared library for a platform that is known; None: it is one."""
    system, processors = _PLATFORMS[platform]
    try:
        header = _header(content)
    except struct.error:
        return f"is cut: {len(content)} bytes end within its headers"
    if header is None:
        return "is no shared library: neither ELF, PE nor Mach-O"
    if header.system != system or not header.processors & processors:
        on = " and ".join(sorted(header.processors))
        return f"is for {on} on {header.system}, not for {platform}"
    if not header.shared:
        return "is a program or an object file, no shared library"
    if header.end > len(content):
        return f"is cut: {len(content)} bytes of {header.end}"
    return None


def _header(content: bytes) -> _Header | None:
    """Of a file of any of the three formats; None: of no other."""
    start = content[:4]
    if start == b"\x7fELF":
        return _elf(content)
    if start[:2] == b"MZ":
        return _pe(content)
    if start in (b"\xce\xfa\xed\xfe", b"\xcf\xfa\xed\xfe"):
        return _mach(content)
    if start == b"\xca\xfe\xba\xbe":
        return _universal(content)
    return None


def _elf(content: bytes) -> _Header | None:
    wide, order = content[4:5] == b"\2", ">" if content[5:6] == b"\2" else "<"
    kind, machine = struct.unpack_from(f"{order}HH", content, 16)
    programs, sections = struct.unpack_from(
        f"{order}{'QQ' if wide else 'II'}", content, 28 + 4 * wide
    )
    at = 54 if wide else 42
    program_size, n_programs, section_size, n_sections = struct.unpack_from(
        f"{order}HHHH", content, at
    )
    end = sections + section_size * n_sections
    for i in range(n_programs):
        at = programs + program_size * i
        if wide:
            _, _, offset, _, _, size = struct.unpack_from(f"{order}IIQQQQ", content, at)
        else:
            _, offset, _, _, size = struct.unpack_from(f"{order}IIIII", content, at)
        end = max(end, offset + size)
    name = _ELF_MACHINES.get(machine, f"ELF machine {machine}")
    if machine == _ELF_RISCV:
        name = "riscv64" if wide else "riscv32"
    return _Header("linux", frozenset({name}), kind == 3 and n_programs > 0, end)


def _pe(content: bytes) -> _Header | None:
    (at,) = struct.unpack_from("<I", content, 0x3C)
    magic, machine, n_sections, options, flags = struct.unpack_from("<4sHH12xHH", content, at)
    if magic != b"PE\0\0":
        return None
    end = at + 24 + options + 40 * n_sections
    for i in range(n_sections):
        size, offset = struct.unpack_from("<II", content, at + 24 + options + 40 * i + 16)
        end = max(end, offset + size)
    name = _PE_MACHINES.get(machine, f"PE machine {machine:#x}")
    return _Header("windows", frozenset({name}), bool(flags & 0x2000) and n_sections > 0, end)


def _mach(content: bytes) -> _Header | None:
    cpu, _, kind, n_commands = struct.unpack_from("<IIII", content, 4)
    if n_commands > _MAX_COMMANDS:
        return None
    at = 32 if content[0] == 0xCF else 28
    end = at
    for _ in range(n_commands):
        command, size = struct.unpack_from("<II", content, at)
        if command == 0x19:  # LC_SEGMENT_64
            offset, length = struct.unpack_from("<QQ", content, at + 40)
            end = max(end, offset + length)
        elif command == 0x1:  # LC_SEGMENT
            offset, length = struct.unpack_from("<II", content, at + 32)
            end = max(end, offset + length)
        at += max(size, 8)
    name = _MACH_CPUS.get(cpu, f"Mach-O processor {cpu:#x}")
    return _Header("darwin", frozenset({name}), kind in (6, 8), max(end, at))


def _universal(content: bytes) -> _Header | None:
    """Of several Mach-O files in one; class files of Java begin with the same four bytes."""
    (count,) = struct.unpack_from(">I", content, 4)
    if not 0 < count <= _MAX_SLICES:
        return None
    processors: set[str] = set()
    shared, end = True, 0
    for i in range(count):
        offset, size = struct.unpack_from(">8xII", content, 8 + 20 * i)
        one = _mach(content[offset : offset + size])
        if one is None:
            return None
        processors |= one.processors
        shared &= one.shared
        end = max(end, offset + max(size, one.end))
    return _Header("darwin", frozenset(processors), shared, end)
