"""A sweep from start to end: planned, flown on an engine, resumed where one was killed."""

import contextlib
import hashlib
import json
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from itertools import chain, groupby
from pathlib import Path
from typing import Any

import numpy as np

from cosim.lanes import LaneMaster
from cosim.limits import Limits
from cosim.recording import Recording, RunError
from cosim.worker import WorkerMaster
from fmus.lanes import LANES
from twin.errors import FmuError
from twin.vehicle import Vehicle

from ..jobs.engine import Engine, EngineName, Workers
from ..output import check_folder, results_folder, sha256, write_json
from ..simulation import Scenario, asked_scenario
from ..vehicles import load_vehicle
from .design import Design, Value, distribution_of, read_design
from .outcome import JOURNAL, Journal, Outcome, outcome_of
from .plan import Job, Plan, SharedSystem, plan_of, scenarios_of
from .result import SweepResult, table_of


@dataclass(frozen=True, slots=True)
class RunResult:
    """A run and what it left.

    Attributes:
        outcome: In figures.
        recording: Where recordings are stored.
    """

    outcome: Outcome
    recording: Recording | None = None


Block = tuple[Job, ...]
"""Runs of one system that a worker flies together."""
WORTH = 64
"""Runs of one system from which on it is compiled for lanes, which takes as long as some 100 runs.
"""


@dataclass(frozen=True, slots=True)
class SweepTask:
    """What is done with each block of runs, for `uavtwin.jobs`.

    Attributes:
        key: Hash of the sweep.
        stands: Systems.
        limits: Of the process that the FMUs run in, where it is not that of the sweep (lanes); the
            time as a whole is that of one run.
        keep: Whether recordings are wanted.
    """

    key: str
    stands: tuple[SharedSystem, ...]
    limits: Limits
    keep: bool = False

    def name(self, block: Block) -> str:
        """Number of the first run."""
        return str(block[0].run)

    def worker(self) -> "RunWorker":
        """One more that flies runs."""
        return RunWorker(self)

    def packed(self) -> "PackedSweep":
        """With the content of the FMUs, which lie elsewhere."""
        bare = tuple(replace(s, system=replace(s.system, folder=None)) for s in self.stands)
        fmus = tuple(
            {name: path.read_bytes() for name, path in s.system.fmus.items()} for s in self.stands
        )
        return PackedSweep(replace(self, stands=bare), fmus)

    def lost(self, block: Block, why: str) -> list[RunResult]:
        """Runs that nobody could fly."""
        return [RunResult(Outcome(job.run, "failed", why, 0.0, {})) for job in block]


@dataclass(frozen=True, slots=True)
class PackedSweep:
    """Systems with the content of their files.

    Attributes:
        flying: Whose FMUs lie elsewhere.
        fmus: Content of each, by stand and name.
    """

    flying: SweepTask
    fmus: tuple[dict[str, bytes], ...]

    @property
    def key(self) -> str:
        """Hash of the sweep."""
        return self.flying.key

    def unpacked(self, folder: Path) -> SweepTask:
        """The systems, their FMUs written into a folder."""
        stands = []
        for number, (stand, files) in enumerate(zip(self.flying.stands, self.fmus, strict=True)):
            paths = {name: folder / f"{number}_{name}.fmu" for name in files}
            for name, content in files.items():
                paths[name].write_bytes(content)
            stands.append(replace(stand, system=replace(stand.system, fmus=paths)))
        return replace(self.flying, stands=tuple(stands))


class RunWorker:
    """Flies blocks of runs; a crash of an FMU costs the run in which it happens."""

    def __init__(self, flying: SweepTask) -> None:
        """Start nothing yet."""
        self._flying = flying
        self._master: WorkerMaster | None = None
        self._stand: SharedSystem | None = None
        self._lanes: tuple[SharedSystem, LaneMaster | None] | None = None

    def do(self, block: Block) -> list[RunResult]:
        """Fly a block; whatever an FMU does, there are outcomes."""
        stand = self._flying.stands[block[0].stand]
        if len(block) > 1 and (lanes := self._in_lanes(stand)) is not None:
            times = stand.times
            with contextlib.suppress(FmuError):  # then each by itself, which says what it does
                recordings = lanes.run(
                    [job.starts for job in block],
                    *(times.begin_s, times.end_s, times.step_s, times.every),
                )
                return [
                    self._result(job, stand, recording)
                    for job, recording in zip(block, recordings, strict=True)
                ]
        return [self._alone(job, stand) for job in block]

    def _in_lanes(self, stand: SharedSystem) -> LaneMaster | None:
        """Of a stand; None: it cannot be flown in lanes here."""
        if self._lanes is None or self._lanes[0] is not stand:
            self._lanes = stand, None
            with contextlib.suppress(FmuError):
                self._lanes = stand, LaneMaster(stand.system, stand.record)
        return self._lanes[1]

    def _alone(self, job: Job, stand: SharedSystem) -> RunResult:
        """Fly one run by its FMUs."""
        times = stand.times
        try:
            master = self._ready(stand)
            master.initialize(times.begin_s, job.starts)
            recording = master.run(times.end_s, times.step_s, every=times.every)
            why = ""
        except RunError as error:
            recording, why = error.recording, str(error)
            self.close()
        except FmuError as error:
            recording, why = _nothing(), str(error)
            self.close()
        return self._result(job, stand, recording, why)

    def _result(
        self, job: Job, stand: SharedSystem, recording: Recording, why: str = ""
    ) -> RunResult:
        """What a run left."""
        outcome = outcome_of(job.run, recording, stand.arm_m, why)
        return RunResult(outcome, recording if self._flying.keep else None)

    def _ready(self, stand: SharedSystem) -> WorkerMaster:
        """A master with the system of a stand loaded."""
        if self._master is None or self._stand is not stand:
            self.close()
            self._master = WorkerMaster(stand.system, stand.record, self._flying.limits)
            self._stand = stand
        return self._master

    def close(self) -> None:
        """End the process."""
        master, self._master, self._stand = self._master, None, None
        if master is not None:
            with contextlib.suppress(FmuError):  # the outcome is known already
                master.close()


