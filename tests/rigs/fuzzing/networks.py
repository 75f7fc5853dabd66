"""Compensators: metadata, tensors, operators and sizes of an ONNX file changed."""

import hashlib
import json
import math
import random
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from google.protobuf.message import DecodeError  # type: ignore[import-untyped]
from onnx import TensorProto, helper, numpy_helper

from fmus.compensator import FILE, interface_model, native_model, read_network
from fmus.network_file import FORMAT, INPUTS, OUTPUTS, plain_copy
from fmus.source import generated_sources

from .engine import Seen, Step
from .flights import Long, apply_bytes, draw_bytes, spelled

_N, _M, _STATE = 2, 4, 3
_JSON: tuple[Long, ...] = (
    *(
        "null",
        "[]",
        "{}",
        "NaN",
        "1e999",
        "-1",
        "0",
        "true",
        '""',
        ("[", 200_000),
        ("9", 5000),
        "{",
    ),
    *('["a", "a"]', '["x\\"; }"]', '["acc_x", "acc_y", "acc_z"]', '{"a": 1e400}', "[[[[1]]]]"),
    *(
        json.dumps(["a" * 100]),
        ('["cmd_1"], ', 5000),
        ("[0, ", 9),
        '"\\ud800"',
        "[1, 2",
        "10000000",
    ),
)
_OPERATORS = (
    *("Loop", "If", "Scan", "Range", "Expand", "ConstantOfShape", "Tile", "Resize", "NonZero"),
    *("evil*/", "", "MatMul", "Gemm", "Reshape", "Concat", "Relu", "Identity", "Pad", "Einsum"),
)
_SIZES = (0, -1, 1, 7, 2**18, 2**31, 2**40, 2**62)
_BYTES = ("flip", "cut", "repeat", "remove")


class Networks:
    """The kind."""

    file = FILE
    visible: frozenset[str] = frozenset()

    def __init__(self) -> None:
        self._generated: set[str] = set()

    def bases(self) -> dict[str, bytes]:
        """Of code alone."""
        return {"linear": _linear()}

    def draw(self, rng: random.Random, blob: bytes) -> Step:
        """Most of them know the format, and most of these mend the checksum."""
        model = _parsed(blob)
        if model is None or rng.random() < 0.1:
            return draw_bytes(rng, blob or b"\0")
        names = ("said", "unsaid", "size", "tensor", "operator", "input", "more", "opset", "damage")
        name = rng.choices(names, (10, 2, 5, 5, 5, 4, 2, 1, 3))[0]
        given: dict[str, Any] = {"at": rng.randrange(10_000), "mend": rng.random() < 0.95}
        match name:
            case "said":
                given |= {"to": rng.choice(_JSON)}
            case "unsaid":
                given |= {"twice": rng.random() < 0.5}
            case "size":
                given |= {"to": rng.choice((*_SIZES, "n"))}
            case "tensor":
                what = ("dims", "type", "cut", "value", "outside", "name", "huge")
                given |= {"what": rng.choice(what), "to": rng.choice(_SIZES)}
            case "operator":
                given |= {
                    "to": rng.choice(_OPERATORS),
                    "domain": rng.choice(("", "", "", "my.own")),
                }
            case "input":
                given |= {"to": rng.choice(("state", "", "no such", ("x", 200), "a\0b", "spread"))}
            case "more":
                given |= {"what": rng.choice(("chain", "copies", "attribute", "double"))}
                given |= {"times": rng.choice((1, 100, 30_000))}
            case "opset":
                given |= {"to": rng.choice((0, 1, 6, 99, 2**40))}
            case "damage":
                graph = model.graph.SerializeToString(deterministic=True)
                given |= {"step": list(draw_bytes(rng, graph or b"\0"))}
        return name, given

    def apply(self, blob: bytes, step: Step) -> bytes:
        """As drawn; what cannot be read any more is left."""
        name, given = step
        if name in _BYTES:
            return apply_bytes(blob, step)
        model = _parsed(blob)
        if model is None:
            return blob
        try:
            _change(model, name, given)
        except (
            ValueError,
            IndexError,
            ZeroDivisionError,
            DecodeError,
        ):  # of protobuf, or nothing to change
            return blob
        if given["mend"]:
            graph = model.graph.SerializeToString(deterministic=True)
            for entry in model.metadata_props:
                if entry.key == "graph_sha256":
                    entry.value = hashlib.sha256(graph).hexdigest()
        return bytes(model.SerializeToString(deterministic=True))

    def read(self, path: Path) -> Seen:
        """As `uavtwin export compensator`, up to the C to compile; that of each graph once."""
        network = read_network(path.parent, path.name)
        said = repr(replace(network, path=Path(), content=b""))
        graph = plain_copy(_parsed(network.content)).SerializeToString(deterministic=True)
        digest = hashlib.sha256(graph).hexdigest()
        new = digest not in self._generated
        self._generated.add(digest)
        generated_sources(native_model(network) if new else interface_model(network), "{token}")
        return Seen(said + digest, frozenset())


def _parsed(blob: bytes) -> Any:
    """The model, or None."""
    try:
        return onnx.load_model_from_string(blob)
    except Exception:  # of protobuf, on what earlier changes left
        return None


