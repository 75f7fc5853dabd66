"""The state at the start as an expression."""

import casadi as ca

from twin.component import Component


def draws(component: Component) -> ca.SX:
    """Symbols of the normal draws at a sample instant."""
    return ca.SX.sym("w", 0 if component.sampling is None else component.sampling.channels)


def first_state(component: Component, u: ca.SX, p: ca.SX, w: ca.SX) -> ca.SX:
    """State at the start, the first sample instant included."""
    x, sampling = component.initial(u, p), component.sampling
    return x if sampling is None else sampling.update(x, u, p, w, sampling.signals(x, u, p))
