"""Flights of our own plant: what the twin makes of them, same bytes again, no truth in sight."""

import argparse
import ast
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import benchmarks.hidden_effects as package
from benchmarks.hidden_effects import generate
from benchmarks.hidden_effects.cases import Case, cases, subset
from benchmarks.hidden_effects.planning import hide
from benchmarks.hidden_effects.plants import missions
from benchmarks.hidden_effects.plants.aircraft import AIRCRAFT, NOISE, vehicle_toml
from benchmarks.hidden_effects.plants.kinds import EFFECTS
from benchmarks.hidden_effects.plants.missions import Order
from benchmarks.hidden_effects.plants.own.flight import Trace, fly
from benchmarks.hidden_effects.plants.sensing import flight_table
from benchmarks.hidden_effects.produce import true_gap
from twin.logs.flight import Flight
from twin.logs.read import read_flight
from twin.residuals.aligned import align_flight
from twin.residuals.channels import BAND_HZ, GRID_HZ, imu_channels, low_pass
from twin.vehicle_file import parse_vehicle

ALLOWED = (
    "twin.errors",
    "twin.logs.autopilot",
    "twin.logs.flight",
    "twin.logs.table",
    "twin.vehicle_file",
)
"""What the generators may take from the twin: the file formats and their errors."""
RUNNERS = ("run", "__main__")
"""What calls `twin.explain`; generators import none of it."""
SHORT_S = 5.0


def order(aircraft: str, effect: str | None, noise: str) -> Order:
    """Start of a tour, the same for every effect."""
    a = AIRCRAFT[aircraft]
    plant = a.nominal
    if effect:
        plant = EFFECTS[effect].hide(plant, a, EFFECTS[effect].sizes[1], np.random.default_rng(3))[
            0
        ]
    tour = missions.mission("tour", a.nominal.leg, a.pace, np.random.default_rng(5))
    return Order(a, plant, tour, NOISE[noise], (7,))


