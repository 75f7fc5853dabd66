"""Files that are off, days, logs without sensors, defects: against the truth that is recorded."""

import argparse
import hashlib
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmarks.hidden_effects import generate
from benchmarks.hidden_effects import run as runner
from benchmarks.hidden_effects.cases import HALVES, SENSORS, Case, Conditions, cases, half_of
from benchmarks.hidden_effects.generate import _DEVIATION, LIFE_KINDS, batches, life_set
from benchmarks.hidden_effects.planning import missions_of, plan
from benchmarks.hidden_effects.plants import missions
from benchmarks.hidden_effects.plants.aircraft import AIRCRAFT, NOISE, Aircraft, vehicle_toml
from benchmarks.hidden_effects.plants.kinds import EFFECTS, PLANTS
from benchmarks.hidden_effects.plants.missions import Order
from benchmarks.hidden_effects.plants.own.flight import Trace, fly
from benchmarks.hidden_effects.plants.own.parameters import GRAVITY_M_S2, Parameters
from benchmarks.hidden_effects.plants.sensing import flight_table
from benchmarks.hidden_effects.produce import produce, shown
from benchmarks.hidden_effects.realism import (
    DEFECTS,
    as_logged,
    can_show,
    draw_day,
    mean_deviations,
    on_day,
    seen_from,
    wrong_file,
)
from twin.vehicle_file import parse_vehicle

QUAD = AIRCRAFT["quad_450"]
DAYS = Conditions(days=True, fits=3)
every_aircraft = pytest.mark.parametrize("aircraft", AIRCRAFT.values(), ids=list(AIRCRAFT))
both_drives = pytest.mark.parametrize("by_speed", [False, True], ids=["commands", "speeds"])


def order(plant: Parameters, mission: str = "hover") -> Order:
    """A flight without noise."""
    flown = missions.mission(mission, QUAD.nominal.leg, QUAD.pace, np.random.default_rng(5))
    return Order(QUAD, plant, flown, NOISE["none"], (7,))


# -- today's cases --------------------------------------------------------------------------


def test_identifiers_of_todays_cases_stay() -> None:
    ids = "".join(c.id for c in cases())
    assert hashlib.sha256(ids.encode()).hexdigest().startswith("3c1ff9f592a5a7a3f22ddd8e")


