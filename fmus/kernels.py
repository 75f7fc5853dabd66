"""Kernels: the CasADi functions of a component that its FMU calls in C, and their C source.

The list of functions and the parts that are computed only once; their directional derivatives; each
as a list of scalar operations, and that list as C, one statement for each operation.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import casadi as ca

from twin.component import Component, Shortcut
from twin.errors import FmuError


def draws(component: Component) -> ca.SX:
    """Symbols of the normal draws at a sample instant."""
    return ca.SX.sym("w", 0 if component.sampling is None else component.sampling.channels)


def first_state(component: Component, u: ca.SX, p: ca.SX, w: ca.SX) -> ca.SX:
    """State at the start, the first sample instant included."""
    x, sampling = component.initial(u, p), component.sampling
    return x if sampling is None else sampling.update(x, u, p, w, sampling.signals(x, u, p))


def tangents(component: Component, exchange: bool) -> list[ca.Function]:
    """`(x, u, p, du, dp) -> dy` while stepping, `(u, p, du, dp, w) -> dy` at the start.

    With `exchange` the first has another argument, the change of the states: `dx`. A component that
    `starts_alike` has the first one only.
    """
    x, dx = (ca.SX.sym(n, len(component.states)) for n in ("x", "dx"))
    u, du = (ca.SX.sym(n, len(component.inputs)) for n in ("u", "du"))
    p, dp = (ca.SX.sym(n, len(component.parameters)) for n in ("p", "dp"))
    w = draws(component)

    def tangent(
        name: str, state: ca.SX, arguments: list[ca.SX], known: list[ca.SX], change: list[ca.SX]
    ) -> ca.Function:
        """Change of the outputs, with the state as an expression of the arguments."""
        y = component.outputs(state, u, p)
        dy = ca.jtimes(y, ca.vertcat(*known), ca.vertcat(*change))
        return ca.Function(name, arguments, [ca.cse(dy)])

    if starts_alike(component, exchange):
        return [tangent("tangent", x, [x, u, p, du, dp], [u, p], [du, dp])]
    first, d = first_state(component, u, p, w), [du, dp]
    starting = tangent("initial_tangent", first, [u, p, *d, w], [u, p], d)
    if exchange:
        return [tangent("tangent", x, [x, u, p, *d, dx], [u, p, x], [*d, dx]), starting]
    return [tangent("tangent", x, [x, u, p, *d], [u, p], d), starting]


def starts_alike(component: Component, exchange: bool) -> bool:
    """Whether there is one tangent for both: without states the start does not differ.

    It is compiled once: the tangent of a learned force takes a compiler twenty seconds.
    """
    return not (component.states or exchange)


_COSTLY = ("step", "outputs", "update")
"""Functions with most of a step's computing time."""
_Stepping = tuple[ca.Function, str]
"""A function that runs in every step, and its arguments, a letter each: x, u, p and so on."""


@dataclass(frozen=True, slots=True)
class Kernels:
    """The functions that the C source of a component calls.

    Attributes:
        functions: Functions; the first is `prepare`, `p -> c`. Those that run in every step have an
            additional argument c after p: their parts that depend on parameters only, computed
            before. Operations and results are the same, to the last bit.
        cheaper: Numbers of the shortcuts with a cheaper version of `step`, `outputs`, `update` and
            `signals`.
        in_place: Names of functions whose result overwrites the states, their first argument.
        often: Names of functions that most steps call: shortcuts, or the full one where there is
            none.
        seldom: Names of functions that no step calls.
        still: Whether a step changes no state.
        starts_alike: Whether the tangent while stepping is also that of the start.
    """

    functions: tuple[ca.Function, ...] = field(repr=False)
    cheaper: Mapping[str, tuple[int, ...]]
    in_place: frozenset[str]
    often: frozenset[str]
    seldom: frozenset[str]
    still: bool
    starts_alike: bool


