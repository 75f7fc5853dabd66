"""C source of kernels against CasADi's own evaluation, and which operations go together."""

import ctypes
import re
import subprocess
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from fmus.builder import CFLAGS
from fmus.kernels import (
    NUMBERS,
    TOGETHER,
    TRUTHS,
    guards,
    kernel_source,
    kernels,
    operations,
    paired,
)
from fmus.lanes import native_options
from twin.errors import FmuError
from twin.flight.lqr import controller
from twin.vehicle_file import load_vehicle

Array = NDArray[np.float64]


def compiled(
    folder: Path, source: str, name: str, arguments: int, *options: str
) -> Callable[..., None]:
    """A kernel as a function of arrays."""
    named = [f"x{i}" for i in range(arguments + 1)]
    outside = f"void called({', '.join(f'double* {n}' for n in named)})"
    (folder / "kernel.c").write_text(
        '#include <math.h>\n#include "kernel.h"\n'
        f"{source}\n"
        f'__attribute__((visibility("default"))) {outside} {{ {name}({", ".join(named)}); }}\n'
    )
    header = resources.files("fmus") / "c" / "kernel.h"
    (folder / "kernel.h").write_text(header.read_text())
    library = folder / "kernel.so"
    command = [
        "cc",
        *CFLAGS,
        *options,
        "-shared",
        "-o",
        str(library),
        str(folder / "kernel.c"),
        "-lm",
    ]
    subprocess.run(command, check=True)
    called = ctypes.CDLL(str(library)).called
    called.argtypes = [np.ctypeslib.ndpointer(np.float64)] * (arguments + 1)
    called.restype = None
    return called


def tangle(rng: np.random.Generator, inputs: int, size: int) -> tuple[ca.SX, ca.SX]:
    """Symbols and results of random operations on them and on each other."""
    x = ca.SX.sym("x", inputs)
    known = [*ca.vertsplit(x), ca.SX(0.1), ca.SX(3.0), ca.SX(-2.5e7)]
    binary = [
        lambda a, b: a + b,
        lambda a, b: a - b,
        lambda a, b: a * b,
        lambda a, b: a / (ca.fabs(b) + 0.3),
        ca.fmax,
        ca.fmin,
        lambda a, b: ca.if_else(a < b, a, b),
        lambda a, b: (a <= b) + ca.logic_and(a > 0, b > 0) / 3 - ca.logic_not(b),
        lambda a, b: ca.if_else(ca.logic_or(a == b, a != 0.1), ca.sign(a), -b),
        lambda a, b: ca.copysign(ca.floor(a), b) + ca.ceil(b),
    ]
    unary = [
        lambda a: ca.sqrt(ca.fabs(a)),
        lambda a: ca.sqrt(a * a + 1),
        lambda a: 1 / (1 + a * a),
        lambda a: -2 * a,
        ca.fabs,
    ]
    for _ in range(size):
        a, b = (known[i] for i in rng.integers(len(known), size=2))
        made = (
            binary[rng.integers(len(binary))](a, b)
            if rng.random() < 0.6
            else unary[rng.integers(len(unary))](a)
        )
        # Bounded, so that no number becomes infinite on the way.
        known.append(made / ca.sqrt(1 + 1e-4 * made * made))
    return x, ca.densify(ca.vertcat(*known[-inputs:]))


@pytest.mark.parametrize("seed", range(6))
def test_the_numbers_of_casadi(tmp_path: Path, seed: int) -> None:
    """In place and into an array of their own. The larger of 0 and -0 may be either."""
    rng = np.random.default_rng(seed)
    x, y = tangle(rng, 8, 150)
    y[3] = x[3]  # in place it is not written
    function = ca.Function("mixed", [x], [y])
    for in_place in (False, True):
        folder = tmp_path / str(in_place)
        folder.mkdir()
        source = kernel_source([function], ["mixed"] * in_place, ["mixed"])
        call = compiled(folder, source, "mixed", 1)
        for scale in (0.0, 1e-3, 1.0, 1e3):
            value = scale * rng.normal(size=8)
            result = value.copy() if in_place else np.empty(8)
            call(result if in_place else value, result)
            np.testing.assert_array_equal(result, np.asarray(function(value)).ravel())


