"""The page of the recorded flights: figures against counts by hand, words against planted facts."""

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.real_flights import __main__ as command
from benchmarks.real_flights.agreement import Agreement, Number, agreements, judge
from benchmarks.real_flights.details import drag_1_s, passing
from benchmarks.real_flights.measure import (
    about_mean,
    above,
    band_rms,
    baselines,
    braking,
    held,
    spectra,
)
from benchmarks.real_flights.page import details, state
from benchmarks.real_flights.rows import read_rows, renewed, rows, short_page, write_rows
from benchmarks.real_flights.scenarios import SCENARIOS, Change, read
from twin.residuals.channels import ChannelData
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import fly

ROOT = Path(__file__).parents[2]


def channel(residual: list[float], piece: list[int] | None = None) -> ChannelData:
    r = np.array(residual)
    of = np.zeros(len(r), dtype=np.intp) if piece is None else np.array(piece, dtype=np.intp)
    return ChannelData("acc_x", "m/s²", np.arange(len(r)) / 50, r, r, np.zeros((len(r), 0)), of)


# -- baselines ------------------------------------------------------------------------------


def test_baselines_against_a_count_by_hand() -> None:
    found = baselines([channel([1.0, 2.0, 4.0, 1.0])], [channel([1.0]), channel([3.0, 5.0])])
    assert found["fit_mean"] == pytest.approx(np.sqrt((4 + 1 + 1 + 4) / 4))  # mean 3 of samples
    assert found["own_mean"] == pytest.approx(np.sqrt((1 + 0 + 4 + 1) / 4))
    assert found["last_20_ms"] == pytest.approx(np.sqrt((1 + 4 + 9) / 3))
    assert found["last_500_ms"] is None  # no flight is long enough
    assert baselines([channel([1.0])], [])["fit_mean"] is None


def test_nothing_is_held_over_a_gap_or_from_flight_to_flight() -> None:
    gap = channel([1.0, 2.0, 100.0, 103.0], [0, 0, 1, 1])
    assert held([gap, channel([7.0, 7.0])], 0.02) == pytest.approx(np.sqrt((1 + 9 + 0) / 3))


def test_holding_a_wave_by_its_period_leaves_nothing() -> None:
    wave = channel(np.sin(2 * np.pi * 2 * np.arange(200) / 50).tolist())
    assert held([wave], 0.5) == pytest.approx(0, abs=1e-12)
    assert held([wave], 0.02) == pytest.approx(np.sqrt(2) * np.sin(2 * np.pi / 50), rel=0.02)


# -- vehicle files --------------------------------------------------------------------------


def test_a_vehicle_file_is_wrong_in_one_number_alone() -> None:
    wrong = {s.name: s.read_vehicle() for s in SCENARIOS if s.change is not None}
    for scenario in SCENARIOS:
        true, now = load_vehicle(scenario.vehicle), scenario.read_vehicle()
        if scenario.name == "simulated_heavy":
            wanted = true.mass_kg - now.mass_kg
            assert scenario.expected["mass_offset.mass_kg"] == pytest.approx(wanted)
        elif scenario.name in ("simulated_quick", "crazyflie_quick"):
            assert now.rotors.lag_up_s == now.rotors.lag_down_s == 0
            assert scenario.expected["motor_lag.tau_s"] == true.rotors.lag_up_s
        else:
            assert scenario.change is None
            assert (now.mass_kg, now.name) == (true.mass_kg, true.name)
    assert set(wrong) == {"simulated_heavy", "simulated_quick", "crazyflie_quick"}


def test_flights_say_where_they_were_or_are_told(data_dir: Path) -> None:
    told = {s.name for s in SCENARIOS if s.indoors is not None}
    assert told == {"nanobench", "crazyflie_motor_delay", "crazyflie_quick"}
    for scenario in (s for s in SCENARIOS if s.indoors is not None):
        assert read(data_dir, scenario.flights[0]).indoors is None


def test_a_change_keeps_comments_and_says_that_it_is_one() -> None:
    text = '[body]\n# weighed\nmass = { value = 2.0, unit = "kg", source = "scales" }\n'
    assert Change("body.mass", 1.5)(text) == (
        '[body]\n# weighed\nmass = { value = 3.0, unit = "kg", '
        'source = "deliberately wrong: 1.5 times the true one" }\n'
    )
    assert "mass" not in Change("body.mass", None)(text)


