"""Real time: paced by deadlines, lateness told, interruptible."""

import time

import pytest

from cosim.master import Master, Pace
from cosim.recording import Interrupted
from cosim.slave import Slave
from cosim.system import System
from fmus import build, component_model
from twin.component import ComponentBuilder
from twin.errors import FmuError


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> System:
    m = ComponentBuilder("clock", "Counts seconds")
    x = m.state("x", "s", "Time", 0.0)
    m.derivative("x", 1.0)
    m.output("y", "s", "Time", x)
    path = tmp_path_factory.mktemp("realtime") / "clock.fmu"
    return System({"clock": build(component_model(m.build()), path)})


class Clock:
    """Moves by what is slept, and by hand."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s, self.slept = 100.0, list[float]()
        monkeypatch.setattr(time, "perf_counter", lambda: self.now_s)
        monkeypatch.setattr(time, "sleep", self._sleep)

    def _sleep(self, duration_s: float) -> None:
        self.slept.append(duration_s)
        self.now_s += duration_s


@pytest.mark.parametrize("factor", [1.0, 4.0])
def test_takes_as_long_as_it_says(
    system: System, factor: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = Clock(monkeypatch)
    with Master(system) as master:
        master.initialize()
        run = master.run(0.4, 0.01, realtime=factor)
    assert clock.now_s == pytest.approx(100.0 + 0.4 / factor)
    assert run["clock.y"][-1] == pytest.approx(0.4)
    assert run.lateness_s == 0.0


def test_by_the_clock_of_the_machine(system: System) -> None:
    """It may be late, and then says so."""
    with Master(system) as master:
        master.initialize()
        begin = time.perf_counter()
        run = master.run(0.4, 0.01, realtime=1.0)
        taken = time.perf_counter() - begin
    assert taken >= 0.4 and 0 <= run.lateness_s < taken


def test_a_late_step_delays_none_after_it(system: System, monkeypatch: pytest.MonkeyPatch) -> None:
    """The clock of the test moves by what is slept and by 35 ms in one step."""
    clock = Clock(monkeypatch)
    step = Slave.step

    def slow(slave: Slave, time_s: float, step_s: float) -> None:
        if time_s == pytest.approx(0.05):
            clock.now_s += 0.035
        step(slave, time_s, step_s)

    monkeypatch.setattr(Slave, "step", slow)
    with Master(system) as master:
        master.initialize()
        run = master.run(0.2, 0.01, realtime=1.0)
    assert clock.now_s == pytest.approx(100.2)
    assert run.lateness_s == pytest.approx(0.025)
    assert clock.slept == pytest.approx([0.01] * 5 + [0.005] + [0.01] * 11)


def test_interruption_between_steps(system: System, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = 0

    def wait(pace: Pace, time_s: float) -> None:
        nonlocal calls
        calls += 1
        if calls == 5:
            raise KeyboardInterrupt

    monkeypatch.setattr(Pace, "wait", wait)
    with Master(system) as master:
        master.initialize()
        with pytest.raises(Interrupted, match=r"interrupted at 0\.05 s") as caught:
            master.run(0.1, 0.01, realtime=1.0)
        recording = caught.value.recording
        assert recording.time_s.tolist() == [0.01 * k for k in range(6)]
        assert recording.steps == 5
        rest = master.run(0.1, 0.01, realtime=1.0)
        master.initialize()
        whole = master.run(0.1, 0.01)
    assert rest["clock.y"].tolist() == whole["clock.y"][5:].tolist()


def test_interruption_within_a_step(system: System, monkeypatch: pytest.MonkeyPatch) -> None:
    """Some slaves may have stepped and some not: there is nothing to go on from."""

    def step(slave: Slave, time_s: float, step_s: float) -> None:
        raise KeyboardInterrupt

    with Master(system, compiled=False) as master:
        master.initialize()
        with monkeypatch.context() as patched:
            patched.setattr(Slave, "step", step)
            with pytest.raises(Interrupted):
                master.run(0.1, 0.01)
        with pytest.raises(FmuError, match="call initialize"):
            master.run(0.1, 0.01)
        master.initialize()
        master.run(0.1, 0.01)


@pytest.mark.parametrize("factor", [0.0, -1.0, float("nan"), float("inf")])
def test_wrong_factor(system: System, factor: float) -> None:
    with Master(system) as master:
        master.initialize()
        with pytest.raises(FmuError, match=r"realtime = .*: needs a positive factor"):
            master.run(0.1, 0.01, realtime=factor)
