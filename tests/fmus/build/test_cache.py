"""What was compiled before is taken from the cache only where it is what was put there."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from kinds import model

from fmus import build
from fmus.builder import cached, cached_or_made, store
from twin.errors import FmuError

Damage = Callable[[bytes, bytes], bytes]
DAMAGES: dict[str, Damage] = {
    "cut": lambda entry, _: entry[: len(entry) // 2],
    "empty": lambda *_: b"",
    "one bit": lambda entry, _: entry[:-1] + bytes([entry[-1] ^ 1]),
    "replaced": lambda entry, _: entry[:32] + b"\x7fELF of somebody else",
    "another entry's content": lambda entry, other: entry[:32] + other[32:],
}


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The FMU as it is made of nothing."""
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("good")
        patch.setenv("UAVTWIN_CACHE", str(folder / "cache"))
        return build(model("battery"), folder / "b.fmu", 2).read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("damage", ["cut", "another entry's content"])
def test_a_damaged_entry_never_gets_into_an_fmu(
    damage: str, good: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UAVTWIN_CACHE", str(tmp_path / "cache"))
    path = tmp_path / "b.fmu"
    build(model("battery"), path, 2)
    entries = sorted(p for p in (tmp_path / "cache").iterdir() if p.suffix in (".so", ".o"))
    before = [p.read_bytes() for p in entries]
    for i, entry in enumerate(entries):
        entry.write_bytes(DAMAGES[damage](before[i], before[i - 1]))
    path.unlink()
    assert build(model("battery"), path, 2).read_bytes() == good
    assert [p.read_bytes() for p in entries] == before  # and they are mended


def test_what_is_kept_is_read_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UAVTWIN_CACHE", str(tmp_path / "deep" / "cache"))
    assert cached("a.so") is None
    store("a.so", b"content")
    assert cached("a.so") == b"content"
    store("b.so", b"of another")
    for damage in DAMAGES.values():
        first, second = (tmp_path / "deep" / "cache" / name for name in ("a.so", "b.so"))
        whole = first.read_bytes()
        first.write_bytes(damage(whole, second.read_bytes()))
        assert cached("a.so") is None
        first.write_bytes(whole)
    assert (tmp_path / "deep" / "cache").stat().st_mode & 0o777 == 0o700


_MAKER = """
import pathlib, sys, time
from fmus.builder import cached_or_made

def make():
    with open(sys.argv[1], "a") as calls:
        calls.write("made\\n")
    time.sleep(0.5)
    return b"content"

assert cached_or_made("ab" * 32 + ".o", make) == b"content"
"""


def test_of_processes_that_want_the_same_at_once_one_makes_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UAVTWIN_CACHE", str(tmp_path / "cache"))
    command = [sys.executable, "-c", _MAKER, str(tmp_path / "calls")]
    several = [subprocess.Popen(command) for _ in range(3)]
    assert [p.wait() for p in several] == [0, 0, 0]
    assert (tmp_path / "calls").read_text() == "made\n"


def test_what_cannot_be_made_is_asked_for_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UAVTWIN_CACHE", str(tmp_path / "cache"))

    def fails() -> bytes:
        """As a compiler that finds a mistake."""
        raise FmuError("no")

    with pytest.raises(FmuError, match="no"):
        cached_or_made("cd.o", fails)
    assert cached_or_made("cd.o", lambda: b"mended") == b"mended"


@pytest.mark.parametrize("mode", [0o777, 0o775, 0o1777, 0o722])
def test_a_folder_that_others_may_write_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mode: int
) -> None:
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache").chmod(mode)
    monkeypatch.setenv("UAVTWIN_CACHE", str(tmp_path / "cache"))
    with pytest.raises(FmuError, match=r"others may write into it .*chmod go-w"):
        build(model("battery"), tmp_path / "b.fmu", 2)
    assert not (tmp_path / "b.fmu").exists()


def test_a_folder_of_somebody_else_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UAVTWIN_CACHE", str(tmp_path))
    monkeypatch.setattr(os, "getuid", lambda: tmp_path.stat().st_uid + 1)
    with pytest.raises(FmuError, match="belongs to user"):
        cached("a.so")


def test_a_place_where_no_folder_can_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("UAVTWIN_CACHE", str(tmp_path / "file" / "cache"))
    with pytest.raises(FmuError, match=r"file/cache: no folder for what was compiled"):
        store("a.so", b"")
