"""Analysis of a fleet from start to end: logs found, analysed by an engine, resumed after
interruption."""

import glob
import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np

from twin.component import unknown_name
from twin.draft.rotors import Estimate
from twin.errors import LogError, TwinError
from twin.explain.model.numbers import with_effects
from twin.formatting import counted
from twin.logs.formats import FORMATS
from twin.vehicle import Deviation

from ..flights import counted_key, what_is_there
from ..jobs.engine import Engine, EngineName, Workers
from ..jobs.process import JobLimits
from ..output import check_folder, results_folder, write_json
from ..vehicles import Vehicle, load_vehicle
from .dataset import JOURNAL, TABLES, JobRows, Journal, write_dataset
from .fleet_statistics import Spread
from .log_analysis import OF_VEHICLE, VERBS, LogAnalysis, LogJob, Verb, file_stem
from .result import FleetResult, result_of

MOST_LOGS = 10_000_000
"""Largest number of logs of a fleet. Made up."""


@dataclass(frozen=True, slots=True)
class Log:
    """One log file.

    Attributes:
        path: Absolute path.
        name: Path relative to the common folder.
        bytes: Size of the file.
        changed_ns: Time of the last change.
    """

    path: str
    name: str
    bytes: int
    changed_ns: int

    @property
    def job(self) -> int:
        """Identifying number, 63 bits: different for other content."""
        text = f"{self.path}\0{self.bytes}\0{self.changed_ns}"
        return job_number(text)


def job_number(text: str) -> int:
    """Number from 63 bits of a hash."""
    return int.from_bytes(hashlib.sha256(text.encode("utf-8", "surrogateescape")).digest()[:8]) >> 1


def found_logs(given: Sequence[str | Path]) -> list[Log]:
    """All logs of files, patterns and folders, by name, without duplicates.

    Args:
        given: Files, patterns and folders; of a folder all files at any depth with an extension of
            logs.

    Raises:
        LogError: A path or pattern has no logs.
    """
    paths = sorted({p for one in given for p in _of(str(one))}, key=counted_key)
    if not paths:
        raise LogError("fleet: no log is given.")
    if len(paths) > MOST_LOGS:
        raise LogError(f"fleet: {len(paths)} logs, at most {MOST_LOGS} are taken at once.")
    above = os.path.commonpath([os.path.dirname(p) for p in paths])
    found = []
    for path in paths:
        stat = os.stat(path)
        name = Path(os.path.relpath(path, above)).as_posix()
        found.append(Log(path, name, stat.st_size, stat.st_mtime_ns))
    return found


def _of(text: str) -> Iterator[str]:
    """Absolute paths of a file, pattern or folder."""
    if os.path.isdir(text):
        suffixes = {s for f in FORMATS for s in f.suffixes}
        inside = [
            os.path.join(folder, name)
            for folder, _, names in os.walk(text)
            for name in names
            if os.path.splitext(name)[1].lower() in suffixes and not name.startswith(".")
        ]
        if not inside:
            raise LogError(
                f"{text}: the folder holds no logs. Files that end in "
                f"{', '.join(sorted(suffixes))} are looked for."
            )
    elif os.path.isfile(text) or not glob.has_magic(text):
        if not os.path.exists(text):
            raise LogError(f"{text}: there is no such file. {what_is_there(Path(text))}")
        inside = [text]
    else:
        inside = [p for p in glob.glob(text, recursive=True) if os.path.isfile(p)]
        if not inside:
            raise LogError(f"{text}: no log matches this pattern. {what_is_there(Path(text))}")
    yield from (os.path.abspath(p) for p in inside)


Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True)
class Work(Workers):
    """Settings of the computation; results do not depend on it, except for logs that exceed the
    limits.

    Workers of a Dask cluster need the logs at the same paths.

    Attributes:
        allowed: Limits for one log, or one aircraft.
    """

    allowed: JobLimits = field(default_factory=JobLimits)


