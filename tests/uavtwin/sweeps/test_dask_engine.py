"""The same sweep on a Dask cluster of separate processes, one of which is killed meanwhile."""

import os
import signal
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from distributed import Client
from job_rigs.clusters import local_cluster

import uavtwin as ut
from twin.errors import TwinError
from uavtwin.sweeps.outcome import JOURNAL

pytestmark = pytest.mark.slow
VARY = {"airframe.mass": {"low": 1.2, "high": 1.7}, "gusts": [True, False]}


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with local_cluster() as found:
        yield found


def swept(out: Path, **engine: str) -> None:
    ut.sweep("tour", out=out, vary=VARY, runs=24, duration=4.0, **engine)  # type: ignore[arg-type]


@pytest.mark.filterwarnings("ignore")
def test_a_cluster_gives_the_same_bytes_though_a_worker_is_killed(
    address: str, tmp_path: Path
) -> None:
    swept(tmp_path / "here")
    killed: list[int] = []
    over = threading.Event()

    def kill() -> None:
        """One worker, when a quarter of the runs is done."""
        journal = tmp_path / "there" / JOURNAL
        while not (journal.exists() and journal.read_bytes().count(b"\n") > 6):
            if over.wait(0.02):
                return
        with Client(address, set_as_default=False) as client:
            pids = client.run(os.getpid)
        killed.append(next(iter(pids.values())))
        os.kill(killed[0], signal.SIGKILL)

    murderer = threading.Thread(target=kill)
    murderer.start()
    try:
        swept(tmp_path / "there", engine="dask", scheduler=address)
    finally:
        over.set()
        murderer.join()
    assert killed
    for name in ("runs.parquet", "sweep.json", "report.html"):
        assert (tmp_path / "there" / name).read_bytes() == (tmp_path / "here" / name).read_bytes()


def test_a_scheduler_that_does_not_answer_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uavtwin.jobs.engine.CONNECT_S", 1.0)
    with pytest.raises(TwinError, match="give --scheduler"):
        swept(tmp_path / "a", engine="dask")
    with pytest.raises(TwinError, match="no scheduler answers"):
        swept(tmp_path / "b", engine="dask", scheduler="tcp://127.0.0.1:1")
