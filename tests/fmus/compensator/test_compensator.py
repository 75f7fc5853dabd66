"""The compensator as an FMU: numbers of torch and onnxruntime, states, derivatives, refusals."""

import hashlib
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import onnx
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu
from instance import Array, Instance, library, unzip
from learning_rigs.compensator_rig import (
    Rows,
    changed,
    compensator,
    exported,
    flight,
    rows_of,
    tiny,
)
from places import needs_package

from cosim.master import Master
from cosim.ssp import read_ssp, write_ssp
from cosim.system import System
from cosim.whole_twin import fused_model, parts_of, system_of
from fmus import build
from fmus.compensator import (
    FILE,
    INT8_FILE,
    UnsupportedNetworkError,
    compensator_model,
    interface_model,
    native_model,
    network_source,
    read_network,
)
from fmus.platforms import compilers, select_platforms
from fmus.python_slave.build import build_network_slave
from learning.data.channels import CHANNELS, GROUPS
from learning.export.write import streamed
from learning.model.compensator import Compensator
from twin.errors import FmuError, TwinError
from twin.flight.assembly import Assembly, connected_by_name, flying_twin
from twin.vehicle_file import load_vehicle, vehicle_text
from uavtwin.cli.export import Choice, default_vehicle, export_components
from uavtwin.exports.write import WrittenFile

VEHICLE, H = "crazyflie", 0.01
TOLERANCE = 1e-5
"""Of numbers of size 1, which the tiny models' units are."""
MODELS: dict[str, Callable[[], Compensator]] = {
    "track": lambda: compensator(vehicle=VEHICLE, envelope=1e4),
    "reconstruct": lambda: compensator(protocol="reconstruct"),
    "free": lambda: compensator(tiny(encoder_units=(10, 7), quantiser="hard"), "free"),
    "wide": lambda: compensator(
        tiny(encoder_units=(70, 33), decoder_units=(40,), code_size=21), "reconstruct"
    ),
}
KINDS = ("correction", "corrected", "spread")
REAL = [f"{kind}.{c}" for kind in KINDS for c in CHANNELS] + ["anomaly"]

Fmu = Callable[[str, int], Path]
New = Callable[..., Instance]
Folder = Callable[[str], Path]


@cache
def model(name: str) -> Compensator:
    return MODELS[name]()