@pytest.mark.slow
@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda s: str(s.name))
def test_every_recording_is_there(data_dir: Path, scenario: Any) -> None:
    assert all((data_dir / flight).is_file() for flight in scenario.flights)
    if scenario.change is None:
        flight = read(data_dir, scenario.flights[-1])
        assert flight.name == Path(scenario.flights[-1]).stem
        assert flight.has("cmd_1", "acc_z", "gyro_z")


# -- what to believe ------------------------------------------------------------------------


def case(holdout: str, effects: Mapping[str, Mapping[str, Any]], **more: Any) -> dict[str, Any]:
    """A rotation; effects: name -> value, ci95, and what else is known of its one number `n`."""
    rms = {"none": 2.0, "effects": 1.0, "fit_mean": 1.5, "own_mean": 1.4, "floor": 0.9}
    row = {
        "name": "acc_z",
        "unit": "m/s²",
        "n": 900,
        **rms,
        "last_20_ms": 0.5,
        "last_500_ms": None,
        "shrink_ci95": [0.3, 0.6],
        "mean": {"none": 1.4, "effects": 0.6, "fit_mean": 0.1, "own_mean": 0.0, "floor": 0.2},
        "bands": {name: [0.5, 0.3, 0.4, 0.1] for name in rms},
    }
    told = [
        {
            "name": name,
            "probability": 0.97,
            "channels": ["acc_z"],
            "parameters": {"n": {"value": e["value"], "unit": "s", "ci95": e.get("ci95")}},
        }
        for name, e in effects.items()
    ]
    verdict = more.pop("verdict", "named" if effects else "nothing")
    alike = [{"name": e, "why": "too far"} for e in more.pop("acts_like", [])]
    return {
        "scenario": "real",
        "holdout": holdout,
        "said": {
            "verdict": verdict,
            "effects": told,
            "reasons": [],
            "nothing_probability": 0.01,
            "acts_like": alike,
            "inclusion": {e: 0.97 for e in effects},
        },
        "numbers": {
            f"{k}.n": {
                "value": e["value"],
                "unit": "s",
                "ci95": e.get("ci95"),
                "edge": e.get("edge"),
                "neutral": e.get("neutral", 0.0),
                "prior_share": e.get("prior_share", 0.1),
            }
            for k, e in effects.items()
        },
        "predicted": {f"{k}.n": e["value"] for k, e in effects.items()},
        "channels": [row | more],
        "braking": 0.25,
        "seconds": 30.0,
        "twin": "0123456789ab",
    }


GOOD = {"value": 0.05, "ci95": [0.04, 0.06]}


def against(cases: list[dict[str, Any]]) -> dict[str, str]:
    return {j.effect: "; ".join(j.against) for j in judge(cases)}


def test_an_effect_that_all_rotations_confirm_has_nothing_against_it() -> None:
    assert against([case(f, {"motor_lag": GOOD}) for f in "abc"]) == {"motor_lag": ""}


@pytest.mark.parametrize(
    ("change", "more", "said"),
    [
        ({"edge": [0.0, 0.05]}, {}, "`motor_lag.n` at the edge of its range with c held out"),
        ({"value": 0.3, "ci95": [0.2, 0.4]}, {}, "differs between .*: 0.05 and 0.05 and 0.3"),
        ({}, {"acts_like": ["motor_lag"]}, "something only acts like it with c held out"),
        ({}, {"verdict": "cannot_tell"}, "only a candidate with c held out"),
        ({}, {"shrink_ci95": [-0.1, 0.2]}, "no channel .* shrinks beyond doubt on c"),
        ({}, {"shrink_ci95": [None, None]}, "no channel .* shrinks beyond doubt on c"),
        ({}, {"fit_mean": 0.95}, "a constant does as well on c"),
    ],
)
def test_each_fact_against_an_effect_is_told(
    change: dict[str, Any], more: dict[str, Any], said: str
) -> None:
    cases = [case(f, {"motor_lag": GOOD}) for f in "ab"]
    cases.append(case("c", {"motor_lag": GOOD | change}, **more))
    assert re.fullmatch(f".*{said}.*", against(cases)["motor_lag"])


def test_a_number_that_is_always_at_its_edge_is_told_once() -> None:
    edge = GOOD | {"edge": [0.0, 0.05]}
    said = against([case(f, {"motor_lag": edge}) for f in "abc"])["motor_lag"]
    assert said == "`motor_lag.n` at the edge of its range every time"


