"""How the verbs end that leave a folder: result, files, series, run.json, damage, exit code."""

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
"""Writes files into a folder, optional ones by their steps, and takes the share done to a function;
names of the files, the first one for people."""


class Printable(Protocol):
    """A result of a verb."""

    @property
    def record(self) -> "Record":
        """Every number of it."""

    def findings(self) -> "Iterable[str | TextTable]":
        """What it says, the claim first."""


class Paged(Printable, Protocol):
    """A result with a page."""

    def report(self, path: str | Path) -> Path:
        """Write the page."""


def print_result(found: Printable, as_json: bool) -> None:
    """A result for machines; else its findings, warnings on stderr."""
    if as_json:
        print_json(found.record)
        return
    for warning in getattr(found, "warnings", ()):
        STDERR.print(warning, style="yellow")
    print_sections(found.findings())


def write_page(found: Paged, folder: Path, name: str) -> list[str]:
    """Write the page of a result and its numbers; names of the files."""
    write_json(folder / name, found.record.json())
    found.report(folder / "report.html")
    return ["report.html", name]


TABLES = "tables"
"""Folder of the tables in one of results."""


def write_tables(record: "Record", folder: Path) -> None:
    """Write each list of a record, or its parts by name, as CSV: a row each, `a.b` for b in a,
    `a.1` for the first number in a; lists of parts, or parts by name, within a row are a table of
    their own."""
    folder.mkdir()
    _write_parts(record.json(), folder, "")


def _write_parts(whole: dict[str, Any], folder: Path, name: str) -> None:
    """Tables of what a part of the record holds."""
    for key, value in whole.items():
        if rows := _rows(value):
            _write_table(rows, folder, name + key)
        elif isinstance(value, dict):
            _write_parts(value, folder, f"{name}{key}.")


def _rows(value: object) -> list[dict[str, Any]]:
    """A list of parts, or parts by name, or by two names, as rows; none of anything else."""
    if isinstance(value, list):
        return value if all(isinstance(p, dict) for p in value) else []
    if not isinstance(value, dict) or not all(isinstance(p, dict) for p in value.values()):
        return []
    parts = {k: p for k, p in value.items() if p}
    if all(map(_rows, parts.values())):
        return [{"of": k, **row} for k, p in parts.items() for row in _rows(p)]
    return [{"name": k, **p} for k, p in parts.items()]


def _flat(row: dict[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Columns and cells of a row; what is a table of its own stays whole."""
    for key, cell in row.items():
        if isinstance(cell, dict) and not _rows(cell):
            yield from _flat(cell, f"{before}{key}.")
        else:
            yield f"{before}{key}", cell


def _write_table(rows: list[dict[str, Any]], folder: Path, name: str) -> None:
    """One table, and those of the parts in its rows, which say of which row they are."""
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
    """Print a result, write its folder, and end with exit code 1 where there are findings.

    Args:
        verb: Of the command line.
        found: The result.
        out: Folder.
        write: What is in it besides series and run.json.
        options: For run.json.
        inputs: Files that were read; what is no file, such as a built-in vehicle, is left out.
        force: Whether files that are there are replaced.
        as_json: Whether JSON is printed.
        findings: Whether the result asks for exit code 1, which damaged flights and optional steps
            that fail do as well.
        flights: That were read.
        series: Of the folder.
        forms: Of these.
        tables: Whether the lists of the record are written as tables too.
        seed: Of what is drawn.
        journal: Name of a file of the folder that the run leaves if it is killed; "": none.
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
