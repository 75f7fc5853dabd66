"""The rules by which hypotheses are compared, and what a log can hide from them."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from cosim.demo import Waypoints, fly
from twin.airframe import airframe
from twin.effects import EFFECTS
from twin.explain.model import model_of
from twin.explain.naming import _needless, _spoils, name_effects
from twin.explain.numbers import at_voltage, numbers_of
from twin.explain.refine import Fitted, Ground
from twin.flightlog import Flight
from twin.over_rows import OverRows
from twin.vehicle_file import load_vehicle

COPTER, CRAZYFLIE = load_vehicle("copter_default"), load_vehicle("crazyflie")
ROUND: Waypoints = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 2.0, (0.0, 0.0, -1.5)),
    ("tour", 2.0, (1.5, 0.0, -1.5)),
    ("tour", 2.0, (1.5, 1.5, -2.0)),
    ("tour", 2.0, (0.0, 0.0, -1.5)),
)


@pytest.fixture(scope="module")
def quiet() -> Flight:
    """Nothing hidden."""
    return fly(COPTER, COPTER, seed=4, name="quiet", waypoints=ROUND)


def ground_of(flight: Flight, *effects: str) -> Ground:
    """The flight against the model with some effects."""
    return Ground.of(model_of([flight], COPTER, [EFFECTS[e] for e in effects]))


def late(flight: Flight, columns: list[str], rows: int) -> Flight:
    """The flight with some columns later by so many rows of the table."""
    table = flight.table.copy()
    known = table[columns].notna()
    table[columns] = table[columns].ffill().shift(rows).bfill().where(known)
    return replace(flight, table=table)


def hypothesis(effects: tuple[str, ...], gains: list[float], raw: list[float]) -> Fitted:
    """With one number per effect and these gains and powers per channel."""
    values = {f"{e}.number": 1.0 for e in effects}
    return Fitted(effects, values, (), np.zeros((0, 0)), np.array([gains]), np.array(raw),
                  np.array(raw))  # fmt: skip


def test_a_larger_set_has_to_explain_more_than_a_law_may_be_off() -> None:
    one = hypothesis(("a",), [1e5, 0.0], [1.0, 1.0])
    finer = hypothesis(("a", "b"), [1.02e5, 0.0], [1.0, 1.0])
    elsewhere = hypothesis(("a", "c"), [1e5, 50.0], [1.0, 1.0])
    assert _needless(finer, [one, finer])  # 2,000 nats, but two percent of what one explains
    assert not _needless(elsewhere, [one, elsewhere])  # 50 nats in a channel of its own
    assert not _needless(one, [finer, elsewhere])


def test_an_effect_that_spoils_a_channel_is_told(quiet: Flight) -> None:
    ground = ground_of(quiet, "accel_bias")
    best = ground.fit(["accel_bias"])
    assert not _spoils(best, ground)
    assert _spoils(replace(best, raw=2.0 * ground.raw), ground)


def test_age_of_position_and_of_attitude_are_told_apart(quiet: Flight) -> None:
    """The table has 200 rows a second: ten rows are 50 ms."""
    place = [f"{stem}_{a}" for stem in ("pos", "vel") for a in "xyz"]
    fitted = ground_of(late(quiet, place, 10), "position_delay").fit(["position_delay"])
    assert fitted.values["position_delay.delay_s"] == pytest.approx(0.05, abs=0.006)
    assert fitted.values["position_delay.attitude_s"] == pytest.approx(0.0, abs=0.004)
    turned = late(quiet, [f"q_{a}" for a in "wxyz"], 10)
    fitted = ground_of(turned, "position_delay").fit(["position_delay"])
    assert fitted.values["position_delay.attitude_s"] == pytest.approx(0.05, abs=0.004)
    assert fitted.values["position_delay.delay_s"] == pytest.approx(0.0, abs=0.006)


def test_a_lag_is_seen_though_the_file_has_none() -> None:
    instant = replace(COPTER, rotors=replace(COPTER.rotors, lag_up_s=0.0, lag_down_s=0.0))
    flight = fly(instant, COPTER, seed=4, name="lagging", waypoints=ROUND)
    ground = Ground.of(model_of([flight], instant, [EFFECTS["motor_lag"]]))
    fitted = ground.fit(["motor_lag"])
    true = 0.5 * (COPTER.rotors.lag_up_s + COPTER.rotors.lag_down_s)
    assert fitted.values["motor_lag.tau_s"] == pytest.approx(true, rel=0.1)


def test_noise_of_the_pose_is_not_damped_by_a_scale(quiet: Flight) -> None:
    table, rng = quiet.table.copy(), np.random.default_rng(0)
    for a in "xyz":
        noise = pd.Series(0.03 * rng.standard_normal(len(table)), index=table.index)
        table[f"vel_{a}"] += noise
    ground = ground_of(replace(quiet, table=table), "accel_scale")
    fitted = ground.fit(["accel_scale"])
    spread = np.sqrt(np.diag(fitted.covariance))
    for n, s in zip(fitted.numbers, spread, strict=True):
        assert abs(fitted.values[n.full] - 1.0) < max(4.0 * s, 0.01), n.full


def test_nothing_hidden_is_nothing(quiet: Flight) -> None:
    naming = name_effects([quiet], COPTER)
    assert naming.verdict == "nothing"
    assert naming.best.effects == ()


def test_a_voltage_comes_from_the_flights_where_the_vehicle_has_none(quiet: Flight) -> None:
    (number,) = (n for n in numbers_of([EFFECTS["battery_sag"]], COPTER) if n.shape)
    flight = replace(quiet, table=quiet.table.assign(vbat_v=11.6))
    found = at_voltage(number, [flight], COPTER)
    assert found.now == pytest.approx(11.6)
    assert found.about.prior[0] < 11.0 < 12.0 < found.about.prior[1]
    battery = replace(COPTER, battery=CRAZYFLIE.battery)
    assert at_voltage(number, [flight], battery) is number
    dead = replace(quiet, table=quiet.table.assign(vbat_v=0.0))
    assert at_voltage(number, [dead], COPTER) is number


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("battery_sag", {"slope": 1.5, "reference_v": 11.6}),
        ("command_delay", {"delay_s": 0.02}),
    ],
)
def test_a_vehicle_with_an_effect_has_a_hover_trim(effect: str, values: dict[str, float]) -> None:
    plain, changed = (airframe(v) for v in (COPTER, COPTER.with_effects({effect: values})))
    assert changed.inputs[0].name == plain.inputs[0].name == "cmd_1"
    assert changed.inputs[0].start == pytest.approx(plain.inputs[0].start)


def test_a_moved_centre_of_mass_leaves_the_imu_where_it_is() -> None:
    """Turning at 3 rad/s about the vertical, 2 cm before the centre of mass: 0.18 m/s2."""
    shift = {"x_m": 0.02, "y_m": 0.0}
    body = airframe(COPTER.with_effects({"cog_offset": shift}))
    x = np.asarray(body.initial(body.input_values(), body.parameter_values())).ravel()
    x[[s.name for s in body.states].index("omega_z")] = 3.0
    y = np.asarray(body.outputs(x, body.input_values(), body.parameter_values())).ravel()
    felt = y[body.output_names.index("specific_force_x")]
    assert felt == pytest.approx(0.02 * 3.0**2, rel=1e-3)


def test_rows_one_by_one_and_all_at_once_are_the_same() -> None:
    body = airframe(COPTER)
    rng = np.random.default_rng(1)
    x = np.asarray(body.initial(body.input_values(), body.parameter_values())).ravel()
    xs = x + 0.01 * rng.standard_normal((5, len(x)))
    us = np.tile(body.input_values(), (5, 1))
    p = body.parameter_values()
    whole = OverRows(body.outputs, rows=2)(xs, us, p)
    for row, a, u in zip(whole, xs, us, strict=True):
        np.testing.assert_array_equal(row, np.asarray(body.outputs(a, u, p)).ravel())
    assert OverRows(body.outputs, rows=2)(xs[:0], us[:0], p).shape == (0, whole.shape[1])
