"""What the command line prints: results on stdout, progress and warnings on stderr."""

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
    """Shows what would steer a terminal, and half characters, as escapes: names come from files."""

    def render_str(self, text: str, **options: Any) -> Text:
        """Text with its styles."""
        return super().render_str(_visible(text), **options)


WIDTH = None if sys.stdout.isatty() or "COLUMNS" in os.environ else 160
"""Characters in a line of a table where nobody says how many there are."""
STDOUT = _Terminal(highlight=False, markup=False, soft_wrap=True, width=WIDTH)  # for results
STDERR = _Terminal(stderr=True, highlight=False, markup=False, soft_wrap=True)
"""Consoles for results, and for progress and warnings."""


EVERY_S = 10.0
"""Time between two lines of progress where stderr is no terminal."""


FORETOLD, STEADY = 0.25, 1.5
"""Share done from which on the time left may be said; ratio of two speeds that are the same."""


class TimeLeft:
    """Time left of a run by its speed in the last third; nothing while that speed changes."""

    def __init__(self) -> None:
        self._seen: list[tuple[float, float]] = []

    def said(self, elapsed_s: float, done: float) -> str:
        """In words; "": not known.

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
        """In words."""
        return Text(self._left.said(task.elapsed or 0.0, task.completed))


@contextmanager
def progress(what: str) -> Iterator[Callable[[float], None]]:
    """A bar on stderr, or a line now and then where that is no terminal; the function takes the
    share done, 0..1."""
    if not STDERR.is_terminal:
        yield _lines(what)
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn())
    with Progress(*columns, _LeftColumn(), console=STDERR, transient=True) as bar:
        task = bar.add_task(what, total=1.0)
        yield lambda done: bar.update(task, completed=done)


def _lines(what: str) -> Callable[[float], None]:
    """Prints the share done, and the time left once that is known."""
    began = said = time.monotonic()
    left = TimeLeft()

    def tell(done: float) -> None:
        """Print a line where the last one is old enough."""
        nonlocal said
        now = time.monotonic()
        known = left.said(now - began, done)
        if now - said < EVERY_S:
            return
        said = now
        STDERR.print(f"{what}: {100 * done:.0f} %{f', {known}' if known else ''}")

    return tell


def _visible(text: str) -> str:
    """Text with control, format and half characters written out, line ends and tabs left."""
    return "".join(
        ascii(c)[1:-1] if unicodedata.category(c) in ("Cc", "Cf", "Cs") and c not in "\n\t" else c
        for c in text
    )


def print_error(error: Exception, doing: str) -> Exit:
    """One line of what went wrong; the traceback of a mistake of ours goes to a file that it names.

    Args:
        error: What was raised.
        doing: What was being done, and with which files.

    Returns:
        The exit code that it deserves.
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
    """The file that tells where in the program it happened, among the logs of the user."""
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
    """Ctrl-C, or a signal to end, ends a flight and not its report: gives whether one has come."""
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
    """A result for machines; its keys are those of the class, in the reference of JSON keys."""
    from ..record import content_of

    sys.stdout.write(json_text(content_of(content)))


def print_rows(rows: Sequence[Mapping[str, Any]]) -> None:
    """Rows for machines, whose keys nobody knows before."""
    sys.stdout.write(json_text(rows))


def print_table(table: "TextTable") -> None:
    """A table as wide as it needs; what does not fit goes on in the next line."""
    columns = (
        Column(name, no_wrap=i in table.unbroken, overflow="fold")
        for i, name in enumerate(table.header)
    )
    printed = Table(*columns, box=None)
    for row in table.rows:
        printed.add_row(*row)
    STDOUT.print(printed)


def print_sections(sections: "Iterable[str | TextTable]") -> None:
    """A result as it prints itself, the claim in bold."""
    for i, section in enumerate(sections):
        if isinstance(section, str):
            STDOUT.print(section, style="bold" if i == 0 else None)
        else:
            print_table(section)


def print_damage(flights: "Sequence[AnyFlight]") -> int:
    """Print what the readers found damaged; how many."""
    errors = [(f.name, x) for f in flights for x in f.findings if x.severity == "error"]
    for name, finding in errors:
        STDERR.print(
            f"finding: {name}: {finding.where}: {finding.message} ({finding.count})",
            style="red",
        )
    return len(errors)


def print_incomplete(steps: "OptionalSteps") -> bool:
    """Warn of optional steps that failed, the results being in place; whether any did.

    Raises:
        Exception: One failed by a mistake of ours, or Ctrl-C.
    """
    for failed in steps.failed:
        STDERR.print(
            f"warning: {failed}. Everything else is written; run.json says what is missing.",
            style="yellow",
        )
    steps.finish()
    return bool(steps.failed)


def print_written(out: Path, files: Sequence[str]) -> None:
    """Names of the results in a folder, the first of them with the folder, and its run.json."""
    first, *others = files
    STDOUT.print(f"written: {', '.join([str(out / first), *others, 'run.json'])}")


def print_files(written: "list[WrittenFile]") -> None:
    """FMUs and systems that were written, with their hashes, and notes on them."""
    for row in written:
        platforms = ",".join(row.platforms)
        STDOUT.print(f"{row.file}  FMI {row.fmi}  {platforms}  {row.bytes} bytes")
        STDOUT.print(f"  sha256 {row.sha256}")
    for row in written:
        if row.note:
            STDERR.print(f"{row.file}: {row.note}")
