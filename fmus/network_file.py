"""`model.onnx` of a trained compensator: its metadata, checked against its graph.

The file may have any origin, and its graph is checked before it is used. Refused are graphs that
could run for ever, read other files, need unbounded memory or insert text into C: control flow,
functions and operators of other domains, numbers in other files, tensors without a fixed size,
sizes and counts beyond bounds, numbers that are not finite, names that are no identifiers.
`onnx.checker` checks none of that.
"""

import hashlib
import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from twin.errors import FmuError, install_command
from twin.representation import ShortRepr

from .names import LONGEST_NAME, base_exponents, check_identifier, check_name, check_text, shown

Shape = tuple[int, ...]

INPUTS = ("virtual", "command", "phase", "measured", "valid", "state")  # of the graph
OUTPUTS = ("correction", "spread", "anomaly", "inside", "state_out")  # of the graph
MAX_FILE_BYTES = 256 * 2**20
"""Largest file; the largest preset has 8 MB."""
MAX_NODES = 10_000
"""Largest number of operators in a graph. Made up."""
MAX_NUMBERS = 2**18
"""Largest size of an intermediate tensor: 1 MiB of the caller's stack. The largest preset has 5,218
numbers in its state."""
_OPERATOR_DOMAINS = ("", "ai.onnx")  # ONNX's own, by its two names
_WAY_OUT = "Use a file that uavtwin train wrote"  # remedy in messages


def parse_network(path: Path, content: bytes) -> Any:
    """The unchecked ONNX model from the bytes of a file.

    Raises:
        FmuError: It is no ONNX file, it is too large, or the package onnx is missing.
    """
    try:
        import onnx
        from google.protobuf.message import DecodeError  # type: ignore[import-untyped]
    except ModuleNotFoundError as error:
        raise missing_package(error) from error
    if len(content) > MAX_FILE_BYTES:
        raise FmuError(
            f"{path}: {len(content)} bytes, at most {MAX_FILE_BYTES} are read. {_WAY_OUT}."
        )
    try:
        return onnx.load_model_from_string(content)
    except DecodeError as error:
        raise FmuError(f"{path}: damaged, or no ONNX file: {error}") from error


def take_one_sample(model: Any) -> None:
    """Change a model with any number of samples per call to one sample, as in an FMU: the first
    axis of its inputs and outputs gets the size 1 where it has a name."""
    for value in (*model.graph.input, *model.graph.output):
        shape = value.type.tensor_type.shape.dim
        if shape and shape[0].HasField("dim_param"):
            shape[0].dim_value = 1


def check_graph(path: Path, model: Any) -> None:
    """Check that a parsed graph can become an FMU.

    Raises:
        FmuError: It cannot; the text states the reason.
    """
    import onnx

    _check_structure(path, model)
    for tensor in _tensors(model.graph):
        _check_numbers(path, tensor)
    for value in (*model.graph.input, *model.graph.output):
        _check_row(path, value)
    try:
        onnx.checker.check_model(model)
        inferred = onnx.shape_inference.infer_shapes(
            model, check_type=True, strict_mode=True, data_prop=True
        )
    except (onnx.checker.ValidationError, onnx.shape_inference.InferenceError) as error:
        raise FmuError(f"{path}: damaged, or no ONNX file: {error}") from error
    graph = inferred.graph
    known = {v.name for v in (*graph.input, *graph.output, *graph.value_info)}
    for value in graph.value_info:
        _check_size(path, value.name, _shape(value))
    for name in (name for node in graph.node for name in node.output):
        if name and name not in known:
            raise _refusal(path, f"tensor {name}", "unknown shape", "every shape must be fixed")


def row_widths(values: Any) -> dict[str, int]:
    """Width of the inputs or outputs of a checked graph by name: each is one row."""
    return {v.name: _shape(v)[-1] for v in values}


