"""What a sweep has done so far: a line per run, so that it goes on from there after a kill."""

import json
import os
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

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
            TwinError: It is of another sweep, or not ours.
        """
        self._path = path
        self.done: set[int] = set()
        if path.exists():
            end = self._look(sweep)
            os.truncate(path, end)  # a kill in the middle of a line
        if not path.exists() or not path.stat().st_size:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps({"sweep": sweep}) + "\n", "utf-8")
        self._file = path.open("a", encoding="utf-8")

    def _look(self, sweep: str) -> int:
        """Take the runs that are done; bytes of whole lines."""
        end = 0
        with self._path.open("rb") as file:
            for number, line in enumerate(file):
                if not line.endswith(b"\n"):
                    break
                try:
                    content = json.loads(line)
                    found = content["sweep"] if number == 0 else int(content["run"])
                except (ValueError, KeyError, TypeError) as error:
                    raise TwinError(
                        f"{self._path}: line {number + 1} is not of a sweep. Choose another --out, "
                        f"or delete the file to begin anew."
                    ) from error
                if number:
                    self.done.add(found)
                elif found != sweep:
                    raise TwinError(
                        f"{self._path}: is of another sweep, which was not finished (other "
                        f"scenario, design, seed, files or version). Choose another --out, or "
                        f"delete the file to begin anew."
                    )
                end += len(line)
        return end

    def add(self, outcome: Outcome) -> None:
        """Write a run down; a kill after this does not lose it."""
        self._file.write(json.dumps(outcome.json(), allow_nan=False) + "\n")
        self._file.flush()

    def outcomes(self) -> Iterator[Outcome]:
        """All that is written, in the order in which it was."""
        with self._path.open(encoding="utf-8") as file:
            next(file)
            for line in file:
                yield Outcome(**json.loads(line))

    def remove(self) -> None:
        """Close and delete it: the results are in their place."""
        self._file.close()
        self._path.unlink()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()
