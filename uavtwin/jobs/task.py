"""What is done with each job, as the engines know it."""

from pathlib import Path
from typing import Protocol, TypeVar

J = TypeVar("J")
D = TypeVar("D")
J_contra = TypeVar("J_contra", contravariant=True)
D_co = TypeVar("D_co", covariant=True)


class Worker(Protocol[J_contra, D_co]):
    """Does one job after another, in one thread."""

    def do(self, job: J_contra, /) -> D_co:
        """What comes of a job; whatever happens in it, there is something."""

    def close(self) -> None:
        """End what it has started."""


class Task(Protocol[J, D]):
    """The same for all jobs."""

    @property
    def key(self) -> str:
        """Hash of all that decides what comes of the jobs."""

    def name(self, job: J, /) -> str:
        """By which a job is told from others."""

    def worker(self) -> Worker[J, D]:
        """One more that does jobs."""

    def packed(self) -> "Packed[J, D]":
        """As it travels to another machine."""

    def lost(self, job: J, why: str, /) -> D:
        """What comes of a job whose workers were lost."""


class Packed(Protocol[J, D]):
    """A task that is pickled."""

    @property
    def key(self) -> str:
        """Of the task."""

    def unpacked(self, folder: Path, /) -> Task[J, D]:
        """The task, its files written into a folder."""
