"""Store of the site: logs by their hash, results as files, a table of flights and of jobs.

A mapping file of ROS 2 bags is stored for bags of its name, and is copied next to each.

The table of jobs is the journal: a job is queued in it before it runs, and one that was running
when the server ended is queued again by the next.
"""

import contextlib
import hashlib
import itertools
import os
import re
import secrets
import shutil
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from twin.errors import TwinError, install_command
from twin.topic_mapping import BAG_SUFFIXES, MAPPING_SUFFIX, read_mapping
from twin.vehicle_file import builtin_vehicles

from ..output import output_file
from ..site.doors import SHORTEST_TOKEN

State = Literal["queued", "running", "done", "failed", "cancelled"]
OPEN: tuple[State, ...] = ("queued", "running")
"""States of a job that has not ended."""
OF_VEHICLE = ("gap", "fmu", "explain")
"""Kinds of jobs that need a vehicle."""
MOST_TRIES = 3
"""Largest number of starts of a job: one during which the server ended that often is not started
again."""
SHOWN = 200
"""Number of flights in a list: more are found by searching."""
LONGEST_NAME = 80
"""Largest number of characters of a file name."""
LONGEST_TAGS = 200
"""Largest number of characters of a flight's tags."""
JOURNAL = "explain.part"
"""File name as in `uavtwin.explain_journal`, whose import would load numpy and CasADi into the
server."""
_OF_LOG = ("check", "why", "draft", "gap", "mcap", "explain")
"""Kinds of jobs for each log, in the order of their names."""
FORMAT = 1
"""Version of the tables; a store of another version is not opened."""
_TABLES = f"""
CREATE TABLE IF NOT EXISTS format AS SELECT {FORMAT} AS number;
CREATE TABLE IF NOT EXISTS flights (
    id TEXT, sha256 TEXT, name TEXT, bytes BIGINT, added_s DOUBLE, format TEXT, aircraft TEXT,
    airframe TEXT, date_year DOUBLE, duration_s DOUBLE, verdict TEXT, check_text TEXT,
    why_verdict TEXT, why_text TEXT, gap_text TEXT, explain_text TEXT, tags TEXT, vehicle TEXT
);
CREATE TABLE IF NOT EXISTS scripts (hash TEXT);
CREATE TABLE IF NOT EXISTS jobs (
    flight TEXT, kind TEXT, other TEXT, state TEXT, queued_s DOUBLE, began_s DOUBLE, ended_s DOUBLE,
    tries INTEGER, text TEXT
);
"""
_SETTINGS = {
    "memory_limit": "256MB",
    "threads": "1",
    "python_enable_replacements": "false",
    "autoinstall_known_extensions": "false",
    "autoload_known_extensions": "false",
}
"""Settings of DuckDB: little memory, no extensions."""
_ANSWERS = ("verdict", "check_text", "why_verdict", "why_text", "gap_text", "explain_text")
"""Columns with results of the log."""
_SEARCHED = ("name", "tags", "verdict", "check_text", "why_text", "airframe", "format", "vehicle")
"""Columns that a search covers."""


@dataclass(frozen=True, slots=True)
class FlightRow:
    """A flight in the list.

    Attributes:
        id: First characters of the hash of its log.
        sha256: Full hash of its log.
        name: Original name of the file.
        bytes: Size of the log.
        added_s: Time of upload, s since 1970.
        format: Format of the log.
        aircraft: Identifier in the log, "" where it has none.
        airframe: Kind of aircraft.
        date_year: Date by the satellites, decimal year.
        duration_s: Duration of the flight table.
        verdict: Verdict of check: fine, warnings, problems, unreadable; None: not known yet.
        check_text: First finding of check.
        why_verdict: Verdict of why.
        why_text: Sentence of why.
        gap_text: Sentence of gap.
        explain_text: Sentence of explain.
        tags: Tags set by users.
        vehicle: Name of the vehicle file, or of a built-in vehicle, for the comparison.
    """

    id: str
    sha256: str
    name: str
    bytes: int
    added_s: float
    format: str | None
    aircraft: str | None
    airframe: str | None
    date_year: float | None
    duration_s: float | None
    verdict: str | None
    check_text: str | None
    why_verdict: str | None
    why_text: str | None
    gap_text: str | None
    explain_text: str | None
    tags: str
    vehicle: str | None


Run = tuple[str, str, str, float]
"""Run of a job: flight, kind, the other flight, time of queueing, s since 1970."""


