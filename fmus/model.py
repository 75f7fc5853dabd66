"""What the builder turns into an FMU: an interface table, dependencies and C source."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources

import casadi as ca
import numpy as np

from twin.component import Component, Variable


@dataclass(frozen=True, slots=True)
class FmuModel:
    """Everything an FMU holds, apart from the FMI version it speaks.

    Attributes:
        name: Model identifier, a C identifier.
        variables: In value-reference order from 1 on: parameters, inputs, outputs.
        dependencies: Inputs on which each output directly depends during simulation.
        initial_dependencies: Inputs and parameters on which each output depends at the end of
            initialisation.
        state_names: Continuous states, for messages.
        defines: Further lines of `model.h`.
        source: C source of the model, `model.c` without its tables.
        headers: Further C headers, by file name.
        max_step_s: Longest internal step.
        resources: Files of the resources folder.
    """

    name: str
    description: str
    variables: tuple[Variable, ...]
    dependencies: Mapping[str, tuple[str, ...]]
    initial_dependencies: Mapping[str, tuple[str, ...]]
    state_names: tuple[str, ...]
    source: str
    max_step_s: float
    headers: Mapping[str, str] = field(default_factory=dict)
    defines: Mapping[str, int] = field(default_factory=dict)
    resources: Mapping[str, bytes] = field(default_factory=dict)


def component_model(component: Component) -> FmuModel:
    """The FMU model of a CasADi component: kernels generated as C."""
    kernels = _kernels(component)
    return FmuModel(
        name=component.name,
        description=component.description,
        variables=component.variables,
        dependencies=_dependencies(component),
        initial_dependencies=_initial_dependencies(component),
        state_names=tuple(s.name for s in component.states),
        source=(resources.files(__package__) / "c" / "casadi.c").read_text(),
        headers={"kernels.h": _kernel_header(kernels)},
        max_step_s=component.max_step_s,
        defines=_defines(component, kernels),
    )


def _kernels(component: Component) -> list[ca.Function]:
    """Every function of the component that its C source calls."""
    functions = [component.initial, component.step, component.outputs, *_tangents(component)]
    if component.sampling is not None:
        functions.append(component.sampling.update)
    if component.shortcut is not None:
        functions += [component.shortcut.holds, component.shortcut.step]
    return functions


def _kernel_header(functions: list[ca.Function]) -> str:
    """C source of the kernels, included by `casadi.c`."""
    generator = ca.CodeGenerator(
        "kernel", {"with_header": False, "casadi_int": "int", "with_export": False}
    )
    for function in functions:
        generator.add(function)
    prototypes = "\n".join(
        f"static int {f.name()}(const double** arg, double** res, int* iw, double* w, int mem);"
        for f in functions
    )
    linkage = "/* Internal linkage: the compiler can fold the kernels into their callers. */"
    return f"{linkage}\n{prototypes}\n\n{generator.dump()}"


def _defines(component: Component, functions: list[ca.Function]) -> dict[str, int]:
    """Lines of `model.h`: work space of the kernels, and what the component has."""
    defines = {
        "N_ARGUMENTS": max(f.sz_arg() for f in functions) + 1,
        "N_RESULTS": max(f.sz_res() for f in functions) + 1,
        "N_INTEGERS": max(f.sz_iw() for f in functions) + 1,
        "N_WORK": max(f.sz_w() for f in functions) + 1,
    }
    if component.shortcut is not None:
        defines["HAS_SHORTCUT"] = 1
    if component.sampling is not None:
        reference = {v.name: i for i, v in enumerate(component.variables, start=1)}
        defines |= {
            "SAMPLE_PERIOD": reference[component.sampling.period],
            "SEED": reference[component.sampling.seed or component.sampling.period],
            "N_NOISE": component.sampling.channels,
            "STREAM": component.sampling.stream,
        }
    return defines


def _tangents(component: Component) -> list[ca.Function]:
    """`(x, u, p, du, dp) -> dy` while stepping, `(u, p, du, dp[, w]) -> dy` at the start."""
    x = ca.SX.sym("x", len(component.states))
    u, du = (ca.SX.sym(n, len(component.inputs)) for n in ("u", "du"))
    p, dp = (ca.SX.sym(n, len(component.parameters)) for n in ("p", "dp"))
    w = _draws(component)

    def tangent(name: str, state: ca.SX, arguments: list[ca.SX]) -> ca.Function:
        """Change of the outputs, with the state as an expression of the arguments."""
        y = component.outputs(state, u, p)
        dy = ca.jtimes(y, ca.vertcat(u, p), ca.vertcat(du, dp))
        return ca.Function(name, arguments, [ca.cse(dy)])

    start = [u, p, du, dp] if component.sampling is None else [u, p, du, dp, w]
    return [
        tangent("tangent", x, [x, u, p, du, dp]),
        tangent("initial_tangent", _first_state(component, u, p, w), start),
    ]


def _draws(component: Component) -> ca.SX:
    """Symbols of the normal draws at a sample instant."""
    return ca.SX.sym("w", 0 if component.sampling is None else component.sampling.channels)


def _first_state(component: Component, u: ca.SX, p: ca.SX, w: ca.SX) -> ca.SX:
    """State at the start, the first sample instant included."""
    x = component.initial(u, p)
    return x if component.sampling is None else component.sampling.update(x, u, p, w)


def _dependencies(component: Component) -> dict[str, tuple[str, ...]]:
    """Inputs that each output feels directly, from the sparsity of the equations."""
    pattern = _pattern(component.outputs, 1, len(component.inputs))
    return {
        y: tuple(u for u, hit in zip(component.input_names, row, strict=True) if hit)
        for y, row in zip(component.output_names, pattern, strict=True)
    }


def _initial_dependencies(component: Component) -> dict[str, tuple[str, ...]]:
    """Inputs and parameters that each output feels at the end of initialisation."""
    u = ca.SX.sym("u", len(component.inputs))
    p = ca.SX.sym("p", len(component.parameters))
    w = _draws(component)
    y = component.outputs(_first_state(component, u, p, w), u, p)
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
