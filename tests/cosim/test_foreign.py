"""FMUs of other tools: all scalar types, what is ignored, what is refused, what they may say."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from alter import altered

from cosim.interface import read_interface
from cosim.master import Master
from cosim.system import Connection, System
from fmus import build, component_model
from twin.component import ComponentBuilder
from twin.errors import FmuError

MIXED = '''
from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, Integer, Real, String

CONTINUOUS, DISCRETE = Fmi2Variability.continuous, Fmi2Variability.discrete
TABLE = {
    "parameter": [(Real, "gain"), (String, "label"), (Boolean, "on")],
    "input": [(Real, "u"), (Integer, "number"), (Boolean, "flag")],
    "output": [(Real, "y"), (Integer, "count"), (Integer, "seen"), (Boolean, "nor"),
               (String, "said")],
}


class Mixed(Fmi2Slave):
    """Scalars of all types."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.gain, self.label, self.on = 2.0, "text", True
        self.u, self.number, self.flag = 0.0, 0, False
        self.y, self.count, self.seen, self.nor, self.said = 0.0, 0, 0, False, "nothing"
        for causality, variables in TABLE.items():
            for kind, name in variables:
                variability = CONTINUOUS if kind is Real else DISCRETE
                if causality == "parameter":
                    variability = Fmi2Variability.tunable
                self.register_variable(
                    kind(name, causality=Fmi2Causality[causality], variability=variability)
                )

    def do_step(self, time, step):
        self.count += 1
        self.y, self.seen, self.nor = self.gain * self.u, self.number + 1, not self.flag
        return self.count < 5
