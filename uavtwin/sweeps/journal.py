"""What a sweep has done so far: a line per run, so that it goes on from there after a kill."""

import fcntl
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from twin.errors import TwinError

from .outcome import Outcome

JOURNAL = "sweep.jsonl"


class Journal:
    """A file in the folder of the results, gone when they are there.

    Attributes:
        done: Runs that were in it when it was opened.
    """

    def __init__(self, path: Path, sweep: str) -> None:
        """Open it, or begin one.

        Args:
            path: Of the file.
            sweep: Hash of all that decides the outcomes.

        Raises:
            TwinError: It is of another sweep, not ours, or another process writes it.
        """
        self._path = path
        self.done: set[int] = set()
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("a+b")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.truncate(path, self._look(sweep))  # a kill in the middle of a line
        except BlockingIOError as error:
            self._file.close()
            raise TwinError(
                f"{path}: another sweep is writing it. Wait for it, or choose another --out."
            ) from error
        except BaseException:
            self._file.close()
            raise
        if not path.stat().st_size:
            self._write({"sweep": sweep})

    def _look(self, sweep: str) -> int:
        """Take the runs that are done; bytes of whole lines."""
        end = 0
        self._file.seek(0)
        for number, line in enumerate(self._file):
            if not line.endswith(b"\n"):
                break
            try:
                content = json.loads(line)
                found = content["sweep"] if number == 0 else Outcome(**content).run
            except (ValueError, KeyError, TypeError) as error:
                raise TwinError(
                    f"{self._path}: line {number + 1} is not of a sweep. Choose another --out, or "
                    f"delete the file to begin anew."
                ) from error
            if number:
                self.done.add(found)
            elif found != sweep:
                raise TwinError(
                    f"{self._path}: is of another sweep, which was not finished (other scenario, "
                    f"design, seed, files or version). Choose another --out, or delete the file to "
                    f"begin anew."
                )
            end += len(line)
        return end

    def add(self, outcome: Outcome) -> None:
        """Write a run down; a kill after this does not lose it."""
        self._write(outcome.json())

    def _write(self, content: Mapping[str, Any]) -> None:
        self._file.write(json.dumps(content, allow_nan=False).encode() + b"\n")
        self._file.flush()

    def outcomes(self) -> Iterator[Outcome]:
        """All that is written, in the order in which it was."""
        with self._path.open(encoding="utf-8") as file:
            next(file)
            for line in file:
                yield Outcome(**json.loads(line))

    def remove(self) -> None:
        """Delete it: the results are in their place."""
        self._path.unlink()

    def close(self) -> None:
        """Another may go on with it."""
        self._file.close()
