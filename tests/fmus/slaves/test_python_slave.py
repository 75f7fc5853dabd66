"""Python-slave FMUs: the bits of `Run` and of the native FMU, alone and beside one another."""

import hashlib
import json
import logging
import os
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu
from fmu_manipulation_toolbox.checker import get_checkers
from fmu_manipulation_toolbox.cli.utils import ErrorCounter
from fmu_manipulation_toolbox.operations import FMU
from instance import Array, Instance, token, unzip
from places import IMPORT_PATH
from sensor_rig import motion, readings

from cosim.master import Master
from cosim.system import System, connect
from fmus import build, component_model
from fmus.python_slave import build as python_slave
from fmus.python_slave.build import build_python_slave, component_text
from fmus.python_slave.script import read_component
from twin.component import Component, ComponentBuilder
from twin.effects import EFFECTS
from twin.errors import FmuError, ModelError
from twin.physics.airframe import airframe
from twin.physics.battery import battery
from twin.physics.sensors.imu import imu
from twin.physics.sensors.position import position_sensor
from twin.vehicle_file import load_vehicle

VEHICLE = load_vehicle("crazyflie")
COMPONENTS: dict[str, Callable[[], Component]] = {
    "airframe": lambda: airframe(VEHICLE, effects=EFFECTS),
    "imu": lambda: imu(VEHICLE, EFFECTS),
    "gnss": lambda: position_sensor(VEHICLE, EFFECTS),
    "battery": lambda: battery(VEHICLE),
}
SETTINGS = {
    "imu": {"acc_noise": 0.1, "gyro_bias_walk": 0.003, "sample_period": 0.0035, "seed": 11.0},
    "gnss": {"position_delay.delay_s": 0.037, "sample_period": 0.02},
}
SEVERAL = ("airframe", "imu", "gnss")
STEPS = 1000


@cache
def component(name: str) -> Component:
    return COMPONENTS[name]()


def settings(name: str) -> dict[str, float]:
    """Every effect on, and noise and delays with it."""
    switches = {v.name: 1.0 for v in component(name).parameters if v.name.endswith(".enabled")}
    return switches | SETTINGS.get(name, {})


