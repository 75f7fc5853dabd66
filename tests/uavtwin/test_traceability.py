"""Traces of an export: valid by schemas of the standard, from numbers to hashes of flights."""

import json
import zipfile
from base64 import urlsafe_b64decode
from functools import cache
from hashlib import sha256
from importlib.resources import files
from pathlib import Path, PurePosixPath
from typing import Any

import pytest
from explained_rig import COPTER, explained
from lxml import etree

import uavtwin as ut
from cosim.ssp.read import SSD_FILE
from uavtwin.exports.credibility import FILE, CredibilityRecord
from uavtwin.exports.traceability import SRMD, STMD, resource_meta_data, task_meta_data

_STEPS = {
    "ImplementationPhase": ("ImplementModel", "ImplementParameter", "IntegrateSimulation"),
    "EvaluationPhase": ("EvaluateSimulationResults", "DeriveSimulationQualityVerdict"),
}
"""Of STMD, those that we write, in the order of the specification."""


@cache
def schemas() -> Path:
    """Folder of the published schemas: SSP 2.0, SRMD and the common part of the traceability."""
    return Path(str(files(pytest.importorskip("pyssp_standard")) / "resources"))


@cache
def schema(kind: str) -> Any:
    """Of "SRMD" or "STMD". No package has that of STMD: its phases and steps are written out here
    after its section, the types of their content are the published ones."""
    xmlschema = pytest.importorskip("xmlschema")
    if kind == "SRMD":
        return xmlschema.XMLSchema11(str(schemas() / "SRMD11.xsd"), allow="local")
    phases = "".join(
        f'<xs:element name="{phase}" minOccurs="0"><xs:complexType><xs:sequence>'
        + "".join(f'<xs:element name="{s}" type="stc:StepType" minOccurs="0"/>' for s in steps)
        + '<xs:group ref="stc:GPhaseCommon"/></xs:sequence></xs:complexType></xs:element>'
        for phase, steps in _STEPS.items()
    )
    space = "http://ssp-standard.org/SSPTraceability1/"
    common = "http://ssp-standard.org/SSP1/SystemStructureCommon"
    text = (
        f'<xs:schema xmlns:xs="http://www.w3.org/2001/XMLSchema" elementFormDefault="qualified" '
        f'xmlns:stc="{space}SSPTraceabilityCommon" xmlns:ssc="{common}" '
        f'targetNamespace="{space}SimulationTaskMetaData">'
        f'<xs:import namespace="{common}" schemaLocation="SystemStructureCommon.xsd"/>'
        f'<xs:import namespace="{space}SSPTraceabilityCommon" schemaLocation="STC11.xsd"/>'
        '<xs:element name="SimulationTaskMetaData"><xs:complexType><xs:sequence>'
        f'<xs:element name="GeneralInformation" type="stc:GeneralInformationType" minOccurs="0"/>'
        f'{phases}<xs:group ref="stc:GElementCommon"/></xs:sequence>'
        '<xs:attribute name="version" type="xs:string" use="required"/>'
        '<xs:attribute name="name" type="xs:string" use="required"/>'
        '<xs:attribute name="GUID" type="xs:string" use="required"/>'
        '<xs:attributeGroup ref="ssc:ABaseElement"/>'
        '<xs:attributeGroup ref="ssc:ATopLevelMetaData"/>'
        "</xs:complexType></xs:element></xs:schema>"
    )
    return xmlschema.XMLSchema11(text, base_url=f"{schemas()}/", allow="local")


def faults(kind: str, content: bytes) -> list[str]:
    """What the schema finds."""
    return [str(e.reason) for e in schema(kind).iter_errors(etree.fromstring(content))]


def card_of(folder: Path) -> CredibilityRecord:
    return ut.credibility(ut.load_vehicle(folder / "vehicle.toml"), folder)


def entries(root: etree._Element, kind: str) -> dict[str, str]:
    """Of the classifications of a kind."""
    found = root.iterfind(
        f".//{{*}}Classification[@type='uavtwin.{kind}']/{{*}}ClassificationEntry"
    )
    return {e.get("keyword", ""): e.text or "" for e in found}


def test_every_number_has_its_source(tmp_path: Path) -> None:
    found = card_of(explained(tmp_path / "a"))
    written = resource_meta_data(found)
    assert faults("SRMD", written) == []
    assert faults("SRMD", written.replace(b"keyword=", b"key="))
    root = etree.fromstring(written)
    vehicle = ut.load_vehicle(tmp_path / "a" / "vehicle.toml")
    assert entries(root, "sources").keys() == vehicle.sources.keys()
    assert entries(root, "sources")["effects.rotor_drag.k_xy_1_s"] == "uavtwin explain, a"
    assert entries(root, "evidence.sha256")["a.ulg"] == "0" * 64
    assert entries(root, "credibility")["validation"].startswith("2: b held out")
    assert entries(root, "verdicts") == {"verdict": "named", "rotor_drag": "0.97"}
    assert entries(root, "settings") == {"hash": "0123456789ab", "prior": "2"}


