"""`uavtwin explain` on short flights with and without a hidden effect: files, page, exit codes."""

import errno
import io
import json
import math
import os
import re
import sys
import warnings
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from fmpy import read_model_description
from page_rigs.browser import VIEWS, browser, faults, needs_browser, pictures

from twin.errors import TwinError
from twin.explain.balance import Balance, Hypothesis
from twin.explain.design import Suggestion
from twin.explain.estimates import estimates_of, totals
from twin.explain.explanation import Explanation
from twin.explain.inference.detection import Detectable
from twin.explain.inference.posterior import ScoredModel
from twin.explain.inference.selection import averaged
from twin.explain.setting_group import Value
from twin.explain.settings import DEFAULT
from twin.explain.unnamed import Equation
from twin.flight.closed_loop import Mission
from twin.formatting import certainty
from twin.logs import read_flight, write_flight
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from uavtwin import explanation as explain_files
from uavtwin import vehicles
from uavtwin.cli import main
from uavtwin.cli.explain import flight_payloads
from uavtwin.demo.flights import Waypoints, fly
from uavtwin.explain_record import explain_record
from uavtwin.explanation import ExplainResult, explained_vehicle, vehicle_today
from uavtwin.exports.parts import component, twin
from uavtwin.exports.write import Starts, products_of
from uavtwin.headline import amount, headline

pytestmark = pytest.mark.slow
COPTER = load_vehicle("copter_default")
DRAG_1_S = 0.5
DRAGGED = replace(
    COPTER,
    drag_linear_n_s_m=COPTER.drag_linear_n_s_m
    + DRAG_1_S * COPTER.mass_kg * np.array([1.0, 1.0, 0.0]),
)
Place = tuple[float, float, float]


def legs(first: Place, second: Place, seconds: float) -> Waypoints:
    """Take off, fly to two places, hover."""
    return (
        ("ground", 0.5, (0.0, 0.0, 0.0)),
        ("takeoff", 3.0, (0.0, 0.0, -1.0)),
        ("forward", seconds, first),
        ("forward", seconds, second),
        ("hover", 1.5, second),
    )


ONE, TWO = ((2.0, 1.0, -1.0), (0.0, 0.0, -1.3)), ((-1.0, 2.0, -1.0), (0.0, 0.0, -1.3))


def flights(folder: Path, plant: Vehicle, seconds: float) -> list[Path]:
    """Two flights to fit on and one to hold out."""
    paths = []
    for seed, (name, places) in enumerate((("one", ONE), ("two", TWO), ("three", TWO)), start=1):
        flight = fly(COPTER, plant, seed, name, legs(*places, seconds))
        paths.append(folder / f"{name}.parquet")
        write_flight(flight, paths[-1])
    return paths


@dataclass(frozen=True)
class Run:
    """One call of the verb."""

    code: int
    stdout: str
    stderr: str
    out: Path
    found: Explanation | None

    @property
    def json(self) -> dict[str, Any]:
        content = json.loads((self.out / "explain.json").read_text(), parse_constant=pytest.fail)
        assert isinstance(content, dict)
        return content


def run(out: Path, *arguments: object, found: Explanation | None = None) -> Run:
    """Call `uavtwin explain`, flying one mission only; with `found` the search is left out."""
    kept: list[Explanation] = []
    real = explain_files.write_explanation

    def keep(found: Explanation, *rest: Any) -> list[str]:
        kept.append(found)
        return real(found, *rest)

    argv = ["uavtwin", "explain", *map(str, arguments), "--out", str(out)]
    stdout, stderr, code = io.StringIO(), io.StringIO(), 0
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(stdout), redirect_stderr(stderr):
        patch.setattr(sys, "argv", argv)
        patch.setattr("twin.flight.closed_loop.mission_names", lambda: ("takeoff",))
        patch.setattr(explain_files, "write_explanation", keep)
        if found is not None:
            patch.setattr(explain_files, "explain", lambda *_, **__: ExplainResult(found))
        try:
            main.main()
        except SystemExit as stop:
            code = int(stop.code or 0)
    return Run(code, stdout.getvalue(), stderr.getvalue(), out, kept[0] if kept else None)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("explain")


@pytest.fixture(scope="module")
def dragged(folder: Path) -> list[Path]:
    """Flights with rotor drag that the twin lacks."""
    place = folder / "dragged"
    place.mkdir()
    return flights(place, DRAGGED, 2.0)