@dataclass(frozen=True, slots=True)
class FleetRequest:
    """Settings of the analysis.

    Attributes:
        vehicle: Name or file of the vehicle of all aircraft; None: each has its own.
        per_aircraft: Folder with a vehicle file per aircraft.
        verbs: Verbs to run, from `VERBS`.
        alone: Whether each flight is explained separately, or each aircraft with all its flights.
        indoors: Whether all flights were indoors; None: by each log.
        trust_vehicle: Whether contradictions between rotors of logs and vehicle file are ignored.
    """

    vehicle: str | None = None
    per_aircraft: Path | None = None
    verbs: tuple[Verb, ...] = VERBS
    alone: bool = True
    indoors: bool | None = None
    trust_vehicle: bool = False

    def __post_init__(self) -> None:
        both = self.vehicle is not None and self.per_aircraft is not None
        neither = self.vehicle is None and self.per_aircraft is None
        if both or (neither and OF_VEHICLE & set(self.verbs)):
            raise TwinError(
                f"fleet: {'both' if both else 'neither'} of --vehicle and --per-aircraft given. "
                f"Give the vehicle file of all aircraft, or a folder with one for each; check and "
                f"why need none: --verbs check,why."
            )
        for verb in self.verbs:
            if verb not in VERBS:
                raise TwinError(unknown_name("fleet", "verb", verb, VERBS))
        if not self.verbs:
            raise TwinError(f"fleet: no verb given: {', '.join(VERBS)}.")

    def base(self) -> Vehicle | None:
        """The vehicle of all aircraft.

        Raises:
            ModelError: There is no such vehicle.
        """
        return None if self.vehicle is None else load_vehicle(self.vehicle)

    def own(self) -> dict[str, Vehicle]:
        """Vehicles by the stem of their files' names.

        Raises:
            TwinError: There are none, or one is invalid.
        """
        if self.per_aircraft is None:
            return {}
        files = sorted(self.per_aircraft.glob("*.toml"))
        if not files:
            raise TwinError(f"{self.per_aircraft}: holds no vehicle file, AIRCRAFT.toml.")
        return {f.stem: load_vehicle(f) for f in files}


def fleet(
    logs: str | Path | Sequence[str | Path],
    vehicle: str | Path | None = None,
    *,
    out: str | Path,
    per_aircraft: str | Path | None = None,
    verbs: Sequence[Verb] = VERBS,
    each: str = "flight",
    indoors: bool | None = None,
    engine: EngineName = "local",
    workers: int | None = None,
    scheduler: str | None = None,
    allowed: JobLimits | None = None,
    force: bool = False,
    progress: Progress = lambda _: None,
) -> FleetResult:
    """Check, compare and explain many logs; report aircraft that differ and numbers that drift.

    After an interruption the same call resumes the analysis. Results are bit-identical with any
    engine and any number of workers.

    Args:
        logs: Files, patterns, or folders with logs at any depth.
        vehicle: Vehicle file of all aircraft, or a built-in name.
        out: Folder for the dataset, the page and vehicle files.
        per_aircraft: Instead of `vehicle`, a folder with a file for each aircraft.
        verbs: Verbs to run on each log: `check`, `why`, `gap`, `explain`.
        each: Whether each `flight` is explained separately, or each `aircraft` with all its
            flights.
        indoors: Whether all flights were indoors; None: by each log.
        engine: `local`, or `dask` with a scheduler.
        workers: Processes of the local engine; default: one per core.
        scheduler: Address of a Dask scheduler.
        allowed: Limits for one log, or one aircraft.
        force: Whether files in the folder may be replaced.
        progress: Called with the completed share, 0..1.

    Raises:
        TwinError: There is no log or no vehicle, or the folder is not free.
    """
    if each not in ("flight", "aircraft"):
        raise TwinError(unknown_name("fleet", "each", each, ("flight", "aircraft")))
    folder = None if per_aircraft is None else Path(per_aircraft)
    named = None if vehicle is None else str(vehicle)
    request = FleetRequest(named, folder, tuple(verbs), each == "flight", indoors)
    given = [logs] if isinstance(logs, str | Path) else list(logs)
    work = Work(engine, workers, scheduler, allowed or JobLimits())
    return run_fleet(given, request, Path(out), work, force, progress)


