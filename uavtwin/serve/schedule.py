"""Jobs from the table to worker processes and back: who does what, how far it is, its end."""

import contextlib
import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..jobs.process import Allowed, ProcessWorker
from .store import OF_VEHICLE, FlightRow, JobRow, Store, safe_name
from .work import LONG, QUICK, Answer, Job, LogWork

Key = tuple[str, str, str]
"""Of a job: flight, kind, the other flight."""
QUICK_SHARE = 1 / 3
"""Of the time limit, for a job that is not long: a hostile log holds a worker no longer. `why` of
40 min of flight took 3 min on a core that it shared."""
LARGE_BYTES = 30_000_000
"""Of a log after which a worker process is replaced: what it took of the memory goes back."""
_IDLE_S = 5.0
"""After which a thread looks for work without being woken."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What a log, and a job, may use.

    Attributes:
        allowed: Time of a long job, memory of any.
        most_bytes: Of a log.
        workers: Processes.
    """

    allowed: Allowed = field(default_factory=lambda: Allowed(1800.0, 3.0))
    most_bytes: int = 1 << 30
    workers: int = 2


class Scheduler:
    """Threads that take jobs from the store, each with a process that does them.

    Attributes:
        done: Share done of each job that is running, 0..1.
    """

    def __init__(self, store: Store, limits: Limits, changed: Callable[[str], None]) -> None:
        """Start nothing yet.

        Args:
            store: With the jobs.
            limits: What they may use.
            changed: Called with the flight of which something is new, from any thread.
        """
        self._store, self._limits, self._changed = store, limits, changed
        self._bell = threading.Condition()
        self._ended = False
        self._workers = [
            ProcessWorker[Job, Answer](LogWork(limits.most_bytes), dict, _lost, limits.allowed)
            for _ in range(limits.workers)
        ]
        self._running: dict[Key, ProcessWorker[Job, Answer]] = {}
        self.done: dict[Key, float] = {}
        self._threads = [
            threading.Thread(target=self._work, args=(k,), name=f"worker {k}", daemon=True)
            for k in range(limits.workers)
        ]

    def start(self) -> None:
        """Begin with what waits."""
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """End all processes; what they did is done again by the next server."""
        with self._bell:
            self._ended = True
            self._bell.notify_all()
        for worker in self._workers:
            worker.kill()
        for thread in self._threads:
            thread.join(5.0)

    def wake(self) -> None:
        """There is something new in the store."""
        with self._bell:
            self._bell.notify_all()

    def cancel(self, flight: str, kind: str, other: str = "") -> bool:
        """End a job, or take it out of the queue; whether it was open."""
        job = self._store.job(flight, kind, other)
        if job is None or not self._store.end(job, "cancelled"):
            return False
        with self._bell:
            if worker := self._running.get((flight, kind, other)):
                worker.kill()
        self._changed(flight)
        return True

    def choose(self, flight: str, vehicle: str) -> None:
        """Compare a flight with a vehicle; what is being done with the former one ends."""
        for kind in OF_VEHICLE:
            self.cancel(flight, kind)
        self._store.choose(flight, vehicle)
        self.wake()

    # -- in the thread of a worker --------------------------------------------------------------

    def _work(self, number: int) -> None:
        kinds = QUICK if number == 0 and self._limits.workers > 1 else (*QUICK, *LONG)
        with contextlib.closing(self._workers[number]) as worker:
            worker.do({"kind": "warm"})
            while (job := self._next(kinds)) is not None:
                try:
                    self._do(job, worker)
                except Exception:  # one that fails here takes none of the others along
                    said = traceback.format_exc(limit=-1).strip().splitlines()[-1]
                    self._store.end(job, "failed", f"{said} This is a mistake of uavtwin.")
                self._changed(job.flight)

    def _next(self, kinds: tuple[str, ...]) -> JobRow | None:
        """The next job, waited for; None: it is over."""
        with self._bell:
            while not self._ended:
                if (job := self._store.take(kinds)) is not None:
                    return job
                self._bell.wait(_IDLE_S)
        return None

    def _do(self, job: JobRow, worker: ProcessWorker[Job, Answer]) -> None:
        key = (job.flight, job.kind, job.other)
        flight = self._store.flight(job.flight)
        if flight is None:
            return
        content = self._content(job, flight)
        worker.start()
        with self._bell:
            self._running[key] = worker
        self._changed(job.flight)
        long_s = self._limits.allowed.time_s
        try:
            if (now := self._store.job(*key)) is None or now.state != "running":
                return
            answer = worker.do(
                content,
                lambda done: self._share(key, done),
                long_s if job.kind in LONG else QUICK_SHARE * long_s,
            )
        finally:
            with self._bell:
                self._running.pop(key, None)
                self.done.pop(key, None)
        if not self._ended or "lost" not in answer:  # else the next server does it again
            self._finish(job, flight, answer)
        if flight.bytes > LARGE_BYTES:
            worker.close()

    def _share(self, key: Key, done: float) -> None:
        self.done[key] = done
        self._changed(key[0])

    def _content(self, job: JobRow, flight: FlightRow) -> dict[str, Any]:
        """What the process has to know."""
        store = self._store
        content = {
            "kind": job.kind,
            "flight": flight.id,
            "name": flight.name,
            "log": str(store.log(flight)),
            "folder": str(store.results(flight.id)),
            "incoming": str(store.folder / "incoming"),
        }
        if job.kind in OF_VEHICLE:
            content["vehicle"] = str(store.vehicle_file(flight.vehicle or "") or flight.vehicle)
        if job.other and (other := store.flight(job.other)) is not None:
            content |= {"other": other.id, "other_name": other.name}
            content["other_folder"] = str(store.results(other.id))
        return content

    def _finish(self, job: JobRow, flight: FlightRow, answer: Answer) -> None:
        """Write down what came of a job."""
        store = self._store
        if error := answer.get("error") or answer.get("lost"):
            if store.end(job, "failed", error) and job.kind == "check":
                store.note(flight.id, verdict="unreadable", check_text=error)
            return
        if "logs" in answer:
            for log in answer["logs"]:
                file = Path(log["file"])
                new, _ = store.add(log["name"], file, log["sha256"], log["bytes"])
                file.unlink(missing_ok=True)  # the same log was there
                self._changed(new)
            store.delete(flight)
            self.wake()
            return
        if "vehicle" in answer:
            source = Path(answer["vehicle"])
            source.replace(store.folder / "vehicles" / safe_name(source.name))
            if job.kind == "check":  # it was no flight
                store.delete(flight)
                return
        now = store.job(job.flight, job.kind, job.other)
        if now is None or now.state != "running":
            return  # it was cancelled meanwhile
        store.note(flight.id, **answer.get("note", {}))
        for kind in answer.get("queue", ()):
            store.queue(flight.id, kind)
        if "chosen" in answer:
            self.choose(flight.id, answer["chosen"])
        if job.kind == "check":
            self._known_vehicle(flight.id)
        store.end(job, "done")  # last: a kill before it has all of this done again
        self.wake()

    def _known_vehicle(self, flight: str) -> None:
        """Compare a flight with the vehicle that was chosen for another of the same aircraft."""
        found = self._store.flight(flight)
        if found is None or found.vehicle or not found.aircraft:
            return
        if vehicle := self._store.vehicle_of_aircraft(found.aircraft):
            self._store.choose(flight, vehicle)


def _lost(job: Job, why: str) -> Answer:
    """Of a job that ended its process."""
    return {"lost": f"{why}."}
