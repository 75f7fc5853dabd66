"""Systems in a process of their own: FMUs that misbehave in many ways, and the same bits else."""

import contextlib
import os
import re
import resource
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from alter import NO_DERIVATIVES, altered
from bad_fmu import bad_fmu

from cosim.calls import TraceEntry, read_table, read_trace, shared_file, table_bytes
from cosim.limits import Limits
from cosim.master import Algorithm, Interrupted, Master, Recording, RunError
from cosim.system import Connection, System
from cosim.worker import WorkerMaster
from fmus import build, component_model
from twin.component import ComponentBuilder
from twin.errors import FmuError

SHORT = Limits(call_s=2.0, whole_s=60.0, memory_gib=1.0)
DURING = r"\(bad\.fmu\): fmi2DoStep at 0\.4 s: "
LATE = "did not return within 2 s"
PATIENT = Limits(call_s=20.0, whole_s=60.0, memory_gib=1.0)
"""Where nothing hangs: a process of a busy machine takes its time to end, too."""

STOPPED = {
    "exit0": DURING + "its process ended with exit code 0",
    "underscore_exit": DURING + "its process ended with exit code 0",
    "abort": DURING + "its process ended with signal SIGABRT",
    "segv": DURING + "its process ended with signal SIGSEGV",
    "stack_overflow": DURING + "its process ended with signal SIGSEGV",
    "interrupts": DURING + "its process ended with signal SIGINT",
    "loop_in_step": DURING + LATE,
    "stops_itself": DURING + LATE,
    "signals": DURING + LATE,
    "exit_in_get": r"\(bad\.fmu\): fmi2GetReal at 0\.4 s: its process ended with exit code 0",
    "nan": r"\(bad\.fmu\): y = nan at 0\.5 s",
    "inf": r"\(bad\.fmu\): y = inf at 0\.5 s",
    "error": r"\(bad\.fmu\): step at 0\.4 s: this went wrong$",
    "discard": r"\(bad\.fmu\): step at 0\.4 s: the FMU gave up at 0\.4 s instead of 0\.5 s",
    "negative_time": r"\(bad\.fmu\): step at 0\.4 s: the FMU gave up at -7 s",
    "fatal": r"\(bad\.fmu\): step at 0\.4 s: the FMU gave no reason",
    "says_escapes": r"\(bad\.fmu\): step at 0\.4 s: \[2J \[31mall is well$",
    "rounding": DURING + "changed how the processor rounds",
    "flush_to_zero": DURING + "changed how the processor rounds or treats small numbers",
}
"""Kinds whose fifth step, from 0.4 s on, is not recorded."""

NEVER_RAN = {
    "wrong_guid": r"bad\.fmu: cannot be loaded: the GUID is another",
    "loop_in_instantiate": r"\(bad\.fmu\): instantiate at 0 s: did not return within 2 s",
    "exit_in_instantiate": r"\(bad\.fmu\): instantiate at 0 s: .* exit code 0",
    "segv_in_initialization": r"\(bad\.fmu\): enterInitializationMode at 0 s: .* SIGSEGV",
    "nan_at_start": r"\(bad\.fmu\): y = nan at 0 s",
}

ALL_RECORDED = {
    "loop_in_terminate": r"\(bad\.fmu\): terminate at 0\.9 s: did not return",
    "exit_in_terminate": r"\(bad\.fmu\): terminate at 0\.9 s: .* exit code 0",
    "segv_in_free": r"\(bad\.fmu\): freeInstance at 0\.9 s: .* SIGSEGV",
    "closes_all": r"\(bad\.fmu\): after fmi2GetReal at 0\.9 s: its process ended with exit code 1",
}

HARMLESS = (
    *("fine", "prints_a_lot", "closes_stdout", "chdir", "locale"),
    *("fork_stays", "fork_returns", "leaves_files"),
    *("truncates_all", "extends_all"),  # sizes are sealed
)
SPOILT = (
    *("answers_done", "answers_progress", "answers_nan", "answers_deep", "punches_all"),
    "writes_all",
)
"""Kinds that answer for the worker, or write over the recording."""


