"""Let `twin.explain` look at every case: `python -m benchmarks.hidden_effects.run DIR`.

    DIR/flights/ID/       what it is given
    DIR/results/ID.json   what it says, with the time it took

The truth lies elsewhere and is not read. Cases with a result are skipped, so a run that was cut
short goes on where it stopped; a case that fails is recorded as such.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Lock, Thread
from typing import Any

from .explaining import Worker, twin_state
from .files import VEHICLE, write_json


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
