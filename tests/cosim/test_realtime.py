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


LATE_S = 1.2
"""Less than what four times the speed makes of the wrong end; a busy machine is late."""


@pytest.mark.parametrize("factor", [1.0, 4.0])
def test_takes_as_long_as_it_says(system: System, factor: float) -> None:
    with Master(system) as master:
        master.initialize()
        begin = time.perf_counter()
        run = master.run(0.4, 0.01, realtime=factor)
        taken = time.perf_counter() - begin
    assert 0.4 / factor <= taken < 0.4 / factor + LATE_S
    assert run["clock.y"][-1] == pytest.approx(0.4)
    assert 0 <= run.lateness_s < LATE_S


def test_a_late_step_delays_none_after_it(system: System, monkeypatch: pytest.MonkeyPatch) -> None:
    """The clock of the test moves by what is slept and by 30 ms in one step."""
    now = 100.0
    slept: list[float] = []

    def sleep(duration_s: float) -> None:
        nonlocal now
        slept.append(duration_s)
        now += duration_s

    monkeypatch.setattr(time, "perf_counter", lambda: now)
    monkeypatch.setattr(time, "sleep", sleep)
    step = Slave.step

    def slow(slave: Slave, time_s: float, step_s: float) -> None:
        nonlocal now
        if time_s == pytest.approx(0.05):
            now += 0.035
        step(slave, time_s, step_s)

    monkeypatch.setattr(Slave, "step", slow)
    with Master(system) as master:
        master.initialize()
        run = master.run(0.2, 0.01, realtime=1.0)
    assert now == pytest.approx(100.2)
    assert run.lateness_s == pytest.approx(0.025)
    assert slept == pytest.approx([0.01] * 5 + [0.005] + [0.01] * 11)


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

    with Master(system) as master:
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
