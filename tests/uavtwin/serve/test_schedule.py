"""Runs of jobs that are cancelled, begun anew or fail while a worker does them."""

import asyncio
import json
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import pytest
from starlette.types import Message

from uavtwin.jobs.process import ProcessWorker
from uavtwin.serve.schedule import Limits, Scheduler
from uavtwin.serve.server import Site
from uavtwin.serve.store import Store
from uavtwin.serve.work import QUICK, Answer, Job
from uavtwin.site.doors import AccessPolicy

pytestmark = pytest.mark.slow


class Worker:
    """Answers in this thread."""

    def __init__(self, answer: Callable[[dict[str, Any]], Answer]) -> None:
        self._answer, self.killed, self.closed = answer, 0, 0

    def start(self) -> None:
        """There is no process."""

    def do(self, job: dict[str, Any], *_: object) -> Answer:
        return {} if job["kind"] == "warm" else self._answer(job)

    def kill(self) -> None:
        self.killed += 1

    def close(self) -> None:
        self.closed += 1

    @property
    def as_process(self) -> ProcessWorker[Job, Answer]:
        return cast(ProcessWorker[Job, Answer], self)


def added(store: Store, content: bytes = b"log", name: str = "a.ulg") -> str:
    with store.upload(1000) as coming:
        coming.write(content)
        return store.add(name, coming.path, coming.sha256, coming.size)[0]


def opened(folder: Path) -> tuple[Store, Scheduler]:
    """Without threads."""
    store = Store(folder)
    return store, Scheduler(store, Limits(workers=0), lambda _: None)


def done_next(scheduler: Scheduler, worker: Worker, *kinds: str) -> None:
    scheduler._do_next(kinds or QUICK, worker.as_process)


@pytest.mark.parametrize("fails", [False, True])
def test_a_run_with_the_former_vehicle_says_nothing_of_the_one_with_the_next(
    tmp_path: Path, fails: bool
) -> None:
    store, scheduler = opened(tmp_path)
    flight = added(store)
    store.choose(flight, "first")

    def answer(_: dict[str, Any]) -> Answer:
        scheduler.choose(flight, "second")
        if fails:
            raise ValueError("killed")
        return {"note": {"gap_text": "a gap of the first"}}

    done_next(scheduler, worker := Worker(answer), "gap")
    row, job = store.flight(flight), store.job(flight, "gap")
    assert row is not None and (row.vehicle, row.gap_text) == ("second", None)
    assert job is not None and (job.state, job.text) == ("queued", None)
    assert worker.killed == 1 and worker.closed == 1
    done_next(scheduler, Worker(lambda _: {"note": {"gap_text": "of the second"}}), "gap")
    row = store.flight(flight)
    assert row is not None and row.gap_text == "of the second"


def test_an_error_of_a_cancelled_check_is_no_verdict(tmp_path: Path) -> None:
    store, scheduler = opened(tmp_path)
    flight = added(store)

    def answer(_: dict[str, Any]) -> Answer:
        assert scheduler.cancel(flight, "check") and store.queue(flight, "check")
        return {"lost": "its process ended."}

    done_next(scheduler, Worker(answer))
    row, job = store.flight(flight), store.job(flight, "check")
    assert row is not None and row.verdict is None and job is not None and job.state == "queued"


def test_a_kill_while_a_vehicle_is_stored_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, scheduler = opened(tmp_path)
    flight = added(store, b"vehicle", "mine.toml")

    def killed(_: object) -> None:
        raise KeyboardInterrupt

    worker = Worker(lambda job: {"vehicle": job["log"]})
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(store, "delete", killed)
        done_next(scheduler, worker)
    row = store.flight(flight)
    assert row is not None and store.log(row).read_bytes() == b"vehicle"
    store.close()
    store, scheduler = opened(tmp_path)
    done_next(scheduler, worker)
    assert store.vehicles() == ["mine"] and store.flight(flight) is None


