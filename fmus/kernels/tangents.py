"""Directional derivatives of the outputs."""

import casadi as ca

from twin.component import Component

from .start import draws, first_state


def tangents(component: Component, exchange: bool) -> list[ca.Function]:
    """`(x, u, p, du, dp) -> dy` while stepping, `(u, p, du, dp, w) -> dy` at the start.

    With `exchange` the first has another argument, the change of the states: `dx`.
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

    if not (component.states or exchange):
        always = tangent("tangent", x, [x, u, p, du, dp], [u, p], [du, dp])
        return [always, _the_same("initial_tangent", always)]
    first, d = first_state(component, u, p, w), [du, dp]
    starting = tangent("initial_tangent", first, [u, p, *d, w], [u, p], d)
    if exchange:
        return [tangent("tangent", x, [x, u, p, *d, dx], [u, p, x], [*d, dx]), starting]
    return [tangent("tangent", x, [x, u, p, *d], [u, p], d), starting]


def _the_same(name: str, tangent: ca.Function) -> ca.Function:
    """The tangent of a component without states as that of its start.

    It is called, not written again: that of a learned force takes a compiler twenty seconds.
    """
    nothing, *arguments = [ca.MX.sym(n, tangent.size1_in(i)) for i, n in enumerate("xupcd")]
    draws = ca.MX.sym("w", 0)
    (dy,) = tangent.call([ca.MX(nothing.shape[0], 1), *arguments])
    return ca.Function(name, [*arguments, draws], [dy])