@pytest.fixture(scope="module")
def named(folder: Path, dragged: list[Path]) -> Run:
    """The verb on flights with rotor drag."""
    one, two, three = dragged
    return run(folder / "named", one, two, "--holdout", three, "--vehicle", "copter_default")


def test_series_are_what_the_gap_is_of(named: Run) -> None:
    """Of the held-out flight alone, as it stood and with the effect."""
    (path,) = (named.out / "series").iterdir()
    table = pd.read_parquet(path)
    assert path.name == "three.parquet"
    for channel, told in named.json["gap"].items():
        columns = f"residual.{channel}", f"residual_explained.{channel}"
        for column, key in zip(columns, ("before", "after"), strict=True):
            left = table[column].dropna()
            assert len(left) == told["n"]
            assert np.sqrt(np.mean(left**2)) == pytest.approx(told[key], rel=1e-5), column


def test_the_hidden_effect_is_named_and_its_number_lies_in_its_interval(named: Run) -> None:
    assert named.code == 1, named.stderr
    content = named.json
    assert content["verdict"] == "named"
    (effect,) = content["effects"]
    assert effect["name"] == "rotor_drag"
    assert effect["probability"] > 0.85
    number = effect["parameters"]["k_xy_1_s"]
    assert number["unit"] == "1/s"
    assert number["value"] == pytest.approx(DRAG_1_S, rel=0.02)
    low, high = number["ci95"]  # given the law, and that of the plant does not know rotor speed
    assert low < number["value"] < high
    assert {"acc_x", "acc_y"} <= set(effect["channels"])
    assert effect["phases"][0] == "forward"
    assert "nothing" not in [r["name"] for r in effect["rivals"][:1]]
    assert all(r["probability"] < 0.05 for r in effect["rivals"])
    sentence = r"Missing from the model: rotor drag 0\.(49|50)\d* \(m/s²\)/\(m/s\) horizontal"
    assert re.match(sentence + r".*, \d+ % probability\.", named.stdout.splitlines()[0])


def test_the_gap_shrinks_to_the_noise_on_the_held_out_flight(named: Run) -> None:
    content = named.json
    assert content["holdout"] == [{"flight": "three", "spans_s": None}]
    for name in ("acc_x", "acc_y"):
        gap = content["gap"][name]
        assert gap["before"] > 5 * gap["noise_floor"]
        assert gap["after"] < 1.1 * gap["noise_floor"]
        assert gap["shrink_ci95"][0] > 0.5
        assert gap["n"] > 200
    assert content["where"][0]["channel"] in ("acc_x", "acc_y")
    assert content["closed_loop"]["stable"]
    assert content["closed_loop"]["worst_tracking_m"] < 0.2


def test_json_has_what_the_design_asks_for(named: Run) -> None:
    content = named.json
    assert {"verdict", "effects", "unnamed", "where", "gap", "holdout", "next_manoeuvre"} <= set(
        content
    )
    assert {"name", "probability", "parameters", "channels", "phases", "rivals"} <= set(
        content["effects"][0]
    )
    gap = content["gap"]["acc_x"]
    assert {"unit", "before", "after", "noise_floor", "shrink_ci95", "n"} <= set(gap)


def test_the_new_vehicle_is_the_old_one_with_the_effect_on(named: Run) -> None:
    new = load_vehicle(named.out / "vehicle.toml")
    parameters = named.json["effects"][0]["parameters"]
    values = {k: p["value"] for k, p in parameters.items()}
    assert new.effects["rotor_drag"] == pytest.approx(values, rel=1e-5)
    beside = new.effects.keys() - {"rotor_drag"}  # what may be there as well
    assert all(0.1 < named.json["inclusion"][e] < 0.5 for e in beside)
    low, high = parameters["k_xy_1_s"]["ci95"]
    source = new.sources["effects.rotor_drag.k_xy_1_s"]
    assert source == f"uavtwin explain, one and two, 95 % interval {low:.4g} to {high:.4g}"
    stated = new.deviations["effects.rotor_drag.k_xy_1_s"].numbers
    assert stated is not None
    assert list(stated) == [pytest.approx((high - low) / 2 / 1.96, rel=1e-4)]
    assert new.mass_kg == COPTER.mass_kg
    assert new.rotors.thrust_n == COPTER.rotors.thrust_n
    assert np.array_equal(new.drag_linear_n_s_m, COPTER.drag_linear_n_s_m)


