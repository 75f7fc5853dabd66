"""Model of an FMU for the builder: parts with their tables and kernels, and their connections.

In FMI 3, variables that belong together may be one array: `pos` for `pos_x`, `pos_y`, `pos_z`. Its
scalars are consecutive in the table of their part and differ only in an axis or a number, so that
it uses the same memory in C and no computation changes.

For model exchange an external solver uses states and derivatives (FMI 2.0 chapter 3, FMI 3.0
chapter 3). The component has these in addition to its outputs: states that no output shows, the
derivatives, and the expressions at whose zeros derivatives are discontinuous, all of causality
`local`. Co-simulation of the same FMU is unchanged.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile

import casadi as ca
import numpy as np

from twin.component import (
    Causality,
    Component,
    Continuous,
    Enumeration,
    Sampling,
    Shortcut,
    Variable,
    check_starts,
)
from twin.errors import FmuError
from twin.representation import ShortRepr

from .kernels import draws, first_state, kernel_source, kernels
from .names import check_identifier, check_name, check_text, check_variable, rate_unit

PULL_1_S = 10.0
"""Rate at which a state decays to its projection, 1/s: no external solver keeps a quaternion at
unit length. On the projection the term is zero. Made up: slower than rotors, so that it never
limits a step, faster than the drift of solvers."""


@dataclass(frozen=True, slots=True)
class ExchangeState:
    """A continuous state in model exchange.

    Attributes:
        place: Index among all states of the component.
        name: Name of the output, or local variable, with its value.
        derivative: Name of the variable of its derivative.
        jumps: Whether an event can change it.
        nominal: Typical magnitude.
    """

    place: int
    name: str
    derivative: str
    jumps: bool
    nominal: float


@dataclass(frozen=True, slots=True)
class Exchange:
    """Additions to a part for model exchange.

    Attributes:
        states: States in the order of the solver's vector.
        crossings: Names of the event indicators.
        depends: States on which each output and local variable depends.
    """

    states: tuple[ExchangeState, ...]
    crossings: tuple[str, ...]
    depends: dict[str, tuple[str, ...]]


def exchanged(component: Component) -> tuple[Component, Exchange]:
    """A component with its local variables after its outputs, and their description.

    Raises:
        FmuError: The component lacks the functions for a solver.
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
        """Outputs, followed by the quantities for the solver."""
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
    """Magnitude of each state at its start value, at least 1: for metres, radians, shares."""
    u, p = component.input_values(), component.parameter_values()
    start = component.initial(u, p)
    return [max(1.0, abs(float(start[i]))) for i in continuous.states]


def _on_states(component: Component, states: Iterable[ExchangeState]) -> dict[str, tuple[str, ...]]:
    """States on which each output depends, by the sparsity of the equations."""
    rows, columns = component.outputs.jac_sparsity(0, 0).get_triplet()
    nonzero = set(zip(rows, columns, strict=True))
    return {
        name: tuple(s.name for s in states if (row, s.place) in nonzero)
        for row, name in enumerate(component.output_names)
    }


_MEMBER = re.compile(r"(?P<before>.+)_(?P<index>[wxyz]|[1-9][0-9]*)(?P<after>\)?)")
"""Name of a member of a vector."""
_AXES = (("x", "y", "z"), ("w", "x", "y", "z"))  # vector, quaternion


@dataclass(frozen=True, slots=True)
class Entry:
    """A variable of an FMU: a scalar or an array.

    Attributes:
        name: Name of the array, or of the scalar.
        members: Scalars in order.
    """

    name: str
    members: tuple[Variable, ...]

    @property
    def is_array(self) -> bool:
        """Whether it is an array, even of one element."""
        return self.name != self.members[0].name

    @property
    def first(self) -> Variable:
        """The first member, for properties that all have in common."""
        return self.members[0]

    @property
    def description(self) -> str:
        """Description with those of the members: "Position, NED north | east | down"."""
        words = [re.split(r"\b", v.description) for v in self.members]
        if len(words) == 1:
            return self.first.description
        head = _common(words)
        tail = _common([w[head:][::-1] for w in words])
        differ = ["".join(w[head : len(w) - tail]).strip() for w in words]
        before, after = words[0][:head], words[0][len(words[0]) - tail :]
        return "".join(before) + " | ".join(differ) + "".join(after)


def scalars(variables: Iterable[Variable]) -> tuple[Entry, ...]:
    """Every variable as a separate entry."""
    return tuple(Entry(v.name, (v,)) for v in variables)


