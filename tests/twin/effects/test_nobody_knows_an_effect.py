"""Who searches, compares, flies and reports knows effects by how they are seen, not by name."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from twin.effects import _MODULES, EFFECTS, Effect, Repeats, Shift
from twin.effects.definition import Average, Displacement, Lines, NoiseFloor, RandomForce

ROOT = Path(__file__).parents[3]
FOLDERS = ("twin/explain", "twin/residuals", "twin/flight", "uavtwin")
SPOKEN = ("uavtwin/wording.py", "uavtwin/calibration.py", "twin/explain/balance.py")
"""Sentences of effects that have one of their own, and the competition of a weak rotor with a load;
other effects are reported by their numbers."""
FILES = sorted(
    p
    for folder in FOLDERS
    for p in (ROOT / folder).rglob("*.py")
    if p.relative_to(ROOT).as_posix() not in SPOKEN
)
NAMED = re.compile(rf"(.*[.\W])?({'|'.join(EFFECTS)})(\..*)?")


def test_every_effect_of_a_module_is_in_its_list() -> None:
    made = [
        effect
        for module in _MODULES
        for effect in vars(module).values()
        if isinstance(effect, Effect)
    ]
    missing = sorted(e.name for e in made if e.name not in EFFECTS)
    assert not missing, f"in no list EFFECTS of twin/effects: {missing}"


def test_what_an_effect_is_mistaken_for_is_an_effect() -> None:
    named = {other for e in EFFECTS.values() for other in e.mistaken_for}
    assert named <= {*EFFECTS}
    assert named


def literals(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Strings of a module that are no docstring, with their lines."""
    prose = {id(s.value) for s in ast.walk(tree) if isinstance(s, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in prose:
            yield node.lineno, node.value


@pytest.mark.slow
@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_no_effect_is_known_by_name(path: Path) -> None:
    found = [
        f"line {line}: {text}"
        for line, text in literals(ast.parse(path.read_text(encoding="utf-8")))
        if " " not in text and NAMED.fullmatch(text)
    ]
    assert not found, "let the effect say how it is seen (twin/effects/definition.py)"


def test_the_pattern_finds_names() -> None:
    source = '"""rotor_drag"""\nx = "rotor_drag"\ny = f"gust.{x}"\nz = "environment.gust.enabled"'
    found = [text for _, text in literals(ast.parse(source)) if NAMED.fullmatch(text)]
    assert {*found} == {"rotor_drag", "gust.", "environment.gust.enabled"}


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=EFFECTS)
def test_what_an_effect_says_of_itself_names_its_own_numbers(effect: Effect) -> None:
    own = {p.name for p in (*effect.parameters, *effect.of_logs)}
    match effect.observable_as:
        case Shift(moves=moves):
            named = {*moves}
        case Average(spreads=spreads):
            named = {*spreads}
        case Displacement(less=less):
            named = {*less}
            assert {n.partition(".")[0] for n in less.values()} <= EFFECTS.keys()
        case NoiseFloor(scale=scale, further=further):
            named = {scale, *further.values()}
        case Lines(frequency=frequency, amplitudes=amplitudes):
            named = {frequency, *amplitudes.values()}
        case RandomForce(intensity=intensity, length=length):
            named = {*intensity, *length}
        case Repeats(channel=channel, since=since):
            named = {channel, since}
        case equation:
            named = {n for n in [equation.turns_pose] if n is not None}
    assert named <= own
    assert {p.name for p in effect.of_logs} <= named
