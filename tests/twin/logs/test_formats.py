"""The table of log formats: no part of a format is forgotten, and what is said of them is right.

That each format keeps its word is in `test_each_format.py`.
"""

import ast
import os
import subprocess
import sys
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest
from sample_logs import SAMPLES

import twin.logs
from twin.errors import LogError
from twin.logs import read_flight
from twin.logs.formats import (
    FORMATS,
    HEAD,
    FirstWord,
    LogFormat,
    Magic,
    ReadOptions,
    known_formats,
    recognise,
)
from twin.logs.read import CERTAIN, PERHAPS

LOGS = Path(twin.logs.__file__).parent
NAMES = [f.name for f in FORMATS]
ULOG = next(f for f in FORMATS if f.name == "PX4 ULog")


# -- nothing is forgotten -------------------------------------------------------------------


@pytest.mark.parametrize("each", FORMATS, ids=NAMES)
def test_the_reader_of_every_row_is_there(each: LogFormat) -> None:
    if any(find_spec(p) is None for p in each.packages):
        pytest.skip("its package is not installed")
    module, _, function = each.reader.partition(":")
    path = LOGS / f"{module.replace('.', '/')}.py"
    assert path.is_file(), f"{each.name!r} names the reader {each.reader}: there is no {path.name}"
    found = import_module(f"twin.logs.{module}")
    assert hasattr(found, function), f"{each.name!r}: {path.name} has no function {function}"


@pytest.mark.slow
def test_every_reader_has_a_row() -> None:
    """A reader is a public function that takes a path, bytes and `ReadOptions`."""
    readers = set()
    for path in LOGS.rglob("*.py"):
        module = ".".join(path.relative_to(LOGS).with_suffix("").parts)
        for node in ast.parse(path.read_text("utf-8")).body:
            if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
                kinds = [ast.unparse(a.annotation) for a in node.args.args if a.annotation]
                if kinds == ["Path", "bytes", ReadOptions.__name__]:
                    readers.add(f"{module}:{node.name}")
    forgotten = sorted(readers - {f.reader for f in FORMATS})
    assert not forgotten, f"in no row of twin/logs/formats.py: {', '.join(forgotten)}"


def test_every_format_has_a_sample() -> None:
    lacking, spare = sorted(set(NAMES) - set(SAMPLES)), sorted(set(SAMPLES) - set(NAMES))
    assert not lacking, f"no sample in tests/rigs/sample_logs.py: {', '.join(lacking)}"
    assert not spare, f"samples of no format: {', '.join(spare)}"


def test_what_is_refused_is_no_format() -> None:
    """A kind that is read now must leave the list of those that are not."""
    for each in FORMATS:
        if any(find_spec(p) is None for p in each.packages):
            continue
        name = each.name
        head = SAMPLES[name]()[:HEAD]
        claimed = [text for s, text in (*CERTAIN, *PERHAPS) if s.matches(head)]
        assert not claimed, f"{name!r} is refused as {claimed[0]}"


def test_names_and_endings_are_those_of_one_format() -> None:
    assert len(set(NAMES)) == len(NAMES)
    endings = [s for f in FORMATS for s in f.suffixes]
    assert len(set(endings)) == len(endings) and all(s.startswith(".") for s in endings)


# -- what is said ---------------------------------------------------------------------------


def test_unknown_bytes_name_all_known_formats(tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(b"\x00\x01\x02\x03")
    with pytest.raises(LogError, match="no known flight log") as error:
        read_flight(tmp_path / "x")
    assert known_formats() in str(error.value)
    for each in FORMATS:
        assert each.name in str(error.value) and all(s in str(error.value) for s in each.suffixes)


def test_bytes_that_two_formats_claim_are_refused() -> None:
    twice = (*FORMATS, replace(ULOG, name="other", signature=Magic(b"ULog")))
    with pytest.raises(LogError, match=r"like PX4 ULog and like other .* as one of: .*PX4 ULog"):
        recognise(SAMPLES["PX4 ULog"](), twice)
    assert recognise(b"nothing", twice) is None


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyulog", None)
    for module in ("px4.log", "px4.ulog"):
        monkeypatch.delitem(sys.modules, f"twin.logs.{module}", raising=False)
    with pytest.raises(LogError, match=r"PX4 ULog is read with pyulog.*pip install pyulog"):
        ULOG.load()


@pytest.mark.slow
def test_only_the_reader_of_the_format_is_imported(tmp_path: Path) -> None:
    """A Parquet table needs no pyulog."""
    path = tmp_path / "flight.parquet"
    path.write_bytes(SAMPLES["flight table, Parquet"]())
    code = (
        "import sys; from twin.logs import read_flight\n"
        f"read_flight({str(path)!r}); print([m for m in sys.modules if 'ulog' in m])"
    )
    said = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONPATH": str(LOGS.parents[1])},
    )
    assert said.stdout == "[]\n"


@pytest.mark.parametrize(
    ("signature", "head", "matches", "damage"),
    [
        (Magic(b"ULog\x01\x12"), b"ULog\x01\x12rest", True, ""),
        (Magic(b"ULog\x01\x12"), b"UL", False, "cut off after 2 bytes"),
        (Magic(b"ULog\x01\x12"), b"ULog\x02\x12", False, "its signature is damaged"),
        (Magic(b"ULog\x01\x12"), b"ULoX\x01\x12", False, ""),
        (Magic(b"\xfe", at=3), b"abc\xfe", True, ""),
        (Magic(b"\xfe", at=3), b"\xfeabc", False, ""),
        (FirstWord(b"time"), b'\xef\xbb\xbf "Time",x', True, ""),
        (FirstWord(b"time"), b"a time", False, ""),
    ],
)
def test_signatures(signature: Magic | FirstWord, head: bytes, matches: bool, damage: str) -> None:
    assert signature.matches(head) is matches
    assert signature.damage(head) == damage


def test_signatures_can_be_printed() -> None:
    assert str(Magic(b"ULog\x01\x12\x35")) == "`ULog` bytes 01 12 35"
    assert str(Magic(b"\xfe", at=8)) == "bytes fe at byte 8"
    assert str(FirstWord(b"time")) == "the word `time`"
