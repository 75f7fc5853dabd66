"""Writer of components of a vehicle, or its whole twin, as files for FMI tools: one per product and
FMI version.
"""

import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from cosim.ssp import write_ssp
from cosim.whole_twin import COMPENSATOR, fused_model, parts_of, system_of
from fmus import FmuModel, build, component_model
from fmus.builder import extend_archive
from fmus.compensator import NetworkFile, UnsupportedNetworkError, native_model
from fmus.model import with_real_outputs
from fmus.platforms import Platform, compilers, select_platforms
from fmus.python_slave.build import build_network_slave, build_python_slave
from fmus.reference_results import add_reference_results
from twin.component import Component, unknown_name
from twin.errors import TwinError
from twin.formatting import counted

from ..display import DisplayMixin, TextTable
from ..output import results_folder, sha256
from ..record import Record
from ..vehicles import GROUNDED
from .credibility import CredibilityRecord, FactorRecord, check_required, members, of_file
from .parts import LAWLESS, Twin, with_reason
from .traceability import members as traces

Exportable = Component | FmuModel | NetworkFile | Twin
KNOWN = "accuracy.known"
"""Parameter of a twin with bands: whether it equals the compared one."""

NEVER_VALID = "accuracy.valid is always false"
"""Note on a twin without valid bands."""


@dataclass(slots=True)
class Starts:
    """Start values given by a user, and the names to which they apply.

    Attributes:
        values: Values by name; "part.name" for the whole twin.
        known: Names in the objects to export.
    """

    values: Mapping[str, float]
    known: set[str] = field(default_factory=set)

    def of(self, part: Component | FmuModel, name: str = "") -> dict[str, float]:
        """Start values of one part; `name`: its name in the whole twin."""
        prefix = f"{name}." if name else ""
        settable = {v.name for v in part.variables if v.causality != "output"}
        self.known |= {prefix + n for n in settable}
        return {n: self.values[prefix + n] for n in settable if prefix + n in self.values}

    def check(self) -> None:
        """Refuse names that do not exist.

        Raises:
            TwinError: There is one.
        """
        for name in self.values:
            if name not in self.known:
                raise TwinError(unknown_name("start value", "parameter or input", name, self.known))


@dataclass(frozen=True, slots=True)
class Product:
    """One file per FMI version.

    Attributes:
        file: Name of the file.
        write: `(path, FMI version, platforms)`: write it.
        note: Note for the user, or "".
        model: Model of a native FMU; None: another kind of file.
        references: Whether reference results are added.
        card: Card of its credibility; None: none is included.
    """

    file: str
    write: Callable[[Path, int, Sequence[str]], object]
    note: str = ""
    model: FmuModel | None = None
    references: bool = False
    card: CredibilityRecord | None = None


class WrittenFile(Record, frozen=True, kw_only=False, omit_defaults=True):
    """A file that was written.

    Attributes:
        file: Path of the file, relative to the folder of the export.
        fmi: FMI version.
        platforms: Platforms with binaries in it.
        bytes: Size of the file.
        sha256: Hash of its content.
        note: Note for the user; missing without one.
    """

    file: str
    fmi: int
    platforms: tuple[str, ...]
    bytes: int
    sha256: str
    note: str = ""


def products_of(
    what: Exportable,
    starts: Starts,
    versions: Sequence[int],
    python_slave: bool = False,
    arrays: bool = False,
    real_outputs: bool = False,
) -> list[Product]:
    """Files of one object to export; the whole twin has two, fused and as `.ssp`.

    Args:
        what: Object to export.
        starts: Start values, of which its own are used.
        versions: Requested FMI versions.
        python_slave: Whether Python evaluates it inside the FMU, for prototypes.
        arrays: Whether groups of variables are arrays; no `.ssp` then.
        real_outputs: Whether every output is a real number; no `.ssp` then.

    Raises:
        TwinError: It cannot be written in this form.
    """
    if real_outputs:
        if python_slave:
            raise TwinError("real outputs are of native FMUs; leave out the Python slave.")
        typed = products_of(what, starts, versions, arrays=arrays)
        models = ((with_real_outputs(p.model), p.note) for p in typed if p.model is not None)
        return [replace(_native(model), note=note) for model, note in models]
    if arrays:
        if list(versions) != [3] or python_slave:
            raise TwinError("arrays are of FMI 3 and native FMUs; ask for that version alone.")
        scalar = products_of(what, starts, versions)
        return [_with_arrays(p.model, p.note) for p in scalar if p.model is not None]
    if python_slave and (list(versions) != [2] or not isinstance(what, Component | NetworkFile)):
        raise TwinError("a Python slave speaks FMI 2 and is one component; leave the rest native.")
    if isinstance(what, Twin):
        return _twin_products(what, starts)
    if isinstance(what, NetworkFile):
        return [_compensator_product(what, versions, python_slave, starts)]
    if isinstance(what, Component):
        ready = what.with_starts(starts.of(what))
        native = not python_slave
        made = (
            _native(component_model(ready, exchange=ready.for_solvers)) if native else _slave(ready)
        )
        return [replace(made, note=_grounded(what.description))]
    if isinstance(what, FmuModel):
        return [_native(what.with_starts(starts.of(what)))]
    raise TwinError(
        f"export: a {type(what).__name__} cannot be exported. Give twin(vehicle), component(NAME, "
        f"vehicle), replay(flight) or compensator(folder)."
    )


