"""Compensator: a learned correction of the virtual sensors as an FMU, from the ONNX file only.

The file may have any origin; `network_file` reads and checks it. This module converts its
description to the interface table of an FMU, and its network to C, by emx-onnx-cgen.
"""

import re
import shutil
import tempfile
from collections.abc import Iterable, Mapping
from functools import lru_cache
from importlib import resources
from pathlib import Path

from twin.component import Variable
from twin.errors import FmuError

from .model import Constant, FmuModel, Submodel
from .network_file import (
    FILE,
    INT8_FILE,
    NetworkFile,
    check_graph,
    missing_package,
    parse_network,
    plain_copy,
    read_network,
    take_one_sample,
)

PREAMBLE = """\
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC optimize("O3", "no-trapping-math") /* vectorises, exp and tanh too; clang does anyway */
#endif
static inline float network_exp(float), network_tanh(float);
static inline float network_max(float, float), network_min(float, float);
static void network_product(const float*, const float*, float*, int, int, int);
static void network_rows(const int8_t*, const uint8_t*, int, int32_t*, int, int);
static void network_steps(const float*, uint8_t*, float*, uint8_t*, int);
static void network_softmax(const float*, float*, int);
#define expf network_exp
#define tanhf network_tanh
#define fmaxf network_max
#define fminf network_min
"""
"""Preamble of the network's C: replacements for functions of the C library, c/compensator.h."""
_TEMPLATES = tuple(
    f"{name}_op.c.j2" for name in ("matmul", "matmul_integer", "dynamic_quantize_linear", "softmax")
)
"""Templates of this project that replace those of the generator."""
_EXPORTED = re.compile(
    r"^extern const [^\n]*;\n|^_Bool network_load\(.*?^\}\n", re.MULTILINE | re.DOTALL
)  # templates of the generator
_OPEN = re.compile(r"^(?=const EMX_UNUSED|void network\()", re.MULTILINE)
"""Start of declarations that become static."""


class UnsupportedNetworkError(FmuError):
    """Error for a network that the C generator does not support, although onnxruntime may run
    it."""


@lru_cache(maxsize=2)
def network_source(content: bytes) -> str:
    """C function `network` of an ONNX file; all static, without memory allocation.

    No text of the file enters the C: the generator gets a copy of the graph with generated names
    and without metadata.

    Raises:
        UnsupportedNetworkError: The generator does not support the network.
        FmuError: The graph is not allowed in an FMU, or emx-onnx-cgen is not installed.
    """
    try:
        import emx_onnx_cgen
        from emx_onnx_cgen.compiler import Compiler, CompilerOptions
        from emx_onnx_cgen.errors import CompilerError
    except ModuleNotFoundError as error:
        raise missing_package(error) from error
    nowhere = Path("network")
    model = parse_network(nowhere, content)
    take_one_sample(model)
    check_graph(nowhere, model)
    with tempfile.TemporaryDirectory(prefix="uavtwin-") as name:
        templates = Path(name, "templates")
        shutil.copytree(Path(emx_onnx_cgen.__file__).parent / "templates", templates)
        for ours in _TEMPLATES:
            (templates / ours).write_text((resources.files("fmus") / "c" / ours).read_text())
        options = CompilerOptions(
            template_dir=templates,
            model_name="network",
            large_temp_threshold_bytes=0,  # temporaries on the stack, none on the heap
            large_weight_threshold=0,  # weights in the binary, none in a file
        )
        try:
            source = Compiler(options).compile(plain_copy(model))
        except CompilerError as error:
            raise UnsupportedNetworkError(f"the C generator refuses the network: {error}") from None
    if "malloc(" in source:
        raise UnsupportedNetworkError("the C generator would allocate memory in each sample")
    return _OPEN.sub("static ", _EXPORTED.sub("", source))


MAX_STEP_S = 1e-3
"""Step size in the description of a compensator; nothing is integrated."""


def compensator_model(folder: Path) -> FmuModel:
    """The native FMU model of the compensator in a folder.

    Raises:
        UnsupportedNetworkError: The C generator does not support the network.
        FmuError: The folder contains no compensator, or a package is missing.
    """
    return native_model(read_network(folder))


def native_model(network: NetworkFile) -> FmuModel:
    """The native FMU model of a network."""
    defines: dict[str, Constant] = {
        "SAMPLE_PERIOD": 1,
        "N_CHANNELS": len(network.channels),
        "N_COMMANDS": len(network.commands),
        "N_GROUPS": len(network.groups) if network.sees_measurements else 0,
        "N_NETWORK": network.state_size,
        "GROUP_OF_CHANNEL": network.group_of_channel,
        "INITIAL_SPREAD": network.uncorrected_rms,
    }
    return interface_model(network, PREAMBLE + network_source(network.content), defines)