def test_the_fmu_has_the_effect_on(named: Run) -> None:
    description = read_model_description(str(named.out / "airframe.fmu"))
    starts = {v.name: v.start for v in description.modelVariables}
    assert (starts["rotor_drag.enabled"], starts["thrust_scale.enabled"]) == ("true", "false")
    value = named.json["effects"][0]["parameters"]["k_xy_1_s"]["value"]
    assert float(starts["rotor_drag.k_xy_1_s"]) == pytest.approx(value, rel=1e-5)


def test_one_flight_held_out_gives_no_bands_and_that_is_said(named: Run) -> None:
    found = json.loads((named.out / "accuracy.json").read_text())
    assert not found["twins"]
    assert found["missing"].keys() == {"plain", "observer"}
    assert "2 are needed" in found["missing"]["plain"]


def test_the_settings_are_recorded(named: Run) -> None:
    assert named.json["settings"] == {"hash": DEFAULT.hash, "changed": {}}
    assert named.found is not None
    bands = ((0.2, 0.4), (0.4, 0.8), (0.8, 1.5), (1.5, 3.0))
    changed: dict[str, Value] = {
        "inference.selection.sure": 0.9,
        "stochastic.gust.slope_bands_hz": bands,
    }
    other = explain_record(replace(named.found, settings=DEFAULT.with_values(changed))).json()
    assert other["settings"]["changed"] == {
        "inference.selection.sure": 0.9,
        "stochastic.gust.slope_bands_hz": [list(b) for b in bands],
    }
    assert other["settings"]["hash"] != DEFAULT.hash


def test_every_key_is_in_the_documentation(named: Run) -> None:
    text = (Path(__file__).parents[2] / "docs/reference/json.md").read_text("utf-8")
    lines = text.partition("## explain.json")[2].partition("\n## ")[0].splitlines()
    told = {k for line in lines for k in re.findall(r"`(\w+)`", line.split(" | ")[0])}
    assert told == set(named.json)


def test_run_json_lists_every_input(named: Run) -> None:
    record = json.loads((named.out / "run.json").read_text())
    assert record["verb"] == "explain"
    assert [i["name"] for i in record["inputs"]] == ["one.parquet", "two.parquet", "three.parquet"]


def test_the_page_says_it_first_and_shows_it(named: Run) -> None:
    page = (named.out / "report.html").read_text()
    order = (
        "<h1>Missing from the model: rotor drag",
        'id="time-acc_',
        'id="evidence',
        "Alternative explanations",
        '<h2 id="flight">',
        '<h2 id="gap">',
        '<h2 id="where">',
    )
    places = [page.index(words) for words in order]
    assert places == sorted(places)
    assert "Does the new model fly?" in page
    assert "src=" not in page.split("<body>")[1].split("<script>")[0]


@needs_browser
def test_the_page_is_fine_to_look_at(named: Run, tmp_path: Path) -> None:
    page = named.out / "report.html"
    assert page.stat().st_size < 1.5e6
    with browser(tmp_path) as opened:
        for view in (VIEWS[0], VIEWS[3]):
            picture = pictures(tmp_path) / f"explain_{view}.png"
            assert faults(opened, page, view, picture) == [], view


