"""Hostile archives: refused before anything is written or loaded, by one error type."""

import stat
import zipfile
from collections.abc import Callable
from copy import copy
from pathlib import Path

import pytest

from cosim.slave import Slave
from fmus import build, component_model
from fmus.archive import unpack
from fmus.inspect import inspect_fmu
from twin.errors import FmuError
from twin.physics.sensors.imu import imu
from twin.vehicle_file import load_vehicle

Members = list[tuple[zipfile.ZipInfo, bytes]]


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Members:
    path = tmp_path_factory.mktemp("good") / "imu.fmu"
    build(component_model(imu(load_vehicle("copter_default"))), path)
    with zipfile.ZipFile(path) as archive:
        return [(info, archive.read(info)) for info in archive.infolist()]


def member(
    name: str, content: bytes = b"x", mode: int = 0o644, kind: int = stat.S_IFREG
) -> tuple[zipfile.ZipInfo, bytes]:
    info = zipfile.ZipInfo(name)
    info.create_system = 3
    info.external_attr = (kind | mode) << 16
    info.compress_type = zipfile.ZIP_DEFLATED
    return info, content


def described(edit: Callable[[bytes], bytes]) -> Callable[[Members], Members]:
    def change(members: Members) -> Members:
        return [
            (info, edit(content) if info.filename == "modelDescription.xml" else content)
            for info, content in members
        ]

    return change


def added(*extra: tuple[zipfile.ZipInfo, bytes]) -> Callable[[Members], Members]:
    return lambda members: [*members, *extra]


def without(name: str) -> Callable[[Members], Members]:
    return lambda members: [m for m in members if m[0].filename != name]


HOSTILE: dict[str, Callable[[Members], Members]] = {
    "traversal": added(member("../../evil.so")),
    "hidden traversal": added(member("resources/../../evil.so")),
    "absolute": added(member("/tmp/uavtwin-evil")),
    "drive": added(member("C:/evil.dll")),
    "backslash": added(member("binaries\\..\\..\\evil.so")),
    "link": added(member("resources/link", b"/etc/passwd", kind=stat.S_IFLNK)),
    "link to a folder": added(
        member("resources/dir", b"/", kind=stat.S_IFLNK), member("resources/dir/evil")
    ),
    "device": added(member("resources/null", b"", kind=stat.S_IFCHR)),
    "fifo": added(member("resources/pipe", b"", kind=stat.S_IFIFO)),
    "twice": added(member("binaries/linux64/imu.so", b"evil")),
    "twice but for case": added(member("BINARIES/linux64/imu.so", b"evil")),
    "file and folder": added(member("extra", b"x"), member("extra/inside", b"x")),
    "control characters": added(member("resources/a\nb")),
    "long name": added(member("resources/" + "a" * 600)),
    "too many": added(*(member(f"resources/{i}", b"") for i in range(20_001))),
    "bad identifier": described(
        lambda x: x.replace(b'modelIdentifier="imu"', b'modelIdentifier="../../evil"')
    ),
    "doctype": described(lambda x: b'<!DOCTYPE x [<!ENTITY a "aaaa">]>' + x.split(b"?>", 1)[1]),
    "entity bomb": described(
        lambda x: (
            b'<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;">]>'
            + x.split(b"?>", 1)[1].replace(b"Accelerometer", b"&b;", 1)
        )
    ),
    "no description": without("modelDescription.xml"),
    "missing library": without("binaries/linux64/imu.so"),
    "library of another kind": lambda members: [
        (info, b"MZ not a library" if info.filename.endswith(".so") else content)
        for info, content in members
    ],
    "other token": described(lambda x: x.replace(b'guid="', b'guid="0')),
}


@pytest.mark.parametrize("kind", HOSTILE)
@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_hostile_archives_are_refused(kind: str, good: Members, tmp_path: Path) -> None:
    path = tmp_path / "hostile.fmu"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for info, content in HOSTILE[kind](good):
            archive.writestr(info, content)
    with pytest.raises(FmuError, match=r"hostile\.fmu"):
        Slave("imu", path)
    assert [p.name for p in tmp_path.iterdir()] == ["hostile.fmu"]
    assert not Path("/tmp/uavtwin-evil").exists()


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_equal_entries_are_a_finding_and_do_no_harm(good: Members, tmp_path: Path) -> None:
    """Some tools add a file each time they are asked; which of them is read does not matter."""
    path, library = tmp_path / "repeated.fmu", "binaries/linux64/imu.so"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for info, content in [*good, *(m for m in good if m[0].filename == library)]:
            archive.writestr(copy(info), content)
    assert inspect_fmu(path).problems == (
        f"the archive holds {library!r} 2 times, the same each time",
    )
    Slave("imu", path).close()


def test_a_bomb_is_refused_by_what_it_says(good: Members, tmp_path: Path) -> None:
    path = tmp_path / "bomb.fmu"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for info, content in good:
            archive.writestr(info, content)
        with archive.open("resources/zeros", "w", force_zip64=True) as file:
            for _ in range(40):
                file.write(bytes(2**24))
    with pytest.raises(FmuError, match="unpacks to"):
        unpack(path, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_bomb_that_lies_about_its_size_is_stopped(good: Members, tmp_path: Path) -> None:
    """Sizes in the headers patched from 64 MiB to 10 bytes: stopped at what they say."""
    path = tmp_path / "liar.fmu"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for info, content in good:
            archive.writestr(info, content)
        archive.writestr(member("resources/zeros")[0], bytes(2**26))
    size = (2**26).to_bytes(4, "little")
    content = path.read_bytes()
    assert content.count(size) >= 2
    path.write_bytes(content.replace(size, (10).to_bytes(4, "little")))
    folder = tmp_path / "out"
    folder.mkdir()
    with pytest.raises(FmuError, match=r"liar\.fmu"):
        unpack(path, folder)
    assert sum(p.stat().st_size for p in folder.rglob("*") if p.is_file()) < 2**20


def test_a_damaged_stream_is_refused(good: Members, tmp_path: Path) -> None:
    path = tmp_path / "damaged.fmu"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for info, content in good:
            archive.writestr(info, content)
    damaged = bytearray(path.read_bytes())
    for i in range(len(damaged) // 2, len(damaged) // 2 + 200):
        damaged[i] ^= 0x5A
    path.write_bytes(bytes(damaged))
    folder = tmp_path / "out"
    folder.mkdir()
    with pytest.raises(FmuError, match=r"damaged\.fmu"):
        unpack(path, folder)
