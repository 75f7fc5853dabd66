"""Compensator: a learned correction of the virtual sensors as an FMU, from the ONNX file alone.

The network becomes C by emx-onnx-cgen; `c/compensator.h` runs it at its sample instants. What the
file says about itself (`learning.export.write` writes it) becomes the interface table.
"""

import hashlib
import json
import re
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from twin.component import Variable
from twin.errors import FmuError
from twin.representation import short_repr

from .model import FmuModel, Part
from .units import base_exponents

Shape = tuple[int, ...]

FILE = "model.onnx"
"""In the folder of a trained model."""
FORMAT = "uavtwin compensator 1"
INPUTS = ("virtual", "command", "phase", "measured", "valid", "state")
OUTPUTS = ("correction", "spread", "anomaly", "inside", "state_out")
MAX_STEP_S = 1e-3
"""Nothing is integrated; it is what a compensator alone names as its step."""
_TEMPLATE = "matmul_op.c.j2"
_PREAMBLE = """\
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC optimize("no-trapping-math") /* vectorises exp and tanh; clang does without */
#endif
static inline float network_exp(float), network_tanh(float);
static inline float network_max(float, float), network_min(float, float);
#define expf network_exp
#define tanhf network_tanh
#define fmaxf network_max
#define fminf network_min
"""
"""In front of the network's C: what stands for functions of the C library, c/compensator.h."""
_EXPORTED = re.compile(
    r"^extern const [^\n]*;\n|^_Bool network_load\(.*?^\}\n", re.MULTILINE | re.DOTALL
)
_OPEN = re.compile(r"^(?=const EMX_UNUSED|void network\()", re.MULTILINE)


class UnsupportedNetworkError(FmuError):
    """The C generator refuses a network that onnxruntime may run."""


@dataclass(frozen=True, slots=True)
class NetworkFile:
    """A compensator as its ONNX file describes it.

    Attributes:
        path: Of the file.
        content: Its bytes.
        channels: Virtual signals, as the twin names its outputs.
        units: Of the channels.
        groups: Sensors; each channel's name begins with one of them.
        commands: What drives the rotors, as the twin names its outputs.
        phases: Code of each phase.
        rate_hz: Samples per second.
        protocol: Which measurements it sees.
        horizon: Age of the newest one, samples.
        uncorrected_rms: What is to be expected without a correction, by channel.
        vehicle: Name of the twin's vehicle, "" where not said.
        vehicle_sha256: Of the vehicle's file, "" where not said.
        state_size: Numbers of the packed state.
    """

    path: Path
    content: bytes
    channels: tuple[str, ...]
    units: tuple[str, ...]
    groups: tuple[str, ...]
    commands: tuple[str, ...]
    phases: Mapping[str, int]
    rate_hz: float
    protocol: str
    horizon: int
    uncorrected_rms: tuple[float, ...]
    vehicle: str
    vehicle_sha256: str
    state_size: int

    __repr__ = short_repr

    @property
    def sees_measurements(self) -> bool:
        """Whether measured signals enter at all."""
        return self.protocol != "free"

    @property
    def group_of_channel(self) -> tuple[int, ...]:
        """Index of each channel's sensor."""
        return tuple(self.groups.index(c.rpartition("_")[0]) for c in self.channels)


# -- the file -------------------------------------------------------------------------------


def read_network(folder: Path) -> NetworkFile:
    """The network in the folder of a trained model.

    Raises:
        FmuError: There is none, it is damaged or foreign, or the package onnx is missing.
    """
    path = folder / FILE
    if not path.is_file():
        raise FmuError(f"{folder}: holds no {FILE}; give the folder that uavtwin train wrote.")
    content = path.read_bytes()
    model = _loaded(path, content)
    said = {p.key: p.value for p in model.metadata_props}
    if said.get("format") != FORMAT:
        raise FmuError(
            f"{path}: is no compensator ({FORMAT!r} is not among its metadata); give the folder "
            f"that uavtwin train wrote."
        )
    digest = hashlib.sha256(model.graph.SerializeToString(deterministic=True)).hexdigest()
    if said.get("graph_sha256") != digest:
        raise FmuError(f"{path}: damaged or changed, its checksum does not fit; export it again.")
    try:
        network = _described(path, content, said, _shapes(model.graph.input))
        _check(network, _shapes(model.graph.input), _shapes(model.graph.output))
    except (KeyError, TypeError, ValueError) as error:
        raise FmuError(f"{path}: its metadata do not fit its graph: {error}.") from error
    return network


