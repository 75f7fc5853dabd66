"""`check` looks into archives of any origin without unpacking or loading them."""

import io
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from fmus import build, component_model
from fmus.inspect import inspect_fmu
from twin.errors import FmuError
from twin.physics.sensors.imu import imu
from twin.vehicle.file import load_vehicle

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


@pytest.mark.parametrize("name", PROBLEMS)
def test_problems_are_listed(name: str, members: dict[str, bytes], tmp_path: Path) -> None:
    edit, word = PROBLEMS[name]
    report = inspect_fmu(pack(edit(members), tmp_path / "bad.fmu"))
    assert any(word in p for p in report.problems), report.problems
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bad.fmu"]  # nothing was unpacked


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