def test_a_tie_is_told_as_a_tie(named: Run, tmp_path: Path) -> None:
    assert named.found is not None
    naming = named.found.naming
    assert naming is not None
    other = next(f for f in naming.fitted[1:] if f.effects and "rotor_drag" not in f.effects)
    chances = {naming.best.effects: 0.6, other.effects: 0.4}
    tied = replace(
        named.found,
        verdict="cannot_tell",
        naming=replace(
            naming, probabilities=tuple(chances.get(f.effects, 0.0) for f in naming.fitted)
        ),
        next_manoeuvre=Suggestion(
            "legs", "Fly fast and straight.", (("rotor_drag",), ("mass_offset",)), 50.0
        ),
    )
    content = explain_record(tied).json()
    assert content["effects"][0]["name"] == "rotor_drag"
    assert content["effects"][0]["rivals"][0]["probability"] == pytest.approx(0.4)
    assert {e["name"] for e in content["effects"]} == {
        *naming.best.effects,
        *other.effects,
    }
    assert headline(tied).text.startswith(
        "Several causes are consistent with these flights: rotor drag"
    )
    assert tied.added is None
    ExplainResult(tied).report(tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert "not distinguishable here" in page
    assert "Fly fast and straight." in page


def test_drag_that_two_effects_may_be_is_told_in_sum(named: Run, tmp_path: Path) -> None:
    """Planted as rotor drag; blade flapping beside it is nearly as probable, and then each of both
    may be none."""
    found = named.found
    assert found is not None and found.naming is not None
    naming, either = found.naming, ("blade_flapping", "rotor_drag")
    sets = naming.posterior.sets
    both = next(s for s in sets if {*either} <= {*s.effects})
    wide = replace(naming.conditional, half_widths=100 * np.abs(naming.conditional.half_widths))
    tied = replace(
        naming,
        fitted=(naming.best, replace(naming.best, effects=either)),
        probabilities=(0.6, 0.4),
        inclusion={**naming.inclusion, "rotor_drag": 1.0, "blade_flapping": 0.4},
        posterior=replace(
            naming.posterior,
            sets=(replace(sets[0], probability=0.6), replace(both, probability=0.4)),
        ),
        conditional=wide,
        credible={},
    )
    unsure = replace(found, verdict=tied.verdict, naming=tied)
    (total,) = totals(unsure)
    assert total.effects == either[::-1]
    assert unsure.verdict == "named"
    assert tied.named == ("rotor_drag",)
    assert not tied.undecided
    assert total.probability == pytest.approx(1.0)
    assert total.ci95[0] < DRAG_1_S < total.ci95[1] < 1.3 * DRAG_1_S
    text = headline(unsure).text
    assert text.startswith(f"Missing from the model: rotor drag {total.value:.3g} (m/s²)/(m/s) ")
    which = "How much of the rotor drag is blade flapping, these flights do not tell."
    assert which in text
    third = replace(naming.best, effects=("ground_effect", "rotor_drag"))
    more = replace(tied, fitted=(*tied.fitted, third), probabilities=(0.4, 0.3, 0.3))
    also = headline(replace(unsure, naming=more)).text
    assert which in also
    told = explain_record(unsure).json()
    (record,) = told["totals"]
    assert record["effects"] == [*total.effects]
    assert record["value"] == pytest.approx(total.value, rel=1e-5)
    first = told["effects"][0]
    assert (first["name"], first["probability"]) == ("rotor_drag", record["probability"])
    assert first["parameters"]["k_xy_1_s"]["value"] == record["value"]
    assert first["parameters"]["k_xy_1_s"]["ci95"] == record["ci95"]
    assert "blade_flapping" in first["one_of"]
    ExplainResult(unsure).report(tmp_path / "report.html")
    assert which in (tmp_path / "report.html").read_text()
    (alone,) = totals(found)  # the figure is that of the one that is named
    assert alone.effects == ("rotor_drag",)
    own = {t.number.name: t for t in estimates_of(found, "rotor_drag")}["k_xy_1_s"]
    assert (alone.value, alone.ci95) == (own.value, own.ci95)


def test_drag_of_discs_that_tilt_back_has_the_name_of_its_family() -> None:
    assert amount("blade_flapping", "0.2 (m/s²)/(m/s) horizontal") == (
        "rotor drag by blade flapping 0.2 (m/s²)/(m/s) horizontal"
    )
    assert amount("rotor_drag", "0.2 1/s") == "rotor drag 0.2 1/s"


def test_arviz_gets_the_posterior(named: Run) -> None:
    """The planted drag is in the interval that ArviZ computes, the standard deviation is that of
    the interval reported; the prior is wider by far; the same seed gives the same draws."""
    arviz = import_arviz()
    assert named.found is not None and named.found.naming is not None
    result = ExplainResult(named.found)
    # Some hundred draws of the models of a percent, in which the drag is known far worse.
    made = result.to_arviz(draws=10_000, seed=3)
    assert made.attrs["observed_data"] == "one, two"
    drag, name = made.posterior["rotor_drag.k_xy_1_s"], "rotor_drag"
    assert drag.dims == ("chain", "draw") and drag.shape == (4, 10_000)
    assert drag.attrs["units"] == "1/s"
    there = made.posterior["included"].sel(effect=name) == 1
    chance = made.constant_data["inclusion_probability"].sel(effect=name).item()
    assert float(there.mean()) == pytest.approx(named.found.naming.posterior.inclusion[name])
    assert chance == pytest.approx(named.json["inclusion"][name], rel=1e-5)
    low, high = named.json["effects"][0]["parameters"]["k_xy_1_s"]["ci95"]
    assert 2 * 1.96 * float(drag.std()) == pytest.approx(high - low, rel=0.2)
    low, high = arviz.hdi(drag.values.ravel(), hdi_prob=0.95)
    assert low < DRAG_1_S < high
    assert float(made.prior["rotor_drag.k_xy_1_s"].std()) > 5 * float(drag.std())
    assert float(made.prior["included"].sel(effect=name).mean()) < 0.5
    assert made.posterior.equals(result.to_arviz(draws=10_000, seed=3).posterior)


def import_arviz() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # of its next version
        return pytest.importorskip("arviz")


def test_without_arviz_the_error_says_how_to_get_it(
    named: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert named.found is not None
    monkeypatch.setitem(sys.modules, "arviz", None)
    with pytest.raises(TwinError, match=r"arviz is not installed; .*pip install .*arviz"):
        ExplainResult(named.found).to_arviz()


def test_no_name_where_every_interval_contains_no_effect(named: Run) -> None:
    found = named.found
    assert found is not None and found.naming is not None
    told = found.naming.conditional
    wide = replace(told, half_widths=100 * np.abs(told.half_widths))
    vague = replace(found.naming, conditional=wide)
    assert vague.probability_of("rotor_drag") == found.naming.probability_of("rotor_drag")
    assert (vague.named, vague.undecided) == ((), ("rotor_drag",))
    assert vague.verdict == "cannot_tell"
    assert found.naming.named == ("rotor_drag",)
    untold = replace(found, verdict=vague.verdict, naming=vague)
    assert headline(untold).text.startswith(
        "Several causes are consistent with these flights: rotor drag ("
    )
    assert untold.added is None


def test_a_model_that_does_not_fly_is_told_so_first(
    named: Run, dragged: list[Path], tmp_path: Path
) -> None:
    """By the sentence, by its vehicle files, and by what is exported from them, with a way out."""
    assert named.found is not None
    assert "not fly" not in headline(named.found).text
    assert not vehicles.load_vehicle(named.out / "vehicle.toml").grounded
    lost = [Mission(name, False, math.nan, "it tips\nover") for name in ("hover", "land")]
    missions = (*lost, Mission("tour", True, 0.1, ""))
    fallen = replace(named.found, missions=missions)
    first = "The model with these changes does not fly hover or land in closed loop. "
    assert headline(fallen).text == first + headline(named.found).text
    assert headline(fallen).numbers == headline(named.found).numbers
    since = replace(fallen, since=("zero",))
    assert headline(since).text.startswith(f"{first}Since the calibration on zero: ")
    quiet = headline(replace(fallen, verdict="nothing")).text
    assert quiet.startswith(
        "The model with the numbers of these flights does not fly hover or land in "
    )

    out = run(tmp_path / "out", dragged[0], "--vehicle", "copter_default", found=fallen)
    assert out.stdout.startswith(first)
    assert out.json["closed_loop"]["stable"] is False
    assert "<h1>The model with these changes does not fly hover" in (
        (out.out / "report.html").read_text()
    )
    vehicle = vehicles.load_vehicle(out.out / "vehicle.toml")
    assert vehicle.text.startswith(
        "# DOES NOT FLY: hover and land (it tips over); uavtwin explain, one and "
    )
    assert "Take out an [effects.NAME] section" in vehicle.grounded
    assert vehicle.effects == vehicles.load_vehicle(named.out / "vehicle.toml").effects
    assert read_model_description(str(out.out / "airframe.fmu")).description.endswith(
        f"DOES NOT FLY: {vehicle.grounded}"
    )
    for made in (component("airframe", vehicle), twin(vehicle)):
        notes = [p.note for p in products_of(made, Starts({}), (2,))]
        assert notes and {*notes} == {f"DOES NOT FLY: {vehicle.grounded}"}
    for made in (component("airframe", long := vehicle.marked("word " * 300)), twin(long)):
        assert all(p.note.endswith("word ...") for p in products_of(made, Starts({}), (2,)))
    (plain,) = products_of(component("airframe", vehicle.marked("")), Starts({}), (2,))
    assert not plain.note
    again = explained_vehicle(replace(named.found, vehicle=vehicle))
    assert not again.grounded and "DOES NOT FLY" not in again.toml()


def test_nothing_hidden_nothing_named(folder: Path) -> None:
    place = folder / "quiet"
    place.mkdir()
    one, two, three = flights(place, COPTER, 3.0)
    out = run(place / "out", one, two, "--vehicle", "copter_default", "--holdout", three)
    assert out.code == 0, out.stderr
    assert out.json["verdict"] == "nothing"
    assert out.json["effects"] == []
    assert out.json["nothing_probability"] > 0.9
    assert re.search(r" A loss below [\d.]+ % .* would not show in these flights\.", out.stdout)
    # Commands that are held come half a sample late: a lag below what is worth a name may be there.
    assert all(g["after"] == pytest.approx(g["before"], rel=0.01) for g in out.json["gap"].values())
    files = {"explain.json", "report.html", "run.json", "series"}
    assert {p.name for p in out.out.iterdir()} == files
    assert "Nothing detectable is missing" in out.stdout


def test_without_a_holdout_blocks_of_time_stand_in_and_that_is_said(
    folder: Path, dragged: list[Path]
) -> None:
    out = run(folder / "blocks", dragged[0], "--vehicle", "copter_default", "--no-fmus", "--json")
    content = json.loads(out.stdout)
    assert content == out.json
    assert content["holdout"] == [{"flight": "one", "spans_s": [[4.0, pytest.approx(8.0)]]}]
    assert any("weaker" in w for w in content["warnings"])
    gap = content["gap"]["acc_y"]
    assert gap["after"] < 0.5 * gap["before"]
    assert not list(out.out.glob("*.fmu"))


def test_an_unusable_flight_is_a_verdict_and_no_crash(folder: Path, dragged: list[Path]) -> None:
    flight = read_flight(dragged[0])
    path = folder / "flipped.parquet"
    write_flight(replace(flight, table=flight.table.assign(acc_z=-flight.table["acc_z"])), path)
    out = run(folder / "unusable", path, "--vehicle", "copter_default")
    assert out.code == 1
    assert out.json["verdict"] == "unusable"
    assert "check the axes" in out.json["reasons"][0]
    assert out.json["gap"] == {}
    assert "cannot be used" in out.stdout


def test_a_flight_cannot_be_its_own_holdout(folder: Path, dragged: list[Path]) -> None:
    one = dragged[0]
    out = run(folder / "twice", one, "--holdout", one, "--vehicle", "copter_default")
    assert out.code == 2
    assert "--holdout takes others" in out.stderr
    assert not out.out.exists()


def test_what_the_library_lacks_has_a_place(named: Run, tmp_path: Path) -> None:
    assert named.found is not None
    terms = (("sin(yaw)", 0.3, "m/s²"),)
    equation = Equation("acc_x", "m/s²", terms, "0.3 m/s² * sin(yaw)", 0.85, 18.0, 0.2, 400.0)
    unnamed = replace(named.found, verdict="unnamed", shown=None, unnamed=(equation,))
    content = explain_record(unnamed).json()
    (told,) = content["unnamed"]
    assert told["channel"] == "acc_x"
    assert told["expression"] == "0.3 m/s² * sin(yaw)"
    assert told["share"] == 0.85
    assert told["terms"] == [{"product": "sin(yaw)", "coefficient": 0.3, "unit": "m/s²"}]
    assert content["effects"] == []
    ExplainResult(unnamed).report(tmp_path / "report.html")
    assert "0.3 m/s² * sin(yaw)" in (tmp_path / "report.html").read_text()


@pytest.mark.parametrize(
    ("probability", "words"),
    [(1.0, "more than 99 %"), (0.992, "99 %"), (0.9, "90 %"), (1e-9, "less than 1 %")],
)
def test_certainty_is_never_complete(probability: float, words: str) -> None:
    assert certainty(probability) == words


def test_a_payload_is_told_by_flight() -> None:
    flights = ("one", "two=b")
    assert flight_payloads(["one=0.2", "two=b=1"], flights) == {
        "one": 0.2,
        "two=b": 1.0,
    }


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("one", "write FLIGHT=KG, e.g. one=0.2"),
        ("one=heavy", "write FLIGHT=KG"),
        ("one=-1", "write FLIGHT=KG"),
        ("one=nan", "write FLIGHT=KG"),
        ("ond=0.2", "there is no flight 'ond'. Did you mean 'one'"),
    ],
)
def test_a_wrong_payload_is_refused(text: str, says: str) -> None:
    with pytest.raises(TwinError, match=re.escape(says)):
        flight_payloads([text], ("one",))


