"""Output of the command line: results on stdout, progress and warnings on stderr."""

import os
import signal
import sys
import tempfile
import time
import traceback
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import platformdirs
from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskProgressColumn,
    TextColumn,
)
from rich.table import Column, Table
from rich.text import Text

from twin.errors import TwinError

from ..output import json_text
from .options import Exit

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from twin.logs import AnyFlight

    from ..display import TextTable
    from ..exports.write import WrittenFile
    from ..output import OptionalSteps
    from ..record import Record


class _Terminal(Console):
    """Console that escapes terminal control and half characters: names come from files."""

    def render_str(self, text: str, **options: Any) -> Text:
        """Text with its styles."""
        return super().render_str(_visible(text), **options)


WIDTH = None if sys.stdout.isatty() or "COLUMNS" in os.environ else 160
"""Default number of characters in a line of a table."""
STDOUT = _Terminal(highlight=False, markup=False, soft_wrap=True, width=WIDTH)  # for results
STDERR = _Terminal(stderr=True, highlight=False, markup=False, soft_wrap=True)
"""Consoles for results, and for progress and warnings."""


EVERY_S = 10.0
"""Interval between two lines of progress where stderr is no terminal."""


FORETOLD, STEADY = 0.25, 1.5
"""Share done from which on the time left may be said; ratio of two speeds that are the same."""


class TimeLeft:
    """Time left of a run by its speed in the last third; nothing while that speed changes."""

    def __init__(self) -> None:
        self._seen: list[tuple[float, float]] = []

    def said(self, elapsed_s: float, done: float) -> str:
        """Remaining time in words; "": not known.

        Args:
            elapsed_s: Since the run began.
            done: Share done, 0..1.
        """
        if not self._seen or elapsed_s >= self._seen[-1][0] + 1:
            self._seen.append((elapsed_s, done))
        recent = [x for x in self._seen if x[0] >= elapsed_s * 2 / 3]
        if done < FORETOLD or len(recent) < 3:
            return ""
        (a, x), (b, y), (c, z) = recent[0], recent[len(recent) // 2], recent[-1]
        slow, fast = sorted(((y - x) / (b - a), (z - y) / (c - b)))
        if fast > STEADY * slow or slow <= 0:
            return ""
        return f"{(1 - done) * (c - a) / (z - x):.0f} s left"


class _LeftColumn(ProgressColumn):
    """Time left of a bar."""

    def __init__(self) -> None:
        super().__init__()
        self._left = TimeLeft()

    def render(self, task: Task) -> Text:
        """Remaining time in words."""
        return Text(self._left.said(task.elapsed or 0.0, task.completed))


@contextmanager
def progress(what: str) -> Iterator[Callable[[float], None]]:
    """A progress bar on stderr, or regular lines where that is no terminal; the function takes the
    completed share, 0..1."""
    if not STDERR.is_terminal:
        yield _lines(what)
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn())
    with Progress(*columns, _LeftColumn(), console=STDERR, transient=True) as bar:
        task = bar.add_task(what, total=1.0)
        yield lambda done: bar.update(task, completed=done)


def _lines(what: str) -> Callable[[float], None]:
    """Function that prints the completed share, and the remaining time once it is known."""
    began = said = time.monotonic()
    left = TimeLeft()

    def tell(done: float) -> None:
        """Print a line if the last one is old enough."""
        nonlocal said
        now = time.monotonic()
        known = left.said(now - began, done)
        if now - said < EVERY_S:
            return
        said = now
        STDERR.print(f"{what}: {100 * done:.0f} %{f', {known}' if known else ''}")

    return tell


def _visible(text: str) -> str:
    """Text with control, format and half characters written out, except line ends and tabs."""
    return "".join(
        ascii(c)[1:-1] if unicodedata.category(c) in ("Cc", "Cf", "Cs") and c not in "\n\t" else c
        for c in text
    )