@pytest.fixture(scope="module")
def bad(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bad_fmu(tmp_path_factory.mktemp("bad"))


@pytest.fixture(autouse=True)
def nothing_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """No file and no process of any worker outlives its test."""
    folder = tmp_path / "temp"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    yield
    assert list(folder.iterdir()) == []
    deadline = time.monotonic() + 60.0  # what was killed takes a moment to be gone
    while processes_with(folder) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert processes_with(folder) == []


def processes_with(folder: Path) -> list[str]:
    """Processes whose temporary folder is in a folder."""
    found = []
    for path in Path("/proc").glob("[0-9]*/environ"):
        with contextlib.suppress(OSError):  # it is no more, or another user's
            if f"TMPDIR={folder}".encode() in path.read_bytes():
                found.append(path.parent.name)
    return found


def limits_for(text: str) -> Limits:
    """Short ones where an error tells of them."""
    return SHORT if "did not return" in text else PATIENT


def run_bad(kind: str, fmu: Path, limits: Limits = SHORT) -> Recording:
    """Ten steps, which are counted."""
    with WorkerMaster(System({kind: fmu}), limits=limits) as master:
        master.initialize()
        return master.run(1.0, 0.1)


@contextlib.contextmanager
def passing(
    monkeypatch: pytest.MonkeyPatch, seconds: float, where: Callable[[TraceEntry], bool]
) -> Iterator[list[TraceEntry]]:
    """So much time passes for who waits for the worker at each look at a call like that; yields
    these looks."""
    looks: list[TraceEntry] = []
    now = time.monotonic

    def look(file: int) -> TraceEntry:
        entry = read_trace(file)
        if where(entry):
            looks.append(entry)
        return entry

    with monkeypatch.context() as patched:
        patched.setattr("cosim.worker.read_trace", look)
        patched.setattr(time, "monotonic", lambda: now() + seconds * len(looks))
        yield looks


# -- FMUs that misbehave --------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("kind", STOPPED)
def test_stopped_at_the_last_good_row(bad: Path, kind: str) -> None:
    with pytest.raises(RunError, match=f"^{kind} {STOPPED[kind]}") as caught:
        run_bad(kind, bad, limits_for(STOPPED[kind]))
    recording = caught.value.recording
    assert recording.values.ravel().tolist() == [0, 1, 2, 3, 4]
    assert recording.time_s.tolist() == [0.1 * k for k in range(5)]
    assert recording.steps == 4
    assert recording.incomplete == str(caught.value)
    assert str(caught.value).isprintable()


@pytest.mark.slow
@pytest.mark.parametrize("kind", NEVER_RAN)
def test_what_never_ran(bad: Path, kind: str) -> None:
    with pytest.raises(FmuError, match=NEVER_RAN[kind]):
        run_bad(kind, bad, limits_for(NEVER_RAN[kind]))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ALL_RECORDED)
def test_failed_after_the_last_row(bad: Path, kind: str) -> None:
    with pytest.raises(RunError, match=f"^{kind} {ALL_RECORDED[kind]}") as caught:
        run_bad(kind, bad, limits_for(ALL_RECORDED[kind]))
    assert caught.value.recording.values.ravel().tolist() == list(range(11))
    assert caught.value.recording.incomplete == str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize("kind", HARMLESS)
