"""Figures of cases as in life, from small results written by hand."""

import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from benchmarks.hidden_effects.cases import HALVES, half_of
from benchmarks.hidden_effects.measures import (
    Forecast,
    Outcome,
    brier,
    calibration_error,
    reliability,
    reliability_svg,
)
from benchmarks.hidden_effects.score import main, score, table

LIFE = {"off": True, "days": False, "rotors": False, "without": "", "fits": 2, "slow": False}


def number(value: float, neutral: float = 0.0) -> dict[str, Any]:
    return {"value": value, "unit": "m", "neutral": neutral, "exact": True}


def truth(kind: str, *names: str, **more: Any) -> dict[str, Any]:
    return {
        "kind": kind,
        "plant": "own",
        "magnitude": "mixed",
        "noise": "low",
        "seed": 0,
        "effects": [{"name": n, "parameters": {"k": number(1.0)}} for n in names],
        "life": LIFE,
        "class": None,
        "material": list(names),
        "days": {},
        "file": [],
        "seen_from_file": {},
        **more,
    }


def name(effect: str, low: float = 0.9, high: float = 1.1, **more: Any) -> dict[str, Any]:
    value = {"value": (low + high) / 2, "unit": "m", "ci95": [low, high]}
    return {"name": effect, "probability": 0.9, "parameters": {"k": value}, **more}


def calibrated(effect: str, interval: list[float]) -> dict[str, Any]:
    return {"effect": effect, "parameters": {"k": {"value": 0.0, "ci95": interval}}}


def said(verdict: str, *effects: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"verdict": verdict, "effects": list(effects), "gap": {}, **more}


def row(figures: dict[str, Any], start: str) -> dict[str, Any]:
    """The only line of life whose name begins so."""
    rows = [r for r in figures["life"] if r["what"].strip().startswith(start)]
    assert len(rows) == 1, (start, rows)
    found: dict[str, Any] = rows[0]
    return found


def test_recall_counts_what_is_larger_than_twice_its_deviation_or_shows() -> None:
    hidden = truth("many", "drag", "lag", "mass", "tilt", "bias", material=["lag", "bias"])
    answer = said("named", name("drag"), name("mass", -3.0, 5.0))  # 1 +- 4: told by nobody
    figures = score([Outcome(hidden, answer)])
    recall = row(figures, "many: recall")  # drag found; lag, bias missed; tilt hardly shows
    assert (recall["good"], recall["n"]) == (1, 3)


def test_what_cannot_be_told_from_a_name_counts_as_found() -> None:
    hidden = truth("many", "drag", "lag")
    answer = said("named", name("flapping", one_of=["flapping", "drag"]), name("bias"))
    figures = score([Outcome(hidden, answer)])
    assert row(figures, "many: recall")["value"] == 0.5
    assert row(figures, "many: precision")["value"] == 0.5


def test_drag_and_flapping_are_one_family_where_there_are_many_effects() -> None:
    hidden = truth("many", "blade_flapping", "lag")
    figures = score([Outcome(hidden, said("named", name("rotor_drag"), name("lag")))])
    assert row(figures, "many: recall")["value"] == 1.0
    assert row(figures, "many: precision")["value"] == 1.0


def test_what_something_acts_like_is_found_but_has_no_name() -> None:
    alike = [{"name": "drag", "why": "too far"}]
    figures = score([Outcome(truth("many", "drag", "lag"), said("unnamed", acts_like=alike))])
    assert row(figures, "many: recall")["value"] == 0.0
    assert row(figures, "with what something acts like")["value"] == 0.5


@pytest.mark.parametrize(("interval", "found"), [([0.3, 0.5], 1.0), ([-0.1, 0.9], 0.0)])
def test_a_number_that_was_calibrated_away_from_the_file_is_found(
    interval: list[float], found: float
) -> None:
    hidden = truth("many", "mass", seen_from_file={"mass": {"k": number(0.4)}})
    answer = said("named", calibrated=[calibrated("mass", interval)])
    figures = score([Outcome(hidden, answer)])
    assert row(figures, "many: recall")["value"] == found
    assert row(figures, "calibrated numbers")["value"] == 1.0