def test_every_number_of_the_new_file_is_told(named: Run, tmp_path: Path) -> None:
    """A lag too doubtful for a name, too: the file was sure of it."""
    found = named.found
    assert found is not None and found.naming is not None and found.shown is not None
    lag = next(n for n in found.naming.problem.model.numbers if n.full == "motor_lag.tau_s")
    shown = replace(
        found.naming.shown,
        effects=(*found.naming.shown.effects, "motor_lag"),
        values={**found.naming.shown.values, lag.full: -0.002},
        numbers=(*found.naming.shown.numbers, lag),
        half_widths=np.append(found.naming.shown.half_widths, 0.0005),
    )
    late = replace(
        found,
        naming=replace(found.naming, shown=shown),
        shown=shown,
        values={**found.values, lag.full: -0.002},
    )
    record = explain_record(late)
    (doubtful,) = record.doubtful
    assert record.calibrated == ()
    number = doubtful.parameters["tau_s"]
    assert (doubtful.effect, number.value) == ("motor_lag", -0.002)
    assert number.ci95 is not None and number.ci95[0] < -0.002 < number.ci95[1] < 0
    made, told = explained_vehicle(late), {e.name for e in record.effects} | {doubtful.effect}
    assert {*made.effects} - {*COPTER.effects} == told
    assert made.effects["motor_lag"]["tau_s"] == -0.002
    page = ExplainResult(late).report(tmp_path / "late.html").read_text()
    assert "Also changed in the new vehicle file" in page and "motor_lag.tau_s" in page
    assert "Calibrated parameters" not in page


