"""Jobs in processes of their own: what one does to its process costs that one alone."""

import contextlib
import os
import threading
import time

import pytest
from job_rigs.harm import Harm

from twin.errors import TwinError
from uavtwin.jobs.engine import Workers
from uavtwin.jobs.process import JobLimits, ProcessWorker

pytestmark = pytest.mark.slow
JOBS = ["fine 1", "crash", "fine 2", "exit", "hang", "hoard", "number", "fine 3", "fine 4"]


@pytest.mark.parametrize("workers", [1, 3])
def test_every_job_is_done_once_whatever_others_do(workers: int) -> None:
    harm = Harm(allowed=JobLimits(time_s=8.0, memory_gib=1.0))
    with Workers("local", workers).opened() as engine:
        found = sorted(engine.run(harm, JOBS))
    told = {line.partition(":")[0]: line.partition(": ")[2] for line in found}
    assert sorted(told) == sorted(JOBS)
    assert all(told[f"fine {k}"].isdigit() for k in range(1, 5))
    assert told["crash"].startswith("lost, its process ended with signal SIGSEGV")
    assert told["exit"].startswith("lost, its process ended with exit code 3")
    assert told["hang"] == "lost, took longer than 8 s, the limit (--time-limit)"
    assert told["hoard"].startswith("lost, its process ended with exit code 1")
    assert "1 GiB of memory" in told["hoard"]
    assert told["number"].startswith("lost, its process ended with exit code 1")


def test_a_process_is_kept_from_job_to_job_and_ends_with_its_worker() -> None:
    harm = Harm()
    worker: ProcessWorker[str, str] = harm.worker()
    first, second = worker.do("fine a"), worker.do("fine b")
    pid = int(first.partition(": ")[2])
    assert second == f"fine b: {pid}"
    assert pid != os.getpid()
    worker.close()
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    raise AssertionError("the process is still there")


def test_a_job_says_how_much_of_it_is_done() -> None:
    with contextlib.closing(Harm().worker()) as worker:
        shares: list[float] = []
        assert worker.do("count", shares.append).startswith("count: ")
        assert shares == [0.0, 0.2, 0.4, 0.6, 0.8]


def test_a_job_can_be_killed_from_another_thread_and_has_a_time_limit_of_its_own() -> None:
    with contextlib.closing(Harm().worker()) as worker:
        worker.start()
        threading.Timer(0.5, worker.kill).start()
        assert worker.do("hang").startswith("hang: lost, its process ended with signal SIGKILL")
        assert worker.do("fine").partition(": ")[2].isdigit()
        assert worker.do("hang", time_s=0.5) == (
            "hang: lost, took longer than 0.5 s, the limit (--time-limit)"
        )


@pytest.mark.parametrize(
    ("name", "workers", "scheduler", "says"),
    [
        ("dask", None, None, "give --scheduler"),
        ("local", None, "tcp://127.0.0.1:1", "goes with --engine dask"),
        ("local", 0, None, "needs a whole number, 1 to 1024"),
    ],
)
def test_what_an_engine_has_no_use_for_is_refused(
    name: str, workers: int | None, scheduler: str | None, says: str
) -> None:
    with (
        pytest.raises(TwinError, match=says),
        Workers(name, workers, scheduler).opened(),  # type: ignore[arg-type]
    ):
        pass


def test_a_limit_that_is_none_is_refused() -> None:
    with pytest.raises(TwinError, match="limit time_s = -1: needs a positive number"):
        JobLimits(time_s=-1.0)
