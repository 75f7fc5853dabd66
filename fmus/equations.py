"""The equations of a component as readable text with numeric parameters, from the operations of its
C code."""

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from twin.component import Component
from twin.errors import FmuError
from twin.frames import AXES, to_ned

from .kernels import NUMBERS, operations

Array = NDArray[np.float64]
SUM, PRODUCT, SIGN, POWER, ATOM = 1, 2, 3, 4, 5
"""Precedence of an expression; one of lower precedence is put in brackets."""
OPERATORS = {
    ca.OP_ADD: ("{0} + {1}", SUM, SUM, SUM),
    ca.OP_SUB: ("{0} - {1}", SUM, SUM, PRODUCT),
    ca.OP_MUL: ("{0}*{1}", PRODUCT, PRODUCT, PRODUCT),
    ca.OP_DIV: ("{0}/{1}", PRODUCT, PRODUCT, SIGN),
    ca.OP_NEG: ("-{0}", SIGN, SIGN, SIGN),
    ca.OP_SQ: ("{0}^2", POWER, ATOM, ATOM),
    ca.OP_TWICE: ("2*{0}", PRODUCT, PRODUCT, PRODUCT),
    ca.OP_INV: ("1/{0}", PRODUCT, SIGN, SIGN),
    ca.OP_POW: ("{0}^{1}", POWER, ATOM, ATOM),
    ca.OP_CONSTPOW: ("{0}^{1}", POWER, ATOM, ATOM),
    ca.OP_LT: ("{0} < {1}", 0, SUM, SUM),
    ca.OP_LE: ("{0} <= {1}", 0, SUM, SUM),
    ca.OP_EQ: ("{0} == {1}", 0, SUM, SUM),
    ca.OP_NE: ("{0} != {1}", 0, SUM, SUM),
    ca.OP_NOT: ("not {0}", 0, ATOM, ATOM),
    ca.OP_AND: ("{0} and {1}", 0, SUM, SUM),
    ca.OP_OR: ("{0} or {1}", 0, SUM, SUM),
    ca.OP_IF_ELSE_ZERO: ("({1} if {0} else 0)", ATOM, SUM, SUM),
}
"""Pattern, precedence of the result, and the least precedence of each argument."""
FUNCTIONS = {
    code: pattern.partition("(")[0]
    for code, pattern in NUMBERS.items()
    if re.fullmatch(r"\w+\(.*\)", pattern) and code not in OPERATORS
} | {ca.OP_FMAX: "max", ca.OP_FMIN: "min", ca.OP_SIGN: "sign", ca.OP_FABS: "abs"}
"""Names of the other operations: those of C, except for those written as conditions in C."""
CONTACT = "ground.enabled"
"""Parameter of the airframe that enables ground contact."""
LEAVES = (ca.OP_INPUT, ca.OP_CONST)  # operations without arguments


@dataclass(frozen=True, slots=True)
class Equation:
    """One line of the equations.

    Attributes:
        left: Left side: a state's derivative, an output, or a shared part `t1`, `t2`, ...
        right: The expression.
        unit: Unit, "" for a shared part.
        description: Description, "" for a shared part.
    """

    left: str
    right: str
    unit: str = ""
    description: str = ""


def equations_of(
    component: Component, values: Mapping[str, float] | None = None, contact: bool = False
) -> list[Equation]:
    """Outputs and derivatives of a component as functions of states and inputs.

    Parameters are numbers: start values, with changes by `values`. A part that several equations
    share is a separate line in front of them; where it is an output, or an element of the rotation
    matrix from body to NED, its name is used.

    Args:
        component: Component with the equations.
        values: Parameters that differ from their start values.
        contact: Whether ground contact is included; else the equations are those in flight.

    Raises:
        FmuError: An operation is not supported.
        ModelError: A name of `values` is no parameter.
    """
    symbols, given = _Symbols(component), dict(values or {})
    if not contact and any(v.name == CONTACT for v in component.parameters):
        given = {CONTACT: 0.0} | given
    p = component.parameter_values(given)
    x = _without_constants(component, symbols, p)
    changes = _changes(component, symbols, x, p)
    turned = _rotation([s.name for s in component.states], x)
    outputs = component.outputs(x, symbols.u, p)
    # One graph without repetitions: equal expressions have one name.
    every = ca.cse(ca.densify(ca.vertcat(*turned.values(), outputs, *changes.values())))
    defined = [
        *((name, "1", "rotation from body to NED") for name in turned),
        *((v.name, v.unit, v.description) for v in component.output_variables),
        *((f"d {s.name}/dt", _rate_unit(s.unit), s.description) for s in component.states),
        *((f"next {s.name}", s.unit, s.description) for s in component.states),
    ]
    function = ca.Function("equations", symbols.all, [every])
    return _Text(function, symbols.names, defined[: every.numel()]).lines()