@pytest.fixture(scope="module")
def folder_of(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    """Name -> the folder of the trained model."""
    there = tmp_path_factory.mktemp("models")
    return cache(lambda name: exported(model(name), there / name))


@pytest.fixture(scope="module")
def fmu_of(folder_of: Folder, tmp_path_factory: pytest.TempPathFactory) -> Fmu:
    """(name, FMI version) -> the FMU; "slave NAME" by Python, "int8 NAME" of 8-bit weights."""
    there = tmp_path_factory.mktemp("fmus")

    @cache
    def built(name: str, fmi: int) -> Path:
        path = there / f"{name}-{fmi}.fmu"
        if name.startswith("slave "):
            return build_network_slave(read_network(folder_of(name.removeprefix("slave "))), path)
        if name.startswith("int8 "):
            network = read_network(folder_of(name.removeprefix("int8 ")), INT8_FILE)
            return build(native_model(network), path, fmi)
        return build(compensator_model(folder_of(name)), path, fmi)

    return built


@pytest.fixture
def new(fmu_of: Fmu, tmp_path: Path) -> Iterator[New]:
    """(name, FMI version) -> a fresh instance, freed after the test."""
    made: list[Instance] = []

    def instance(name: str, fmi: int = 2) -> Instance:
        made.append(Instance(unzip(fmu_of(name, fmi), tmp_path / f"{len(made)}")))
        return made[-1]

    yield instance
    for one in made:
        one.close()


def feed(instance: Instance, rows: Rows, k: int) -> None:
    """Set all inputs of a sample."""
    reals = dict(zip(CHANNELS, rows["virtual"][k], strict=True))
    reals |= {f"cmd_{i}": v for i, v in enumerate(rows["command"][k], start=1)}
    reals |= {f"measured.{c}": v for c, v in zip(CHANNELS, rows["measured"][k], strict=True)}
    truths = {f"valid.{g}": bool(rows["valid"][k, c][0]) for g, c in GROUPS.items()}
    kind = "Real" if instance.fmi == 2 else "Float64"
    for values, verb in ((reals, f"set{kind}"), (truths, "setBoolean")):
        known = {n: v for n, v in values.items() if n in instance.reference}
        if known:
            references = [instance.reference[n] for n in known]
            getattr(instance.fmu, verb)(references, list(known.values()))
    instance.set({"phase": rows["phase"][k, 0]})


def fly(instance: Instance, rows: Rows, samples: range) -> Array:
    """Real outputs and `inside` after each sample, shape (samples, 47)."""
    get = instance.fmu.getReal if instance.fmi == 2 else instance.fmu.getFloat64
    references, found = [instance.reference[n] for n in REAL], []
    for k in samples:
        feed(instance, rows, k)
        instance.step(k * H, H)
        found.append([*get(references), instance.get("inside")])
    return np.array(found)


def outputs(found: Array) -> dict[str, Array]:
    """What `fly` found by name: correction, corrected, spread, anomaly, inside."""
    parts = np.split(found, [15, 30, 45, 46], axis=1)
    return dict(zip((*KINDS, "anomaly", "inside"), parts, strict=True))


# -- numbers --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "samples"),
    [
        ("reconstruct", 1000),
        pytest.param("track", 2000, marks=pytest.mark.slow),
        pytest.param("free", 1000, marks=pytest.mark.slow),
        pytest.param("track", 10_000, marks=pytest.mark.long),
    ],
)
def test_torch_is_onnxruntime_is_c(new: New, folder_of: Folder, name: str, samples: int) -> None:
    """The sequence form of torch, onnxruntime, and C in the FMU."""
    along = flight(model(name), samples)
    rows = rows_of(along)
    said = outputs(fly(new(name).start(), rows, range(samples)))
    theirs = streamed(onnx.load(folder_of(name) / FILE), rows)
    ours = model(name).run(along)
    np.testing.assert_array_equal(said["inside"], theirs["inside"])
    np.testing.assert_array_equal(said["inside"][:, 0] > 0, ours.inside)
    for kind, right in (("correction", ours.correction), ("spread", ours.spread)):
        assert np.max(np.abs(said[kind] - theirs[kind])) < TOLERANCE, kind
        # a spread is over running sums of float32
        assert np.max(np.abs(said[kind] - right)) < (5 if kind == "spread" else 1) * TOLERANCE, kind
    for anomaly in (theirs["anomaly"][:, 0], np.nan_to_num(ours.anomaly)):
        np.testing.assert_allclose(said["anomaly"][:, 0], anomaly, TOLERANCE, TOLERANCE)
    np.testing.assert_array_equal(said["corrected"], rows["virtual"] + said["correction"])


@pytest.mark.slow
def test_8_bits_are_those_of_onnxruntime_and_nearly_the_numbers_of_torch(
    new: New, folder_of: Folder
) -> None:
    """Off by less than 1 % of the residual's spread; sizes that fill no register among them."""
    along = flight(model("wide"), 500)
    rows = rows_of(along)
    said = outputs(fly(new("int8 wide").start(), rows, range(500)))
    theirs = streamed(onnx.load(folder_of("wide") / INT8_FILE), rows)
    ours, residual = model("wide").run(along), rows["measured"] - rows["virtual"]
    apart = {
        name: np.sqrt(np.mean((said["correction"] - other) ** 2, axis=0)) / residual.std(axis=0)
        for name, other in (("onnxruntime", theirs["correction"]), ("torch", ours.correction))
    }
    assert (apart["onnxruntime"] < 1e-3).all()  # a number between two steps may go either way
    assert (apart["torch"] < 0.01).all() and (apart["torch"] > 0).any()


