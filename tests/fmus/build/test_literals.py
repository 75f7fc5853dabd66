"""Literals of generated C against a C compiler; names and texts of a model in its files."""

import subprocess
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from kinds import model, recorded
from lxml import etree

from fmus import replay_model
from fmus.builder import write_archive
from fmus.description import model_description
from fmus.names import check_name, check_text, shown
from fmus.source import c_list, c_number, c_string, generated_sources
from twin.errors import FmuError
from twin.logs.columns import is_known, motor_number

NASTY = (
    "",
    '"',
    "\\",
    '\\"',
    "a\nb",
    "*/",
    "//",
    "??/",
    '??/" ',
    "??'",
    "%s",
    "\x7f\x01",
    "é" * 3 + "0",
    "\x010",
    "日本",
    "\\\n",
    "\r",
)


def test_a_compiler_reads_every_text_back(tmp_path: Path) -> None:
    """Trigraphs, octal digits behind an escape, both marks of a comment, any script."""
    rng = np.random.default_rng(0)
    alphabet = [*map(chr, range(1, 128)), "é", "日", "\U0001f681", *'"\\?/\n01' * 10]
    texts = [*NASTY, *("".join(rng.choice(alphabet, rng.integers(40))) for _ in range(300))]
    rows = ",\n".join(map(c_string, texts))
    code = (
        "#include <stdio.h>\n#include <string.h>\n"
        f"static const char* const texts[] = {{\n{rows}}};\n"
        "int main(void) {\n"
        "    for (size_t i = 0; i < sizeof texts / sizeof *texts; i++)\n"
        "        fwrite(texts[i], 1, strlen(texts[i]) + 1, stdout);\n"
        "    return 0;\n}\n"
    )
    (tmp_path / "texts.c").write_text(code)
    program = tmp_path / "texts"
    subprocess.run(
        ["cc", "-std=c99", "-trigraphs", "-Werror", str(tmp_path / "texts.c"), "-o", str(program)],
        check=True,
    )
    said = subprocess.run([program], capture_output=True, check=True).stdout
    assert said.split(b"\0")[:-1] == [t.encode() for t in texts]


@given(st.text())
@example("\0")
@example("\ud800")
def test_a_literal_ends_where_it_ends(text: str) -> None:
    """Between the quotes stand plain characters, and backslashes with three octal digits."""
    if "\0" in text or any("\ud800" <= c <= "\udfff" for c in text):
        with pytest.raises(FmuError):
            c_string(text)
        return
    literal = c_string(text)
    assert literal[0] == literal[-1] == '"'
    assert not set(literal[1:-1]) & set('"?\n\r')
    pieces = literal[1:-1].split("\\")[1:]
    assert all(len(p) >= 3 and set(p[:3]) <= set("01234567") for p in pieces)
    assert literal.isascii()


@given(st.floats(allow_nan=False, allow_infinity=False) | st.integers())
def test_numbers_read_back(value: float) -> None:
    assert type(value)(c_number(value)) == value
    assert c_number(np.float64(0.1)) == "0.1"


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, True, "1", None, "0; system()"])
def test_what_is_no_constant(value: object) -> None:
    with pytest.raises(FmuError, match="cannot be a constant of C"):
        c_number(value)  # type: ignore[arg-type]
    with pytest.raises(FmuError, match="cannot be a constant of C"):
        c_list([0.5, value])  # type: ignore[list-item]


@given(st.text(max_size=70))
def test_names(text: str) -> None:
    """What is taken is ASCII, short, and begins as an identifier does."""
    try:
        assert check_name("here", text) == text
    except FmuError as error:
        assert "here" in str(error) and str(error).isascii()
        assert not (text.isascii() and text.isidentifier() and len(text) <= 64)
    else:
        assert text.isascii() and text.replace(".", "_").isidentifier()


@given(st.text(max_size=200))
def test_a_description_stands_in_xml_as_it_is_or_is_refused(text: str) -> None:
    """Quotes, angle brackets and ampersands too; control characters and half ones are refused."""
    changed = replace(model("battery"), description=text)
    for fmi in (2, 3):
        try:
            xml = model_description(changed, fmi, "token", ())
        except FmuError as error:
            assert not text.isprintable()
            assert "description" in str(error)
        else:
            assert etree.fromstring(xml).get("description") == text


def test_messages_are_plain() -> None:
    """No terminal is steered by the name of a file's signal."""
    assert shown("\x1b[2J\n" + "x" * 500).isprintable()
    assert len(shown("x" * 500)) < 100
    with pytest.raises(FmuError, match=r"\\x1b"):
        check_text("here", "\x1b[2J")


def test_each_place_of_a_model_is_checked() -> None:
    """Parts, macros, glue, variables, numbers; states and lines are written as literals."""
    battery = model("battery")
    (part,) = battery.parts
    first = part.variables[0]
    evil = 'x"}; int owned'
    for wrong in (
        replace(part, name=evil),
        replace(part, glue=evil),
        replace(part, defines={evil: 1}),
        replace(part, defines={"N": "1; int owned"}),  # type: ignore[dict-item]
        replace(part, max_step_s=float("nan")),
        replace(part, variables=(replace(first, name=evil), *part.variables[1:])),
        replace(part, variables=(replace(first, start=float("inf")), *part.variables[1:])),
        replace(part, variables=(replace(first, minimum=float("nan")), *part.variables[1:])),
    ):
        with pytest.raises(FmuError, match=r"is no name|constant of C"):
            generated_sources(replace(battery, parts=(wrong,)), "token")
    fine = replace(part, state_names=(evil,), folder=evil)
    text = generated_sources(replace(battery, parts=(fine,)), '"token')["part_battery.c"]
    assert '"x\\042}; int owned"' in text
    twice = replace(part, variables=(first, *part.variables))
    with pytest.raises(FmuError, match="is there twice"):
        model_description(replace(battery, parts=(twice,)), 2, "token", ())
    for name in (evil, "a.b", "../x", ""):
        with pytest.raises(FmuError, match="is no name"):
            model_description(replace(battery, name=name), 2, "token", ())


@pytest.mark.parametrize("name", ["../x", "/etc/x", "a/../b", "a\\b", "c:x", "a\nb", ""])
def test_no_member_leaves_the_archive(tmp_path: Path, name: str) -> None:
    with pytest.raises(FmuError, match="is no name of a member"):
        write_archive(tmp_path / "x.fmu", {name: b""})
    assert list(tmp_path.iterdir()) == []
    write_archive(tmp_path / "x.fmu", {"resources/part/record.bin": b"1"})
    assert zipfile.ZipFile(tmp_path / "x.fmu").namelist() == ["resources/part/record.bin"]


def test_a_flight_table_names_nothing() -> None:
    """Columns are those of the table's definition, motors by ASCII digits."""
    for name in ('cmd_1", OUTPUT', "cmd_1٣", "cmd_1\n", "cmd_01", "acc_x "):
        assert not is_known(name), name
        assert motor_number(name) is None
    flight = recorded(time=[0.0, 1.0], cmd_1=[0.0, 1.0])
    with pytest.raises(FmuError, match="is no text"):
        model_description(replay_model(replace(flight, name="a\x1b\x00"), ("cmd_1",)), 2, "t", ())
    spelled = replay_model(replace(flight, name='<"flight" & co>'), ("cmd_1",))
    root = etree.fromstring(model_description(spelled, 2, "t", ()))
    assert root.get("description") == 'Recorded flight <"flight" & co>'