def test_numbers_are_compared_as_seen_from_the_file() -> None:
    hidden = truth("many", "mass", seen_from_file={"mass": {"k": number(1.3)}})
    answers = [said("named", name("mass")), said("named", name("mass", 1.2, 1.4))]
    figures = score([Outcome(hidden, a) for a in answers])
    assert row(figures, "many: numbers inside")["value"] == 0.5


def test_names_for_what_is_far_off_in_the_file_are_neither_right_nor_wrong() -> None:
    file = [{"key": "body.mass", "effect": "mass", "true": 1.3, "file": 1.0, "sd": 0.1, "z": 3.0}]
    far, sound = truth("uncertain", file=file), truth("uncertain")
    many = truth("many", "drag", file=file)
    figures = score(
        [
            Outcome(far, said("named", name("mass"))),
            Outcome(sound, said("nothing")),
            Outcome(sound, said("named", name("lag"))),
            Outcome(many, said("named", name("drag"), name("mass"))),
        ]
    )
    assert (row(figures, "uncertain")["good"], row(figures, "uncertain")["n"]) == (2, 3)
    assert row(figures, "no number of the file over")["value"] == 0.5
    assert row(figures, "many: precision")["value"] == 1.0


def test_a_calibrated_number_is_compared_with_the_same_of_the_truth() -> None:
    hidden = truth("uncertain", seen_from_file={"mass": {"k": number(1.3)}})
    answers = [
        said("nothing", calibrated=[calibrated(effect, [0.9, 1.1])]) for effect in ("mass", "other")
    ]
    inside = row(score([Outcome(hidden, a) for a in answers]), "calibrated numbers")
    assert (inside["good"], inside["n"]) == (0, 1)


def test_days_whose_mean_happens_to_stand_out_are_no_wrong_name() -> None:
    life = {**LIFE, "off": False, "days": True}
    figures = score(
        [
            Outcome(
                truth("nothing", life=life, days={"fit_1": {}}, day_means={"accel_bias": z}),
                said("named", name("accel_bias")),
            )
            for z in (1.9, 2.1)
        ]
    )
    quiet = row(figures, "days that differ: quiet")
    assert (quiet["good"], quiet["n"]) == (1, 2)


def test_what_is_undecided_is_no_name() -> None:
    answer = said("named", name("drag"), name("tilt"), undecided=["tilt"])
    figures = score([Outcome(truth("many", "drag"), answer)])
    assert row(figures, "many: precision")["value"] == 1.0


def test_a_late_clock_of_the_day_is_no_wrong_name() -> None:
    life = {**LIFE, "off": False, "days": True}
    quiet = truth("nothing", life=life, days={"fit_1": {}})
    one = truth("single", "drag", life=life, days={"fit_1": {}})
    late = name("position_delay")
    figures = score(
        [
            Outcome(quiet, said("named", late)),
            Outcome(quiet, said("named", late, name("drag"))),
            Outcome(one, said("named", late, {**name("drag"), "probability": 0.5})),
        ]
    )
    assert row(figures, "days that differ: quiet")["value"] == 0.5
    assert row(figures, "days that differ: right")["value"] == 1.0
    assert figures["goals"][0]["n"] == 0  # none of them is a case of today


def loss(rotor: int, value: float) -> dict[str, Any]:
    number = {"value": value, "unit": "1", "ci95": None}
    return {
        "name": "rotor_efficiency_loss",
        "probability": 0.9,
        "parameters": {f"loss_{rotor}": number, "torque_share": {**number, "value": 0.9}},
    }


