"""Common end of the verbs that write a folder: result, files, series, run.json, damage, exit
code."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import typer

from ..output import OptionalSteps, results_folder, write_json, write_run
from .options import Exit
from .printing import (
    STDERR,
    print_damage,
    print_incomplete,
    print_json,
    print_sections,
    print_written,
    progress,
)

if TYPE_CHECKING:
    from twin.logs import AnyFlight

    from ..display import TextTable
    from ..record import Record
    from ..series.files import Form, Series

Write = Callable[[Path, OptionalSteps, Callable[[float], None]], list[str]]
"""Function that writes files into a folder, optional ones by their steps, and reports the completed
share; returns the names of the files, the main one first."""


class Printable(Protocol):
    """A result of a verb."""

    @property
    def record(self) -> "Record":
        """Record of all its numbers."""

    def findings(self) -> "Iterable[str | TextTable]":
        """Text of the result, the main sentence first."""


class Paged(Printable, Protocol):
    """A result with a page."""

    def report(self, path: str | Path) -> Path:
        """Write the page."""


def print_result(found: Printable, as_json: bool) -> None:
    """Print a result as JSON; else its findings, with warnings on stderr."""
    if as_json:
        print_json(found.record)
        return
    for warning in getattr(found, "warnings", ()):
        STDERR.print(warning, style="yellow")
    print_sections(found.findings())


def write_page(found: Paged, folder: Path, name: str) -> list[str]:
    """Write the page of a result and its numbers; returns the names of the files."""
    write_json(folder / name, found.record.json())
    found.report(folder / "report.html")
    return ["report.html", name]


TABLES = "tables"
"""Folder of the tables in a folder of results."""


def write_tables(record: "Record", folder: Path) -> None:
    """Write each list of a record, or its parts by name, as CSV: a row each, `a.b` for b in a,
    `a.1` for the first number in a; lists of parts, or parts by name, within a row are separate
    tables."""
    folder.mkdir()
    _write_parts(record.json(), folder, "")


def _write_parts(whole: dict[str, Any], folder: Path, name: str) -> None:
    """Write the tables of a part of the record."""
    for key, value in whole.items():
        if rows := _rows(value):
            _write_table(rows, folder, name + key)
        elif isinstance(value, dict):
            _write_parts(value, folder, f"{name}{key}.")


def _rows(value: object) -> list[dict[str, Any]]:
    """A list of parts, or parts by name, or by two names, as rows; none for anything else."""
    if isinstance(value, list):
        return value if all(isinstance(p, dict) for p in value) else []
    if not isinstance(value, dict) or not all(isinstance(p, dict) for p in value.values()):
        return []
    parts = {k: p for k, p in value.items() if p}
    if all(map(_rows, parts.values())):
        return [{"of": k, **row} for k, p in parts.items() for row in _rows(p)]
    return [{"name": k, **p} for k, p in parts.items()]


def _flat(row: dict[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Columns and cells of a row; nested tables remain whole."""
    for key, cell in row.items():
        if isinstance(cell, dict) and not _rows(cell):
            yield from _flat(cell, f"{before}{key}.")
        else:
            yield f"{before}{key}", cell


def _write_table(rows: list[dict[str, Any]], folder: Path, name: str) -> None:
    """Write one table, and those of the parts in its rows, with references to the row."""
    import pandas as pd

    table = pd.DataFrame([dict(_flat(row)) for row in rows], dtype=object)
    table = table.where(table.notna(), None)
    of = table["name"] if "name" in table else pd.Series(table.index)
    columns: dict[str, Any] = {}
    for column, cells in table.items():
        lists = [cell for cell in cells if isinstance(cell, list)]
        if inner := [
            {"of": whose, **part}
            for whose, cell in zip(of, cells, strict=True)
            for part in _rows(cell)
        ]:
            _write_table(inner, folder, f"{name}.{column}")
        elif lists and all(isinstance(x, int | float | None) for cell in lists for x in cell):
            for k in range(max(map(len, lists))):
                columns[f"{column}.{k + 1}"] = [
                    cell[k] if isinstance(cell, list) and k < len(cell) else None for cell in cells
                ]
        elif lists:
            columns[str(column)] = [
                "; ".join(map(str, cell)) if isinstance(cell, list) else cell for cell in cells
            ]
        elif cells.notna().any() or not any(c.startswith(f"{column}.") for c in table):
            columns[str(column)] = cells
    pd.DataFrame(columns).to_csv(folder / f"{name}.csv", index=False)


def conclude(
    verb: str,
    found: Printable,
    out: Path,
    write: Write,
    options: Mapping[str, Any],
    inputs: Iterable[Path],
    *,
    force: bool,
    as_json: bool,
    findings: bool,
    flights: "Sequence[AnyFlight]" = (),
    series: "Sequence[Series]" = (),
    forms: "Sequence[Form]" = (),
    tables: bool = False,
    seed: int | None = None,
    journal: str = "",
) -> None:
    """Print a result, write its folder, and end with exit code 1 if there are findings.

    Args:
        verb: Verb of the command line.
        found: Result of the verb.
        out: Output folder.
        write: Writes its files besides series and run.json.
        options: Options for run.json.
        inputs: Input files; other inputs, such as a built-in vehicle, are ignored.
        force: Whether existing files are replaced.
        as_json: Whether JSON is printed.
        findings: Whether the result needs exit code 1, as do damaged flights and failed optional
            steps.
        flights: Flights that were read.
        series: Series for the folder.
        forms: Formats of the series.
        tables: Whether the lists of the record are written as tables too.
        seed: Seed of random numbers.
        journal: Name of a file that remains in the folder if the run is killed; "": none.
    """
    from ..series.files import write_all_series

    print_result(found, as_json)
    steps = OptionalSteps()
    with results_folder(out, force, journal) as folder, progress("writing") as step:
        written = write(folder, steps, step)
        if steps.run("series", folder, lambda place: write_all_series(series, place, forms)):
            written.append("series/")
        if tables:
            write_tables(found.record, folder / TABLES)
            written.append(f"{TABLES}/")
        read = [p for p in inputs if p.is_file()]
        write_run(folder, verb, options, read, seed, incomplete=steps.incomplete)
    if not as_json:
        print_written(out, written)
    damaged = print_damage(flights)
    if print_incomplete(steps) or damaged or findings:
        raise typer.Exit(Exit.FINDINGS)