@dataclass(frozen=True, slots=True)
class JobRow:
    """A job.

    Attributes:
        flight: Flight of the job.
        kind: Kind of the job.
        other: Second flight of a comparison; else "".
        state: State of the job.
        queued_s: Time of queueing, s since 1970.
        began_s: Time of the last start.
        ended_s: Time of the end.
        tries: Number of starts.
        text: Reason of failure.
    """

    flight: str
    kind: str
    other: str
    state: State
    queued_s: float
    began_s: float | None
    ended_s: float | None
    tries: int
    text: str | None

    @property
    def run(self) -> Run:
        """Identifier of this run of the job: one that is queued again has another."""
        return self.flight, self.kind, self.other, self.queued_s


_FLIGHT = ", ".join(FlightRow.__slots__)
_JOB = ", ".join(JobRow.__slots__)


def safe_name(given: str) -> str:
    """A valid file name: letters, digits, `_`, `-` and `.`, beginning with a letter or digit.

    Args:
        given: Name of any origin.
    """
    name = re.sub(r"[^A-Za-z0-9_.-]+", "_", given.replace("\\", "/").rpartition("/")[2])
    stem, dot, end = name.strip("._-").rpartition(".")
    return f"{stem[: LONGEST_NAME - 10]}{dot}{end[:9]}" if stem else end[:LONGEST_NAME] or "log"


def is_mapping(name: str) -> bool:
    """Whether a file has the name of a mapping file for a ROS 2 bag."""
    return name.lower().endswith(MAPPING_SUFFIX)


def _is_bag(flight: FlightRow) -> bool:
    """Whether a log is a ROS 2 bag, by its content, else by its name."""
    if flight.format is not None:
        return flight.format.startswith("ROS 2 bag")
    return Path(flight.name).suffix in BAG_SUFFIXES


@dataclass(slots=True)
class Upload:
    """A file that is being uploaded.

    Attributes:
        path: Path of the partial file.
        most: Largest size, bytes.
        limit: Name of the limit.
        size: Bytes received.
    """

    path: Path
    most: int
    limit: str = "--size-limit"
    size: int = 0
    _hash: Any = field(default_factory=hashlib.sha256)

    def __post_init__(self) -> None:
        self.path.touch()

    def check(self, size: int) -> None:
        """Refuse a file that is too large.

        Raises:
            TwinError: It is too large.
        """
        if size > self.most:
            most = f"{self.most / 2**20:.0f} MiB" if self.most >= 2**20 else f"{self.most} bytes"
            raise TwinError(f"over {most}, the limit ({self.limit})")

    def write(self, part: bytes) -> None:
        """Append bytes.

        Raises:
            TwinError: There are too many, or the disk is full.
        """
        self.size += len(part)
        self.check(self.size)
        self._hash.update(part)
        try:
            with self.path.open("ab") as file:
                file.write(part)
        except OSError as error:
            raise TwinError(f"cannot be stored: {error.strerror}. Make room.") from error

    @property
    def sha256(self) -> str:
        """Hash of the received bytes."""
        return str(self._hash.hexdigest())