def arrays(variables: Sequence[Variable], alike: Callable[[Variable], object]) -> tuple[Entry, ...]:
    """Entries with groups of variables as arrays, in the same order.

    Args:
        variables: Variables of an FMU, in order.
        alike: Further properties that must be equal for the members of an array.
    """
    taken = {v.name for v in variables}
    entries: list[Entry] = []
    left = list(variables)
    while left:
        name, size = _begins(left, alike)
        if size == 0 or name in taken:
            name, size = left[0].name, 1
        entries.append(Entry(name, tuple(left[:size])))
        del left[:size]
    return tuple(entries)


def _begins(variables: Sequence[Variable], alike: Callable[[Variable], object]) -> tuple[str, int]:
    """Name and size of the array that begins here; size 0: none."""
    first = variables[0]
    stem = _stem(first)

    def belongs(v: Variable) -> bool:
        return _stem(v) == stem and _facts(v) == _facts(first) and alike(v) == alike(first)

    run = list(takewhile(belongs, variables)) if first.real and stem is not None else []
    indices = tuple(m["index"] for v in run if (m := _MEMBER.fullmatch(v.name)))
    counted = tuple(str(i) for i in range(1, len(run) + 1))
    whole = len(run) > 1 and indices in (*_AXES, counted)
    return stem or "", len(run) if whole else 0


def _stem(v: Variable) -> str | None:
    """Name without axis or number."""
    m = _MEMBER.fullmatch(v.name)
    return None if m is None else m["before"] + m["after"]


def _facts(v: Variable) -> tuple[object, ...]:
    return v.causality, v.unit, v.kind, v.fixed, v.minimum, v.maximum


def _common(rows: Sequence[Sequence[str]]) -> int:
    """Number of leading entries that all rows have in common."""
    return len(list(takewhile(lambda column: len(set(column)) == 1, zip(*rows, strict=False))))


Constant = int | tuple[int, ...] | tuple[float, ...]
"""Value of a macro: a number, or the numbers of an array."""


@dataclass(frozen=True, slots=True)
class Submodel(ShortRepr):
    """One model inside an FMU, a C source file of its own.

    Attributes:
        name: A C identifier.
        variables: Variables in the order of their value references from 1: parameters, inputs,
            outputs.
        dependencies: Inputs on which each output directly depends during simulation.
        initial_dependencies: Inputs and parameters on which each output depends at the end of
            initialisation.
        state_names: Continuous states, for messages.
        max_step_s: Longest internal step.
        glue: File of `fmus/c` with the code around tables and kernels.
        kernels: C source of the kernels.
        apart: Whether the kernels are compiled as a separate file, which also includes the glue.
        defines: Macros of the glue.
        shortcuts: Cheaper kernels that the glue tries, by kernel; None where it has none.
        sampling: Evaluation at sample instants.
        resources: Files it reads.
        folder: Their folder in the resources folder, "" or ending in a slash.
        may_lack: Inputs and outputs that may be NaN; any other NaN stops the simulation.
        held: Real outputs that change only at sample instants.
        exchange: Additions for model exchange; None: co-simulation only.
    """

    name: str
    variables: tuple[Variable, ...]
    dependencies: Mapping[str, tuple[str, ...]]
    initial_dependencies: Mapping[str, tuple[str, ...]]
    state_names: tuple[str, ...]
    max_step_s: float
    glue: str
    kernels: str = ""
    apart: bool = False
    defines: Mapping[str, Constant] = field(default_factory=dict)
    shortcuts: Mapping[str, tuple[int, ...]] | None = None
    sampling: Sampling | None = None
    resources: Mapping[str, bytes] = field(default_factory=dict)
    folder: str = ""
    may_lack: frozenset[str] = frozenset()
    held: frozenset[str] = frozenset()
    exchange: Exchange | None = None

    def of(self, causality: Causality) -> tuple[Variable, ...]:
        """Parameters, inputs, outputs or local variables of the part."""
        return tuple(v for v in self.variables if v.causality == causality)


