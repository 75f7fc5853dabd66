"""Output folders: nothing overwritten unless asked, a `run.json` beside every result."""

import hashlib
import json
import platform
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from twin.errors import TwinError

_PACKAGES = ("casadi", "fmpy", "numpy", "pandas", "pyulog", "scipy", "uavtwin")


def check_folder(out: Path, force: bool) -> None:
    """Refuse an output folder before the work is done; nothing is made yet.

    Raises:
        TwinError: It is a file, or it holds files and `force` is not given.
    """
    if out.exists() and not out.is_dir():
        raise TwinError(f"{out}: is a file; --out names a folder.")
    if out.is_dir() and any(out.iterdir()) and not force:
        raise TwinError(f"{out}: exists and is not empty. Choose another --out or add --force.")


def make_folder(out: Path) -> None:
    """Make the output folder, parents included.

    Raises:
        TwinError: It cannot be made.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TwinError(
            f"{out}: cannot be made: {error.strerror}. Choose another --out."
        ) from error


def sha256(path: Path) -> str:
    """Hash of a file's content."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_json(path: Path, content: Any) -> None:
    """Strict, readable JSON: a NaN is a mistake of ours and raises."""
    path.write_text(
        json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n", "utf-8"
    )


def write_run(
    out: Path,
    verb: str,
    options: Mapping[str, Any],
    inputs: Iterable[Path] = (),
    seed: int | None = None,
) -> None:
    """Write `run.json`: what made the results beside it. No time and no machine: the same run
    gives the same bytes."""
    write_json(
        out / "run.json",
        {
            "verb": verb,
            "options": dict(options),
            "seed": seed,
            "inputs": [{"name": p.name, "sha256": sha256(p)} for p in inputs],
            "python": platform.python_version(),
            "packages": {name: version(name) for name in _PACKAGES},
        },
    )
