"""Model exchange: a component whose states and derivatives a solver outside sees.

FMI 2.0 chapter 3, FMI 3.0 chapter 3. The outputs of the component get company: states that no
output shows, the derivatives, and the expressions at whose zeros derivatives jump, all of
causality `local`. Co-simulation of the same FMU goes on as before.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import casadi as ca

from twin.component import Component, Continuous, Shortcut, Variable
from twin.errors import FmuError

from .units import rate_unit

PULL_1_S = 10.0
"""Rate at which a state is drawn back to where its projection puts it, 1/s: no solver outside
keeps a quaternion at unit length. Where the projection holds it adds nothing. Made up: slower
than rotors and so never what limits a step, faster than solvers drift."""


@dataclass(frozen=True, slots=True)
class ExchangeState:
    """A continuous state as the importer sees it.

    Attributes:
        place: Among all states of the component.
        name: Of the output, or local variable, that shows it.
        derivative: Name of the variable of its rate of change.
        jumps: Whether an event can change it.
        nominal: A usual size.
    """

    place: int
    name: str
    derivative: str
    jumps: bool
    nominal: float


@dataclass(frozen=True, slots=True)
class Exchange:
    """What model exchange adds to a part.

    Attributes:
        states: In the order of the solver's vector.
        crossings: Names of the event indicators.
        depends: States on which each output and local variable depends.
    """

    states: tuple[ExchangeState, ...]
    crossings: tuple[str, ...]
    depends: dict[str, tuple[str, ...]]


def exchanged(component: Component) -> tuple[Component, Exchange]:
    """A component with its local variables behind its outputs, and what they are.

    Raises:
        FmuError: The component has nothing of what a solver needs.
    """
    continuous = component.continuous
    if continuous is None:
        raise FmuError(f"{component.name}: its equations are not all there for model exchange.")
    x, u, p = component.outputs.sx_in()
    y = component.outputs(x, u, p)
    shown = {
        i: v.name
        for i in continuous.states
        for v, row in zip(component.output_variables, ca.vertsplit(y), strict=True)
        if ca.is_equal(row, x[i])
    }
    hidden = [i for i in continuous.states if i not in shown]
    names = {i: shown.get(i, f"state.{component.states[i].name}") for i in continuous.states}
    states = tuple(
        ExchangeState(i, names[i], f"der({names[i]})", _jumps(component, i), nominal)
        for i, nominal in zip(continuous.states, _nominals(component, continuous), strict=True)
    )
    table = (*component.output_variables, *_local_variables(component, states, hidden))

    def company(name: str, outputs: ca.Function, derivatives: ca.Function) -> ca.Function:
        """Outputs, and behind them what the solver sees."""
        rates = derivatives(x, u, p) + PULL_1_S * (continuous.project(x) - x)
        rows = [x[i] for i in hidden] + [rates[i] for i in continuous.states]
        all_rows = ca.vertcat(outputs(x, u, p), *rows, continuous.crossings(x, u, p))
        return ca.Function(name, [x, u, p], [ca.densify(ca.cse(all_rows))])

    def shortcut(i: int, old: Shortcut) -> Shortcut:
        return replace(old, outputs=company(f"cheap_outputs_{i}", old.outputs, old.derivatives))

    whole = replace(
        component,
        output_variables=table,
        outputs=company("outputs", component.outputs, component.derivatives),
        shortcuts=tuple(shortcut(i, old) for i, old in enumerate(component.shortcuts)),
    )
    exchange = Exchange(
        states,
        tuple(name for name, _, _ in continuous.crossing_names),
        _on_states(whole, states),
    )
    return whole, exchange


def _local_variables(
    component: Component, states: Iterable[ExchangeState], hidden: Iterable[int]
) -> list[Variable]:
    rows = [
        (f"state.{s.name}", s.unit, s.description) for s in (component.states[i] for i in hidden)
    ]
    for state in states:
        of = component.states[state.place]
        meaning = f"Rate of change: {of.description[:1].lower()}{of.description[1:]}"
        rows.append((state.derivative, rate_unit(of.unit), meaning))
    assert component.continuous is not None
    rows += component.continuous.crossing_names
    return [Variable(name, "local", unit, meaning) for name, unit, meaning in rows]


def _jumps(component: Component, place: int) -> bool:
    """Whether a sample instant can change a state that is integrated."""
    if component.sampling is None:
        return False
    arguments = component.sampling.update.sx_in()
    return not ca.is_equal(component.sampling.update(*arguments)[place], arguments[0][place])


def _nominals(component: Component, continuous: Continuous) -> list[float]:
    """Size of each state at its start value, 1 where that is below: of metres, radians, shares."""
    u, p = component.input_values(), component.parameter_values()
    start = component.initial(u, p)
    return [max(1.0, abs(float(start[i]))) for i in continuous.states]


def _on_states(component: Component, states: Iterable[ExchangeState]) -> dict[str, tuple[str, ...]]:
    """By the sparsity of the equations."""
    rows, columns = component.outputs.jac_sparsity(0, 0).get_triplet()
    nonzero = set(zip(rows, columns, strict=True))
    return {
        name: tuple(s.name for s in states if (row, s.place) in nonzero)
        for row, name in enumerate(component.output_names)
    }