@dataclass(frozen=True, slots=True)
class FmuModel(ShortRepr):
    """Content of an FMU, independent of the FMI version.

    Names of variables are unique over all parts.

    Attributes:
        name: Model identifier, a C identifier.
        parts: Parts: one, or several joined by `fuse`.
        connections: (output, input), by name.
        order: Indices of parts in an order of evaluation with correct outputs at initialisation.
        step_s: Longest step between two exchanges of values; None for a part alone.
        arrays: Whether groups of scalars are arrays, in FMI 3.
    """

    name: str
    description: str
    parts: tuple[Submodel, ...]
    connections: tuple[tuple[str, str], ...] = ()
    order: tuple[int, ...] = (0,)
    step_s: float | None = None
    arrays: bool = False

    @property
    def entries(self) -> tuple[Entry, ...]:
        """Variables as scalars and arrays, in the order of their value references from 1."""
        if not self.arrays:
            return scalars(self.variables)
        part_of = {v.name: i for i, part in enumerate(self.parts) for v in part.variables}
        states = {s.name for s in self.exchange.states} if self.exchange else set()
        lacking = frozenset[str]().union(*(part.may_lack for part in self.parts))

        def alike(v: Variable) -> object:
            return part_of[v.name], v.name in self.held, v.name in lacking, v.name in states

        return arrays(self.variables, alike)

    @property
    def variables(self) -> tuple[Variable, ...]:
        """Scalars in value-reference order: parameters, unconnected inputs, outputs, locals."""
        connected = {target for _, target in self.connections}
        kinds: tuple[Causality, ...] = ("parameter", "input", "output", "local")
        return tuple(
            v for kind in kinds for p in self.parts for v in p.of(kind) if v.name not in connected
        )

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs, in order."""
        return tuple(v.name for v in self.variables if v.causality == "input")

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the outputs, in order."""
        return tuple(v.name for v in self.variables if v.causality == "output")

    def with_starts(self, starts: Mapping[str, float]) -> "FmuModel":
        """The model with other start values of parameters or inputs.

        Raises:
            ModelError: A name is neither, or a value is outside its range.
        """
        settable = (v for v in self.variables if v.causality in ("parameter", "input"))
        check_starts(self.name, settable, starts)

        def changed(part: Submodel) -> Submodel:
            """The part with its outputs unchanged."""
            table = (replace(v, start=starts.get(v.name, v.start)) for v in part.variables)
            return replace(part, variables=tuple(table))

        return replace(self, parts=tuple(map(changed, self.parts)))

    @property
    def held(self) -> frozenset[str]:
        """Real outputs that change only at sample instants."""
        return frozenset().union(*(part.held for part in self.parts))

    @property
    def enumerations(self) -> tuple[Enumeration, ...]:
        """Enumerations of its variables, each once."""
        kinds = (v.kind for v in self.variables)
        return tuple(dict.fromkeys(k for k in kinds if isinstance(k, Enumeration)))

    @property
    def dependencies(self) -> dict[str, tuple[str, ...]]:
        """Inputs on which each output directly depends; connected ones are held over a step."""
        connected = {target for _, target in self.connections}
        return {
            output: tuple(u for u in inputs if u not in connected)
            for p in self.parts
            for output, inputs in p.dependencies.items()
        }

    @property
    def initial_dependencies(self) -> dict[str, tuple[str, ...]]:
        """Inputs and parameters on which each output depends at the end of initialisation."""
        source = {target: output for output, target in self.connections}
        dependencies: dict[str, dict[str, None]] = {}  # ordered sets
        for part in (self.parts[i] for i in self.order):
            dependencies |= {
                output: {
                    name: None
                    for k in known
                    for name in (dependencies.get(source[k], {}) if k in source else {k: None})
                }
                for output, known in part.initial_dependencies.items()
            }
        return {output: tuple(known) for output, known in dependencies.items()}

    @property
    def resources(self) -> dict[str, bytes]:
        """Files of the resources folder."""
        return {p.folder + name: file for p in self.parts for name, file in p.resources.items()}

    @property
    def exchange(self) -> Exchange | None:
        """Additions for model exchange; None: co-simulation only."""
        return self.parts[0].exchange if len(self.parts) == 1 else None

    @property
    def longest_step_s(self) -> float:
        """Longest internal step, s; the documentation of an FMU shows it."""
        return self.step_s or self.parts[0].max_step_s


def with_real_outputs(model: FmuModel) -> FmuModel:
    """The model with all outputs as real numbers: Booleans as 0 and 1, enumerations by their codes.

    For importers that read all outputs by `fmi2GetReal` or `fmi3GetFloat64`.
    """

    def changed(part: Submodel) -> Submodel:
        """The part; converted outputs change only at sample instants."""
        others = {v.name for v in part.of("output") if not v.real}
        table = tuple(replace(v, kind="real") if v.name in others else v for v in part.variables)
        return replace(part, variables=table, held=part.held | others)

    return replace(model, parts=tuple(map(changed, model.parts)))