def kernels(component: Component, exchange: bool) -> Kernels:
    """Every function that the C source of a component calls.

    Args:
        component: Equations and interface.
        exchange: Whether an external solver may integrate it, in addition to co-simulation.
    """
    full = _full(component)
    stepping, cheaper = [full[name] for name in full], {}
    for name in ("step", "outputs", "update", "signals"):
        found = [(i, _short(s, name)) for i, s in enumerate(component.shortcuts)]
        others = [
            (i, (f, full[name][1]))
            for i, f in found
            if f is not None and name in full and not _same(f, *full[name])
        ]
        cheaper[name] = tuple(i for i, _ in others)
        stepping += [other for _, other in others]
    tried = sorted({i for some in cheaper.values() for i in some})
    stepping += [(component.shortcuts[i].holds, "xph") for i in tried]
    seldom = [component.initial, *tangents(component, exchange)]
    if exchange and component.continuous is not None:
        seldom.append(component.continuous.rests)
    x = ca.SX.sym("x", len(component.states))
    still = _same(ca.Function("still", [x], [x]), *full["step"])
    short = {kernel: [f"cheap_{kernel}_{i}" for i in found] for kernel, found in cheaper.items()}
    return Kernels(
        functions=(*prepared(stepping), *seldom),
        cheaper=cheaper,
        in_place=frozenset(("step", "update", *short["step"], *short["update"])),
        often=frozenset(n for kernel in _COSTLY for n in short[kernel] or [kernel]),
        seldom=frozenset(f.name() for f in seldom),
        still=still,
        starts_alike=starts_alike(component, exchange),
    )


def _full(component: Component) -> dict[str, _Stepping]:
    """Functions that run in every step, by their name in C."""
    functions = {"step": (component.step, "xuph"), "outputs": (component.outputs, "xup")}
    sampling = component.sampling
    if sampling is not None:
        functions["update"] = (sampling.update, "xupwd")
        if sampling.channels:
            functions["sizes"] = (sampling.sizes, "p")
        if sampling.lines:
            functions["signals"] = (sampling.signals, "xup")
            functions["delays"] = (sampling.delays, "p")
    return functions


def _short(shortcut: Shortcut, name: str) -> ca.Function | None:
    """The function of this name in a shortcut."""
    found: ca.Function | None = getattr(shortcut, name)
    return found


def _same(one: ca.Function, other: ca.Function, letters: str) -> bool:
    """Whether two functions have the same operations; `one` may lack the first arguments."""
    symbols = [ca.SX.sym(k, other.size1_in(i)) for i, k in enumerate(letters)]
    n = other.size1_out(0)
    both = ca.cse(ca.vertcat(one(*symbols[: one.n_in()]), other(*symbols)))
    return bool(ca.is_equal(both[:n], both[n:]))


def prepared(functions: Sequence[_Stepping]) -> list[ca.Function]:
    """`prepare` and the functions, whose parts that depend on parameters only are moved to it.

    Args:
        functions: Functions with their arguments; a letter has the same meaning in all of them.
    """
    symbols: dict[str, ca.SX] = {}
    for function, letters in functions:
        for i, letter in enumerate(letters):
            symbols.setdefault(letter, ca.SX.sym(letter, function.size1_in(i)))
    results = [f(*(symbols[k] for k in letters)) for f, letters in functions]
    left, names, known = ca.extract_parametric(ca.cse(ca.vertcat(*results)), symbols["p"])
    c = ca.vertcat(ca.SX(0, 1), *names)
    made = [ca.Function("prepare", [symbols["p"]], [ca.densify(ca.vertcat(ca.SX(0, 1), *known))])]
    begin = 0
    for function, letters in functions:
        end = begin + function.size1_out(0)
        arguments = [a for k in letters for a in ([symbols[k], c] if k == "p" else [symbols[k]])]
        made.append(ca.Function(function.name(), arguments, [ca.densify(left[begin:end])]))
        begin = end
    return made


@dataclass(frozen=True, slots=True)
class Operation:
    """One scalar operation.

    Attributes:
        code: Code of CasADi, such as `casadi.OP_ADD`.
        arguments: Numbers of the operations whose results are its operands.
        place: For an input: argument of the function, and index in it.
        value: Value of a constant.
    """

    code: int
    arguments: tuple[int, ...] = ()
    place: tuple[int, int] = (0, 0)
    value: float = 0.0


