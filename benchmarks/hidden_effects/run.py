"""Let `twin.explain` read every case: `python -m benchmarks.hidden_effects.run DIR`.

What `twin.explain` says about one flight of an aircraft that was calibrated on normal ones.

This module alone knows how a calibration is asked for:

    calibrate(flights, vehicle).vehicle                      the aircraft with numbers and sd
    explain([flight], [], vehicle, since=True)               what differs from it

What comes back has the content of `explain.json`. Nothing here knows where the truth is.

    DIR/flights/ID/       what it is given
    DIR/results/ID.json   what it says, with the time it took

The truth lies elsewhere and is not read. Cases with a result are skipped, so a run that was cut
short goes on where it stopped; a case that fails is recorded as such.
"""

import argparse
import hashlib
import json
import os
import sys
import time
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Lock, Thread
from typing import TYPE_CHECKING, Any

import twin

from .files import VEHICLE, found_in, write_json

if TYPE_CHECKING:
    from twin.explain.explanation import Explanation
    from twin.explain.settings import SearchSettings

NORMAL, SINCE = "normal_*.parquet", "since_1.parquet"


def is_calibrated(folder: Path) -> bool:
    """Whether a case has normal flights and one after them."""
    return (folder / SINCE).is_file()


def ask_calibrated(folder: Path) -> dict[str, Any]:
    """Content of `explain.json` for the flight after the normal ones."""
    from twin.explain.calibration import calibrate
    from twin.explain.explanation import explain
    from twin.logs import read_flight
    from twin.vehicle_file import load_vehicle
    from uavtwin.explain_record import explain_record

    normal = [read_flight(f) for f in found_in(folder, NORMAL)]
    known = calibrate(normal, load_vehicle(str(folder / VEHICLE))).vehicle
    flight = read_flight(folder / SINCE)
    found = explain([flight], [], known, missions=(), since=True, suggest=False)
    return explain_record(found).json()


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
    from twin.explain.settings import DEFAULT
    from uavtwin.explain_record import explain_record

    wall, cpu = time.perf_counter(), time.process_time()
    if is_calibrated(folder):
        said = ask_calibrated(folder)
    else:
        said = explain_record(explained(folder, DEFAULT.with_values(changed or {}))).json()
    return {
        **said,
        "seconds": round(time.perf_counter() - wall, 2),
        "cpu_seconds": round(time.process_time() - cpu, 2),
    }


def explained(folder: Path, settings: "SearchSettings") -> "Explanation":
    """What is found in a case whose aircraft was not calibrated first."""
    from twin.explain.explanation import explain
    from twin.logs import read_flight
    from twin.vehicle_file import load_vehicle

    fit, away = ([read_flight(f) for f in found_in(folder, n)] for n in (FIT, HOLDOUT))
    vehicle = load_vehicle(str(folder / VEHICLE))
    return explain(fit, away, vehicle, missions=(), settings=settings, suggest=False)


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


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit code 1 when a case failed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("dir", type=Path, help="as written by generate")
    add_options(parser)
    options = parser.parse_args(arguments)
    return run(options.dir, options.results, options.jobs, again=options.again)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options that are the same where everything is done by one command."""
    parser.add_argument("--results", default="results", help="name of the folder in DIR")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument(
        "--again",
        choices=("errors", "changed", "all"),
        help="repeat cases that failed, those by another state of twin/, or all",
    )


def run(
    out: Path,
    results: str = "results",
    jobs: int = 1,
    ids: Collection[str] | None = None,
    again: str | None = None,
    worker: Callable[[], Worker] = Worker,
) -> int:
    """Explain the cases of a folder.

    Args:
        out: As written by generate.
        results: Name of the folder in it to write to.
        jobs: Cases at the same time, a process each.
        ids: Of the cases; default: all.
        again: Which cases with a result to repeat: errors, changed, all.
        worker: Makes a process.

    Returns:
        1 when a case failed.
    """
    there = {f.parent.name: f.parent for f in (out / "flights").glob(f"*/{VEHICLE}")}
    folders = {i: f for i, f in sorted(there.items()) if ids is None or i in ids}
    state = twin_state()
    files = {i: out / results / f"{i}.json" for i in folders}
    missing = [i for i, file in files.items() if not _is_done(file, again, state)]
    print(f"{len(folders)} cases, {len(folders) - len(missing)} there already", file=sys.stderr)
    ask(
        [Question(i, folders[i], files[i], {"case": i, "twin": state}) for i in missing],
        jobs,
        worker,
    )
    return 1 if any(_read(f).get("verdict") == "error" for f in files.values()) else 0


@dataclass(frozen=True)
class Question:
    """What a process is asked.

    Attributes:
        label: For people.
        query: What the worker is called with.
        file: Where the answer goes.
        extra: Written into it beside what is said.
    """

    label: str
    query: Any
    file: Path
    extra: Mapping[str, Any]


def ask(questions: Iterable[Question], jobs: int, worker: Callable[[], Worker] = Worker) -> None:
    """Have questions answered, each into its file as soon as it is, with a line on stderr.

    Args:
        questions: In the order in which they are taken.
        jobs: Processes.
        worker: Makes one.
    """
    queue: SimpleQueue[Question] = SimpleQueue()
    for question in questions:
        queue.put(question)
    progress = _Progress(queue.qsize())

    def serve() -> None:
        """Take questions until none is left."""
        explain = worker()
        try:
            while True:
                question = queue.get_nowait()
                said = {**question.extra, **explain(question.query)}
                write_json(question.file, said)
                progress.done(question.label, said)
        except Empty:
            return
        finally:
            explain.close()

    threads = [Thread(target=serve, daemon=True) for _ in range(min(jobs, queue.qsize()))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


class _Progress:
    """A line per case on stderr, with the time left."""

    def __init__(self, total: int) -> None:
        self._total, self._done, self._start = total, 0, time.perf_counter()
        self._lock = Lock()

    def done(self, label: str, said: Mapping[str, Any]) -> None:
        """One more."""
        with self._lock:
            self._done += 1
            spent = time.perf_counter() - self._start
            left = spent / self._done * (self._total - self._done)
            what = said.get("error") or f"{said['verdict']}, {said['seconds']:.0f} s"
            print(
                f"{self._done}/{self._total} {label} {what}; {_minutes(left)} left",
                file=sys.stderr,
                flush=True,
            )


def _minutes(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"


def _is_done(file: Path, again: str | None, state: str) -> bool:
    """Whether a result is there and need not be repeated."""
    if not file.is_file() or again == "all":
        return False
    if again is None:
        return True
    said = _read(file)
    return bool(said["verdict"] != "error" and (again == "errors" or said["twin"] == state))


def _read(file: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(file.read_text("utf-8")) if file.is_file() else {}
    return content


if __name__ == "__main__":
    raise SystemExit(main())
