"""A sweep from start to end: planned, flown on an engine, resumed after an interruption."""

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
    """Result of one run.

    Attributes:
        outcome: Outcome with its figures.
        recording: Recording of the run; None where recordings are not stored.
    """

    outcome: Outcome
    recording: Recording | None = None


Block = tuple[Job, ...]
"""Runs of one system that a worker flies together."""
WORTH = 64
"""Number of runs of one system from which on it is compiled for lanes; compiling takes as long as
some 100 runs.
"""


@dataclass(frozen=True, slots=True)
class SweepTask:
    """Task of flying one block of runs, for `uavtwin.jobs`.

    Attributes:
        key: Hash of the sweep.
        stands: Systems that the runs share.
        limits: Limits of the process in which FMUs run, where that is not the process of the sweep
            (lanes); the limit on total time applies to one run.
        keep: Whether recordings are returned.
    """

    key: str
    stands: tuple[SharedSystem, ...]
    limits: Limits
    keep: bool = False

    def name(self, block: Block) -> str:
        """Name of a block: number of its first run."""
        return str(block[0].run)

    def worker(self) -> "RunWorker":
        """A new worker that flies runs."""
        return RunWorker(self)

    def packed(self) -> "PackedSweep":
        """The task with the content of its FMUs, for a worker that cannot read their files."""
        bare = tuple(replace(s, system=replace(s.system, folder=None)) for s in self.stands)
        fmus = tuple(
            {name: path.read_bytes() for name, path in s.system.fmus.items()} for s in self.stands
        )
        return PackedSweep(replace(self, stands=bare), fmus)

    def lost(self, block: Block, why: str) -> list[RunResult]:
        """Failed outcomes for runs that no worker could fly."""
        return [RunResult(Outcome(job.run, "failed", why, 0.0, {})) for job in block]


@dataclass(frozen=True, slots=True)
class PackedSweep:
    """A sweep task with the content of its files.

    Attributes:
        flying: Task; the paths of its FMUs are not valid on the worker.
        fmus: Content of each FMU, by system and name.
    """

    flying: SweepTask
    fmus: tuple[dict[str, bytes], ...]

    @property
    def key(self) -> str:
        """Hash of the sweep."""
        return self.flying.key

    def unpacked(self, folder: Path) -> SweepTask:
        """The task with its FMUs written into a folder."""
        stands = []
        for number, (stand, files) in enumerate(zip(self.flying.stands, self.fmus, strict=True)):
            paths = {name: folder / f"{number}_{name}.fmu" for name in files}
            for name, content in files.items():
                paths[name].write_bytes(content)
            stands.append(replace(stand, system=replace(stand.system, fmus=paths)))
        return replace(self.flying, stands=tuple(stands))


class RunWorker:
    """Worker that flies blocks of runs; a crash of an FMU fails only the run in which it
    happens."""

    def __init__(self, flying: SweepTask) -> None:
        """Set the task; no process is started yet."""
        self._flying = flying
        self._master: WorkerMaster | None = None
        self._stand: SharedSystem | None = None
        self._lanes: tuple[SharedSystem, LaneMaster | None] | None = None

    def do(self, block: Block) -> list[RunResult]:
        """Fly a block; returns an outcome of each run, whatever an FMU does."""
        stand = self._flying.stands[block[0].stand]
        if len(block) > 1 and (lanes := self._in_lanes(stand)) is not None:
            times = stand.times
            with contextlib.suppress(FmuError):  # else one run at a time, with its error
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
        """Lanes of a system; None: it cannot be flown in lanes on this machine."""
        if self._lanes is None or self._lanes[0] is not stand:
            self._lanes = stand, None
            with contextlib.suppress(FmuError):
                self._lanes = stand, LaneMaster(stand.system, stand.record)
        return self._lanes[1]

    def _alone(self, job: Job, stand: SharedSystem) -> RunResult:
        """Fly one run by its FMUs in the co-simulation master."""
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
        """Result of a run from its recording."""
        outcome = outcome_of(job.run, recording, stand.arm_m, why)
        return RunResult(outcome, recording if self._flying.keep else None)

    def _ready(self, stand: SharedSystem) -> WorkerMaster:
        """A master with the system of a run loaded."""
        if self._master is None or self._stand is not stand:
            self.close()
            self._master = WorkerMaster(stand.system, stand.record, self._flying.limits)
            self._stand = stand
        return self._master

    def close(self) -> None:
        """End the FMU process."""
        master, self._master, self._stand = self._master, None, None
        if master is not None:
            with contextlib.suppress(FmuError):  # the outcome is known already
                master.close()


def _nothing() -> Recording:
    return Recording((), np.zeros(0), np.zeros((0, 0)))


