"""The card of credibility: levels by rule, honest zeros, refused below what is asked for."""

import json
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from cli_rig import run
from explained_rig import COPTER, explained
from kinds import recorded

import uavtwin as ut
from fmus.experiments import MANIFEST
from twin.errors import TwinError
from uavtwin.exports.credibility import FILE, PAGE, check_required, members, of_file
from uavtwin.exports.parts import LAWLESS, learned
from uavtwin.exports.write import Exportable, export_parts

WORSE = {"before": 0.5, "after": 0.7, "shrink": -0.4, "shrink_ci95": [-0.6, -0.2]}


def levels(folder: Path) -> dict[str, int]:
    card = ut.credibility(ut.load_vehicle(folder / "vehicle.toml"), folder)
    return {name: factor.level for name, factor in card.factors.items()}


def test_nothing_known_is_zero() -> None:
    factors = ut.credibility(ut.load_vehicle(COPTER)).factors
    assert len(factors) == 11
    assert not any(f.level for f in factors.values())
    assert "made up: body.leg_height" in factors["data_pedigree"].because


def test_a_held_out_flight_that_is_closer_gives_two(tmp_path: Path) -> None:
    found = levels(explained(tmp_path / "a"))
    assert found["validation"] == found["data_pedigree"] == 2
    assert found["uncertainty_characterization"] == found["results_robustness"] == 1
    assert found["development_process_product_management"] == 1
    assert found["input_pedigree"] == found["use_assessment"] == 0


def test_less_evidence_gives_less(tmp_path: Path) -> None:
    assert levels(explained(tmp_path / "spans", spans=[[1.0, 2.0]]))["validation"] == 1
    assert levels(explained(tmp_path / "worse", channel=WORSE))["validation"] == 1
    assert levels(explained(tmp_path / "lost", stable=False))["results_robustness"] == 0


def test_nothing_compared_is_zero(tmp_path: Path) -> None:
    folder = explained(tmp_path / "a")
    found = json.loads((folder / "explain.json").read_text()) | {"gap": {}}
    (folder / "explain.json").write_text(json.dumps(found))
    assert levels(folder)["validation"] == 0


@pytest.mark.parametrize(
    ("file", "old", "new", "said"),
    [
        ("explain.json", '[{"flight": "b", "spans_s": null}]', "[{}]", "missing required field"),
        ("explain.json", '[{"flight": "b", "spans_s": null}]', '"x"', "Expected `array`"),
        ("explain.json", '"missions": {"hover": {}, "tour": {}}', '"a": 1', "`missions`"),
        ("run.json", '"sha256"', '"md5"', "missing required field `sha256`"),
        ("run.json", f'"{"0" * 64}"', '"0"', "matching regex"),
    ],
)
def test_damaged_evidence_is_refused(
    tmp_path: Path, file: str, old: str, new: str, said: str
) -> None:
    folder = explained(tmp_path / "a")
    text = (folder / file).read_text()
    assert old in text
    (folder / file).write_text(text.replace(old, new))
    with pytest.raises(TwinError, match=f"{file}: .*{said}.*--evidence takes"):
        levels(folder)


def test_another_twin_than_the_compared_has_no_validation(tmp_path: Path) -> None:
    folder = explained(tmp_path / "a")
    vehicle = ut.load_vehicle(folder / "vehicle.toml")
    card, driven = ut.credibility(vehicle, folder), ut.twin(vehicle, drive="command")
    export_parts([driven], card=card, require=["validation=2"])
    for starts in ({"airframe.mass": 4.2}, {"airframe.rotor_drag.enabled": 0.0}):
        with pytest.raises(TwinError, match=r"validation has level 0, .* not the twin"):
            export_parts([driven], starts=starts, card=card, require=["validation=2"])
    with pytest.raises(TwinError, match="results_robustness has level 0"):
        observed = ut.twin(vehicle, drive="command", observer=True)
        export_parts([observed], card=card, require=["results_robustness=1"])


def test_a_learned_force_is_another_twin_and_is_listed() -> None:
    force = ut.learned_force("copter_drag")
    vehicle = ut.load_vehicle(force.folder / "vehicle.toml")
    made = ut.twin(vehicle, drive="command", force=force)
    assert {"fit_1", "fit_2", "force.json"} <= made.evidence.keys()
    assert all(len(digest) == 64 for digest in made.evidence.values())
    found = of_file(ut.credibility(vehicle), True, made.changes, made.evidence)
    assert "a learned force" in found.factors["validation"].because
    assert found.evidence.keys() >= {"fit_1", "force.json"}


