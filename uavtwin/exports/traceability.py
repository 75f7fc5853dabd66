"""Traceability of an exported twin: sources, settings and hashes, in machine-readable form.

Two files of the SSP Layered Standard Traceability 1.0, sections SRMD, STMD and packaging.
Simulation resource meta data (SRMD) of an archive, FMU or SSP, contain the source of each number of
the vehicle, and its card of credibility. Simulation task meta data (STMD) of an .ssp contain its
derivation: flights and settings of each number, and the basis of its verdicts. A file that is not
included is identified by its SHA-256 (RFC 6920).
"""

import re
import zipfile
from base64 import urlsafe_b64encode
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from hashlib import sha256
from pathlib import Path, PurePath
from uuid import NAMESPACE_URL, uuid5

from lxml import etree

from cosim.ssp.read import SSD_FILE
from fmus.description import dated

from .credibility import FILE, OF_FLIGHTS, RESULTS, CredibilityRecord

SRMD = "extra/org.ssp-standard.ssp-traceability.srmd/resourceMetaData.srmd"
STMD = "extra/org.ssp-standard.ssp-traceability.stmd/SimulationTask.stmd"
"""Members of an archive; the second only of an .ssp."""
_VERSION = "1.0.0"
_SPACES = {
    k: f"http://ssp-standard.org/SSPTraceability1/{v}"
    for k, v in (
        ("srmd", "SimulationResourceMetaData"),
        ("stmd", "SimulationTaskMetaData"),
        ("stc", "SSPTraceabilityCommon"),
    )
} | {"xlink": "http://www.w3.org/1999/xlink"}
_ROOT = "../../"
"""Path of the archive's root, from the folder of either file."""


def _tag(name: str) -> str:
    """Name of an element or attribute, "prefix:name", as in lxml."""
    prefix, _, local = name.partition(":")
    return f"{{{_SPACES[prefix]}}}{local}"


def members(found: CredibilityRecord, path: Path) -> dict[str, bytes]:
    """Members of an archive in addition to its card."""
    traces = {SRMD: resource_meta_data(found)}
    if path.suffix == ".ssp":
        with zipfile.ZipFile(path) as archive:
            fmus = {n: archive.read(n) for n in archive.namelist() if n.endswith(".fmu")}
        traces[STMD] = task_meta_data(found, fmus)
    return traces


def resource_meta_data(found: CredibilityRecord) -> bytes:
    """SRMD: the sources of all numbers, the card, and hashes."""
    root = _document("srmd:SimulationResourceMetaData", found)
    _classified(root, "sources", found.sources)
    _classified(root, "credibility", _levels(found))
    _classified(root, "verdicts", found.verdicts)
    _classified(root, "settings", found.settings)
    _classified(root, "evidence.sha256", found.evidence)
    return _text(root)


def task_meta_data(found: CredibilityRecord, fmus: Mapping[str, bytes]) -> bytes:
    """STMD of an .ssp with these FMUs, by the names of its members."""
    root = _document("stmd:SimulationTaskMetaData", found)
    ids = {name: f"file_{i}" for i, name in enumerate(found.evidence, start=1)}
    given = [n for n in ids if n not in RESULTS]
    results = [n for n in ("explain.json", "accuracy.json") if n in ids]
    made = etree.SubElement(root, _tag("stmd:ImplementationPhase"))
    model = _step(made, "ImplementModel", "Output")["Output"]
    for name in sorted(fmus):
        fmu = _resource(model, "model", "application/x-fmu-sharedlibrary", _ROOT + name)
        _classified(fmu, "sha256", {PurePath(name).name: sha256(fmus[name]).hexdigest()})
    numbers = _step(made, "ImplementParameter", "Input", "Procedure", "Output", "")
    for name in given:
        _evidence(numbers["Input"], name, ids, found.evidence)
    _evidence(numbers["Procedure"], "run.json", ids, found.evidence, "configuration")
    _evidence(numbers["Output"], "vehicle.toml", ids, found.evidence, "parameter")
    _resource(numbers["Output"], "document", "application/x-srmd-meta-data", _ROOT + SRMD)
    _classified(numbers[""], "derivation", _derived(found.sources, given, ids))
    whole = _step(made, "IntegrateSimulation", "Output")["Output"]
    _resource(whole, "system", "application/x-ssp-definition", _ROOT + SSD_FILE)
    judged = etree.SubElement(root, _tag("stmd:EvaluationPhase"))
    if results:
        step = _step(judged, "EvaluateSimulationResults", "Input", "Procedure", "Output", "")
        _refer(step["Input"], (ids[n] for n in given))
        _refer(step["Procedure"], (ids[n] for n in ("run.json",) if n in ids))
        _classified(step["Procedure"], "settings", found.settings)
        for name in results:
            _evidence(step["Output"], name, ids, found.evidence, "result")
        _classified(step[""], "verdicts", found.verdicts)
    card = _step(judged, "DeriveSimulationQualityVerdict", "Input", "Output", "")
    _refer(card["Input"], (ids[n] for n in results))
    _resource(card["Output"], "report", "application/json", _ROOT + FILE)
    _classified(card[""], "credibility", _levels(found))
    root.set("GUID", str(uuid5(NAMESPACE_URL, sha256(_text(root)).hexdigest())))
    return _text(root)


