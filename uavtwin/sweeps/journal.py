"""What a sweep has done so far: a line per run."""

from collections.abc import Iterator

from ..jobs import journal
from .outcome import Outcome

JOURNAL = "sweep.jsonl"


class Journal(journal.Journal[int]):
    """Of the runs of a sweep, by their numbers."""

    kind = "sweep"
    differs = "other scenario, design, seed, files or version"

    def named(self, content: journal.Content) -> int:
        """Number of the run."""
        return Outcome(**content).run

    def add(self, outcome: Outcome) -> None:
        """Write a run down."""
        self.write(outcome.json())

    def outcomes(self) -> Iterator[Outcome]:
        """All that is written, in the order in which it was."""
        return (Outcome(**content) for _, content in self.contents())
