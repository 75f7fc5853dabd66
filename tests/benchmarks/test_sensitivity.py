"""Every setting has a half and a double; what changes by it is counted and told."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stand_ins import by_setting

from benchmarks.hidden_effects.files import write_json
from benchmarks.hidden_effects.measures import Outcome
from benchmarks.hidden_effects.run import Worker
from benchmarks.sensitivity import __main__ as sensitivity
from benchmarks.sensitivity.changes import change
from benchmarks.sensitivity.page import page
from benchmarks.sensitivity.variants import Variant, times, variants
from benchmarks.sensitivity.watch import Noted, watched
from twin.explain.setting_group import numbers
from twin.explain.settings import DEFAULT

EVERY = {s.name: s for s in DEFAULT.every()}
SURE = "inference.selection.sure"


def test_every_setting_has_a_half_and_a_double_that_are_allowed() -> None:
    found: dict[str, list[Variant]] = {}
    for variant in variants():
        DEFAULT.with_values({variant.setting.name: variant.value})  # refuses what makes no sense
        found.setdefault(variant.setting.name, []).append(variant)
    assert set(found) == set(EVERY)
    for own in found.values():
        half, double = own
        usual = numbers(half.setting.value)
        assert all(
            h < x < d
            for h, x, d in zip(numbers(half.value), usual, numbers(double.value), strict=True)
        )


@pytest.mark.parametrize(
    ("name", "half", "double"),
    [
        ("inference.likelihood.huber", 2.0, 8.0),
        (SURE, 0.4, 0.9),
        ("inference.evidence.samples", 125.0, 500.0),
        ("inference.likelihood.order", 8, 30),
        ("unnamed.tones_hz", (0.15, 5.0), (0.6, 20.0)),
        ("stochastic.gust.band_hz", (0.05, 1.5), (0.4 / 3, 4.0)),
    ],
)
def test_halves_and_doubles(name: str, half: object, double: object) -> None:
    assert times(EVERY[name], 0.5) == pytest.approx(half)
    assert times(EVERY[name], 2.0) == pytest.approx(double)


def outcome(hidden: str, verdict: str, **probabilities: float) -> Outcome:
    effects = [{"name": k, "probability": v} for k, v in probabilities.items() if k != "nothing"]
    said: dict[str, Any] = {"verdict": verdict, "effects": effects}
    said["nothing_probability"] = probabilities.get("nothing")
    kind = "single" if hidden else "nothing"
    return Outcome({"kind": kind, "effects": [{"name": hidden}] if hidden else []}, said)


def test_changes_are_counted_against_the_default() -> None:
    (variant,) = (v for v in variants([SURE]) if v.way == "doubled")
    usual = [
        outcome("gust", "named", gust=0.99, nothing=0.0),
        outcome("gust", "named", gust=0.85),
        outcome("", "nothing", nothing=0.95),
    ]
    now = [
        outcome("gust", "named", gust=0.985, nothing=0.004),
        outcome("gust", "cannot_tell", gust=0.6, mass_offset=0.3),
        outcome("", "nothing", nothing=0.95),
    ]
    same, other = change(variant, usual, usual), change(variant, usual, now)
    assert not same.matters
    assert other.matters
    assert (other.verdicts, other.names, other.right) == (1, 1, (2, 3))
    assert other.probability == pytest.approx(0.3)
    text = page("command", 107, usual, [other], "0123")
    assert f"| `{SURE}` | 0.8 | 0.9 | 1 of 3 | 1 of 3 | 0.30 | 3 to 2 |" in text
    assert "3 cases: gust (2), nothing hidden." in text
    assert f"by 0.01: `{SURE}`" in page("command", 107, usual, [same], "0123")


def test_answers_are_asked_once_and_with_the_setting_changed(tmp_path: Path) -> None:
    for case in ("a", "b"):
        truth = {"kind": "nothing", "effects": []}
        write_json(tmp_path / "truth" / f"{case}.json", truth)
    chosen = list(variants([SURE]))

    def go() -> dict[Path, int]:
        sensitivity.answer_all(tmp_path, ["a", "b"], chosen, 2, lambda: Worker(by_setting))
        return {f: f.stat().st_mtime_ns for f in (tmp_path / "answers").rglob("*.json")}

    first = go()
    assert len(first) == 2 * 3
    assert go() == first
    next(iter(first)).unlink()
    assert len(go()) == 6
    usual, changes = sensitivity.compare(tmp_path, ["a", "b"], chosen)
    assert [o.verdict for o in usual] == ["nothing", "nothing"]
    half, double = changes  # the stand-in finds something where a name is given from 0.5 on
    assert (half.verdicts, double.verdicts) == (2, 0)


def test_a_change_is_noted_where_it_decides_or_where_it_cannot_be_followed() -> None:
    settings, noted = watched(variants(["stochastic.gust", "usable.shortest_s", "unnamed.folds"]))
    gust, seconds = settings.stochastic.gust, settings.usable.shortest_s  # 3 s
    assert seconds < 10.0
    assert np.all(np.array([7.0, 8.0]) > 1 + seconds - 1)
    assert round(gust.smallest_fall, 1) == 0.7  # followed no further
    assert not gust.lasting > 0.9  # 0.25: doubled it is 0.5
    assert noted.may == {f"stochastic.gust.smallest_fall.{way}" for way in ("halved", "doubled")}
    assert np.array([2.0, 5.0])[[False, True]] * 1.0 > seconds
    assert "usable.shortest_s.doubled" in noted.may
    assert "usable.shortest_s.halved" not in noted.may
    assert len(range(settings.unnamed.folds)) == 5
    assert {"unnamed.folds.halved", "unnamed.folds.doubled"} < noted.may
    assert "stochastic.gust.lasting.doubled" in noted.consulted
    assert "stochastic.gust.uneven.doubled" not in noted.consulted
    assert DEFAULT.changed == {}


def test_the_page_says_what_cannot_matter_and_what_nobody_asked_for() -> None:
    a, b = f"{SURE}.halved", "usable.shortest_s.doubled"
    text = page("command", 87, [], [], "0123", [Noted({a, b}, {a}), Noted({a, b}, set())])
    free, may, unasked = text.split("## What cannot matter")[1].split("##")
    assert free.endswith("setting: `usable.shortest_s` (2).\n\n")
    assert f"`{SURE}` (1 of 2)." in may
    assert SURE not in unasked
    assert "`unnamed.folds`" in unasked


def test_a_setting_that_is_not_there_is_used_wrongly(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        sensitivity.main(["--out", str(tmp_path), "--only", "selection.sure"])
    assert stop.value.code == 2
    assert "no setting begins with 'selection.sure'" in capsys.readouterr().err
