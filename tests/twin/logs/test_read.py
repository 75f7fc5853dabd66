"""Any file at all: a flight, or a LogError that says what it looks like."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.errors import LogError, TwinError
from twin.logs import read_flight


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"", "empty"),
        (b"\xa3\x95\x80\x80", "ArduPilot DataFlash log of 4 bytes"),
        (b"FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n", "DataFlash .* 1 messages"),
        (b"PK\x03\x04", "ZIP"),
        (b"\x1f\x8b\x08", "gzip"),
        (b"ULo", "cut off after 3 bytes"),
        (b"ULog\x01", "cut off after 5 bytes"),
        (b"ULog\x00\x00\x00\x00", "signature is damaged"),
        (b"roll,pitch\n1,2\n", "begins with 'roll,pitch'"),
        (b"\x00\x01\x02\x03", "no known flight log"),
        (b"PAR1", "damaged Parquet"),
    ],
)
def test_what_is_no_flight_is_named(tmp_path: Path, content: bytes, text: str) -> None:
    path = tmp_path / "file.bin"
    path.write_bytes(content)
    with pytest.raises(LogError, match=text):
        read_flight(path)


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no such file"):
        read_flight(tmp_path / "none.ulg")
    with pytest.raises(LogError, match="folder"):
        read_flight(tmp_path)
    with pytest.raises(LogError, match="cannot be read"):
        read_flight("a\x00b")


HEADS = [b"", b"ULog\x01\x12\x35\x01", b"PAR1", b"time,acc_x\n", b"\xa3\x95", b"FMT, "]


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(
    st.sampled_from(
        [b"", b"ULog\x01\x12\x35\x01", b"PAR1", b"time,acc_x\n", b"\xa3\x95", b"FMT, "]
    ),
    st.binary(),
)
def test_random_bytes_never_raise_anything_else(
    tmp_path_factory: pytest.TempPathFactory, head: bytes, tail: bytes
) -> None:
    path = tmp_path_factory.mktemp("r") / "file"
    path.write_bytes(head + tail)
    try:
        read_flight(path)
    except TwinError as error:
        assert len(str(error)) > 20