@pytest.mark.parametrize(("tau_s", "there"), [(0.9, False), (1.1, True)])
def test_what_is_too_small_for_a_name_is_left_as_the_file_has_it(
    named: Run, tau_s: float, there: bool
) -> None:
    """However sure; `tau_s` in changes that are worth a name."""
    found = named.found
    assert found is not None and found.naming is not None
    problem, posterior = found.naming.problem, found.naming.posterior
    i = problem.priors.names.index("motor_lag.tau_s")
    smallest = problem.model.numbers[problem.priors.columns[i]].about.smallest

    def late(s: ScoredModel) -> ScoredModel:
        """The same set with the lag."""
        x = s.best.x.copy()
        x[i] = -tau_s * smallest
        return replace(
            s, effects=tuple(sorted({*s.effects, "motor_lag"})), best=replace(s.best, x=x)
        )

    sure = replace(
        posterior,
        sets=tuple(map(late, posterior.sets)),
        inclusion={**posterior.inclusion, "motor_lag": 1.0},
    )
    named_ones = found.naming.best.effects
    shown, conditional = averaged(problem, sure, named_ones, found.naming.settings)
    assert {*named_ones} <= {*shown.effects}
    assert ("motor_lag" in shown.effects, "motor_lag" in conditional.effects) == (there, there)


