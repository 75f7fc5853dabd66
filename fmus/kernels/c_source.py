"""C source of kernels: a function of CasADi's operations, one statement for each."""

from collections.abc import Collection, Iterator, Sequence

import casadi as ca

from twin.errors import FmuError

from .operations import Operation, operations
from .pairing import paired

TRUTHS = {
    ca.OP_LT: "{0} < {1}",
    ca.OP_LE: "{0} <= {1}",
    ca.OP_EQ: "{0} == {1}",
    ca.OP_NE: "{0} != {1}",
    ca.OP_NOT: "!{0}",
    ca.OP_AND: "{0} && {1}",
    ca.OP_OR: "{0} || {1}",
}
"""What is 0 or 1, in C."""
NUMBERS = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_ADD: "{0} + {1}",
    ca.OP_SUB: "{0} - {1}",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}",
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "2. * {0}",
    ca.OP_INV: "1. / {0}",
    ca.OP_IF_ELSE_ZERO: "{0} ? {1} : 0.",
    # A comparison is compiled in line, a call of the library is not; numbers are never NaN here.
    ca.OP_FMAX: "{0} > {1} ? {0} : {1}",
    ca.OP_FMIN: "{0} < {1} ? {0} : {1}",
    ca.OP_SIGN: "{0} < 0 ? -1. : {0} > 0 ? 1. : {0}",
    ca.OP_SQRT: "sqrt({0})",
    ca.OP_FABS: "fabs({0})",
    ca.OP_FLOOR: "floor({0})",
    ca.OP_CEIL: "ceil({0})",
    ca.OP_FMOD: "fmod({0}, {1})",
    ca.OP_COPYSIGN: "copysign({0}, {1})",
    ca.OP_POW: "pow({0}, {1})",
    ca.OP_CONSTPOW: "pow({0}, {1})",
    ca.OP_EXP: "exp({0})",
    ca.OP_LOG: "log({0})",
    ca.OP_SIN: "sin({0})",
    ca.OP_COS: "cos({0})",
    ca.OP_TAN: "tan({0})",
    ca.OP_ASIN: "asin({0})",
    ca.OP_ACOS: "acos({0})",
    ca.OP_ATAN: "atan({0})",
    ca.OP_ATAN2: "atan2({0}, {1})",
    ca.OP_SINH: "sinh({0})",
    ca.OP_COSH: "cosh({0})",
    ca.OP_TANH: "tanh({0})",
}
"""The other operations, in C."""
TOGETHER = {ca.OP_DIV: "quotients", ca.OP_SQRT: "roots"}
"""Functions of `kernel.h` that do two at once."""


def kernel_source(
    functions: Sequence[ca.Function],
    in_place: Collection[str] = (),
    often: Collection[str] = (),
    seldom: Collection[str] = (),
) -> str:
    """C source of the kernels, all of it static: several parts are linked into one library.

    A kernel takes the address of each argument, then that of its result, which it writes when it
    has read all of them. The source holds no name and no number of a vehicle, so that one
    compilation serves many.

    Args:
        functions: Of scalar operations, with one result each.
        in_place: Names of those whose result replaces the first argument; what stays as it is is
            not written.
        often: Names of those that most steps call, which are worth more of the compiler's time.
        seldom: Names of those that no step calls, which are worth less.

    Raises:
        FmuError: An operation is not known here.
    """
    names = [f.name() for f in functions]
    worth = ["OFTEN " * (name in often) + "SELDOM " * (name in seldom) for name in names]
    return "\n".join(
        how + _function(f, f.name() in in_place) for how, f in zip(worth, functions, strict=True)
    )


def _function(function: ca.Function, in_place: bool) -> str:
    steps, results = operations(function)
    kernel = _Kernel(function.name(), steps)
    body: list[str] = []
    ends: list[str] = []
    for place, source in enumerate(results):
        if in_place and steps[source].code == ca.OP_INPUT and steps[source].place == (0, place):
            continue
        body += kernel.statements(source)
        (ends if in_place else body).append(f"y[{place}] = v{source};")
    arguments = [f"const double* x{i}" for i in range(function.n_in())]
    unused = [f"(void)x{i};" for i in range(function.n_in())]
    lines = "\n".join([*unused, "(void)y;", *body, *ends])
    return (
        f"static void {function.name()}({', '.join([*arguments, 'double* y'])}) {{\n{lines}\n}}\n"
    )


class _Kernel:
    """The statements of one kernel, each written once, where its result is first needed."""

    def __init__(self, name: str, steps: Sequence[Operation]) -> None:
        self._name, self._steps = name, steps
        self._partner = paired(steps)
        self._written: set[int] = set()

    def statements(self, wanted: int) -> Iterator[str]:
        """All that is not yet written of what gives an operation's result, in order."""
        stack = [wanted]
        while stack:
            k = stack[-1]
            if k in self._written:
                stack.pop()
                continue
            both = (k, self._partner[k]) if k in self._partner else (k,)
            needed = [a for j in both for a in self._steps[j].arguments if a not in self._written]
            if needed:
                stack += reversed(needed)
                continue
            yield self._pair(*sorted(both)) if len(both) > 1 else self._single(k)
            self._written.update(both)

    def _single(self, k: int) -> str:
        kind = "int" if self._steps[k].code in TRUTHS else "double"
        return f"{kind} v{k} = {self._expression(k)};"

    def _pair(self, one: int, other: int) -> str:
        values = [self._number(a) for k in (one, other) for a in self._steps[k].arguments]
        together = TOGETHER[self._steps[one].code]
        return f"double v{one}, v{other}; {together}({', '.join(values)}, &v{one}, &v{other});"

    def _expression(self, k: int) -> str:
        step = self._steps[k]
        if step.code == ca.OP_INPUT:
            return f"x{step.place[0]}[{step.place[1]}]"
        if step.code == ca.OP_CONST:
            return _constant(step.value)
        if step.code in TRUTHS:
            return TRUTHS[step.code].format(*(f"v{a}" for a in step.arguments))
        if step.code in NUMBERS:
            return NUMBERS[step.code].format(*map(self._number, step.arguments))
        raise FmuError(f"{self._name}: there is no C for operation {step.code} of CasADi.")

    def _number(self, k: int) -> str:
        """An operand of arithmetic: a truth value is an int otherwise."""
        return f"(double)v{k}" if self._steps[k].code in TRUTHS else f"v{k}"


def _constant(value: float) -> str:
    """Small whole numbers belong to the equations, others may be of a vehicle."""
    return f"{value:.0f}." if value == round(value) and abs(value) < 1e6 else f"{value:.16e}"
