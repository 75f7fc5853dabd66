"""Integers, truth values and enumerations of a native FMU: types, values, and what is refused."""

from collections.abc import Iterator
from pathlib import Path

import fmpy
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu
from instance import Instance, unzip

from cosim.interface import read_interface
from cosim.master import Master
from cosim.ssp import read_ssp, write_ssp
from cosim.system import Connection, System
from fmus import build, component_model, fuse
from twin.component import Component, ComponentBuilder, Enumeration
from twin.errors import FmuError, ModelError

GEAR = Enumeration("Gear", ("neutral", "first", "second"))
MORE = Enumeration("AnyGear", (*GEAR.items, "reverse"))


def chooser(gear: Enumeration = GEAR) -> Component:
    """Counts sample instants, holds what it was told at the last one."""
    m = ComponentBuilder("chooser", "Gears")
    m.sampled(0.1, "Time between two samples")
    wanted = m.input("wanted", "1", "Gear wanted", kind=gear)
    on = m.input("on", "1", "Whether it turns", kind="boolean")
    rate = m.input("rate", "1", "A number")
    step = m.parameter("step", 2.0, "1", "Counted per sample", minimum=-5, kind="integer")
    level = m.parameter("level", 0.0, "1", "Size of the noise")
    count, held = m.memory("count", "1", "Count"), m.memory("held", "1", "Rate then")
    m.update("count", count + step)
    m.update("held", rate + m.noise(level))
    m.output("count", "1", "Count", count, kind="integer")
    m.output("gear", "1", "Gear", wanted, kind=gear)
    m.output("turning", "1", "Whether it turns", on, kind="boolean")
    m.output("held", "1", "Rate at the last sample", held)
    m.output("rate_now", "1", "Rate, and what was held", rate + 0 * held)
    return m.build()


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    folder = tmp_path_factory.mktemp("kinds")
    model = component_model(chooser())
    return {fmi: build(model, folder / f"chooser{fmi}.fmu", fmi) for fmi in (2, 3)}


@pytest.fixture(params=[2, 3])
def instance(
    request: pytest.FixtureRequest, files: dict[int, Path], tmp_path: Path
) -> Iterator[Instance]:
    one = Instance(unzip(files[request.param], tmp_path))
    yield one
    one.close()


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
def test_description(files: dict[int, Path], fmi: int) -> None:
    assert validate_fmu(str(files[fmi])) == []
    described = fmpy.read_model_description(str(files[fmi]))
    table = {v.name: v for v in described.modelVariables}
    integer = "Integer" if fmi == 2 else "Int32"
    real = "Real" if fmi == 2 else "Float64"
    assert {n: (table[n].type, table[n].variability) for n in table if n != "time"} == {
        "sample_period": (real, "fixed"),
        "seed": (integer, "fixed"),
        "step": (integer, "tunable"),
        "level": (real, "tunable"),
        "wanted": ("Enumeration", "discrete"),
        "on": ("Boolean", "discrete"),
        "rate": (real, "continuous"),
        "count": (integer, "discrete"),
        "gear": ("Enumeration", "discrete"),
        "turning": ("Boolean", "discrete"),
        "held": (real, "discrete"),
        "rate_now": (real, "continuous"),
    }
    (gear,) = described.typeDefinitions
    assert (gear.name, [(i.name, int(i.value)) for i in gear.items]) == (
        "Gear",
        [("neutral", 0), ("first", 1), ("second", 2)],
    )
    assert (table["seed"].min, table["seed"].max) == ("0", str(2**31 - 1))


@pytest.mark.slow
def test_values_come_back(instance: Instance) -> None:
    """Also after a state was saved, and another value was set."""
    instance.start({"step": -3, "wanted": 2, "on": 1})
    instance.step(0.0, 0.25)
    names = ("count", "gear", "turning", "step")
    assert [instance.get(n) for n in names] == [-9, 2, 1, -3]
    state = instance.fmu.getFMUState()
    instance.set({"wanted": 1, "on": 0, "step": 4})
    instance.step(0.25, 0.1)
    assert [instance.get(n) for n in names] == [-5, 1, 0, 4]
    instance.fmu.setFMUState(state)
    assert [instance.get(n) for n in names] == [-9, 2, 1, -3]
    instance.fmu.freeFMUState(state)