@pytest.mark.slow
def test_a_flight_of_today_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sums of columns as they were before there were other conditions; the tolerance is for other
    processors."""
    monkeypatch.setattr(missions, "DURATION_S", 1.6)
    pair = Case("own", "pair", ("rotor_drag", "thrust_tilt"), "medium", "medium", 0)
    made = next(iter(produce([pair])))
    assert list(made.flights) == ["fit_1", "fit_2", "holdout_1"]
    table = made.flights["fit_2"]
    sums = [float(table[c].sum()) for c in ("cmd_1", "acc_x", "gyro_y", "mag_x", "pos_z")]
    before = [111.69964761, -40.7876194824, -6.5993131812, 0.00167986662266, -25.7614395215]
    assert sums == pytest.approx(before, rel=1e-9)
    assert hashlib.sha256(made.vehicle.encode()).hexdigest().startswith("50f1d82ad12938d1fde0a572")
    assert set(made.truth) == {
        *("case", "plant", "kind", "magnitude", "noise", "seed", "missions", "effects"),
        *("aircraft", "gap"),
    }


# -- the set --------------------------------------------------------------------------------


def test_the_set_has_every_kind_and_is_the_same_each_time() -> None:
    chosen = life_set(600)
    assert chosen == life_set(600)
    assert len({c.id for c in chosen}) == len(chosen) == 600
    kinds = Counter(c.kind for c in chosen)
    assert set(kinds) == {"single", "pair", "triple", "outside", "nothing", *LIFE_KINDS}
    assert kinds["since"] == 60
    assert {c.magnitude for c in chosen} == {"small", "medium", "large", "none", "mixed"}
    assert {c.life.without for c in chosen} == {"", *SENSORS}
    assert {c.life.fits for c in chosen if c.life.days and c.kind != "since"} == {2, 3, 4, 5, 6}
    assert {c.plant for c in chosen if c.kind == "many"} == set(PLANTS)
    for plant in PLANTS:
        of_plant = [c for c in chosen if c.plant == plant and c.life.key]
        assert {c.aircraft for c in of_plant} == set(PLANTS[plant].aircraft)
        assert {c.life.without for c in of_plant} == {"", *SENSORS}
        assert {c.life.days for c in of_plant if c.kind == "many"} == {True, False}
    happened = {(c.effects, c.life.slow) for c in chosen if c.kind == "since"}
    assert len(happened) == 2 * len(DEFECTS)


def test_the_set_is_chosen_from_by_half_plant_and_kind() -> None:
    parser = argparse.ArgumentParser()
    generate.add_options(parser)
    chosen = generate.chosen(
        parser.parse_args(
            ["--life", "300", "--half", "tune", "--plant", "drone_models", "--kind", "many"]
        )
    )
    assert chosen
    assert {(c.plant, c.kind) for c in chosen} == {("drone_models", "many")}
    assert {half_of(c.plant, c.kind, c.effects, c.seed) for c in chosen} == {"tune"}
    with pytest.raises(SystemExit):
        parser.parse_args(["--life", "300", "--subset", "10"])


def test_many_effects_are_six_to_twelve_that_show() -> None:
    many = [c for c in life_set(600) if c.kind == "many"]
    assert {len(c.effects) for c in many} == set(range(6, 13))
    for case in many:
        assert case.life.off
        assert all(can_show(n, case.life) for n in case.effects)
        assert len({*case.effects} & {"motor_lag", "command_delay", "position_delay"}) <= 1
        assert {*case.effects} <= {*PLANTS[case.plant].effects}


def test_nobody_looks_for_what_a_log_without_its_sensor_cannot_show() -> None:
    assert not can_show("mag_hard_iron", Conditions(without="field"))
    assert not can_show("accel_bias", Conditions(without="inertial"))
    assert can_show("rotor_drag", Conditions(without="inertial"))
    assert not can_show("motor_lag", Conditions(rotors=True))
    assert not can_show("gust", Conditions())


def test_halves_follow_plant_and_effect_alone() -> None:
    every = [c for c in life_set(600) if c.effects and c.kind != "since"]
    found: dict[tuple[str, tuple[str, ...]], set[str]] = {}
    for c in every:
        key = (c.plant, tuple(sorted(c.effects)))
        found.setdefault(key, set()).add(half_of(c.plant, c.kind, c.effects, c.seed))
    assert {len(halves) for halves in found.values()} == {1}
    for kind in (*LIFE_KINDS, "single", "nothing"):
        of_kind = [c for c in life_set(600) if c.kind == kind]
        halves = Counter(half_of(c.plant, c.kind, c.effects, c.seed) for c in of_kind)
        assert min(halves[h] for h in HALVES) > 0.2 * len(of_kind), (kind, halves)


def test_flights_that_are_flown_at_once_are_not_too_many() -> None:
    chosen = [c for c in life_set(600) if c.plant == "own"]
    parts = batches(chosen)
    assert sorted(c.id for part in parts for c in part) == sorted(c.id for c in chosen)
    assert max(sum(len(missions_of(c)) for c in part) for part in parts) <= 300


# -- files that are off ---------------------------------------------------------------------


@every_aircraft
@both_drives
def test_file_is_off_by_what_the_truth_records(aircraft: Aircraft, by_speed: bool) -> None:
    wrong = wrong_file(aircraft, by_speed, np.random.default_rng(3))
    text = vehicle_toml(wrong.believed, NOISE["low"], wrong.sd, by_speed)
    vehicle = parse_vehicle(_DEVIATION.sub("", text), "vehicle.toml")
    errors, p = {e.key: e for e in wrong.errors}, aircraft.nominal
    assert vehicle.drive == ("rotor_speed" if by_speed else "command")
    assert vehicle.mass_kg == pytest.approx(errors["body.mass"].file)
    assert errors["body.mass"].true == p.mass
    inertia = [errors[f"body.inertia.{a}"].file for a in "xyz"]
    np.testing.assert_allclose(np.diag(vehicle.inertia_kg_m2), inertia)
    places = [errors[f"rotors.position.{a}"] for a in "xy"]
    shift = [e.file - e.true for e in places]
    moved = vehicle.rotors.position_m[:, :2] - p.hubs[:, :2]
    np.testing.assert_allclose(moved, np.broadcast_to(shift, moved.shape), atol=1e-12)
    sound = parse_vehicle(vehicle_toml(aircraft, NOISE["low"], None, by_speed), "vehicle.toml")
    maps = {k.split("_")[0]: e.file for k, e in errors.items() if "_" in k}
    thrust, torque = maps["rotors.thrust"], maps["rotors.torque"]
    np.testing.assert_allclose(vehicle.rotors.thrust_n, np.multiply(thrust, sound.rotors.thrust_n))
    carried = thrust if aircraft.by_command and not by_speed else 1.0
    np.testing.assert_allclose(
        vehicle.rotors.torque_n_m, np.multiply(torque * carried, sound.rotors.torque_n_m)
    )
    assert text.count("sd = ") == len(wrong.sd) == (6 if by_speed else 7)


def test_errors_of_files_are_standard_normal() -> None:
    z = np.array(
        [
            e.z
            for seed in range(150)
            for e in wrong_file(QUAD, False, np.random.default_rng(seed)).errors
        ]
    )
    assert abs(z.mean()) < 4 / np.sqrt(len(z))
    assert abs((z**2).mean() - 1) < 4 * np.sqrt(2 / len(z))


def test_stated_deviations_are_those_of_the_errors() -> None:
    wrong = wrong_file(QUAD, False, np.random.default_rng(1))
    for e in wrong.errors:
        text = next(v for k, v in wrong.sd.items() if e.key.startswith(k))
        stated = float(text.strip('"% ')) / 100 * e.file if "%" in text else float(text)
        assert e.sd == pytest.approx(stated)


@every_aircraft
def test_numbers_seen_from_the_file_make_it_what_flies(aircraft: Aircraft) -> None:
    """Hidden effects and errors of the file together, by the laws of the library."""
    names = ("mass_offset", "cog_offset", "inertia_error", "imu_lever_arm", "motor_lag")
    plant, rng = aircraft.nominal, np.random.default_rng(2)
    for name in (*names, "thrust_scale", "rotor_efficiency_loss"):
        plant, _ = EFFECTS[name].hide(plant, aircraft, EFFECTS[name].sizes[1], rng)
    file = wrong_file(aircraft, False, np.random.default_rng(4)).believed.nominal
    seen = {n: [v.value for v in of.values()] for n, of in seen_from(file, plant).items()}
    centre = np.array([*seen["cog_offset"], 0.0])
    assert file.mass + seen["mass_offset"][0] == pytest.approx(plant.mass)
    assert file.lag + seen["motor_lag"][0] == pytest.approx(plant.lag)
    np.testing.assert_allclose(file.inertia * seen["inertia_error"], plant.inertia)
    np.testing.assert_allclose(file.hubs - centre, plant.hubs, atol=1e-12)
    np.testing.assert_allclose(file.imu_arm - centre + seen["imu_lever_arm"], plant.imu_arm)
    whole = np.isclose(file.thrust_k * seen["thrust_scale"][0], plant.thrust_k)
    assert whole.sum() == len(whole) - 1  # the rotor that has lost thrust


# -- days and defects -----------------------------------------------------------------------


@pytest.mark.slow
def test_constants_of_a_day_show_in_the_readings(monkeypatch: pytest.MonkeyPatch) -> None:
    """At rest on the ground: bias, pressure and heading as drawn."""
    monkeypatch.setattr(missions, "DURATION_S", 0.5)
    drawn, none = draw_day(QUAD, np.random.default_rng(9)), np.zeros(3)
    day = replace(drawn, centre_m=none, wind_m_s=none)  # the feet would give way a little
    orders = [order(QUAD.nominal), order(on_day(QUAD.nominal, day))]
    trace = fly(orders)
    usual, other = (
        flight_table(o, trace, i).ffill().iloc[80:].mean(numeric_only=True)
        for i, o in enumerate(orders)
    )
    change = other - usual
    np.testing.assert_allclose(change[["acc_x", "acc_y", "acc_z"]], day.accel_bias_m_s2, atol=1e-5)
    assert change["baro_pa"] == pytest.approx(day.pressure_pa, abs=1e-3)
    turned = np.arctan2(-other["mag_y"], other["mag_x"]) - np.arctan2(
        -usual["mag_y"], usual["mag_x"]
    )
    assert turned == pytest.approx(day.heading_rad, abs=1e-6)


def test_centre_of_mass_and_air_of_a_day() -> None:
    day = draw_day(QUAD, np.random.default_rng(9))
    flown, usual = on_day(QUAD.nominal, day), QUAD.nominal
    for now, before in ((flown.hubs, usual.hubs), (flown.imu_arm, usual.imu_arm)):
        np.testing.assert_allclose(before - now, np.broadcast_to(day.centre_m, now.shape))
    assert np.all(day.centre_m[:2] != 0) and day.centre_m[2] == 0
    np.testing.assert_array_equal(flown.wind, day.wind_m_s)
    assert flown.position_delay == day.delay_steps


def test_days_differ_and_are_recorded() -> None:
    case = Case("own", "nothing", (), "none", "low", 3, DAYS)
    planned = plan(case)
    assert list(planned.flights) == ["fit_1", "fit_2", "fit_3", "holdout_1"]
    biases = [o.plant.accel_bias.tolist() for o in planned.flights.values()]
    assert biases == [d.accel_bias_m_s2.tolist() for d in planned.days.values()]
    assert len({tuple(b) for b in biases}) == 4
    assert all(d.delay_steps >= 0 for d in planned.days.values())


def test_means_of_days_are_normal_in_their_own_deviations() -> None:
    rng = np.random.default_rng(0)
    sets = [mean_deviations([draw_day(QUAD, rng) for _ in range(4)], QUAD) for _ in range(2000)]
    over = {e: float(np.mean([s[e] > 2 for s in sets])) for e in sets[0]}
    two_sided = 0.0455
    for effect, axes in {
        "baro_bias": 1,
        "heading_offset": 1,
        "cog_offset": 2,
        "accel_bias": 3,
    }.items():
        assert over[effect] == pytest.approx(1 - (1 - two_sided) ** axes, abs=0.02), effect
    assert over["steady_wind"] == pytest.approx(over["cog_offset"], abs=0.02)


def test_only_the_flight_after_the_normal_ones_has_a_defect() -> None:
    life = Conditions(off=True, days=True, fits=5, slow=True)
    planned = plan(Case("own", "since", ("rotor",), "mixed", "low", 0, life))
    flights = planned.flights
    assert list(flights) == [*(f"normal_{i}" for i in range(1, 6)), "since_1"]
    assert len({o.setpoints.yaw.shape for o in flights.values()}) == 1
    for name, o in flights.items():
        lost = 1 - o.plant.thrust_k / AIRCRAFT["quad_450"].nominal.thrust_k
        assert (np.abs(lost).max() > 0.04) == (name == "since_1")


def test_a_hurt_rotor_loses_thrust_and_torque_alike() -> None:
    p, truth = DEFECTS["rotor"](QUAD.nominal, QUAD, np.random.default_rng(0))
    ((name, number),) = truth["rotor_efficiency_loss"].items()
    i = int(name.removeprefix("loss_")) - 1
    for now, before in ((p.thrust_k, QUAD.nominal.thrust_k), (p.torque_k, QUAD.nominal.torque_k)):
        np.testing.assert_allclose(now / before, 1 - number.value * (np.arange(4) == i))


def test_payload_is_a_point_mass() -> None:
    """Mass, centre and inertia of the aircraft taken as points, with one more point."""
    before = QUAD.nominal
    p, truth = DEFECTS["payload"](before, QUAD, np.random.default_rng(0))
    extra = truth["mass_offset"]["mass_kg"].value
    centre = (before.hubs - p.hubs)[0]
    place = centre * p.mass / extra
    assert p.mass == before.mass + extra
    points = [(before.mass, -centre), (extra, place - centre)]
    parallel = sum(m * (r @ r - r**2) for m, r in points)
    np.testing.assert_allclose(p.inertia, before.inertia + parallel)
    assert sum(m * r for m, r in points) == pytest.approx(np.zeros(3), abs=1e-12)


# -- logs -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def hover() -> tuple[Order, Trace]:
    """Takeoff and two seconds of hover without noise."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(missions, "DURATION_S", 5.5)
        flown = order(QUAD.nominal)
        return flown, fly([flown])


