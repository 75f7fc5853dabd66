"""Numbers with units on the command line: one rule for all verbs."""

import re
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.main import get_command

from twin.errors import TwinError
from uavtwin.cli.main import app
from uavtwin.cli.options import named_numbers, quantity


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("90", "s", 90.0),
        ("1.5min", "s", 90.0),
        ("20 ms", "s", 0.02),
        ("1300g", "kg", 1.3),
        ("1.3", "kg", 1.3),
        ("480mm", "m", 0.48),
        ("19in", "m", 0.4826),
        ("-2e-3", "s", -2e-3),
        (".5", "s", 0.5),
        ("20ppm", "1", 2e-5),
        ("2048MiB", "GiB", 2.0),
        ("inf", "s", float("inf")),
    ],
)
def test_units_are_converted(text: str, unit: str, value: float) -> None:
    assert quantity(text, unit) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "unit", "says"),
    [
        ("", "s", "no number"),
        ("five", "s", "no number"),
        ("5kg", "s", "no unit of the kind of s"),
        ("5 parsnips", "s", "not a unit"),
        ("1.2.3", "s", "not a unit"),
        ("5s**9**9**9", "s", "not a unit"),
    ],
)
def test_what_is_no_quantity_is_refused(text: str, unit: str, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        quantity(text, unit)
    with pytest.raises(ValueError, match="has no unit"):
        quantity("480", "m", bare=False)


@given(st.floats(allow_nan=False))
def test_a_number_without_unit_is_itself(value: float) -> None:
    assert quantity(repr(value), "s") == value


def test_payloads_may_have_units() -> None:
    assert named_numbers(["a=b=300g", "c=0.2"], "--payload", "FLIGHT=KG", "kg") == {
        "a=b": 0.3,
        "c": 0.2,
    }
    with pytest.raises(TwinError, match=r"--payload a=3 m: .* write FLIGHT=KG"):
        named_numbers(["a=3 m"], "--payload", "FLIGHT=KG", "kg")


def parameters() -> dict[str, list[Any]]:
    """Options of every verb by name."""
    found: dict[str, list[Any]] = {}

    def walk(command: Any, path: str) -> None:
        for name, inner in getattr(command, "commands", {}).items():
            walk(inner, f"{path} {name}")
        for option in command.params:
            for name in option.opts:
                if name.startswith("--"):
                    found.setdefault(name, []).append((path, option))

    walk(get_command(app), "uavtwin")
    return found


def test_an_option_means_the_same_in_every_verb() -> None:
    """Of one name: one kind of value; a flight has a page, what comes from others is heard."""
    options = parameters()
    for name in ("--out", "--listen", "--serve", "--duration", "--horizon", "--start", "--stop"):
        kinds = {(str(o.bare_type), o.metavar) for _, o in options[name]}
        assert len(kinds) == 1, (name, kinds)
    assert [path for path, _ in options["--serve"]] == ["uavtwin live"]
    listen = {"uavtwin live", "uavtwin serve"}
    assert {path for path, _ in options["--listen"]} == listen


def test_numbers_in_seconds_take_units_everywhere() -> None:
    for name, places in parameters().items():
        for path, option in places:
            says = re.search(r", s[.,:;]", option.help or "") is not None
            assert (option.metavar == "SECONDS") == says, (path, name)


def test_a_wrong_unit_is_wrong_use() -> None:
    with pytest.raises(SystemExit) as caught:
        get_command(app).main(["simulate", "hover", "--stop", "5kg"])
    assert caught.value.code == 2