def test_an_effect_of_one_rotation_is_told_with_those_that_miss_it() -> None:
    cases = [
        case("a", {"gust": GOOD, "motor_lag": GOOD}),
        *(case(f, {"motor_lag": GOOD}) for f in "bc"),
    ]
    assert against(cases) == {"motor_lag": "", "gust": "not named with b and c held out"}


def number(value: float, low: float, high: float, **more: Any) -> Number:
    return Number(value, "m", (low, high), neutral=more.pop("neutral", 0.0), **more)


@pytest.mark.parametrize(
    ("numbers", "same_sign", "overlap", "passes"),
    [
        ([number(1.0, 0.5, 1.5), number(1.4, 0.9, 1.9)], True, True, True),
        ([number(1.0, 0.5, 1.5), number(3.0, 2.0, 4.0)], True, False, False),
        ([number(1.0, 0.9, 1.1), number(-1.0, -1.1, -0.9)], False, False, False),
        ([number(0.1, -0.5, 0.7), number(-0.1, -0.9, 0.7)], None, True, True),
        ([number(0.1, -0.5, 0.7), number(0.5, 0.2, 0.8)], None, True, True),
        (
            [number(1.3, 1.2, 1.6, neutral=1.0), number(0.8, 0.7, 0.9, neutral=1.0)],
            False,
            False,
            False,
        ),
        (
            [number(0.4, 0.2, 0.6, neutral=None), number(0.5, 0.3, 0.7, neutral=None)],
            None,
            True,
            True,
        ),
        ([number(1.0, 0.5, 1.5, edge=(0.0, 1.0)), number(1.1, 0.6, 1.6)], True, True, False),
        ([Number(1.0, "m", None), Number(3.0, "m", None)], None, None, True),
        ([number(1.0, 0.5, 1.5)], None, None, False),
        (
            [number(1.0, 0.5, 1.5), number(1.4, 1.2, 1.6), number(1.7, 1.55, 1.9)],
            True,
            False,
            False,
        ),
    ],
)
def test_agreement(
    numbers: list[Number], same_sign: bool | None, overlap: bool | None, passes: bool
) -> None:
    found = Agreement("e.n", dict(zip("abc", numbers, strict=False)))
    assert (found.same_sign, found.overlap, found.passes) == (same_sign, overlap, passes)


def test_numbers_are_counted_that_pass_that_do_not_and_that_stand_alone() -> None:
    apart = GOOD | {"value": 0.3, "ci95": [0.2, 0.4]}
    cases = [
        case("a", {"motor_lag": GOOD, "gust": GOOD, "cog_offset": GOOD}),
        case("b", {"motor_lag": GOOD, "gust": apart}),
    ]
    assert passing(agreements(cases)) == (1, 2, 1)


def test_numbers_of_what_something_only_acts_like_are_none_of_the_named() -> None:
    alike = case("a", {"motor_lag": GOOD}, acts_like=["gust"])
    alike["numbers"]["gust.n"] = alike["numbers"]["motor_lag.n"]
    assert [a.full for a in agreements([alike])] == ["motor_lag.n"]


# -- bands ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("hz", "band"), [(0.4, 0), (3.0, 1), (9.0, 2), (20.0, 3)])
def test_a_sine_is_in_its_band(hz: float, band: int) -> None:
    """Of whole half periods, so that next to nothing leaks into others."""
    t = np.arange(1000) / 50
    wave = channel((2 * np.cos(2 * np.pi * hz * (t + 0.01))).tolist())
    found = band_rms([wave])
    assert found[band] == pytest.approx(np.sqrt(2), rel=1e-6)
    assert sum(found) == pytest.approx(found[band], abs=1e-6)


def test_bands_sum_up_to_the_whole_over_pieces_and_flights() -> None:
    rng = np.random.default_rng(3)
    parts = [rng.normal(size=n) + 1 for n in (300, 200, 77)]
    first = channel(np.concatenate(parts[:2]).tolist(), [0] * 300 + [1] * 200)
    found = band_rms([first, channel(parts[2].tolist())])
    whole = np.concatenate(parts)
    assert sum(b * b for b in found) == pytest.approx(np.mean(whole**2))
    assert above(found) == pytest.approx(np.sqrt(np.mean(whole**2) - found[0] ** 2))