class Store:
    """The open store; one process has it.

    Attributes:
        lock: Lock for read-modify-write; no other lock is taken within.
    """

    def __init__(self, folder: Path) -> None:
        """Open or create it; incomplete uploads are removed, running jobs are queued again.

        Raises:
            TwinError: The package is missing, another server uses it, or it is no such folder.
        """
        try:
            import duckdb
        except ImportError as error:
            raise TwinError(
                f"serve needs the package duckdb: {install_command('serve')}."
            ) from error
        self.folder = folder.absolute()
        self.lock = threading.RLock()
        try:
            for name in ("logs", "flights", "vehicles", "mappings", "incoming"):
                (self.folder / name).mkdir(parents=True, exist_ok=True)
            self._tables = self._opened(duckdb)
        except OSError as error:
            raise TwinError(f"--store {folder}: {error.strerror or error}.") from error
        for left in (self.folder / "incoming").iterdir():
            shutil.rmtree(left) if left.is_dir() else left.unlink()
        self._write("UPDATE jobs SET state = 'queued' WHERE state = 'running'")
        text = f"the server ended {MOST_TRIES} times while this was done"
        self._write(
            "UPDATE jobs SET state = 'failed', text = ? WHERE state = 'queued' AND tries >= ?",
            (text, MOST_TRIES),
        )

    def _opened(self, duckdb: Any) -> Any:
        file = self.folder / "store.duckdb"
        try:
            tables: Any = duckdb.connect(str(file), config=dict(_SETTINGS))
            tables.execute(_TABLES)
            number = tables.execute("SELECT number FROM format").fetchone()
        except duckdb.Error as error:
            if "lock" in str(error):
                raise TwinError(
                    f"--store {self.folder}: another server has it open. End it, or choose another "
                    f"--store."
                ) from error
            raise TwinError(f"{file}: is no table of flights: {error}") from error
        if number != (FORMAT,):
            raise TwinError(f"{file}: of another version of uavtwin. Choose another --store.")
        return tables

    def close(self) -> None:
        """Close, so that another process may open it; jobs that end by request have not failed."""
        with self.lock:
            self._write(
                "UPDATE jobs SET state = 'queued', tries = tries - 1 WHERE state = 'running'"
            )
            self._tables.close()

    def _rows(self, sql: str, values: Sequence[Any] = ()) -> list[tuple[Any, ...]]:
        with self.lock:
            return list(self._tables.execute(sql, list(values)).fetchall())

    def _write(self, sql: str, values: Sequence[Any] = ()) -> int:
        """Number of rows that were changed."""
        found = self._rows(sql, values)
        return int(found[0][0]) if found else 0

    def token(self) -> str:
        """Token of viewers on other machines: stored, so that a link stays valid."""
        file, new = self.folder / "token", self.folder / "token.new"
        token = file.read_text("utf-8").strip() if file.exists() else ""
        if len(token) < SHORTEST_TOKEN:
            token = secrets.token_urlsafe(24)
            new.unlink(missing_ok=True)
            made = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with open(made, "w", encoding="utf-8") as out:
                out.write(token)
                out.flush()
                os.fsync(made)
            new.replace(file)  # atomically
        return token

    def known_scripts(self, new: Sequence[str]) -> tuple[str, ...]:
        """Hashes of the scripts of all versions that wrote pages here, with those of this one."""
        for name in new:
            self._write(
                "INSERT INTO scripts SELECT ? WHERE ? NOT IN (SELECT hash FROM scripts)",
                (name, name),
            )
        return tuple(str(row[0]) for row in self._rows("SELECT hash FROM scripts ORDER BY hash"))

    # -- logs -----------------------------------------------------------------------------------

    @contextlib.contextmanager
    def upload(self, most: int, limit: str = "--size-limit") -> Iterator[Upload]:
        """A file that is being uploaded; removed at the end unless it was added.

        Args:
            most: Largest size, bytes.
            limit: Name of the limit.
        """
        coming = Upload(self.folder / "incoming" / secrets.token_hex(8), most, limit)
        try:
            yield coming
        finally:
            coming.path.unlink(missing_ok=True)

    def add(self, name: str, file: Path, sha256: str, size: int) -> tuple[str, bool]:
        """Add a file as a log; returns the identifier of its flight, and whether it is new.

        Args:
            name: Original name of the file.
            file: Path of the file, which is moved.
            sha256: Hash of the file.
            size: Size of the file.
        """
        flight, name = sha256[:16], safe_name(name)
        with self.lock:
            if self.flight(flight) is not None:
                return flight, False
            place = self.folder / "logs" / sha256
            place.mkdir(exist_ok=True)
            file.replace(place / name)
            self._map(place / name)
            self._write(
                "INSERT INTO flights (id, sha256, name, bytes, added_s, tags) "
                "VALUES (?, ?, ?, ?, ?, '')",
                (flight, sha256, name, size, time.time()),
            )
            self.queue(flight, "check")
        return flight, True

    def _map(self, log: Path) -> None:
        """Copy the mapping file of a bag's name next to it, if there is one."""
        mapping = self.folder / "mappings" / f"{log.stem}{MAPPING_SUFFIX}"
        if mapping.is_file():
            shutil.copyfile(mapping, log.with_name(mapping.name))

    def add_mapping(self, name: str, file: Path) -> dict[str, list[str]]:
        """Add a mapping file of ROS 2 bags; returns the flights of its name, and the kinds of jobs
        that are repeated for each.

        Args:
            name: Original name of the file.
            file: Path of the file, which is moved.

        Raises:
            TwinError: It is no mapping, or has no name.
        """
        read_mapping(file, name)
        bag = Path(safe_name(f"{name[: -len(MAPPING_SUFFIX)]}.bag"))
        if not bag.suffix:
            way_out = f"Call it as the bag: day{MAPPING_SUFFIX} for day.mcap"
            raise TwinError(f"{name}: a mapping of topics without the name of its bag. {way_out}.")
        with self.lock:
            file.replace(self.folder / "mappings" / f"{bag.stem}{MAPPING_SUFFIX}")
            found = self._rows(
                f"SELECT {_FLIGHT} FROM flights WHERE starts_with(name, ?)", (bag.stem,)
            )
            flights = [FlightRow(*row) for row in found]
            return {
                f.id: self._queue_again(f)
                for f in flights
                if Path(f.name).stem == bag.stem and _is_bag(f)
            }

    def _queue_again(self, bag: FlightRow) -> list[str]:
        """Delete results of a bag, and queue it again; returns its kinds of jobs."""
        self._map(self.log(bag))
        jobs = [j for j in self.jobs(bag.id) if j.state != "cancelled"]
        drafted = {j.kind for j in jobs if (j.kind, j.state) == ("draft", "done")}  # it is chosen
        there = {"check", *(j.kind for j in jobs)} - drafted
        kinds = [kind for kind in _OF_LOG if kind in there]
        self._write(
            "DELETE FROM jobs WHERE (flight = ? AND list_contains(?, kind)) OR "
            "(kind = 'compare' AND ? IN (flight, other))",
            (bag.id, list(_OF_LOG), bag.id),
        )
        self.note(bag.id, **dict.fromkeys(_ANSWERS))
        (self.results(bag.id) / JOURNAL).unlink(missing_ok=True)
        for kind in kinds:
            if kind != "why":  # which check queues
                self.queue(bag.id, kind)
        return kinds

    def log(self, flight: FlightRow) -> Path:
        """Path of a flight's log."""
        return self.folder / "logs" / flight.sha256 / flight.name

    def results(self, flight: str) -> Path:
        """Folder of a flight's results."""
        place = self.folder / "flights" / flight
        place.mkdir(exist_ok=True)
        return place

    def incoming(self, job: JobRow) -> Path:
        """Folder for the unpacked files of a run; not created."""
        return self.folder / "incoming" / "-".join(map(str, job.run))

    def delete(self, flight: FlightRow) -> None:
        """Delete a flight, its log and its results; the same log may be added again at once."""
        gone = [self.folder / "incoming" / secrets.token_hex(8) for _ in range(2)]
        with self.lock:
            self._write("DELETE FROM jobs WHERE flight = ? OR other = ?", (flight.id, flight.id))
            self._write("DELETE FROM flights WHERE id = ?", (flight.id,))
            for name, place in zip(
                (f"logs/{flight.sha256}", f"flights/{flight.id}"), gone, strict=True
            ):
                with contextlib.suppress(FileNotFoundError):
                    (self.folder / name).rename(place)
        for place in gone:
            shutil.rmtree(place, ignore_errors=True)

    # -- flights --------------------------------------------------------------------------------

    def flight(self, flight: str) -> FlightRow | None:
        """A flight; None: there is none."""
        found = self._rows(f"SELECT {_FLIGHT} FROM flights WHERE id = ?", (flight,))
        return FlightRow(*found[0]) if found else None

    def flights(self, search: str = "") -> tuple[list[FlightRow], int]:
        """Flights that match all words of a search, the newest first, and their number."""
        words = search.split()[:10]
        text = " || ' ' || ".join(f"coalesce({c}, '')" for c in _SEARCHED)
        where = " AND ".join([f"contains(lower({text}), lower(?))"] * len(words)) or "true"
        found = self._rows(
            f"SELECT {_FLIGHT} FROM flights WHERE {where} ORDER BY added_s DESC LIMIT {SHOWN}",
            words,
        )
        ((count,),) = self._rows(f"SELECT count(*) FROM flights WHERE {where}", words)
        return [FlightRow(*row) for row in found], int(count)

    def note(self, flight: str, **values: str | float | None) -> None:
        """Store facts of a flight, by column of `FlightRow`."""
        columns = [c for c in values if c in FlightRow.__slots__[5:]]
        if columns:
            which = ", ".join(f"{c} = ?" for c in columns)
            given = (*(values[c] for c in columns), flight)
            self._write(f"UPDATE flights SET {which} WHERE id = ?", given)

    def choose(self, flight: str, vehicle: str) -> None:
        """Set another vehicle of a flight: results with the previous one are deleted."""
        with self.lock:
            self.note(flight, vehicle=vehicle, gap_text=None, explain_text=None)
            self._write(
                "DELETE FROM jobs WHERE flight = ? AND list_contains(?, kind)",
                (flight, list(OF_VEHICLE)),
            )
            self.queue(flight, "gap")

    def vehicle_of_aircraft(self, aircraft: str) -> str | None:
        """The vehicle that was chosen last for a flight of this aircraft."""
        found = self._rows(
            "SELECT vehicle FROM flights WHERE aircraft = ? AND vehicle IS NOT NULL "
            "ORDER BY added_s DESC LIMIT 1",
            (aircraft,),
        )
        return str(found[0][0]) if found else None

    def vehicles(self) -> list[str]:
        """Names of the vehicle files."""
        return sorted(p.stem for p in (self.folder / "vehicles").glob("*.toml"))

    def vehicle_file(self, name: str) -> Path | None:
        """A vehicle file; None: there is none of this name."""
        return self.folder / "vehicles" / f"{name}.toml" if name in self.vehicles() else None

    def add_vehicle(self, file: Path) -> str:
        """Copy a vehicle file to the others; returns its name there.

        A number is appended where another vehicle has that name: results of that one remain valid.

        Args:
            file: Path of the file, which is not moved.
        """
        content, stem = file.read_bytes(), Path(safe_name(file.name)).stem
        taken = builtin_vehicles()
        with self.lock:
            for number in itertools.count(1):
                name = stem if number == 1 else f"{stem}-{number}"
                place = self.folder / "vehicles" / f"{name}.toml"
                if name in taken or (place.exists() and place.read_bytes() != content):
                    continue
                if not place.exists():
                    with output_file(place) as new:
                        new.write_bytes(content)
                break
        return name

    # -- jobs -----------------------------------------------------------------------------------

    def queue(self, flight: str, kind: str, other: str = "") -> bool:
        """Queue a job; returns whether it was not open already. One that has ended is repeated."""
        with self.lock:
            found = self.job(flight, kind, other)
            if found is not None and found.state in OPEN:
                return False
            key = (flight, kind, other)
            self._write("DELETE FROM jobs WHERE flight = ? AND kind = ? AND other = ?", key)
            self._write(
                "INSERT INTO jobs VALUES (?, ?, ?, 'queued', ?, NULL, NULL, 0, NULL)",
                (*key, time.time()),
            )
            return True

    def job(self, flight: str, kind: str, other: str = "") -> JobRow | None:
        """A job; None: there is none."""
        found = self._rows(
            f"SELECT {_JOB} FROM jobs WHERE flight = ? AND kind = ? AND other = ?",
            (flight, kind, other),
        )
        return JobRow(*found[0]) if found else None

    def is_running(self, job: JobRow) -> bool:
        """Whether this run of a job is in progress: not cancelled, not queued again."""
        now = self.job(job.flight, job.kind, job.other)
        return now is not None and now.state == "running" and now.run == job.run

    def jobs(self, flight: str) -> list[JobRow]:
        """All jobs of a flight."""
        found = self._rows(f"SELECT {_JOB} FROM jobs WHERE flight = ? ORDER BY queued_s", (flight,))
        return [JobRow(*row) for row in found]

    def take(self, kinds: Sequence[str]) -> JobRow | None:
        """The next queued job, marked as running; None: there is none.

        Args:
            kinds: Kinds that are taken, the most urgent first.
        """
        with self.lock:
            rows = self._rows(
                f"SELECT {_JOB} FROM jobs WHERE state = 'queued' AND list_contains(?, kind) "
                "ORDER BY list_position(?, kind), queued_s LIMIT 1",
                (list(kinds), list(kinds)),
            )
            if not rows:
                return None
            job = JobRow(*rows[0])
            self._write(
                "UPDATE jobs SET state = 'running', began_s = ?, tries = tries + 1 "
                "WHERE flight = ? AND kind = ? AND other = ?",
                (time.time(), job.flight, job.kind, job.other),
            )
            return job

    def end(self, job: JobRow, state: State, text: str | None = None) -> bool:
        """Store the end of an open run of a job; returns whether it was still open."""
        return bool(
            self._write(
                "UPDATE jobs SET state = ?, ended_s = ?, text = ? WHERE flight = ? AND kind = ? "
                "AND other = ? AND queued_s = ? AND state IN ('queued', 'running')",
                (state, time.time(), text, *job.run),
            )
        )
