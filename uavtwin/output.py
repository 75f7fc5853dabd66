"""Output folders: all results or none, none overwritten unless asked, a `run.json` beside them."""

import errno
import hashlib
import json
import os
import platform
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any

from twin.errors import TwinError
from twin.scratch import PREFIX, leftovers, scratch_folder, sweep, umask

_MOVING = "moving"
"""In a temporary folder: names of the results that are being moved to their place."""
_PACKAGES = ("casadi", "fmpy", "numpy", "pandas", "pyulog", "scipy", "uavtwin")


def check_folder(out: Path, force: bool) -> None:
    """Refuse an output folder before the work is done; nothing is made yet.

    Raises:
        TwinError: It is a file, it cannot be written, or it holds files and `force` is not given.
    """
    if out.exists() and not out.is_dir():
        raise TwinError(f"{out}: is a file; --out names a folder.")
    there = _nearest(out)
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        raise TwinError(
            f"{out}: cannot be written, {there} is "
            f"{'write-protected' if there.is_dir() else 'a file'}. Choose another --out."
        )
    if out.is_dir() and not force:
        _undo(out)
        for entry in out.glob(f"{PREFIX}*"):
            raise TwinError(
                f"{out}: another run is writing into it. Choose another --out; or, where that run "
                f"was killed on another machine, delete {entry.name}."
            )
        if any(out.iterdir()):
            raise TwinError(f"{out}: exists and is not empty. Choose another --out or add --force.")


def check_file(path: Path, force: bool) -> None:
    """Refuse an output file before the work is done.

    Raises:
        TwinError: It is a folder, or it is there and `force` is not given.
    """
    if path.is_dir():
        raise TwinError(f"{path}: is a folder; name a file.")
    if path.exists() and not force:
        raise TwinError(f"{path}: exists. Choose another --out or add --force.")


@contextmanager
def results_folder(out: Path, force: bool) -> Iterator[Path]:
    """A temporary folder whose content is moved to `out` at the end; nothing is, if that fails.

    Files of `out` that have another name than a result stay.

    Raises:
        TwinError: As `check_folder`, or a result cannot be moved to its place.
    """
    check_folder(out, force)
    with scratch_folder(_nearest(out)) as folder:
        results = folder / "results"
        results.mkdir()
        yield results
        readable(results.rglob("*"))
        try:
            out.parent.mkdir(parents=True, exist_ok=True)
            if force:
                _move(results, out)
            else:
                _move_into_empty(results, out, folder)
        except OSError as error:
            place = error.filename2 or error.filename
            raise TwinError(
                f"{place}: cannot be written: {error.strerror}. Choose another --out."
            ) from error


@contextmanager
def output_file(path: Path) -> Iterator[Path]:
    """A temporary file of the same kind that takes the place of `path` at the end.

    Nothing happens to `path` if that fails. Folders above it are made.

    Raises:
        TwinError: It is a folder, or it cannot be written.
    """
    if path.is_dir():
        raise TwinError(f"{path}: is a folder; name a file.")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with scratch_folder(path.parent) as folder:
            file = folder / path.name
            yield file
            readable([file])
            file.replace(path)
    except OSError as error:
        raise TwinError(f"{path}: cannot be written: {error.strerror}.") from error


def readable(files: Iterable[Path]) -> None:
    """Give files the rights that the umask allows: some libraries write theirs for the owner alone.

    Args:
        files: Folders among them, and what is not there, are left as they are.
    """
    rights = 0o666 & ~umask()
    for file in files:
        if file.is_file() and not file.is_symlink():
            file.chmod(file.stat().st_mode | rights)


def _nearest(out: Path) -> Path:
    """The folder itself, or the nearest one above it that exists."""
    return next(path for path in (out, *out.absolute().parents) if path.exists())


def _move_into_empty(results: Path, out: Path, folder: Path) -> None:
    """Move results to a place where there is nothing else.

    A new folder appears at once. Into one that was there, and may be a mount or somebody's working
    directory, entries are moved one by one; a list of them lets the next run undo half of it.

    Raises:
        TwinError: Another run was faster.
    """
    if not folder.is_relative_to(out):
        try:
            results.rename(out)
        except OSError as error:
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                raise
        else:
            return
    elif {entry.name for entry in out.iterdir()} == {folder.name}:
        names = sorted(entry.name for entry in results.iterdir())
        partial = folder / f"{_MOVING}.partial"
        partial.write_text(json.dumps(names), "utf-8")
        partial.replace(folder / _MOVING)
        _move(results, out)
        return
    raise TwinError(
        f"{out}: another run has written into it meanwhile; nothing of this one is there. Choose "
        f"another --out."
    )


def _undo(out: Path) -> None:
    """Take away what runs that are dead had begun to move into a folder that was empty."""
    for left in leftovers(out):
        for name in _moved(left):
            place = out / name
            if place.is_dir() and not place.is_symlink():
                shutil.rmtree(place)
            else:
                place.unlink(missing_ok=True)
    sweep(out)


def _moved(folder: Path) -> list[str]:
    """Names of results that are in their place already; a list that is not ours names none."""
    try:
        names = json.loads((folder / _MOVING).read_text("utf-8"))
    except (OSError, ValueError):
        return []
    listed = names if isinstance(names, list) else []
    plain = [n for n in listed if isinstance(n, str) and n not in ("", "..") and n == Path(n).name]
    return [n for n in plain if not (folder / "results" / n).exists()]


def _move(made: Path, place: Path) -> None:
    """Move a file or a folder; a folder already there keeps what else it holds."""
    if made.is_dir() and place.is_dir():
        for entry in sorted(made.iterdir()):
            _move(entry, place / entry.name)
    else:
        made.replace(place)


def sha256(path: Path) -> str:
    """Hash of a file's content."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def json_text(content: Any) -> str:
    """Strict, readable JSON: a NaN is a mistake of ours and raises.

    Half characters, as in the name of a file that is not of UTF-8, are written as escapes.
    """
    text = json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def write_json(path: Path, content: Any) -> None:
    """The same as a file."""
    path.write_text(json_text(content), "utf-8")


def write_run(
    out: Path,
    verb: str,
    options: Mapping[str, Any],
    inputs: Iterable[Path] = (),
    seed: int | None = None,
    file: str = "run.json",
    incomplete: str = "",
    fmus: Mapping[str, str] | None = None,
) -> None:
    """Write `run.json`: what made the results beside it. No time and no machine: the same run
    gives the same bytes.

    Args:
        out: Folder.
        verb: Of the command line.
        options: It was called with.
        inputs: Files that it read.
        seed: Of what is drawn.
        file: Another name, where the folder is not of this run alone.
        incomplete: Why the results are of a part of the run; "": they are of all of it.
        fmus: How each FMU of a simulation was run, by its name there; None: there were none.
    """
    write_json(
        out / file,
        {
            "verb": verb,
            "options": dict(options),
            "seed": seed,
            "inputs": [{"name": p.name, "sha256": sha256(p)} for p in inputs],
            "python": platform.python_version(),
            "packages": {name: version(name) for name in _PACKAGES},
            **({} if fmus is None else {"fmus": dict(fmus)}),
            **({"incomplete": incomplete} if incomplete else {}),
        },
    )
