"""`uavtwin version` and `uavtwin --version`."""

import typer

from .options import Exit
from .printing import STDOUT


def version() -> None:
    """Print the version."""
    print_version(True)


def print_version(wanted: bool) -> None:
    """Print the version and end, where it is wanted."""
    import uavtwin

    if wanted:
        STDOUT.print(uavtwin.__version__)
        raise typer.Exit(Exit.FINE)