def _nothing() -> Recording:
    return Recording((), np.zeros(0), np.zeros((0, 0)))


Progress = Callable[[float], None]
RECORDINGS = "recordings"
"""Folder of the recordings of runs."""
SWITCH = ".enabled"
"""End of the name of a parameter that switches an effect."""
BUILDING = 0.05
"""Share of the work that building takes, about."""


@dataclass(frozen=True, slots=True)
class Work(Workers):
    """How runs are flown; the outcomes do not depend on it.

    Attributes:
        recordings: Whether every output of every run is stored.
        limits: Of the processes that FMUs run in, where these are not the sweep's (lanes); the time
            as a whole is that of one run.
    """

    recordings: bool = False
    limits: Limits = field(default_factory=Limits)


def sweep(
    scenario: str | Path,
    vehicle: Vehicle | str | None = None,
    *,
    out: str | Path,
    vary: Mapping[str, Any] | None = None,
    design: Design | str | Path | None = None,
    runs: int | None = None,
    method: str | None = None,
    seed: int | None = None,
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0),
    gusts: bool = False,
    controller: str = "lqr",
    effects: Iterable[str] | Mapping[str, Mapping[str, float]] = (),
    starts: Mapping[str, float] | None = None,
    duration: float | None = None,
    step: float | None = None,
    engine: EngineName = "local",
    workers: int | None = None,
    scheduler: str | None = None,
    recordings: bool = False,
    limits: Limits | None = None,
    force: bool = False,
    progress: Progress = lambda _: None,
) -> SweepResult:
    """Fly a scenario many times, each time with other numbers.

    A sweep that was interrupted or killed goes on where it was when the same call is made again.
    The results are the same to the last bit with any engine and any number of workers.

    Args:
        scenario: Name of a mission, or an `.ssp` file.
        vehicle: That flies, or its file or built-in name, which the page's commands then name;
            default: `copter_default`.
        out: Folder for `runs.parquet` and what else comes of it.
        vary: Factors: `{"airframe.mass": {"low": 1.2, "high": 1.6}, "controller": ["lqr", "px4"]}`;
            on top of those of the design.
        design: Or a file that describes one, see `uavtwin.sweeps.design`.
        runs: How many; default: as the design says, else 100.
        method: `latin_hypercube`, `sobol`, `random`, `grid` or `saltelli`.
        seed: Of the points; run k has noise of the seed after k more.
        wind: Of all runs, velocity of the air NED, m/s.
        gusts: Of all runs, whether there is Dryden turbulence.
        controller: Of all runs, `lqr` or `px4`.
        effects: Of all runs, as for `simulate`.
        starts: Of all runs, start values, "part.variable" -> value.
        duration: Of each run, s.
        step: Communication step, s.
        engine: `local`, or `dask` with a scheduler.
        workers: Processes of the local engine; default: one per core.
        scheduler: Address of a Dask scheduler.
        recordings: Whether every output of every run is stored.
        limits: Of the processes that FMUs run in, where these are not the sweep's (lanes).
        force: Whether files in the folder may be replaced.
        progress: Called with the share done, 0..1.

    Raises:
        TwinError: An unknown name, a value outside its range, or a folder that is not free.
    """
    named = vehicle if isinstance(vehicle, str) else ""
    if isinstance(vehicle, str):
        vehicle = load_vehicle(vehicle)
    base = asked_scenario("sweep", scenario, vehicle, wind, gusts, 0, controller, effects, starts)
    return run_sweep(
        base,
        chosen_design(design, vary, runs, method, seed),
        Path(out),
        Work(engine, workers, scheduler, recordings, limits or Limits()),
        duration,
        step,
        named,
        force,
        progress,
    )