def operations(function: ca.Function) -> tuple[list[Operation], list[int]]:
    """Operations of a function, in order.

    Args:
        function: Function of scalar operations (`SX`), with one dense result.

    Returns:
        Operations, each after its operands; and the numbers of those that are the result.
    """
    found: list[Operation] = []
    latest: dict[int, int] = {}  # place in CasADi's work space -> operation that wrote it last
    results = [0] * function.nnz_out(0)
    for k in range(function.n_instructions()):
        code, given = function.instruction_id(k), function.instruction_input(k)
        if code == ca.OP_OUTPUT:
            results[function.instruction_output(k)[1]] = latest[given[0]]
            continue
        if code == ca.OP_INPUT:
            operation = Operation(code, place=(given[0], given[1]))
        elif code == ca.OP_CONST:
            operation = Operation(code, value=function.instruction_constant(k))
        else:
            operation = Operation(code, tuple(latest[i] for i in given))
        latest[function.instruction_output(k)[0]] = len(found)
        found.append(operation)
    return found, results


CYCLES = {ca.OP_DIV: 13, ca.OP_SQRT: 21, ca.OP_INPUT: 0, ca.OP_CONST: 0}
"""Approximate duration of an operation, in processor cycles; others take `USUAL`. A processor
starts a division every five cycles and a root every nine, for one number or two in a vector, and
these dominate the time of a controller: so divisions and roots of a kernel are computed in
pairs."""
USUAL = 3
"""Cycles of an operation that `CYCLES` does not list."""
APART = 12
"""Largest difference of cycles between the operands of a pair. As this is less than the duration of
either, neither waits for the other, and pairs do not wait for each other."""


def paired(steps: Sequence[Operation]) -> dict[int, int]:
    """Partner of each division and each root that has one.

    Args:
        steps: Operations of one function; see `operations`.
    """
    done: list[int] = []  # time at which each is done, if all begin as soon as possible
    for step in steps:
        begins = max((done[a] for a in step.arguments), default=0)
        done.append(begins + CYCLES.get(step.code, USUAL))
    partner: dict[int, int] = {}
    for code in (ca.OP_DIV, ca.OP_SQRT):
        left = sorted((k for k, s in enumerate(steps) if s.code == code), key=done.__getitem__)
        while len(left) > 1:
            one, other, *rest = left
            together = done[other] - done[one] <= APART
            if together:
                partner |= {one: other, other: one}
            left = rest if together else left[1:]
    return partner


def guards(steps: Sequence[Operation], results: Sequence[int]) -> dict[int, int]:
    """Condition of each power outside of which it does not affect a result.

    With several aircraft at once no branch skips what only some of them do not need.

    Args:
        steps: Operations of one function.
        results: Numbers of those that are its result; see `operations`.
    """
    powers = (ca.OP_POW, ca.OP_CONSTPOW)
    if not any(step.code in powers for step in steps):
        return {}
    needed: dict[int, frozenset[int]] = {k: frozenset() for k in results}  # conditions of each
    for k in range(len(steps) - 1, -1, -1):
        step, own = steps[k], needed.get(k, frozenset())
        for i, a in enumerate(step.arguments):
            chosen = step.code == ca.OP_IF_ELSE_ZERO and i == 1
            found = own | {step.arguments[0]} if chosen else own
            needed[a] = needed[a] & found if a in needed else found
    first = {k: min(needed.get(k, ()), default=k) for k, s in enumerate(steps) if s.code in powers}
    return {k: condition for k, condition in first.items() if condition < k}


TRUTHS = {
    ca.OP_LT: "{0} < {1}",
    ca.OP_LE: "{0} <= {1}",
    ca.OP_EQ: "{0} == {1}",
    ca.OP_NE: "{0} != {1}",
    ca.OP_NOT: "!{0}",
    ca.OP_AND: "{0} && {1}",
    ca.OP_OR: "{0} || {1}",
}
"""Operations with a result of 0 or 1, in C."""
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
    # A comparison is compiled inline, a call of the library is not; numbers are never NaN here.
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
"""Functions of `kernel.h` that compute two values at once."""