def test_what_happened_is_told_by_class_and_rotor() -> None:
    slow, fast = ({**LIFE, "slow": s} for s in (True, False))
    hurt = [{"name": "rotor_efficiency_loss", "parameters": {"loss_3": number(0.2)}}]
    rotor = truth("since", effects=hurt, life=slow, **{"class": "rotor"})
    payload = truth("since", "mass_offset", "cog_offset", life=fast, **{"class": "payload"})
    normal = truth("since", life=fast, **{"class": "none"})
    figures = score(
        [
            Outcome(rotor, said("named", loss(3, 0.2))),
            Outcome(rotor, said("named", loss(1, 0.2))),
            Outcome(
                rotor,
                said("named", {**loss(3, 0.2), "one_of": ["mass_offset"]}),
            ),
            Outcome(payload, said("named", name("cog_offset"), name("mass_offset"))),
            Outcome(
                payload,
                said("named", {**loss(3, 0.1), "one_of": ["mass_offset"]}),
            ),
            Outcome(normal, said("nothing")),
            Outcome(normal, said("error")),
        ]
    )
    assert (row(figures, "since: class")["good"], row(figures, "since: class")["n"]) == (5, 7)
    assert row(figures, "slow flights")["value"] == 1.0
    assert row(figures, "or among what")["good"] == 6
    assert row(figures, "since: right rotor")["value"] == pytest.approx(2 / 3)
    assert row(figures, "since: normal")["value"] == 0.5


def test_brier_score_and_calibration_error_of_known_forecasts() -> None:
    sure = [Forecast(0.8, True)] * 4 + [Forecast(0.8, False)]
    assert calibration_error(sure) == pytest.approx(0.0)
    assert brier(sure) == pytest.approx((4 * 0.04 + 0.64) / 5)
    assert calibration_error([Forecast(1.0, False), Forecast(0.0, False)]) == 0.5
    assert reliability([Forecast(1.0, True)]) == [{"n": 1, "said": 1.0, "came_true": 1}]
    assert brier([]) is None and calibration_error([]) is None


def test_every_candidate_is_a_forecast_named_or_not() -> None:
    inclusion = {"drag": 1.0, "lag": 0.5, "tilt": 0.3}
    answer = said("named", name("drag"), inclusion=inclusion)
    figures = score([Outcome(truth("many", "drag"), answer)])
    brier_all = row(figures, "Brier score, all candidates")
    assert brier_all["n"] == 3
    assert brier_all["value"] == pytest.approx((0.5**2 + 0.3**2) / 3)
    assert row(figures, "Brier score, names")["value"] == pytest.approx(0.01)


def test_gap_over_what_the_mean_of_the_fit_flights_leaves() -> None:
    gap = {
        "acc_x": {
            "before": 3.0,
            "after": 1.0,
            "on_its_day": 0.9,
            "noise_floor": 0.8,
            "fit_mean": 2.0,
        }
    }
    figures = score([Outcome(truth("many", "drag"), said("named", name("drag"), gap=gap))])
    assert row(figures, "many: held-out gap over that")["value"] == 0.5
    assert row(figures, "many: held-out gap over noise")["value"] == 1.25


def test_halves_stand_side_by_side(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = {h: next(n for n in "abcdefgh" if half_of("own", "many", n, 0) == h) for h in HALVES}
    for half, effect in names.items():
        (tmp_path / "truth").mkdir(exist_ok=True)
        (tmp_path / "results").mkdir(exist_ok=True)
        answer = said("named", *[name(effect)] * (half == "tune"), inclusion={effect: 0.7})
        (tmp_path / f"truth/{half}.json").write_text(json.dumps(truth("many", effect)))
        (tmp_path / f"results/{half}.json").write_text(json.dumps(answer))
    assert main([str(tmp_path)]) == 0
    printed = capsys.readouterr().out.splitlines()
    recall = [line for line in printed if line.startswith("many: recall")][-1]
    assert recall.split()[-6:] == ["1.000", "(n", "1)", "0.000", "(n", "1)"]
    ElementTree.parse(tmp_path / "results.reliability.svg")
    assert main([str(tmp_path), "--half", "score"]) == 0
    assert json.loads((tmp_path / "results.score.json").read_text())["cases"] == 1


def test_diagram_has_a_point_for_each_bin() -> None:
    bins = reliability([Forecast(0.1, False), Forecast(0.95, True), Forecast(0.93, True)])
    root = ElementTree.fromstring(reliability_svg({"tune": bins}))
    assert len([e for e in root.iter() if e.tag.endswith("circle")]) == 2


def test_results_of_today_have_no_life_and_still_a_table() -> None:
    today = {k: v for k, v in truth("nothing").items() if k != "life"}
    figures = score([Outcome(today, said("nothing"))])
    assert figures["life"] == []
    assert "as in life" not in table(figures)