def run_sweep(
    base: Scenario,
    design: Design,
    out: Path,
    work: Work,
    duration_s: float | None = None,
    step_s: float | None = None,
    vehicle: str = "",
    force: bool = False,
    progress: Progress = lambda _: None,
    found: Callable[[SweepResult], None] = lambda _: None,
    alongside: Callable[[SweepResult, Path], None] = lambda *_: None,
) -> SweepResult:
    """Plan a sweep, fly what is not done of it, and write what came of it.

    Args:
        base: What all runs share.
        design: What they differ in.
        out: Folder.
        work: How runs are flown.
        duration_s: Of each run.
        step_s: Communication step.
        vehicle: Name or file of what flies, for commands; "" for the usual one.
        force: Whether files in the folder may be replaced.
        progress: Called with the share done, 0..1.
        found: Takes the result before it is written: a full disk does not keep it from a reader.
        alongside: Writes what else belongs into the folder, which it is given.

    Raises:
        TwinError: As `sweep`.
    """
    check_folder(out, force, JOURNAL, [RECORDINGS])
    points = design.points()
    with tempfile.TemporaryDirectory(prefix="uavtwin-") as scratch:
        plan = plan_of(
            scenarios_of(base, points, design.seed),
            Path(scratch),
            duration_s,
            step_s,
            whole=work.recordings,
            progress=lambda done: progress(BUILDING * done),
        )
        key = sweep_key(plan, points, work.recordings)
        with closing(Journal(out / JOURNAL, key)) as journal:
            flying = SweepTask(key, plan.stands, work.limits, work.recordings)
            with work.opened() as engine:
                _fly(plan, flying, engine, journal, out, progress)
            table = table_of(points, journal.outcomes())
            periods = plan.periods(design.vary)
            given = design, plan.scenarios, vehicle, periods, plan.warnings
            result = SweepResult(base.name, table, *given)
            found(result)
            with results_folder(out, force, JOURNAL, [RECORDINGS]) as folder:
                result.save(folder / "runs.parquet")
                result.report(folder / "report.html")
                write_json(folder / "sweep.json", result.json())
                alongside(result, folder)
    return result


def chosen_design(
    design: Design | str | Path | None,
    vary: Mapping[str, Any] | None = None,
    runs: int | None = None,
    method: str | None = None,
    seed: int | None = None,
) -> Design:
    """A design, with what is given besides on top.

    Raises:
        TwinError: It is wrong.
    """
    if design is None:
        given = Design()
    else:
        given = design if isinstance(design, Design) else read_design(Path(design))
    more = {
        name: found if hasattr(found, "at") else distribution_of(name, found, "vary")
        for name, found in (vary or {}).items()
    }
    return Design(
        {**given.vary, **more},
        given.method if method is None else method,
        given.runs if runs is None else runs,
        given.seed if seed is None else seed,
    )


def sweep_key(plan: Plan, points: Sequence[Mapping[str, Value]], recordings: bool) -> str:
    """Hash of all that decides the outcomes."""
    import uavtwin

    stands = [
        {
            "fmus": {name: sha256(path) for name, path in s.system.fmus.items()},
            "connections": [[c.source, c.target] for c in s.system.connections],
            "starts": dict(s.system.starts),
            "periods": dict(s.system.periods),
            "times": asdict(s.times),
            "arm_m": s.arm_m,
        }
        for s in plan.stands
    ]
    jobs = [[j.run, j.stand, dict(j.starts)] for j in plan.jobs]
    content = [uavtwin.__version__, stands, jobs, [dict(p) for p in points], recordings]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _fly(
    plan: Plan,
    flying: SweepTask,
    engine: Engine,
    journal: Journal,
    folder: Path,
    progress: Progress,
) -> None:
    """Fly what is not done, those of one system after those of another."""
    left = [j for j in plan.jobs if j.run not in journal.done]
    done = len(plan.jobs) - len(left)
    for flown in chain.from_iterable(engine.run(flying, blocks(left))):
        _keep(flown, folder)
        journal.add(flown.outcome)
        done += 1
        progress(BUILDING + (1 - BUILDING) * done / len(plan.jobs))


def blocks(jobs: Iterable[Job]) -> Iterator[Block]:
    """What is flown together: of one system, with the same switches as far as may be, since lanes
    that are alike take the same shortcuts."""

    def alike(job: Job) -> tuple[int, list[str]]:
        """System and switches."""
        return job.stand, sorted(n for n, v in job.starts.items() if n.endswith(SWITCH) and v)

    for _, of_stand in groupby(sorted(jobs, key=alike), key=lambda job: job.stand):
        runs = tuple(of_stand)
        size = LANES if len(runs) >= WORTH else 1
        yield from (runs[i : i + size] for i in range(0, len(runs), size))


def recording_file(folder: Path, run: int) -> Path:
    """Of one run."""
    return folder / RECORDINGS / f"run_{run:06d}.parquet"


def _keep(flown: RunResult, folder: Path) -> None:
    """Write a recording, before its run counts as done."""
    if flown.recording is not None and len(flown.recording.time_s):
        path = recording_file(folder, flown.outcome.run)
        path.parent.mkdir(exist_ok=True)
        part = path.with_suffix(".part.parquet")
        flown.recording.write(part)
        os.replace(part, path)
