"""`check` of a system: what it holds and what is wrong with it, with no library loaded."""

import io
import tempfile
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from cli_rig import run
from fuzzing.all_kinds import kind

from cosim.ssp import inspect_ssp
from cosim.ssp.inspect import MAX_LISTED
from fmus.archive import MAX_DIRECTORY_BYTES, archive_members
from twin.errors import FmuError

Edit = Callable[[dict[str, bytes]], dict[str, bytes]]
SSD, MOTOR = "SystemStructure.ssd", "resources/motor.fmu"


def unpacked(content: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def packed(members: dict[str, bytes]) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return file.getvalue()


def written(edit: Edit, path: Path) -> Path:
    """The sound system with a change; its libraries are headers, which nobody could load."""
    path.write_bytes(packed(edit(unpacked(kind("ssp").bases()["drive"]))))
    return path


def structure(old: str, new: str) -> Edit:
    def edit(m: dict[str, bytes]) -> dict[str, bytes]:
        assert old.encode() in m[SSD]
        return {**m, SSD: m[SSD].replace(old.encode(), new.encode())}

    return edit


def motor(edit: Edit) -> Edit:
    return lambda m: {**m, MOTOR: packed(edit(unpacked(m[MOTOR])))}


def test_a_sound_system(tmp_path: Path) -> None:
    report = inspect_ssp(written(lambda m: m, tmp_path / "drive.ssp"))
    assert (report.problems, report.notes) == ((), ())
    assert (report.platforms, report.runs_here) == (("linux64",), True)
    facts = report.facts
    assert facts["components"] == "3"
    assert facts["component motor"].startswith(f"{MOTOR}: FMU, FMI 2.0, co-simulation; linux64")
    assert "FMI 3.0" in facts["component amplifier"]
    assert facts["connections"] == "3"
    assert facts["motor -> amplifier"] == "1: speed"
    assert facts["start values"] == "3"
    assert facts["times"] == "from 0 s to 3.5 s, base step 0.01 s, second every 4 steps"


LIBRARY = "binaries/linux64/motor.so"
PROBLEMS: dict[str, tuple[Edit, str]] = {
    "library cut": (
        motor(lambda m: {**m, LIBRARY: m[LIBRARY][:999]}),
        f"'{MOTOR}': {LIBRARY} is cut",
    ),
    "library that is text": (motor(lambda m: {**m, LIBRARY: b"x" * 99}), "is no shared library"),
    "start that is no number": (
        motor(
            lambda m: {
                **m,
                "modelDescription.xml": m["modelDescription.xml"].replace(b'"0.0"', b'"NaN"'),
            }
        ),
        "is not finite",
    ),
    "path out of an FMU": (motor(lambda m: {**m, "../x": b""}), "unsafe path"),
    "no FMU": (lambda m: {**m, MOTOR: b"text"}, f"'{MOTOR}': not a readable FMU archive"),
    "connector that is none": (structure('"speed"', '"sped"'), "Did you mean 'speed'?"),
    "component that is none": (structure('endElement="motor"', 'endElement="m"'), "no component"),
    "source that is missing": (structure("motor.fmu", "rotor.fmu"), "not in the archive"),
    "step of zero": (structure('Size="0.01"', 'Size="0"'), "must be above 0 s"),
    "an SSP of its own": (
        structure("resources/motor.fmu", SSD),
        "not a readable FMU archive",
    ),
}


@pytest.mark.parametrize("name", PROBLEMS)
def test_problems_are_listed(name: str, tmp_path: Path) -> None:
    edit, text = PROBLEMS[name]
    report = inspect_ssp(written(edit, tmp_path / "bad.ssp"))
    assert any(text in p for p in report.problems), report.problems


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_equal_entries_are_a_finding(tmp_path: Path) -> None:
    path = written(lambda m: m, tmp_path / "drive.ssp")
    cases: tuple[tuple[Callable[[bytes], bytes], str], ...] = (
        (lambda old: old, f"the archive holds {MOTOR!r} 2 times, the same each time"),
        (lambda old: old + b"x", "'resources/motor.fmu' twice, with different content"),
    )
    for again, expected in cases:
        with zipfile.ZipFile(path, "a") as archive:
            archive.writestr(MOTOR, again(archive.read(MOTOR)))
        try:
            (problem,) = inspect_ssp(path).problems
        except FmuError as error:
            problem = str(error)
        assert expected in problem


def test_what_is_not_used_is_a_note(tmp_path: Path) -> None:
    report = inspect_ssp(written(lambda m: {**m, "resources/x.fmu": m[MOTOR]}, tmp_path / "x.ssp"))
    assert report.problems == ()
    assert report.notes == ("'resources/x.fmu': no component is made of it",)


def test_platforms_are_those_of_all(tmp_path: Path) -> None:
    """A motor for ARM alone beside an amplifier for x86-64."""
    folder = "binaries/aarch64-linux"

    def arm(m: dict[str, bytes]) -> dict[str, bytes]:
        library = m.pop(LIBRARY)
        return {**m, f"{folder}/motor.so": library[:18] + b"\xb7\0" + library[20:]}

    report = inspect_ssp(written(motor(arm), tmp_path / "x.ssp"))
    assert (report.problems, report.platforms, report.runs_here) == ((), (), False)


def test_many_components_and_problems_are_cut(tmp_path: Path) -> None:
    many = "".join(f'<ssd:Component name="c{k}" source="{MOTOR}"/>' for k in range(2000))
    edit = structure("<ssd:Elements>", f"<ssd:Elements>{many}")
    begun = time.process_time()
    report = inspect_ssp(written(edit, tmp_path / "x.ssp"))
    assert time.process_time() - begun < 5.0  # the motor is read once, not 2000 times
    assert report.facts["components"] == "2003"
    assert sum(k.startswith("component ") for k in report.facts) == MAX_LISTED


@pytest.mark.slow
def test_archives_within_are_bounded_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each may unpack to 300 MiB, two of them may not; nothing stays behind."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    bomb = packed({"modelDescription.xml": b"<x/>", "zeros": bytes(300 * 2**20)})
    edit: Edit = lambda m: {**m, "resources/a.fmu": bomb, "resources/b.fmu": bomb}  # noqa: E731
    path = written(edit, tmp_path / "bomb.ssp")
    assert path.stat().st_size < 4 * 2**20
    begun = time.process_time()
    (problem,) = inspect_ssp(path).problems
    assert "bytes unpacked in all: they are not looked at" in problem
    assert time.process_time() - begun < 3.0
    assert list(tmp_path.iterdir()) == [path]


def test_a_list_of_members_without_end_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "many.fmu"
    count = MAX_DIRECTORY_BYTES // 46 + 1000
    entry = b"PK\1\2" + bytes(42)
    size = len(entry) * count
    end = b"PK\5\6" + bytes(4) + b"\xff\xff" * 2 + size.to_bytes(4, "little") + bytes(6)
    path.write_bytes(entry * count + end)
    with pytest.raises(FmuError, match=r"many\.fmu: its list of members has .* bytes, more than"):
        archive_members(path)


@pytest.mark.slow
def test_exit_codes(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    code, said, _ = run(capsys, "check", written(lambda m: m, tmp_path / "drive.ssp"))
    assert code == 0
    assert "good for: co-simulation on linux64: uavtwin simulate drive.ssp" in said
    code, said, _ = run(capsys, "check", written(PROBLEMS["no FMU"][0], tmp_path / "bad.ssp"))
    assert (code, "good for" in said) == (1, False)
    (tmp_path / "none.ssp").write_bytes(b"PK")
    code, said, error = run(capsys, "check", tmp_path / "none.ssp")
    assert (code, said) == (2, "")
    assert "none.ssp: not a readable SSP archive" in error
