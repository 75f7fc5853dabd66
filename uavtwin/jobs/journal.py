"""What has been done so far: a line per job, so that it goes on from there after a kill."""

import fcntl
import json
import os
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Generic, TypeVar

from twin.errors import TwinError

N = TypeVar("N")
Content = Mapping[str, Any]


class Journal(ABC, Generic[N]):
    """A file in the folder of the results, gone when they are there.

    A class below says what its lines are: `kind` names the whole, and `named` takes the name of a
    job from its line.

    Attributes:
        done: Names of the jobs that were in it when it was opened.
    """

    kind = "job"
    """Of what it is the journal, in a word."""
    differs = "other files, options or version"
    """What may be other in a journal of another run."""

    def __init__(self, path: Path, key: str) -> None:
        """Open it, or begin one.

        Args:
            path: Of the file.
            key: Hash of all that decides what comes of the jobs.

        Raises:
            TwinError: It is of another run, not ours, or another process writes it.
        """
        self._path = path
        self.done: set[N] = set()
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("a+b")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.truncate(path, self._look(key))  # a kill in the middle of a line
        except BlockingIOError as error:
            self._file.close()
            raise TwinError(
                f"{path}: another {self.kind} is writing it. Wait for it, or choose another --out."
            ) from error
        except BaseException:
            self._file.close()
            raise
        if not path.stat().st_size:
            self.write({self.kind: key})

    @abstractmethod
    def named(self, content: Content) -> N:
        """Name of the job of a line.

        Raises:
            ValueError, KeyError, TypeError: It is of no job.
        """

    def _look(self, key: str) -> int:
        """Take the jobs that are done; bytes of whole lines."""
        end = 0
        self._file.seek(0)
        for number, line in enumerate(self._file):
            if not line.endswith(b"\n"):
                break
            try:
                content = json.loads(line)
                if number:
                    self.done.add(self.named(content))
                elif content[self.kind] != key:
                    raise TwinError(
                        f"{self._path}: is of another {self.kind}, which was not finished "
                        f"({self.differs}). Choose another --out, or delete the file to begin "
                        f"again."
                    )
            except (ValueError, KeyError, TypeError) as error:
                raise self.foreign(number + 1) from error
            end += len(line)
        return end

    def foreign(self, line: int) -> TwinError:
        """A line of something else."""
        return TwinError(
            f"{self._path}: line {line} is not of a {self.kind}. Choose another --out, or delete "
            f"the file to begin again."
        )

    def write(self, content: Content) -> None:
        """Write a job down; a kill after this does not lose it."""
        self._file.write(json.dumps(content, allow_nan=False).encode() + b"\n")
        self._file.flush()

    def contents(self) -> Iterator[tuple[int, dict[str, Any]]]:
        """All lines of jobs, in the order in which they were written, and where each begins."""
        with self._path.open("rb") as file:
            place = len(next(file))
            for line in file:
                yield place, json.loads(line)
                place += len(line)

    def close(self) -> None:
        """Another may go on with it."""
        self._file.close()
