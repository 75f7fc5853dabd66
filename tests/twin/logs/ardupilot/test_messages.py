"""DataFlash files: every value as pymavlink reads it; damage counted, the rest kept."""

import struct
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from log_rigs.dataflash_rig import KINDS, MARK, dataflash, message
from numpy.typing import ArrayLike
from places import needs_package
from sample_logs import FLOWN_PARAMS, flown_messages

from twin.logs.ardupilot.file import (
    Content,
    Messages,
    define,
    in_si,
    read_binary,
    read_plain,
    units_of,
)


def _first(messages: Any) -> dict[str, ArrayLike]:
    """A second of them."""
    return {k: np.asarray(v)[np.asarray(messages["t"]) < 1.0] for k, v in messages.items()}


FLOWN = dataflash(flown_messages(), FLOWN_PARAMS)
SHORT = dataflash({n: _first(m) for n, m in flown_messages().items()}, FLOWN_PARAMS)
NAMES = ("IMU", "XKQ", "XKF1", "RCOU", "PARM", "BARO")
ROWS = 100
"""Messages of a kind that are held against pymavlink's, from both ends and between."""


def values(messages: Messages, row: int) -> list[Any]:
    told = messages.definition
    return [
        messages.texts(c)[row] if told.is_text(c) else float(messages.data[c][row])
        for c in told.columns
    ]