def test_constants_of_the_day_go_into_the_vehicle_of_a_single_flight(named: Run) -> None:
    """With several, into that of today, which is of the last one."""
    found = named.found
    assert found is not None and found.naming is not None
    days = {
        "one": {},
        "two": {"accel_bias.x_m_s2": (0.26, 0.04), "clock_offset.pose_s": (0.1, 0.01)},
    }
    several = replace(found, naming=replace(found.naming, days=days))
    assert "accel_bias" not in explained_vehicle(several).effects
    today = vehicle_today(several)
    assert today is not None
    assert today.effects["accel_bias"]["x_m_s2"] == pytest.approx(0.26)
    assert today.effects["rotor_drag"] == explained_vehicle(several).effects["rotor_drag"]
    assert "clock_offset" not in today.effects
    key = "effects.accel_bias.x_m_s2"
    assert today.sources[key].startswith("uavtwin explain, of the day of two alone: +0.26 there")
    assert today.deviations[key].numbers == (0.04,)
    single = replace(several, flights=("two",))
    assert vehicle_today(single) is None
    assert explained_vehicle(single).effects == today.effects
    quiet = replace(several, naming=replace(found.naming, days={"two": {}}))
    assert vehicle_today(quiet) is None


def test_not_visible_holds_what_the_balance_would_show(named: Run) -> None:
    """Since a calibration; the sentence and the JSON say the same."""
    assert named.found is not None
    loss = Detectable("rotor_efficiency_loss.loss_1", 0.0625, "1")
    load = Detectable("payload_cg.mass_kg", None, "kg")
    seen = {"rotor_efficiency_loss": loss, "payload_cg": load}
    nothing = Hypothesis("nothing", (), 1.0, {}, {})
    found = replace(
        named.found,
        verdict="nothing",
        since=("zero",),
        balance=Balance((nothing,), seen, (0.0,) * 4, 0.8),
    )
    hidden = {
        e["cause"]: e["smallest_detectable"] for e in explain_record(found).json()["not_visible"]
    }
    assert hidden["rotor_efficiency_loss"] == {"value": 0.0625, "unit": "1"}
    assert hidden["payload_cg"] is None
    assert " A loss below 6.2 % " in headline(found).text