def plain_copy(model: Any) -> Any:
    """A copy of the model with operators and numbers, without any text of its author.

    Tensors between inputs and outputs are numbered. Names of nodes, metadata and descriptions are
    omitted: the C generator writes all of them into comments unchanged.
    """
    import onnx

    names: dict[str, str] = {"": ""} | {n: n for n in (*INPUTS, *OUTPUTS)}
    for node in model.graph.node:
        for name in (*node.input, *node.output):
            names.setdefault(name, f"tensor_{len(names)}")
    nodes = []
    for node in model.graph.node:
        attributes = []
        for attribute in node.attribute:
            copy = onnx.AttributeProto()
            copy.CopyFrom(attribute)
            copy.ClearField("doc_string")
            if copy.HasField("t"):
                array = onnx.numpy_helper.to_array(attribute.t)
                copy.t.CopyFrom(onnx.numpy_helper.from_array(array))
            attributes.append(copy)
        fresh = onnx.NodeProto(op_type=node.op_type, domain=node.domain, attribute=attributes)
        fresh.input.extend(names[name] for name in node.input)
        fresh.output.extend(names[name] for name in node.output)
        nodes.append(fresh)
    numbers = []
    for tensor in (t for t in model.graph.initializer if t.name in names):
        array = onnx.numpy_helper.to_array(tensor)
        numbers.append(onnx.numpy_helper.from_array(array, names[tensor.name]))

    def row(value: Any) -> Any:
        """An input or output with name and shape only."""
        return onnx.helper.make_tensor_value_info(
            value.name, onnx.TensorProto.FLOAT, list(_shape(value))
        )

    graph = onnx.helper.make_graph(
        nodes,
        "network",
        [row(v) for v in model.graph.input],
        [row(v) for v in model.graph.output],
        numbers,
    )
    opsets = [onnx.helper.make_opsetid("", o.version) for o in model.opset_import]
    return onnx.helper.make_model(graph, opset_imports=opsets, ir_version=model.ir_version)


def check_names(path: Path, graph: Any) -> None:
    """Check that all names and texts in a graph are identifiers.

    Raises:
        FmuError: One is not.
    """
    for node in graph.node:
        check_name(f"{path}: operator", node.op_type)
        for name in filter(None, (node.name, *node.input, *node.output)):
            check_name(f"{path}: name in the graph", name)
        for attribute in node.attribute:
            where = f"{path}: attribute of {node.op_type}"
            check_name(where, attribute.name)
            for text in filter(None, (attribute.s, *attribute.strings)):
                check_name(where, text.decode("ascii", "replace"))
    for named in (*graph.initializer, *graph.input, *graph.output, *graph.value_info):
        check_name(f"{path}: name in the graph", named.name)


def missing_package(error: ModuleNotFoundError) -> FmuError:
    """Error for a package that is not installed."""
    return FmuError(
        f"a compensator needs the package {error.name}: {install_command('learn')}. To export one "
        f"that is trained, onnx and emx-onnx-cgen are enough."
    )


# -- one thing each -------------------------------------------------------------------------


def _check_structure(path: Path, model: Any) -> None:
    """Check that there are only operators of ONNX, in one flat graph."""
    graph = model.graph
    for what, found, most in (
        ("functions", len(model.functions), 0),
        ("training graphs", len(model.training_info), 0),
        ("sparse tensors", len(graph.sparse_initializer), 0),
        ("operators", len(graph.node), MAX_NODES),
        ("inputs", len(graph.input), len(INPUTS)),
        ("outputs", len(graph.output), len(OUTPUTS)),
    ):
        if found > most:
            raise _refusal(path, what, found, f"there may be {most}")
    check_names(path, graph)
    domains = [*(o.domain for o in model.opset_import), *(n.domain for n in graph.node)]
    for domain in domains:
        if domain not in _OPERATOR_DOMAINS:
            raise _refusal(path, "domain of an operator", domain, "only those of ONNX are run")
    for node in graph.node:
        for attribute in node.attribute:
            if attribute.ref_attr_name or attribute.type not in _attribute_types():
                raise _refusal(
                    path,
                    f"attribute of {node.op_type}",
                    attribute.name,
                    "numbers, tensors and names alone may stand there, no graphs",
                )
            if not all(map(math.isfinite, (attribute.f, *attribute.floats))):
                raise _refusal(path, attribute.name, "not finite", "numbers must be finite")


def _attribute_types() -> tuple[int, ...]:
    from onnx import AttributeProto as Kind

    return (Kind.FLOAT, Kind.INT, Kind.STRING, Kind.TENSOR, Kind.FLOATS, Kind.INTS, Kind.STRINGS)


def _tensors(graph: Any) -> Iterator[Any]:
    """Every numeric tensor: weights, and constants among the attributes of operators."""
    yield from graph.initializer
    for node in graph.node:
        yield from (a.t for a in node.attribute if a.HasField("t"))