def same_as_pymavlink(path: Path, content: Content, text: bool) -> int:
    """How many values have been compared."""
    from pymavlink import DFReader

    reader = DFReader.DFReader_text(path) if text else DFReader.DFReader_binary(path)
    found: dict[str, list[Any]] = {}
    while (m := reader.recv_msg()) is not None:
        found.setdefault(m.get_type(), []).append(m)
    counts = {n: len(m) for n, m in found.items()}
    lines = {"UNIT": content.counts["UNIT"]} if text else {}  # it drops that of an empty label
    assert counts | lines == content.counts
    compared = 0
    for name, each in content.messages.items():
        assert len(each.places) == len(found[name])
        step = max(len(each.places) // ROWS, 1)
        for row in range(0, len(each.places), step):
            told = [getattr(found[name][row], c) for c in each.definition.columns]
            mine = values(each, row)
            for a, b in zip(mine, told, strict=True):
                same = a == b or (a != a and b != b) or (text and a == pytest.approx(b))
                assert same, (name, row, mine, told)
                compared += 1
    reader.close()
    return compared


@pytest.mark.slow
@needs_package("pymavlink")
@pytest.mark.parametrize("text", [False, True])
def test_every_value_is_that_of_pymavlink(tmp_path: Path, text: bool) -> None:
    blob = dataflash(flown_messages(), FLOWN_PARAMS, text=text)
    path = tmp_path / "log"
    path.write_bytes(blob)
    content = (read_plain if text else read_binary)(blob, NAMES)
    assert same_as_pymavlink(path, content, text) > 1500
    assert content.damage.lost == content.damage.tail == 0


@pytest.mark.slow
@needs_package("pymavlink")
def test_every_value_of_a_recorded_log_is_that_of_pymavlink(data_dir: Path) -> None:
    path = data_dir / "quiver_pt1" / "pt1_00000092.BIN"
    names = (*NAMES, "ATT", "BAT", "ESC", "EV", "GPS", "MAG", "MODE", "MSG", "RATE", "VER", "VIBE")
    assert same_as_pymavlink(path, read_binary(path.read_bytes(), names), False) > 10_000


def test_text_and_binary_say_the_same() -> None:
    binary = read_binary(FLOWN, NAMES)
    text = read_plain(dataflash(flown_messages(), FLOWN_PARAMS, text=True), NAMES)
    assert binary.counts == text.counts
    for name in NAMES:
        a, b = binary.messages[name], text.messages[name]
        assert a.units == b.units
        for column in a.definition.columns:
            if not a.definition.is_text(column):
                np.testing.assert_allclose(
                    a.data[column].astype(float), b.data[column].astype(float), rtol=1e-6
                )


def test_a_lost_definition_loses_its_messages_alone() -> None:
    """pymavlink's index ends there."""
    at = FLOWN.index(b"XKQ\0")
    begin = FLOWN.rindex(MARK, 0, at)
    content = read_binary(FLOWN[:begin] + FLOWN[begin + 89 :], NAMES)
    whole = read_binary(FLOWN, NAMES)
    assert "XKQ" not in content.messages
    left = {n: c for n, c in whole.counts.items() if n not in ("FMT", "XKQ")}
    assert {n: content.counts[n] for n in left} == left
    size = whole.messages["XKQ"].definition.size
    assert content.damage.lost == whole.counts["XKQ"] * size
    assert content.damage.stretches > 100


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(st.integers(SHORT.rindex(b"SERVO"), len(SHORT)), st.integers(1, 3000))
def test_bytes_that_are_missing_are_noticed(at: int, count: int) -> None:
    """Unless whole messages are missing: those before and after are read, no other is made up."""
    whole, content = read_binary(SHORT, NAMES), read_binary(SHORT[:at] + SHORT[at + count :], NAMES)
    for name in NAMES:
        mine = content.messages[name].data if name in content.messages else {}
        rows = {tuple(r) for r in zip(*mine.values(), strict=True)}
        known = {tuple(r) for r in zip(*whole.messages[name].data.values(), strict=True)}
        assert len(rows - known) <= 1  # one whose head and tail belong to two
    fewer = sum(whole.counts.values()) - sum(content.counts.values())
    damage = content.damage
    assert damage.lost or damage.tail or fewer * 11 <= min(count, len(SHORT) - at) + 89


def test_garbage_between_messages_is_counted() -> None:
    at = FLOWN.index(message("XKQ", (5_000_000, 0, 1, 0, 0, 0))[:3])
    content = read_binary(FLOWN[:at] + b"\x01" * 777 + FLOWN[at:], NAMES)
    assert (content.damage.lost, content.damage.stretches) == (777, 1) or content.damage.lost > 777
    assert content.damage.lost < 1000


@pytest.mark.parametrize("padding", [b"", b"\0" * 400, b"\xff" * 400])
def test_padding_at_the_end_is_no_damage(padding: bytes) -> None:
    content = read_binary(FLOWN + padding, NAMES)
    assert content.damage.lost == content.damage.tail == 0
    assert content.counts == read_binary(FLOWN, NAMES).counts


@pytest.mark.parametrize("left", [1, 2, 3, 20])
def test_a_message_cut_off_at_the_end_is_its_tail(left: int) -> None:
    last = FLOWN.rindex(MARK + bytes([1 + list(KINDS).index("IMU")]))
    damage = read_binary(FLOWN[: last + left], NAMES).damage
    assert (damage.tail, damage.lost) == (left, 0)


def fmt(number: int, length: int, name: bytes, letters: bytes, columns: bytes) -> bytes:
    return MARK + b"\x80" + struct.pack("<BB4s16s64s", number, length, name, letters, columns)


@pytest.mark.parametrize(
    ("name", "length", "letters", "columns", "why"),
    [
        ("ODD", 12, "QB", "TimeUS", "1 names for 2 columns"),
        ("ODD", 12, "Q?", "TimeUS,x", "format letter '\\?'"),
        ("ODD", 99, "QB", "TimeUS,x", "take 12 bytes, not 99"),
        ("ODD", 12, "QB", "TimeUS,TimeUS", "one name"),
        ("", 12, "QB", "TimeUS,x", "its name"),
        ("ODD", 4, "", "", "0 names"),
    ],
)
def test_a_definition_that_makes_no_sense_is_told(
    name: str, length: int, letters: str, columns: str, why: str
) -> None:
    with pytest.raises(ValueError, match=why):
        define(7, length, name, letters, columns)
    made = fmt(7, length, name.encode(), letters.encode(), columns.encode())
    odd = MARK + b"\x07" + bytes(length - 3)
    content = read_binary(FLOWN[:89] + made + odd * 3 + FLOWN[89:], NAMES)
    assert len(content.damage.undefined) == 1 and content.damage.lost == 0
    assert content.counts[name or "of type 7"] == 3  # stepped over


def test_a_second_definition_does_not_change_the_messages_before_it() -> None:
    """Those behind it are its own; the kind with most messages counts."""
    number = 1 + list(KINDS).index("XKQ")
    half = FLOWN.index(MARK + bytes([number]), len(FLOWN) * 2 // 3)
    other = fmt(number, 11, b"XKQ", b"Q", b"TimeUS")
    content = read_binary(FLOWN[:half] + other + FLOWN[half:], NAMES)
    assert content.damage.redefined == ["XKQ"]
    whole = read_binary(FLOWN, NAMES).messages["XKQ"].data["Q1"]
    first = content.messages["XKQ"].data["Q1"]
    np.testing.assert_array_equal(first, whole[: len(first)])
    assert 0.5 * len(whole) < len(first) < len(whole)
    again = read_binary(FLOWN[:half] + FLOWN[:89] + FLOWN[half:], NAMES)
    assert again.damage.redefined == []  # the same once more is none


@pytest.mark.slow
def test_lines_that_make_no_sense_are_counted() -> None:
    lines = dataflash(flown_messages(), FLOWN_PARAMS, text=True).decode().splitlines(True)
    lines[500:500] = ["NONE, 1, 2\n", "IMU, 1, 2\n", "\n"]
    lines[700] = lines[700].replace(", ", ", x", 1)
    content = read_plain("".join(lines).encode() + b"IMU, 5", NAMES)
    assert content.damage.stretches == 2 and content.damage.tail == 6
    assert sum(content.counts.values()) == len(lines) - 3
    file = [lines[0], "FMT, 9, 87, FILE, NIZ, FileName,Offset,Data\n", *lines[1:]]
    file[400:400] = ["FILE, @SYS/x.txt, 0, one, two\n", "three\n", "\n", "four, 5\n"]
    within = read_plain("".join(file).encode(), NAMES)
    assert within.damage.lost == content.damage.lost and within.counts["FILE"] == 1


def test_ends_that_look_like_padding_take_no_time() -> None:
    """Each of 200 000 messages is followed by what could be padding up to the end."""
    short = fmt(9, 4, b"X", b"B", b"x")
    blob = short + (MARK + b"\x09\x01\0") * 200_000 + b"\x01"
    begin = time.process_time()
    damage = read_binary(blob, NAMES).damage
    assert time.process_time() - begin < 5.0
    assert damage.lost >= 1_000_000


def test_units_come_from_the_log() -> None:
    imu = define(3, None, "MAG", "QBhhc", "TimeUS,I,X,Y,T")
    labels, factors = {"G": "Gauss", "s": "s", "d": "deg"}, {"C": 1e-3, "F": 1e-6, "B": 1e-2}
    units = units_of(imu, "s#G?d", "F-C-B", labels, factors)
    assert units.instance == "I"
    assert units.labels == {"TimeUS": "s", "X": "Gauss", "T": "deg"}
    assert units.multipliers == {"TimeUS": 1e-6, "X": 1e-3}  # T has the divisor of its format
    assert in_si("Gauss", "Gauss") == (1e-4, False)
    assert in_si("deg/s", "rad/s") == (np.pi / 180.0, False)
    assert in_si("", "rad/s") == (1.0, False)
    assert in_si("V", "rad/s") == (1.0, True)
