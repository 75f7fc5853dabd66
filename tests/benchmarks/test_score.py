"""Figures of the score from small results written by hand."""

import json
from pathlib import Path
from typing import Any

import pytest

from benchmarks.hidden_effects.measures import Outcome, middle, wilson
from benchmarks.hidden_effects.score import main, score, table


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


def row(figures: dict[str, Any], start: str) -> Any:
    """Value of the only figure whose name begins so."""
    rows = [r for r in (*figures["goals"], *figures["more"]) if r["what"].strip().startswith(start)]
    assert len(rows) == 1, start
    return rows[0]["value"]


def test_all_names_count_for_three_effects() -> None:
    three = truth("triple", drag={}, lag={}, mass={})
    answers = [("drag", "lag", "mass"), ("drag", "mass"), ("lag", "bias", "mass")]
    figures = score([Outcome(three, said("named", *names)) for names in answers])
    assert row(figures, "triples") == pytest.approx(1 / 3)
    assert row(figures, "of the effects hidden") == pytest.approx(7 / 9)


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
    assert row(figures, "single medium") == pytest.approx(1 / 3)
    assert row(figures, "pairs") == pytest.approx(1 / 2)
    assert row(figures, "cannot tell") == pytest.approx(1 / 5)
    assert row(figures, "with the truth among") == 1.0
    drag, lag = figures["effects"]["drag"], figures["effects"]["lag"]
    assert drag["recall"]["value"] == pytest.approx(3 / 5)
    assert drag["precision"]["value"] == 1.0
    assert drag["cannot_tell"]["value"] == pytest.approx(1 / 5)
    assert lag["precision"]["value"] == pytest.approx(2 / 3)
    assert figures["confusions"] == [
        {"hidden": "drag", "said": "cannot_tell", "n": 1},
        {"hidden": "drag", "said": "lag+drag", "n": 1},
        {"hidden": "drag+lag", "said": "lag", "n": 1},
    ]
    assert figures["by"]["plant"]["own"]["single"]["good"] == 1


def test_only_medium_effects_count_for_the_goal() -> None:
    large = {**truth("single", drag={}), "magnitude": "large"}
    figures = score([Outcome(large, said("named", "drag"))])
    assert row(figures, "single medium") is None
    assert row(figures, "single effect, all") == 1.0
    assert figures["by"]["magnitude"]["large"]["single"]["value"] == 1.0


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
    assert row(figures, "quiet flights: false") == 0.5
    assert row(figures, "quiet flights: nothing") == 0.5
    assert row(figures, "outside the library, given") == 0.5
    assert row(figures, "outside the library: share") == pytest.approx(0.8)
    assert row(figures, "single medium") is None
    assert "leak" not in figures["effects"]


def test_a_failed_case_counts_as_wrong_and_is_told() -> None:
    failed = {"verdict": "error", "error": "LogError: too short", "effects": [], "case": "abc"}
    figures = score([Outcome(truth("single", drag={}), failed)])
    assert row(figures, "single medium") == 0.0
    assert row(figures, "failed") == 1.0
    assert "abc failed: LogError: too short" in table(figures)


def test_parameter_errors_are_relative_to_the_hidden_vector() -> None:
    answer = said("named", "arm")
    answer["effects"][0]["parameters"] = {
        "x_m": {"value": 3.5, "unit": "m", "ci95": [2.9, 4.1]},
        "y_m": {"value": 4.0, "unit": "m", "ci95": [4.5, 5.0]},
        "z_m": {"value": 9.0, "unit": "s", "ci95": [8.0, 10.0]},
        "shape_m": {"value": 0.0, "unit": "m", "ci95": None},
        "other": {"value": 1.0, "unit": "m", "ci95": [0, 2]},
    }
    hidden = {"x_m": 3.0, "y_m": 4.0, "z_m": 0.0, "shape_m": 0.0}
    figures = score([Outcome(truth("single", arm=hidden), answer)])
    assert list(figures["parameters"]) == ["arm.x_m", "arm.y_m"]
    assert row(figures, "median error of a number") == pytest.approx(0.05)
    assert row(figures, "numbers inside") == 0.5
    assert figures["parameters"]["arm.x_m"]["error"]["value"] == pytest.approx(0.1)


def test_gap_counts_where_there_was_one() -> None:
    gap = {
        "acc_x": {"before": 3.0, "after": 1.2, "noise_floor": 1.0},
        "acc_y": {"before": 1.05, "after": 1.0, "noise_floor": 1.0},
    }
    figures = score([Outcome(truth("single", drag={}), said("named", "drag", gap=gap))])
    assert row(figures, "share of the gap closed") == pytest.approx(0.9)
    assert row(figures, "gap with the effect added") == pytest.approx(1.2)


def test_intervals_of_shares_and_medians() -> None:
    assert wilson(81, 263) == pytest.approx([0.2553, 0.3662], abs=1e-4)  # Newcombe 1998, table I
    assert wilson(0, 20) == pytest.approx([0.0, 0.1611], abs=1e-4)
    assert wilson(0, 0) is None
    assert middle(range(1, 11))["ci95"] == [2, 9]  # 97.9 %: tables of the sign test
    assert middle([1.0, float("nan")]) == {"value": 1.0, "n": 1, "ci95": None}


def test_command_line_prints_a_table_and_counts_what_is_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "truth").mkdir()
    (tmp_path / "results").mkdir()
    for case in ("aaa", "bbb"):
        text = json.dumps(truth("single", drag={"k": 1.0}))
        (tmp_path / "truth" / f"{case}.json").write_text(text)
    (tmp_path / "results/aaa.json").write_text(json.dumps(said("named", "drag")))
    assert main([str(tmp_path)]) == 1
    printed = capsys.readouterr().out
    assert "1 cases have no result, bbb" in printed
    assert "drag" in printed
    figures = json.loads((tmp_path / "results.score.json").read_text())
    assert figures["missing"] == ["bbb"]
    assert row(figures, "single medium") == 1.0


def test_table_of_nothing_can_be_printed() -> None:
    assert "0 cases" in table(score([]))


def test_results_of_two_states_of_the_twin_are_told_apart() -> None:
    outcomes = [Outcome(truth("nothing"), said("nothing", twin=state)) for state in ("a", "b")]
    assert "different states of twin/" in table(score(outcomes))