def _check_numbers(path: Path, tensor: Any) -> None:
    """Check that numbers are in the file itself, of a supported type, complete, and finite."""
    import onnx

    kind = onnx.TensorProto
    where = f"tensor {tensor.name}"
    if tensor.data_location != kind.DEFAULT or tensor.external_data:
        raise _refusal(path, where, "in another file", "all numbers must be in this one")
    known = ("FLOAT", "INT64", "INT32", "INT8", "UINT8", "BOOL")
    if tensor.data_type not in [kind.DataType.Value(name) for name in known]:
        name = kind.DataType.Name(tensor.data_type) if tensor.data_type in _types() else "unknown"
        raise _refusal(path, f"type of {where}", name, f"{', '.join(known)} are known")
    if any(d < 0 for d in tensor.dims):
        raise _refusal(path, f"shape of {where}", tuple(tensor.dims), "no size may be negative")
    try:
        values = onnx.numpy_helper.to_array(tensor)
    except (ValueError, TypeError) as error:
        raise FmuError(f"{path}: damaged: {where}, shape {tuple(tensor.dims)}: {error}.") from error
    if not np.isfinite(values).all():
        bad = values[~np.isfinite(values)]
        raise _refusal(path, where, f"{bad[0]} in {bad.size} places", "weights must be finite")


def _types() -> list[int]:
    from onnx import TensorProto

    return list(TensorProto.DataType.values())


def _check_row(path: Path, value: Any) -> None:
    """Check that an input or output is one row of float32."""
    import onnx

    if value.type.tensor_type.elem_type != onnx.TensorProto.FLOAT:
        raise _refusal(path, f"type of {value.name}", "not float32", "it must be FLOAT")
    shape = _shape(value)
    if len(shape) != 2 or shape[0] != 1:
        raise _refusal(path, f"shape of {value.name}", shape, "it must be one row, (1, n)")
    _check_size(path, value.name, shape)


def _check_size(path: Path, name: str, shape: Shape) -> None:
    if any(d < 1 for d in shape):
        raise _refusal(path, f"shape of {name}", shape, "every size must be fixed and 1 or more")
    if math.prod(shape) > MAX_NUMBERS:
        raise _refusal(path, f"size of {name}", shape, f"at most {MAX_NUMBERS} numbers are held")


def _shape(value: Any) -> Shape:
    """Sizes of a tensor, 0 where one is not fixed."""
    return tuple(d.dim_value for d in value.type.tensor_type.shape.dim)


def _refusal(path: Path, quantity: str, value: object, need: str) -> FmuError:
    return FmuError(
        f"{path}: refused: {quantity[: 2 * LONGEST_NAME]} = {shown(value)}; {need}. {_WAY_OUT}."
    )


FILE, INT8_FILE = "model.onnx", "model_int8.onnx"
"""Files in the folder of a trained model: as trained, and with weights of 8 bits."""
FORMAT = "uavtwin compensator 1"  # in the metadata
PROTOCOLS = ("reconstruct", "track", "free")  # ways of feeding measurements
MAX_CHANNELS, MAX_COMMANDS, MAX_PHASES, MAX_HORIZON = 64, 64, 64, 10_000
"""Largest counts; models of this project have 15 channels."""
MAX_STATE = 50_000
"""Largest size of the packed state; the largest preset has 5,218."""
MAX_RATE_HZ = 1e5
"""Highest sample rate of a compensator, Hz. Made up."""
MAX_TEXT = 255
"""Largest number of characters of a vehicle's name, which may be that of its file."""
MAX_METADATA = 2**20
"""Largest number of characters of one entry."""


@dataclass(frozen=True, slots=True)
class NetworkFile(ShortRepr):
    """A compensator as described by its ONNX file.

    Attributes:
        path: Path of the file.
        content: Content of the file.
        channels: Virtual signals, by the names of the twin's outputs.
        units: Units of the channels.
        groups: Sensors; each channel's name begins with one of them.
        commands: Rotor inputs, by the names of the twin's outputs.
        phases: Code of each phase of flight.
        rate_hz: Sample rate.
        protocol: Measurements that are inputs.
        horizon: Age of the newest measurement, samples.
        uncorrected_rms: Expected rms residual without a correction, by channel.
        vehicle: Name of the twin's vehicle, "" where not stated.
        vehicle_sha256: Hash of the vehicle's file, "" where not stated.
        state_size: Size of the packed state.
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

    @property
    def sees_measurements(self) -> bool:
        """Whether measured signals are inputs."""
        return self.protocol != "free"

    @property
    def group_of_channel(self) -> tuple[int, ...]:
        """Index of each channel's sensor."""
        return tuple(self.groups.index(c.rpartition("_")[0]) for c in self.channels)