def test_a_constant_is_in_the_first_band_alone_and_a_mean_takes_it() -> None:
    rng = np.random.default_rng(4)
    noise = rng.normal(size=400)
    noisy, flat = channel((noise + 5).tolist()), channel([5.0] * 400)
    assert band_rms([flat]) == pytest.approx([5.0, 0.0, 0.0, 0.0])
    found = spectra({"none": [noisy], "effects": [flat]}, [channel([3.0, 5.0])])
    assert found["mean"] == pytest.approx(
        {
            "none": 5 + noise.mean(),
            "effects": 5.0,
            "own_mean": 0.0,
            "fit_mean": 1 + noise.mean(),
        }
    )
    for mean in ("own_mean", "fit_mean"):
        assert found["bands"][mean][1:] == pytest.approx(found["bands"]["none"][1:])
    assert found["bands"]["own_mean"][0] < found["bands"]["fit_mean"][0]
    rms = float(np.sqrt(np.mean(noisy.residual**2)))
    assert about_mean(rms, found["mean"]["none"]) == pytest.approx(float(np.std(noisy.residual)))


# -- the page -------------------------------------------------------------------------------


def test_details_hold_every_figure_and_no_path() -> None:
    real = next(s for s in SCENARIOS if s.name == "real")
    heavy = next(s for s in SCENARIOS if s.name == "simulated_heavy")
    shape = {"value": 4.8, "edge": [2.6, 4.8], "neutral": None}
    text = details(
        [
            (real, [case("a", {"motor_lag": GOOD, "battery_sag": shape}), case("b", {})]),
            (heavy, [case("sim", {})]),
        ]
    )
    assert "| a | named | `motor_lag` 0.97, `battery_sag` 0.97 | - | 0.01 | - |" in text
    alone = "- | - | no | no | one rotation |"
    assert f"| `motor_lag.n` | s | 0.05 (0.04 to 0.06) | - | {alone}" in text
    assert f"| `battery_sag.n` | s | 4.8* | - | {alone.replace('no', 'a', 1)}" in text
    assert "| `acc_z` | m/s² | 1.4 | 0.6 | 0.1 | 0.2 | 1.4 | 0.8 |" in text
    assert "| `acc_z` | m/s² | 900 | 2 | 1 | 1.5 | 1.4 | 0.5 | - | 0.9 | 30 to 60 % |" in text
    nowhere = "| - | - | - | no | no | never given |"
    assert f"| `mass_offset.mass_kg` | - | -0.28 {nowhere}" in text
    assert "| `mass_offset` | 0 of 1 | made wrong on purpose, and missed |" in text
    assert not re.search(r"(^|[\s(`\"])/\w+/", text)
    for line in text.splitlines():
        assert not line.startswith("|") or line.endswith("|")


def test_page_tells_how_near_a_number_is_that_was_made_wrong() -> None:
    quick = next(s for s in SCENARIOS if s.name == "crazyflie_quick")
    near, far = GOOD | {"value": 0.07, "ci95": [0.06, 0.08]}, GOOD | {"value": 0.06}
    cases = [case("a", {"motor_lag": near}), case("b", {"motor_lag": far}), case("c", {})]
    for c in cases:
        c["numbers"] = {f"{k[:-1]}tau_s": n for k, n in c["numbers"].items()}
    said = "given by 2 of 3 rotations, off by 20 % at most, inside the interval in 1."
    assert f"- `motor_lag.tau_s` was to be 0.075: {said}" in details([(quick, cases)])


def test_page_shows_bands() -> None:
    cases = [case(f, {"motor_lag": GOOD}) for f in ("real_1", "real_2", "real_3")]
    for c in cases:
        row = c["channels"][0]
        c["channels"].append(row | {"name": "gyro_rate_z", "unit": "rad/s²"})
    text = details([(SCENARIOS[0], cases)])
    assert "| `gyro_rate_z` | 0.8-4.5 Hz | 0.3 | 0.3 | 0.3 | 0.3 | 0.3 |" in text
    assert "| `gyro_rate_z` | **> 0.8 Hz** | 0.51 | 0.51 | 0.51 | 0.51 | 0.51 |" in text
    assert "- Of 1 numbers that more than one rotation gives, 1 pass, 0 of them mostly" in text


