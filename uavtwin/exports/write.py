"""Components of a vehicle, or its whole twin, as files that FMI tools run."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from fmus.platforms import Platform, compilers, select_platforms
from twin.errors import TwinError

from ..output import results_folder
from ..shown import Shown, TextTable, counted
from .products import Exportable, Starts, WrittenFile, products_of, write_products

Progress = Callable[[float], None]
VERSIONS = (2, 3)
"""Of FMI, that we write."""


@dataclass(frozen=True, slots=True, repr=False)
class ExportResult(Shown):
    """Files that were written.

    Attributes:
        folder: Where.
        files: What.
    """

    folder: Path
    files: tuple[WrittenFile, ...]

    @property
    def paths(self) -> tuple[Path, ...]:
        """Of the files, in the order of the FMI versions."""
        return tuple(self.folder / f.file for f in self.files)

    def sections(self) -> Iterable[str | TextTable]:
        """A row per file, then notes on them."""
        yield f"{counted(self.files, 'file')} in {self.folder}"
        yield TextTable(
            ("file", "FMI", "platforms", "bytes", "sha256"),
            tuple(
                (f.file, str(f.fmi), ", ".join(f.platforms), str(f.bytes), f.sha256)
                for f in self.files
            ),
        )
        yield from (f"{f.file}: {f.note}" for f in self.files if f.note)

    def brief(self) -> str:
        """Names of the files."""
        return f"{type(self).__name__}: {', '.join(f.file for f in self.files)}"


def export(
    what: Exportable,
    path: str | Path,
    *,
    fmi: int | Iterable[int] = 2,
    platforms: str | Iterable[str] = "linux64",
    starts: Mapping[str, float] | None = None,
    python_slave: bool = False,
    arrays: bool = False,
    real_outputs: bool = False,
    progress: Progress = lambda _: None,
) -> ExportResult:
    """Write an FMU, or the whole twin as an `.ssp`.

    Args:
        what: `twin(vehicle)`, `component(NAME, vehicle)`, `replay(flight)`, `compensator(folder)`.
        path: File to write, `.fmu` or, of a twin, `.ssp`; an existing one is replaced. Several FMI
            versions go beside it, into folders of their own: `fmi2/NAME`, `fmi3/NAME`.
        fmi: FMI versions, 2, 3 or both.
        platforms: That it runs on, see `fmus.platforms`.
        starts: Start values baked in, by name of the parameter or input; in a twin "part.name".
        python_slave: Whether Python evaluates it inside the FMU, for prototypes.
        arrays: Whether what belongs together is one array, `pos` for `pos_x` to `pos_z`: FMI 3, and
            no `.ssp`.
        real_outputs: Whether every output is a real number, for importers that know no other; no
            `.ssp`.
        progress: Called with the share done, 0..1.

    Returns:
        The files, with their hashes.

    Raises:
        TwinError: An unknown start value, FMI version or platform, or a missing compiler.
    """
    path, known = Path(path), Starts(dict(starts or {}))
    versions, on = checked_versions(fmi), _platforms(platforms)
    made = products_of(what, known, versions, python_slave, arrays, real_outputs)
    products = {Path(p.file).suffix: p for p in made}
    known.check()
    if path.suffix not in products:
        raise TwinError(f"{path}: this is written as {' or '.join(products)}; name such a file.")
    product = replace(products[path.suffix], file=path.name)
    path.parent.mkdir(parents=True, exist_ok=True)  # others may export into it at the same time
    with results_folder(path.parent, force=True) as folder:
        written = write_products([product], versions, on, folder, progress)
    return ExportResult(path.parent, tuple(written))


def export_parts(
    parts: Sequence[Exportable],
    fmi: int | Iterable[int] = 2,
    platforms: str | Iterable[str] = "linux64",
    starts: Mapping[str, float] | None = None,
    python_slave: bool = False,
    arrays: bool = False,
    real_outputs: bool = False,
) -> Callable[[Path, Progress], list[WrittenFile]]:
    """Check everything, then return the function that writes several into one folder.

    Args:
        parts: What to write, under their own names; of a twin both the `.fmu` and the `.ssp`.
        fmi: As for `export`.
        platforms: As for `export`.
        starts: As for `export`; each part takes those that it has.
        python_slave: As for `export`.
        arrays: As for `export`.
        real_outputs: As for `export`.

    Raises:
        TwinError: As `export`.
    """
    known = Starts(dict(starts or {}))
    versions, on = checked_versions(fmi), _platforms(platforms)
    products = [
        p
        for part in parts
        for p in products_of(part, known, versions, python_slave, arrays, real_outputs)
    ]
    known.check()
    return lambda out, progress: write_products(products, versions, on, out, progress)


def checked_versions(fmi: int | Iterable[int]) -> tuple[int, ...]:
    """FMI versions, in order and each once.

    Raises:
        TwinError: There is none, or one that we do not write.
    """
    versions = tuple(sorted({fmi} if isinstance(fmi, int) else set(fmi)))
    if not versions or not set(versions) <= set(VERSIONS):
        raise TwinError(f"fmi = {fmi}: choose 2, 3 or (2, 3).")
    return versions


def _platforms(names: str | Iterable[str]) -> tuple[Platform, ...]:
    platforms = select_platforms([names] if isinstance(names, str) else names)
    compilers(platforms)  # a missing one is reported before anything is written
    return platforms