def kernel_source(
    functions: Sequence[ca.Function],
    in_place: Collection[str] = (),
    often: Collection[str] = (),
    seldom: Collection[str] = (),
) -> str:
    """C source of the kernels, all static: several parts are linked into one library.

    A kernel takes the address of each argument, then that of its result, which it writes after
    reading all of them; for several aircraft at once, one value of each in a vector (`LANES` of
    `kernel.h`). The source contains no name and no number of a vehicle, so that one compilation
    serves many.

    Args:
        functions: Functions of scalar operations, with one result each.
        in_place: Names of those whose result overwrites the first argument; unchanged elements are
            not written.
        often: Names of those that most steps call, which are optimised more.
        seldom: Names of those that no step calls, which are optimised less.

    Raises:
        FmuError: An operation is not supported.
    """
    names = [f.name() for f in functions]
    worth = ["OFTEN " * (name in often) + "SELDOM " * (name in seldom) for name in names]
    return "\n".join(
        how + _function(f, f.name() in in_place) for how, f in zip(worth, functions, strict=True)
    )


def _function(function: ca.Function, in_place: bool) -> str:
    steps, results = operations(function)
    kernel = _Kernel(function.name(), steps, guards(steps, results))
    body: list[str] = []
    ends: list[str] = []
    for place, source in enumerate(results):
        if in_place and steps[source].code == ca.OP_INPUT and steps[source].place == (0, place):
            continue
        body += kernel.statements(source)
        (ends if in_place else body).append(f"y[AT({place})] = v{source};")
    arguments = [f"const double* x{i}" for i in range(function.n_in())]
    unused = [f"(void)x{i};" for i in range(function.n_in())]
    lines = "\n".join([*unused, "(void)y;", "EACH_LANE {", *body, *ends, "}"])
    return (
        f"static void {function.name()}({', '.join([*arguments, 'double* y'])}) {{\n{lines}\n}}\n"
    )


class _Kernel:
    """The statements of one kernel, each written once, where its result is first needed."""

    def __init__(self, name: str, steps: Sequence[Operation], guard: Mapping[int, int]) -> None:
        self._name, self._steps, self._guard = name, steps, guard
        self._partner = paired(steps)
        self._written: set[int] = set()

    def statements(self, wanted: int) -> Iterator[str]:
        """Statements not yet written that an operation's result needs, in order."""
        stack = [wanted]
        while stack:
            k = stack[-1]
            if k in self._written:
                stack.pop()
                continue
            both = (k, self._partner[k]) if k in self._partner else (k,)
            needed = [a for j in both for a in self._needs(j) if a not in self._written]
            if needed:
                stack += reversed(needed)
                continue
            yield self._pair(*sorted(both)) if len(both) > 1 else self._single(k)
            self._written.update(both)

    def _needs(self, k: int) -> tuple[int, ...]:
        """Operations that must be written before an operation."""
        more = (self._guard[k],) if k in self._guard else ()
        return (*more, *self._steps[k].arguments)

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
            return f"x{step.place[0]}[AT({step.place[1]})]"
        if step.code == ca.OP_CONST:
            return _constant(step.value)
        if step.code in TRUTHS:
            return TRUTHS[step.code].format(*(f"v{a}" for a in step.arguments))
        if k in self._guard:
            base, exponent = map(self._number, step.arguments)
            return f"pow(IF_FELT(v{self._guard[k]}, {base}), {exponent})"
        if step.code in NUMBERS:
            return NUMBERS[step.code].format(*map(self._number, step.arguments))
        raise FmuError(f"{self._name}: there is no C for operation {step.code} of CasADi.")

    def _number(self, k: int) -> str:
        """An operand of arithmetic: a Boolean is an int otherwise."""
        return f"(double)v{k}" if self._steps[k].code in TRUTHS else f"v{k}"


def _constant(value: float) -> str:
    """A constant in C: small integers belong to the equations, others may depend on a vehicle."""
    return f"{value:.0f}." if value == round(value) and abs(value) < 1e6 else f"{value:.16e}"
