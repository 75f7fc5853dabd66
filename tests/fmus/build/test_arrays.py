"""Arrays of FMI 3: which scalars go together, what is described, and the same bits as scalars."""

import zipfile
from dataclasses import replace
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu
from instance import Instance, unzip
from kinds import model
from lxml import etree

from cosim.master import Master
from cosim.system import Connection, System
from fmus import FmuModel, build
from fmus.model import arrays
from twin.component import Variable
from twin.errors import FmuError, TwinError
from uavtwin import component, export, twin, vehicle

_ENDS = ("input", "output")


def named(*names: str, unit: str = "m") -> list[Variable]:
    return [Variable(n, "output", unit, n) for n in names]


def grouped(table: list[Variable]) -> dict[str, int]:
    return {e.name: len(e.members) for e in arrays(table, lambda v: None)}


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (("pos_x", "pos_y", "pos_z"), {"pos": 3}),
        (("q_w", "q_x", "q_y", "q_z"), {"q": 4}),
        (("cmd_1", "cmd_2", "other"), {"cmd": 2, "other": 1}),
        (("der(pos_x)", "der(pos_y)", "der(pos_z)"), {"der(pos)": 3}),
        (("pos_x", "pos_y"), {"pos_x": 1, "pos_y": 1}),
        (("pos_y", "pos_x", "pos_z"), {"pos_y": 1, "pos_x": 1, "pos_z": 1}),
        (("cmd_1", "cmd_3"), {"cmd_1": 1, "cmd_3": 1}),
        (("cmd_1", "pos", "cmd_2"), {"cmd_1": 1, "pos": 1, "cmd_2": 1}),
        (("pos", "pos_x", "pos_y", "pos_z"), {"pos": 1, "pos_x": 1, "pos_y": 1, "pos_z": 1}),
    ],
)
def test_what_goes_together(names: tuple[str, ...], expected: dict[str, int]) -> None:
    assert grouped(named(*names)) == expected


@pytest.mark.parametrize(
    "change", [{"unit": "m/s"}, {"causality": "input"}, {"minimum": 0.0}, {"kind": "integer"}]
)
def test_what_differs_stays_apart(change: dict[str, object]) -> None:
    table = named("a_1", "a_2")
    table[1] = replace(table[1], **change)  # type: ignore[arg-type]
    assert grouped(table) == {"a_1": 1, "a_2": 1}


def test_descriptions_say_what_each_element_is() -> None:
    table = [
        Variable(f"pos_{a}", "output", "m", f"Position, NED {d}, at rest")
        for a, d in zip("xyz", ("north", "east", "down"), strict=True)
    ]
    (entry,) = arrays(table, lambda v: None)
    assert entry.description == "Position, NED north | east | down, at rest"


