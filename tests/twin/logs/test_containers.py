"""The log in a file is read whatever is around it, and what is no log is named."""

import bz2
import gzip
import io
import zipfile
from pathlib import Path

import numpy as np
import pytest
from sample_logs import SAMPLES

from twin.errors import LogError
from twin.logs import Flight, read_flight
from twin.logs.formats import FORMATS
from uavtwin.file_check import check_file

ULOG = SAMPLES["PX4 ULog"]()
SOUGHT = [f.name for f in FORMATS if f.sought is not None]
LEAD = b"\x20w9\xfb\xc1\x00\xffP\x80\xb1\xf3\x7f"


def zipped(members: dict[str, bytes]) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return file.getvalue()


def read(tmp_path: Path, blob: bytes, name: str = "file.zip") -> Flight:
    path = tmp_path / name
    path.write_bytes(blob)
    return read_flight(path)


def said(found: Flight) -> str:
    return "; ".join(f"{f.severity} {f.message}" for f in found.findings if f.where == "file")


def same(found: Flight, other: Flight) -> None:
    assert list(found.table) == list(other.table)
    np.testing.assert_array_equal(
        found.table.drop(columns="phase").to_numpy(), other.table.drop(columns="phase").to_numpy()
    )


@pytest.mark.parametrize("name", SAMPLES)
def test_a_log_of_any_format_is_read_out_of_an_archive(tmp_path: Path, name: str) -> None:
    blob = SAMPLES[name]()
    members = {"readme.txt": b"a flight", "logs/flight.bin": blob, "__MACOSX/._flight": b"x"}
    found = read(tmp_path, zipped(members))
    same(found, read(tmp_path, blob, "plain"))
    assert "logs/flight.bin, out of a ZIP archive; files in it that are no logs: 1" in said(found)


def test_what_is_compressed_twice_is_read(tmp_path: Path) -> None:
    """By two tools one after the other; not without end."""
    flight = read(tmp_path, gzip.compress(bz2.compress(ULOG)))
    assert said(flight).count("unpacked") == 2
    same(flight, read(tmp_path, gzip.compress(zipped({"log": ULOG}))))
    deep = ULOG
    for _ in range(4):
        deep = gzip.compress(deep)
    with pytest.raises(LogError):
        read(tmp_path, deep)


@pytest.mark.parametrize(("pack", "what"), [(gzip.compress, "gzip"), (bz2.compress, "bzip2")])
def test_compressed_logs_are_read(tmp_path: Path, pack: object, what: str) -> None:
    assert callable(pack)
    found = read(tmp_path, pack(ULOG), "log.ulg.gz")
    same(found, read(tmp_path, ULOG, "plain"))
    assert f"{what}-compressed, {len(ULOG)} bytes unpacked" in said(found)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("members", "text"),
    [
        ({"a.ulg": ULOG, "b.ulg": ULOG}, r"2 logs: a.ulg .*, b.ulg .*Extract the one"),
        ({"photo.jpg": b"\xff\xd8\xff\xe0"}, r"without a flight log; it holds photo.jpg \(4 bytes"),
        ({}, "without a file"),
        ({"modelDescription.xml": b"<x/>"}, "an FMU"),
        ({"xl/workbook.xml": b"<x/>"}, "Excel workbook. Save the sheet as CSV"),
        ({"zeros.bin": ULOG + bytes(40_000_000)}, "over 100 times its size"),
    ],
)
def test_archives_that_hold_no_one_log_say_so(
    tmp_path: Path, members: dict[str, bytes], text: str
) -> None:
    with pytest.raises(LogError, match=text):
        read(tmp_path, zipped(members))