def print_error(error: Exception, doing: str) -> Exit:
    """Print an error in one line; it names a file with the traceback of an internal error.

    Args:
        error: Error that was raised.
        doing: Activity during the error, with its files.

    Returns:
        The exit code for the error.
    """
    code = Exit.WRONG_USE
    if isinstance(error, TwinError):
        text = str(error)
    elif isinstance(error, OSError):
        text = f"{error.filename or 'output'}: {error.strerror or error}"
    else:
        code = Exit.BROKEN
        said = " ".join(str(error).split())[:300]
        text = (
            f"{doing}: {type(error).__name__}: {said} This is a mistake of uavtwin; please report "
            f"it with {_stored_traceback(error)}."
        )
    STDERR.print(f"error: {text}", style="red")
    return code


def _stored_traceback(error: Exception) -> str:
    """File with the traceback, among the logs of the user."""
    text = "".join(traceback.format_exception(error))
    try:
        folder = platformdirs.user_log_path("uavtwin", ensure_exists=True)
        handle, name = tempfile.mkstemp(prefix="error-", suffix=".txt", dir=folder)
        with open(handle, "w", encoding="utf-8") as file:
            file.write(text)
    except OSError as failure:
        return f"what a file should hold ({failure}): {text!r}"
    return name


def warn(text: str) -> None:
    """Print a warning."""
    STDERR.print(f"warning: {text}", style="yellow")


@contextmanager
def interruptible() -> Iterator[Callable[[], bool]]:
    """Context in which Ctrl-C, or a signal to end, ends a flight but not its report: returns
    whether one has come."""
    came: list[int] = []
    names = (signal.SIGINT, signal.SIGTERM)
    before = {n: signal.signal(n, lambda number, _: came.append(number)) for n in names}
    try:
        yield lambda: bool(came)
    finally:
        for name, handler in before.items():
            signal.signal(name, handler)


def print_json(
    content: "Record | DataclassInstance | Sequence[Record | DataclassInstance]",
) -> None:
    """Print a result as JSON; its keys are those of the class, in the reference of JSON keys."""
    from ..record import content_of

    sys.stdout.write(json_text(content_of(content)))


def print_rows(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print rows with arbitrary keys as JSON."""
    sys.stdout.write(json_text(rows))


def print_table(table: "TextTable") -> None:
    """Print a table at its natural width; longer lines are wrapped."""
    columns = (
        Column(name, no_wrap=i in table.unbroken, overflow="fold")
        for i, name in enumerate(table.header)
    )
    printed = Table(*columns, box=None)
    for row in table.rows:
        printed.add_row(*row)
    STDOUT.print(printed)


def print_sections(sections: "Iterable[str | TextTable]") -> None:
    """Print a result, with the main result in bold."""
    for i, section in enumerate(sections):
        if isinstance(section, str):
            STDOUT.print(section, style="bold" if i == 0 else None)
        else:
            print_table(section)


def print_damage(flights: "Sequence[AnyFlight]") -> int:
    """Print damage found by the readers; returns the number of findings."""
    errors = [(f.name, x) for f in flights for x in f.findings if x.severity == "error"]
    for name, finding in errors:
        STDERR.print(
            f"finding: {name}: {finding.where}: {finding.message} ({finding.count})",
            style="red",
        )
    return len(errors)


def print_incomplete(steps: "OptionalSteps") -> bool:
    """Warn of optional steps that failed while the results are complete; returns whether any did.

    Raises:
        Exception: One failed by an internal error, or Ctrl-C.
    """
    for failed in steps.failed:
        STDERR.print(
            f"warning: {failed}. Everything else is written; run.json says what is missing.",
            style="yellow",
        )
    steps.finish()
    return bool(steps.failed)


def print_written(out: Path, files: Sequence[str]) -> None:
    """Print names of the results in a folder, the first one with the folder, and its run.json."""
    first, *others = files
    STDOUT.print(f"written: {', '.join([str(out / first), *others, 'run.json'])}")


def print_files(written: "list[WrittenFile]") -> None:
    """Print written FMUs and systems, with their hashes, and notes on them."""
    for row in written:
        platforms = ",".join(row.platforms)
        STDOUT.print(f"{row.file}  FMI {row.fmi}  {platforms}  {row.bytes} bytes")
        STDOUT.print(f"  sha256 {row.sha256}")
    for row in written:
        if row.note:
            STDERR.print(f"{row.file}: {row.note}")
