"""What the builder turns into an FMU: an interface table, dependencies and C source."""

from collections.abc import Mapping
from dataclasses import dataclass, field

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
    defines: Mapping[str, int] = field(default_factory=dict)
    resources: Mapping[str, bytes] = field(default_factory=dict)


def component_model(component: Component) -> FmuModel:
    """The FMU model of a CasADi component: kernels generated as C."""
    return FmuModel(
        name=component.name,
        description=component.description,
        variables=component.variables,
        dependencies=_dependencies(component),
        initial_dependencies=_initial_dependencies(component),
        state_names=tuple(s.name for s in component.states),
        source=_kernel_source(component),
        max_step_s=component.max_step_s,
        defines=_sampling_defines(component),
    )


def _sampling_defines(component: Component) -> dict[str, int]:
    sampling = component.sampling
    if sampling is None:
        return {}
    reference = {v.name: i for i, v in enumerate(component.variables, start=1)}
    return {
        "SAMPLE_PERIOD": reference[sampling.period],
        "SEED": reference[sampling.seed or sampling.period],
        "N_NOISE": sampling.channels,
        "STREAM": sampling.stream,
    }


_FIRST_NOISE = """double noise[N_NOISE + 1];
    standard_normal((uint64_t)s->v[SEED], STREAM, N_NOISE, 0, noise);"""

_UPDATE = """\
void model_update(const State* s, const void* data, const double* noise, double* x_next) {{
    (void)data;
    const double* arg[{arguments}] = {{s->x, INPUTS, PARAMETERS, noise}};
    double* res[{results}] = {{x_next}};
    int iw[{integers}];
    double w[{work}];
    update(arg, res, iw, w, 0);
}}
"""

_SHORTCUT = """\
    double cheap = 0;
    const double* condition[4] = {s->x, PARAMETERS, &h};
    double* verdict[2] = {&cheap};
    holds(condition, verdict, iw, w, 0);
    if (cheap) {
        cheap_step(arg, res, iw, w, 0);
        return;
    }
"""


def _kernel_source(component: Component) -> str:
    functions = [component.initial, component.step, component.outputs, *_tangents(component)]
    if component.sampling is not None:
        functions.append(component.sampling.update)
    if component.shortcut is not None:
        functions += [component.shortcut.holds, component.shortcut.step]
    generator = ca.CodeGenerator(
        "kernel", {"with_header": False, "casadi_int": "int", "with_export": False}
    )
    for function in functions:
        generator.add(function)
    work = max(f.sz_w() for f in functions) + 1
    integers = max(f.sz_iw() for f in functions) + 1
    arguments = max(f.sz_arg() for f in functions) + 1
    results = max(f.sz_res() for f in functions) + 1
    prototypes = "\n".join(
        f"static int {f.name()}(const double** arg, double** res, int* iw, double* w, int mem);"
        for f in functions
    )
    shortcut = "" if component.shortcut is None else _SHORTCUT
    update = (
        ""
        if component.sampling is None
        else _UPDATE.format(arguments=arguments, results=results, integers=integers, work=work)
    )
    noise_header = "" if component.sampling is None else '#include "noise.h"\n'
    noise = "const double noise[1] = {0};" if component.sampling is None else _FIRST_NOISE
    return f"""\
#include "core.h"
{noise_header}
/* Internal linkage for the kernels, so that the compiler can fold them into their callers. */
{prototypes}

{generator.dump()}

/* CasADi kernels behind the interface of core.h. They read inputs while they write results, so
 * the two never share a buffer. */
#define PARAMETERS (s->v + 1)
#define INPUTS (s->v + FIRST_INPUT)

int model_open(const char* resources, void** data, char* message, size_t size) {{
    (void)resources, (void)message, (void)size;
    *data = NULL;
    return 0;
}}
void model_close(void* data) {{ (void)data; }}

void model_initial(const State* s, const void* data, double* x) {{
    (void)data;
    const double* arg[{arguments}] = {{INPUTS, PARAMETERS}};
    double* res[{results}] = {{x}};
    int iw[{integers}];
    double w[{work}];
    initial(arg, res, iw, w, 0);
}}
void model_step(const State* s, const void* data, double h, double* x_next) {{
    (void)data;
    const double* arg[{arguments}] = {{s->x, INPUTS, PARAMETERS, &h}};
    double* res[{results}] = {{x_next}};
    int iw[{integers}];
    double w[{work}];
{shortcut}    step(arg, res, iw, w, 0);
}}
void model_outputs(State* s, void* data) {{
    (void)data;
    const double* arg[{arguments}] = {{s->x, INPUTS, PARAMETERS}};
    double* res[{results}] = {{s->v + FIRST_OUTPUT}};
    int iw[{integers}];
    double w[{work}];
    outputs(arg, res, iw, w, 0);
}}
void model_tangent(const State* s, const void* data, int initializing, double* change) {{
    (void)data;
    const double* d_p = change + 1;
    const double* d_u = change + FIRST_INPUT;
    {noise}
    const double* arg[{arguments}] = {{s->x, INPUTS, PARAMETERS, d_u, d_p, noise}};
    double* res[{results}] = {{change + FIRST_OUTPUT}};
    int iw[{integers}];
    double w[{work}];
    if (initializing)
        initial_tangent(arg, res, iw, w, 0);
    else
        tangent(arg, res, iw, w, 0);
}}
{update}"""


def _tangents(component: Component) -> list[ca.Function]:
    """`(x, u, p, du, dp) -> dy` while stepping, and at the end of initialisation."""
    x, u, p, du, dp = (
        ca.SX.sym(name, n)
        for name, n in (
            ("x", len(component.states)),
            ("u", len(component.inputs)),
            ("p", len(component.parameters)),
            ("du", len(component.inputs)),
            ("dp", len(component.parameters)),
        )
    )
    known, change = ca.vertcat(u, p), ca.vertcat(du, dp)
    w = ca.SX.sym("w", component.sampling.channels if component.sampling else 1)
    functions = []
    for name, state in (("tangent", x), ("initial_tangent", _first_state(component, u, p, w))):
        y = component.outputs(state, u, p)
        dy = ca.cse(ca.jtimes(y, known, change))
        functions.append(ca.Function(name, [x, u, p, du, dp, w], [dy]))
    return functions


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
    w = ca.SX.sym("w", component.sampling.channels if component.sampling else 1)
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