@pytest.mark.parametrize("lanes", [3, 8])
def test_a_lane_computes_what_one_aircraft_does(tmp_path: Path, lanes: int) -> None:
    """Bit by bit, powers that a condition leaves out and zeros with a sign among them."""
    rng = np.random.default_rng(lanes)
    x, y = tangle(rng, 8, 150)
    power = ca.fmax(ca.fabs(x[0]), 0.1) ** ca.fmin(x[1], 3.0)
    y[2] = ca.if_else(x[2] > 0, 2 * power, ca.log(1 + x[3] ** 2))
    source = kernel_source([ca.Function("mixed", [x], [y])])
    assert re.search(r"pow\(IF_FELT\(v\d+, v\d+\), v\d+\)", source)
    folders = tmp_path / "one", tmp_path / "several"
    for folder in folders:
        folder.mkdir()
    one = compiled(folders[0], source, "mixed", 1)
    several = compiled(folders[1], source, "mixed", 1, f"-DLANES={lanes}", *native_options())
    for scale in (0.0, 1e-3, 1.0, 30.0):
        value = scale * rng.normal(size=(8, lanes))
        found, single = np.empty((8, lanes)), np.empty(8)
        several(value, found)
        for lane in range(lanes):
            one(value[:, lane].copy(), single)
            assert single.tobytes() == found[:, lane].tobytes()


def test_a_power_waits_for_what_alone_feels_it() -> None:
    x = ca.SX.sym("x", 4)
    felt = ca.if_else(x[0] > 0, x[1] ** x[2], x[3])
    for results, guarded in ([felt], 1), ([felt, x[1] ** x[2]], 0):
        steps, places = operations(ca.Function("f", [x], [ca.cse(ca.vertcat(*results))]))
        found = guards(steps, places)
        assert len(found) == guarded
        for k, condition in found.items():
            assert steps[k].code == ca.OP_POW
            assert steps[condition].code == ca.OP_LT


def test_every_operation_means_what_it_does_in_casadi(tmp_path: Path) -> None:
    """One by one; functions of the library within one unit of the last place."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    made = {
        "sin": ca.sin(x), "cos": ca.cos(x), "tan": ca.tan(x), "exp": ca.exp(x),
        "log": ca.log(x), "asin": ca.asin(x), "acos": ca.acos(x), "atan": ca.atan(x),
        "atan2": ca.atan2(x, y), "sinh": ca.sinh(x), "cosh": ca.cosh(x), "tanh": ca.tanh(x),
        "pow": x**y, "fmod": ca.fmod(x, y), "constpow": x**2.5, "twice": 2 * x, "inv": 1 / x,
    }  # fmt: skip
    function = ca.Function("each", [x, y], [ca.vertcat(*made.values())])
    call = compiled(tmp_path, kernel_source([function]), "each", 2)
    for values in ((0.3, 0.7), (0.9, -1.3), (0.01, 2.0)):
        found = np.empty(len(made))
        call(np.array(values[:1]), np.array(values[1:]), found)
        expected = np.asarray(function(*values)).ravel()
        np.testing.assert_array_max_ulp(found, expected, maxulp=1)


def test_an_operation_that_c_lacks_is_refused() -> None:
    x = ca.SX.sym("x")
    with pytest.raises(FmuError, match="smooth: there is no C for operation"):
        kernel_source([ca.Function("smooth", [x], [ca.erf(x)])])


def test_the_tables_have_no_operation_twice() -> None:
    assert not TRUTHS.keys() & NUMBERS.keys()
    assert TOGETHER.keys() <= NUMBERS.keys()


def test_who_goes_together_does_not_wait_for_each_other() -> None:
    """In the controller; there most divisions and roots of a step have a partner of their kind."""
    made = {f.name(): f for f in kernels(controller(load_vehicle("crazyflie")), False).functions}
    steps, _ = operations(made["step"])
    partner = paired(steps)
    needs: list[set[int]] = []
    for step in steps:
        needs.append({*step.arguments}.union(*(needs[a] for a in step.arguments)))
    for one, other in partner.items():
        assert partner[other] == one != other
        assert steps[one].code == steps[other].code in TOGETHER
        assert one not in needs[other]
    slow = [k for k, step in enumerate(steps) if step.code in TOGETHER]
    assert len(slow) > 100
    assert len(partner) > 0.7 * len(slow)
