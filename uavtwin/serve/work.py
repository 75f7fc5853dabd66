"""Jobs for a log, in a separate process: each kind of job writes its files.

Large packages are imported only by the jobs that need them: the server imports this module too.
"""

import hashlib
import json
import shutil
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.errors import LogError, TwinError

from ..jobs.process import Progress

if TYPE_CHECKING:
    from twin.logs import Flight

Job = Mapping[str, Any]
"""Kind, log, folder of the results, vehicle; further data by kind."""
Answer = dict[str, Any]
"""Result with `error`, or any of `note` (columns of the flight), `queue` (kinds of jobs), `logs`
(of an archive), `vehicle` (a file for the store), `chosen` (whether the flight uses it)."""
TABLE = "flight.parquet"
"""Flight table that check writes for all other jobs."""
MOST_LOGS = 500
"""Largest number of logs in one archive."""
_BLOCK = 1 << 20
"""Block size for unpacking, bytes."""


@dataclass(frozen=True, slots=True)
class LogWork:
    """Runs the jobs of the site.

    Attributes:
        most_bytes: Largest size of a log from an archive.
    """

    most_bytes: int

    def do(self, job: Job, progress: Progress = lambda _: None) -> Answer:
        """Result of a job; an error is a result too."""
        try:
            return KINDS[job["kind"]](self, job, progress)
        except TwinError as error:
            return {"error": str(error)}
        except MemoryError:
            return {"error": "needs more memory than a job may use (--memory-limit)."}
        except Exception as error:
            said = " ".join(str(error).split())[:300]
            return {"error": f"{type(error).__name__}: {said} This is a mistake of uavtwin."}


def _warm(_: LogWork, __: Job, ___: Progress) -> Answer:
    """Import the packages for the first log."""
    from .. import diagnosis, file_check, gaps  # noqa: F401
    from ..report import gap, why  # noqa: F401

    return {}


def _check(work: LogWork, job: Job, _: Progress) -> Answer:
    """Format and findings of the file; the flight table; the logs of an archive."""
    from twin.logs import Flight, open_flight
    from twin.logs.read import logs_in_archive
    from twin.vehicle_file import builtin_vehicles

    from ..file_check import check_file, check_flight
    from ..flights import reported_aircraft
    from ..output import write_json

    log, folder = Path(job["log"]), Path(job["folder"])
    if log.suffix == ".toml":
        if log.stem in builtin_vehicles():
            raise TwinError(f"{log.name}: a built-in vehicle has this name. Rename the file.")
        check_file(log)
        return {"vehicle": str(log)}
    if len(members := logs_in_archive(log)) > 1:
        return {"logs": _unpack(log, members, Path(job["incoming"]), work.most_bytes)}
    flight = open_flight(log)
    report = check_flight(flight, log.name)
    write_json(folder / "check.json", report.json())
    if isinstance(flight, Flight):
        _write_table(flight, folder)
    else:
        shutil.copyfile(log, folder / TABLE)
    airframe = flight.airframe
    place = None if airframe is None else airframe.place
    time_s = flight.time_s
    aircraft = ", ".join(t for t in reported_aircraft(flight) if t)
    note = {
        "format": flight.facts.get("format"),
        "aircraft": aircraft if "aircraft" in flight.facts else "",
        "airframe": report.facts.get("kind"),
        "date_year": None if place is None else place.value.year,
        "duration_s": float(time_s[-1] - time_s[0]),
        **{"verdict": report.verdict, "check_text": report.reason},
    }
    return {"note": note, "queue": ["why"]}


def _write_table(flight: "Flight", folder: Path) -> None:
    from twin.logs import write_flight

    from ..output import output_file

    with output_file(folder / TABLE) as file:
        write_flight(flight, file)


def _unpack(archive: Path, members: list[str], folder: Path, most: int) -> list[Answer]:
    """Name, file, hash and size of each log of an archive.

    Args:
        archive: Path of a ZIP archive.
        members: Names of its logs.
        folder: Folder for unpacked files; it is created. The caller removes it.
        most: Largest size of one log, bytes.

    Raises:
        LogError: There are too many, one or all of them are too large, or one cannot be unpacked.
    """
    from twin.logs.read import DAMAGED, TOO_LARGE, most_unpacked

    if len(members) > MOST_LOGS:
        raise LogError(f"a ZIP archive of {len(members)} logs, over {MOST_LOGS}. Split it.")
    most_of_all = left = most_unpacked(archive.stat().st_size)
    found: list[Answer] = []
    for number, name in enumerate(members):
        try:
            answer = _unpack_one(archive, name, folder / str(number), min(most, left))
        except DAMAGED as error:
            of_disk = isinstance(error, OSError) and error.errno is not None
            way_out = "Make room in --store" if of_disk else "Copy or download the archive again"
            raise LogError(
                f"{archive.name}: {name[:80]} cannot be unpacked ({error}). {way_out}."
            ) from error
        if answer["bytes"] > most:
            limit = f"over {most / 2**20:.0f} MiB, the limit (--size-limit)."
            raise LogError(f"{archive.name}: {name[:80]}: {limit}")
        left -= answer["bytes"]
        if left < 0:
            raise LogError(f"{archive.name}: unpacks to over {most_of_all} bytes, {TOO_LARGE}")
        found.append(answer)
    return found