def _native(model: FmuModel) -> Product:
    def write(path: Path, fmi: int, platforms: Sequence[str]) -> None:
        build(model, path, fmi, platforms)
        if not model.arrays:  # experiments have scalars in their tables
            add_reference_results(path, model, fmi)

    return Product(f"{model.name}.fmu", write, model=model, references=not model.arrays)


def _with_arrays(model: FmuModel, note: str) -> Product:
    return replace(_native(replace(model, arrays=True)), note=note)


def _slave(component: Component) -> Product:
    return Product(f"{component.name}.fmu", lambda path, *_: build_python_slave(component, path))


def _compensator_product(
    network: NetworkFile, versions: Sequence[int], python_slave: bool, starts: Starts
) -> Product:
    """Native FMU; a Python slave on request, or if the C generator does not support the network."""
    if not python_slave:
        try:
            model = native_model(network)
            return _native(model.with_starts(starts.of(model)))
        except UnsupportedNetworkError as refusal:
            if list(versions) != [2]:
                raise TwinError(
                    f"{network.path}: {refusal}. A Python slave can run it, for FMI 2 alone."
                ) from None
            note = f"{refusal}; so it is a Python slave: its host must be Python with onnxruntime"
            return replace(_network_slave(network), note=note)
    return _network_slave(network)


def _network_slave(network: NetworkFile) -> Product:
    return Product("compensator.fmu", lambda path, *_: build_network_slave(network, path))


def _twin_products(twin: Twin, starts: Starts) -> list[Product]:
    """The fused FMU and the `.ssp`."""
    compensator = None
    if twin.compensator is not None:
        try:
            compensator = native_model(twin.compensator)
        except UnsupportedNetworkError as refusal:
            raise TwinError(
                f"{twin.compensator.path}: {refusal}. The corrected twin is native; export the "
                f"compensator alone, as a Python slave."
            ) from None
    parts = parts_of(twin.assembly, compensator)
    own = {name: starts.of(part, name) for name, part in parts.items()}
    assembly = twin.assembly.with_starts(
        {f"{name}.{n}": x for name in twin.assembly.parts for n, x in own[name].items()}
    )
    bands = _bands(twin, starts)
    if bands != twin.bands:
        assembly = assembly.with_starts({KNOWN: 0.0})
    if compensator is not None:
        compensator = compensator.with_starts(own[COMPENSATOR])

    def write(path: Path, fmi: int, platforms: Sequence[str]) -> None:
        """Write the `.ssp`, with its FMUs built next to it and then removed."""
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=".parts") as folder:
            system = system_of(assembly, Path(folder), fmi, platforms, compensator=compensator)
            for name, part in parts_of(assembly, compensator).items():
                model = component_model(part) if isinstance(part, Component) else part
                add_reference_results(system.fmus[name], model, fmi)
            write_ssp(system, path)

    fused = fused_model(assembly, twin.name, compensator)
    fused = replace(fused, description=with_reason(fused.description, twin.grounded))
    note = _grounded(fused.description)
    system = Product(f"{fused.name}.ssp", write, references=True)
    said = [note] * bool(note) + [c for c in twin.changes if c == LAWLESS]
    if bands is not None and not bands.level:
        said.append(f"{NEVER_VALID}: {bands.because}")
    return [replace(_native(fused), note="; ".join(said)), replace(system, note=note)]


def _bands(twin: Twin, starts: Starts) -> FactorRecord | None:
    """Factor for the bands of a twin: with other start values it is not the compared one, except
    for the pressure of the day, which differed between flights."""
    others = [n for n in starts.values if not n.endswith("barometer.ground_pressure")]
    if twin.bands is None or not twin.bands.level or not others:
        return twin.bands
    return FactorRecord(level=0, because="bands of outputs: start values are set")


def _grounded(description: str) -> str:
    """Text for the description of a twin that cannot fly; "": it can."""
    _, mark, why = description.partition(GROUNDED)
    return mark + why


def write_products(
    products: Sequence[Product],
    versions: Sequence[int],
    platforms: Sequence[Platform],
    out: Path,
    progress: Callable[[float], None],
) -> list[WrittenFile]:
    """Write all products, with their cards of credibility; several FMI versions each into a
    separate folder, `fmi2`, `fmi3`."""
    names = tuple(p.name for p in platforms)
    written: list[WrittenFile] = []
    for version in versions:
        folder = out if len(versions) == 1 else out / f"fmi{version}"
        folder.mkdir(exist_ok=True)
        for product in products:
            path = folder / product.file
            product.write(path, version, names)
            if product.card is not None:
                extend_archive(path, members(product.card) | traces(product.card, path))
            written.append(
                WrittenFile(
                    str(path.relative_to(out)),
                    version,
                    names,
                    path.stat().st_size,
                    sha256(path),
                    product.note,
                )
            )
            progress(len(written) / (len(versions) * len(products)))
    return written


