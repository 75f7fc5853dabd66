"""C source of kernels, as CasADi writes it and an FMU needs it."""

import re
from collections.abc import Sequence

import casadi as ca

_EXPORTED = re.compile(
    r"^(?:const )?\w+\*? (?P<name>\w+)\([^)]*\) ?\{(?:[^\n]*\}|.*?\n\})\n+"
    r"|^static const casadi_int casadi_s\d+\[[^;]*;\n",
    re.MULTILINE | re.DOTALL,
)
"""What CasADi writes to be called from outside: functions that are not static, and their tables."""


_SELDOM = """#if defined(__OPTIMIZE__) && defined(__GNUC__) && !defined(__clang__)
#pragma GCC push_options
#pragma GCC optimize ("O1")
#define SELDOM
#endif
"""
"""In front of what no step calls. Derivatives are longer than what they are of, and gcc takes up to
three quarters of its time for them at -O3: the same bits, of which nobody has many to wait for."""
_OFTEN = """#ifdef SELDOM
#pragma GCC pop_options
#endif
"""


def kernel_source(functions: Sequence[ca.Function], stepping: int) -> str:
    """C source of the kernels, all of it static: several parts are linked into one library.

    It holds no name and no number of a vehicle, so that one compilation serves many.

    Args:
        functions: Those that run in every step first.
        stepping: How many these are.
    """
    generator = ca.CodeGenerator(
        "kernel", {"with_header": False, "casadi_int": "int", "with_export": False}
    )
    for function in functions:
        generator.add(function)
    names = {f.name() for f in functions}
    last = functions[stepping - 1].name()

    def kept(exported: re.Match[str]) -> str:
        """Kernels and CasADi's helpers, without the functions that describe a kernel to CasADi."""
        name = exported["name"] or ""
        called = name in names or name.startswith("casadi_")
        seldom = _SELDOM if name == last else ""
        return f"static {exported[0]}{seldom}" if called else ""

    source = _EXPORTED.sub(kept, generator.dump())
    # A comparison is compiled in line, a call of the library is not; numbers are never NaN here.
    for name, sign in (("fmax", ">"), ("fmin", "<")):
        source = source.replace(f"return {name}(x, y);", f"return x {sign} y ? x : y;")
    return source + _OFTEN


def workspace(functions: Sequence[ca.Function]) -> dict[str, int]:
    """Sizes of what the kernels work in."""
    return {
        "N_ARGUMENTS": max(f.sz_arg() for f in functions) + 1,
        "N_RESULTS": max(f.sz_res() for f in functions) + 1,
        "N_INTEGERS": max(f.sz_iw() for f in functions) + 1,
        "N_WORK": max(f.sz_w() for f in functions) + 1,
        "N_PREPARED": next(f.size1_out(0) for f in functions if f.name() == "prepare"),
    }