def test_what_does_no_harm(
    bad: Path, kind: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """It prints, closes, moves, forks or leaves files: not here."""
    here, mask = Path.cwd(), os.umask(0)
    os.umask(mask)
    before = set(here.iterdir())
    recording = run_bad(kind, bad, PATIENT)
    assert recording.values.ravel().tolist() == list(range(11))
    assert recording.incomplete == ""
    assert (Path.cwd(), os.umask(mask)) == (here, mask)
    assert set(here.iterdir()) == before
    assert capfd.readouterr() == ("", "")
    if kind == "prints_a_lot":
        assert recording.printed.endswith("a line that nobody wants to read\n")
        assert len(recording.printed) == 2**16


@pytest.mark.slow
def test_a_thread_that_crashes_later(bad: Path) -> None:
    """In which step is chance; what was recorded before counts on without a gap."""
    with pytest.raises(RunError, match=r"thread \(bad\.fmu\): .* SIGABRT") as caught:
        run_bad("thread", bad)
    rows = caught.value.recording.values.ravel().tolist()
    assert 5 <= len(rows) < 11
    assert rows == list(range(len(rows)))


@pytest.mark.slow
@pytest.mark.parametrize("kind", SPOILT)
def test_an_fmu_that_writes_into_what_is_not_its_own(bad: Path, kind: str) -> None:
    """How far it gets before that is seen is chance. What it has spoilt ends the recording."""
    with pytest.raises(RunError, match=r": its process wrote into what belongs to") as caught:
        run_bad(kind, bad, PATIENT)
    rows = caught.value.recording.values.ravel().tolist()
    assert rows == list(range(len(rows)))
    if kind != "punches_all":  # it takes its own name off the board
        assert str(caught.value).startswith(f"{kind} (bad.fmu): ")
        assert len(rows) >= 5
    assert caught.value.recording.incomplete == str(caught.value)


@pytest.mark.skipif(not hasattr(os, "memfd_create"), reason="no files in memory")
def test_no_more_is_read_than_was_asked_for(tmp_path: Path) -> None:
    """Whatever size the file has; one from the board is sealed."""
    times_s = np.array([0, 0.1, 0.2])
    file = shared_file(table_bytes(6))
    for size in (0, 24, 2**40):
        with pytest.raises(PermissionError):
            os.ftruncate(file, size)
    os.pwrite(file, struct.pack("6d", 0, 0.1, np.nan, 1, 2, 3), table_bytes(0))
    assert [a.tolist() for a in read_table(file, times_s, 1)] == [[0, 0.1], [[1], [2]]]
    assert [a.tolist() for a in read_table(file, times_s[:0], 1)] == [[], []]
    os.pwrite(file, struct.pack("2d", 0, 0.3), table_bytes(0))
    assert [a.tolist() for a in read_table(file, times_s, 1)] == [[0], [[1]]]
    os.close(file)
    with (tmp_path / "table").open("w+b") as table:
        for size in (0, 8, table_bytes(1), 2**40):
            table.truncate(size)
            time_s, _ = read_table(table.fileno(), times_s, 1)
            assert len(time_s) == (size > table_bytes(0))
        assert read_trace(table.fileno()).who == ""
        table.truncate(table_bytes(0) + 4)
        assert read_trace(table.fileno()).who == ""


@pytest.mark.slow
def test_memory_is_limited_and_the_error_says_so(bad: Path) -> None:
    limits = Limits(call_s=30.0, memory_gib=0.6)
    with pytest.raises(RunError, match=r"SIGABRT") as caught:
        run_bad("memory", bad, limits)
    text, own_gib = str(caught.value), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    if own_gib < 0.4 or "GiB" in text:  # the peak of a larger parent hides that of the worker
        assert re.search(r"SIGABRT after 0\.. of the 0\.6 GiB", text), text
    assert len(caught.value.recording.time_s) == 5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flags", "cut", "message"),
    [
        (("-DMISSING",), 0, r"missing\.fmu: cannot be loaded: .*fmi2ExitInitializationMode"),
        ((), 9000, r"missing\.fmu.*(cannot be loaded|loading its library)"),
        ((), 100, r"missing\.fmu.*(cannot be loaded|loading its library)"),
    ],
)
def test_libraries_that_do_not_load(
    tmp_path: Path, flags: tuple[str, ...], cut: int, message: str
) -> None:
    with pytest.raises(FmuError, match=message):
        run_bad("a", bad_fmu(tmp_path, "missing", flags, cut))


