"""Names of files, and files that are there whole or not at all."""

import json
from pathlib import Path
from typing import Any

from twin.errors import LogError

VEHICLE = "vehicle.toml"
"""Of a case."""


def found_in(folder: Path, pattern: str) -> list[Path]:
    """Flights of a case in the order of their names."""
    found = sorted(folder.glob(pattern))
    if not found:
        raise LogError(f"{folder}: no {pattern}; write the flights again with generate")
    return found


def write_json(path: Path, content: Any) -> None:
    """Write JSON; whoever is cut short leaves no half of a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    partial.write_text(json.dumps(content, indent=1, sort_keys=True) + "\n", "utf-8")
    partial.replace(path)