def run_fleet(
    given: Sequence[str | Path],
    request: FleetRequest,
    out: Path,
    work: Work,
    force: bool = False,
    progress: Progress = lambda _: None,
    found: Callable[[FleetResult], None] = lambda _: None,
    alongside: Callable[[FleetResult, Path], None] = lambda *_: None,
    each: Callable[[JobRows], None] = lambda _: None,
) -> FleetResult:
    """Analyse the remaining logs, and write the joint results.

    Args:
        given: Files, patterns, folders.
        request: Settings of the analysis.
        out: Output folder.
        work: Settings of the computation.
        force: Whether files in the folder may be replaced.
        progress: Called with the completed share.
        found: Called with the result as soon as it is available.
        alongside: Writes further files into the given folder.
        each: Called with the results of each log, or of each aircraft, as they arrive.

    Raises:
        TwinError: As in `fleet`.
    """
    check_folder(out, force, JOURNAL)
    base, own = request.base(), request.own()
    logs = found_logs(given)
    analysis = analysis_of(request, base, own, work.allowed)
    with closing(Journal(out / JOURNAL, analysis.key)) as journal:
        with work.opened() as engine:
            jobs = [LogJob(log.job, (log.path,), (log.name,), log.bytes) for log in logs]
            by_aircraft = "explain" in request.verbs and not request.alone
            share = 0.5 if by_aircraft else 1.0
            _do(jobs, analysis, engine, journal, lambda d: progress(share * d), each)
            if by_aircraft:
                more = aircraft_jobs(jobs, journal)
                _do(more, analysis, engine, journal, lambda d: progress(share + share * d), each)
                jobs += more
        with results_folder(out, force, JOURNAL) as folder:
            write_dataset(journal.lines([k.job for k in jobs], journal.places()), folder)
            result = result_of(folder, "" if base is None else base.name)
            if not result.logs:
                first = result.bad_logs(1)["error"].iloc[0]
                raise LogError(f"fleet: none of {counted(logs, 'file')} is a log. {first}")
            found(result)
            if result.explained:
                files = numbers_of_files(result.spreads, list(result.explained), base is not None)
                write_vehicles(files, base, own, folder)
            result.report(folder / "report.html")
            write_json(folder / "fleet.json", result.json())
            alongside(result, folder)
    return replace(result, folder=out)


def analysis_of(
    request: FleetRequest, base: Vehicle | None, own: Mapping[str, Vehicle], allowed: JobLimits
) -> LogAnalysis:
    """The analysis of each log, with a hash of all inputs of its rows."""
    import uavtwin

    texts = {stem: v.text for stem, v in own.items()}
    vehicle = "" if base is None else base.text
    content = [uavtwin.__version__, vehicle, texts, request.verbs, request.alone, request.indoors]
    content += [asdict(allowed), request.trust_vehicle]
    content += [c.name for columns in TABLES.values() for c in columns]
    key = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
    file = request.vehicle or f"{request.per_aircraft}"
    return LogAnalysis(
        key,
        vehicle,
        texts,
        Path(file).name,
        request.verbs,
        request.alone,
        request.indoors,
        allowed,
        request.trust_vehicle,
    )


def aircraft_jobs(jobs: Sequence[LogJob], journal: Journal) -> list[LogJob]:
    """A job for each aircraft named in logs, by its name, each flight once."""
    flights: dict[str, list[LogJob]] = {}
    for job, line in zip(jobs, journal.lines([k.job for k in jobs], journal.places()), strict=True):
        about = line["flights"][0]
        if about.get("aircraft") and about["status"] in ("fine", "findings"):
            flights.setdefault(about["aircraft"], []).append(job)
    found = []
    for aircraft, own in sorted(flights.items()):
        text = "\0".join([aircraft, *(str(k.job) for k in own)])
        paths, names = tuple(k.paths[0] for k in own), tuple(k.names[0] for k in own)
        size = sum(k.bytes for k in own)
        found.append(LogJob(job_number(text), paths, names, size, aircraft))
    return found


def _do(
    jobs: Sequence[LogJob],
    analysis: LogAnalysis,
    engine: Engine,
    journal: Journal,
    progress: Progress,
    each: Callable[[JobRows], None],
) -> None:
    """Run the jobs that are not done."""
    left = [k for k in jobs if k.job not in journal.done]
    done = len(jobs) - len(left)
    for found in engine.run(analysis, _largest_first(left)):
        journal.add(found)
        done += 1
        each(found)
        progress(done / len(jobs))


def _largest_first(jobs: Sequence[LogJob]) -> Iterator[LogJob]:
    """Jobs with the largest first, so that no worker ends with a large one."""
    return iter(sorted(jobs, key=lambda k: (-k.bytes, k.names[0])))


