"""What files that are no flights have in common here: they are read as `uavtwin check` reads."""

from pathlib import Path

from uavtwin.file_check import check_file

from .engine import Seen


def read_checked(path: Path) -> Seen:
    """What is said of a file, and of that what is wrong or doubted."""
    report = check_file(path)
    wrong = (*report.problems, *report.warnings, *map(str, report.questions))
    return Seen(repr(report.json()), frozenset(wrong))
