"""Reference results inside an FMU: rerun by FMPy, told from another twin, refused where damaged."""

import csv
import json
import zipfile
from dataclasses import replace
from pathlib import Path

import fmpy
import numpy as np
import pytest
from cli_rig import run as run_verb
from lxml import etree

import uavtwin as ut
from fmus import build
from fmus.archive import open_archive
from fmus.builder import write_archive
from fmus.experiments import FOLDER, MANIFEST, read_experiments, related_problems, run, verify
from fmus.inspect import inspect_fmu
from fmus.reference_results import add_reference_results
from twin.errors import FmuError
from twin.physics.rotors import Drive
from twin.vehicle_file import load_vehicle
from uavtwin.exports.parts import twin
from uavtwin.exports.write import Starts, products_of

pytestmark = pytest.mark.slow
COPTER = load_vehicle("copter_default")


def written(folder: Path, mass: float = 1.0, fmi: int = 2, driven: bool = True) -> Path:
    """The twin of a copter of so many times its mass."""
    vehicle = COPTER.with_mass(mass * COPTER.mass_kg)
    made = products_of(twin(vehicle, drive="command" if driven else None), Starts({}), [fmi])
    model = made[0].model
    assert model is not None
    path = folder / f"{mass}_{fmi}_{driven}.fmu"
    build(model, path, fmi)
    add_reference_results(path, model, fmi)
    return path


def members(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {n: archive.read(n) for n in archive.namelist()}


def changed(path: Path, others: dict[str, bytes]) -> Path:
    """The same with other members."""
    new = path.with_name("changed.fmu")
    write_archive(new, members(path) | others)
    return new


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("plant"))


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("driven", [True, False])
def test_another_mass_is_told(tmp_path: Path, fmi: int, driven: bool) -> None:
    own, heavier = (written(tmp_path, mass, fmi, driven) for mass in (1.0, 1.03))
    (same,) = verify(own)
    assert same.passed and 0 < same.share < 1e-8 and same.outputs > 50
    old = {n: c for n, c in members(own).items() if n.startswith(FOLDER)}
    (other,) = verify(changed(heavier, old))
    assert not other.passed and other.share > 1e-2


@pytest.mark.parametrize("drive", ["command", None])
def test_the_last_bits_of_an_input_decide_nothing(tmp_path: Path, drive: Drive | None) -> None:
    """The least stable of what is exported: a Crazyflie without a controller, and the lightest that
    flies a mission while forces and moments act from outside."""
    path = ut.export(ut.twin(ut.load_vehicle("crazyflie"), drive=drive), tmp_path / "x.fmu")
    (experiment,) = read_experiments(open_archive(path.paths[0]))
    moved = {n: w if n == "time" else w * (1 + 1e-12) for n, w in experiment.stimuli.items()}
    names = [n for n in experiment.references if n != "time"]
    found = run(path.paths[0], replace(experiment, stimuli=moved), names)
    for name in names:
        wanted = experiment.references[name]
        off = np.abs(found[name] - wanted).max()
        assert off <= 1e-5 * max(np.abs(wanted).max(), 1e-9), name


def test_ten_lines_of_fmpy_say_the_same(plant: Path) -> None:
    folder = fmpy.extract(str(plant))
    place = Path(folder, FOLDER)
    times = etree.parse(place / "reference.exp").find(".//TransientSimulation")
    assert times is not None
    given = fmpy.util.read_csv(str(place / "reference_in.csv"))
    wanted = fmpy.util.read_csv(str(place / "reference_out.csv"))
    names = [n for n in wanted.dtype.names if n != "time"]
    step, stop = float(times.get("stepSize", "")), float(times.get("stopTime", ""))
    found = fmpy.simulate_fmu(
        folder, stop_time=stop, output_interval=step, input=given, output=names
    )
    off = [np.abs(found[n] - wanted[n]).max() / max(np.abs(wanted[n]).max(), 1e-9) for n in names]
    assert max(off) < 1e-4


def test_the_same_model_gives_the_same_bytes_and_the_date_that_is_asked_for(
    plant: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert written(tmp_path).read_bytes() == plant.read_bytes()
    assert b"generationDateAndTime" not in open_archive(plant).description
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    dated = open_archive(written(tmp_path))
    assert dated.root.get("generationDateAndTime") == "2023-11-14T22:13:20Z"
    assert dated.root.get("guid") == open_archive(plant).root.get("guid")
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "yesterday")
    with pytest.raises(FmuError, match="SOURCE_DATE_EPOCH=yesterday: give whole seconds"):
        written(tmp_path)


def test_the_manifest_is_what_the_draft_asks_for(plant: Path) -> None:
    content = members(plant)
    root = etree.fromstring(content[MANIFEST])
    space = "{http://fmi-standard.org/fmi-ls-manifest}fmi-ls-"
    assert root.get(f"{space}name") == "org.fmi-standard.fmi-ls-ref"
    assert root.get(f"{space}version") == "1.0.0-alpha.1"
    files = {e.get("source"): e.get("role") for e in root.iter("Related")}
    assert files["reference.exp"] == "experiment/smoke-test"
    assert {f"{FOLDER}/{f}" for f in files} <= content.keys()
    (experiment,) = read_experiments(open_archive(plant))
    assert experiment.stop_s == 1.0 and set(experiment.stimuli) >= {"time", "airframe.cmd_1"}
    assert related_problems(open_archive(plant)) == []


