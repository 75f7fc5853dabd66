"""Output folders: all results or none, no overwriting unless forced, with a `run.json`.

Results are written into a scratch folder and moved to their place at the end. A new folder appears
atomically. Into an existing folder (which may be a mount, or a working directory) entries are moved
one by one; the scratch folder has a list of them meanwhile, so that the next run can revert the
moves of a killed one. A file is reverted only if it is still the one in the list, by device, inode,
size and SHA-256, and only if that is true for all of them; else nothing is changed. The list is not
trusted further: names are relative, no link is followed, and a folder is removed only when it is
empty.
"""

import errno
import hashlib
import json
import os
import platform
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar

from msgspec import UNSET, UnsetType

from twin.errors import TwinError
from twin.scratch import PREFIX, leftovers, scratch_file, scratch_folder, sweep, umask

from .record import Record

T = TypeVar("T")
_MOVING = "moving"
"""File in a scratch folder that lists the results while they are moved."""
_LONGEST_LIST = 2**26
"""Largest such list that is read, bytes: some 400,000 results."""
_RECORD_KEYS = {"verb", "options", "inputs", "packages"}
"""Keys of every run.json."""
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Errors of a full disk, and of a file that is too large."""
_PACKAGES = ("casadi", "fmpy", "numpy", "pandas", "pyulog", "scipy", "uavtwin")
"""Packages whose versions are in a run.json."""


def check_folder(out: Path, force: bool, journal: str = "", alongside: Sequence[str] = ()) -> None:
    """Refuse an output folder before the work is done; nothing is created yet.

    Args:
        out: Folder.
        force: Whether files in it may be replaced.
        journal: Name of a file in it that marks an unfinished run, which may be resumed.
        alongside: Names of further files of an unfinished run.

    Raises:
        TwinError: It is a file, it cannot be written, or it is not empty and `force` is not given.
    """
    if out.exists() and not out.is_dir():
        raise TwinError(f"{out}: is a file; --out names a folder.")
    there = _nearest(out)
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        raise TwinError(
            f"{out}: cannot be written, {there} is "
            f"{'write-protected' if there.is_dir() else 'a file'}. Choose another --out."
        )
    if not out.is_dir() or force:
        return
    unfinished = bool(journal) and (out / journal).is_file()
    own = {journal, *alongside} if unfinished else set()
    own |= _take_back_all(out, own)
    others = sorted(entry.name for entry in out.iterdir() if entry.name not in own)
    for name in others:
        if name.startswith(PREFIX):
            raise TwinError(
                f"{out}: another run is writing into it. Choose another --out; or, where that run "
                f"was killed on another machine or before a restart, delete {name}."
            )
    if others:
        besides = f", {others[0]} beside the unfinished run" if unfinished else ""
        raise TwinError(
            f"{out}: exists and is not empty{besides}. Choose another --out or add --force."
        )
    sweep(out)


def check_file(path: Path, force: bool) -> None:
    """Refuse an output file before the work is done.

    Raises:
        TwinError: It is a folder, or it exists and `force` is not given.
    """
    if path.is_dir():
        raise TwinError(f"{path}: is a folder; name a file.")
    if os.path.lexists(path) and not force:
        raise TwinError(f"{path}: exists. Choose another --out or add --force.")


def check_record(path: Path, force: bool) -> None:
    """Refuse another file in the place of a run.json; see `check_file`."""
    if not _is_record(path):
        check_file(path, force)


@contextmanager
def results_folder(
    out: Path, force: bool, journal: str = "", alongside: Sequence[str] = ()
) -> Iterator[Path]:
    """A temporary folder whose content is moved to `out` at the end, or not at all on failure.

    Other files of `out` remain. The journal is removed when the results are in place.

    Args:
        out, force, journal, alongside: See `check_folder`.

    Raises:
        TwinError: As in `check_folder`, or a result cannot be written or moved to its place.
    """
    check_folder(out, force, journal, alongside)
    with _explained(out), scratch_folder(_nearest(out)) as folder:
        results = folder / "results"
        results.mkdir()
        yield results
        readable(results.rglob("*"))
        out.parent.mkdir(parents=True, exist_ok=True)
        if not folder.is_relative_to(out):
            _appear(results, out)
        elif force:
            _merge(results, out)
            _finish(out, journal)
        else:
            _move_listed(results, out, folder, journal, alongside)


@contextmanager
def output_file(path: Path) -> Iterator[Path]:
    """A temporary file of the same kind that takes the place of `path` at the end.

    On failure `path` is unchanged. Parent folders are created.

    Raises:
        TwinError: It is a folder, or it cannot be written.
    """
    if path.is_dir():
        raise TwinError(f"{path}: is a folder; name a file.")
    with _explained(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with scratch_file(path) as file:
            yield file


@contextmanager
def recorded_file(path: Path, force: bool) -> Iterator[tuple[Path, Callable[..., None]]]:
    """An output file and its run.json, `STEM.run.json`: both or none.

    Returns a temporary file of the same name, and a function with the arguments of `write_run`
    after the folder. The record is moved first: a run that is killed between the two can be
    repeated, as a record without its file may be replaced.

    Raises:
        TwinError: `path` exists and `force` is not given, or it cannot be written.
    """
    record = record_of(path)
    check_file(path, force)
    check_record(record, force)
    with _explained(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with scratch_folder(path.parent) as folder:
            results = folder / "results"
            results.mkdir()

            def note(
                verb: str,
                options: Mapping[str, Any],
                inputs: Iterable[Path],
                seed: int | None = None,
            ) -> None:
                """Write the record."""
                write_run(results, verb, options, inputs, seed, record.name)

            yield results / path.name, note
            readable(results.iterdir())
            check_file(path, force)
            check_record(record, force)
            for name in (record.name, path.name):
                (results / name).replace(path.with_name(name))


def record_of(path: Path) -> Path:
    """The run.json of a file."""
    return path.with_name(f"{path.stem}.run.json")


def _is_record(path: Path) -> bool:
    """Whether a file is a run.json written by a run."""
    try:
        if path.is_symlink() or path.stat().st_size > _LONGEST_LIST:
            return False
        content = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(content, dict) and content.keys() >= _RECORD_KEYS


class OptionalSteps:
    """Optional steps at the end of a run, such as building FMUs.

    A failed step leaves no files; the other results are moved to their place nevertheless.

    Attributes:
        failed: Failed steps, with the reason.
    """

    def __init__(self) -> None:
        self.failed: list[str] = []
        self._raised: BaseException | None = None

    @property
    def incomplete(self) -> str:
        """Text on all failures for run.json; "" for none."""
        return "; ".join(self.failed)

    def run(self, what: str, folder: Path, write: Callable[[Path], T]) -> T | None:
        """Write files into a separate folder, and move them to the results on success.

        Args:
            what: The step, for a reader.
            folder: Folder of the results.
            write: Writes into the given folder.

        Returns:
            Result of `write`; None: it failed, or an earlier one was interrupted.
        """
        if self._raised is not None:
            self.failed.append(f"{what}: not done")
            return None
        try:
            with scratch_folder(folder) as place:
                made = place / "step"
                made.mkdir()
                result = write(made)
                _merge(made, folder)
                return result
        except (TwinError, OSError) as error:
            reason = error if isinstance(error, TwinError) else error.strerror or error
            self.failed.append(f"{what}: {' '.join(str(reason).split())}")
        except (Exception, KeyboardInterrupt) as error:
            interrupted = isinstance(error, KeyboardInterrupt)
            self.failed.append(f"{what}: {'interrupted' if interrupted else repr(error)}")
            self._raised = error
        return None

    def finish(self) -> None:
        """Raise internal errors and Ctrl-C of the steps, after the results are in place."""
        if self._raised is not None:
            raise self._raised


def readable(files: Iterable[Path]) -> None:
    """Set permissions of files by the umask: some libraries allow access to the owner only.

    Args:
        files: Paths of the files; folders and missing files are ignored.
    """
    rights = 0o666 & ~umask()
    for file in files:
        if file.is_file() and not file.is_symlink():
            file.chmod(file.stat().st_mode | rights)


@contextmanager
def _explained(out: Path) -> Iterator[None]:
    """Context that reports system errors for the requested path."""
    try:
        yield
    except OSError as error:
        if error.errno in _FULL:
            raise TwinError(
                f"{out}: cannot be written: {error.strerror}. Nothing of this run is there; make "
                f"room, or choose another --out."
            ) from error
        place = Path(error.filename2 or error.filename or out)
        if not place.absolute().is_relative_to(_nearest(out.absolute())):
            raise  # an input
        raise TwinError(
            f"{place}: cannot be written: {error.strerror or error}. Choose another --out."
        ) from error


def _nearest(out: Path) -> Path:
    """The folder itself, or the nearest one above it that exists."""
    return next(path for path in (out, *out.absolute().parents) if path.exists())


def _taken(out: Path) -> TwinError:
    return TwinError(
        f"{out}: another run has written into it meanwhile; nothing of this one is there. Choose "
        f"another --out."
    )


def _appear(results: Path, out: Path) -> None:
    """Move results atomically to a place where nothing exists.

    Raises:
        TwinError: Another run was faster.
    """
    try:
        results.rename(out)
    except OSError as error:
        if error.errno in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR):
            raise _taken(out) from error
        raise


def _move_listed(
    results: Path, out: Path, folder: Path, journal: str, alongside: Sequence[str]
) -> None:
    """Move results into an existing folder, entry by entry, with a list of them meanwhile.

    Raises:
        TwinError: Another entry exists there by now.
    """
    if {entry.name for entry in out.iterdir()} - {folder.name, journal, *alongside}:
        raise _taken(out)
    partial = folder / f"{_MOVING}.partial"
    partial.write_text(json.dumps({n: _identity(results / n) for n in _files(results)}), "utf-8")
    partial.replace(folder / _MOVING)
    try:
        for entry in sorted(results.iterdir()):
            if os.path.lexists(out / entry.name):
                raise _taken(out)
            entry.replace(out / entry.name)
        _finish(out, journal)
    except BaseException:
        _take_back(out, folder)
        raise
    (folder / _MOVING).unlink()


def _finish(out: Path, journal: str) -> None:
    """Remove the journal of a run whose results are in their place."""
    if journal:
        (out / journal).unlink(missing_ok=True)


def _files(folder: Path) -> list[str]:
    """Files at any depth, by their names in the list."""
    found = (p for p in folder.rglob("*") if not p.is_dir() or p.is_symlink())
    return sorted(p.relative_to(folder).as_posix() for p in found)


def _identity(path: Path) -> list[int | str] | None:
    """Device, inode, size and hash of a regular file; None: there is no such file."""
    try:
        found = path.lstat()
        if not stat.S_ISREG(found.st_mode):
            return None
        return [found.st_dev, found.st_ino, found.st_size, sha256(path)]
    except OSError:
        return None


def _listed(folder: Path) -> dict[str, Any]:
    """The list of a scratch folder; empty without one that a run has written."""
    try:
        path = folder / _MOVING
        if path.is_symlink() or path.stat().st_size > _LONGEST_LIST:
            return {}
        found = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    if not isinstance(found, dict) or not all(map(_is_relative, found)):
        return {}
    return found


def _is_relative(name: str) -> bool:
    """Whether a name stays within the folder to which it is joined."""
    parts = name.split("/")
    return "\0" not in name and not any(p in ("", ".", "..") for p in parts)


def _take_back_all(out: Path, own: set[str]) -> set[str]:
    """Revert the moves of killed runs; returns names of their other leftovers.

    Args:
        out: Folder.
        own: Files of an unfinished run that will be resumed.

    Raises:
        TwinError: A file differs from that in the list, or there are others. Nothing was changed.
    """
    dead = set()
    for left in leftovers(out):
        dead.add(left.name)
        listed = _listed(left)
        there = [n for n in listed if os.path.lexists(out / n)]
        if not there or (len(there) == len(listed) and not own):
            continue  # nothing had been moved, or everything
        stranger = _stranger(out, listed, there, own)
        if stranger is not None:
            raise TwinError(
                f"{out}: {stranger} is not what the run that left {left.name} was moving there "
                f"when it was killed. Nothing was removed. Move your files out of it, or choose "
                f"another --out."
            )
        _take_back(out, left)
    return dead


def _stranger(
    out: Path, listed: Mapping[str, Any], there: Sequence[str], own: set[str]
) -> str | None:
    """Name of an entry in an output folder that is not a file of the list; None: there is none."""
    for name in there:
        if not _is_listed(out, name, listed[name]):
            return name
    tops = {PurePosixPath(n).parts[0] for n in there}
    for entry in out.iterdir():
        if entry.name in tops:
            inner = (f"{entry.name}/{n}" for n in _files(entry))
            if (other := next((n for n in inner if n not in listed), None)) is not None:
                return other
        elif entry.name not in own and not entry.name.startswith(PREFIX):
            return entry.name
    return None


def _is_listed(out: Path, name: str, identity: Any) -> bool:
    """Whether a file of an output folder is that of a list, reached without a link."""
    above = [out / p for p in list(PurePosixPath(name).parents)[:-1]]
    return not any(p.is_symlink() for p in above) and _identity(out / name) == identity


def _take_back(out: Path, folder: Path) -> None:
    """Remove files that are still those of the list, and empty folders."""
    listed = _listed(folder)
    for name, identity in listed.items():
        if _is_listed(out, name, identity):
            (out / name).unlink()
    above = {p for n in listed for p in list(PurePosixPath(n).parents)[:-1]}
    for inner in sorted(above, key=lambda p: -len(p.parts)):
        with suppress(OSError):
            (out / inner).rmdir()


def _merge(made: Path, folder: Path) -> None:
    """Move the entries of one folder into another, which retains its other entries."""
    for entry in sorted(made.iterdir()):
        place = folder / entry.name
        if entry.is_dir() and place.is_dir() and not place.is_symlink():
            _merge(entry, place)
        else:
            entry.replace(place)


def sha256(path: Path) -> str:
    """Hash of a file's content."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def json_text(content: Any) -> str:
    """Strict, readable JSON: a NaN is an internal error and raises.

    Half characters, as in the name of a file that is not of UTF-8, are written as escapes.
    """
    text = json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def write_json(path: Path, content: Any) -> None:
    """Write strict, readable JSON to a file."""
    path.write_text(json_text(content), "utf-8")


