"""A compensator's file from anywhere: no name of it becomes code, no size or number gets past."""

import json
import re
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
from fmpy import simulate_fmu
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from learning_rigs.compensator_rig import changed, compensator, exported
from onnx import TensorProto, helper, numpy_helper

from fmus import build
from fmus.compensator import (
    FILE,
    NetworkFile,
    compensator_model,
    interface_model,
    network_source,
    read_network,
)
from fmus.description import model_description
from fmus.network_file import MAX_NUMBERS, OUTPUTS, plain_copy, take_one_sample
from fmus.source import generated_sources
from learning.data.channels import CHANNELS, GROUPS, UNITS
from learning.export.streaming import streaming_model
from learning.export.write import metadata
from learning.preset import PRESETS, PROTOCOLS, Preset, Protocol
from twin.errors import FmuError

Change = Callable[[onnx.ModelProto], object]
Reader = Callable[[Change], NetworkFile]
LONG = "a" * 65
NO_NAMES = ("", " ", "a b", "1a", 'x"', "x\n", "x\0", "é", "x٣", "x[0]", "a-b", "a*/b", LONG)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of an honest model."""
    return exported(compensator(), tmp_path_factory.mktemp("models") / "honest")


@pytest.fixture(scope="module")
def fresh(trained: Path) -> Callable[[], onnx.ModelProto]:
    """The honest model, to be changed."""
    content = (trained / FILE).read_bytes()
    return lambda: onnx.load_model_from_string(content)


@pytest.fixture
def read_changed(fresh: Callable[[], onnx.ModelProto], tmp_path: Path) -> Reader:
    """What the reader makes of the honest model with a change."""

    def read(change: Change) -> NetworkFile:
        model = fresh()
        change(model)
        return read_network(changed(model, tmp_path / f"{len(list(tmp_path.iterdir()))}"))

    return read


# -- code from data -------------------------------------------------------------------------


def payload(marker: Path) -> str:
    """C that creates a file as soon as its library is loaded."""
    return (
        f"extern int creat(const char*, unsigned); __attribute__((constructor)) "
        f'static void owned(void) {{ creat("{marker}", 0600u); }}'
    )


def in_a_string(marker: Path) -> str:
    """A name that ends a row of the interface table, and begins another table."""
    return f'x", INPUT, 0, 0, 0}}}};\n{payload(marker)}\nstatic const Variable rest[] = {{{{"x'


def in_a_comment(marker: Path) -> str:
    """A text that ends a comment, and begins another."""
    return f"*/\n{payload(marker)}\n/*"


def evil_command(marker: Path) -> dict[str, Any]:
    """Says as the last motor's name what runs."""
    return {"commands": ["cmd_1", "cmd_2", "cmd_3", in_a_string(marker)]}


def evil_group(marker: Path) -> dict[str, Any]:
    """The same as a sensor without channels."""
    return {"groups": [*GROUPS, in_a_string(marker)]}


def evil_channel(marker: Path) -> dict[str, Any]:
    """The same as a channel of such a sensor."""
    name = in_a_string(marker)
    return {"groups": [*GROUPS, name], "channels": [*CHANNELS[:-1], f"{name}_x"]}


@pytest.mark.slow
@pytest.mark.parametrize("said", [evil_command, evil_group, evil_channel])
def test_a_name_that_is_code_is_refused_at_reading(
    fresh: Callable[[], onnx.ModelProto],
    tmp_path: Path,
    said: Callable[[Path], dict[str, Any]],
) -> None:
    """Written into C as it is, it runs when the FMU is loaded."""
    marker = tmp_path / "owned"
    folder = changed(fresh(), tmp_path / "model", **said(marker))
    with pytest.raises(FmuError, match=rf"{FILE}: (commands|groups|channels) = .* is no name"):
        simulate_fmu(str(build(compensator_model(folder), tmp_path / "x.fmu")), stop_time=0.01)
    assert not marker.exists()


@pytest.mark.slow
def test_texts_that_are_never_used_do_not_run_either(
    fresh: Callable[[], onnx.ModelProto], tmp_path: Path
) -> None:
    """The C generator writes metadata and descriptions into a comment as they are."""
    marker, model = tmp_path / "owned", fresh()
    text = in_a_comment(marker)
    model.doc_string = model.producer_name = model.graph.doc_string = text
    folder = changed(model, tmp_path / "model", raw={"note": text, text: "1", "preset": text})
    path = build(compensator_model(folder), tmp_path / "x.fmu")
    simulate_fmu(str(path), stop_time=0.01)
    assert not marker.exists()
    assert "owned" not in network_source(read_network(folder).content)


