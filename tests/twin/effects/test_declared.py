"""Each effect gives prior, change, wording and advice, or declines it by None."""

import re
from dataclasses import MISSING, fields
from typing import Any

import pytest
from places import ROOT

from twin.effects import EFFECTS, Effect, advice_of
from twin.effects.wording import ADVICE

DECLARED = ("prior", "change", "wording", "advice")


@pytest.mark.parametrize("what", DECLARED)
def test_an_effect_that_forgets_one_does_not_import(what: str) -> None:
    given: dict[str, Any] = dict.fromkeys(DECLARED)
    (field,) = (f for f in fields(Effect) if f.name == what)
    assert field.default is MISSING and field.default_factory is MISSING
    del given[what]
    with pytest.raises(TypeError, match=what):
        Effect("x", "", "airframe", object, (), (), "", lambda s, _: s, **given)


@pytest.mark.parametrize("what", DECLARED)
def test_the_list_says_which_effects_decline_what(what: str) -> None:
    """The list is generated, so that a new definition that declines something shows in it."""
    text = (ROOT / "docs" / "reference" / "effects.md").read_text("utf-8")
    (line,) = (row for row in text.splitlines() if row.startswith(f"| `{what}` |"))
    declined = {name for name, e in EFFECTS.items() if getattr(e, what) is None}
    assert declined and {*re.findall(r"`(\w+)`", line.split("|")[3])} == declined


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=EFFECTS)
def test_what_is_declared_fits_the_numbers(effect: Effect) -> None:
    names = [p.name for p in (*effect.parameters, *effect.of_logs)]
    for prior in (effect.prior, effect.change):
        for indoors in (False, True):
            assert prior is None or all(prior.of(n, indoors).sd > 0 for n in names)
    for stem in effect.advice or {}:
        assert any(n.startswith(stem) for n in names)
    if effect.wording is not None:
        assert {*effect.wording.secondary} <= {*names}


def test_clauses_about_what_would_not_show_have_an_order() -> None:
    every = (e.wording.undetected for e in EFFECTS.values() if e.wording)
    places = [u.place for u in every if u is not None]
    assert sorted(places) == [*range(1, len(places) + 1)]


def test_advice_is_by_the_longest_beginning() -> None:
    yaw, roll = (advice_of(f"inertia_error.scale_{a}") for a in "zx")
    assert yaw is not None and roll is not None
    assert (yaw.topic, roll.topic) == ("yaw torque", "inertia and lag")
    assert advice_of("gyro_bias.x_rad_s") is None
    assert {*ADVICE} == {a for e in EFFECTS.values() for a in (e.advice or {}).values()}