def test_the_headline_and_its_numbers(named: Run) -> None:
    content = named.json
    assert content["headline"] == {
        "text": named.stdout.splitlines()[0],
        "numbers": ["rotor_drag.k_xy_1_s"],
    }
    number = content["effects"][0]["parameters"]["k_xy_1_s"]
    assert number["no_effect"] == 0.0 < number["ci95"][0]
    assert number["prior_share"] <= 0.5
    hidden = {entry["cause"]: entry for entry in content["not_visible"]}
    assert "rotor_drag" not in hidden
    assert 0 < hidden["mass_offset"]["smallest_detectable"]["value"] < 0.5 * COPTER.mass_kg
    assert hidden["mass_offset"]["smallest_detectable"]["unit"] == "kg"


def test_a_named_answer_says_second_which_channel_got_worse(named: Run) -> None:
    assert named.found is not None and named.found.comparison is not None
    compared = named.found.comparison
    assert not any(g.worse for g in compared.gaps)
    grown = [
        replace(g, before=2.68, after=9.94, shrink_ci95=(-3.3, -2.2))
        if g.name == "gyro_rate_z"
        else g
        for g in compared.gaps
    ]
    found = replace(named.found, comparison=replace(compared, gaps=tuple(grown)))
    lines = list(ExplainResult(found).findings())
    assert found.verdict == "named"
    assert lines[1] == (
        "On the held-out flights the residual in gyro_rate_z increases from 2.68 to 9.94 rad/s² "
        "rms."
    )


# -- what fails after the search ---------------------------------------------------------------


def test_a_compiler_that_fails_leaves_all_but_the_fmus(
    named: Run, dragged: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is found and says its version, and fails where it is to compile."""
    compiler = tmp_path / "bin" / "cc"
    compiler.parent.mkdir()
    compiler.write_text("#!/bin/sh\n[ $# -le 1 ] && exec /usr/bin/cc $@\necho broken >&2; exit 1\n")
    compiler.chmod(0o755)
    monkeypatch.setenv("PATH", str(compiler.parent), prepend=os.pathsep)
    monkeypatch.setenv("UAVTWIN_CACHE", str(tmp_path / "cache"))
    words = (*dragged[:2], "--holdout", dragged[2], "--vehicle", "copter_default")
    failed = run(tmp_path / "out", *words, found=named.found)
    assert failed.code == 1
    assert named.found is not None and ExplainResult(named.found).sentence in failed.stdout
    assert "warning: FMUs: " in failed.stderr and "the C compiler failed" in failed.stderr
    assert "broken" in failed.stderr
    record = json.loads((failed.out / "run.json").read_text())
    assert record.pop("incomplete").startswith("FMUs: ")
    assert record == json.loads((named.out / "run.json").read_text())
    left = {p.name: p for p in named.out.iterdir() if p.suffix != ".fmu" and p.name != "run.json"}
    assert {p.name for p in failed.out.iterdir()} == {*left, "run.json"}
    assert "vehicle.toml" in left
    for name, path in left.items():
        if path.is_file():
            assert (failed.out / name).read_bytes() == path.read_bytes()


@pytest.mark.parametrize("form", ["text", "json"])
def test_the_answer_is_printed_though_nothing_can_be_written(
    named: Run, dragged: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("uavtwin.report.explain.page_text", full)
    words = (*dragged[:2], "--vehicle", "copter_default", *(["--json"] if form == "json" else []))
    failed = run(tmp_path / "out", *words, found=named.found)
    assert failed.code == 2
    assert "out: cannot be written: No space left on device" in failed.stderr
    assert list(tmp_path.iterdir()) == []
    if form == "json":
        assert json.loads(failed.stdout)["verdict"] == "named"
    else:
        assert named.found is not None and ExplainResult(named.found).sentence in failed.stdout