def _document(name: str, found: CredibilityRecord) -> etree._Element:
    """An empty document."""
    root = etree.Element(_tag(name), nsmap=_SPACES, version=_VERSION, name=_printed(found.vehicle))
    for key, value in {"generationTool": "uavtwin", **dated()}.items():
        root.set(key, value)
    return root


def _levels(found: CredibilityRecord) -> dict[str, str]:
    return {n: f"{f.level}: {f.because}" for n, f in found.factors.items()}


def _step(phase: etree._Element, name: str, *particles: str) -> dict[str, etree._Element]:
    """Particles of a step by name; "": the step itself, with classifications last."""
    step = etree.SubElement(phase, _tag(f"stmd:{name}"))
    return {p: etree.SubElement(step, _tag(f"stc:{p}")) if p else step for p in particles}


def _resource(where: etree._Element, kind: str, mime: str, source: str) -> etree._Element:
    return etree.SubElement(where, _tag("stc:Resource"), kind=kind, type=mime, source=source)


def _evidence(
    where: etree._Element,
    name: str,
    ids: Mapping[str, str],
    hashes: Mapping[str, str],
    kind: str = "document",
) -> None:
    """Add a file that is not included, if there is such evidence."""
    if name not in ids:
        return
    digest = urlsafe_b64encode(bytes.fromhex(hashes[name])).decode().rstrip("=")
    mime = "application/json" if name.endswith(".json") else "application/octet-stream"
    made = _resource(where, kind, mime, f"ni:///sha-256;{digest}")
    made.set("id", ids[name])
    made.set("description", _printed(name))
    _classified(made, "sha256", {name: hashes[name]})


def _refer(where: etree._Element, ids: Iterable[str]) -> None:
    """Add references to resources elsewhere in the document."""
    for own in ids:
        etree.SubElement(where, _tag("stc:ResourceReference"), {_tag("xlink:href"): f"#{own}"})


def _derived(
    sources: Mapping[str, str], given: Sequence[str], ids: Mapping[str, str]
) -> dict[str, str]:
    """Number -> resources of its flights, known by hash or by name only."""
    stems = Counter(PurePath(n).stem for n in given if not n.endswith(".toml"))
    own = {PurePath(n).stem: ids[n] for n in given if not n.endswith(".toml")}
    named = {
        k: [own[n] for n, count in stems.items() if count == 1 and _names(s, n)]
        for k, s in sources.items()
        if s.startswith(OF_FLIGHTS)
    }
    return {k: " ".join(found) for k, found in named.items() if found}


def _names(source: str, flight: str) -> bool:
    """Whether the source of a number, "uavtwin explain, a and b, 0.1 to 0.2", names a flight."""
    return re.search(rf"(, | and ){re.escape(flight)}(?=, | and |$)", source) is not None


def _classified(where: etree._Element, kind: str, entries: Mapping[str, str]) -> None:
    """Add keywords with their values, if there are any."""
    if not entries:
        return
    part = etree.SubElement(where, _tag("stc:Classification"), type=f"uavtwin.{kind}")
    for keyword, value in entries.items():
        entry = etree.SubElement(part, _tag("stc:ClassificationEntry"), keyword=_printed(keyword))
        entry.text = _printed(value)


def _text(root: etree._Element) -> bytes:
    text: bytes = etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    return text


def _printed(text: str) -> str:
    """The text with a question mark for each character that XML does not allow."""
    return "".join(c if c.isprintable() else "?" for c in text)