class InputRecord(Record, frozen=True, kw_only=True):
    """An input file.

    Attributes:
        name: Name of the file.
        sha256: SHA-256 of the file.
    """

    name: str
    sha256: str


class RunRecord(Record, frozen=True, kw_only=True):
    """Record of a run next to its results, for repeating it; equal runs give equal bytes.

    Attributes:
        verb: Verb of the command line.
        options: Options of the call; of `explain`, `indoors` has `indoors` and `source` for each
            flight.
        seed: Seed of the random numbers; null: none are drawn.
        inputs: Input files.
        python: Version of Python.
        packages: Versions, by name.
        fmus: Interface of each FMU of a simulation, by its name in the system.
        incomplete: Failed optional steps with the reason, as "FMUs: the C compiler failed ..."; of
            `simulate`, the reason why the run is incomplete. Missing where it is complete.
    """

    verb: str
    options: dict[str, Any]
    seed: int | None
    inputs: tuple[InputRecord, ...]
    python: str
    packages: dict[str, str]
    fmus: dict[str, str] | UnsetType = UNSET
    incomplete: str | UnsetType = UNSET


def package_versions() -> dict[str, str]:
    """Versions of packages that affect results, by name."""
    return {name: version(name) for name in _PACKAGES}


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
    """Write `run.json`, the settings of the results next to it. No time and no machine: equal runs
    give equal bytes.

    Args:
        out: Folder.
        verb: Verb of the command line.
        options: Options of the call.
        inputs: Input files.
        seed: Seed of the random numbers.
        file: Another file name, where the folder is shared with other runs.
        incomplete: Reason why the results are incomplete, or the failed optional steps; "":
            complete.
        fmus: Interface of each FMU of a simulation, by its name in the system; None: no FMU.
    """
    record = RunRecord(
        verb=verb,
        options=dict(options),
        seed=seed,
        inputs=tuple(InputRecord(name=p.name, sha256=sha256(p)) for p in inputs),
        python=platform.python_version(),
        packages=package_versions(),
        fmus=UNSET if fmus is None else dict(fmus),
        incomplete=incomplete or UNSET,
    )
    write_json(out / file, record.json())
