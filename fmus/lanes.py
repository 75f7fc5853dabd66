"""Lanes: the sources of an FMU compiled to fly several aircraft at once, one in each SIMD lane.

A lane performs the operations of the FMU in the same order, so its numbers are equal to the last
bit. The library is compiled for the processor of this machine, with the longest vectors that it
has.
"""

import hashlib
import platform
import subprocess
import zipfile
from functools import lru_cache
from importlib import resources
from pathlib import Path

from twin.errors import FmuError

from .builder import compile_library
from .platforms import DEFAULT, PLATFORMS, Compiler, machine_compiler

LANES = 8
"""Number of aircraft at once: doubles in an AVX-512 register, the longest."""
_NATIVE = {
    "x86_64": ("-march=native", "-mprefer-vector-width=512"),
    "aarch64": ("-mcpu=native",),
    "arm64": ("-mcpu=native",),
}
"""Compiler options that enable all instructions of this processor."""
_STRAIGHT = ("-fno-trapping-math", "-fno-tree-sink", "-fno-thread-jumps")
"""Options of gcc that forbid moving an operation of a kernel behind a branch, which would prevent
its vectorisation over lanes; no option changes a number."""
_KNOWN = {"core.h", "kernel.h", "noise.h", "casadi.h"}
"""Headers of FMUs that consist of CasADi kernels only; code with other headers holds the state of
one aircraft."""


def lanes_library(fmu: Path, lanes: int = LANES) -> bytes:
    """Compile a shared library with the function `lanes_fly` of `fmus/c/lanes.c`; returns its
    content.

    Args:
        fmu: FMU of this program, with its sources inside.
        lanes: Number of aircraft at once.

    Raises:
        FmuError: A part of the FMU is no CasADi component, or no compiler supports this processor.
    """
    with zipfile.ZipFile(fmu) as archive:
        inside = {
            name.removeprefix("sources/"): archive.read(name).decode()
            for name in archive.namelist()
            if name.startswith("sources/") and name.endswith((".c", ".h"))
        }
    sources = {name: text for name, text in inside.items() if not name.startswith("fmi")}
    if others := {name for name in sources if name.endswith(".h")} ^ _KNOWN:
        raise FmuError(f"{fmu.name}: flies one aircraft at a time: {', '.join(sorted(others))}.")
    sources["lanes.c"] = (resources.files(__package__) / "c" / "lanes.c").read_text()
    compiled = tuple(name for name in sorted(sources) if name.endswith(".c"))
    compiler = _native_compiler(lanes)
    return compile_library(fmu.stem, PLATFORMS[DEFAULT[0]], compiler, sources, compiled)


def native_options() -> tuple[str, ...]:
    """Options by which the compiler of this machine uses all instructions of its processor.

    Raises:
        FmuError: There is no such compiler, or it does not know the processor.
    """
    own, options = machine_compiler(), _NATIVE.get(platform.machine())
    if own is None or options is None:
        raise FmuError(f"no C compiler for the processor of this machine, {platform.machine()}.")
    straight = _STRAIGHT if "Free Software Foundation" in own.identity else ()
    return (*options, *straight)


@lru_cache
def _native_compiler(lanes: int) -> Compiler:
    """Compiler for this processor.

    Raises:
        FmuError: No such compiler exists.
    """
    options, own = native_options(), machine_compiler()
    assert own is not None
    command = (*own.command, *options, f"-DLANES={lanes}")
    macros = subprocess.run(
        [*command, "-dM", "-E", "-x", "c", "/dev/null"], capture_output=True, check=False
    )
    if macros.returncode != 0:
        raise FmuError(f"{own.command[0]}: does not know the options {' '.join(options)}.")
    known = hashlib.sha256(macros.stdout + repr(command).encode()).hexdigest()
    return Compiler(command, own.identity + known)
