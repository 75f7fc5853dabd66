"""Which functions of a component its C source calls, and what of them is computed but once."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import casadi as ca

from twin.component import Component, Shortcut

from .tangents import starts_alike, tangents

_COSTLY = ("step", "outputs", "update")
"""Functions that take most of a step's time."""
_Stepping = tuple[ca.Function, str]
"""A function that runs in every step, and its arguments, a letter each: x, u, p and so on."""


@dataclass(frozen=True, slots=True)
class Kernels:
    """The functions that the C source of a component calls.

    Attributes:
        functions: First among them `prepare`, `p -> c`, of which those that run in every step have
            an argument more than in the component, c after p: what they compute of parameters
            alone, it has computed before. The operations are the same and so are the numbers, to
            the last bit.
        cheaper: Of `step`, `outputs`, `update` and `signals`, the shortcuts that have another one.
        in_place: Names of those whose result takes the place of the states, their first argument.
        often: Names of those that most steps call: shortcuts, or the full one where there is none.
        seldom: Names of those that no step calls.
        still: Whether a step changes no state.
        starts_alike: Whether the tangent while stepping is that of the start, too.
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
        exchange: Whether a outside solver may integrate it, besides co-simulation.
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
    """What runs in every step, by what it is called here."""
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
    """Whether two functions are the same operations; `one` may do with the first arguments."""
    symbols = [ca.SX.sym(k, other.size1_in(i)) for i, k in enumerate(letters)]
    n = other.size1_out(0)
    both = ca.cse(ca.vertcat(one(*symbols[: one.n_in()]), other(*symbols)))
    return bool(ca.is_equal(both[:n], both[n:]))


def prepared(functions: Sequence[_Stepping]) -> list[ca.Function]:
    """`prepare` and the functions, what they have of parameters alone taken out into it.

    Args:
        functions: Each with its arguments; a letter stands for the same in all of them.
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