def test_a_changed_reference_is_told(plant: Path) -> None:
    name = f"{FOLDER}/reference_out.csv"
    rows = list(csv.reader(members(plant)[name].decode().splitlines()))
    rows[50][1] = str(float(rows[50][1]) + 1.0)
    text = "\n".join(",".join(row) for row in rows) + "\n"
    new = changed(plant, {name: text.encode()})
    assert related_problems(open_archive(new)) == [
        f"'{name}' has another checksum than {MANIFEST} says"
    ]
    with pytest.raises(FmuError, match="has another checksum"):
        verify(new)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (b'source="reference_out.csv"/>', b'source="../../../etc/passwd"/>', "no item named"),
        (b'stepSize="0.02"', b'stepSize="0"', "is no experiment"),
        (b'stopTime="1"', b'stopTime="soon"', "soon"),
        (b'tolerance="0.0001"', b'tolerance="nan"', "a tolerance of nan"),
        (b'tolerance="0.0001"', b'tolerance="inf"', "zeros would pass"),
        (b"<References", b'<Parameters source="x.ssv"/><References', "without Parameters"),
        (b"<Experiments", b"<Experiments <", "reference.exp"),
    ],
)
def test_what_cannot_be_rerun_is_refused(plant: Path, old: bytes, new: bytes, said: str) -> None:
    name = f"{FOLDER}/reference.exp"
    text = members(plant)[name]
    assert old in text
    with pytest.raises(FmuError, match=said):
        verify(changed(plant, {name: text.replace(old, new)}))


@pytest.mark.parametrize("law", ["controller", "controller_px4"])
def test_references_of_a_controller_tell_another(tmp_path: Path, law: str) -> None:
    own, other = (
        ut.export(ut.component(law, ut.load_vehicle(name)), tmp_path / f"{name}.fmu")
        for name in ("copter_default", "crazyflie")
    )
    assert verify(own.paths[0])[0].passed
    old = {n: c for n, c in members(own.paths[0]).items() if n.startswith(FOLDER)}
    assert not verify(changed(other.paths[0], old))[0].passed


def test_a_renamed_output_is_refused(plant: Path) -> None:
    name = f"{FOLDER}/reference_out.csv"
    text = members(plant)[name].replace(b"airframe.pos_x", b"airframe.pos_q")
    renamed = changed(plant, {name: text})
    with pytest.raises(FmuError, match="another checksum"):
        verify(renamed)
    (experiment,) = read_experiments(open_archive(plant))
    with pytest.raises(FmuError, match=r"no output .*pos_q|cannot be run"):
        run(plant, experiment, ["airframe.pos_q"])
    assert "reference results: no variable 'airframe.pos_q'" in inspect_fmu(renamed).problems


def test_references_that_are_zero_throughout_are_counted(plant: Path) -> None:
    (experiment,) = read_experiments(open_archive(plant))
    (found,) = verify(plant)
    zero = [n for n, v in experiment.references.items() if n != "time" and not v.any()]
    assert 0 < found.zero == len(zero) < found.outputs


def test_each_file_has_a_verdict(capsys: pytest.CaptureFixture[str], plant: Path) -> None:
    bare = changed(plant, {MANIFEST: b""})
    code, said, err = run_verb(capsys, "verify", bare, plant)
    assert code == 2 and "comes out the same" in said and "changed.fmu" in err
    _, said, _ = run_verb(capsys, "verify", bare, plant, "--json")
    lost, found = json.loads(said)
    assert "changed.fmu" in lost["error"] and not lost["passed"]
    assert not found["error"] and found["passed"]
    code, _, err = run_verb(capsys, "verify", "nope.fmu")
    assert code == 2 and "nope.fmu: no such file." in err


def test_a_changed_byte_in_any_member_is_told(plant: Path, tmp_path: Path) -> None:
    """In the middle of its packed content, by its CRC: no member is only half looked at."""
    path, whole = tmp_path / "plant.fmu", plant.read_bytes()
    with zipfile.ZipFile(plant) as archive:
        packed = [m for m in archive.infolist() if m.filename != "modelDescription.xml"]
    for member in packed:
        place = member.header_offset + 30 + len(member.filename) + member.compress_size // 2
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        assert any(member.filename in p for p in inspect_fmu(path).problems), member.filename
        if member.filename.startswith(FOLDER):
            with pytest.raises(FmuError):
                verify(path)


def test_references_without_outputs_are_refused(plant: Path) -> None:
    with pytest.raises(FmuError, match="hold no output"):
        verify(changed(plant, {f"{FOLDER}/reference_out.csv": b"time\n0\n1\n"}))


def test_each_fmu_of_an_ssp_is_rerun(tmp_path: Path) -> None:
    found = ut.export(ut.twin(ut.load_vehicle("crazyflie")), tmp_path / "twin.ssp")
    result = ut.verify(found.paths[0])
    assert result.passed and {"airframe.made_up", "imu.made_up"} <= {
        e.name for e in result.record.experiments
    }


def test_without_reference_results_it_is_said(plant: Path, tmp_path: Path) -> None:
    bare = tmp_path / "bare.fmu"
    write_archive(bare, {n: c for n, c in members(plant).items() if not n.startswith("extra")})
    with pytest.raises(FmuError, match="holds no reference results"):
        verify(bare)