@pytest.mark.slow
def test_rotor_speeds_carry_the_weight(hover: tuple[Order, Trace]) -> None:
    flown, trace = hover
    table = as_logged(flight_table(flown, trace, 0), trace.rotor[:, :, 0], Conditions(rotors=True))
    assert not [c for c in table if c.startswith("cmd_")]
    speeds = table[[f"rotor_{i}" for i in range(1, 5)]].to_numpy()
    p = QUAD.nominal
    thrust = (p.thrust_k * speeds**2).sum(axis=1)
    assert thrust[-200:] == pytest.approx(p.mass * GRAVITY_M_S2, rel=5e-3)
    airborne = table["time"].to_numpy() > 1.8
    drag = p.drag_linear[2] * table["vel_z"].ffill().to_numpy()
    force = -(thrust + drag) / p.mass
    np.testing.assert_allclose(table["acc_z"][airborne], force[airborne], atol=0.1)


@pytest.mark.slow
def test_an_effect_shows_by_its_size_over_the_noise(hover: tuple[Order, Trace]) -> None:
    _, trace = hover
    bias = np.array([0.0, 0.3, 0.0])
    noise = NOISE["medium"]
    biased = replace(QUAD.nominal, accel_bias=bias)
    ratio = shown(QUAD, biased, trace, 0, noise, Conditions())
    assert ratio == pytest.approx(0.3 / (noise.accel * np.sqrt(2 * 18 / 200)), rel=1e-6)
    assert shown(QUAD, biased, trace, 0, noise, Conditions(days=True)) < 3.0
    assert shown(QUAD, biased, trace, 0, noise, Conditions(without="inertial")) == 0.0
    assert shown(QUAD, QUAD.nominal, trace, 0, noise, Conditions()) == 0.0


@pytest.mark.parametrize("without", SENSORS)
def test_columns_of_missing_sensors_are_gone(without: str) -> None:
    names = ["time", "cmd_1", "acc_x", "gyro_x", "mag_x", "baro_pa", "pos_x", "vel_x", "q_w"]
    table = pd.DataFrame(np.zeros((2, len(names))), columns=names)
    left = set(as_logged(table, np.zeros((2, 1)), Conditions(without=without)))
    assert (
        set(names) - left
        == {
            "field": {"mag_x", "baro_pa"},
            "velocity": {"vel_x"},
            "inertial": {"acc_x", "gyro_x", "mag_x", "baro_pa", "vel_x"},
        }[without]
    )


def test_usual_conditions_leave_the_log_alone() -> None:
    table = pd.DataFrame({"time": [0.0], "cmd_1": [0.5]})
    assert as_logged(table, np.zeros((1, 1)), Conditions()) is table


# -- asking ---------------------------------------------------------------------------------


def test_a_case_with_normal_flights_is_asked_for_what_happened_since(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / runner.SINCE).touch()
    monkeypatch.setattr(runner, "ask_calibrated", lambda folder: {"verdict": folder.name})
    assert runner.explain_case(tmp_path)["verdict"] == tmp_path.name