DIGITS = 6
"""Significant digits of a number in a vehicle file."""
FOLDER = "vehicles"
"""Folder for the vehicle files, in the folder of the dataset."""


Numbers = Mapping[str, Estimate]
"""Estimates by "effect.number"."""


@dataclass
class Files:
    """Numbers for the vehicle files.

    Attributes:
        of_type: Numbers common to the type; none: there are no common ones.
        of_aircraft: Numbers of each aircraft.
    """

    of_type: dict[str, Estimate] = field(default_factory=dict)
    of_aircraft: dict[str, dict[str, Estimate]] = field(default_factory=dict)


def numbers_of_files(spreads: Sequence[Spread], explained: Sequence[str], typed: bool) -> Files:
    """Numbers for the vehicle files, of the type and of each aircraft.

    An effect of the type is written to the files of all its aircraft: where its own flights
    determine it, their estimate, shrunk towards the type by its uncertainty; where they do not,
    that of the type, with the spread between aircraft as standard deviation. Other effects belong
    to their aircraft only.

    Args:
        spreads: Numbers over aircraft.
        explained: Names of the aircraft.
        typed: Whether all are of one type; else each has its own numbers only.
    """
    files = Files(of_aircraft={a: {} for a in explained})
    for s in spreads:
        if not s.of_vehicle:
            continue
        name, common = f"{s.effect}.{s.number}", s.common
        shared = typed and s.of_type
        basis = f"uavtwin fleet, {len(s.aircraft)} of {s.explained} aircraft"
        if shared:
            between = f"{basis}, which differ by {common.between:.3g}"
            files.of_type[name] = Estimate(common.mean, common.sd, between)
            unsure = float(np.hypot(common.between, common.sd))
            for numbers in files.of_aircraft.values():
                source = f"{basis}: not determined by its own flights, as of the type"
                numbers[name] = Estimate(common.mean, unsure, source)
        for i, a in enumerate(s.aircraft):
            own = f"uavtwin fleet, named in {a.named} of {a.explained} explanations"
            known = (
                Estimate(float(common.own[i]), float(common.own_sd[i]), f"{own}; {basis}")
                if shared
                else Estimate(a.value, a.sd, own)
            )
            files.of_aircraft.setdefault(a.aircraft, {})[name] = known
    return files


def with_numbers(vehicle: Vehicle, numbers: Numbers, name: str) -> Vehicle:
    """A vehicle with numbers of effects, each with source and standard deviation."""
    values = {k: float(f"{n.value:.{DIGITS}g}") for k, n in numbers.items()}
    effects = tuple(dict.fromkeys(k.partition(".")[0] for k in numbers))
    made = Vehicle.of(with_effects(vehicle, effects, values), vehicle.text)
    sources, deviations = dict(vehicle.sources), dict(vehicle.deviations)
    for k, n in numbers.items():
        key = f"effects.{k}"
        sources[key] = n.source
        deviations.pop(key, None)
        sd = float(f"{n.sd:.4g}")
        if sd > 0 and values[k]:
            deviations[key] = Deviation.of([sd], [values[k]])
    return replace(made, name=name, sources=sources, deviations=deviations, calibration=None)


def write_vehicles(
    files: Files, base: Vehicle | None, own: Mapping[str, Vehicle], out: Path
) -> list[str]:
    """Write all files; returns their names.

    Args:
        files: Numbers for the files.
        base: Vehicle of all aircraft; None: each has its own.
        own: Vehicles by the stem of their aircraft's file name.
        out: Folder of the dataset.
    """
    written = []
    taken = set()
    if base is not None:
        stem = file_stem(base.name)
        taken.add(stem)
        with_numbers(base, files.of_type, base.name).save(out / FOLDER / f"{stem}.toml")
        written.append(f"{stem}.toml")
    for aircraft, numbers in files.of_aircraft.items():
        stem = file_stem(aircraft)
        vehicle = base or own.get(stem)
        if vehicle is None or stem in taken:
            continue
        taken.add(stem)
        with_numbers(vehicle, numbers, vehicle.name).save(out / FOLDER / f"{stem}.toml")
        written.append(f"{stem}.toml")
    return written