def inputs(name: str, steps: int = STEPS) -> Array:
    """Inputs over time: around the start values for the airframe, anything for sensors."""
    u = motion(component(name), steps)
    return component(name).input_values() + 0.05 * u if name == "airframe" else u


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Name -> FMU."""
    folder = tmp_path_factory.mktemp("python")
    return cache(lambda name: build_python_slave(component(name), folder / f"{name}.fmu"))


@pytest.fixture(scope="module")
def folder(
    built: Callable[[str], Path], tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str], Path]:
    """Name -> the FMU, extracted."""
    there = tmp_path_factory.mktemp("extracted")
    return cache(lambda name: unzip(built(name), there / name))


class Logged(Instance):
    """An instance that says why it fails: pythonfmu says nothing unless logging is on."""

    def instantiate(self) -> None:
        self.fmu.instantiate(callbacks=self._callbacks, loggingOn=True)


def fly(instance: Instance, names: tuple[str, ...], u: Array, first: int = 0) -> Array:
    """Outputs after each step of a millisecond with the inputs held."""
    rows = []
    for k, row in enumerate(u, start=first):
        instance.set(dict(zip(names, row, strict=True)))
        instance.step(k * 1e-3)
        rows.append(instance.outputs())
    return np.array(rows)


# -- results ----------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", SEVERAL)
def test_run_slave_and_native_fmu_give_the_same_bits(
    name: str, folder: Callable[[str], Path], tmp_path: Path
) -> None:
    c, u = component(name), inputs(name)
    native = unzip(build(component_model(c), tmp_path / "native.fmu"), tmp_path)
    expected = readings(c, u, settings(name))
    for where in (folder(name), native):
        instance = Instance(where)
        instance.start(dict(zip(c.input_names, u[0], strict=True)) | settings(name))
        got = np.vstack([instance.outputs(), fly(instance, c.input_names, u)])
        instance.close()
        np.testing.assert_array_equal(got, expected)
    assert np.ptp(expected, axis=0).any()


@pytest.mark.slow
def test_through_the_master(built: Callable[[str], Path], tmp_path: Path) -> None:
    """In a system with a native FMU."""
    body, sensor = airframe(VEHICLE), component("imu")
    other = build(component_model(sensor), tmp_path / "imu.fmu")
    connections = connect("airframe", "imu", sensor.input_names)

    def run(path: Path) -> Array:
        with Master(System({"airframe": path, "imu": other}, connections)) as master:
            master.initialize()
            return master.run(0.1, 1e-3).values

    native = run(build(component_model(body), tmp_path / "a.fmu"))
    np.testing.assert_array_equal(run(build_python_slave(body, tmp_path / "b.fmu")), native)


def test_a_tunable_parameter_changes_on_the_way(folder: Callable[[str], Path]) -> None:
    instance = Instance(folder("battery")).start()
    before = instance.get("vbat_v")
    instance.set({"ibat_a": 2.0})
    sagged = instance.get("vbat_v")
    instance.set({"resistance": 2 * instance.get("resistance")})
    assert before - instance.get("vbat_v") == pytest.approx(2 * (before - sagged))
    instance.close()


# -- saved states -----------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", SEVERAL)
def test_rollback_is_exact(name: str, folder: Callable[[str], Path]) -> None:
    """Saved at random instants, run on, restored, run again, and in an instance never started."""
    c, u, rng = component(name), inputs(name), np.random.default_rng(1)
    instance = Instance(folder(name)).start(settings(name), time_s=0.5)
    other, done = Instance(folder(name)), 500
    for ahead in rng.integers(1, 40, size=10):
        fly(instance, c.input_names, u[done - 500 :][:ahead], done)
        done += int(ahead)
        state, coming = instance.fmu.getFMUState(), u[done - 500 :][:25]
        text = instance.fmu.serializeFMUState(state)
        once = fly(instance, c.input_names, coming, done)
        instance.fmu.setFMUState(state)
        assert instance.fmu.serializeFMUState(instance.fmu.getFMUState()) == text
        np.testing.assert_array_equal(fly(instance, c.input_names, coming, done), once)
        other.fmu.setFMUState(other.fmu.deserializeFMUState(text))
        np.testing.assert_array_equal(fly(other, c.input_names, coming, done), once)
        instance.fmu.setFMUState(state)
        instance.fmu.freeFMUState(state)
    instance.close()
    other.close()


def test_state_during_initialisation(folder: Callable[[str], Path]) -> None:
    instance = Instance(folder("battery"))
    instance.enter({"initial.charge": 0.25})
    state = instance.fmu.getFMUState()
    instance.leave()
    instance.run(3)
    instance.fmu.setFMUState(state)
    instance.set({"initial.charge": 0.5})
    assert instance.get("charge") == 0.5
    instance.leave()
    assert instance.get("charge") == 0.5
    instance.close()


@pytest.mark.slow
def test_foreign_states_are_refused(folder: Callable[[str], Path]) -> None:
    instance, foreign = Logged(folder("battery")).start(), Instance(folder("imu")).start()
    good = instance.fmu.serializeFMUState(instance.fmu.getFMUState())
    for content, text in (
        (foreign.fmu.serializeFMUState(foreign.fmu.getFMUState()), f"bytes, expected {len(good)}"),
        (b"\xff" * len(good), "another FMU or another version of this one"),
    ):
        with pytest.raises(FMICallException):
            instance.fmu.setFMUState(instance.fmu.deserializeFMUState(content))
        assert text in instance.messages[-1]
        assert instance.fmu.serializeFMUState(instance.fmu.getFMUState()) == good
    instance.close()
    foreign.close()


# -- failures ---------------------------------------------------------------------------------


def test_what_is_wrong_is_in_the_log(folder: Callable[[str], Path]) -> None:
    instance = Logged(folder("battery"))
    fmu, reference = instance.fmu, instance.reference

    def refused(text: str, call: Callable[..., object], *arguments: object) -> None:
        with pytest.raises(FMICallException):
            call(*arguments)
        assert text in instance.messages[-1]

    refused("battery: resistance = -1 Ohm is outside its range", instance.set, {"resistance": -1})
    refused("ibat_a = nan must be a finite number", instance.set, {"ibat_a": np.nan})
    refused("vbat_v is an output and cannot be set", instance.set, {"vbat_v": 1.0})
    refused("no variable has value reference 0", fmu.getReal, [0])
    refused("no variable has value reference 999", fmu.setReal, [999], [1.0])
    refused("vbat_v is of kind real, not integer", fmu.getInteger, [reference["vbat_v"]])
    refused("vbat_v cannot be read before initialization", instance.get, "vbat_v")
    refused("a step cannot be made before initialization", instance.step, 0.0)
    instance.start()
    refused("initial.charge is fixed once initialization", instance.set, {"initial.charge": 0.5})
    refused("step size -1 s must be positive", instance.step, 0.0, -1.0)
    refused("doStep at 1 s, but the FMU is at 0 s", instance.step, 1.0)
    instance.step(0.0)
    fmu.reset()
    assert (
        instance.start().get("charge")
        == component("battery").parameter_values()[
            [v.name for v in component("battery").parameters].index("initial.charge")
        ]
    )
    instance.close()


def test_no_step_goes_beyond_the_stop_time(folder: Callable[[str], Path]) -> None:
    instance = Logged(folder("battery"))
    instance.fmu.setupExperiment(startTime=1.0, stopTime=1.02)
    instance.fmu.enterInitializationMode()
    instance.leave()
    for k in range(2):
        instance.step(1.0 + 0.01 * k, 0.01)
    with pytest.raises(FMICallException):
        instance.step(1.02, 0.01)
    assert "doStep to 1.03 s, beyond the stop time 1.02 s" in instance.messages[-1]
    instance.fmu.terminate()
    instance.close()


def test_a_diverging_model_stops(tmp_path: Path) -> None:
    m = ComponentBuilder("blast", "Finite escape time")
    x = m.state("x", "1", "State", 1.0)
    m.derivative("x", 1e3 * x * x)
    m.output("x", "1", "State", x)
    instance = Logged(unzip(build_python_slave(m.build(), tmp_path / "b.fmu"), tmp_path)).start()
    with pytest.raises(FMICallException):
        instance.run(100)
    assert "blast: state x = " in instance.messages[-1]
    assert "the simulation has diverged" in instance.messages[-1]
    instance.close()


def test_pythonfmu_is_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pythonfmu", None)
    with pytest.raises(FmuError, match="battery: a Python slave needs pythonfmu: pip install"):
        build_python_slave(component("battery"), tmp_path / "b.fmu")


def test_equations_of_another_casadi() -> None:
    written = json.loads(component_text(component("battery")))
    written["step"] = {"casadi": "99.1", "function": "jhpn"}
    with pytest.raises(ModelError, match=r"cannot read the equations: install casadi 99\.1"):
        read_component(json.dumps(written))


# -- one process ------------------------------------------------------------------------------

# pythonfmu's libraries read freed memory when a process that held several of them unloads them at
# its end, and sometimes abort it there: after the last output these processes leave without that.
ROWS = """
import os, sys
from pathlib import Path
from instance import Instance
instances = [Instance(Path(folder)).start({"seed": 5}) for folder in sys.argv[1:]]
for k in range(50):
    for instance in instances:
        instance.step(k * 1e-3)