def _unpack_one(archive: Path, name: str, file: Path, most: int) -> Answer:
    """Name, file, hash and size of one log of an archive, which is refused above `most` bytes."""
    digest, size = hashlib.sha256(), 0
    file.parent.mkdir(exist_ok=True)
    with zipfile.ZipFile(archive) as opened, opened.open(name) as source, file.open("wb") as out:
        while size <= most and (part := source.read(_BLOCK)):
            size += len(part)
            digest.update(part)
            out.write(part)
    return {"name": name, "file": str(file), "sha256": digest.hexdigest(), "bytes": size}


def _why(_: LogWork, job: Job, __: Progress) -> Answer:
    """Diagnosis of the flight from the log alone."""
    from ..diagnosis import why
    from ..output import write_json

    found = why(job["log"])
    folder = Path(job["folder"])
    write_json(folder / "why.json", found.record.json())
    found.report(folder / "why.html")
    return {"note": {"why_verdict": found.record.verdict, "why_text": found.record.text}}


def _gap(_: LogWork, job: Job, progress: Progress) -> Answer:
    """Gap between the flight and the twin of its vehicle."""
    from ..flights import open_alike
    from ..gaps import gap
    from ..output import write_json
    from ..vehicles import load_vehicle

    found = gap(open_alike([Path(job["log"])]), load_vehicle(job["vehicle"]), progress=progress)
    folder = Path(job["folder"])
    write_json(folder / "gap.json", found.record.json())
    found.report(folder / "gap.html")
    return {"note": {"gap_text": found.claim}}


def _draft(_: LogWork, job: Job, __: Progress) -> Answer:
    """First vehicle file from the log and the owner's knowledge of the aircraft."""
    from twin.logs import read_flight

    from ..vehicle_draft import draft_vehicle

    log, folder = Path(job["log"]), Path(job["folder"])
    known = json.loads((folder / "draft.json").read_text("utf-8"))
    found = draft_vehicle(read_flight(log), **known, name=f"draft_{job['flight'][:6]}")
    file = found.vehicle.save(folder / f"{found.vehicle.name}.toml")
    return {"vehicle": str(file), "chosen": True}


def explained_file(folder: Path, flight: str) -> Path:
    """Vehicle file with the effects that explain named for a flight.

    Args:
        folder: Folder of the flight's results.
        flight: Identifier of the flight.
    """
    return folder / "explain" / f"explained_{flight[:6]}.toml"


def _explain(_: LogWork, job: Job, progress: Progress) -> Answer:
    """Missing effect of the vehicle; after a kill or cancellation, the search is resumed."""
    from ..explain_journal import JOURNAL, ExplainJournal, run_key
    from ..explanation import explain, write_explanation
    from ..flights import open_alike
    from ..vehicles import load_vehicle

    log, folder, vehicle = Path(job["log"]), Path(job["folder"]), load_vehicle(job["vehicle"])
    flights = open_alike([log])
    journal = ExplainJournal(folder / JOURNAL, run_key([log], [], vehicle, ()))
    found = explain(flights, [], vehicle, progress=progress, checkpoint=journal)
    place = folder / "explain"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    answer: Answer = {"note": {"explain_text": found.sentence}}
    if "vehicle.toml" in write_explanation(found.details, place):
        file = explained_file(folder, job["flight"])
        (place / "vehicle.toml").rename(file)
        answer["vehicle"] = str(file)
    journal.remove()
    return answer


def _mcap(_: LogWork, job: Job, __: Progress) -> Answer:
    """Export of the flight for Foxglove and PlotJuggler, and a layout for each."""
    from twin.logs import read_flight

    from ..output import output_file
    from ..series.layouts import write_layouts
    from ..series.mcap import write_flight_mcap

    flight, out = read_flight(job["log"]), Path(job["folder"]) / "flight.mcap"
    with output_file(out) as file:
        write_flight_mcap(flight, file)
    write_layouts(flight, out)
    return {}


def _fmu(_: LogWork, job: Job, progress: Progress) -> Answer:
    """FMU of the whole twin of the vehicle."""
    from ..exports.parts import twin
    from ..exports.write import export
    from ..vehicles import load_vehicle

    export(twin(load_vehicle(job["vehicle"])), Path(job["folder"]) / "twin.fmu", progress=progress)
    return {}


def _compare(_: LogWork, job: Job, __: Progress) -> Answer:
    """Comparison of two flights."""
    from twin.logs import open_flight

    from ..output import output_file
    from .comparison import comparison_page

    first, second = (open_flight(Path(f) / TABLE) for f in (job["folder"], job["other_folder"]))
    with output_file(Path(job["folder"]) / f"compare-{job['other']}.html") as file:
        file.write_text(comparison_page(first, second, job["name"], job["other_name"]), "utf-8")
    return {}


KINDS: Mapping[str, Callable[[LogWork, Job, Progress], Answer]] = {
    "warm": _warm,
    "check": _check,
    "compare": _compare,
    "why": _why,
    "draft": _draft,
    "gap": _gap,
    "mcap": _mcap,
    "fmu": _fmu,
    "explain": _explain,
}
"""Kinds of jobs, the most urgent first."""
LONG = ("fmu", "explain")
"""Kinds that take minutes: one worker never runs them, so that new logs do not wait."""
QUICK = tuple(k for k in KINDS if k not in ("warm", *LONG))
"""Other kinds of jobs."""