def test_page_tells_what_something_acts_like() -> None:
    text = details([(SCENARIOS[0], [case("a", {}, verdict="unnamed", acts_like=["gyro_scale"])])])
    assert "| a | unnamed | - | `gyro_scale` | 0.01 | - |" in text
    assert "- a held out: something acts like `gyro_scale`: too far" in text


def test_drag_is_that_of_either_effect_in_1_s() -> None:
    nano = next(s for s in SCENARIOS if s.name == "nanobench")
    found = case("circle", {})
    found["predicted"] = {"rotor_drag.k_xy_1_s": 0.1, "blade_flapping.k_rad_s_m": 0.02}
    assert drag_1_s(found) == pytest.approx(0.1 + 9.80665 * 0.02)
    row = found["channels"][0] | {"unit": "rad/s²", "effects": 10.0}
    for axis, mean in zip("xyz", (9.0, 0.0, 8.0), strict=True):
        found["channels"].append(
            row | {"name": f"gyro_rate_{axis}", "mean": row["mean"] | {"effects": mean}}
        )
    assert (
        "| circle | 0.296 | 0.25 | - | - | - | - | - | 4.36 of 1.4 | 10* of 1.4 | 6 of 1.4 |"
        in details([(nano, [found])])
    )


def test_the_trivial_rule_for_drag_finds_a_planted_one() -> None:
    vehicle = load_vehicle("crazyflie")
    plant = vehicle.with_effects({"rotor_drag": {"k_xy_1_s": 0.3, "k_z_1_s": 0.0}})
    flown = fly(vehicle, plant, seed=2)
    assert braking([flown]) == pytest.approx(0.3, rel=0.1)
    assert braking([replace(flown, table=flown.table.drop(columns="vel_x"))]) is None


def test_page_tells_of_what_failed_or_could_not_be_used() -> None:
    real = SCENARIOS[0]
    failed = command.answer(Path("nowhere"), (real, real.flights[0]))
    assert failed["said"]["verdict"] == "error"
    lying = case("real_2", {}, verdict="unusable") | {"channels": []}
    lying["said"]["reasons"] = ["real_1: upside down at 3.0 s"]
    text = details([(real, [failed | {"twin": ""}, lying])])
    assert "- real_1 held out: LogError" in text
    assert "- real_2 held out: real_1: upside down at 3.0 s" in text
    assert "No gap could be shown." in text


def short(found: list[Any], folder: Path) -> str:
    """The page of these rotations, by way of the stored rows."""
    facts = {"measured": "1 May 2026", "note": "", "state": state(found)}
    write_rows(folder / "rows.jsonl", [facts, *rows(details(found))])
    return short_page(read_rows(folder / "rows.jsonl"), "rows.jsonl")


def test_the_page_begins_with_labelled_flights_and_states_its_run(tmp_path: Path) -> None:
    text = short([(SCENARIOS[0], [case("a", {"motor_lag": GOOD})])], tmp_path)
    first = text.index("| class right, of those answered |")
    assert first < text.index("| scenario |")
    assert "Measured on 1 May 2026." in text and "0123456789ab" in text
    assert "[rows.jsonl](rows.jsonl)" in text
    assert f"- **{SCENARIOS[0].title}**: {SCENARIOS[0].about}" in text
    assert "{" not in text


def test_the_page_shows_numbers_that_agree_and_no_others(tmp_path: Path) -> None:
    apart = GOOD | {"value": 0.3, "ci95": [0.2, 0.4]}
    vague = GOOD | {"prior_share": 0.9}
    effects = {"motor_lag": GOOD, "gust": GOOD, "cog_offset": vague}
    other = {"motor_lag": GOOD | {"value": 0.055}, "gust": apart, "cog_offset": vague}
    text = short([(SCENARIOS[0], [case("a", effects), case("b", other)])], tmp_path)
    assert f"| {SCENARIOS[0].title} | `motor_lag.n`, s | 0.05…0.055 | 2 |" in text
    assert "`gust.n`" not in text and "`cog_offset.n`" not in text


def test_rms_of_a_page_is_that_over_all_samples(tmp_path: Path) -> None:
    """900 samples with 1 and 300 with 3: the root of (900 * 1 + 300 * 9) / 1200."""
    one, other = case("a", {}), case("b", {}, n=300, shrink_ci95=[-0.8, -0.2])
    other["channels"][0]["effects"] = 3.0
    text = short([(SCENARIOS[0], [one, other])], tmp_path)
    assert f"| {SCENARIOS[0].title} | `acc_z` | 2 | 1.73 | 1.5 | 0.9 | 1 | 1 |" in text