for instance in instances:
    print(instance.outputs().tobytes().hex())
    instance.close()
sys.stdout.flush()
os._exit(0)
"""

ALONE = """
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("twin", "fmus", "cosim", "learning", "pythonfmu"):
            raise ModuleNotFoundError(f"{name} is not here")

sys.meta_path.insert(0, Absent())
import fmpy
before = list(sys.path)
result = fmpy.simulate_fmu(sys.argv[1], stop_time=0.1, step_size=1e-3, output_interval=1e-3)
assert sys.path == before
for name in result.dtype.names:
    print(name, result[name].tobytes().hex())
"""

MANY = """
import gc, os, sys
from pathlib import Path
from instance import Instance
for k in range(60):
    instance = Instance(Path(sys.argv[1])).start()
    for time_s in (7.0, 8.0):
        try:
            instance.step(time_s)
        except Exception:
            instance.fmu.reset()
            instance.start()
    instance.step(0.0)
    instance.close()
    gc.collect()
print("survived", flush=True)
os._exit(0)  # pythonfmu's library may crash as it is unloaded: twice in some 130 runs
"""


def output(program: str, *arguments: Path, here: Path) -> list[str]:
    """Lines that a program prints in a process of its own."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    if program != ALONE:
        environment["PYTHONPATH"] = f"{IMPORT_PATH}{os.pathsep}{Path(__file__).parent}"
    result = subprocess.run(
        [sys.executable, "-c", program, *map(str, arguments)],
        cwd=here,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout.splitlines()


@pytest.mark.slow
def test_versions_of_one_component_do_not_meet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Other start values, another equation, another noise generator: each as when alone."""
    noisy = imu(VEHICLE).with_starts({"acc_noise": 0.1})
    modules = python_slave._modules

    def altered(module: str) -> dict[str, str]:
        return {
            name: text.replace("q = p - 0.5", "q = 0.5 - p")
            for name, text in modules(module).items()
        }

    made = [
        build_python_slave(noisy, tmp_path / "0.fmu"),
        build_python_slave(noisy.with_starts({"gyro_noise": 0.1}), tmp_path / "1.fmu"),
        build_python_slave(imu(load_vehicle("copter_default"), EFFECTS), tmp_path / "2.fmu"),
    ]
    monkeypatch.setattr(python_slave, "_modules", altered)
    made.append(build_python_slave(noisy, tmp_path / "3.fmu"))
    folders = [unzip(path, path.with_suffix("")) for path in made]
    alone = [output(ROWS, folder, here=tmp_path)[0] for folder in folders]
    assert len(set(alone)) == len(alone)
    assert output(ROWS, *folders, *folders, here=tmp_path) == alone + alone
    assert output(ROWS, *reversed(folders), here=tmp_path) == alone[::-1]


@pytest.mark.slow
def test_nothing_of_this_repository_is_needed(built: Callable[[str], Path], tmp_path: Path) -> None:
    c = component("airframe")
    rows = dict(line.split() for line in output(ALONE, built("airframe"), here=tmp_path))
    expected = readings(c, np.tile(c.input_values(), (100, 1)))
    for name, column in zip(c.output_names, expected.T, strict=True):
        if name in rows and not next(v for v in c.variables if v.name == name).boolean:
            assert rows[name] == column.tobytes().hex(), name
    assert len(rows) == 1 + len(c.output_names)


@pytest.mark.slow
def test_failures_and_many_instances_do_not_end_the_process(
    folder: Callable[[str], Path], tmp_path: Path
) -> None:
    """pythonfmu alone gives back too many references, and the process crashes."""
    assert output(MANY, folder("battery"), here=tmp_path) == ["survived"]


# -- archive ----------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", COMPONENTS)
def test_checkers_find_no_problem(name: str, built: Callable[[str], Path]) -> None:
    assert validate_fmu(str(built(name))) == []
    logger, errors = logging.getLogger("fmu_manipulation_toolbox"), ErrorCounter()
    logger.addHandler(errors)
    try:
        with FMU(str(built(name))) as fmu:
            for checker in get_checkers():
                fmu.apply_operation(checker())
    finally:
        logger.removeHandler(errors)
    assert errors.count == 0


def test_description_is_that_of_the_native_fmu(
    built: Callable[[str], Path], tmp_path: Path
) -> None:
    """Apart from what the slave cannot do, and what it needs."""
    native, python = (
        fmpy.read_model_description(str(path))
        for path in (build(component_model(component("imu")), tmp_path / "i.fmu"), built("imu"))
    )
    assert python.description.startswith(native.description)
    assert "needs a Python host with numpy and casadi" in python.description
    simulation = python.coSimulation
    assert simulation.needsExecutionTool and not simulation.providesDirectionalDerivative
    assert simulation.canGetAndSetFMUstate and simulation.canSerializeFMUstate
    assert python.guid != native.guid
    for a, b in zip(native.modelVariables, python.modelVariables, strict=True):
        for what in ("name", "valueReference", "type", "causality", "variability", "start", "unit"):
            assert getattr(a, what) == getattr(b, what)
    for group in ("outputs", "initialUnknowns"):
        for a, b in zip(getattr(native, group), getattr(python, group), strict=True):
            assert [v.name for v in a.dependencies] == [v.name for v in b.dependencies]


@pytest.mark.slow
def test_same_component_same_bytes(built: Callable[[str], Path], tmp_path: Path) -> None:
    first = hashlib.sha256(built("imu").read_bytes()).hexdigest()
    program = (
        "import sys, hashlib; from pathlib import Path; from test_python_slave import *; "
        "p = build_python_slave(component('imu'), Path('again.fmu')); "
        "print(hashlib.sha256(p.read_bytes()).hexdigest())"
    )
    assert output(program, here=tmp_path) == [first]
    other = component("imu").with_starts({"seed": 12})
    tokens = {
        token(unzip(path, tmp_path / path.stem))
        for path in (built("imu"), build_python_slave(other, tmp_path / "other.fmu"))
    }
    assert len(tokens) == 2


@pytest.mark.slow
@pytest.mark.parametrize("name", COMPONENTS)
def test_a_component_travels_unchanged(name: str) -> None:
    text = component_text(component(name))
    assert component_text(read_component(text)) == text
