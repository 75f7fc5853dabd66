"""Builder of components: symbols and equations collected in reading order.

`ComponentBuilder` is the authoring side of `twin.component`: it returns CasADi symbols, collects
equations, and converts both to a `Component`.
"""

import pickle
import threading
import zlib
from collections.abc import Callable, Iterable, Sequence

import casadi as ca

from ..errors import ModelError
from .component import (
    LARGEST_INTEGER,
    Component,
    Continuous,
    DelayLine,
    Kind,
    Sampling,
    Shortcut,
    State,
    Variable,
    check_range,
)

BUILT = 8
"""Number of cached components per thread."""


class _Built(threading.local):
    """Components that one thread has built recently, with their parts: threads do not share
    CasADi's functions."""

    def __init__(self) -> None:
        self.found: dict[tuple[object, ...], tuple[Component, Sequence[object]]] = {}


_BUILT = _Built()


def built_once(
    build: Callable[..., Component], parts: Sequence[object], *given: object
) -> Component:
    """Result of `build(parts, *given)`, cached for recent arguments.

    Args:
        build: Function of a module.
        parts: Arguments that are compared by identity.
        given: Arguments that are compared by value.
    """
    key = build, pickle.dumps(given), *map(id, parts)
    if key not in _BUILT.found:
        made = build(parts, *given), parts
        while len(_BUILT.found) >= BUILT:
            del _BUILT.found[next(iter(_BUILT.found))]
        _BUILT.found[key] = made
    return _BUILT.found[key][0]