Progress = Callable[[float], None]
VERSIONS = (2, 3)
"""Supported FMI versions."""


@dataclass(frozen=True, slots=True, repr=False)
class ExportResult(DisplayMixin):
    """Files that were written.

    Attributes:
        folder: Folder of the export.
        files: Written files.
    """

    folder: Path
    files: tuple[WrittenFile, ...]

    @property
    def paths(self) -> tuple[Path, ...]:
        """Paths of the files, in the order of the FMI versions."""
        return tuple(self.folder / f.file for f in self.files)

    def findings(self) -> Iterable[str | TextTable]:
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
    card: CredibilityRecord | None = None,
    progress: Progress = lambda _: None,
) -> ExportResult:
    """Write an FMU, or the whole twin as an `.ssp`.

    Args:
        what: Result of `twin(vehicle)`, `component(NAME, vehicle)`, `replay(flight)` or
            `compensator(folder)`.
        path: File to write, `.fmu` or, of a twin, `.ssp`; an existing one is replaced. Several FMI
            versions are written to folders next to it: `fmi2/NAME`, `fmi3/NAME`.
        fmi: FMI versions, 2, 3 or both.
        platforms: Platforms of the binaries, see `fmus.platforms`.
        starts: Start values in the file, by name of the parameter or input; in a twin "part.name".
        python_slave: Whether Python evaluates it inside the FMU, for prototypes.
        arrays: Whether groups of variables are one array, `pos` for `pos_x` to `pos_z`: FMI 3, and
            no `.ssp`.
        real_outputs: Whether every output is a real number, for importers without other types; no
            `.ssp`.
        card: Card from `credibility` to include; None: none.
        progress: Called with the completed share, 0..1.

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
    product = replace(_with_card(products[path.suffix], what, known, card), file=path.name)
    path.parent.mkdir(parents=True, exist_ok=True)  # others may create it at the same time
    with results_folder(path.parent, force=True) as folder:
        written = write_products([product], versions, on, folder, progress)
    return ExportResult(path.parent, tuple(written))


@contextmanager
def temporary_fmu(what: Exportable) -> Iterator[Path]:
    """Context with the FMU of an object, as of `export`, in a temporary folder."""
    with tempfile.TemporaryDirectory() as place:
        yield export(what, Path(place, "twin.fmu")).paths[0]


def export_parts(
    parts: Sequence[Exportable],
    fmi: int | Iterable[int] = 2,
    platforms: str | Iterable[str] = "linux64",
    starts: Mapping[str, float] | None = None,
    python_slave: bool = False,
    arrays: bool = False,
    real_outputs: bool = False,
    card: CredibilityRecord | None = None,
    require: Iterable[str] = (),
) -> Callable[[Path, Progress], list[WrittenFile]]:
    """Check all options, then return the function that writes several objects into one folder.

    Args:
        parts: Objects to write, under their own names; of a twin both the `.fmu` and the `.ssp`.
        fmi: FMI versions, as in `export`.
        platforms: Platforms, as in `export`.
        starts: Start values, as in `export`; each part uses its own.
        python_slave: Whether Python evaluates them, as in `export`.
        arrays: Whether groups are arrays, as in `export`.
        real_outputs: Whether outputs are real, as in `export`.
        card: Card of credibility, as in `export`.
        require: Required levels of each file's card, as "FACTOR=LEVEL".

    Raises:
        TwinError: As in `export`, or a level is lower.
    """
    known = Starts(dict(starts or {}))
    versions, on = checked_versions(fmi), _platforms(platforms)
    products = [
        _with_card(p, part, known, card)
        for part in parts
        for p in products_of(part, known, versions, python_slave, arrays, real_outputs)
    ]
    known.check()
    for product in products:
        if product.card is not None:
            check_required(product.card, require)
    return lambda out, progress: write_products(products, versions, on, out, progress)


def _with_card(
    product: Product, what: Exportable, starts: Starts, card: CredibilityRecord | None
) -> Product:
    """The product with the card of its file."""
    if card is None:
        return product
    changes = [f"{name} = {value:g}" for name, value in starts.values.items()]
    evidence: Mapping[str, str] = {}
    bands = None
    if isinstance(what, Twin):
        changes, evidence, bands = [*changes, *what.changes], what.evidence, _bands(what, starts)
    return replace(product, card=of_file(card, product.references, changes, evidence, bands))


def checked_versions(fmi: int | Iterable[int]) -> tuple[int, ...]:
    """FMI versions in order, without duplicates.

    Raises:
        TwinError: There is none, or one is not supported.
    """
    versions = tuple(sorted({fmi} if isinstance(fmi, int) else set(fmi)))
    if not versions or not set(versions) <= set(VERSIONS):
        raise TwinError(f"fmi = {fmi}: choose 2, 3 or (2, 3).")
    return versions


def _platforms(names: str | Iterable[str]) -> tuple[Platform, ...]:
    platforms = select_platforms([names] if isinstance(names, str) else names)
    compilers(platforms)  # a missing one is reported before anything is written
    return platforms
