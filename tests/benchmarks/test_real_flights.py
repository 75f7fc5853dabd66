"""The page of the recorded flights: figures against counts by hand, words against planted facts."""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.real_flights import __main__ as command
from benchmarks.real_flights.agreement import Number, agreement, judge
from benchmarks.real_flights.measure import baselines, held
from benchmarks.real_flights.page import page
from benchmarks.real_flights.scenarios import SCENARIOS, Change, read
from twin.residuals.channels import ChannelData
from twin.vehicle.file import load_vehicle

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
    """A rotation; effects: name -> value, ci95, edge of its one number `n`, added per flight."""
    rms = {"none": 2.0, "effects": 1.0, "fit_mean": 1.5, "own_mean": 1.4, "floor": 0.9}
    row = {
        "name": "acc_z",
        "unit": "m/s²",
        "n": 900,
        **rms,
        "last_20_ms": 0.5,
        "last_500_ms": None,
        "shrink_ci95": [0.3, 0.6],
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
    return {
        "scenario": "real",
        "holdout": holdout,
        "said": {"verdict": verdict, "effects": told, "reasons": [], "nothing_probability": 0.01},
        "at_edge": {f"{k}.n": e["edge"] for k, e in effects.items() if "edge" in e},
        "by_flight": {k: e["added"] for k, e in effects.items() if "added" in e},
        "channels": [row | more],
        "seconds": 30.0,
        "twin": "0123456789ab",
    }


GOOD = {"value": 0.05, "ci95": [0.04, 0.06], "added": {"a": 40.0, "b": 30.0}}


def against(cases: list[dict[str, Any]]) -> dict[str, str]:
    return {j.effect: "; ".join(j.against) for j in judge(cases)}


def test_an_effect_that_all_rotations_confirm_has_nothing_against_it() -> None:
    assert against([case(f, {"motor_lag": GOOD}) for f in "abc"]) == {"motor_lag": ""}


@pytest.mark.parametrize(
    ("change", "more", "said"),
    [
        ({"edge": [0.0, 0.05]}, {}, "`motor_lag.n` at the edge of its range with c held out"),
        ({"value": 0.3, "ci95": [0.2, 0.4]}, {}, "differs between .*: 0.05 and 0.05 and 0.3"),
        ({"added": {"a": 99.0, "b": 1.0}}, {}, "rests on a with c held out: 99 %"),
        ({"added": {"a": 9.0, "b": -5.0}}, {}, "rests on a with c held out: 100 %"),
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


@pytest.mark.parametrize(
    ("numbers", "said"),
    [
        ([(1.0, (0.5, 1.5)), (1.4, (0.9, 1.9))], "yes"),
        ([(1.0, (0.5, 1.5)), (1.6, (1.1, 2.1))], "intervals overlap"),
        ([(1.0, (0.5, 1.5)), (3.0, (2.0, 4.0))], "no"),
        ([(1.0, None), (3.0, None)], "no interval"),
        ([(1.0, (0.5, 1.5))], "one rotation only"),
    ],
)
def test_agreement(numbers: list[tuple[float, Any]], said: str) -> None:
    assert agreement([Number(v, "m", ci, None) for v, ci in numbers]) == said


# -- the page -------------------------------------------------------------------------------


def test_page_holds_every_figure_and_no_path() -> None:
    real = next(s for s in SCENARIOS if s.name == "real")
    heavy = next(s for s in SCENARIOS if s.name == "simulated_heavy")
    shape = {"value": 4.8, "edge": [2.6, 4.8], "added": {"a": 4.0, "b": 3.0}}
    text = page(
        [
            (real, [case("a", {"motor_lag": GOOD, "battery_sag": shape}), case("b", {})]),
            (heavy, [case("sim", {})]),
        ]
    )
    assert "| a | named | `motor_lag` 0.97, `battery_sag` 0.97 | 0.01 | - |" in text
    assert "| `motor_lag.n` | s | 0.05 (0.04 to 0.06) | - | one rotation only |" in text
    assert "| `battery_sag.n` | s | 4.8* | - | one rotation only |" in text
    assert "| `acc_z` | m/s² | 900 | 2 | 1 | 1.5 | 1.4 | 0.5 | - | 0.9 | 30 to 60 % |" in text
    assert "| `mass_offset.mass_kg` | - | -0.28 | - | never given |" in text
    assert "| `mass_offset` | 0 of 1 | made wrong on purpose, and missed |" in text
    assert "0123456789ab" in text
    assert not re.search(r"(^|[\s(`\"])/\w+/", text)
    for line in text.splitlines():
        assert not line.startswith("|") or line.endswith("|")


def test_page_tells_how_near_a_number_is_that_was_made_wrong() -> None:
    quick = next(s for s in SCENARIOS if s.name == "crazyflie_quick")
    near, far = GOOD | {"value": 0.07, "ci95": [0.06, 0.08]}, GOOD | {"value": 0.06}
    cases = [case("a", {"motor_lag": near}), case("b", {"motor_lag": far}), case("c", {})]
    for c in cases:
        for effect in c["said"]["effects"]:
            effect["parameters"] = {"tau_s": effect["parameters"]["n"]}
    said = "given by 2 of 3 rotations, off by 20 % at most, inside the interval in 1."
    assert f"- `motor_lag.tau_s` was to be 0.075: {said}" in page([(quick, cases)])


def test_page_tells_of_what_failed_or_could_not_be_used() -> None:
    real = SCENARIOS[0]
    failed = command.answer(Path("nowhere"), (real, real.flights[0]))
    assert failed["said"]["verdict"] == "error"
    lying = case("real_2", {}, verdict="unusable") | {"channels": []}
    lying["said"]["reasons"] = ["real_1: upside down at 3.0 s"]
    text = page([(real, [failed | {"twin": ""}, lying])])
    assert "- real_1 held out: LogError" in text
    assert "- real_2 held out: real_1: upside down at 3.0 s" in text
    assert "No gap could be shown." in text


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
    assert "nothing speaks against it" in out.read_text()
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
    assert all(f"## {s.title}\n" in text for s in SCENARIOS)
