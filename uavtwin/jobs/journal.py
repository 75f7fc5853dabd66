"""Journal of completed jobs, one line each, for resuming after a kill."""

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
    """A file in the folder of the results, deleted when they are complete.

    A subclass defines the lines: `kind` names the whole, and `named` returns the name of a job from
    its line.

    Attributes:
        done: Names of the jobs that were in it when it was opened.
    """

    kind = "job"
    """Name of the whole, one word."""
    differs = "other files, options or version"
    """Text on possible differences to the journal of another run."""

    def __init__(self, path: Path, key: str) -> None:
        """Open or create it.

        Args:
            path: Path of the file.
            key: Hash of all inputs of the results.

        Raises:
            TwinError: It belongs to another run or program, or another process writes it.
        """
        self._path = path
        self.done: set[N] = set()
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("a+b")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.truncate(path, self._look(key))  # after a kill within a line
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
            ValueError, KeyError, TypeError: The line is not that of a job.
        """

    def _look(self, key: str) -> int:
        """Read the completed jobs; returns the number of bytes in complete lines."""
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
        """Error for a line of another kind."""
        return TwinError(
            f"{self._path}: line {line} is not of a {self.kind}. Choose another --out, or delete "
            f"the file to begin again."
        )

    def write(self, content: Content) -> None:
        """Append a job; it is then preserved after a kill."""
        self._file.write(json.dumps(content, allow_nan=False).encode() + b"\n")
        self._file.flush()

    def contents(self) -> Iterator[tuple[int, dict[str, Any]]]:
        """All lines of jobs, in the order of writing, with the offset of each."""
        with self._path.open("rb") as file:
            place = len(next(file))
            for line in file:
                yield place, json.loads(line)
                place += len(line)

    def close(self) -> None:
        """Close, so that another process may continue."""
        self._file.close()
