"""Directional derivatives of the outputs."""

import casadi as ca

from twin.component import Component

from .start import draws, first_state


def tangents(component: Component, exchange: bool) -> list[ca.Function]:
    """`(x, u, p, du, dp) -> dy` while stepping, `(u, p, du, dp, w) -> dy` at the start.

    With `exchange` the first has another argument, the change of the states: `dx`. A component that
    `starts_alike` has the first alone.
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
    """Whether there is one tangent for both: without states nothing is different at the start.

    It is compiled once: that of a learned force takes a compiler twenty seconds.
    """
    return not (component.states or exchange)