def read_network(folder: Path, file: str = FILE) -> NetworkFile:
    """The network in the folder of a trained model, by the name of its file.

    The file may have any origin: names, sizes and numbers are checked before use, so that all of it
    can be written into an FMU.

    Raises:
        FmuError: There is none, it is damaged or of another kind, a part of it is not allowed in an
            FMU, or the package onnx is missing.
    """
    path = folder / file
    if not path.is_file():
        raise FmuError(
            f"{folder}: holds no {file}; give the folder that uavtwin train wrote, of a preset "
            f"that has an ONNX form (docs/guide/compensator.md)."
        )
    with path.open("rb") as opened:
        content = opened.read(MAX_FILE_BYTES + 1)
    model = parse_network(path, content)
    said = _Metadata(path, model.metadata_props)
    said.check_format(model.graph)
    take_one_sample(model)
    check_graph(path, model)
    network = _described(said, content, model.graph)
    _check_fit(said, network, model.graph)
    return network


class _Metadata:
    """Reader of a file's entries, one method per kind of value; each refuses other kinds."""

    def __init__(self, path: Path, properties: Any) -> None:
        self.path = path
        self._texts: dict[str, str] = {}
        for entry in properties:
            if entry.key in self._texts:
                raise FmuError(f"{path}: metadata {shown(entry.key)} is there twice. {_WAY_OUT}.")
            self._texts[entry.key] = entry.value

    def check_format(self, graph: Any) -> None:
        """Check that the file is a compensator's and its graph unchanged.

        The checksum detects damage, not intent: an author of changes can correct it.
        """
        if self._texts.get("format") != FORMAT:
            raise FmuError(
                f"{self.path}: is no compensator ({FORMAT!r} is not among its metadata); give the "
                f"folder that uavtwin train wrote."
            )
        digest = hashlib.sha256(graph.SerializeToString(deterministic=True)).hexdigest()
        if self._texts.get("graph_sha256") != digest:
            raise FmuError(
                f"{self.path}: damaged or changed, its checksum does not fit; export it again."
            )

    def refuse(self, key: str, value: object, need: str) -> NoReturn:
        """Raise an error that names the invalid entry and the condition."""
        raise FmuError(
            f"{self.path}: its metadata do not fit: {key} = {shown(value)}, {need}. {_WAY_OUT}."
        )

    def value(self, key: str) -> Any:
        """A JSON value, without NaN and infinity."""
        text = self._texts.get(key)
        if text is None:
            self.refuse(key, None, "the entry is missing")
        if len(text) > MAX_METADATA:
            self.refuse(key, text, f"{len(text)} characters are more than {MAX_METADATA}")
        try:
            return json.loads(text, parse_constant=_no_number)
        except (ValueError, RecursionError) as error:
            self.refuse(key, text, f"it is not JSON: {error}")

    def names(self, key: str, most: int) -> tuple[str, ...]:
        """1 to `most` distinct identifiers."""
        values = self.list(key, most)
        where = f"{self.path}: {key}"
        names = tuple(check_identifier(where, v, LONGEST_NAME) for v in values)
        if len(set(names)) < len(names):
            self.refuse(key, values, "a name is there twice")
        return names

    def list(self, key: str, most: int) -> list[Any]:
        """1 to `most` values."""
        values = self.value(key)
        if not isinstance(values, list) or not 1 <= len(values) <= most:
            self.refuse(key, values, f"it must be a list of 1 to {most}")
        return values

    def text(self, key: str) -> str:
        """One line of text."""
        return check_text(f"{self.path}: {key}", self.value(key), MAX_TEXT)

    def whole(self, key: str, value: object, most: int) -> int:
        """An integer from 0 to `most`."""
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= most:
            self.refuse(key, value, f"it must be a whole number from 0 to {most}")
        return value

    def numbers(self, key: str, values: object, n: int, least: float) -> tuple[float, ...]:
        """A given number of finite numbers, each at least `least`."""
        if not isinstance(values, list) or len(values) != n:
            self.refuse(key, values, f"it must be a list of {n} numbers")
        for value in values:
            if not _is_number(value) or value < least:
                limit = "" if least == -math.inf else f" from {least:g} on"
                self.refuse(key, value, f"it must be a finite number{limit}")
        return tuple(map(float, values))


