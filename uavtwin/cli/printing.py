"""What the command line prints: results on stdout, progress and warnings on stderr."""

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Column, Table

if TYPE_CHECKING:
    from twin.explain.explanation import Explanation
    from twin.logs import Flight
    from twin.residuals.gap import FlightGap

STDOUT = Console(highlight=False, soft_wrap=True)
STDERR = Console(stderr=True, highlight=False, soft_wrap=True)


@contextmanager
def progress(what: str) -> Iterator[Callable[[float], None]]:
    """A bar on stderr; the function takes the share done, 0..1."""
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=STDERR, transient=True, disable=not STDERR.is_terminal) as bar:
        task = bar.add_task(what, total=1.0)
        yield lambda done: bar.update(task, completed=done)


def print_json(content: Any) -> None:
    """Results for machines."""
    sys.stdout.write(json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def print_gap(gaps: "list[FlightGap]", out: Path) -> None:
    """The gap of some flights as a table, and where its files are."""
    from twin.residuals.gap import rank, summaries

    from ..report.gap import claim

    pooled = summaries(gaps)
    STDOUT.print(claim(rank(pooled)), style="bold", markup=False)
    table = Table("channel", "unit", "horizon s", "n", "rms", "mean", "share of signal", box=None)
    for name, s in pooled.items():
        t = s.total
        table.add_row(
            name,
            s.unit,
            f"{s.horizon_s:g}",
            str(t.n),
            f"{t.rms:.4g}",
            f"{t.mean:.4g}",
            f"{100 * t.share:.0f} %",
        )
    STDOUT.print(table)
    for g in gaps:
        if "commands_match" in g.facts:
            STDOUT.print(f"{g.flight}: commands {g.facts['commands_match']}", markup=False)
        for warning in g.warnings:
            STDERR.print(f"{g.flight}: {warning}", style="yellow", markup=False)
    STDOUT.print(f"written: {out / 'report.html'}, gap.json, run.json", markup=False)


def print_explanation(found: "Explanation") -> None:
    """What was found, and the gap before and after."""
    from ..report.words import claim, shrink_words

    for warning in found.warnings:
        STDERR.print(warning, style="yellow", markup=False)
    STDOUT.print(claim(found), style="bold", markup=False)
    if found.next_manoeuvre is not None:
        STDOUT.print(f"Fly next: {found.next_manoeuvre.description}", markup=False)
    if found.comparison is None:
        return
    shrink = Column("shrink, 95 %", no_wrap=True)
    table = Table("channel", "unit", "n", "before", "after", "noise floor", shrink, box=None)
    for g in found.comparison.gaps:
        table.add_row(
            g.name,
            g.unit,
            str(g.n),
            f"{g.before:.4g}",
            f"{g.after:.4g}",
            f"{g.noise_floor:.4g}",
            shrink_words(g),
        )
    STDOUT.print(table)


def print_damage(flights: "list[Flight]") -> int:
    """Print what the readers found damaged; how many."""
    errors = [(f.name, x) for f in flights for x in f.findings if x.severity == "error"]
    for name, finding in errors:
        STDERR.print(
            f"finding: {name}: {finding.where}: {finding.message} ({finding.count})",
            style="red",
            markup=False,
        )
    return len(errors)


def print_files(written: list[dict[str, Any]]) -> None:
    """FMUs and systems that were written, with their hashes, and notes on them."""
    for row in written:
        platforms = ",".join(row["platforms"])
        STDOUT.print(f"{row['file']}  FMI {row['fmi']}  {platforms}  {row['bytes']} bytes")
        STDOUT.print(f"  sha256 {row['sha256']}")
    for row in written:
        if "note" in row:
            STDERR.print(f"{row['file']}: {row['note']}", markup=False)