def test_a_twin_without_an_accepted_law_says_so(tmp_path: Path) -> None:
    force = ut.learned_force("copter_drag")
    none = replace(force, model=replace(force.model, ridge=None))
    made = ut.twin(ut.load_vehicle(force.folder / "vehicle.toml"), drive="command", force=none)
    assert LAWLESS in made.changes and "a learned force acts on it" not in made.changes
    fmu, _ = export_parts([made])(tmp_path, lambda _: None)
    assert LAWLESS in fmu.note


def test_an_unknown_model_is_said_with_those_that_are_shipped() -> None:
    with pytest.raises(TwinError, match=r"copter_dragg: no such folder, .* shipped: copter_drag\."):
        learned(Path("copter_dragg"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("what", "file", "options", "level"),
    [
        ("imu", "imu.fmu", {}, 1),
        ("imu", "imu.fmu", {"fmi": 3, "arrays": True}, 0),
        ("imu", "imu.fmu", {"real_outputs": True}, 1),
        ("imu", "imu.fmu", {"python_slave": True}, 0),
        ("replay", "replay.fmu", {"fmi": 3}, 1),
        ("driven", "twin.fmu", {}, 1),
        ("driven", "twin.ssp", {}, 1),
        ("mission", "twin.ssp", {"fmi": 3}, 1),
        ("force", "twin.ssp", {}, 1),
    ],
)
def test_a_card_claims_references_where_all_fmus_of_its_file_have_some(
    what: str, file: str, options: dict[str, Any], level: int, tmp_path: Path
) -> None:
    force = ut.learned_force("copter_drag")
    taught, vehicle = ut.load_vehicle(force.folder / "vehicle.toml"), ut.load_vehicle(COPTER)
    flown = recorded(time=[0.0, 0.5, 1.0], cmd_1=[0.4, 0.5, 0.6])
    makers: dict[str, Callable[[], Exportable]] = {
        "imu": lambda: ut.component("imu", vehicle),
        "replay": lambda: ut.replay(flown),
        "driven": lambda: ut.twin(vehicle, drive="command"),
        "mission": lambda: ut.twin(vehicle),
        "force": lambda: ut.twin(taught, drive="command", force=force),
    }
    made = makers[what]()
    path = tmp_path / file
    ut.export(made, path, card=ut.credibility(vehicle), **options)
    with zipfile.ZipFile(path) as archive:
        card = json.loads(archive.read(FILE))
        inside = [n for n in archive.namelist() if n.endswith(".fmu")]
        for name in inside:
            archive.extract(name, tmp_path)
    assert card["factors"]["verification"]["level"] == level
    for fmu in [tmp_path / n for n in inside] or [path]:
        with zipfile.ZipFile(fmu) as archive:
            assert (MANIFEST in archive.namelist()) == bool(level)
    if level:
        assert ut.verify(path).passed


def test_evidence_of_another_vehicle_is_refused(tmp_path: Path) -> None:
    folder = explained(tmp_path / "a")
    with pytest.raises(TwinError, match=r"not the vehicle of the export, copter_default"):
        ut.credibility(ut.load_vehicle(COPTER), folder)
    (folder / "explain.json").write_text("{")
    with pytest.raises(TwinError, match=r"explain\.json: .*--evidence takes a folder"):
        ut.credibility(ut.load_vehicle(folder / "vehicle.toml"), folder)


@pytest.mark.parametrize("text", ["validation", "validation=5", "fame=1", "validation=-1"])
def test_what_is_no_requirement_is_said(text: str) -> None:
    with pytest.raises(TwinError, match="write FACTOR=LEVEL, 0 to 4"):
        check_required(ut.credibility(ut.load_vehicle(COPTER)), [text])


def test_the_page_says_what_the_numbers_say(tmp_path: Path) -> None:
    folder = explained(tmp_path / "a")
    card = ut.credibility(ut.load_vehicle(folder / "vehicle.toml"), folder)
    written = members(card)
    assert json.loads(written[FILE])["evidence"]["a.ulg"] == "0" * 64
    page = written[PAGE].decode()
    assert "not checked against the text of the standard" in page
    assert json.loads(written[FILE])["names"] in page
    assert all(f"<td>{name}</td>" in page for name in card.factors)


@pytest.mark.slow
def test_the_card_goes_along_or_the_export_is_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    folder, out = explained(tmp_path / "a"), tmp_path / "out"
    proof = ("--evidence", folder, "--out", out)
    code, _, err = run(capsys, "export", "imu", *proof, "--require", "use_assessment=1")
    assert code == 2 and "use_assessment has level 0, 1 is required: who uses" in err
    assert not out.exists()
    assert run(capsys, "export", "imu", *proof, "--require", "validation=2")[0] == 0
    with zipfile.ZipFile(out / "imu.fmu") as archive:
        assert json.loads(archive.read(FILE))["factors"]["validation"]["level"] == 2
    assert ut.verify(out / "imu.fmu").passed