@pytest.fixture(scope="module")
def flown() -> tuple[dict[str, Order], Trace]:
    """Quiet flights without and with noise, and one flight of every effect, side by side."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(missions, "DURATION_S", SHORT_S)
        orders = {
            "quad_450 none": order("quad_450", None, "none"),
            "quad_150 none": order("quad_150", None, "none"),
            "quad_450 medium": order("quad_450", None, "medium"),
            **{name: order("quad_450", name, "none") for name in EFFECTS},
        }
    return orders, fly(list(orders.values()))


def residual_rms(orders: dict[str, Order], trace: Trace, name: str) -> dict[str, float]:
    """Teacher-forced residuals of the twin that the vehicle file describes."""
    i = list(orders).index(name)
    vehicle = parse_vehicle(vehicle_toml(orders[name].aircraft, orders[name].noise), "v.toml")
    flight = Flight(name, flight_table(orders[name], trace, i))
    return {
        c.name: float(np.sqrt(np.mean(c.residual**2)))
        for c in imu_channels(flight, vehicle, align_flight(flight, vehicle, 1 / GRID_HZ))
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", ["quad_450 none", "quad_150 none"])
def test_twin_matches_a_quiet_flight(flown: tuple[dict[str, Order], Trace], name: str) -> None:
    rms = residual_rms(*flown, name)
    assert max(rms[f"acc_{a}"] for a in "xyz") < 0.006  # of 9.8; low noise is 0.02
    assert max(rms[f"gyro_rate_{a}"] for a in "xyz") < 0.004  # of 3; low noise is 0.05


@pytest.mark.slow
def test_residual_of_a_noisy_quiet_flight_is_its_noise(
    flown: tuple[dict[str, Order], Trace],
) -> None:
    rms = residual_rms(*flown, "quad_450 medium")
    white = NOISE["medium"].accel * np.random.default_rng(0).standard_normal(20_000)
    expected = float(np.std(low_pass(white, BAND_HZ)))
    for axis in "xyz":
        assert rms[f"acc_{axis}"] == pytest.approx(expected, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("name", EFFECTS)
def test_hidden_effect_shows_and_the_aircraft_still_flies(
    flown: tuple[dict[str, Order], Trace], name: str
) -> None:
    orders, trace = flown
    i = list(orders).index(name)
    gap = true_gap(orders[name].aircraft, orders[name].plant, trace, i)
    strange = {"sensor_noise_level", "stuck_sensor"}  # noise and a frozen log: no gap to speak of
    assert name in strange or max(np.abs(v).max() for v in gap.values()) > 1e-7
    off = np.abs(trace.truth[:, :3, i] - orders[name].setpoints.pos).max()
    assert off < 1.5
    assert np.all(np.isfinite(flight_table(orders[name], trace, i)["acc_z"]))


@pytest.mark.slow
def test_quiet_flight_has_no_gap(flown: tuple[dict[str, Order], Trace]) -> None:
    orders, trace = flown
    gap = true_gap(AIRCRAFT["quad_450"], orders["quad_450 none"].plant, trace, 0)
    assert max(np.abs(v).max() for v in gap.values()) < 1e-9


@pytest.mark.slow
def test_delays_are_exact(flown: tuple[dict[str, Order], Trace]) -> None:
    orders, trace = flown
    names = list(orders)
    late = names.index("position_delay")
    steps = orders["position_delay"].plant.position_delay
    assert steps % 10 == 0  # whole samples, so that records can be compared
    there = trace.truth[: -steps // 10, :3, late]
    np.testing.assert_allclose(trace.pose[steps // 10 :, :3, late], there, atol=1e-12)


@pytest.mark.slow
def test_a_flight_is_the_same_in_other_company(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(missions, "DURATION_S", 1.6)
    names = ["vibration", "induced_inflow", "thrust_curve", "battery_sag", "slung_load"]
    together = [order("quad_450", n, "medium") for n in names] + [order("quad_150", None, "high")]
    crowd, alone = fly(together), fly(together[-1:])
    pd.testing.assert_frame_equal(
        flight_table(together[-1], crowd, 5), flight_table(together[-1], alone, 0), check_exact=True
    )


@pytest.mark.slow
def test_cases_are_written_once_alike_and_without_their_truth(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(missions, "DURATION_S", 1.6)
    chosen = [
        c for c in cases(["own"]) if c.seed == 0 and c.noise == "low" and c.kind != "nothing"
    ][:2]
    for folder in ("a", "b"):
        generate.write_batch(tmp_path / folder, chosen)
    files = sorted(p.relative_to(tmp_path / "a") for p in (tmp_path / "a").rglob("*.*"))
    assert len(files) == 2 * 5
    for file in files:
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()
    for case in chosen:
        assert generate.is_complete(tmp_path / "a", case)
        flights = generate.flights_folder(tmp_path / "a", case)
        told = b"".join(p.read_bytes() for p in flights.iterdir()) + str(flights).encode()
        assert not any(word.encode() in told for word in (*EFFECTS, case.magnitude, case.key))
        assert generate.truth_file(tmp_path / "a", case).parent not in flights.parents
        truth = json.loads(generate.truth_file(tmp_path / "a", case).read_text())
        assert [e["name"] for e in truth["effects"]] == [*case.effects]
        assert not read_flight(flights / "fit_1.parquet").findings


def test_cases_are_distinct_opaque_and_drawn_by_their_seed() -> None:
    every = cases()
    assert len({c.id for c in every}) == len(every)
    assert all(re.fullmatch("[0-9a-f]{12}", c.id) for c in every)
    assert len({e for c in every for e in c.effects if not EFFECTS[e].outside}) == 39
    case = next(c for c in every if c.effects == ("thrust_tilt",))
    other = replace(case, seed=case.seed + 3)
    assert np.array_equal(hide(case)[0].tilt, hide(case)[0].tilt)
    assert not np.array_equal(hide(case)[0].tilt, hide(other)[0].tilt)


def test_triples_are_flown_only_where_they_are_asked_for() -> None:
    parser = argparse.ArgumentParser()
    generate.add_options(parser)
    usual, triples = (
        generate.chosen(parser.parse_args(["--plant", "own", *more]))
        for more in ([], ["--kind", "triple", "--subset", "6"])
    )
    assert {c.kind for c in usual} == {"single", "pair", "outside", "nothing"}
    assert [len(c.effects) for c in triples] == 6 * [3]


def test_subset_is_stratified_and_stable() -> None:
    every = [c for c in cases(["own"]) if c.kind != "triple"]
    chosen = subset(every, 120)
    assert chosen == subset(every, 120)
    assert abs(len(chosen) - 120) <= 2
    kinds = {k: sum(c.kind == k for c in chosen) for k in ("single", "pair", "nothing", "outside")}
    assert kinds["single"] >= 55
    assert min(kinds.values()) >= 10
    assert len({c.effects for c in chosen if c.kind == "single"}) == 39


def test_generators_share_no_code_with_the_twin() -> None:
    for file in Path(next(iter(package.__path__))).rglob("*.py"):
        if file.stem in RUNNERS:
            continue
        for node in ast.walk(ast.parse(file.read_text())):
            names = [node.module] if isinstance(node, ast.ImportFrom) and not node.level else []
            if isinstance(node, ast.ImportFrom) and node.level:
                assert node.module not in RUNNERS, (file.name, node.module)
            if isinstance(node, ast.Import):
                names = [a.name for a in node.names]
            for name in names:
                root = str(name).split(".")[0]
                assert root not in ("cosim", "fmus", "learning"), (file.name, name)
                assert root != "twin" or name in ALLOWED, (file.name, name)


def test_case_keys_hold_the_plant() -> None:
    a = Case("own", "nothing", (), "none", "low", 0)
    assert a.id != replace(a, plant="other").id