def test_a_name_that_xml_may_not_have_is_printed(tmp_path: Path) -> None:
    folder = explained(tmp_path / "a")
    odd = [{"name": "\x1b[31m", "sha256": "0" * 64}]
    (folder / "run.json").write_text(json.dumps({"inputs": odd}))
    for written in (resource_meta_data(card_of(folder)), task_meta_data(card_of(folder), {})):
        assert b'keyword="?[31m"' in written


def test_numbers_and_verdicts_lead_to_hashes(tmp_path: Path) -> None:
    folder = explained(tmp_path / "a")
    inputs = [{"name": f"{n}.ulg", "sha256": str(i) * 64} for i, n in enumerate(("a", "a_2", "b"))]
    (folder / "run.json").write_text(json.dumps({"inputs": inputs}))
    written = task_meta_data(card_of(folder), {"resources/x.fmu": b"x"})
    assert faults("STMD", written) == []
    assert faults("STMD", written.replace(b"stc:Output", b"stc:Outcome"))
    root = etree.fromstring(written)
    resources = {r.get("id"): r for r in root.iter("{*}Resource") if r.get("id")}
    (taught_by,) = entries(root, "derivation").values()
    flight = resources[taught_by]
    assert flight.get("description") == "a.ulg"
    digest = flight.get("source", "").removeprefix("ni:///sha-256;")
    assert urlsafe_b64decode(f"{digest}=").hex() == "0" * 64
    for reference in root.iter("{*}ResourceReference"):
        assert reference.get("{http://www.w3.org/1999/xlink}href", "")[1:] in resources
    judged = root.find(".//{*}EvaluateSimulationResults")
    assert judged is not None
    assert entries(judged, "settings")["hash"] == "0123456789ab"
    assert entries(judged, "verdicts")["rotor_drag"] == "0.97"
    shown = {r.get("description"): entries(r, "sha256") for r in resources.values()}
    for name in ("explain.json", "run.json", "vehicle.toml"):
        assert shown[name] == {name: sha256((folder / name).read_bytes()).hexdigest()}
    assert entries(root, "sha256")["x.fmu"] == sha256(b"x").hexdigest()


def test_other_content_has_another_guid() -> None:
    card = ut.credibility(ut.load_vehicle(COPTER))
    one, same, other = (task_meta_data(card, {"a.fmu": x}) for x in (b"1", b"1", b"2"))
    assert one == same
    assert etree.fromstring(one).get("GUID") != etree.fromstring(other).get("GUID")
    assert faults("STMD", one) == []


@pytest.mark.slow
def test_an_ssp_of_a_twin_is_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Everything that its traces name lies in it, and its structure is valid by SSP 2.0."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    folder = explained(tmp_path / "a")
    vehicle = ut.load_vehicle(folder / "vehicle.toml")
    path = tmp_path / "twin.ssp"
    ut.export(ut.twin(vehicle, drive="command"), path, card=card_of(folder))
    with zipfile.ZipFile(path) as archive:
        members = {n: archive.read(n) for n in archive.namelist()}
    assert (faults("SRMD", members[SRMD]), faults("STMD", members[STMD])) == ([], [])
    root, here = etree.fromstring(members[STMD]), PurePosixPath(STMD).parent
    named = [r.get("source", "") for r in root.iter("{*}Resource") if not r.get("id")]
    within = {str(here.joinpath(s).relative_to(here / "../..")) for s in named}
    assert within <= members.keys()
    assert {FILE, SRMD, SSD_FILE} <= within
    assert {n for n in members if n.endswith(".fmu")} <= within
    hashes = entries(root, "sha256")
    assert all(
        hashes[PurePosixPath(n).name] == sha256(data).hexdigest()
        for n, data in members.items()
        if n.endswith(".fmu")
    )
    rules = etree.XMLSchema(file=str(schemas() / "ssp2" / "SystemStructureDescription.xsd"))
    rules.assertValid(etree.fromstring(members[SSD_FILE]))
    dated = "2023-11-14T22:13:20Z"
    for name in (SRMD, STMD, SSD_FILE):
        assert etree.fromstring(members[name]).get("generationDateAndTime") == dated


@pytest.mark.parametrize(
    ("names", "source", "found"),
    [
        (["a.ulg", "b.ulg"], "a and b", ["a.ulg", "b.ulg"]),
        (["a.ulg", "a.toml"], "a", ["a.ulg"]),
        (["a.ulg", "a.csv", "b.bin"], "a and b", ["b.bin"]),
        (["salt and pepper.ulg"], "salt and pepper", ["salt and pepper.ulg"]),
    ],
)
def test_a_number_leads_to_the_flights_that_it_names(
    tmp_path: Path, names: list[str], source: str, found: list[str]
) -> None:
    folder = explained(tmp_path / "a")
    inputs = [{"name": n, "sha256": str(i) * 64} for i, n in enumerate(names)]
    (folder / "run.json").write_text(json.dumps({"inputs": inputs}))
    file = folder / "vehicle.toml"
    file.write_text(file.read_text().replace("uavtwin explain, a", f"uavtwin explain, {source}"))
    root = etree.fromstring(task_meta_data(card_of(folder), {}))
    resources = {r.get("id"): r.get("description") for r in root.iter("{*}Resource")}
    (taught_by,) = entries(root, "derivation").values()
    assert [resources[i] for i in taught_by.split()] == found
