"""Scheduler: distribution of jobs to worker processes, their progress and results."""

import contextlib
import logging
import shutil
import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..jobs.process import JobLimits, ProcessWorker
from .store import OF_VEHICLE, FlightRow, JobRow, Run, Store
from .work import LONG, QUICK, Answer, Job, LogWork

QUICK_SHARE = 1 / 3
"""Share of the time limit for a quick job, so that a hostile log blocks a worker no longer. `why`
of 40 min of flight took 3 min on a shared core."""
LARGE_BYTES = 30_000_000
"""Size of a log after which a worker process is replaced, to release its memory."""
_IDLE_S = 5.0
"""Interval at which a thread looks for work, or retries after a failure of the store."""
_LOG = logging.getLogger(__name__)
"""Log of failures that no job can report."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits for a log and for a job.

    Attributes:
        allowed: Time limit of a long job, memory limit of any job.
        most_bytes: Largest size of a log.
        workers: Number of worker processes.
    """

    allowed: JobLimits = field(default_factory=lambda: JobLimits(1800.0, 3.0))
    most_bytes: int = 1 << 30
    workers: int = 2


class Scheduler:
    """Threads that take jobs from the store, each with a worker process.

    Attributes:
        done: Completed share of each running job, 0..1.
    """

    def __init__(self, store: Store, limits: Limits, changed: Callable[[str], None]) -> None:
        """Set up without starting.

        Args:
            store: Store with the jobs.
            limits: Limits of the jobs.
            changed: Called with a flight that has changed, from any thread.
        """
        self._store, self._limits, self._changed = store, limits, changed
        self._bell = threading.Condition()
        self._ended = False
        self._workers = [
            ProcessWorker[Job, Answer](LogWork(limits.most_bytes), dict, _lost, limits.allowed)
            for _ in range(limits.workers)
        ]
        self._running: dict[JobRow, ProcessWorker[Job, Answer]] = {}
        self.done: dict[Run, float] = {}
        self._threads = [
            threading.Thread(target=self._work, args=(k,), name=f"worker {k}", daemon=True)
            for k in range(limits.workers)
        ]

    def start(self) -> None:
        """Start with the queued jobs."""
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """End all processes; the next server repeats their jobs."""
        with self._bell:
            self._ended = True
            self._bell.notify_all()
        for worker in self._workers:
            worker.kill()
        for thread in self._threads:
            thread.join(5.0)

    def wake(self) -> None:
        """Notify of new jobs in the store."""
        with self._bell:
            self._bell.notify_all()

    def cancel(self, flight: str, kind: str, other: str = "") -> bool:
        """End a job, or remove it from the queue; returns whether it was open."""
        job = self._store.job(flight, kind, other)
        if job is None or not self._store.end(job, "cancelled"):
            return False
        self._kill_ended()
        self._changed(flight)
        return True

    def choose(self, flight: str, vehicle: str) -> None:
        """Set the vehicle of a flight; running jobs with the previous one end."""
        self._store.choose(flight, vehicle)
        self._kill_ended()
        self.wake()

    def map_topics(self, name: str, file: Path) -> dict[str, list[str]]:
        """Add a mapping file of ROS 2 bags, and read bags of its name again, see
        `Store.add_mapping`."""
        flights = self._store.add_mapping(name, file)
        self._kill_ended()
        self.wake()
        for flight in flights:
            self._changed(flight)
        return flights

    def _kill_ended(self) -> None:
        """End the processes of jobs that have ended in the store."""
        with self._bell:
            for job, worker in self._running.items():
                if not self._store.is_running(job):
                    worker.kill()

    # -- in the thread of a worker --------------------------------------------------------------

    def _work(self, number: int) -> None:
        kinds = QUICK if number == 0 and self._limits.workers > 1 else (*QUICK, *LONG)
        with contextlib.closing(self._workers[number]) as worker:
            with contextlib.suppress(OSError):  # the first job starts it, or reports why not
                worker.do({"kind": "warm"})
            while not self._ended:
                try:
                    self._do_next(kinds, worker)
                except Exception:  # from the store: a full disk may have space later
                    _LOG.exception("a worker of the page goes on in %g s", _IDLE_S)
                    with self._bell:
                        self._bell.wait_for(lambda: self._ended, _IDLE_S)

    def _do_next(self, kinds: tuple[str, ...], worker: ProcessWorker[Job, Answer]) -> None:
        if (job := self._next(kinds)) is None:
            return
        try:
            self._do(job, worker)
        except Exception:  # a failure here must not affect other threads
            said = traceback.format_exc(limit=-1).strip().splitlines()[-1]
            self._store.end(job, "failed", f"{said} This is a mistake of uavtwin.")
        finally:
            shutil.rmtree(self._store.incoming(job), ignore_errors=True)
        self._changed(job.flight)

    def _next(self, kinds: tuple[str, ...]) -> JobRow | None:
        """The next job, waiting for one; None: the scheduler is closed."""
        with self._bell:
            while not self._ended:
                if (job := self._store.take(kinds)) is not None:
                    return job
                self._bell.wait(_IDLE_S)
        return None

    def _do(self, job: JobRow, worker: ProcessWorker[Job, Answer]) -> None:
        flight = self._store.flight(job.flight)
        if flight is None:
            return
        content = self._content(job, flight)
        worker.start()
        with self._bell:
            self._running[job] = worker
        self._changed(job.flight)
        long_s = self._limits.allowed.time_s
        try:
            if not self._store.is_running(job):
                return
            answer = worker.do(
                content,
                lambda done: self._share(job, done),
                long_s if job.kind in LONG else QUICK_SHARE * long_s,
            )
        finally:
            with self._bell:
                self._running.pop(job, None)
                self.done.pop(job.run, None)
            if not self._store.is_running(job):
                worker.close()  # it was killed, perhaps between two jobs
        if not self._ended or "lost" not in answer:  # else the next server repeats it
            self._finish(job, flight, answer)
        if flight.bytes > LARGE_BYTES:
            worker.close()

    def _share(self, job: JobRow, done: float) -> None:
        self.done[job.run] = done
        self._changed(job.flight)

    def _content(self, job: JobRow, flight: FlightRow) -> dict[str, Any]:
        """Data for the process."""
        store = self._store
        content = {
            "kind": job.kind,
            "flight": flight.id,
            "name": flight.name,
            "log": str(store.log(flight)),
            "folder": str(store.results(flight.id)),
            "incoming": str(store.incoming(job)),
        }
        if job.kind in OF_VEHICLE:
            content["vehicle"] = str(store.vehicle_file(flight.vehicle or "") or flight.vehicle)
        if job.other and (other := store.flight(job.other)) is not None:
            content |= {"other": other.id, "other_name": other.name}
            content["other_folder"] = str(store.results(other.id))
        return content

    def _finish(self, job: JobRow, flight: FlightRow, answer: Answer) -> None:
        """Store the result of a run, unless it was cancelled or restarted."""
        store = self._store
        if not store.is_running(job):
            return
        for log in answer.get("logs", ()):
            new, _ = store.add(log["name"], Path(log["file"]), log["sha256"], log["bytes"])
            self._changed(new)
        with store.lock:  # so that it is not cancelled meanwhile
            if store.is_running(job):
                self._record(job, flight, answer)
        self._kill_ended()
        self.wake()

    def _record(self, job: JobRow, flight: FlightRow, answer: Answer) -> None:
        """Store the result of a running job, its end last: after a kill the job is repeated as a
        whole."""
        store = self._store
        if error := answer.get("error") or answer.get("lost"):
            if job.kind == "check":
                store.note(flight.id, verdict="unreadable", check_text=error)
            store.end(job, "failed", error)
            return
        vehicle = store.add_vehicle(Path(answer["vehicle"])) if "vehicle" in answer else ""
        if "logs" in answer or (vehicle and job.kind == "check"):
            store.delete(flight)  # it was no flight
            return
        store.note(flight.id, **answer.get("note", {}))
        for kind in answer.get("queue", ()):
            store.queue(flight.id, kind)
        if answer.get("chosen"):
            store.choose(flight.id, vehicle)
        if job.kind == "check":
            self._known_vehicle(flight.id)
        store.end(job, "done")

    def _known_vehicle(self, flight: str) -> None:
        """Set the vehicle that was chosen for another flight of the same aircraft."""
        found = self._store.flight(flight)
        if found is None or found.vehicle or not found.aircraft:
            return
        if vehicle := self._store.vehicle_of_aircraft(found.aircraft):
            self._store.choose(flight, vehicle)


def _lost(job: Job, why: str) -> Answer:
    """Answer for a job that ended its process."""
    return {"lost": f"{why}."}