def test_a_scenario_measured_again_takes_the_place_of_its_rows() -> None:
    one, other = ([(s, [case("a", {"motor_lag": GOOD})])] for s in SCENARIOS[:2])
    later = [(SCENARIOS[0], [case("a", {"gust": GOOD})])]
    facts = {"measured": "1 May 2026", "note": "", "state": "first"}
    both = [facts, *rows(details([*one, *other]))]
    made = renewed(both, list(rows(details(later))), "later.")
    assert made[0] == facts | {"again": {SCENARIOS[0].title: "later."}}
    latest = renewed(made, list(rows(details(later))), "latest.")
    text = short_page(latest, "rows.jsonl")
    assert f"{SCENARIOS[0].title}: latest." in text and "later." not in text
    assert made[1:] == list(rows(details([*later, *other])))


def test_the_short_page_tells_a_scenario_with_a_goal_rotation_by_rotation(tmp_path: Path) -> None:
    nano = next(s for s in SCENARIOS if s.name == "nanobench")
    found = case("circle", {})
    found["predicted"] = {"rotor_drag.k_xy_1_s": 0.3}
    flown = {"hover": {"stable": True}, "tour": {"stable": False}}
    day = {"clock_offset.pose_s": {"difference": -0.017}}
    found["said"] |= {"closed_loop": {"missions": flown}, "per_flight": {"a": day, "b": {}}}
    text = short([(nano, [found])], tmp_path)
    assert f"## {nano.title}: rotations" in text
    assert "| circle | 0.3 | 0.25 | - | - | - | -17, 0 | 1 of 2 |" in text


def test_the_stored_rows_make_the_page_of_the_documentation(tmp_path: Path) -> None:
    results = ROOT / "docs" / "results"
    (tmp_path / "real_flights.jsonl").write_bytes((results / "real_flights.jsonl").read_bytes())
    assert command.main(["--stored", "--out", str(tmp_path / "real_flights.md")]) == 0
    page = (tmp_path / "real_flights.md").read_text("utf-8")
    assert page == (results / "real_flights.md").read_text("utf-8")
    assert len(page.split()) <= 3000


# -- the command ----------------------------------------------------------------------------


def test_a_run_goes_on_where_it_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    real = SCENARIOS[0]
    (tmp_path / "data" / "rflysimdt").mkdir(parents=True)
    for flight in real.flights:
        (tmp_path / "data" / flight).write_text(flight)

    monkeypatch.setattr(command, "twin_state", lambda: "now")

    def files(state: str = "now") -> dict[str, str]:
        return {f: command.key(tmp_path / "data", real, f, state) for f in real.flights}

    for flight, name in files().items():
        said = case(Path(flight).stem, {"motor_lag": GOOD})
        (tmp_path / f"{name}.json").write_text(json.dumps(said))
    out = tmp_path / "page.md"
    options = [
        "--data",
        str(tmp_path / "data"),
        "--out",
        str(out),
        "--cache",
        str(tmp_path),
        "--only",
        "real",
    ]
    assert command.main(options) == 0
    assert "3 rotations, 3 there already" in capsys.readouterr().err
    assert "nothing speaks against it" in out.with_suffix(".jsonl").read_text("utf-8")
    before = files()
    (tmp_path / "data" / real.flights[2]).write_text("another flight")
    assert not set(before.values()) & set(files().values())  # it is in every rotation
    (tmp_path / "data" / real.flights[2]).write_text(real.flights[2])
    assert files() == before
    assert not set(before.values()) & set(files("another state of twin/").values())


def test_without_recordings_the_command_says_what_is_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "page.md"
    assert command.main(["--data", str(tmp_path), "--out", str(out)]) == 2
    assert "real_1.ulg" in capsys.readouterr().err
    assert not out.exists()


def test_the_page_in_the_repository_names_every_scenario() -> None:
    text = (ROOT / "docs" / "results" / "real_flights.md").read_text("utf-8")
    assert text.startswith((ROOT / "benchmarks/real_flights/protocol.md").read_text()[:60])
    assert all(f"| {s.title} | " in text for s in SCENARIOS)