@pytest.fixture(scope="module", params=["airframe-crazyflie", "imu-filtered", "fused"])
def pair(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[FmuModel, Path, Path]:
    """A model with arrays, its FMU, and the FMU of the same with scalars."""
    folder, plain = tmp_path_factory.mktemp("arrays"), model(request.param)
    whole = replace(plain, arrays=True)
    return whole, build(whole, folder / "arrays.fmu", 3), build(plain, folder / "plain.fmu", 3)


@pytest.mark.slow
def test_fmpy_finds_no_problem_and_the_same_bits(pair: tuple[FmuModel, Path, Path]) -> None:
    whole, vectors, plain = pair
    assert validate_fmu(str(vectors)) == []
    many, single = (
        fmpy.simulate_fmu(str(p), stop_time=0.5, output_interval=0.01) for p in (vectors, plain)
    )
    outputs = [e for e in whole.entries if e.first.causality == "output"]
    assert set(many.dtype.names) == {"time", *(e.name for e in outputs)}
    assert max(len(e.members) for e in outputs) >= 3
    for entry in outputs:
        columns = np.column_stack([single[v.name] for v in entry.members])
        assert np.reshape(many[entry.name], columns.shape).tobytes() == columns.tobytes()


@pytest.mark.slow
def test_start_values_terminals_and_page(pair: tuple[FmuModel, Path, Path]) -> None:
    whole, vectors, _ = pair
    table = {v.name: v for v in fmpy.read_model_description(str(vectors)).modelVariables}
    for entry in (e for e in whole.entries if e.is_array):
        variable = table[entry.name]
        assert variable.shape == (len(entry.members),)
        if entry.first.causality in ("parameter", "input"):
            given = [float(x) for x in variable.start.split()]
            assert given == [v.start for v in entry.members]
    with zipfile.ZipFile(vectors) as archive:
        root = etree.fromstring(archive.read("terminalsAndIcons/terminalsAndIcons.xml"))
        page = archive.read("documentation/index.html").decode()
    members = [m.get("variableName") for m in root.iter("TerminalMemberVariable")]
    assert members and set(members) <= set(table)
    assert any(table[m].shape for m in members)
    assert "<h2>Arrays</h2>" in page


@pytest.mark.slow
def test_elements_are_set_and_their_derivatives_told(tmp_path: Path) -> None:
    """Directional derivatives of arrays are those of their elements, one after another."""
    plain = model("airframe-crazyflie")
    one, other = (
        Instance(unzip(build(m, tmp_path / f"{i}.fmu", 3), tmp_path / f"{i}"))
        for i, m in enumerate((replace(plain, arrays=True), plain))
    )
    push, felt = [0.1, -0.2, 0.05], [f"specific_force_{a}" for a in "xyz"]
    pushes = [f"force_{a}" for a in "xyz"]
    one.enter()
    one.fmu.setFloat64([one.reference["force"]], push)
    one.leave()
    other.start(dict(zip(pushes, push, strict=True)))
    got = one.fmu.getFloat64([one.reference["force"], one.reference["density"]], 4)
    assert list(got) == [*push, other.get("density")]
    seed = [0.3, -0.7, 1.1]
    tangents = [
        i.fmu.getDirectionalDerivative(
            [i.reference[n] for n in y], [i.reference[n] for n in u], seed, nSensitivity=3
        )
        for i, y, u in ((other, felt, pushes), (one, ["specific_force"], ["force"]))
    ]
    assert np.abs(tangents[0]).max() > 0
    assert tangents[0] == tangents[1]
    for size in (1, 2, 4):
        with pytest.raises(FMICallException):
            one.fmu.getFloat64([one.reference["force"]], size)
        assert "the number of values is not that of the variables" in one.messages[-1]
    for i in (one, other):
        i.close()


@pytest.mark.slow
def test_our_master_steps_it_and_refuses_to_connect_arrays(
    pair: tuple[FmuModel, Path, Path],
) -> None:
    whole, vectors, _ = pair
    names = {c: [e.name for e in whole.entries if e.first.causality == c] for c in _ENDS}
    arrays_of = {e.name for e in whole.entries if e.is_array}
    with Master(System({"a": vectors})) as master:
        master.initialize()
        assert set(master.run(0.01, 1e-3).names) == {
            f"a.{n}" for n in names["output"] if n not in arrays_of
        }
    (given, *_) = (n for n in names["output"] if n in arrays_of)
    with pytest.raises(FmuError, match=r"is an array of Float64; only Real, Integer, Boolean and"):
        Master(System({"a": vectors}), [f"a.{given}"])
    taken = [n for n in names["input"] if n in arrays_of]
    for name in taken[:1]:
        with pytest.raises(FmuError, match=r"is an array of Float64"):
            Master(System({"a": vectors}, (Connection(f"a.{given}", f"a.{name}"),)))
    start = next(e.name for e in whole.entries if e.is_array and e.first.causality == "parameter")
    with pytest.raises(FmuError, match=r"is an array of Float64"):
        Master(System({"a": vectors}, starts={f"a.{start}": 1.0}))


# -- the front door ---------------------------------------------------------------------------


@pytest.mark.slow
def test_export_with_arrays(tmp_path: Path) -> None:
    """By name and as a twin, which has no `.ssp` then; in FMI 2 refused."""
    battery = component("battery", vehicle("crazyflie"))
    result = export(battery, tmp_path / "battery.fmu", fmi=3, arrays=True)
    assert [f.fmi for f in result.files] == [3]
    for versions in (2, (2, 3)):
        with pytest.raises(TwinError, match="arrays are of FMI 3"):
            export(battery, tmp_path / "no.fmu", fmi=versions, arrays=True)
    with pytest.raises(TwinError, match=r"written as \.fmu; name such a file"):
        export(twin(vehicle("crazyflie")), tmp_path / "twin.ssp", fmi=3, arrays=True)


def test_fmi_2_has_none(tmp_path: Path) -> None:
    with pytest.raises(FmuError, match="arrays are of FMI 3"):
        build(replace(model("battery"), arrays=True), tmp_path / "battery.fmu", 2)