def interface_model(
    network: NetworkFile, kernels: str = "", defines: Mapping[str, Constant] = {}
) -> FmuModel:
    """Names, units and dependencies of a compensator, with or without its code."""
    variables = (
        Variable(
            "sample_period",
            "parameter",
            "s",
            "Time between two samples, as trained",
            1 / network.rate_hz,
            1 / network.rate_hz,
            1 / network.rate_hz,
            fixed=True,
        ),
        *_inputs(network),
        *_outputs(network),
    )
    dependencies: dict[str, tuple[str, ...]] = {
        v.name: () for v in variables if v.causality == "output"
    }
    dependencies |= {f"corrected.{c}": (c,) for c in network.channels}
    held = [f"{kind} {c}" for kind in ("correction", "spread") for c in network.channels]
    memory = [f"number {i} of the network's state" for i in range(network.state_size)]
    part = Submodel(
        name="compensator",
        variables=variables,
        dependencies=dependencies,
        initial_dependencies=dependencies,
        state_names=(*memory, *held, "anomaly", "inside", "left_out"),
        max_step_s=MAX_STEP_S,
        glue="compensator.h",
        kernels=kernels,
        defines=defines,
        may_lack=_may_lack(variables),
        held=frozenset(
            v.name
            for v in variables
            if v.causality == "output" and v.real and not v.name.startswith("corrected.")
        ),
    )
    name = f" of {network.vehicle}" if network.vehicle else ""
    sees = {"free": "sees no measurement", "reconstruct": "sees the present measurement"}.get(
        network.protocol, f"sees measurements as old as {network.horizon} samples"
    )
    return FmuModel("compensator", f"Learned correction of the sensors{name}, {sees}", (part,))


def _inputs(network: NetworkFile) -> list[Variable]:
    codes = ", ".join(f"{code} {name}" for name, code in network.phases.items())
    phases, unknown = f"Phase of the flight: {codes}", max(network.phases.values())
    channels = list(zip(network.channels, network.units, strict=True))
    table = [Variable(c, "input", u, f"What the twin reads, {c}") for c, u in channels]
    for i, c in enumerate(network.commands, start=1):
        table.append(Variable(c, "input", *_drive(c, i)))
    table.append(Variable("phase", "input", "1", phases, 0.0, 0, unknown, kind="integer"))
    if network.sees_measurements:
        table += [
            Variable(f"measured.{c}", "input", u, f"What the aircraft measured, {c}")
            for c, u in channels
        ]
        table += [
            Variable(f"valid.{g}", "input", "1", f"Whether measured.{g}_* is new", kind="boolean")
            for g in network.groups
        ]
    return table


def _drive(name: str, number: int) -> tuple[str, str]:
    """Unit and description of a rotor input."""
    unit, what = ("rad/s", "Speed") if name.startswith("rotor_") else ("1", "Command")
    return unit, f"{what} of motor {number}"


def _outputs(network: NetworkFile) -> list[Variable]:
    meanings = {
        "correction": "To be added to what the twin reads",
        "corrected": "What the twin reads with its correction",
        "spread": "Standard deviation expected of what is left",
    }
    channels = list(zip(network.channels, network.units, strict=True))
    table = [
        Variable(f"{kind}.{c}", "output", u, f"{meaning}, {c}")
        for kind, meaning in meanings.items()
        for c, u in channels
    ]
    table.append(
        Variable("anomaly", "output", "1", "Strangeness of the residual; above 1 is unusual")
    )
    inside = "Whether the flight is within the training's envelope; outside the correction fades"
    left_out = "Samples so far that were left out, as an input was no number"
    table.append(Variable("inside", "output", "1", inside, kind="boolean"))
    return [*table, Variable("left_out", "output", "1", left_out, kind="integer")]


def _may_lack(variables: Iterable[Variable]) -> frozenset[str]:
    """Signals that may be NaN for some time, and their corrections."""
    return frozenset(
        v.name
        for v in variables
        if (v.causality == "input" and v.real) or v.name.startswith("corrected.")
    )


__all__ = [
    "FILE",
    "INT8_FILE",
    "NetworkFile",
    "UnsupportedNetworkError",
    "compensator_model",
    "interface_model",
    "native_model",
    "network_source",
    "read_network",
]