def _check(network: NetworkFile, inputs: Mapping[str, Shape], outputs: Mapping[str, Shape]) -> None:
    """Raise ValueError or KeyError where metadata and graph do not say the same."""
    n, m, state = len(network.channels), len(network.commands), network.state_size
    for names, found, widths in (
        (INPUTS, inputs, (n, m, 1, n, n, state)),
        (OUTPUTS, outputs, (n, n, 1, 1, state)),
    ):
        expected = {name: (1, width) for name, width in zip(names, widths, strict=True)}
        if list(found.items()) != list(expected.items()):
            raise ValueError(f"tensors {dict(found)} should be {expected}")
    if not (len(network.units) == len(network.uncorrected_rms) == len(network.group_of_channel)):
        raise ValueError(f"{n} channels need as many units and spreads")
    if not network.phases:
        raise ValueError("there are no phases")
    for unit in network.units:
        base_exponents(unit)


def _loaded(path: Path, content: bytes) -> Any:
    """The ONNX model, checked."""
    try:
        import onnx
        from google.protobuf.message import DecodeError  # type: ignore[import-untyped]
    except ModuleNotFoundError as error:
        raise _missing(error) from error
    try:
        model = onnx.load_model_from_string(content)
        onnx.checker.check_model(model)
    except (DecodeError, onnx.checker.ValidationError) as error:
        raise FmuError(f"{path}: damaged, or no ONNX file: {error}") from error
    return model


def _shapes(values: Any) -> dict[str, Shape]:
    """Name -> shape of inputs or outputs of a graph."""
    return {v.name: tuple(d.dim_value for d in v.type.tensor_type.shape.dim) for v in values}


def _described(
    path: Path, content: bytes, said: Mapping[str, str], inputs: Mapping[str, Shape]
) -> NetworkFile:
    """What the metadata say, in the words of the dataclass."""

    def value(name: str) -> Any:
        if name not in said:
            raise ValueError(f"there is no {name!r}")
        return json.loads(said[name])

    rate_hz = float(value("rate_hz"))
    if not 0 < rate_hz < np.inf:
        raise ValueError(f"rate_hz is {rate_hz:g}")
    return NetworkFile(
        path=path,
        content=content,
        channels=tuple(map(str, value("channels"))),
        units=tuple(str(u).replace("²", "2") for u in value("units")),
        groups=tuple(map(str, value("groups"))),
        commands=tuple(map(str, value("commands"))),
        phases={str(k): int(v) for k, v in dict(value("phases")).items()},
        rate_hz=rate_hz,
        protocol=str(value("protocol")),
        horizon=int(value("horizon")),
        uncorrected_rms=tuple(map(float, value("uncorrected_rms"))),
        vehicle=str(value("vehicle")),
        vehicle_sha256=str(value("vehicle_sha256")),
        state_size=inputs["state"][-1],
    )


def _missing(error: ModuleNotFoundError) -> FmuError:
    return FmuError(
        f"a compensator needs the package {error.name}: pip install uavtwin[learn], or onnx and "
        f"emx-onnx-cgen alone."
    )


# -- the FMU --------------------------------------------------------------------------------


def compensator_model(folder: Path) -> FmuModel:
    """The native FMU model of the compensator in a folder.

    Raises:
        UnsupportedNetworkError: The C generator refuses the network.
        FmuError: The folder holds no compensator, or a package is missing.
    """
    return native_model(read_network(folder))