@pytest.mark.slow
@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress, lambda b: zipped({"log.ulg": b})])
def test_damaged_and_cut_archives_are_named(tmp_path: Path, pack: object) -> None:
    assert callable(pack)
    blob = pack(ULOG)
    for cut in (20, len(blob) // 2, len(blob) - 2):
        with pytest.raises(LogError, match=r"(cut short or damaged|unpacked)"):
            read(tmp_path, blob[:cut])
    with pytest.raises(LogError, match="over 100 times its size"):
        read(tmp_path, gzip.compress(bytes(40_000_000)))


def test_an_archive_with_a_password_says_so(tmp_path: Path) -> None:
    blob = bytearray(zipped({"log.ulg": ULOG}))
    for mark, at in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        blob[blob.index(mark) + at] |= 1
    with pytest.raises(LogError, match="password"):
        read(tmp_path, bytes(blob))


def test_check_reads_a_log_in_an_archive(tmp_path: Path) -> None:
    path = tmp_path / "flight.zip"
    path.write_bytes(zipped({"flight.ulg": ULOG}))
    report = check_file(path)
    assert report.facts["format"] == "PX4 ULog"
    assert any("flight.ulg, out of a ZIP archive" in n for n in report.notes)


@pytest.mark.parametrize("name", SOUGHT)
@pytest.mark.parametrize(
    "lead",
    [LEAD, b"\xff\xfe" + LEAD, b"Reading logs...\r\nArduCopter V3.1.5\r\nFree RAM: 1331\r\n"],
)
def test_bytes_before_the_head_are_left_out_and_counted(
    tmp_path: Path, name: str, lead: bytes
) -> None:
    blob = SAMPLES[name]()
    if name == "ArduPilot DataFlash, text" and not lead.endswith(b"\n"):
        lead += b"\n"
    found = read(tmp_path, lead + blob)
    same(found, read(tmp_path, blob, "plain"))
    assert f"warning {len(lead)} bytes before the head of the log" in said(found)
    assert found.facts["format"] == name


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"ULogEnc" + bytes(15) + LEAD * 50, "encrypted.*decrypt it with your key"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12\n", "git lfs pull"),
        (b"<!DOCTYPE html>\n<html><title>404</title></html>", "HTML page"),
        (b"\n <HTML><body>", "HTML page"),
        (b'{"message": "Not Found"}', "JSON"),
        (b"<?xml version='1.0'?>", "XML"),
        (b"\xfd7zXZ\x00rest", "xz-compressed"),
        (b"7z\xbc\xaf\x27\x1crest", "7z archive"),
        (b"Rar!\x1a\x07\x01", "RAR archive"),
        (b"log" + bytes(254) + b"ustar\x0000" + ULOG, "tar archive"),
        (b"#ROSBAG V2.0\n", "ROS 1 bag"),
        (b"\xff\xfet\x00i\x00m\x00e\x00", "UTF-16"),
        (b"\xfd\x09\x00\x00\x00\x01\x01", "without times"),
        (b"\xfe\x09\x00\x01\x01\x00", "without times"),
        (bytes(5000), "5000 bytes, all of them 00"),
        (b"\xff" * 700, "700 bytes, all of them ff"),
    ],
)
def test_what_is_no_log_is_named(tmp_path: Path, content: bytes, text: str) -> None:
    with pytest.raises(LogError, match=text):
        read(tmp_path, content)


def test_a_table_behind_empty_lines_is_read(tmp_path: Path) -> None:
    blob = SAMPLES["flight table, CSV"]()
    behind = read(tmp_path, b"\r\n\n" + blob)
    assert len(behind.table) > 0
    same(behind, read(tmp_path, blob, "plain"))


@pytest.mark.parametrize("cut", [1, 5, 40, 88])
def test_a_dataflash_log_whose_first_bytes_are_cut_is_read_from_its_next_definition(
    tmp_path: Path, cut: int
) -> None:
    """FMT, which describes itself, is known without."""
    blob = SAMPLES["ArduPilot DataFlash"]()
    found = read(tmp_path, blob[cut:])
    same(found, read(tmp_path, blob, "plain"))
    assert f"{89 - cut} bytes before the head of the log" in said(found)
