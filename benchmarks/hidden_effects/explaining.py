"""What `twin.explain` says about the folder of one case. Nothing here knows where the truth is."""

import hashlib
import os
import time
from collections.abc import Callable, Mapping
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import twin

from .calibrated import ask_calibrated, is_calibrated
from .files import VEHICLE, found_in

FIT, HOLDOUT = "fit_*.parquet", "holdout_*.parquet"
LONGEST_S = 900.0
"""After this a case counts as failed."""
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def twin_state() -> str:
    """Hash of the sources of `twin`: results of different states are not to be mixed."""
    digest = hashlib.sha256()
    root = Path(next(iter(twin.__path__)))
    for file in sorted(root.rglob("*.py")):
        digest.update(str(file.relative_to(root)).encode() + file.read_bytes())
    return digest.hexdigest()[:12]


def explain_case(folder: Path, changed: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Content of `explain.json` and the time it took, without missions of the new model and without
    a search for what to fly next.

    Args:
        folder: Of the case.
        changed: Settings of the search that are not to be the default ones, by name.
    """
    from twin.explain.explanation import explain
    from twin.explain.settings import DEFAULT
    from twin.logs import read_flight
    from twin.vehicle.file import load_vehicle
    from uavtwin.explain_record import explain_record

    wall, cpu = time.perf_counter(), time.process_time()
    if is_calibrated(folder):
        said = ask_calibrated(folder)
    else:
        fit, away = ([read_flight(f) for f in found_in(folder, n)] for n in (FIT, HOLDOUT))
        settings = DEFAULT.with_values(changed or {})
        vehicle = load_vehicle(str(folder / VEHICLE))
        said = explain_record(
            explain(fit, away, vehicle, missions=(), settings=settings, suggest=False)
        ).json()
    return {
        **said,
        "seconds": round(time.perf_counter() - wall, 2),
        "cpu_seconds": round(time.process_time() - cpu, 2),
    }


def answer(
    folder: Path, explain: Callable[[Path], dict[str, Any]] = explain_case
) -> dict[str, Any]:
    """The same; an exception becomes the verdict "error"."""
    try:
        return explain(folder)
    except Exception as error:
        return failure(f"{type(error).__name__}: {error}")


def failure(problem: str) -> dict[str, Any]:
    """Result of a case that gave none."""
    return {"verdict": "error", "error": problem, "effects": []}


class Worker:
    """A process that explains one case after the other; a case that kills it costs no other.

    Args:
        answer: Called there with what is asked: the folder of a case, if nothing else is said.
        longest_s: Time for a case.
    """

    def __init__(
        self, answer: Callable[[Any], dict[str, Any]] = answer, longest_s: float = LONGEST_S
    ) -> None:
        self._answer, self._longest_s = answer, longest_s
        self._connection: Connection | None = None

    def __call__(self, query: Any) -> dict[str, Any]:
        """Result of a case."""
        try:
            connection = self._connection or self._start()
            connection.send(query)
            if connection.poll(self._longest_s):
                result: dict[str, Any] = connection.recv()
                return result
            problem = f"took more than {self._longest_s:.0f} s"
        except (EOFError, OSError):
            self._process.join()
            problem = f"the process ended with exit code {self._process.exitcode}"
        self.close()
        return failure(problem)

    def close(self) -> None:
        """End the process."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None
            self._process.kill()
            self._process.join()

    def _start(self) -> Connection:
        for name in _ONE_THREAD:  # a process per core; sums come out the same on every machine
            os.environ[name] = "1"
        context = get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, self._answer), daemon=True)
        self._process.start()
        theirs.close()
        self._connection.recv()  # it is ready: starting costs no case its time
        return self._connection


def _serve(connection: Connection, answer: Callable[[Any], dict[str, Any]]) -> None:
    """Answer until nobody asks any more."""
    connection.send("ready")
    try:
        while True:
            connection.send(answer(connection.recv()))
    except (EOFError, OSError, KeyboardInterrupt):
        return
