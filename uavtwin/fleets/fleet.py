"""A fleet from start to end: found, looked at on an engine, resumed where it was killed."""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from twin.component import unknown_name
from twin.errors import TwinError

from ..jobs.engine import Engine, EngineName, opened_engine
from ..jobs.process import Allowed
from ..output import check_folder, results_folder, write_json
from ..vehicles import Vehicle, load_vehicle
from .dataset import JOURNAL, Journal, write_dataset
from .logs import Log, found_logs, job_number
from .looking import VERBS, Found, Look, Looking, Verb
from .result import FleetResult, result_of
from .vehicles import numbers_of_files, write_vehicles

Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True)
class Work:
    """How logs are looked at; but for logs that need more than is allowed, nothing depends on it.

    Attributes:
        engine: `local`, or `dask` with a scheduler; its workers find the logs at the same paths.
        workers: Processes of the local engine; None: one per core.
        scheduler: Address of a Dask scheduler.
        allowed: What one log, or one aircraft, may use.
    """

    engine: EngineName = "local"
    workers: int | None = None
    scheduler: str | None = None
    allowed: Allowed = field(default_factory=Allowed)


@dataclass(frozen=True, slots=True)
class Asked:
    """What is asked of a fleet.

    Attributes:
        vehicle: Name or file of the vehicle of all aircraft; None: each has its own.
        per_aircraft: Folder with a vehicle file per aircraft.
        verbs: Of `VERBS`.
        alone: Whether each flight is explained by itself, or each aircraft with all its flights.
        indoors: Whether all flew within walls; None: as each log says.
        trust_vehicle: Whether rotors that the logs state otherwise than the file are left out.
    """

    vehicle: str | None = None
    per_aircraft: Path | None = None
    verbs: tuple[Verb, ...] = VERBS
    alone: bool = True
    indoors: bool | None = None
    trust_vehicle: bool = False

    def __post_init__(self) -> None:
        if (self.vehicle is None) == (self.per_aircraft is None):
            raise TwinError(
                f"fleet: {'neither' if self.vehicle is None else 'both'} of --vehicle and "
                f"--per-aircraft given. Give the vehicle file of all aircraft, or a folder with "
                f"one for each."
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
        """Vehicles by the stem of the names of their files.

        Raises:
            TwinError: There are none, or one is wrong.
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
    allowed: Allowed | None = None,
    force: bool = False,
    progress: Progress = lambda _: None,
) -> FleetResult:
    """Check, compare and explain many logs, and say which aircraft differs and what drifts.

    One that was interrupted or killed goes on where it was when the same call is made again. What
    is found is the same to the last bit with any engine and any number of workers.

    Args:
        logs: Files, patterns, or folders with logs at any depth.
        vehicle: Vehicle file of all aircraft, or a built-in name.
        out: Folder for the dataset, the page and vehicle files.
        per_aircraft: Instead of `vehicle`, a folder with a file for each aircraft.
        verbs: What is done with each log: `check`, `gap`, `explain`.
        each: Whether each `flight` is explained by itself, or each `aircraft` with all its flights.
        indoors: Whether all flew within walls; None: as each log says.
        engine: `local`, or `dask` with a scheduler.
        workers: Processes of the local engine; default: one per core.
        scheduler: Address of a Dask scheduler.
        allowed: What one log, or one aircraft, may use.
        force: Whether files in the folder may be replaced.
        progress: Called with the share done, 0..1.

    Raises:
        TwinError: There is no log or no vehicle, or the folder is not free.
    """
    if each not in ("flight", "aircraft"):
        raise TwinError(unknown_name("fleet", "each", each, ("flight", "aircraft")))
    folder = None if per_aircraft is None else Path(per_aircraft)
    named = None if vehicle is None else str(vehicle)
    asked = Asked(named, folder, tuple(verbs), each == "flight", indoors)
    given = [logs] if isinstance(logs, str | Path) else list(logs)
    work = Work(engine, workers, scheduler, allowed or Allowed())
    return run_fleet(given, asked, Path(out), work, force, progress)


def run_fleet(
    given: Sequence[str | Path],
    asked: Asked,
    out: Path,
    work: Work,
    force: bool = False,
    progress: Progress = lambda _: None,
    found: Callable[[FleetResult], None] = lambda _: None,
    beside: Callable[[FleetResult, Path], None] = lambda *_: None,
    each: Callable[[Found], None] = lambda _: None,
) -> FleetResult:
    """Look at the logs that are not done, and write what they say together.

    Args:
        given: Files, patterns, folders.
        asked: What is asked of them.
        out: Folder.
        work: How.
        force: Whether files in the folder may be replaced.
        progress: Called with the share done, 0..1.
        found: Takes the result as soon as there is one.
        beside: Writes what else belongs into the folder, which it is given.
        each: Called with what is found in each log, or of each aircraft, as it comes.

    Raises:
        TwinError: As `fleet`.
    """
    check_folder(out, force, JOURNAL)
    base, own = asked.base(), asked.own()
    logs = found_logs(given)
    looking = looking_of(asked, base, own, work.allowed)
    with closing(Journal(out / JOURNAL, looking.key)) as journal:
        with opened_engine(work.engine, work.workers, work.scheduler) as engine:
            looks = [_look(log) for log in logs]
            together = "explain" in asked.verbs and not asked.alone
            share = 0.5 if together else 1.0
            _do(looks, looking, engine, journal, lambda d: progress(share * d), each)
            if together:
                more = aircraft_looks(looks, journal)
                _do(more, looking, engine, journal, lambda d: progress(share + share * d), each)
                looks += more
        with results_folder(out, force, JOURNAL) as folder:
            write_dataset(journal.lines(looks, journal.places()), folder)
            result = result_of(folder, "" if base is None else base.name)
            found(result)
            if result.explained:
                files = numbers_of_files(result.spreads, list(result.explained), base is not None)
                write_vehicles(files, base, own, folder)
            result.report(folder / "report.html")
            write_json(folder / "fleet.json", result.json())
            beside(result, folder)
    return replace(result, folder=out)


def looking_of(
    asked: Asked, base: Vehicle | None, own: Mapping[str, Vehicle], allowed: Allowed
) -> Looking:
    """What is done with each log, with a hash of all that decides what is found."""
    import uavtwin

    texts = {stem: v.text for stem, v in own.items()}
    vehicle = "" if base is None else base.text
    content = [uavtwin.__version__, vehicle, texts, asked.verbs, asked.alone, asked.indoors]
    content += [asdict(allowed), asked.trust_vehicle]
    key = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
    file = asked.vehicle or f"{asked.per_aircraft}"
    return Looking(
        key,
        vehicle,
        texts,
        Path(file).name,
        asked.verbs,
        asked.alone,
        asked.indoors,
        allowed,
        asked.trust_vehicle,
    )


def _look(log: Log) -> Look:
    return Look(log.job, (log.path,), (log.name,), log.bytes)


def aircraft_looks(looks: Sequence[Look], journal: Journal) -> list[Look]:
    """A job for each aircraft that logs name, by its name, each flight once."""
    flights: dict[str, list[Look]] = {}
    for look, line in zip(looks, journal.lines(looks, journal.places()), strict=True):
        about = line["flights"][0]
        if about.get("aircraft") and about["status"] in ("fine", "findings"):
            flights.setdefault(about["aircraft"], []).append(look)
    found = []
    for aircraft, own in sorted(flights.items()):
        text = "\0".join([aircraft, *(str(k.job) for k in own)])
        paths, names = tuple(k.paths[0] for k in own), tuple(k.names[0] for k in own)
        size = sum(k.bytes for k in own)
        found.append(Look(job_number(text), paths, names, size, aircraft))
    return found


def _do(
    looks: Sequence[Look],
    looking: Looking,
    engine: Engine,
    journal: Journal,
    progress: Progress,
    each: Callable[[Found], None],
) -> None:
    """Do what is not done."""
    left = [k for k in looks if k.job not in journal.done]
    done = len(looks) - len(left)
    for found in engine.run(looking, _largest_first(left)):
        journal.add(found)
        done += 1
        each(found)
        progress(done / len(looks))


def _largest_first(looks: Sequence[Look]) -> Iterator[Look]:
    """The large ones first: no worker has one left when the others are done."""
    return iter(sorted(looks, key=lambda k: (-k.bytes, k.names[0])))