@pytest.mark.slow
def test_the_writers_refuse_as_well(trained: Path, tmp_path: Path) -> None:
    """Whoever comes past the reader meets the same wall at the C and at the XML."""
    network, marker = read_network(trained), tmp_path / "owned"
    for said in (evil_command(marker), evil_group(marker), evil_channel(marker)):
        changes: dict[str, Any] = {k: tuple(v) for k, v in said.items()}
        crafted = replace(network, **changes)
        model = interface_model(crafted)
        with pytest.raises(FmuError, match="is no name"):
            generated_sources(model, "token")
        with pytest.raises(FmuError, match="is no name"):
            model_description(model, 3, "token", ())
        with pytest.raises(FmuError, match="is no name"):
            build(model, tmp_path / "x.fmu")
    assert list(tmp_path.iterdir()) == []


def test_names_in_the_graph_do_not_reach_the_c(
    fresh: Callable[[], onnx.ModelProto], tmp_path: Path, read_changed: Reader
) -> None:
    text = in_a_comment(tmp_path / "owned")

    def rename_tensor(model: onnx.ModelProto) -> None:
        (node,) = (n for n in model.graph.node if "inside" in n.output)
        old, node.input[0] = node.input[0], text
        for other in model.graph.node:
            for i, name in enumerate(other.output):
                if name == old:
                    other.output[i] = text
            for i, name in enumerate(other.input):
                if name == old:
                    other.input[i] = text

    def rename_node(model: onnx.ModelProto) -> None:
        model.graph.node[0].name = text

    def mark(model: onnx.ModelProto) -> None:
        model.graph.node[0].attribute.append(helper.make_attribute("note", text))

    for change in (rename_tensor, rename_node, mark):
        with pytest.raises(FmuError, match="is no name"):
            read_changed(change)
        model = fresh()
        change(model)
        network_source.cache_clear()
        with pytest.raises(FmuError, match="is no name"):
            network_source(model.SerializeToString())


@pytest.mark.parametrize("key", ["channels", "groups", "commands", "phases"])
@pytest.mark.parametrize("name", NO_NAMES, ids=ascii)
def test_no_names(
    fresh: Callable[[], onnx.ModelProto], tmp_path: Path, key: str, name: str
) -> None:
    said: dict[str, Any] = {
        "channels": [*CHANNELS[:-1], name],
        "groups": [*GROUPS, name],
        "commands": ["cmd_1", "cmd_2", "cmd_3", name],
        "phases": {"ground": 0, name: 1},
    }
    with pytest.raises(FmuError, match=f"{key} = .* is no name") as caught:
        read_network(changed(fresh(), tmp_path / "model", **{key: said[key]}))
    assert str(caught.value).isascii()
    assert "\n" not in str(caught.value)


@pytest.mark.slow
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(name=st.text(max_size=80) | st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,70}", fullmatch=True))
def test_any_name_is_an_identifier_or_refused(
    fresh: Callable[[], onnx.ModelProto], tmp_path_factory: pytest.TempPathFactory, name: str
) -> None:
    folder = changed(
        fresh(),
        tmp_path_factory.mktemp("any") / "model",
        commands=["cmd_1", "cmd_2", "cmd_3", name],
    )
    taken = {*CHANNELS, "cmd_1", "cmd_2", "cmd_3", "phase", "anomaly", "inside", "sample_period"}
    fine = bool(re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]{0,63}", name, re.ASCII)) and name not in taken
    try:
        assert read_network(folder).commands[3] == name
    except FmuError:
        assert not fine
    else:
        assert fine