class _Symbols:
    """Symbols of the equations: states, inputs, noise draws, delayed signals."""

    def __init__(self, component: Component) -> None:
        sampling = component.sampling
        lines = () if sampling is None else sampling.lines
        draws = 0 if sampling is None else sampling.channels
        self.names = (
            [s.name for s in component.states],
            component.input_names,
            [f"noise{i}" for i in range(1, draws + 1)],
            [f"{line.name} before its delay" for line in lines],
        )
        self.all = [ca.SX.sym("v", len(names)) for names in self.names]
        self.x, self.u, self.w, self.d = self.all


def _changes(component: Component, symbols: _Symbols, x: ca.SX, p: Array) -> dict[str, ca.SX]:
    """Derivatives of the states and, for a sampled component, their values after a sample
    instant."""
    found = {"d": component.derivatives(x, symbols.u, p)}
    if component.sampling is not None:
        update = component.sampling.update
        found["next"] = update(x, symbols.u, p, symbols.w, symbols.d)
    return found


def _without_constants(component: Component, symbols: _Symbols, p: Array) -> ca.SX:
    """States, with those that never change replaced by their initial values."""
    x, initial = ca.SX(symbols.x), component.initial(symbols.u, p)
    while True:
        changes = _changes(component, symbols, x, p)
        constant = [
            i
            for i in range(x.numel())
            if not x[i].is_constant()
            and initial[i].is_constant()
            and changes["d"][i].is_zero()
            and all(
                ca.is_equal(after[i], x[i]) or ca.is_equal(after[i], initial[i])
                for name, after in changes.items()
                if name == "next"
            )
        ]
        if not constant:
            return x
        for i in constant:
            x[i] = initial[i]


def _rotation(states: Sequence[str], x: ca.SX) -> dict[str, ca.SX]:
    """Elements of the rotation matrix from body to NED by name, where the attitude is a state."""
    if "q_w" not in states:
        return {}
    q = [x[states.index(f"q_{a}")] for a in "wxyz"]
    axes = [[ca.SX(float(a == b)) for b in AXES] for a in AXES]
    columns = {b: to_ned(q, axis) for b, axis in zip(AXES, axes, strict=True)}
    return {f"R_{a}{b}": columns[b][i] for i, a in enumerate(AXES) for b in AXES}