class ComponentBuilder:
    """Collects the interface table and the equations of one component, in reading order."""

    def __init__(self, name: str, description: str, max_step_s: float = 1e-3) -> None:
        self._name, self._description, self._max_step_s = name, description, max_step_s
        self._variables: dict[str, tuple[Variable, ca.SX]] = {}
        self._states: dict[str, tuple[State, ca.SX, ca.SX]] = {}
        self._rates: dict[str, ca.SX] = {}
        self._projections: dict[str, ca.SX] = {}
        self._idle: list[tuple[ca.SX, ca.SX, Sequence[ca.SX]]] = []
        self._flags: list[tuple[ca.SX, ca.SX]] = []
        self._updates: dict[str, ca.SX] = {}
        self._period: str | None = None
        self._noise: list[tuple[ca.SX, ca.SX]] = []
        self._delayed: list[tuple[DelayLine, ca.SX, ca.SX, ca.SX]] = []
        self._crossings: list[tuple[tuple[str, str, str], ca.SX]] = []
        self._rests: ca.SX | None = None

    def parameter(
        self,
        name: str,
        start: float,
        unit: str,
        description: str,
        *,
        minimum: float | None = None,
        maximum: float | None = None,
        fixed: bool = False,
        kind: Kind = "real",
    ) -> ca.SX:
        """Declare a parameter and return its symbol."""
        variable = Variable(
            name, "parameter", unit, description, start, minimum, maximum, fixed, kind
        )
        check_range(self._name, variable, start)
        return self._declare(variable, ca.SX.sym(name))

    def input(
        self,
        name: str,
        unit: str,
        description: str,
        start: float = 0.0,
        *,
        kind: Kind = "real",
        nominal: float | None = None,
    ) -> ca.SX:
        """Declare an input and return its symbol."""
        variable = Variable(name, "input", unit, description, start, kind=kind, nominal=nominal)
        return self._declare(variable, ca.SX.sym(name))

    def output(
        self,
        name: str,
        unit: str,
        description: str,
        expression: ca.SX | float,
        *,
        kind: Kind = "real",
    ) -> None:
        """Declare an output and its equation."""
        self._declare(Variable(name, "output", unit, description, kind=kind), ca.SX(expression))

    def state(self, name: str, unit: str, description: str, initial: ca.SX | float) -> ca.SX:
        """Declare a state with its initial value: an expression of inputs, parameters, and other
        states."""
        symbol = ca.SX.sym(name)
        self._states[name] = (State(name, unit, description), symbol, ca.SX(initial))
        return symbol

    def derivative(self, name: str, rate: ca.SX | float) -> None:
        """Give the time derivative of a state."""
        self._rates[name] = ca.SX(rate)

    def projection(self, name: str, expression: ca.SX) -> None:
        """Replace a state after each step by an expression of the states."""
        self._projections[name] = expression

    def sampled(self, period_s: float, description: str) -> ca.SX:
        """Make the component sampled, with the parameter `sample_period`.

        A component that draws noise gets the parameter `seed` next to it.

        Returns:
            Symbol of the sample period, s.
        """
        self._period = "sample_period"
        period = self.parameter(
            "sample_period", period_s, "s", description, minimum=1e-5, fixed=True
        )
        self.parameter(
            "seed",
            0.0,
            "1",
            "Seed of the noise",
            minimum=0,
            maximum=LARGEST_INTEGER,
            fixed=True,
            kind="integer",
        )
        return period

    def memory(self, name: str, unit: str, description: str, initial: ca.SX | float = 0.0) -> ca.SX:
        """Declare a state that changes only at sample instants."""
        return self.state(name, unit, description, initial)

    def update(self, name: str, expression: ca.SX | float) -> None:
        """Give the value of a memory from each sample instant on."""
        self._updates[name] = ca.SX(expression)

    def noise(self, size: ca.SX | float = 1.0) -> ca.SX:
        """A normal draw, new at each sample instant; for use in updates.

        Args:
            size: Standard deviation, an expression of parameters; channels with standard deviation
                zero are not drawn.
        """
        symbol = ca.SX.sym(f"noise_{len(self._noise)}")
        self._noise.append((symbol, ca.SX(size)))
        return size * symbol

    def delayed(self, name: str, signal: ca.SX, delay_s: ca.SX, samples: int) -> ca.SX:
        """Delayed signal at each sample instant; for use in updates.

        The signal is interpolated linearly between sample instants, and constant before the start.

        Args:
            name: Name of the delay, for messages.
            signal: Scalar expression of states, inputs and parameters, evaluated before the update.
            delay_s: Expression of parameters, s, from 0 to `samples` - 1 sample periods; any other
                value stops the simulation.
            samples: Number of stored samples, including the present one.

        Returns:
            Symbol of the delayed signal.

        Raises:
            ModelError: `samples` is below 1.
        """
        if samples < 1:
            raise ModelError(
                f"{self._name}: delay {name!r} needs at least 1 sample, not {samples}."
            )
        symbol = ca.SX.sym(f"delayed_{name}")
        line = DelayLine(name, samples)
        self._delayed.append((line, ca.SX(signal), ca.SX(delay_s), symbol))
        return symbol

    def flag(self, name: str, condition: ca.SX) -> ca.SX:
        """A Boolean that `idle_while` may use as a switch, in outputs and rates.

        Args:
            name: Name of the symbol.
            condition: Expression of states, inputs and parameters.
        """
        symbol = ca.SX.sym(name)
        self._flags.append((symbol, condition))
        return symbol

    def idle_while(self, condition: ca.SX, step: ca.SX, switches: Sequence[ca.SX]) -> None:
        """Declare when parameters or flags that enable equations have the same effect as 0.

        With several calls, the first condition that is true is used.

        Args:
            condition: Expression of states, parameters and `step`.
            step: Symbol of the step length, s; 0 for outputs.
            switches: Symbols of the parameters or flags.
        """
        self._idle.append((condition, step, switches))

    def crossing(self, name: str, unit: str, description: str, expression: ca.SX) -> None:
        """Declare that derivatives jump where an expression of states and parameters changes sign.

        Solvers with variable steps locate the instant; the expression must not be identically 0.
        """
        self._crossings.append(((name, unit, description), ca.SX(expression)))

    def rests_while(self, condition: ca.SX) -> None:
        """Declare, by an expression of parameters, when sample instants have no effect."""
        self._rests = condition

    def build(self) -> Component:
        """Convert the collected equations to a component."""
        if self._period is not None and not self._noise:
            self._variables.pop("seed", None)
        table = {
            c: [(v, e) for v, e in self._variables.values() if v.causality == c]
            for c in ("parameter", "input", "output")
        }
        x = _column(symbol for _, symbol, _ in self._states.values())
        u = _column(symbol for _, symbol in table["input"])
        p = _column(symbol for _, symbol in table["parameter"])
        x0 = _column(initial for _, _, initial in self._states.values())
        x0 = ca.substitute(x0, x, x0)  # a state that starts at the value of another one
        rates = _column(self._rates.get(name, ca.SX(0)) for name in self._states)
        projected = _column(
            self._projections.get(name, symbol) for name, (_, symbol, _) in self._states.items()
        )
        y = _column(expression for _, expression in table["output"])
        flagged = [rates, y]
        rates, y = self._unflagged(flagged)
        project = ca.Function("project", [x], [projected])
        f = ca.Function("derivatives", [x, u, p], [ca.cse(rates)], ["x", "u", "p"], ["dx"])

        sampling = self._sampling(x, u, p)

        def shortcut(
            i: int, condition: ca.SX, length: ca.SX, switches: Sequence[ca.SX]
        ) -> Shortcut:
            """Functions of the component with some switches at zero."""
            on, off = list(switches), [ca.SX(0.0)] * len(switches)
            dx, cheap_y = self._unflagged(ca.substitute(flagged, on, off))
            cheap = ca.Function("f", [x, u, p], [ca.cse(dx)])
            update = signals = None
            if sampling is not None:
                after, now = ca.substitute([self._after(), self._signals()], on, off)
                update = self._update(f"cheap_update_{i}", after, x, u, p)
                signals = ca.Function(f"cheap_signals_{i}", [x, u, p], [ca.cse(now)])
            return Shortcut(
                holds=ca.Function(f"holds_{i}", [x, p, length], [condition]),
                step=_rk4(f"cheap_step_{i}", cheap, project),
                outputs=ca.Function(f"cheap_outputs_{i}", [x, u, p], [ca.cse(cheap_y)]),
                update=update,
                signals=signals,
                derivatives=cheap,
            )

        return Component(
            name=self._name,
            description=self._description,
            parameters=tuple(v for v, _ in table["parameter"]),
            inputs=tuple(v for v, _ in table["input"]),
            output_variables=tuple(v for v, _ in table["output"]),
            states=tuple(state for state, _, _ in self._states.values()),
            initial=ca.Function("initial", [u, p], [ca.cse(x0)], ["u", "p"], ["x"]),
            derivatives=f,
            step=_rk4("step", f, project),
            outputs=ca.Function("outputs", [x, u, p], [ca.cse(y)], ["x", "u", "p"], ["y"]),
            max_step_s=self._max_step_s,
            shortcuts=tuple(shortcut(i, *idle) for i, idle in enumerate(self._idle)),
            sampling=sampling,
            continuous=Continuous(
                states=tuple(i for i, name in enumerate(self._states) if name in self._rates),
                project=project,
                crossings=ca.Function("z", [x, u, p], [_column(z for _, z in self._crossings)]),
                crossing_names=tuple(about for about, _ in self._crossings),
                rests=ca.Function("rests", [p], [self._resting()]),
            ),
        )

    def _unflagged(self, expressions: list[ca.SX]) -> list[ca.SX]:
        """Expressions with the flags' symbols replaced by their conditions."""
        if not self._flags:
            return expressions
        symbols, conditions = zip(*self._flags, strict=True)
        return list(ca.substitute(expressions, list(symbols), list(conditions)))

    def _resting(self) -> ca.SX:
        """Whether sample instants have no effect: never, unless declared."""
        if self._rests is not None:
            return self._rests
        return ca.SX(self._period is None)

    def _sampling(self, x: ca.SX, u: ca.SX, p: ca.SX) -> Sampling | None:
        if self._period is None:
            if self._updates or self._noise or self._delayed:
                raise ModelError(f"{self._name}: updates need a sample period: call sampled().")
            return None
        signals = self._signals()
        delays = _column(delay for _, _, delay, _ in self._delayed)
        sizes = _column(size for _, size in self._noise)
        return Sampling(
            period=self._period,
            seed="seed" if self._noise else None,
            channels=len(self._noise),
            sizes=ca.Function("noise_sizes", [p], [ca.cse(sizes)], ["p"], ["sd"]),
            stream=zlib.crc32(self._name.encode()),
            lines=tuple(line for line, *_ in self._delayed),
            signals=ca.Function("signals", [x, u, p], [ca.cse(signals)], ["x", "u", "p"], ["s"]),
            delays=ca.Function("delays", [p], [ca.cse(delays)], ["p"], ["s"]),
            update=self._update("update", self._after(), x, u, p),
        )

    def _signals(self) -> ca.SX:
        """Inputs of the delay lines."""
        return _column(signal for _, signal, _, _ in self._delayed)

    def _after(self) -> ca.SX:
        """States after a sample instant."""
        return _column(
            self._updates.get(name, symbol) for name, (_, symbol, _) in self._states.items()
        )

    def _update(self, name: str, after: ca.SX, x: ca.SX, u: ca.SX, p: ca.SX) -> ca.Function:
        w = _column(symbol for symbol, _ in self._noise)
        d = _column(symbol for _, _, _, symbol in self._delayed)
        arguments = [x, u, p, w, d]
        return ca.Function(name, arguments, [ca.cse(after)], ["x", "u", "p", "w", "d"], ["x_next"])

    def _declare(self, variable: Variable, expression: ca.SX) -> ca.SX:
        if variable.name in self._variables:
            raise ModelError(f"{self._name}: {variable.name!r} is declared twice.")
        self._variables[variable.name] = (variable, expression)
        return expression


def _column(parts: Iterable[ca.SX]) -> ca.SX:
    parts = list(parts)
    # Dense: C source would omit the entries that are constant zero, and pack the others.
    return ca.densify(ca.vertcat(*parts)) if parts else ca.SX(0, 1)


def _rk4(name: str, f: ca.Function, project: ca.Function) -> ca.Function:
    """`(x, u, p, h) -> x`: one classical Runge-Kutta step of fourth order, then the projection."""
    x, u, p = f.sx_in()
    h = ca.SX.sym("h")
    k1 = f(x, u, p)
    k2 = f(x + h / 2 * k1, u, p)
    k3 = f(x + h / 2 * k2, u, p)
    k4 = f(x + h * k3, u, p)
    x_next = ca.cse(project(x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)))
    return ca.Function(name, [x, u, p, h], [x_next], ["x", "u", "p", "h"], ["x_next"])