@pytest.mark.slow
def test_the_wrong_function_says_so(instance: Instance) -> None:
    fmu, reference = instance.fmu, instance.reference
    real, integer = ("Real", "Integer") if instance.fmi == 2 else ("Float64", "Int32")
    for kind, name, what in (
        (real, "step", "step is an integer"),
        (real, "gear", "gear is an enumeration"),
        (integer, "turning", "turning is a truth value"),
        ("Boolean", "count", "count is an integer"),
        (integer, "rate", "rate is a real number"),
        *(() if instance.fmi == 2 else (("Int32", "gear", "gear is an enumeration"),)),
    ):
        for verb, values in (("get", ()), ("set", ([1],))):
            with pytest.raises(FMICallException):
                getattr(fmu, verb + kind)([reference[name]], *values)
            assert what in instance.messages[-1]


@pytest.mark.slow
def test_what_is_no_item_is_refused(instance: Instance) -> None:
    with pytest.raises(FMICallException):
        instance.set({"wanted": 3})
    assert "wanted = 3 is above its maximum 2" in instance.messages[-1]


@pytest.mark.parametrize(
    ("starts", "message"),
    [
        ({"seed": 1.5}, "seed = 1.5 must be a whole number"),
        ({"on": 0.5}, "on = 0.5 must be a whole number"),
        ({"wanted": 3}, "wanted = 3 is none of its values: 0 neutral, 1 first, 2 second"),
    ],
)
def test_python_refuses_the_same(starts: dict[str, float], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        chooser().with_starts(starts)
    assert chooser().with_starts({"seed": 3.0, "on": True, "wanted": 2.0}).inputs[0].start == 2


# -- connected -------------------------------------------------------------------------------


@pytest.mark.slow
def test_connected_saved_as_ssp_and_run(files: dict[int, Path], tmp_path: Path) -> None:
    """Each kind to its own, an enumeration by its codes to a number; the file gives the same."""
    system = System(
        {"a": files[2], "b": files[2]},
        (
            Connection("a.gear", "b.wanted"),
            Connection("a.turning", "b.on"),
            Connection("a.gear", "b.rate"),
        ),
        {"a.wanted": 2, "a.on": 1, "a.step": 7, "b.seed": 4},
    )
    runs = []
    for one in (system, read_ssp(write_ssp(system, tmp_path / "gears.ssp"))):
        with Master(one) as master:
            master.initialize()
            runs.append(master.run(0.3, 0.1, "settled").values)
            assert master.slaves[1].get("seed") == 4
            columns = dict(zip(master.record_names, runs[-1][-1], strict=True))
    assert columns["b.gear"] == columns["b.rate_now"] == 2
    assert (columns["b.turning"], columns["a.count"]) == (1, 28)
    assert runs[0].tobytes() == runs[1].tobytes()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("source", "target"),
    [
        ("held", "wanted"),
        ("count", "wanted"),
        ("count", "on"),
        ("turning", "wanted"),
        ("gear", "on"),
    ],
)
def test_what_would_mean_something_else_is_refused(
    files: dict[int, Path], source: str, target: str
) -> None:
    system = System({"a": files[2]}, (Connection(f"a.{source}", f"a.{target}"),))
    with pytest.raises(FmuError, match="rounded or mean something else"):
        system.check({"a": read_interface(files[2])})


@pytest.mark.slow
def test_an_enumeration_goes_where_all_its_items_are(
    files: dict[int, Path], tmp_path: Path
) -> None:
    more = build(component_model(chooser(MORE)), tmp_path / "more.fmu")
    paths = {"few": files[2], "more": more}
    interfaces = {name: read_interface(path) for name, path in paths.items()}
    System(paths, (Connection("few.gear", "more.wanted"),)).check(interfaces)
    with pytest.raises(FmuError, match="3 reverse is no value of the enumeration there"):
        System(paths, (Connection("more.gear", "few.wanted"),)).check(interfaces)
    parts = {"few": chooser(), "more": chooser(MORE).with_starts({"seed": 1})}
    fuse("both", "Both", parts, [("few.gear", "more.wanted")])
    for ends in (("more.gear", "few.wanted"), ("few.turning", "more.rate")):
        with pytest.raises(FmuError, match="kinds differ"):
            fuse("both", "Both", parts, [ends])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("step", 1.5, "step = 1.5 is no Integer value; whole numbers"),
        (
            "step",
            2.0**40,
            "step = 1099511627776 is no Integer value; whole numbers from -2147483648",
        ),
        ("on", 2, "on = 2 is no Boolean value; 0 and 1"),
        ("wanted", 3, "wanted = 3 is no Enumeration value; 0 neutral, 1 first, 2 second"),
    ],
)
def test_start_values_are_not_rounded(
    files: dict[int, Path], name: str, value: float, message: str
) -> None:
    system = System({"a": files[2]}, starts={f"a.{name}": value})
    with Master(system) as master, pytest.raises(FmuError, match=message):
        master.initialize()