class _Text:
    """Operations as text; each result that is used more than once gets a name.

    Args:
        function: Function of states and inputs, with all defined quantities as one result.
        leaves: Names of states and inputs.
        defined: Name, unit and description of each element of the result.
    """

    def __init__(
        self,
        function: ca.Function,
        leaves: Sequence[Sequence[str]],
        defined: Sequence[tuple[str, str, str]],
    ) -> None:
        self._steps, self._results = operations(function)
        self._leaves, self._defined = leaves, defined
        self._names: dict[int, str] = {}
        self._lines: list[Equation] = []
        self._parts = 0
        self._of: dict[int, tuple[str, str, str]] = {}
        for k, row in zip(self._results, defined, strict=True):
            if self._steps[k].code not in LEAVES and not _state_of(row[0]):
                self._of.setdefault(k, row)
        used = Counter(a for k in self._below(self._results) for a in self._steps[k].arguments)
        self._shared = {k for k, n in used.items() if n > 1 and not self._short(k)}

    def lines(self) -> list[Equation]:
        """One line for each non-trivial result, shared parts before their uses.

        Omitted: `pos_x = pos_x`, constant states, and those on which nothing depends.
        """
        needed = self._needed()
        for row, k in zip(self._defined, self._results, strict=True):
            state = _state_of(row[0])
            if state and state not in needed:
                continue
            if state and self._rests(k, state, row[0]):
                continue
            text, _ = self._term(k)
            if text != row[0]:
                self._lines.append(Equation(row[0], text, *row[1:]))
        return self._lines

    def _needed(self) -> set[str]:
        """States on which an output depends, directly or through other states."""
        found: set[str] = set()
        more = {
            k for k, row in zip(self._results, self._defined, strict=True) if not _state_of(row[0])
        }
        while more:
            names = self._states_in(more) - found
            found |= names
            more = {
                k
                for k, row in zip(self._results, self._defined, strict=True)
                if _state_of(row[0]) in names
            }
        return found

    def _states_in(self, results: Iterable[int]) -> set[str]:
        """States among the leaves of some expressions."""
        below = (self._steps[k] for k in self._below(results))
        inputs = (s.place for s in below if s.code == ca.OP_INPUT)
        return {self._leaves[0][place] for which, place in inputs if which == 0}

    def _below(self, results: Iterable[int]) -> set[int]:
        """Some expressions and all their operands."""
        found, stack = set(results), list(results)
        while stack:
            for k in set(self._steps[stack.pop()].arguments) - found:
                found.add(k)
                stack.append(k)
        return found

    def _rests(self, k: int, state: str, name: str) -> bool:
        """Whether a derivative is zero, or the next value equals the present one."""
        step = self._steps[k]
        if name.startswith("d "):
            return step.code == ca.OP_CONST and step.value == 0
        return step.code == ca.OP_INPUT and self._leaves[step.place[0]][step.place[1]] == state

    def _short(self, k: int) -> bool:
        """Whether it is no longer than a name: a sign, or an operation on two leaves."""
        step = self._steps[k]
        return all(self._steps[a].code in LEAVES for a in step.arguments) or step.code == ca.OP_NEG

    def _term(self, k: int) -> tuple[str, int]:
        """Text of a value, and its precedence."""
        if k in self._names:
            return self._names[k], ATOM
        text, strength = self._expression(k)
        if k in self._of:
            name, unit, description = self._of[k]
        elif k in self._shared:
            self._parts += 1
            name, unit, description = f"t{self._parts}", "", ""
        else:
            return text, strength
        self._names[k] = name
        self._lines.append(Equation(name, text, unit, description))
        return name, ATOM

    def _expression(self, k: int) -> tuple[str, int]:
        step = self._steps[k]
        if step.code == ca.OP_INPUT:
            which, place = step.place
            return self._leaves[which][place], ATOM
        if step.code == ca.OP_CONST:
            return _number(step.value), SIGN if step.value < 0 else ATOM
        terms = [self._term(a) for a in step.arguments]
        if step.code in FUNCTIONS:
            return f"{FUNCTIONS[step.code]}({', '.join(text for text, _ in terms)})", ATOM
        if step.code not in OPERATORS:
            raise FmuError(f"operation {step.code} of CasADi cannot be written as text.")
        pattern, strength, *least = OPERATORS[step.code]
        parts = [
            text if holds >= needs else f"({text})"
            for (text, holds), needs in zip(terms, least, strict=False)
        ]
        return pattern.format(*parts), strength


def _state_of(name: str) -> str:
    """The state of a derivative or next value; "" for an output."""
    if name.startswith("d "):
        return name.removeprefix("d ").removesuffix("/dt")
    return name.removeprefix("next ") if name.startswith("next ") else ""


def _rate_unit(unit: str) -> str:
    """Unit of a derivative: m/s for m, m/s2 for m/s."""
    whole, _, power = unit.partition("/s")
    if unit.endswith("/s") or (power.isdigit() and unit.endswith(power)):
        return f"{whole}/s{int(power or 1) + 1}"
    return f"{unit}/s"


def _number(value: float) -> str:
    return f"{value:.6g}"