def check_interface(model: FmuModel) -> None:
    """Check that names and texts of a model are allowed in an FMU, and each variable occurs once.

    Raises:
        FmuError: One is not allowed.
    """
    check_identifier("model identifier", model.name)
    check_text(f"{model.name}: description", model.description)
    names: set[str] = set()
    for v in (v for part in model.parts for v in part.variables):
        check_variable(f"{model.name}: variable", v.name)
        check_text(f"{model.name}: description of {v.name}", v.description)
        if v.name in names:
            raise FmuError(f"{model.name}: {v.name} is there twice; name each variable once.")
        names.add(v.name)
    _check_enumerations(model)


def _check_enumerations(model: FmuModel) -> None:
    """Check names and items; a name must have the same definition in all parts."""
    types: set[str] = set()
    for kind in model.enumerations:
        check_name(f"{model.name}: enumeration", kind.name)
        for item in kind.items:
            check_name(f"{model.name}: item of {kind.name}", item)
        if kind.name in types:
            raise FmuError(f"{model.name}: two parts mean different values by {kind.name}.")
        types.add(kind.name)


def component_model(component: Component, exchange: bool = False) -> FmuModel:
    """The FMU model of a CasADi component: kernels generated as C.

    Args:
        component: Equations and interface.
        exchange: Whether an external solver may integrate it, in addition to co-simulation.

    Raises:
        FmuError: The component cannot be exchanged.
    """
    offered: Exchange | None = None
    if exchange:
        component, offered = exchanged(component)
    called, dependencies = kernels(component, exchange), _dependencies(component)
    sampled = component.sampling is not None
    part = Submodel(
        name=component.name,
        variables=component.variables,
        dependencies=dependencies,
        initial_dependencies=_initial_dependencies(component),
        state_names=tuple(s.name for s in component.states),
        max_step_s=component.max_step_s,
        glue="casadi.h",
        kernels=kernel_source(called.functions, called.in_place, called.often, called.seldom),
        apart=True,
        defines={
            "N_PREPARED": called.functions[0].size1_out(0),
            "STILL": int(called.still),
            "HOLDS": int(called.still and sampled and not any(dependencies.values())),
            "STARTS_ALIKE": int(called.starts_alike),
        },
        shortcuts=called.cheaper,
        sampling=component.sampling,
        held=_held(component),
        exchange=offered,
    )
    return FmuModel(component.name, component.description, (part,))


def _dependencies(component: Component) -> dict[str, tuple[str, ...]]:
    """Inputs on which each output directly depends, from the sparsity of the equations."""
    pattern = _pattern(component.outputs, 1, len(component.inputs))
    return {
        y: tuple(u for u, hit in zip(component.input_names, row, strict=True) if hit)
        for y, row in zip(component.output_names, pattern, strict=True)
    }


def _held(component: Component) -> frozenset[str]:
    """Real outputs that depend on memory only, by the sparsity of the equations."""
    if component.sampling is None or component.continuous is None:
        return frozenset()
    on_states = _pattern(component.outputs, 0, len(component.states))
    flowing = on_states[:, list(component.continuous.states)].any(axis=1)
    fed = _pattern(component.outputs, 1, len(component.inputs)).any(axis=1)
    held = np.asarray(on_states.any(axis=1) & ~flowing & ~fed)
    return frozenset(v.name for i, v in enumerate(component.output_variables) if held[i] and v.real)


def _initial_dependencies(component: Component) -> dict[str, tuple[str, ...]]:
    """Inputs and parameters on which each output depends at the end of initialisation."""
    u = ca.SX.sym("u", len(component.inputs))
    p = ca.SX.sym("p", len(component.parameters))
    w = draws(component)
    y = component.outputs(first_state(component, u, p, w), u, p)
    f = ca.Function("f", [ca.vertcat(p, u), w], [y])
    names = [v.name for v in component.parameters + component.inputs]
    pattern = _pattern(f, 0, len(names))
    if component.sampling is not None and component.sampling.seed is not None:
        noisy = _pattern(f, 1, component.sampling.channels).any(axis=1)
        pattern[:, names.index(component.sampling.seed)] |= noisy
    return {
        name: tuple(n for n, hit in zip(names, row, strict=True) if hit)
        for name, row in zip(component.output_names, pattern, strict=True)
    }


def _pattern(function: ca.Function, argument: int, width: int) -> np.ndarray:
    sparsity = function.jac_sparsity(0, argument)
    dense = np.zeros((function.size1_out(0), width), dtype=bool)
    rows, columns = sparsity.get_triplet()
    dense[rows, columns] = True
    return dense