'''


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pythonfmu slave; it asks to end the simulation in its fifth step."""
    from pythonfmu.builder import FmuBuilder

    folder = tmp_path_factory.mktemp("mixed")
    script = folder / "mixed.py"
    script.write_text(MIXED)
    return Path(FmuBuilder.build_FMU(str(script), dest=str(folder)))


@pytest.fixture(scope="module")
def lag(tmp_path_factory: pytest.TempPathFactory) -> Callable[[int], Path]:
    """A small FMU of ours, to be altered."""
    m = ComponentBuilder("lag", "A lag")
    u = m.input("u", "1", "Input")
    x = m.state("x", "1", "State", 0.0)
    m.derivative("x", u - x)
    m.output("y", "1", "Output", x)
    folder = tmp_path_factory.mktemp("lag")
    made = {f: build(component_model(m.build()), folder / f"lag{f}.fmu", f) for f in (2, 3)}
    return made.__getitem__


def test_scalars_of_all_types(mixed: Path) -> None:
    """Integers and truth values pass between slaves, texts stay where they are."""
    system = System(
        {"a": mixed, "b": mixed},
        (
            Connection("a.seen", "b.number"),
            Connection("a.nor", "b.flag"),
            Connection("a.count", "b.u"),  # an integer is a real number
        ),
        {"a.number": 41, "a.flag": 1, "b.gain": 0.5},
    )
    with Master(system) as master:
        assert "a.said" not in master.record_names
        master.initialize()
        run = master.run(0.4, 0.1, "jacobi")
    assert run["a.seen"].tolist() == [0, 42, 42, 42, 42]
    assert run["b.seen"].tolist() == [0, 1, 43, 43, 43]
    assert run["a.nor"].tolist() == [0, 0, 0, 0, 0]
    assert run["b.nor"].tolist() == [0, 1, 1, 1, 1]
    assert run["b.y"].tolist() == [0, 0, 0.5, 1.0, 1.5]


def test_a_step_that_ends_the_simulation(mixed: Path) -> None:
    with Master(System({"a": mixed})) as master:
        master.initialize()
        with pytest.raises(
            FmuError,
            match=r"a \(Mixed\.fmu\): step at 0\.4 s: the FMU asked to end the simulation at .* s "
            r"instead of 0\.5 s: .*"
            r"Choose a shorter step or an earlier stop time",
        ):
            master.run(1.0, 0.1)


@pytest.mark.parametrize(
    ("connection", "message"),
    [
        (Connection("a.y", "b.number"), r"a\.y \(Real\) -> b\.number \(Integer\): .* rounded"),
        (Connection("a.seen", "b.flag"), r"a\.seen \(Integer\) -> b\.flag \(Boolean\): .* rounded"),
        (Connection("a.said", "b.u"), r"Mixed\.fmu: said is String; only Real, Integer, Boolean"),
    ],
)
def test_connections_that_would_lose_something(
    mixed: Path, connection: Connection, message: str
) -> None:
    with pytest.raises(FmuError, match=message):
        Master(System({"a": mixed, "b": mixed}, (connection,)))


def test_texts_are_not_recorded_nor_set(mixed: Path) -> None:
    with pytest.raises(FmuError, match=r"said is String"):
        Master(System({"a": mixed}), ["a.said"])
    with pytest.raises(FmuError, match=r"label is String"):
        Master(System({"a": mixed}, starts={"a.label": 1.0}))


ARRAY = {
    r"(</ModelVariables>)": r'<Float64 name="grid" valueReference="77" causality="output" '
    r'variability="continuous"><Dimension start="3"/></Float64>\1',
    r"(<Output )": r'<Output valueReference="77"/>\1',
    r"(<InitialUnknown )": r'<InitialUnknown valueReference="77"/>\1',
}


def test_arrays_are_left_alone(lag: Callable[[int], Path]) -> None:
    fmu = altered(lag(3), "array.fmu", ARRAY)
    with Master(System({"a": fmu})) as master:
        assert master.record_names == ("a.y",)
        master.initialize()
        master.run(0.1, 0.01)
    system = System({"a": fmu, "b": lag(2)}, (Connection("a.grid", "b.u"),))
    with pytest.raises(FmuError, match=r"array\.fmu: grid is an array of Float64; only .* scalars"):
        Master(system)


FLAGS = {
    "earlyReturn": r"gave up at 0\.01 s instead of 0\.01 s",
    "terminateSimulation": r"asked to end the simulation at 0\.01 s",
    "eventHandlingNeeded": r"asks for event mode, which is not supported",
}


@pytest.mark.slow
@pytest.mark.parametrize("flag", FLAGS)
def test_what_fmi3_tells_after_a_step(lag: Callable[[int], Path], flag: str) -> None:
    source = {f"if ({flag}) *{flag} = fmi3False;": f"if ({flag}) *{flag} = fmi3True;"}
    fmu = altered(lag(3), f"{flag}.fmu", source=source)
    with Master(System({"a": fmu})) as master:
        master.initialize()
        with pytest.raises(
            FmuError, match=rf"a \({flag}\.fmu\): step at 0 s: the FMU {FLAGS[flag]}"
        ):
            master.run(1.0, 0.01)


STEP2 = "return status(c, core_step(c, time, h));"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("answer", "message"),
    [
        ("fmi2Discard", r"step at 0 s: the FMU gave up at 0\.1 s instead of 0\.1 s"),
        ("fmi2Pending", r"asynchronous steps \(fmi2Pending\) are not supported"),
        ("fmi2Error", r"step at 0 s: the FMU gave no reason"),
        ("fmi2Fatal", r"step at 0 s: the FMU gave no reason"),
    ],
)
def test_what_fmi2_answers(lag: Callable[[int], Path], answer: str, message: str) -> None:
    source = {STEP2: f"status(c, core_step(c, time, h)); return {answer};"}
    fmu = altered(lag(2), f"{answer}.fmu", source=source)
    with Master(System({"a": fmu})) as master:
        master.initialize()
        with pytest.raises(FmuError, match=message):
            master.run(1.0, 0.1)


@pytest.mark.slow
def test_warnings_do_not_stop(lag: Callable[[int], Path]) -> None:
    fmu = altered(
        lag(2),
        "warns.fmu",
        source={STEP2: f"{STEP2[:-1].replace('return ', '')}; return fmi2Warning;"},
    )
    with Master(System({"a": fmu})) as master:
        master.initialize()
        assert master.run(1.0, 0.1).steps == 10


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
def test_a_stop_time_is_passed_on(lag: Callable[[int], Path], fmi: int) -> None:
    """An FMU that refuses to be initialised without."""
    old = "(void)toleranceDefined, (void)tolerance;"
    source = {old: f"if (!stopTimeDefined || stopTime != 3) return fmi{fmi}Error; {old}"}
    fmu = altered(lag(fmi), f"stops{fmi}.fmu", source=source)
    with Master(System({"a": fmu})) as master:
        with pytest.raises(FmuError, match=r"a \(stops.\.fmu\): (setupExp|enterInit)"):
            master.initialize()
        master.initialize(stop_time_s=3.0)
        with pytest.raises(FmuError, match=r"3\.1 s is beyond the stop time 3 s"):
            master.run(3.1, 0.1)
        master.run(3.0, 0.1)


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize(
    ("start_s", "stop_s", "step_s"), [(0, 0.3, 0.1), (0.7, 1.7, 0.1), (0, 1, 1 / 3)]
)
def test_no_step_ends_beyond_a_stop_time(
    lag: Callable[[int], Path], fmi: int, start_s: float, stop_s: float, step_s: float
) -> None:
    """Not even by a rounding error: an FMU may compare the numbers as they are."""
    beyond = "time + h > ((Instance*)c)->state->stop_time"
    call = "core_step(c, time, h)"
    source = {call: f"{beyond} ? -1 : {call}"}
    fmu = altered(lag(fmi), f"strict{fmi}_{start_s}_{step_s:.1f}.fmu", source=source)
    with Master(System({"a": fmu})) as master:
        master.initialize(start_s, stop_time_s=stop_s)
        assert master.run(stop_s, step_s).time_s[-1] == pytest.approx(stop_s)
        if step_s == 0.1:
            master.initialize(start_s, stop_time_s=stop_s)
            master.run_adaptive(stop_s, step_s, 1e-3)


def test_nominal_values_and_abilities(lag: Callable[[int], Path]) -> None:
    changes = {r'(name="y"[^>]*>\s*<Real[^>]*?) nominal="[^"]*"': r'\1 nominal="-250"'}
    interface = read_interface(altered(lag(2), "nominal.fmu", changes))
    assert interface.ports["y"].nominal == 250.0
    assert interface.ports["u"].nominal == 1.0
    assert interface.saves_state
    assert interface.has_derivatives
    assert interface.varies_step


def test_instances_of_one_file_are_apart(lag: Callable[[int], Path]) -> None:
    """Each has its own copy of the library, so even a static variable is its own."""
    system = System({f"a{i}": lag(2) for i in range(5)}, starts={f"a{i}.u": i for i in range(5)})
    with Master(system) as master:
        master.initialize()
        run = master.run(5.0, 0.1)
    np.testing.assert_allclose(run.values[-1], (1 - np.exp(-5.0)) * np.arange(5), rtol=1e-9)


def test_model_exchange_alone_is_refused(lag: Callable[[int], Path]) -> None:
    fmu = altered(lag(3), "exchange.fmu", {"(</?)CoSimulation": r"\1ModelExchange"})
    with pytest.raises(FmuError, match=r"exchange\.fmu: not a"):
        Master(System({"a": fmu}))