@pytest.mark.slow
def test_all_calls_together_are_limited(bad: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A call that is within its own limit uses them up; a day passes while it is under way."""
    with WorkerMaster(System({"sleep_in_step": bad}), limits=Limits(1e6, 3600.0)) as master:
        master.initialize()
        with (
            passing(monkeypatch, 86_400.0, lambda e: e.busy and e.clock_s > 0.3),
            pytest.raises(RunError, match=r"the 3600 s for the whole run are used up") as caught,
        ):
            master.run(1.0, 0.1)
    assert len(caught.value.recording.time_s) == 5


@pytest.mark.slow
def test_a_worker_ends_with_who_asked_for_it(bad: Path, tmp_path: Path) -> None:
    """Even if that is killed while an FMU does not return."""
    script = (
        "import sys, tempfile; from pathlib import Path; from cosim.worker import *; "
        "from cosim.system import System; tempfile.tempdir = sys.argv[2]; "
        "m = WorkerMaster(System({'loop_in_step': Path(sys.argv[1])})); m.initialize(); "
        "print('runs', flush=True); m.run(1.0, 0.1)"
    )
    folder = tmp_path / "killed"
    folder.mkdir()
    command = [sys.executable, "-c", script, str(bad), str(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as asking:
        assert asking.stdout is not None
        assert asking.stdout.readline() == b"runs\n"
        time.sleep(0.3)
        assert len(processes_with(folder)) == 1
        asking.kill()
    deadline = time.monotonic() + 60
    while processes_with(folder) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert processes_with(folder) == []


@pytest.mark.slow
def test_interruption_keeps_what_was_recorded(bad: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C while an FMU does not return."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a job of a shell has none
    with WorkerMaster(System({"sleep_in_step": bad})) as master:
        master.initialize()

        def look(file: int) -> TraceEntry:
            entry = read_trace(file)
            if entry.busy and entry.clock_s > 0.3 and not pressed:
                pressed.append(entry)
                os.kill(os.getpid(), signal.SIGINT)
            return entry

        monkeypatch.setattr("cosim.worker.read_trace", look)
        pressed: list[TraceEntry] = []
        try:
            with pytest.raises(Interrupted, match=r"interrupted at 0\.4 s") as caught:
                master.run(1.0, 0.1)
        finally:
            signal.signal(signal.SIGINT, before)
        assert caught.value.recording.values.ravel().tolist() == [0, 1, 2, 3, 4]
        with pytest.raises(FmuError, match="had been ended before"):
            master.initialize()


CALCULATES_OTHERWISE = {
    "Instantiate": "instantiate",
    "SetReal": "start values",
    "EnterInitializationMode": "enterInitializationMode",
    "GetReal": "fmi2GetReal",
    "FreeInstance": "freeInstance",
}
"""Function that changes the rounding -> how errors name the call."""


@pytest.mark.slow
@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("function", CALCULATES_OTHERWISE)
def test_who_changed_the_rounding_is_named(bad: Path, function: str, first: bool) -> None:
    """In any call, and wherever in the system it stands: no other FMU is blamed for it."""
    who = f"rounds_in_{function}"
    names = [who, "fine"] if first else ["fine", who]
    system = System({name: bad for name in names}, starts={f"{who}.bad": 0.0})
    call = CALCULATES_OTHERWISE[function]
    expected = rf"^{who} \(bad\.fmu\): {call} at .* changed how the processor rounds"
    with pytest.raises(FmuError, match=expected), WorkerMaster(system, limits=PATIENT) as master:
        master.initialize()
        master.run(1.0, 0.1)


# -- beginning again ------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["fine", "reset_later", "reset_later_or_segv", "reset_never"])
def test_only_what_has_run_is_reset(bad: Path, kind: str) -> None:
    """An FMU that fails or crashes in a reset before its first use runs, as often as wanted; one
    that can never be reset is instantiated anew."""
    for make in (Master, WorkerMaster):
        with make(System({kind: bad}, starts={f"{kind}.bad": 0.0})) as master:
            for _ in range(3):
                master.initialize()
                assert master.run(1.0, 0.1).values.ravel().tolist() == list(range(11))


@pytest.mark.slow
def test_a_reset_that_ends_its_process(bad: Path) -> None:
    """A new process takes its place."""
    with WorkerMaster(System({"reset_segv": bad}, starts={"reset_segv.bad": 0.0})) as master:
        for _ in range(2):
            master.initialize()
            assert master.run(1.0, 0.1).values.ravel().tolist() == list(range(11))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["error", "fatal", "fatal_reset_never"])
def test_beginning_again_after_a_failure(bad: Path, kind: str) -> None:
    """After an error the instance may be reset, after a fatal one it may not be called."""
    with Master(System({kind: bad})) as master:
        master.initialize()
        with pytest.raises(RunError, match=r"step at 0\.4 s"):
            master.run(1.0, 0.1)
        master.initialize(starts={f"{kind}.bad": 0.0})
        assert master.run(1.0, 0.1).values.ravel().tolist() == list(range(11))


# -- FMUs that behave -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def ring(tmp_path_factory: pytest.TempPathFactory) -> Callable[[bool], System]:
    """A lag whose input is a function of its output and of a loop without delay; saves states."""
    folder = tmp_path_factory.mktemp("ring")
    m = ComponentBuilder("lag", "A lag")
    u = m.input("u", "1", "Input")
    x = m.state("x", "1", "State", 0.3)
    m.derivative("x", 3.0 * (u - x))
    m.output("y", "1", "Output", x)
    lag = build(component_model(m.build()), folder / "lag.fmu", 3)
    m = ComponentBuilder("curve", "A curve")
    a, b = (m.input(n, "1", "Input") for n in "ab")
    m.output("y", "1", "Output", 1.0 + 0.3 * a * a - 0.7 * b)
    curve = build(component_model(m.build()), folder / "curve.fmu")
    other = altered(curve, "other.fmu", NO_DERIVATIVES)

    def system(derivatives: bool) -> System:
        return System(
            {"lag": lag, "f": curve, "g": curve if derivatives else other},
            (
                Connection("lag.y", "f.b"),
                Connection("lag.y", "g.b"),
                Connection("f.y", "g.a"),
                Connection("g.y", "f.a"),
                Connection("g.y", "lag.u"),
            ),
        )

    return system


def rows(master: Master | WorkerMaster, algorithm: Algorithm) -> list[tuple[object, ...]]:
    """What two runs in sequence and a controlled one record."""
    master.initialize(2.0)
    runs = [master.run(2.5, 0.01, algorithm, 5), master.run(3.0, 0.01, algorithm)]
    if algorithm != "jacobi":  # where a sensor is late, no step is short enough
        master.initialize(2.0)
        runs.append(master.run_adaptive(3.0, 0.1, 1e-4, algorithm))
    return [(r.names, r.time_s.tobytes(), r.values.tobytes(), r.steps, r.rejected) for r in runs]


@pytest.mark.slow
@pytest.mark.parametrize("derivatives", [True, False])
@pytest.mark.parametrize("algorithm", ["jacobi", "settled", "gauss_seidel"])
def test_the_same_bits_as_in_this_process(
    ring: Callable[[bool], System], algorithm: Algorithm, derivatives: bool
) -> None:
    """Loops, rollback, step-size control, runs that go on."""
    system = ring(derivatives)
    with Master(system) as here, WorkerMaster(system) as there:
        found = rows(there, algorithm)
        assert found == rows(here, algorithm)
    assert len({values for _, _, values, _, _ in found}) == len(found)


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["settled", "gauss_seidel"])
def test_instances_made_anew_are_those_that_run(
    ring: Callable[[bool], System], algorithm: Algorithm
) -> None:
    """Loops, directional derivatives and saved states of a run are those of its instances."""
    system = ring(True)
    stubborn = altered(
        system.fmus["f"],
        f"stubborn_{algorithm}.fmu",
        source={"core_reset(c);": "return fmi2Error;"},
    )
    again = replace(system, fmus={**system.fmus, "f": stubborn})
    with Master(system) as plain, Master(again) as renewed:
        assert rows(renewed, algorithm) == rows(plain, algorithm)


@pytest.mark.slow
def test_periods_columns_progress_and_the_clock(ring: Callable[[bool], System]) -> None:
    system = replace(ring(True), periods={"lag": 4}, starts={"f.b": 1.0})
    reports: list[float] = []
    with Master(system, ["g.y"]) as here, WorkerMaster(system, ["g.y"]) as there:
        here.initialize()
        there.initialize()
        a = here.run(2.0, 1e-3, every=7)
        b = there.run(2.0, 1e-3, every=7, progress=reports.append)
        assert (a.names, a.time_s.tobytes(), a.values.tobytes()) == (
            (b.names, b.time_s.tobytes(), b.values.tobytes())
        )
        assert reports == pytest.approx([1.0, 2.0])
        begin = time.monotonic()
        paced = there.run(2.5, 0.1, realtime=1.0)
        took_s = time.monotonic() - begin
        assert took_s >= 0.5
        assert 0 <= paced.lateness_s < took_s


@pytest.mark.slow
def test_the_clock_does_not_count_as_a_call(
    ring: Callable[[bool], System], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A day passes between two calls, though a call may take a minute."""
    with WorkerMaster(ring(True), limits=Limits(60.0, 1e9)) as master:
        master.initialize()
        with passing(monkeypatch, 86_400.0, lambda e: not e.busy) as looks:
            assert master.run(2.0, 2.0, realtime=1.0).steps == 1
        assert len(looks) > 1


@pytest.mark.slow
def test_refusals_are_those_of_the_master(ring: Callable[[bool], System]) -> None:
    """And the worker goes on."""
    system = ring(True)
    with pytest.raises(FmuError, match=r"no variable 'z'"):
        WorkerMaster(system, ["lag.z"])
    with WorkerMaster(system) as master:
        with pytest.raises(FmuError, match=r"call initialize\(\) before run"):
            master.run(1.0, 0.1)
        with pytest.raises(FmuError, match=r"there is no variable 'w'"):
            master.initialize(starts={"lag.w": 1.0})
        master.initialize()
        with pytest.raises(FmuError, match=r"is not a whole number of steps"):
            master.run(1.0, 0.3)
        assert master.run(1.0, 0.5).steps == 2


@pytest.mark.parametrize("limits", [(0.0, 1.0, 1.0), (1.0, float("nan"), 1.0), (1.0, 1.0, -2.0)])
def test_wrong_limits(limits: tuple[float, float, float]) -> None:
    with pytest.raises(FmuError, match=r"limit .*: needs a positive number"):
        Limits(*limits)


# -- in this process ------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["nan", "inf", "error", "discard", "says_escapes"])
def test_what_was_recorded_in_this_process(bad: Path, kind: str, tmp_path: Path) -> None:
    """The error of a worker and that of the plain master are the same."""
    with Master(System({kind: bad})) as master:
        master.initialize()
        with pytest.raises(RunError, match=f"^{kind} {STOPPED[kind]}") as caught:
            master.run(1.0, 0.1)
    recording = caught.value.recording
    assert recording.values.ravel().tolist() == [0, 1, 2, 3, 4]
    recording.write(tmp_path / "r.parquet")
    assert pd.read_parquet(tmp_path / "r.parquet").attrs == {"incomplete": str(caught.value)}


@pytest.mark.slow
def test_not_a_number_ends_step_size_control(ring: Callable[[bool], System]) -> None:
    """A curve that grows beyond all numbers: no step is short enough."""
    system = ring(True)
    wires = (Connection("f.y", "lag.u"), Connection("lag.y", "f.a"))
    system = System({"lag": system.fmus["lag"], "f": system.fmus["f"]}, wires, {"f.b": -1e3})
    with Master(system) as master:
        master.initialize()
        with pytest.raises(RunError) as caught:
            master.run_adaptive(10.0, 0.1, 1e-3)
    assert np.isfinite(caught.value.recording.values).all()
    assert caught.value.recording.incomplete
