"""Fusion of several components into one FMU: the parts are stepped inside, without a master."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from graphlib import CycleError, TopologicalSorter

from twin.component import Component, Enumeration, Sampling, Variable, unknown_name
from twin.errors import FmuError

from .model import FmuModel, Submodel, component_model
from .names import IDENTIFIER
from .order import visits


def fuse(
    name: str,
    description: str,
    parts: Mapping[str, FmuModel | Component],
    connections: Iterable[tuple[str, str]],
    step_s: float = 1e-3,
) -> FmuModel:
    """One FMU model of connected parts.

    Every parameter, every output and every input without a connection becomes a variable of the
    FMU, named "part.variable". A communication step is divided into equal steps of at most
    `step_s`; in each, all parts step with their inputs held, then their outputs are copied along
    the connections. The results equal those of the co-simulation of one FMU per part by the Jacobi
    algorithm at that step, to the last bit. Therefore the noise of a part depends on its component
    only: two parts of one component draw the same numbers unless their seeds differ.

    Args:
        name: Model identifier, a C identifier.
        description: Description in one line.
        parts: Components, or models of one part, by a name that is a C identifier.
        connections: ("part.output", "part.input") pairs.
        step_s: Longest step between two exchanges of values.

    Raises:
        FmuError: A name is invalid or unknown, a connection is not from an output to a free input
            of the same unit, outputs depend on themselves, or two parts would draw the same noise.
    """
    if not step_s > 0 or step_s == float("inf"):
        raise FmuError(f"{name}: step {step_s:g} s must be positive, e.g. 0.001.")
    for identifier in (name, *parts):
        if not IDENTIFIER.fullmatch(identifier):
            raise FmuError(f"{name}: {identifier!r} is no C identifier; use letters, digits and _.")
    renamed = tuple(_renamed(name, key, part) for key, part in parts.items())
    connected = tuple(connections)
    _check_connections(name, renamed, connected)
    _check_noise(name, renamed)
    order = _order(name, renamed, {target: source for source, target in connected})
    return FmuModel(name, description, renamed, connected, order, step_s)


def _renamed(owner: str, name: str, of: FmuModel | Component) -> Submodel:
    """The part under a new name, also in its variables, states and files."""
    model = component_model(of) if isinstance(of, Component) else of
    if len(model.parts) > 1:
        raise FmuError(f"{owner}: {name} is fused already; give its parts instead.")
    (part,) = model.parts
    if part.exchange is not None:
        raise FmuError(f"{owner}: {name} is for model exchange; give it for co-simulation alone.")

    def under(names: Mapping[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
        return {f"{name}.{k}": tuple(f"{name}.{v}" for v in values) for k, values in names.items()}

    return replace(
        part,
        name=name,
        variables=tuple(replace(v, name=f"{name}.{v.name}") for v in part.variables),
        dependencies=under(part.dependencies),
        initial_dependencies=under(part.initial_dependencies),
        state_names=tuple(f"{name}.{s}" for s in part.state_names),
        sampling=None if part.sampling is None else _renamed_sampling(name, part.sampling),
        folder=f"{name}/",
        may_lack=frozenset(f"{name}.{v}" for v in part.may_lack),
        held=frozenset(f"{name}.{v}" for v in part.held),
    )


def _renamed_sampling(name: str, sampling: Sampling) -> Sampling:
    return replace(
        sampling,
        period=f"{name}.{sampling.period}",
        seed=None if sampling.seed is None else f"{name}.{sampling.seed}",
        lines=tuple(replace(line, name=f"{name}.{line.name}") for line in sampling.lines),
    )


def _check_connections(
    owner: str, parts: Iterable[Submodel], connections: Iterable[tuple[str, str]]
) -> None:
    """Check that names are known, connections go from an output to an input, with one source each
    and equal units."""
    variables = {v.name: v for part in parts for v in part.variables}
    seen: set[str] = set()
    for source, target in connections:
        for end in (source, target):
            if end not in variables:
                raise FmuError(unknown_name(owner, "variable", end, variables))
        a, b = variables[source], variables[target]
        if (a.causality, b.causality) != ("output", "input"):
            raise FmuError(
                f"{owner}: {source} ({a.causality}) -> {target} ({b.causality}): "
                f"a connection goes from an output to an input."
            )
        if a.unit != b.unit:
            raise FmuError(f"{owner}: {source} [{a.unit}] -> {target} [{b.unit}]: units differ.")
        if not _same_kind(a, b):
            raise FmuError(
                f"{owner}: {source} ({a.kind_name}) -> {target} ({b.kind_name}): kinds differ."
            )
        if target in seen:
            raise FmuError(f"{owner}: {target} has two sources; an input takes one.")
        seen.add(target)


def _same_kind(source: Variable, target: Variable) -> bool:
    """Whether a value has the same meaning at both ends; the enumeration of the target may have
    further items."""
    a, b = source.kind, target.kind
    if isinstance(a, Enumeration) and isinstance(b, Enumeration):
        return a.items == b.items[: len(a.items)]
    return a == b


def _check_noise(owner: str, parts: Iterable[Submodel]) -> None:
    """Check that no two parts have equal stream and seed."""
    drawn: dict[tuple[int, float], str] = {}
    for part in parts:
        if part.sampling is None or part.sampling.seed is None:
            continue
        (seed,) = (v for v in part.variables if v.name == part.sampling.seed)
        other = drawn.setdefault((part.sampling.stream, seed.start), part.name)
        if other != part.name:
            raise FmuError(
                f"{owner}: {other} and {part.name} are the same component with the same seed "
                f"{seed.start:g} and would draw the same noise: start one with another seed."
            )


def _order(owner: str, parts: tuple[Submodel, ...], source: Mapping[str, str]) -> tuple[int, ...]:
    """Order of evaluation of parts after which every output is correct, at initialisation and while
    stepping.

    A part occurs twice where some of its outputs are needed before its inputs are known.
    """
    dependencies = {
        output: {source[u] for u in (*direct, *part.initial_dependencies[output]) if u in source}
        for part in parts
        for output, direct in part.dependencies.items()
    }
    try:
        TopologicalSorter(dependencies).prepare()
    except CycleError as error:
        raise FmuError(
            f"{owner}: algebraic loop: {' -> '.join(error.args[1])}, each depending on the one "
            f"before it within an instant. Put a state between two of them."
        ) from None
    index = {part.name: i for i, part in enumerate(parts)}
    mute = (i for i, part in enumerate(parts) if not part.dependencies)
    return (*(index[v] for v in visits(dependencies) if isinstance(v, str)), *mute)
