"""Credibility of a twin: eleven factors with a level and its justification.

Factors and the scale 0 to 4 are named after NASA-STD-7009B (2024): for the capability of a model
its data pedigree, verification, validation, technical review and process and product management;
for its results the use, input pedigree, uncertainty, robustness, technical review and management of
the use. The text of the standard defines the levels; the rules here are those of this program, from
files only. They end at 2: further criteria need the judgement of a person. An unknown factor has 0.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Annotated, TypeVar

import msgspec

from twin.errors import TwinError
from twin.vehicle.vehicle import DEFAULT

from ..display import TextTable
from ..output import json_text, sha256
from ..record import Record
from ..vehicles import Vehicle, checked_vehicle, load_vehicle

FILE, PAGE = "documentation/credibility.json", "documentation/credibility.html"
"""Members of an archive, FMU or SSP."""
HIGHEST = 4
"""Highest level of the standard; the rules here give at most 2."""
RESULTS = ("explain.json", "run.json", "vehicle.toml", "accuracy.json")
"""Files in a folder of `explain` on which the card is based."""
UNCHECKED = "named as other programs quote them, not checked against the text of the standard"
"""Note on the factors in the card itself."""
_MADE_UP = "made up"
OF_FLIGHTS = ("uavtwin calibrate,", "uavtwin explain,")
"""Start of sources that refer to flights."""
_MOST_BYTES = 64 * 2**20  # of a result that is read


class FactorRecord(Record, frozen=True, kw_only=True):
    """A factor of credibility.

    Attributes:
        level: Level 0 to 4; 0: nothing is known.
        because: Justification of the level.
    """

    level: int
    because: str


class CredibilityRecord(Record, frozen=True, kw_only=True):
    """Credibility of a twin, as far as files show it.

    Attributes:
        standard: Standard that defines the factors and the scale.
        names: Source of the names of the factors.
        vehicle: Name of the vehicle.
        factors: Factors by name.
        evidence: SHA-256 of files on which the levels are based, by name; flights among them.
        verdicts: Results of explain: `verdict`, and the probability of each effect.
        settings: Settings of explain: their hash, and changed values.
        sources: Source of each number of the vehicle, by its key in the file.
    """

    standard: str
    names: str
    vehicle: str
    factors: dict[str, FactorRecord]
    evidence: dict[str, str]
    verdicts: dict[str, str]
    settings: dict[str, str]
    sources: dict[str, str]


_T = TypeVar("_T")


class _Channel(msgspec.Struct, frozen=True):
    """Fields in use of a `ChannelRecord`."""

    shrink: float | None
    shrink_ci95: tuple[float, float] | None

    @property
    def worse(self) -> bool:
        """Whether the gap grew, even at the lower end of its interval."""
        best = self.shrink if self.shrink_ci95 is None else self.shrink_ci95[1]
        return best is None or best < 0.0


class _HeldOut(msgspec.Struct, frozen=True):
    """Fields in use of a `HeldOutRecord`."""

    flight: str
    spans_s: tuple[tuple[float, float], ...] | None


class _ClosedLoop(msgspec.Struct, frozen=True):
    """Fields in use of a `ClosedLoopRecord`."""

    stable: bool
    missions: dict[str, msgspec.Raw]


class _Effect(msgspec.Struct, frozen=True):
    """Fields in use of an `EffectRecord`."""

    name: str
    probability: float


class _Settings(msgspec.Struct, frozen=True):
    """Fields in use of a `SettingsRecord`."""

    hash: str
    changed: dict[str, object]

    @property
    def said(self) -> dict[str, str]:
        """Hash of the settings, and changed values."""
        return {"hash": self.hash} | {k: str(v) for k, v in self.changed.items()}


class _Explained(msgspec.Struct, frozen=True):
    """Fields in use of explain.json."""

    verdict: str
    effects: tuple[_Effect, ...]
    settings: _Settings
    gap: dict[str, _Channel]
    holdout: tuple[_HeldOut, ...]
    closed_loop: _ClosedLoop | None

    @property
    def verdicts(self) -> dict[str, str]:
        """The verdict, and the probability of each effect."""
        return {"verdict": self.verdict} | {e.name: f"{e.probability:.2f}" for e in self.effects}


class _Input(msgspec.Struct, frozen=True):
    """Fields in use of an `InputRecord`."""

    name: str
    sha256: Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]


class _Run(msgspec.Struct, frozen=True):
    """Fields in use of run.json."""

    inputs: tuple[_Input, ...]


@dataclass(frozen=True, slots=True)
class _Found:
    """Content of a folder of `explain`.

    Attributes:
        content: Content of explain.json.
        files: SHA-256 by name.
    """

    content: _Explained
    files: Mapping[str, str]


def credibility(vehicle: Vehicle, folder: Path | None = None) -> CredibilityRecord:
    """Credibility of a vehicle's twin; `of_file` adds that of an exported file.

    Args:
        vehicle: Vehicle of the twin.
        folder: Folder of `uavtwin explain` with this vehicle as vehicle.toml; None: there is none.

    Raises:
        TwinError: The folder is none of `explain`, or of another vehicle.
    """
    found = None if folder is None else _read(folder, vehicle)
    return CredibilityRecord(
        standard="NASA-STD-7009B",
        names=UNCHECKED,
        vehicle=vehicle.name,
        factors={
            "data_pedigree": _data_pedigree(vehicle),
            "verification": _nothing("no file with reference results"),
            "validation": _validation(found),
            "development_technical_review": _nothing("no review is recorded"),
            "development_process_product_management": _process(found),
            "use_assessment": _nothing("who uses the twin knows for what"),
            "input_pedigree": _nothing("who uses the twin knows its inputs"),
            "uncertainty_characterization": _uncertainty(vehicle),
            "results_robustness": _robustness(found),
            "use_analysis_technical_review": _nothing("no review is recorded"),
            "use_process_product_management": _nothing("uses are not recorded"),
        },
        evidence={} if found is None else dict(found.files),
        verdicts={} if found is None else found.content.verdicts,
        settings={} if found is None else found.content.settings.said,
        sources=dict(vehicle.sources),
    )


def of_file(
    card: CredibilityRecord,
    references: bool,
    changes: Iterable[str] = (),
    evidence: Mapping[str, str] | None = None,
    bands: FactorRecord | None = None,
) -> CredibilityRecord:
    """The card of one file.

    Args:
        card: Card of the twin by its vehicle file.
        references: Whether reference results are included.
        changes: Differences of the file from that twin.
        evidence: SHA-256 of files on which the differences are based, by name.
        bands: Factor of the uncertainty of its outputs; None: not applicable.
    """
    own = dict(card.factors)
    if bands is not None:
        numbers = own["uncertainty_characterization"]
        own["uncertainty_characterization"] = FactorRecord(
            level=max(bands.level, numbers.level), because=f"{numbers.because}; {bands.because}"
        )
    if references:
        own["verification"] = FactorRecord(
            level=1, because="reference results inside; uavtwin verify reruns them"
        )
    if other := ", ".join(changes):
        for name in ("validation", "results_robustness"):
            own[name] = _nothing(f"this is not the twin that flights were held against: {other}")
        if bands is not None and bands.level:
            own["validation"] = FactorRecord(
                level=1, because=f"flights held out were compared by its bands alone: {other}"
            )
    return msgspec.structs.replace(
        card, factors=own, evidence={**card.evidence, **(evidence or {})}
    )


def _nothing(because: str) -> FactorRecord:
    return FactorRecord(level=0, because=because)


def _data_pedigree(vehicle: Vehicle) -> FactorRecord:
    """Level 1: every number in the file has a source; 2: flights are the source of some."""
    given = {k: s for k, s in vehicle.sources.items() if not s.startswith(DEFAULT)}
    made_up = [k for k, s in given.items() if not s or _MADE_UP in s.lower()]
    measured = sum(s.startswith(OF_FLIGHTS) for s in given.values())
    said = f"{measured} of {len(given)} numbers from flights"
    if made_up:
        return _nothing(f"{said}; made up: {', '.join(made_up)}")
    return FactorRecord(level=2 if measured else 1, because=f"{said}, a source for each other")


def _validation(found: _Found | None) -> FactorRecord:
    """Level 1: parts of the flights were held out; 2: whole flights, and no channel got worse
    there."""
    if found is None:
        return _nothing("no flights compared: --evidence names the folder of explain")
    held, gap = found.content.holdout, found.content.gap
    if not held:
        return _nothing("no flight was held out")
    names = ", ".join(h.flight for h in held)
    if not gap:
        return _nothing(f"{names} held out of the fit, but no channel was compared there")
    worse = [n for n, c in gap.items() if c.worse]
    if any(h.spans_s for h in held):
        return FactorRecord(level=1, because=f"parts of {names} held out of the fit")
    if worse:
        because = f"{names} held out; worse there than before: {', '.join(worse)}"
        return FactorRecord(level=1, because=because)
    return FactorRecord(level=2, because=f"{names} held out of the fit; no channel is worse there")


def _uncertainty(vehicle: Vehicle) -> FactorRecord:
    """Level 1: some numbers have a standard deviation; 2, of files: outputs have bands."""
    if not vehicle.deviations:
        return _nothing("no number has a standard deviation")
    known = len(vehicle.deviations)
    return FactorRecord(level=1, because=f"{known} numbers have a standard deviation")


def _robustness(found: _Found | None) -> FactorRecord:
    """Level 1: the missions were flown in closed loop with the estimated numbers."""
    flown = None if found is None else found.content.closed_loop
    if flown is None or not flown.missions:
        return _nothing("no missions were flown with what was found")
    if not flown.stable:
        return _nothing("a mission is lost with what was found")
    because = f"{len(flown.missions)} missions flown, none lost; numbers were not varied"
    return FactorRecord(level=1, because=because)


def _process(found: _Found | None) -> FactorRecord:
    """Level 1: the computation of the numbers can be repeated."""
    if found is None:
        return _nothing("what made the numbers is not recorded")
    return FactorRecord(level=1, because="inputs, options and versions in run.json, hashes here")


def _read(folder: Path, vehicle: Vehicle) -> _Found:
    """Results of `explain`, with the hashes of its inputs."""
    explained = _content(folder, "explain.json", _Explained)
    run = _content(folder, "run.json", _Run)
    own = load_vehicle(folder / "vehicle.toml")
    if own.toml() != checked_vehicle(vehicle, "credibility").toml():
        raise TwinError(
            f"{folder}: its vehicle.toml is not the vehicle of the export, {vehicle.name}: the "
            f"evidence is of another twin. Give --vehicle {folder / 'vehicle.toml'}."
        )
    names = [n for n in RESULTS if (folder / n).is_file()]
    files = {i.name: i.sha256 for i in run.inputs}
    return _Found(explained, files | {n: sha256(folder / n) for n in names})


def _content(folder: Path, name: str, kind: type[_T]) -> _T:
    """Fields in use of a result."""
    try:
        with (folder / name).open("rb") as file:
            return msgspec.json.decode(file.read(_MOST_BYTES), type=kind)
    except (OSError, msgspec.DecodeError) as error:
        raise TwinError(
            f"{folder / name}: {error}. --evidence takes a folder that uavtwin explain wrote."
        ) from None


def check_required(found: CredibilityRecord, wanted: Iterable[str]) -> None:
    """Refuse a twin below required levels.

    Args:
        found: Card of the twin.
        wanted: Required levels, "FACTOR=LEVEL" texts.

    Raises:
        TwinError: A text has another form, or a factor has a lower level.
    """
    for text in wanted:
        name, _, number = text.partition("=")
        if name not in found.factors or not number.isdigit() or int(number) > HIGHEST:
            known = ", ".join(found.factors)
            raise TwinError(
                f"--require {text}: write FACTOR=LEVEL, 0 to {HIGHEST}, of {known}; e.g. "
                f"validation=2."
            )
        factor = found.factors[name]
        if factor.level < int(number):
            raise TwinError(
                f"{found.vehicle}: {name} has level {factor.level}, {number} is required: "
                f"{factor.because}."
            )


def members(found: CredibilityRecord) -> dict[str, bytes]:
    """The card as members of an archive: machine-readable and as a page."""
    rows = tuple((n, str(f.level), f.because) for n, f in found.factors.items())
    tables = (
        TextTable(("factor", "level, 0 to 4", "because"), rows).html(),
        TextTable(("file", "SHA-256"), tuple(found.evidence.items())).html(),
    )
    page = (
        "<!DOCTYPE html><html lang='en'><meta charset='utf-8'><title>Credibility</title>"
        f"<h1>Credibility of {escape(found.vehicle)}</h1><p>Factors of {found.standard}: "
        f"{found.names}. "
        f"Levels are by rules of uavtwin, from files alone; a person has to judge the rest.</p>"
        f"{''.join(tables)}</html>\n"
    )
    return {FILE: json_text(found.json()).encode(), PAGE: page.encode()}
