"""`check` looks into archives of any origin without unpacking or loading them."""

import io
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from fmpy.model_description import ModelDescription, ModelVariable
from fmpy.validation import _validate_variable_names
from hypothesis import given, settings
from hypothesis import strategies as st

from fmus import build, component_model
from fmus.inspect import MAX_FACT, MAX_PROBLEMS, inspect_fmu, name_problems
from twin.errors import FmuError
from twin.physics.sensors.imu import imu
from twin.vehicle_file import load_vehicle

Edit = Callable[[dict[str, bytes]], dict[str, bytes]]


@pytest.fixture(scope="module")
def members(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Content of a good FMU."""
    path = tmp_path_factory.mktemp("good") / "imu.fmu"
    build(component_model(imu(load_vehicle("copter_default"))), path)
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def pack(members: dict[str, bytes], path: Path) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


def described(edit: Callable[[bytes], bytes]) -> Edit:
    return lambda m: {**m, "modelDescription.xml": edit(m["modelDescription.xml"])}


def test_a_good_fmu_has_no_problems(members: dict[str, bytes], tmp_path: Path) -> None:
    report = inspect_fmu(pack(members, tmp_path / "imu.fmu"))
    assert report.problems == ()
    assert report.facts["platforms"] == "linux64"
    assert report.facts["sources"] == "inside"
    assert report.facts["saves its state"] == "yes"


PROBLEMS: dict[str, tuple[Edit, str]] = {
    "traversal": (lambda m: {**m, "../evil": b"x"}, "unsafe path"),
    "absolute": (lambda m: {**m, "/etc/evil": b"x"}, "unsafe path"),
    "backslash": (lambda m: {**m, "a\\..\\evil": b"x"}, "unsafe path"),
    "drive": (lambda m: {**m, "C:evil": b"x"}, "unsafe path"),
    "nothing to run": (
        lambda m: {k: v for k, v in m.items() if k == "modelDescription.xml"},
        "neither binaries nor sources",
    ),
    "unit undefined": (
        described(lambda x: x.replace(b'unit="rad/s"', b'unit="furlong"')),
        "furlong",
    ),
    "twice": (
        described(lambda x: x.replace(b'name="omega_y"', b'name="omega_x"')),
        "omega_x",
    ),
}


LIBRARY = "binaries/linux64/imu.so"


def library(edit: Callable[[bytes], bytes]) -> Edit:
    return lambda m: {**m, LIBRARY: edit(m[LIBRARY])}


def arm(content: bytes) -> bytes:
    """For another processor: e_machine of the ELF header."""
    return content[:18] + (183).to_bytes(2, "little") + content[20:]


PROBLEMS |= {
    "text as a library": (library(lambda _: b"not a library\n"), f"{LIBRARY} is no shared"),
    "library of ARM": (library(arm), f"{LIBRARY} is for aarch64 on linux, not for linux64"),
    "library of Windows": (
        lambda m: {**m, "binaries/win64/imu.dll": m[LIBRARY]},
        "binaries/win64/imu.dll is for x86_64 on linux, not for win64",
    ),
    "cut library": (library(lambda x: x[: len(x) // 2]), f"{LIBRARY} is cut"),
    "library of another name": (
        lambda m: {(k.replace("imu.so", "other.so")): v for k, v in m.items()},
        "binaries/linux64 holds no imu.so",
    ),
    "start that is no number": (
        described(lambda x: x.replace(b'start="0.0"', b'start="NaN"', 1)),
        "start = 'NaN' is not finite",
    ),
    "start that is infinite": (
        described(lambda x: x.replace(b'start="0.0"', b'start="-INF"', 1)),
        "start = '-INF' is not finite",
    ),
    "stop time that is no number": (
        described(lambda x: x.replace(b'stopTime="10"', b'stopTime="NaN"')),
        "stopTime = 'NaN' is not finite",
    ),
    "name of no convention": (
        described(lambda x: x.replace(b'name="omega_x"', b'name="omega x"')),
        "'omega x' (line",
    ),
}


@pytest.mark.parametrize("name", PROBLEMS)
def test_problems_are_listed(name: str, members: dict[str, bytes], tmp_path: Path) -> None:
    edit, word = PROBLEMS[name]
    report = inspect_fmu(pack(edit(members), tmp_path / "bad.fmu"))
    assert any(word in p for p in report.problems), report.problems
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bad.fmu"]  # nothing was unpacked


def test_what_an_fmu_says_of_itself_is_cut(members: dict[str, bytes], tmp_path: Path) -> None:
    """A description of a megabyte, over several lines, and a token that no schema knows."""
    long = b'description="' + b"a&#10;" * 2**18
    edit = described(
        lambda x: x.replace(b'description="', long, 1).replace(b'"2.0"', b'"2.0" x="1"')
    )
    report = inspect_fmu(pack(edit(members), tmp_path / "long.fmu"))
    assert report.problems
    for text in (*report.facts.values(), *report.problems):
        assert len(text) <= MAX_FACT + 3
        assert "\n" not in text


def test_a_damaged_member_is_a_problem(members: dict[str, bytes], tmp_path: Path) -> None:
    """Every member in turn: one byte of what is packed, then of the checksum."""
    whole = pack(members, tmp_path / "bad.fmu").read_bytes()
    with zipfile.ZipFile(tmp_path / "bad.fmu") as archive:
        infos = [m for m in archive.infolist() if m.filename != "modelDescription.xml"]
    assert len(infos) > 5
    for info in infos:
        content = bytearray(whole)
        content[info.header_offset + 30 + len(info.filename) + info.compress_size // 2] ^= 0xFF
        (tmp_path / "bad.fmu").write_bytes(content)
        (problem,) = inspect_fmu(tmp_path / "bad.fmu").problems
        assert f"'{info.filename}' is damaged" in problem


@pytest.mark.slow
def test_many_variables_take_seconds(members: dict[str, bytes], tmp_path: Path) -> None:
    """200,000: what took minutes takes seconds, and what is wrong with all is not said of all."""
    rows = "".join(
        f'<ScalarVariable name="a{i}.b[1,2]" valueReference="{i}" causality="parameter" '
        f'variability="tunable"><Real start="NaN"/></ScalarVariable>'
        for i in range(200_000)
    )
    text = (
        f'<fmiModelDescription fmiVersion="2.0" modelName="imu" guid="g" '
        f'variableNamingConvention="structured"><CoSimulation modelIdentifier="imu"/>'
        f"<ModelVariables>{rows}</ModelVariables><ModelStructure/></fmiModelDescription>"
    )
    path = pack({**members, "modelDescription.xml": text.encode()}, tmp_path / "many.fmu")
    begun = time.process_time()
    problems = inspect_fmu(path).problems
    assert time.process_time() - begun < 60
    assert len(problems) == MAX_PROBLEMS + 1
    assert problems[-1] == f"and {200_000 - MAX_PROBLEMS} more problems"


@given(name=st.from_regex(r"(der\()?[a_9'.\[\]1, (){}é]{0,12}\)?", fullmatch=True))
@settings(max_examples=50)
def test_names_are_judged_as_by_fmpy(name: str) -> None:
    """FMPy's grammar, a hundred times slower; it takes a lone backslash for an escape."""
    described = ModelDescription()
    described.variableNamingConvention = "structured"
    described.modelVariables = [ModelVariable(name=name, valueReference=1, type="Real")]
    ours = list(name_problems(described))
    assert bool(ours) == bool(_validate_variable_names(described))


REFUSED: dict[str, tuple[Edit, str]] = {
    "no description": (
        lambda m: {k: v for k, v in m.items() if k != "modelDescription.xml"},
        "modelDescription.xml",
    ),
    "not XML": (described(lambda x: b"<fmi"), "XML"),
    "empty": (described(lambda x: b""), "XML"),
    "doctype": (
        described(lambda x: b'<!DOCTYPE x [<!ENTITY a "aaaa">]>' + x.split(b"?>", 1)[1]),
        "DOCTYPE",
    ),
    "huge": (described(lambda x: x + b"\n" * (33 * 2**20)), "larger than"),
    "wrong root": (described(lambda x: b"<html/>"), "understood"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_unsafe_descriptions_are_refused(
    name: str, members: dict[str, bytes], tmp_path: Path
) -> None:
    edit, word = REFUSED[name]
    with pytest.raises(FmuError, match=word) as refusal:
        inspect_fmu(pack(edit(members), tmp_path / "bad.fmu"))
    assert "bad.fmu" in str(refusal.value)


def test_a_bomb_is_reported_by_its_size(members: dict[str, bytes], tmp_path: Path) -> None:
    path = pack(members, tmp_path / "bomb.fmu")
    buffer = io.BytesIO(path.read_bytes())
    with (
        zipfile.ZipFile(buffer, "a", zipfile.ZIP_DEFLATED) as archive,
        archive.open("resources/zeros", "w", force_zip64=True) as file,
    ):
        for _ in range(65):
            file.write(bytes(2**24))
    path.write_bytes(buffer.getvalue())
    assert path.stat().st_size < 4 * 2**20
    assert any("unpacks to" in p for p in inspect_fmu(path).problems)


def test_a_truncated_archive_is_refused(members: dict[str, bytes], tmp_path: Path) -> None:
    whole = pack(members, tmp_path / "cut.fmu").read_bytes()
    for share in (0.1, 0.5, 0.99):
        (tmp_path / "cut.fmu").write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(FmuError, match=r"cut\.fmu"):
            inspect_fmu(tmp_path / "cut.fmu")
