"""Which functions of a component its C source calls, and what of them is computed but once."""

import casadi as ca

from twin.component import Component

from .tangents import tangents


def kernels(component: Component, exchange: bool) -> list[ca.Function]:
    """Every function that the C source of a component calls.

    First among them is `prepare`, `p -> c`, of which those that run in every step have an argument
    more than in the component, c after p: what they compute of parameters alone, it has computed
    before. The operations are the same and so are the numbers, to the last bit.

    Args:
        component: Equations and interface.
        exchange: Whether a solver outside may integrate it, beside co-simulation.
    """
    functions = [*prepared(_stepping(component)), component.initial]
    functions += tangents(component, exchange)
    if exchange and component.continuous is not None:
        functions.append(component.continuous.rests)
    return functions


def _stepping(component: Component) -> list[tuple[ca.Function, str]]:
    """What runs in every step, each with its arguments, a letter each."""
    functions = [(component.step, "xuph"), (component.outputs, "xup")]
    sampling = component.sampling
    if sampling is not None:
        functions.append((sampling.update, "xupwd"))
        if sampling.channels:
            functions.append((sampling.sizes, "p"))
        if sampling.lines:
            functions += [(sampling.signals, "xup"), (sampling.delays, "p")]
    for shortcut in component.shortcuts:
        functions += [(shortcut.holds, "xph"), (shortcut.step, "xuph"), (shortcut.outputs, "xup")]
        functions += [] if shortcut.update is None else [(shortcut.update, "xupwd")]
        if shortcut.signals is not None and sampling and sampling.lines:
            functions.append((shortcut.signals, "xup"))
    return functions


def prepared(functions: list[tuple[ca.Function, str]]) -> list[ca.Function]:
    """`prepare` and the functions, what they have of parameters alone taken out into it.

    Args:
        functions: Each with its arguments, a letter each; p are the parameters. A letter stands
            for the same in all of them.
    """
    symbols: dict[str, ca.SX] = {}
    for function, letters in functions:
        for i, letter in enumerate(letters):
            symbols.setdefault(letter, ca.SX.sym(letter, function.size1_in(i)))
    results = [f(*(symbols[k] for k in letters)) for f, letters in functions]
    together = ca.cse(ca.vertcat(*results))
    left, names, known = ca.extract_parametric(together, symbols["p"])
    c = ca.vertcat(ca.SX(0, 1), *names)
    made = [ca.Function("prepare", [symbols["p"]], [ca.densify(ca.vertcat(ca.SX(0, 1), *known))])]
    begin = 0
    for function, letters in functions:
        end = begin + function.size1_out(0)
        arguments = [a for k in letters for a in ([symbols[k], c] if k == "p" else [symbols[k]])]
        made.append(ca.Function(function.name(), arguments, [ca.densify(left[begin:end])]))
        begin = end
    return made