Progress = Callable[[float], None]
RECORDINGS = "recordings"
"""Folder of the recordings."""
SWITCH = ".enabled"
"""Suffix of a parameter that switches an effect on."""
BUILDING = 0.05
"""Approximate share of the whole work that building takes."""


@dataclass(frozen=True, slots=True)
class Work(Workers):
    """Options of how runs are flown; outcomes do not depend on them, except for failures by limits.

    Attributes:
        recordings: Whether every output of every run is stored.
        limits: Limits of the processes in which FMUs run, where these are not those of the sweep
            (lanes); the limit on total time applies to one run.
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
    """Fly a scenario many times, each time with other values of the factors.

    An interrupted sweep continues when the same call is made again. The results are equal to the
    last bit with any engine and any number of workers.

    Args:
        scenario: Name of a mission, or an `.ssp` file.
        vehicle: Vehicle that flies, or its file or built-in name, which the commands on the page
            then use; default: `copter_default`.
        out: Folder for `runs.parquet` and the other results.
        vary: Varied factors: `{"airframe.mass": {"low": 1.2, "high": 1.6}, "controller": ["lqr",
            "px4"]}`; added to those of the design.
        design: Design or a file that describes one, see `uavtwin.sweeps.design`.
        runs: Number of runs; default: that of the design, else 100.
        method: Sampling method: `latin_hypercube`, `sobol`, `random`, `grid` or `saltelli`.
        seed: Random seed of the points; the noise of run k has seed + k.
        wind: Velocity of the air in all runs, NED, m/s.
        gusts: Whether there is Dryden turbulence in all runs.
        controller: Controller in all runs, `lqr` or `px4`.
        effects: Effects in all runs, as for `simulate`.
        starts: Start values in all runs, "part.variable" -> value.
        duration: Simulated time of each run, s.
        step: Communication step, s.
        engine: Engine: `local`, or `dask` with a scheduler.
        workers: Number of processes of the local engine; default: one per core.
        scheduler: Address of a Dask scheduler.
        recordings: Whether every output of every run is stored.
        limits: Limits of the processes in which FMUs run, where these are not those of the sweep
            (lanes).
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
    """Plan a sweep, fly the runs that are not done yet, and write the results.

    Args:
        base: Scenario that all runs share.
        design: Design: the factors in which runs differ.
        out: Folder of the results.
        work: Options of how runs are flown.
        duration_s: Simulated time of each run, s; None: that of the mission or system.
        step_s: Communication step, s; None: the default.
        vehicle: Name or file of the vehicle, for commands; "" for the default one.
        force: Whether files in the folder may be replaced.
        progress: Called with the share done, 0..1.
        found: Called with the result before it is written, so that a full disk does not hide it.
        alongside: Called with the result and the folder, to write further files into it.

    Raises:
        TwinError: As for `sweep`.
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
    """A design, with the other arguments replacing or adding to its entries.

    Raises:
        TwinError: The design is invalid.
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
    """Hash of all inputs that determine the outcomes."""
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
    """Fly the runs that are not done yet, one system after the other."""
    left = [j for j in plan.jobs if j.run not in journal.done]
    done = len(plan.jobs) - len(left)
    for flown in chain.from_iterable(engine.run(flying, blocks(left))):
        _keep(flown, folder)
        journal.add(flown.outcome)
        done += 1
        progress(BUILDING + (1 - BUILDING) * done / len(plan.jobs))


def blocks(jobs: Iterable[Job]) -> Iterator[Block]:
    """Blocks of runs that are flown together: of one system and, as far as possible, with the same
    switches, since equal lanes take the same branches."""

    def alike(job: Job) -> tuple[int, list[str]]:
        """Sort key of a run: its system and switches."""
        return job.stand, sorted(n for n, v in job.starts.items() if n.endswith(SWITCH) and v)

    for _, of_stand in groupby(sorted(jobs, key=alike), key=lambda job: job.stand):
        runs = tuple(of_stand)
        size = LANES if len(runs) >= WORTH else 1
        yield from (runs[i : i + size] for i in range(0, len(runs), size))


def recording_file(folder: Path, run: int) -> Path:
    """Path of the recording of a run."""
    return folder / RECORDINGS / f"run_{run:06d}.parquet"


def _keep(flown: RunResult, folder: Path) -> None:
    """Write the recording before the run counts as done."""
    if flown.recording is not None and len(flown.recording.time_s):
        path = recording_file(folder, flown.outcome.run)
        path.parent.mkdir(exist_ok=True)
        part = path.with_suffix(".part.parquet")
        flown.recording.write(part)
        os.replace(part, path)