def _described(said: _Metadata, content: bytes, graph: Any) -> NetworkFile:
    """The metadata as a `NetworkFile`."""
    inputs = row_widths(graph.input)
    if tuple(inputs) != INPUTS:
        said.refuse("inputs of the graph", tuple(inputs), f"they must be {INPUTS}")
    channels = said.names("channels", MAX_CHANNELS)
    rate_hz = said.value("rate_hz")
    if not _is_number(rate_hz) or not 0 < rate_hz <= MAX_RATE_HZ:
        said.refuse("rate_hz", rate_hz, f"it must be above 0 and at most {MAX_RATE_HZ:g}")
    protocol = said.value("protocol")
    if protocol not in PROTOCOLS:
        said.refuse("protocol", protocol, f"it must be one of {', '.join(PROTOCOLS)}")
    digest = said.text("vehicle_sha256")
    if not re.fullmatch(r"[0-9a-f]{64}|", digest):
        said.refuse("vehicle_sha256", digest, "it must be empty or 64 digits of a hash")
    return NetworkFile(
        path=said.path,
        content=content,
        channels=channels,
        units=_units(said),
        groups=said.names("groups", MAX_CHANNELS),
        commands=said.names("commands", MAX_COMMANDS),
        phases=_phases(said),
        rate_hz=float(rate_hz),
        protocol=protocol,
        horizon=said.whole("horizon", said.value("horizon"), MAX_HORIZON),
        uncorrected_rms=said.numbers(
            "uncorrected_rms", said.value("uncorrected_rms"), len(channels), 0.0
        ),
        vehicle=said.text("vehicle"),
        vehicle_sha256=digest,
        state_size=inputs["state"],
    )


def _units(said: _Metadata) -> tuple[str, ...]:
    units = tuple(
        u.replace("²", "2") if isinstance(u, str) else u for u in said.list("units", MAX_CHANNELS)
    )
    for unit in units:
        try:
            base_exponents(unit)
        except (KeyError, TypeError):
            said.refuse("units", unit, "it must be a unit of fmus/names.py")
    return units


def _phases(said: _Metadata) -> dict[str, int]:
    """Codes 0, 1, 2, ... by name."""
    phases = said.value("phases")
    if not isinstance(phases, dict) or not 1 <= len(phases) <= MAX_PHASES:
        said.refuse("phases", phases, f"it must be 1 to {MAX_PHASES} codes by name")
    for name, code in phases.items():
        check_name(f"{said.path}: phases", name)
        said.whole(f"phases.{name}", code, len(phases) - 1)
    if len(set(phases.values())) < len(phases):
        said.refuse("phases", phases, "every phase needs a code of its own")
    return phases


def _check_fit(said: _Metadata, network: NetworkFile, graph: Any) -> None:
    """Check that metadata and graph agree, and that the scaling of the graph is usable."""
    n, m, state = len(network.channels), len(network.commands), network.state_size
    if state > MAX_STATE:
        said.refuse("state of the graph", state, f"at most {MAX_STATE} numbers are kept")
    for names, found, widths in (
        (INPUTS, row_widths(graph.input), (n, m, 1, n, n, state)),
        (OUTPUTS, row_widths(graph.output), (n, n, 1, 1, state)),
    ):
        expected = dict(zip(names, widths, strict=True))
        if list(found.items()) != list(expected.items()):
            said.refuse("widths of the graph's tensors", found, f"they must be {expected}")
    if len(network.units) != n:
        said.refuse("units", network.units, f"there must be {n}, one per channel")
    for channel in network.channels:
        if channel.rpartition("_")[0] not in network.groups:
            said.refuse("channels", channel, f"it must begin with one of {network.groups} and _")
    taken = {"phase", "anomaly", "inside", "sample_period"}
    for name in (*network.channels, *network.commands):
        if name in taken:
            said.refuse("channels and commands", name, "this name is another signal's")
        taken.add(name)
    _check_normalisation(said, n, len(network.phases))


def _check_normalisation(said: _Metadata, n_channels: int, n_phases: int) -> None:
    """Check the scaling numbers of the graph, as repeated in the metadata: finite, scales above
    0."""
    tables = said.value("normalisation")
    if not isinstance(tables, dict):
        said.refuse("normalisation", tables, "it must be tables by name")
    tiny = math.ulp(0.0)
    for name, least in (("mean", -math.inf), ("scale", tiny)):
        key, rows = f"normalisation.{name}", tables.get(name)
        if not isinstance(rows, list) or len(rows) != n_phases:
            said.refuse(key, rows, f"it must have {n_phases} rows, one per phase")
        for row in rows:
            said.numbers(key, row, n_channels, least)
    centre = tables.get("feature_mean")
    n_features = len(centre) if isinstance(centre, list) else 0
    for name, least in (("feature_mean", -math.inf), ("feature_scale", tiny)):
        said.numbers(f"normalisation.{name}", tables.get(name), n_features, least)


def _is_number(value: object) -> bool:
    """Whether it is a number in the range of a double."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return -1.7e308 < value < 1.7e308


def _no_number(text: str) -> NoReturn:
    raise ValueError(f"{text} is no number of JSON")
