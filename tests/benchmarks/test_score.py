"""Figures of the score from small results written by hand."""

import json
from pathlib import Path
from typing import Any

import pytest

from benchmarks.hidden_effects.score import Outcome, main, score, table


def truth(kind: str, **effects: dict[str, float]) -> dict[str, Any]:
    return {
        "kind": kind,
        "magnitude": "medium",
        "noise": "low",
        "plant": "own",
        "effects": [
            {
                "name": name,
                "parameters": {
                    k: {"value": v, "unit": "m", "neutral": 0.0, "exact": True}
                    for k, v in numbers.items()
                },
            }
            for name, numbers in effects.items()
        ],
    }


def said(verdict: str, *names: str, **more: Any) -> dict[str, Any]:
    effects = [
        {"name": n, "probability": 0.9 - 0.1 * i, "parameters": {}, "rivals": []}
        for i, n in enumerate(names)
    ]
    return {"verdict": verdict, "effects": effects, "unnamed": [], "gap": {}, **more}


def test_first_name_counts_for_one_effect_and_both_for_a_pair() -> None:
    one, two = truth("single", drag={}), truth("pair", drag={}, lag={})
    figures = score(
        [
            Outcome(one, said("named", "drag")),
            Outcome(one, said("named", "lag", "drag")),
            Outcome(one, said("cannot_tell", "drag", "lag")),
            Outcome(two, said("named", "lag", "drag")),
            Outcome(two, said("named", "lag")),
        ]
    )
    assert figures["right"]["single"] == pytest.approx(1 / 3)
    assert figures["right"]["pair"] == pytest.approx(1 / 2)
    assert figures["cannot_tell"] == pytest.approx(1 / 5)
    assert figures["cannot_tell_holds_truth"] == 1.0
    assert figures["effects"]["drag"]["recall"] == pytest.approx(3 / 5)
    assert figures["effects"]["drag"]["precision"] == 1.0
    assert figures["effects"]["lag"]["precision"] == pytest.approx(2 / 3)
    assert figures["effects"]["drag"]["taken_for"] == {"cannot_tell": 1}


def test_quiet_flights_and_effects_outside_the_library() -> None:
    quiet, strange = truth("nothing"), truth("outside", leak={})
    figures = score(
        [
            Outcome(quiet, said("nothing")),
            Outcome(quiet, said("named", "drag")),
            Outcome(strange, said("unnamed", unnamed=[{"share": 0.5}, {"share": 0.3}])),
            Outcome(strange, said("named", "drag")),
        ]
    )
    assert figures["false_alarms"] == 0.5
    assert figures["right"]["nothing"] == 0.5
    assert figures["outside_called_a_library_effect"] == 0.5
    assert figures["outside_share_explained"] == pytest.approx(0.8)
    assert figures["right"]["single"] is None


def test_parameter_errors_are_relative_to_the_hidden_vector() -> None:
    answer = said("named", "arm")
    answer["effects"][0]["parameters"] = {
        "x_m": {"value": 3.5, "unit": "m", "ci95": [2.9, 4.1]},
        "y_m": {"value": 4.0, "unit": "m", "ci95": [4.5, 5.0]},
        "z_m": {"value": 9.0, "unit": "s", "ci95": None},
        "other": {"value": 1.0, "unit": "m", "ci95": [0, 2]},
    }
    figures = score([Outcome(truth("single", arm={"x_m": 3.0, "y_m": 4.0, "z_m": 0.0}), answer)])
    parameters = figures["parameters"]
    assert parameters["compared"] == 2
    assert parameters["median error"] == pytest.approx(0.05)
    assert parameters["coverage"] == 0.5


def test_gap_counts_where_there_was_one() -> None:
    gap = {
        "acc_x": {"before": 3.0, "after": 1.2, "noise_floor": 1.0},
        "acc_y": {"before": 1.05, "after": 1.0, "noise_floor": 1.0},
    }
    figures = score([Outcome(truth("single", drag={}), said("named", "drag", gap=gap))])
    assert figures["gap"]["share_closed"] == pytest.approx(0.9)
    assert figures["gap"]["after_over_floor"] == pytest.approx(1.2)


def test_command_line_prints_a_table_and_counts_what_is_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "truth").mkdir()
    (tmp_path / "results/aaa").mkdir(parents=True)
    for case in ("aaa", "bbb"):
        text = json.dumps(truth("single", drag={"k": 1.0}))
        (tmp_path / "truth" / f"{case}.json").write_text(text)
    (tmp_path / "results/aaa/explain.json").write_text(json.dumps(said("named", "drag")))
    arguments = [str(tmp_path / "results"), "--truth", str(tmp_path / "truth")]
    assert main([*arguments, "--out", str(tmp_path / "score.json")]) == 1
    printed = capsys.readouterr().out
    assert "1 cases have no result, bbb" in printed
    assert "drag" in printed
    figures = json.loads((tmp_path / "score.json").read_text())
    assert figures["missing"] == ["bbb"]
    assert figures["right"]["single"] == 1.0


def test_table_of_nothing_can_be_printed() -> None:
    assert "0 cases" in table(score([]))