def test_a_dropped_vehicle_file_that_was_cancelled_is_none(tmp_path: Path) -> None:
    store, scheduler = opened(tmp_path)
    flight = added(store, b"vehicle", "mine.toml")

    def answer(job: dict[str, Any]) -> Answer:
        scheduler.cancel(flight, "check")
        return {"vehicle": job["log"]}

    done_next(scheduler, Worker(answer))
    assert store.vehicles() == [] and store.flight(flight) is not None


@pytest.mark.parametrize("end", ["error", "lost", "raises", "logs"])
def test_nothing_that_a_run_unpacked_is_left(tmp_path: Path, end: str) -> None:
    store, scheduler = opened(tmp_path)
    archive = added(store, b"archive", "day.zip")

    def answer(job: dict[str, Any]) -> Answer:
        folder = Path(job["incoming"])
        folder.mkdir()
        (folder / "0").write_bytes(b"log")
        (folder / "1").write_bytes(b"half")
        if end == "raises":
            raise ValueError
        log = {"name": "a.ulg", "file": str(folder / "0"), "sha256": "f" * 64, "bytes": 3}
        return {end: [log] if end == "logs" else "it ended"}

    done_next(scheduler, Worker(answer))
    assert not list((tmp_path / "incoming").iterdir())
    assert (store.flight(archive) is None) == (end == "logs")


def test_a_failure_of_the_store_ends_no_worker(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uavtwin.serve.schedule._IDLE_S", 0.01)
    store, scheduler = opened(tmp_path)
    flight = added(store)
    failures = iter([OSError("full"), OSError("full")])
    take = store.take

    def failing(kinds: tuple[str, ...]) -> object:
        if (error := next(failures, None)) is not None:
            raise error
        return take(kinds)

    monkeypatch.setattr(store, "take", failing)
    scheduler._workers = [Worker(lambda _: {}).as_process]
    thread = threading.Thread(target=scheduler._work, args=(0,), daemon=True)
    thread.start()
    deadline = time.monotonic() + 120
    while (job := store.job(flight, "check")) is None or job.state != "done":
        assert thread.is_alive() and time.monotonic() < deadline
        time.sleep(0.01)
    scheduler.close()
    thread.join(120)
    assert not thread.is_alive()


def post(site: Site, path: str, body: bytes) -> int:
    """Status of a form."""
    sent: list[Message] = []

    async def send(message: Message) -> None:
        sent.append(message)

    async def receive() -> Message:
        return {"type": "http.request", "body": body, "more_body": False}

    scope = {"type": "http", "method": "POST", "path": path, "query_string": b""}
    scope |= {"headers": [(b"host", b"127.0.0.1")]}

    async def answered() -> None:
        await site.app(scope, receive, send)

    asyncio.run(answered())
    return int(sent[0]["status"])


def test_a_moment_says_its_kind_once(tmp_path: Path) -> None:
    store = Store(tmp_path)
    site = Site(store, Limits(workers=0), AccessPolicy("127.0.0.1"))
    flight = store.flight(added(store))
    assert flight is not None
    mode = {"kind": "mode", "t_s": 9.82, "text": "mode Hold"}
    (store.results(flight.id) / "why.json").write_text(json.dumps({"timeline": [mode]}))
    (part, _) = site._pages.parts(flight).values()
    assert "mode</td>" in part and ">Hold</td>" in part and "mode Hold" not in part


def test_new_values_of_a_draft_begin_it_anew(tmp_path: Path) -> None:
    store = Store(tmp_path)
    site = Site(store, Limits(workers=0), AccessPolicy("127.0.0.1"))
    flight = added(store)
    assert post(site, f"/flights/{flight}/draft", b"mass_kg=1.3") == 303
    first = store.take(["draft"])
    assert first is not None and store.is_running(first)
    assert post(site, f"/flights/{flight}/draft", b"mass_kg=1.4&frame=hex+x") == 303
    assert not store.is_running(first)
    second = store.take(["draft"])
    assert second is not None and second.run != first.run
    known = (store.results(flight) / "draft.json").read_text()
    assert "1.4" in known and '"hex x"' in known