def native_model(network: NetworkFile) -> FmuModel:
    """The same of a network that was read."""
    groups = ", ".join(map(str, network.group_of_channel))
    spread = ", ".join(map(repr, network.uncorrected_rms))
    defines: dict[str, int | str] = {
        "SAMPLE_PERIOD": 1,
        "N_CHANNELS": len(network.channels),
        "N_COMMANDS": len(network.commands),
        "N_GROUPS": len(network.groups) if network.sees_measurements else 0,
        "N_NETWORK": network.state_size,
        "GROUP_OF_CHANNEL": f"{{{groups}}}",
        "INITIAL_SPREAD": f"{{{spread}}}",
    }
    return interface_model(network, _PREAMBLE + network_source(network.content), defines)


def interface_model(
    network: NetworkFile, kernels: str = "", defines: Mapping[str, int | str] = {}
) -> FmuModel:
    """Names, units and dependencies of a compensator, with its code or without."""
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
    part = Part(
        name="compensator",
        variables=variables,
        dependencies=dependencies,
        initial_dependencies=dependencies,
        state_names=(*memory, *held, "anomaly", "inside"),
        max_step_s=MAX_STEP_S,
        glue="compensator.h",
        kernels=kernels,
        defines=defines,
    )
    name = f" of {network.vehicle}" if network.vehicle else ""
    sees = {"free": "sees no measurement", "reconstruct": "sees the present measurement"}.get(
        network.protocol, f"sees measurements as old as {network.horizon} samples"
    )
    return FmuModel("compensator", f"Learned correction of the sensors{name}, {sees}", (part,))


def _inputs(network: NetworkFile) -> list[Variable]:
    codes = ", ".join(f"{code} {name}" for name, code in network.phases.items())
    channels = list(zip(network.channels, network.units, strict=True))
    unknown = max(network.phases.values())
    table = [Variable(c, "input", u, f"What the twin reads, {c}") for c, u in channels]
    for i, c in enumerate(network.commands, start=1):
        unit, what = ("rad/s", "Speed") if c.startswith("rotor_") else ("1", "Command")
        table.append(Variable(c, "input", unit, f"{what} of motor {i}"))
    table.append(Variable("phase", "input", "1", f"Phase of the flight: {codes}", 0.0, 0, unknown))
    if network.sees_measurements:
        table += [
            Variable(f"measured.{c}", "input", u, f"What the aircraft measured, {c}")
            for c, u in channels
        ]
        table += [
            Variable(f"valid.{g}", "input", "1", f"Whether measured.{g}_* is new", boolean=True)
            for g in network.groups
        ]
    return table


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
    inside = "Whether the flight is within the training's envelope; outside nothing is corrected"
    return [*table, Variable("inside", "output", "1", inside, boolean=True)]


# -- the network as C -----------------------------------------------------------------------


@lru_cache(maxsize=2)
def network_source(content: bytes) -> str:
    """C function `network` of an ONNX file; all static, and nothing is allocated in it.

    Raises:
        UnsupportedNetworkError: The generator refuses the network.
        FmuError: emx-onnx-cgen is not installed.
    """
    try:
        import emx_onnx_cgen
        import onnx
        from emx_onnx_cgen.compiler import Compiler, CompilerOptions
        from emx_onnx_cgen.errors import CompilerError
    except ModuleNotFoundError as error:
        raise _missing(error) from error
    with tempfile.TemporaryDirectory(prefix="uavtwin-") as name:
        templates = Path(name, "templates")
        shutil.copytree(Path(emx_onnx_cgen.__file__).parent / "templates", templates)
        ours = resources.files(__package__) / "c" / _TEMPLATE
        (templates / _TEMPLATE).write_text(ours.read_text())
        options = CompilerOptions(
            template_dir=templates,
            model_name="network",
            large_temp_threshold_bytes=0,  # temporaries on the stack, none on the heap
            large_weight_threshold=0,  # weights in the binary, none in a file
        )
        try:
            source = Compiler(options).compile(onnx.load_model_from_string(content))
        except CompilerError as error:
            raise UnsupportedNetworkError(f"the C generator refuses the network: {error}") from None
    if "malloc(" in source:
        raise UnsupportedNetworkError("the C generator would allocate memory in each sample")
    return _OPEN.sub("static ", _EXPORTED.sub("", source))