# -- what the metadata may say --------------------------------------------------------------


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ({"channels": list(CHANNELS) * 5}, "channels"),
        ({"channels": "gyro_x"}, "must be a list"),
        ({"channels": [*CHANNELS[:-1], CHANNELS[0]]}, "a name is there twice"),
        ({"channels": [*CHANNELS[:-1], "sonar_x"]}, "sonar_x.*begin with"),
        ({"commands": ["a", "b", "c", "phase"]}, "another signal's"),
        ({"commands": [f"cmd_{i}" for i in range(65)]}, "list of 1 to 64"),
        ({"groups": [f"g{i}" for i in range(65)]}, "list of 1 to 64"),
        ({"units": [*UNITS[:-1], "N.s99999/rad99999"]}, "must be a unit"),
        ({"units": [*UNITS[:-1], 3]}, "must be a unit"),
        ({"units": [*UNITS, "m"]}, "there must be 15"),
        ({"phases": {"ground": 0, "hover": 2**31}}, "phases.hover"),
        ({"phases": {"ground": 0, "hover": 0}}, "a code of its own"),
        ({"phases": {f"p{i}": i for i in range(65)}}, "1 to 64 codes"),
        ({"rate_hz": 1e9}, "rate_hz"),
        ({"rate_hz": True}, "rate_hz"),
        ({"rate_hz": float("nan")}, "NaN is no number"),
        ({"protocol": "guess"}, "one of reconstruct, track, free"),
        ({"protocol": ["track"]}, "one of reconstruct, track, free"),
        ({"horizon": -1}, "horizon"),
        ({"horizon": 2**40}, "horizon"),
        ({"uncorrected_rms": [1.0] * 14}, "list of 15"),
        ({"uncorrected_rms": [float("inf")] * 15}, "Infinity is no number"),
        ({"uncorrected_rms": [10**400] * 15}, "finite number"),
        ({"uncorrected_rms": [-1.0] * 15}, "from 0 on"),
        ({"vehicle": "a\nb"}, "vehicle = .* is no text"),
        ({"vehicle": "a" * 256}, "vehicle = .* is no text"),
        ({"vehicle_sha256": "0"}, "digits of a hash"),
        ({"normalisation": {}}, r"normalisation\.mean"),
        ({"normalisation": []}, "normalisation"),
    ],
    ids=lambda value: value if isinstance(value, str) else next(iter(value)),
)
def test_metadata_out_of_bounds(
    fresh: Callable[[], onnx.ModelProto], tmp_path: Path, said: dict[str, Any], words: str
) -> None:
    """Each refusal names the file, the quantity and the value."""
    with pytest.raises(FmuError, match=words) as caught:
        read_network(changed(fresh(), tmp_path / "model", **said))
    assert str(tmp_path / "model" / FILE) in str(caught.value)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 0.0, "1", None])
def test_normalisation_is_finite_and_scales_positive(
    fresh: Callable[[], onnx.ModelProto], tmp_path: Path, value: object
) -> None:
    texts = {p.key: p.value for p in fresh().metadata_props}
    tables = json.loads(texts["normalisation"])
    tables["scale"][2][3] = value
    with pytest.raises(FmuError, match="normalisation"):
        read_network(changed(fresh(), tmp_path / "model", normalisation=tables))


@pytest.mark.parametrize("text", ["[" * 100_000, "{", "1" * 5000, '"' + "x" * 2**21 + '"'])
def test_what_is_no_json(fresh: Callable[[], onnx.ModelProto], tmp_path: Path, text: str) -> None:
    with pytest.raises(FmuError, match="horizon"):
        read_network(changed(fresh(), tmp_path / "model", raw={"horizon": text}))


def test_an_entry_that_is_there_twice(fresh: Callable[[], onnx.ModelProto], tmp_path: Path) -> None:
    folder = changed(fresh(), tmp_path / "model")
    model = onnx.load(folder / FILE)
    model.metadata_props.add(key="rate_hz", value="1")
    (folder / FILE).write_bytes(model.SerializeToString())
    with pytest.raises(FmuError, match="'rate_hz' is there twice"):
        read_network(folder)


# -- what the graph may hold ----------------------------------------------------------------


def weights(model: onnx.ModelProto) -> onnx.TensorProto:
    """The largest ones."""
    found: onnx.TensorProto = max(model.graph.initializer, key=lambda t: len(t.raw_data))
    return found


def with_weight(value: float) -> Change:
    """One weight is this."""

    def change(model: onnx.ModelProto) -> None:
        tensor = weights(model)
        values = numpy_helper.to_array(tensor).copy()
        values.flat[7] = value
        tensor.raw_data = values.tobytes()

    return change


def with_state(size: int) -> Change:
    """Input and output `state` have this size."""

    def change(model: onnx.ModelProto) -> None:
        for value in (model.graph.input[5], model.graph.output[4]):
            value.type.tensor_type.shape.dim[1].dim_value = size

    return change


def external(model: onnx.ModelProto) -> None:
    """Weights lie in a file of the machine that reads."""
    tensor = weights(model)
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="/etc/passwd")


def of_any_size(model: onnx.ModelProto) -> None:
    model.graph.input[0].type.tensor_type.shape.dim[1].dim_param = "n"


def of_three_axes(model: onnx.ModelProto) -> None:
    model.graph.input[0].type.tensor_type.shape.dim.add().dim_value = 1


def in_doubles(model: onnx.ModelProto) -> None:
    model.graph.output[2].type.tensor_type.elem_type = TensorProto.DOUBLE


def as_text(model: onnx.ModelProto) -> None:
    model.graph.initializer.append(numpy_helper.from_array(np.array(["a"], object), "text"))


def with_a_loop(model: onnx.ModelProto) -> None:
    body = helper.make_graph([], "body", [], [])
    model.graph.node.append(helper.make_node("Loop", ["", ""], ["never"], body=body))