def _change(model: Any, name: str, given: dict[str, Any]) -> None:
    """Change a model in its place."""
    graph, at = model.graph, given["at"]
    match name:
        case "said" | "unsaid":
            entry = model.metadata_props[at % len(model.metadata_props)]
            if name == "said":
                entry.value = spelled(given["to"])
            elif given["twice"]:
                model.metadata_props.append(entry)
            else:
                model.metadata_props.remove(entry)
        case "size":
            values = [*graph.input, *graph.output]
            dims = values[at % len(values)].type.tensor_type.shape.dim
            dim = dims[at // 16 % len(dims)]
            if given["to"] == "n":
                dim.dim_param = "n"
            else:
                dim.dim_value = given["to"]
        case "tensor":
            _change_tensor(graph.initializer[at % len(graph.initializer)], given)
        case "operator":
            node = graph.node[at % len(graph.node)]
            node.op_type, node.domain = given["to"], given["domain"]
        case "input":
            node = graph.node[at % len(graph.node)]
            names = node.input if at // 64 % 2 else node.output
            names[at // 128 % len(names)] = spelled(given["to"])
        case "more":
            _add(graph, given)
        case "opset":
            model.opset_import[0].version = given["to"]
        case "damage":
            content = graph.SerializeToString(deterministic=True)
            graph.ParseFromString(apply_bytes(content, (given["step"][0], given["step"][1])))


def _change_tensor(tensor: Any, given: dict[str, Any]) -> None:
    match given["what"]:
        case "dims":
            tensor.dims[given["at"] // 16 % len(tensor.dims)] = given["to"]
        case "huge":
            tensor.ClearField("raw_data")
            tensor.dims[:] = [2**31, 2**31]
        case "type":
            tensor.data_type = given["to"] % 2**31 % 40
        case "cut":
            tensor.raw_data = tensor.raw_data[: len(tensor.raw_data) // 2]
        case "value" if tensor.data_location != TensorProto.EXTERNAL:
            array = numpy_helper.to_array(tensor).copy()
            array.flat[0] = (math.nan, math.inf, 1e38, 0.0)[given["at"] % 4]
            tensor.CopyFrom(numpy_helper.from_array(array, tensor.name))
        case "outside":
            tensor.data_location = TensorProto.EXTERNAL
            tensor.external_data.add(key="location", value="/etc/passwd")
        case "name":
            tensor.name = "x*/"


def _add(graph: Any, given: dict[str, Any]) -> None:
    """More operators."""
    times = given["times"]
    match given["what"]:
        case "chain":
            names = ["state", *(f"link_{k}" for k in range(times))]
            links = pairwise(names)
            graph.node.extend([helper.make_node("Abs", [a], [b]) for a, b in links])
        case "copies":
            graph.node.extend([graph.node[given["at"] % len(graph.node)]] * times)
        case "attribute":
            node = graph.node[given["at"] % len(graph.node)]
            node.attribute.append(helper.make_attribute("axis", [2**62] * times))
        case "double":  # each as large as all before it
            names = ["state", *(f"twice_{k}" for k in range(min(times, 40)))]
            links = pairwise(names)
            nodes = [helper.make_node("Concat", [a, a], [b], axis=1) for a, b in links]
            graph.node.extend(nodes)


@cache
def _linear() -> bytes:
    """A compensator that is little more than a matrix."""
    rng = np.random.default_rng(0)
    sizes = {"seen": (_N + _M, _N), "sum": (_N, 1), "kept": (_N, _STATE)}
    numbers = [
        numpy_helper.from_array(rng.normal(size=shape).astype(np.float32), name)
        for name, shape in sizes.items()
    ]
    nodes = [
        helper.make_node("Concat", ["virtual", "command"], ["all"], axis=1),
        helper.make_node("MatMul", ["all", "seen"], ["correction"]),
        helper.make_node("Sub", ["measured", "virtual"], ["residual"]),
        helper.make_node("Abs", ["residual"], ["spread"]),
        helper.make_node("MatMul", ["residual", "sum"], ["anomaly"]),
        helper.make_node("Sigmoid", ["phase"], ["inside"]),
        helper.make_node("MatMul", ["valid", "kept"], ["news"]),
        helper.make_node("Add", ["state", "news"], ["state_out"]),
    ]
    widths = ((_N, _M, 1, _N, _N, _STATE), (_N, _N, 1, 1, _STATE))
    inputs, outputs = (
        [
            helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, width])
            for name, width in zip(*table, strict=True)
        ]
        for table in ((INPUTS, widths[0]), (OUTPUTS, widths[1]))
    )
    graph = helper.make_graph(nodes, "network", inputs, outputs, numbers)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    said = {
        "channels": ["acc_x", "acc_y"],
        "units": ["m/s2", "m/s2"],
        "groups": ["acc"],
        "commands": [f"cmd_{i}" for i in range(1, _M + 1)],
        "phases": {"hover": 0, "unknown": 1},
        "rate_hz": 100.0,
        "protocol": "track",
        "horizon": 3,
        "uncorrected_rms": [0.5, 0.5],
        "vehicle": "",
        "vehicle_sha256": "",
        "normalisation": {
            "mean": [[0.0, 0.0]] * 2,
            "scale": [[1.0, 1.0]] * 2,
            "feature_mean": [0.0],
            "feature_scale": [1.0],
        },
    }
    texts = {"format": FORMAT} | {k: json.dumps(v) for k, v in said.items()}
    digest = hashlib.sha256(model.graph.SerializeToString(deterministic=True)).hexdigest()
    helper.set_model_props(model, texts | {"graph_sha256": digest})
    return bytes(model.SerializeToString(deterministic=True))


KIND = Networks()
