"""Steps in C against those in Python: the same bits, the same errors, and Ctrl-C."""

import os
import signal
import threading
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import get_args

import pytest
from bad_fmu import bad_fmu
from reference_fmu import MODELS, reference_fmu

from cosim.compiled import library
from cosim.master import Algorithm, Interrupted, Master, Recording, RunError
from cosim.slave import Slave
from cosim.system import Connection, System, connect
from fmus import build, component_model
from twin.physics.airframe import airframe
from twin.physics.sensors.imu import imu
from twin.vehicle_file import load_vehicle

Made = Callable[[str, int], Path]
ERRORS = ("nan", "inf", "error", "discard", "fatal", "pending", "unknown_status")
PYTHON = """
import signal
from pythonfmu import Fmi2Causality, Fmi2Slave, Real


class Clock(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.y = 0.0
        self.register_variable(Real("y", causality=Fmi2Causality.output))

    def do_step(self, time, step):
        self.y += 1.0
        if self.y == 7.0:
            signal.raise_signal(signal.SIGINT)
        return True
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Airframe, IMU and the Reference FMUs, by FMI version."""
    folder = tmp_path_factory.mktemp("fmus")
    vehicle = load_vehicle("copter_default")
    ours = {"airframe": airframe(vehicle), "imu": imu(vehicle)}

    def one(name: str, fmi: int) -> Path:
        if name in MODELS:
            return reference_fmu(name, fmi, folder)
        return build(component_model(ours[name]), folder / f"{name}{fmi}.fmu", fmi)

    return cache(one)


@pytest.fixture
def flying(made: Made) -> System:
    """Two airframes with an IMU each, in both FMI versions."""
    fmus, connections = dict[str, Path](), list[Connection]()
    for fmi in (2, 3):
        fmus[f"airframe{fmi}"], fmus[f"imu{fmi}"] = made("airframe", fmi), made("imu", 5 - fmi)
        names = imu(load_vehicle("copter_default")).input_names
        connections += connect(f"airframe{fmi}", f"imu{fmi}", names)
    return System(fmus, tuple(connections), {"airframe2.initial.omega_x": 0.7})


@pytest.fixture
def default_handler() -> Iterator[None]:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a job of a shell has none
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def in_c(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Makes steps in Python fail."""

    def refuse() -> None:
        monkeypatch.setattr(Slave, "step", lambda *_: pytest.fail("a step in Python"))

    return refuse


def same(one: Recording, other: Recording) -> bool:
    """Whether two recordings are equal to the last bit."""
    bits = [(r.time_s.tobytes(), r.values.tobytes(), r.values.shape) for r in (one, other)]
    facts = [(r.names, r.steps, r.incomplete) for r in (one, other)]
    return bits[0] == bits[1] and facts[0] == facts[1]


@pytest.mark.parametrize("algorithm", get_args(Algorithm))
def test_the_same_bits(flying: System, algorithm: Algorithm, in_c: Callable[[], None]) -> None:
    """Some columns in another order, decimated, in two parts, up to a stop time."""
    record = ["imu3.acc_x", "airframe2.pos_z", "imu2.gyro_y", "airframe3.pos_z"]

    def runs(compiled: bool) -> list[Recording]:
        with Master(flying, record, compiled=compiled) as master:
            master.initialize(0.5, stop_time_s=0.7)
            return [master.run(end_s, 1e-3, algorithm, every=3) for end_s in (0.55, 0.7)]

    python = runs(compiled=False)
    in_c()
    assert all(map(same, runs(compiled=True), python))
    assert python[1].values.any()


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("algorithm", get_args(Algorithm))
def test_all_types(made: Made, algorithm: Algorithm, fmi: int) -> None:
    """Integers, truth values and codes from a chain of FMUs, with what changes in front."""
    feed = made("FEEDTHROUGH", fmi)
    names = ("a", "b", "n", "flag", "option")
    system = System(
        {"stair": made("STAIR", fmi), "one": feed, "two": feed},
        (
            Connection("stair.counter", "one.n_in"),
            Connection("stair.counter", "one.a_in"),
            *(Connection(f"one.{n}_out", f"two.{n}_in") for n in names),
        ),
        {"one.b_in": -2.25, "one.flag_in": 1.0, "one.option_in": 2.0},
    )
    found = []
    for compiled in (True, False):
        with Master(system, compiled=compiled) as master:
            master.initialize()
            found.append(master.run(4.0, 0.2, algorithm))
    assert same(*found)
    ends = [found[0][f"two.{n}_out"][-1] for n in names]
    assert len({*found[0]["two.n_out"]}) > 2
    assert ends[1:2] + ends[3:] == [-2.25, 1.0, 2.0]


@pytest.mark.parametrize("kind", ERRORS)
def test_the_same_errors(kind: str, tmp_path: Path, made: Made) -> None:
    system = System(
        {"before": made("DAHLQUIST", 2), kind: bad_fmu(tmp_path), "after": made("STAIR", 3)}
    )
    found = []
    for compiled in (True, False):
        with Master(system, compiled=compiled) as master:
            master.initialize()
            with pytest.raises(RunError) as caught:
                master.run(1.0, 0.1)
        found.append(caught.value)
    assert str(found[0]) == str(found[1])
    assert same(found[0].recording, found[1].recording)
    assert found[0].recording.incomplete


def test_a_run_without_a_compiler(flying: System, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    assert library.__wrapped__() is None
    monkeypatch.setattr("cosim.stepping.library", lambda: None)
    with Master(flying) as master:
        master.initialize()
        assert master.run(0.01, 1e-3).steps == 10


@pytest.mark.usefixtures("default_handler")
def test_interruption_in_the_python_code_of_an_fmu(tmp_path: Path) -> None:
    """The step is finished, whatever the FMU does in it."""
    from pythonfmu.builder import FmuBuilder

    script = tmp_path / "clock.py"
    script.write_text(PYTHON)
    fmu = Path(FmuBuilder.build_FMU(str(script), dest=str(tmp_path)))
    with Master(System({"clock": fmu})) as master:
        master.initialize()
        with pytest.raises(Interrupted, match=r"interrupted at 0\.7 s") as caught:
            master.run(1.0, 0.1)
        rest = master.run(1.0, 0.1)
    assert rest["clock.y"].tolist() == [*range(7, 11)]
    assert caught.value.recording["clock.y"].tolist() == [*range(8)]
    assert caught.value.recording.steps == 7
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.usefixtures("default_handler")
def test_interruption_of_an_endless_run(made: Made) -> None:
    """From another thread, as the first steps are done."""
    threads: list[threading.Thread] = []

    def interrupt(time_s: float) -> None:
        if not threads:
            threads.append(threading.Thread(target=os.kill, args=(os.getpid(), signal.SIGINT)))
            threads[0].start()

    with Master(System({"one": made("DAHLQUIST", 3)})) as master:
        master.initialize()
        with pytest.raises(Interrupted, match="interrupted at") as caught:
            master.run(1e8, 0.1, every=10**9, progress=interrupt)
    threads[0].join()
    assert caught.value.recording.steps >= 1000
    assert len(caught.value.recording.time_s) == 1