@pytest.mark.slow
def test_other_forms_give_the_same(new: New) -> None:
    """FMI 3 to the bit; the Python slave as far as sums of float32 go."""
    rows = rows_of(flight(model("track"), 200))
    native = fly(new("track", 2).start(), rows, range(200))
    assert fly(new("track", 3).start(), rows, range(200)).tobytes() == native.tobytes()
    np.testing.assert_allclose(
        fly(new("slave track").start(), rows, range(200)), native, TOLERANCE, TOLERANCE
    )


@pytest.mark.slow
@needs_package("ziglang")
@pytest.mark.parametrize(
    ("name", "file", "others"),
    [
        pytest.param("track", FILE, ["aarch64-linux", "darwin-arm64"], marks=pytest.mark.long),
        ("wide", INT8_FILE, []),
    ],
)
def test_other_compilers_give_the_same_bits(
    new: New,
    folder_of: Folder,
    name: str,
    file: str,
    others: list[str],
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Exponentials and sums are our own: clang's library gives the bits of gcc's."""
    zig = compilers(select_platforms(["all"]))
    monkeypatch.setattr("fmus.builder.compilers", lambda some: {p.name: zig[p.name] for p in some})
    rows = rows_of(flight(model(name), 200))
    there = tmp_path_factory.mktemp("zig")
    path = build(
        native_model(read_network(folder_of(name), file)),
        there / "zig.fmu",
        2,
        ["linux64", *others],
    )
    other = Instance(unzip(path, there / "zig"))
    found = fly(other.start(), rows, range(200))
    other.close()
    ours = f"int8 {name}" if file == INT8_FILE else name
    assert found.tobytes() == fly(new(ours).start(), rows, range(200)).tobytes()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["track", "slave track"])
def test_the_first_sample_is_a_period_after_the_start(new: New, name: str) -> None:
    """Until then nothing is corrected, and what an uncorrected sensor is wrong by is expected."""
    rows = rows_of(flight(model("track"), 30))
    one, other = new(name), new(name)
    one.enter()
    feed(one, rows, 0)
    one.leave()
    for k in range(9):
        one.step(k * 1e-3)
    assert [one.get(f"correction.{c}") for c in CHANNELS] == [0.0] * 15
    assert [one.get(f"corrected.{c}") for c in CHANNELS] == list(map(float, rows["virtual"][0]))
    np.testing.assert_array_equal([one.get(f"spread.{c}") for c in CHANNELS], model("track").rms)
    assert (one.get("inside"), one.get("anomaly")) == (0.0, 0.0)
    one.step(0.009)
    feed(other.start(), rows, 0)
    other.step(0.0, H)
    np.testing.assert_array_equal(one.outputs(), other.outputs())
    assert one.get("correction.gyro_x") != 0


@pytest.mark.slow
def test_a_long_step_takes_every_sample(new: New) -> None:
    rows = rows_of(flight(model("track"), 1))
    fine, coarse = new("track").start(), new("track").start()
    feed(fine, rows, 0)
    feed(coarse, rows, 0)
    fine.run(70)
    coarse.step(0.0, 0.07)
    np.testing.assert_array_equal(fine.outputs(), coarse.outputs())


@pytest.mark.slow
def test_outside_the_envelope_nothing_is_corrected(new: New) -> None:
    rows = rows_of(flight(model("free"), 30))
    rows["virtual"][10:20, 1] = float(model("free").place_centre[1]) + 1e3
    said = outputs(fly(new("free").start(), rows, range(30)))
    assert not said["inside"][10:20].any()
    assert not said["correction"][10:20].any()
    np.testing.assert_array_equal(said["corrected"][10:20], rows["virtual"][10:20])
    np.testing.assert_array_equal(said["spread"][10:20], np.tile(model("free").rms, (10, 1)))
    assert said["inside"][20:].all()
    assert said["correction"][20:].all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["track", "slave track"])
def test_a_sample_with_no_number_is_left_out_and_counted(new: New, name: str) -> None:
    """The rest is that of a run without it, to the bit; what is not valid is never looked at."""
    rows = rows_of(flight(model("track"), 30))
    rows["measured"] = np.where(rows["valid"] > 0.5, rows["measured"], np.float32("nan"))
    kept = [k for k in range(30) if k not in (10, 20)]
    rest = {n: values[kept] for n, values in rows.items()}
    right = outputs(fly(new(name).start(), rest, range(len(kept))))
    rows["virtual"][10, 3] = rows["command"][20, 1] = np.float32("nan")
    instance = new(name).start()
    said = outputs(fly(instance, rows, range(30)))
    for kind, values in right.items():
        np.testing.assert_array_equal(said[kind][kept], values, kind)
    assert not said["inside"][[10, 20]].any() and not said["correction"][[10, 20]].any()
    assert list(np.flatnonzero(~np.isfinite(said["corrected"]).all(axis=1))) == [10]
    assert instance.get("left_out") == 2
    with pytest.raises(FMICallException):
        instance.set({"gyro_x": float("inf")})


# -- what FMI promises ----------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("name", "fmi"), [("track", 2), ("track", 3), ("slave track", 2)])
def test_restored_run_repeats_bit_by_bit(new: New, name: str, fmi: int) -> None:
    rows = rows_of(flight(model("track"), 60))
    one, other = new(name, fmi).start(), new(name, fmi)
    fly(one, rows, range(20))
    state = one.fmu.getFMUState()
    text = one.fmu.serializeFMUState(state)
    first = fly(one, rows, range(20, 60)).tobytes()
    one.fmu.setFMUState(state)
    assert one.fmu.serializeFMUState(one.fmu.getFMUState()) == text
    assert fly(one, rows, range(20, 60)).tobytes() == first
    other.fmu.setFMUState(other.fmu.deserializeFMUState(text))
    assert fly(other, rows, range(20, 60)).tobytes() == first


@pytest.mark.parametrize("fmi", [2, 3])
def test_derivatives(new: New, fmi: int) -> None:
    """A corrected signal follows its own signal one to one; the rest is held. At the start too."""
    instance = new("track", fmi)
    known = [n for n in instance.reference if n in CHANNELS or n.startswith(("cmd_", "measured."))]
    get = instance.fmu.getDirectionalDerivative
    unknown = [instance.reference[n] for n in REAL]
    instance.enter()
    for samples in (0, 5):
        if samples:
            instance.leave()
            fly(instance, rows_of(flight(model("track"), samples)), range(samples))
        for name in known:
            found = np.array(get(unknown, [instance.reference[name]], [2.0]))
            right = [2.0 * (output == f"corrected.{name}") for output in REAL]
            np.testing.assert_array_equal(found, right, name)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "fmi"),
    [
        *((name, 2) for name in MODELS),
        ("track", 3),
        *(pytest.param(n, 3, marks=pytest.mark.long) for n in MODELS if n != "track"),
    ],
)
def test_description(fmu_of: Fmu, name: str, fmi: int) -> None:
    path = fmu_of(name, fmi)
    assert validate_fmu(str(path)) == []
    description = fmpy.read_model_description(str(path))
    variables = {v.name: v for v in description.modelVariables}
    assert variables["acc_z"].unit == variables["corrected.acc_z"].unit == "m/s2"
    assert variables["cmd_4"].causality == "input"
    assert ("measured.mag_x" in variables) == ("valid.mag" in variables) == (name != "free")
    if name != "free":
        assert (variables["valid.mag"].type, variables["valid.mag"].start) == ("Boolean", "false")
    assert variables["inside"].type == "Boolean"
    felt = {o.variable.name: [d.name for d in o.dependencies] for o in description.outputs}
    assert felt == {n: [] for n in felt} | {f"corrected.{c}": [c] for c in CHANNELS}
    assert float(variables["sample_period"].start) == H


@pytest.mark.slow
@pytest.mark.parametrize("name", ["track", "int8 wide"])
def test_library_and_sources(fmu_of: Fmu, name: str, tmp_path: Path) -> None:
    """Our own code compiles without a warning; the library allocates as those of others do."""
    folder = unzip(fmu_of(name, 2), tmp_path / "fmu")
    part = folder / "sources" / "part_compensator.c"
    assert "malloc" not in part.read_text()
    assert "\nextern" not in part.read_text()
    command = [
        "cc",
        "-std=c99",
        "-Wall",
        "-Wextra",
        "-Wno-unused-function",
        "-Werror",
        "-O1",
        "-c",
        str(part),
        "-o",
        str(tmp_path / "o.o"),
    ]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    symbols = subprocess.run(
        ["nm", "-D", "--defined-only", library(folder)], capture_output=True, text=True, check=True
    ).stdout
    assert all(line.split()[-1].startswith("fmi2") for line in symbols.splitlines())


@pytest.mark.slow
def test_the_same_model_gives_the_same_bytes(fmu_of: Fmu, tmp_path: Path) -> None:
    network_source.cache_clear()
    again = exported(MODELS["track"](), tmp_path / "again")
    path = build(compensator_model(again), tmp_path / "again.fmu", 2)
    assert path.read_bytes() == fmu_of("track", 2).read_bytes()


# -- uavtwin export -------------------------------------------------------------------------


def export(names: list[str], out: Path, **choice: Any) -> list[WrittenFile]:
    """What `uavtwin export` writes into a new folder."""
    out.mkdir()
    return export_components(names, Choice(**choice))(out, lambda _: None)


@pytest.mark.slow
def test_corrected_twin_is_the_co_simulation_of_its_parts(
    folder_of: Folder, tmp_path: Path
) -> None:
    """A takeoff: the fused FMU at 10 ms against the parts of the `.ssp` at 1 ms, to the bit."""
    assembly = _twin(VEHICLE).with_starts({"mission.wait": 0.1})
    network = compensator_model(folder_of("track"))
    whole = build(fused_model(assembly, VEHICLE, network), tmp_path / "whole.fmu")
    assert validate_fmu(str(whole)) == []
    parts = read_ssp(
        write_ssp(system_of(assembly, tmp_path, compensator=network), tmp_path / "parts.ssp")
    )
    starts = {"compensator.measured.acc_z": -9.0, "compensator.valid.acc": 1.0}
    with Master(replace(parts, starts=starts)) as master:
        names = master.record_names
        master.initialize()
        fine = master.run(2.0, 1e-3, every=10).values
    one = System({"twin": whole}, starts={f"twin.{k}": v for k, v in starts.items()})
    with Master(one, [f"twin.{n}" for n in names]) as master:
        master.initialize()
        coarse = master.run(2.0, 1e-2).values
    column = {n: fine[:, i] for i, n in enumerate(names)}
    assert column["compensator.inside"][1:].all()
    assert np.ptp(column["airframe.pos_z"]) > 0.1
    for channel in CHANNELS:
        assert np.ptp(column[f"compensator.correction.{channel}"]) > 0
    passed = np.array([n.startswith("compensator.corrected.") for n in names])
    assert coarse[:, ~passed].tobytes() == fine[:, ~passed].tobytes()
    shown = {n: coarse[:, i] for i, n in enumerate(names)}
    for name in (n for n, is_passed in zip(names, passed, strict=True) if is_passed):
        channel = name.removeprefix("compensator.corrected.")
        own = next(shown[n] for n in names if n.endswith(f".{channel}") and "compen" not in n)
        now = own + shown[f"compensator.correction.{channel}"]
        np.testing.assert_allclose(shown[name], now, rtol=0, atol=1e-12)  # of one instant
    result = fmpy.simulate_fmu(str(whole), stop_time=0.2, output=["compensator.corrected.acc_z"])
    assert np.isfinite(result["compensator.corrected.acc_z"]).all()


@pytest.mark.slow
def test_export_of_the_corrected_twin(
    folder_of: Folder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Descriptions alone: the sensors, the commands and the phase feed the compensator."""
    monkeypatch.setattr("fmus.builder.compile_library", lambda *_: b"")
    monkeypatch.setattr("uavtwin.exports.write.add_reference_results", lambda *_: None)
    rows = export(["corrected-twin"], tmp_path / "out", vehicle=VEHICLE, model=folder_of("track"))
    assert [row.file for row in rows] == ["corrected_twin.fmu", "corrected_twin.ssp"]
    parts = read_ssp(tmp_path / "out" / "corrected_twin.ssp")
    fed = {c.target: c.source for c in parts.connections if c.target.startswith("compensator.")}
    givers = {
        "gyro": "imu",
        "acc": "imu",
        "mag": "magnetometer",
        "pos": "airframe",
        "vel": "airframe",
    }
    wanted = {f"compensator.{c}": f"{givers[c[:-2]]}.{c}" for c in CHANNELS}
    wanted |= {f"compensator.cmd_{i}": f"controller.cmd_{i}" for i in range(1, 5)}
    assert fed == wanted | {"compensator.phase": "mission.phase_code"}
    description = fmpy.read_model_description(str(tmp_path / "out" / "corrected_twin.fmu"))
    free = {v.name for v in description.modelVariables if v.causality == "input"}
    assert {f"compensator.measured.{c}" for c in CHANNELS} <= free
    assert not any(v in free for v in wanted)


@pytest.mark.slow
def test_the_vehicle_is_that_of_the_model(tmp_path: Path) -> None:
    """Where none is named the folder brings it; another one, or one that changed, is refused."""
    text, _ = vehicle_text(VEHICLE)
    trained = compensator(vehicle=VEHICLE)
    trained.info = replace(trained.info, vehicle_sha256=hashlib.sha256(text.encode()).hexdigest())
    folder = exported(trained, tmp_path / "model")
    assert default_vehicle(None) == default_vehicle(folder) == "copter_default"
    own = folder / "vehicle.toml"
    own.write_text(text)
    assert default_vehicle(folder) == str(own)
    export_components(["compensator"], Choice(str(own), model=folder))
    export_components(["compensator"], Choice(VEHICLE, model=folder))
    own.write_text(text + "# lighter\n")
    for vehicle, words in (
        ("copter_default", "corrects the twin of crazyflie, not of copter_default"),
        (str(own), "trained on other numbers of crazyflie"),
    ):
        with pytest.raises(TwinError, match=words):
            export_components(["corrected-twin"], Choice(vehicle, model=folder))


@pytest.mark.slow
def test_what_does_not_fit_is_refused(folder_of: Folder, tmp_path: Path) -> None:
    two = exported(compensator(commands=2), tmp_path / "two")
    fine = folder_of("track")
    for names, choice, words in (
        (["compensator"], Choice(), "--model FOLDER"),
        (
            ["imu"],
            Choice(VEHICLE, model=fine),
            "changes nothing of imu: it goes with compensator and corrected-twin",
        ),
        (["imu"], Choice(VEHICLE, int8=True), "--int8 goes with --model"),
        (["compensator"], Choice(VEHICLE, model=two), "trained with 2 motors, crazyflie has 4"),
        (["compensator"], Choice(VEHICLE, model=tmp_path), "holds no model.onnx"),
        (["compensator"], Choice(VEHICLE, model=fine, start=["gyro_w=1"]), "mean 'gyro_"),
        (["compensator"], Choice(VEHICLE, model=fine, start=["phase=9"]), "outside its range"),
    ):
        with pytest.raises(TwinError, match=words):
            export_components(names, choice)


@pytest.mark.slow
def test_a_model_of_rotor_speeds_reads_those_of_the_airframe(tmp_path: Path) -> None:
    """Which knows them where a speed belongs to each thrust."""
    fast = compensator()
    fast.feature_mean[-4:] = 1500.0
    network = interface_model(read_network(exported(fast, tmp_path)))
    wired = connected_by_name(parts_of(_twin("copter_default"), network))
    assert ("airframe.rotor_4", "compensator.rotor_4") in wired
    with pytest.raises(TwinError, match="reads rotor_1, rotor_2, rotor_3, rotor_4, which"):
        parts_of(_twin(VEHICLE), network)


def _twin(vehicle: str) -> Assembly:
    return flying_twin(load_vehicle(vehicle), "takeoff", effects=())


def test_start_values_are_baked_in(
    folder_of: Folder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fmus.builder.compile_library", lambda *_: b"")
    monkeypatch.setattr("uavtwin.exports.write.add_reference_results", lambda *_: None)
    export(
        ["compensator"],
        tmp_path / "out",
        vehicle=VEHICLE,
        model=folder_of("track"),
        start=["phase=2", "valid.gyro=1"],
    )
    description = fmpy.read_model_description(str(tmp_path / "out" / "compensator.fmu"))
    starts = {v.name: v.start for v in description.modelVariables}
    assert (float(starts["phase"]), starts["valid.gyro"], starts["valid.acc"]) == (
        2.0,
        "true",
        "false",
    )


# -- damaged, foreign, refused files --------------------------------------------------------


def test_damaged_files_are_refused(folder_of: Folder, tmp_path: Path) -> None:
    content = (folder_of("track") / FILE).read_bytes()
    weights = onnx.load(folder_of("track") / FILE).graph.initializer
    numbers = max((t.raw_data for t in weights), key=len)
    at = content.index(numbers) + len(numbers) // 2
    for damaged in (
        b"",
        b"PK",
        content[:-100],
        content[: len(content) // 2],
        content[:at] + b"\0\1\2\3" + content[at + 4 :],
    ):
        (tmp_path / FILE).write_bytes(damaged)
        with pytest.raises(FmuError, match=r"damaged|no compensator"):
            read_network(tmp_path)


def test_foreign_files_are_refused(folder_of: Folder, tmp_path: Path) -> None:
    graph = onnx.load(folder_of("track") / FILE)
    metadata: tuple[dict[str, Any], ...] = (
        {"rate_hz": 0},
        {"rate_hz": "fast"},
        {"channels": ["gyro_x"]},
        {"commands": ["cmd_1"]},
        {"units": ["furlong"] * 15},
        {"groups": ["gyro"]},
        {"uncorrected_rms": None},
        {"phases": []},
    )
    for i, said in enumerate(metadata):
        folder = changed(graph, tmp_path / f"{i}", **said)
        with pytest.raises(FmuError, match="metadata do not fit"):
            read_network(folder)
        graph = onnx.load(folder_of("track") / FILE)
    onnx.helper.set_model_props(graph, {"format": "somebody else's"})
    (tmp_path / FILE).write_bytes(graph.SerializeToString())
    with pytest.raises(FmuError, match="is no compensator"):
        read_network(tmp_path)


@pytest.mark.slow
def test_what_the_c_generator_refuses_becomes_a_python_slave(
    folder_of: Folder, new: New, tmp_path: Path
) -> None:
    """Here the operator GlobalLpPool; with the reason, and for FMI 2 alone."""
    graph = onnx.load(folder_of("track") / FILE)
    (last,) = (n for n in graph.graph.node if "inside" in n.output)
    last.output[0] = "plain"
    shapes = {"deep": [1, 1, 1], "flat": [1, 1]}
    for name, shape in shapes.items():
        graph.graph.initializer.append(onnx.numpy_helper.from_array(np.array(shape), name))
    node = onnx.helper.make_node
    graph.graph.node.extend(
        [
            node("Reshape", ["plain", "deep"], ["image"]),
            node("GlobalLpPool", ["image"], ["pooled"], p=1),
            node("Reshape", ["pooled", "flat"], ["inside"]),
        ]
    )
    folder = changed(graph, tmp_path / "pooled")
    with pytest.raises(UnsupportedNetworkError, match="GlobalLpPool"):
        compensator_model(folder)
    choice: dict[str, Any] = {"vehicle": VEHICLE, "model": folder}
    (row_,) = export(["compensator"], tmp_path / "out", **choice)
    assert "GlobalLpPool" in row_.note
    assert "onnxruntime" in row_.note
    for names, fmi, words in (
        (["compensator"], "3", "for FMI 2 alone"),
        (["corrected-twin"], "2", "export the compensator alone"),
    ):
        with pytest.raises(TwinError, match=words):
            export_components(names, Choice(**choice, fmi=fmi))
    rows = rows_of(flight(model("track"), 50))
    slave = Instance(unzip(tmp_path / "out" / "compensator.fmu", tmp_path / "slave"))
    found = fly(slave.start(), rows, range(50))
    slave.close()
    right = fly(new("track").start(), rows, range(50))
    np.testing.assert_allclose(found, right, TOLERANCE, TOLERANCE)
