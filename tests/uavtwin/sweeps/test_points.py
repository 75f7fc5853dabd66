"""Designs: what is drawn is what was asked for, and what cannot be is refused with a way out."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import kstest, norm

from twin.effects import EFFECTS
from twin.errors import TwinError
from uavtwin.simulation import Scenario
from uavtwin.sweeps.design import (
    METHODS,
    Choice,
    Design,
    Normal,
    Uniform,
    Value,
    distribution_of,
    factor_of,
    read_design,
)
from uavtwin.sweeps.plan import period_of, scenario_of
from uavtwin.sweeps.result import influences

UNIT = {"a": Uniform(0.0, 1.0), "b": Uniform(0.0, 1.0), "c": Uniform(0.0, 1.0)}


@given(runs=st.integers(1, 60), seed=st.integers(0, 2**32))
def test_a_latin_hypercube_has_each_stratum_once(runs: int, seed: int) -> None:
    points = Design(UNIT, "latin_hypercube", runs, seed).points()
    for name in UNIT:
        strata = sorted(math.floor(float(p[name]) * runs) for p in points)
        assert strata == list(range(runs))


@pytest.mark.parametrize("method", [m for m in METHODS if m != "grid"])
def test_the_same_seed_gives_the_same_points(method: str) -> None:
    one, same, other = (Design(UNIT, method, 40 if method != "sobol" else 32, s) for s in (3, 3, 4))
    assert one.points() == same.points() != other.points()


def test_a_grid_has_every_combination_once() -> None:
    vary = {
        "x": distribution_of("x", {"low": 0.0, "high": 1.0, "steps": 3}, "f"),
        "y": Choice(("a", "b")),
    }
    points = Design(vary, "grid").points()
    assert [(p["x"], p["y"]) for p in points] == [
        (x, y) for x in (0.0, 0.5, 1.0) for y in ("a", "b")
    ]


def test_distributions_are_those_that_they_say() -> None:
    share = (np.arange(4000) + 0.5) / 4000
    normal = np.array(Normal(2.0, 0.5).at(share))
    assert kstest(normal, norm(2.0, 0.5).cdf).pvalue > 0.99
    cut = np.array(Normal(2.0, 0.5, low=2.0).at(share))
    assert cut.min() >= 2.0
    assert np.median(cut) == pytest.approx(norm.ppf(0.75, 2.0, 0.5), abs=1e-3)
    logarithmic = np.array(Uniform(0.1, 10.0, log=True).at(np.array([0.0, 0.5, 1.0])))
    assert logarithmic == pytest.approx([0.1, 1.0, 10.0])
    assert Choice(("a", "b", "c")).at(np.array([0.0, 0.34, 1.0])) == ["a", "b", "c"]


@pytest.mark.slow
def test_sobol_indices_of_a_known_function() -> None:
    """Ishigami and Homma (1990): first order 0.314, 0.442, 0; total 0.558, 0.442, 0.244."""
    vary = {n: Uniform(-math.pi, math.pi) for n in "abc"}
    design = Design(vary, "saltelli", 5 * 4096, 1)
    table = pd.DataFrame(design.points())
    a, b, c = (table[n].to_numpy() for n in "abc")
    table["y"] = np.sin(a) + 7 * np.sin(b) ** 2 + 0.1 * c**4 * np.sin(a)
    told = {i.factor: i for i in influences(table, design, "y")}
    first, total = ([getattr(told[n], k) for n in "abc"] for k in ("share", "total"))
    assert first == pytest.approx([0.3139, 0.4424, 0.0], abs=0.02)
    assert total == pytest.approx([0.5576, 0.4424, 0.2437], abs=0.02)
    assert [i.factor for i in influences(table, design, "y")] == ["a", "b", "c"]


@pytest.mark.slow
def test_sobol_indices_of_words_have_intervals_that_repeat() -> None:
    vary: dict[str, Any] = {
        "mission": Choice(("calm", "fast")),
        "x": Uniform(0.0, 1.0),
        "idle": Uniform(0.0, 1.0),
    }
    design = Design(vary, "saltelli", 5 * 64, 1)
    table = pd.DataFrame(design.points())
    table["y"] = 3.0 * (table["mission"] == "fast") + 4 * table["x"]
    word, number, idle = influences(table, design, "y")
    assert (word.factor, number.factor, idle.factor) == ("mission", "x", "idle")
    assert word.low < 2.25 / (2.25 + 16 / 12) < word.high
    assert word.determined and number.determined and not idle.determined
    assert repr(influences(table, design, "y")) == repr([word, number, idle])


VARIANCE = {"word": 2 / 3 * 1.44, "angle": 0.5, "number": 0.25 / 12, "noise": 0.04}


def mixed(runs: int, seed: int) -> tuple[pd.DataFrame, Design]:
    """A figure that depends on a word, an angle and a number, and on neither of two others."""
    vary: dict[str, Any] = {
        "word": Choice(("a", "b", "c")),
        "angle": Uniform(0.0, 360.0),
        "number": Uniform(0.0, 1.0),
        "idle": Uniform(0.0, 1.0),
        "switch": Choice((True, False)),
    }
    design = Design(vary, "latin_hypercube", runs, seed)
    table = pd.DataFrame(design.points())
    level = table["word"].map({"a": -1.2, "b": 0.0, "c": 1.2})
    wave = np.cos(np.radians(table["angle"] - 77.0))  # of no slope over a whole turn
    noise = 0.2 * np.random.default_rng(seed + 1000).standard_normal(runs)
    table["y"] = level + wave + 0.5 * table["number"] + noise
    return table, design


@pytest.mark.slow
def test_words_angles_and_numbers_have_shares_of_one_kind() -> None:
    """Against the variances that the figure was made of."""
    table, design = mixed(2000, 3)
    found = {i.factor: i for i in influences(table, design, "y", {"angle": 360.0})}
    whole = sum(VARIANCE.values())
    for name in ("word", "angle", "number"):
        assert found[name].share == pytest.approx(VARIANCE[name] / whole, abs=0.02)
        assert found[name].low < VARIANCE[name] / whole < found[name].high
    assert [*found][:3] == ["word", "angle", "number"]
    assert not (found["idle"].determined or found["switch"].determined)
    assert found["idle"].words[0] == "not distinguishable from 0"
    assert math.isnan(found["word"].rank) and math.isnan(found["angle"].rank)
    assert found["number"].rank > 0


@pytest.mark.slow
def test_a_factor_without_influence_is_seldom_given_one() -> None:
    """At most one sweep in twenty, where the intervals hold together as they say."""
    false = 0
    for seed in range(60):
        table, design = mixed(60, seed)
        found = influences(table, design, "y", {"angle": 360.0})
        false += any(i.determined for i in found if i.factor in ("idle", "switch"))
        assert next(i for i in found if i.factor == "word").determined
    assert false <= 6  # of true 5 %, more are found once in 50


def test_too_few_runs_are_said() -> None:
    table, design = mixed(6, 1)
    assert {i.words for i in influences(table, design, "y")} == {("too few runs", "")}


def test_a_word_that_a_resample_never_draws_costs_nothing() -> None:
    design = Design({"word": Choice(tuple("abcdefgh"))}, "random", 20, 2)
    table = pd.DataFrame(design.points())
    table["y"] = np.arange(20.0)
    (found,) = influences(table, design, "y")
    assert np.isfinite([found.share, found.low, found.high]).all()


def test_ranks_see_what_goes_up_throughout() -> None:
    design = Design(UNIT, "random", 200, 5)
    table = pd.DataFrame(design.points())
    table["y"] = np.exp(5 * table["b"]) - 1e-3 * table["c"]
    first, *others = influences(table, design, "y")
    assert (first.factor, round(first.rank, 3)) == ("b", 1.0)
    assert first.share > 0.98
    assert all(abs(i.rank) < 0.25 and math.isnan(i.total) for i in others)
    assert not any(i.determined for i in others)


def test_angles_are_known_by_their_unit() -> None:
    units = {"part.yaw": "rad", "part.course": "deg", "part.rate": "rad/s", "part.mass": "kg"}
    periods = {n: period_of(n, units) for n in (*units, "wind.from", "wind.speed", "mission")}
    turn = 2 * math.pi
    assert {n: p for n, p in periods.items() if p} == {
        "part.yaw": turn,
        "part.course": 360.0,
        "wind.from": 360.0,
    }
    numbers = [
        (f"effect.{e.name}.{p.name}", p.unit) for e in EFFECTS.values() for p in e.parameters
    ]
    assert any(unit == "rad" for _, unit in numbers)
    assert all((period_of(n, {}) == turn) == (unit == "rad") for n, unit in numbers)


def test_a_file_says_the_same_as_python(tmp_path: Path) -> None:
    path = tmp_path / "design.toml"
    path.write_text(
        'method = "sobol"\nruns = 64\nseed = 7\n[vary]\n'
        '"wind.speed" = { mean = 4, sd = 2, low = 0 }\ncontroller = ["lqr", "px4"]\n'
        '[vary.airframe]\nmass = { low = 1, high = 2, scale = "log" }\n'
    )
    assert read_design(path) == Design(
        {
            "wind.speed": Normal(4.0, 2.0, low=0.0),
            "controller": Choice(("lqr", "px4")),
            "airframe.mass": Uniform(1.0, 2.0, log=True),
        },
        "sobol",
        64,
        7,
    )


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("runs = 0", "runs = 0: needs an integer"),
        ("runs = 1.5", "runs = 1.5: needs an integer"),
        ('methd = "grid"', "there is no key 'methd'. Did you mean 'method'?"),
        ('method = "grit"', "there is no method 'grit'. Did you mean 'grid'?"),
        ("vary = 3", "vary = 3: is a table"),
        ("[vary]\nx = { low = 2, high = 1 }", "x: low = 2, high = 1: low has to be below"),
        ("[vary]\nx = { low = nan, high = 1 }", "x: low = nan: needs a finite number"),
        ("[vary]\nx = { low = 0, high = 1, scale = 'log' }", "a log scale needs positive"),
        ("[vary]\nx = { low = 0, high = 1, steps = 1 }", "steps = 1: needs an integer of 2"),
        ("[vary]\nx = { mean = 0, sd = 0 }", "sd = 0: needs a positive number"),
        ("[vary]\nx = { mean = 0, hig = 1 }", "mean, hig is no distribution"),
        ("[vary]\nx = []", "x: an empty list"),
        ("[vary]\nx = [1, 'a']", "of several kinds"),
        ("[vary]\nx = [inf]", "inf is no value"),
        ("x = [", "design.toml: not valid TOML"),
    ],
)
def test_a_wrong_design_names_file_key_and_value(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "design.toml"
    path.write_text(text)
    with pytest.raises(TwinError) as caught:
        read_design(path)
    assert says in str(caught.value)


@pytest.mark.parametrize(
    ("design", "says"),
    [
        (Design(UNIT, "sobol", 100), "Take 64 or 128 runs, or latin_hypercube"),
        (Design(UNIT, "saltelli", 100), "Take 80 runs"),
        (Design(UNIT, "grid"), "a has no steps"),
        (Design({"a": Choice((1.0, 2.0))}, "grid", 3), "grid: 2 combinations, --runs says 3"),
    ],
)
def test_what_a_method_cannot_do_is_refused_with_a_way_out(design: Design, says: str) -> None:
    with pytest.raises(TwinError) as caught:
        design.points()
    assert says in str(caught.value)


@pytest.mark.parametrize(
    ("text", "name", "found"),
    [
        ("airframe.mass=1:2", "airframe.mass", Uniform(1.0, 2.0)),
        ("x=0:1:3", "x", Choice((0.0, 0.5, 1.0))),
        ("gusts=true,false", "gusts", Choice((True, False))),
        ("mission=tour,land", "mission", Choice(("tour", "land"))),
        ("a.b=-1.5", "a.b", Choice((-1.5,))),
    ],
)
def test_factors_of_the_command_line(text: str, name: str, found: Any) -> None:
    assert factor_of(text) == (name, found)


@pytest.mark.parametrize("text", ["x", "x=", "=1:2", "x=1:2:3:4", "x=1:b", "x=2:1"])
def test_a_wrong_factor_says_how_it_is_written(text: str) -> None:
    with pytest.raises(TwinError, match=r"--vary"):
        factor_of(text)


def test_factors_shape_a_scenario() -> None:
    base = Scenario("tour", starts={"imu.acc_noise": 0.1}, effects=("rotor_drag",), fused=True)
    factors: dict[str, Value] = {
        "mission": "land",
        "controller": "px4",
        "gusts": True,
        "wind.speed": 5.0,
        "wind.from": 90.0,
        "airframe.mass": 1.3,
        "effect.mass_offset.mass_kg": 0.1,
        "effect.rotor_drag": False,
    }
    made = scenario_of(base, factors, 11)
    assert (made.target, made.controller, made.gusts, made.seed) == ("land", "px4", True, 11)
    assert made.wind_m_s == pytest.approx((0.0, -5.0, 0.0), abs=1e-12)  # from the east, to the west
    assert dict(made.starts) == {"imu.acc_noise": 0.1, "airframe.mass": 1.3}
    assert made.effects == {"mass_offset": {"mass_kg": 0.1}}
    assert scenario_of(base, {"seed": 3.0}, 11).seed == 3


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("wing.speed", True, "wing.speed = True: needs a number"),
        ("contrller", "lqr", "Did you mean 'controller'?"),
        ("gusts", 1.0, "gusts = 1.0: needs true or false"),
        ("seed", 1.5, "seed = 1.5: needs a whole number"),
        ("effect.mass_ofset", True, "Did you mean 'mass_offset'?"),
        ("effect.mass_offset.mass", 1.0, "Did you mean 'mass_kg'?"),
        ("mission", 1.0, "mission = 1.0: needs names"),
    ],
)
def test_a_wrong_factor_is_named(name: str, value: Any, says: str) -> None:
    with pytest.raises(TwinError) as caught:
        scenario_of(Scenario("tour"), {name: value}, 0)
    assert says in str(caught.value)


def test_wind_is_given_one_way() -> None:
    with pytest.raises(TwinError, match="by speed and from, or by north and east"):
        scenario_of(Scenario("tour"), {"wind.speed": 1.0, "wind.north": 1.0}, 0)
