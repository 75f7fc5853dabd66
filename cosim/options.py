"""What the verbs of the command line share: options and exit codes."""

from enum import IntEnum
from pathlib import Path
from typing import Annotated

import typer


class Exit(IntEnum):
    """Exit codes."""

    FINE = 0
    FINDINGS = 1
    WRONG_USE = 2


Out = Annotated[Path, typer.Option("--out", help="Folder for the results.")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite what the folder holds.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]
VehicleName = Annotated[
    str, typer.Option("--vehicle", help="Vehicle file (TOML), or the name of a built-in vehicle.")
]