def of_another_domain(model: onnx.ModelProto) -> None:
    model.graph.node[0].domain = "com.example"


def with_a_function(model: onnx.ModelProto) -> None:
    model.functions.add(name="f", domain="com.example")


def blown_up(model: onnx.ModelProto) -> None:
    """A tensor of 4 GiB from two numbers."""
    shape = numpy_helper.from_array(np.array([1, 2**30]), "blown")
    model.graph.initializer.append(shape)
    model.graph.node.append(helper.make_node("Expand", ["phase", "blown"], ["big"]))


def cut(model: onnx.ModelProto) -> None:
    weights(model).raw_data = weights(model).raw_data[:-4]


def infinite_attribute(model: onnx.ModelProto) -> None:
    model.graph.node.append(
        helper.make_node("LeakyRelu", ["phase"], ["leaked"], alpha=float("inf"))
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (with_weight(float("nan")), r"nan in 1 places"),
        (with_weight(float("-inf")), r"-inf in 1 places"),
        (with_state(2**31), f"size of state.*{MAX_NUMBERS}"),
        (with_state(60_000), "damaged|at most"),
        (with_state(-1), "1 or more"),
        (external, "in another file"),
        (of_any_size, "1 or more"),
        (of_three_axes, "one row"),
        (in_doubles, "must be FLOAT"),
        (as_text, "STRING"),
        (with_a_loop, "no graphs"),
        (of_another_domain, "only those of ONNX"),
        (with_a_function, "functions"),
        (blown_up, f"size of big.*{MAX_NUMBERS}"),
        (cut, "damaged"),
        (infinite_attribute, "finite"),
    ],
)
def test_graphs_out_of_bounds(read_changed: Reader, change: Change, words: str) -> None:
    """Soon, too: a state of 2^31 numbers was once listed number by number."""
    start = time.process_time()
    with pytest.raises(FmuError, match=words):
        read_changed(change)
    assert time.process_time() - start < 5


def test_a_consistent_graph_with_a_huge_state(
    fresh: Callable[[], onnx.ModelProto], tmp_path: Path
) -> None:
    """Every check of shapes holds; what is kept between samples is too much."""
    widths = {"virtual": 15, "command": 4, "phase": 1, "measured": 15, "valid": 15}
    size = MAX_NUMBERS

    def row(name: str, width: int) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, width])

    sources = ("virtual", "measured", "phase", "phase", "state")
    nodes = [helper.make_node("Identity", [a], [b]) for a, b in zip(sources, OUTPUTS, strict=True)]
    graph = helper.make_graph(
        nodes,
        "huge",
        [*(row(n, w) for n, w in widths.items()), row("state", size)],
        [row(n, w) for n, w in zip(OUTPUTS, (15, 15, 1, 1, size), strict=True)],
    )
    model = fresh()
    model.graph.CopyFrom(graph)
    with pytest.raises(FmuError, match=f"state of the graph = {size}.*50000"):
        read_network(changed(model, tmp_path / "model"))


def test_the_copy_for_the_c_generator_computes_the_same(
    fresh: Callable[[], onnx.ModelProto],
) -> None:
    """onnxruntime on the file and on the copy without its texts, to the bit."""
    rng = np.random.default_rng(0)
    given = fresh()
    take_one_sample(given)
    copy = plain_copy(given)
    onnx.checker.check_model(copy, full_check=True)
    fed = {
        v.name: rng.normal(size=[d.dim_value for d in v.type.tensor_type.shape.dim]).astype("f4")
        for v in copy.graph.input
    }
    said = [
        onnxruntime.InferenceSession(m.SerializeToString(), providers=["CPUExecutionProvider"]).run(
            None, fed
        )
        for m in (fresh(), copy)
    ]
    for ours, theirs in zip(*said, strict=True):
        assert ours.tobytes() == theirs.tobytes()
    assert not copy.metadata_props


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("preset", PRESETS.values(), ids=list(PRESETS))
def test_the_limits_leave_room_for_every_preset(
    tmp_path: Path, preset: Preset, protocol: Protocol
) -> None:
    """Predicted a second ahead, with as many motors as there may be."""
    made = compensator(preset, protocol, horizon=100, commands=12)
    model = streaming_model(made)
    folder = changed(model, tmp_path / "model", raw=metadata(made))
    assert read_network(folder).state_size == made.state_size


def test_the_honest_model_is_read(trained: Path) -> None:
    network = read_network(trained)
    assert network.channels == CHANNELS
    assert network.groups == tuple(GROUPS)
    names = set(generated_sources(interface_model(network), "token"))
    assert names == {"part_compensator.c", "system.c"}
