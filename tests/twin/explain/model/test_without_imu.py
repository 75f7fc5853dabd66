"""Flights without accelerometer or gyroscope: what the pose tells in their place, and what stays
unknown."""

import importlib.util
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from places import DATA, needs

from twin.effects import EFFECTS
from twin.explain.balance import trim_of
from twin.explain.explanation import explain
from twin.explain.holdout import hidden, localize
from twin.explain.model.model import Model, candidates, model_of
from twin.explain.model.numbers import lacking
from twin.frames import to_euler
from twin.logs import Flight, read_flight
from twin.logs.columns import ACC_NED, EULER, POS, QUAT, VEL
from twin.residuals.teacher_forced import drive_warnings
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import Waypoints, fly

COPTER = load_vehicle("copter_default")
LEGS: Waypoints = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 2.0, (0.0, 0.0, -1.5)),
    ("forward", 2.5, (4.0, 2.0, -2.0)),
    ("forward", 2.5, (0.0, 3.0, -2.5)),
    ("hover", 2.0, (0.0, 3.0, -2.5)),
)
OF_IMU = ("acc_", "gyro_")
MOTION = [f"motion_{kind}_{a}" for kind in ("acc", "rate") for a in "xyz"]


def without(flight: Flight, *stems: str) -> Flight:
    columns = [c for c in flight.table if c.startswith(stems)]
    return replace(flight, table=flight.table.drop(columns=columns))


def flown(plant: Vehicle) -> Flight:
    return fly(COPTER, plant, 1, waypoints=LEGS)


def bare(plant: Vehicle) -> Flight:
    """Commands and pose."""
    return without(flown(plant), *OF_IMU)


def solved(model: Model, effects: Sequence[str], stem: str) -> dict[str, float]:
    """Numbers by least squares on channels whose names begin so, each of equal weight."""
    columns = [i for i, n in enumerate(model.numbers) if n.effect in effects and not n.shape]
    rows = [c for f in model.channels(columns) for c in f if c.name.startswith(stem)]
    size = {c.name: float(np.std(c.residual)) for c in rows}
    slopes = np.concatenate([c.slopes / size[c.name] for c in rows])
    residual = np.concatenate([c.residual / size[c.name] for c in rows])
    found = np.linalg.lstsq(slopes, residual, rcond=None)[0]
    return {model.numbers[i].full: float(v) for i, v in zip(columns, found, strict=True)}


@pytest.fixture(scope="module")
def same() -> Flight:
    """Flown by what the model says."""
    return flown(COPTER)


def modelled(flight: Flight) -> Model:
    return model_of([flight], COPTER, candidates([flight]))


def names(model: Model) -> list[str]:
    return [c.name for c in model.channels([])[0]]


@pytest.mark.slow
def test_the_pose_stands_in_for_what_is_missing_and_for_nothing_else(same: Flight) -> None:
    assert not {*MOTION} & {*names(modelled(same))}
    assert names(modelled(without(same, *OF_IMU))) == MOTION
    no_acc = names(modelled(without(same, "acc_")))
    assert {*MOTION[:3]} < {*no_acc}
    assert not {*MOTION[3:]} & {*no_acc}
    no_gyro = names(modelled(without(same, "gyro_")))
    assert {*MOTION[3:]} < {*no_gyro}
    assert not {*MOTION[:3]} & {*no_gyro}


@pytest.mark.slow
def test_of_two_flights_one_without_an_imu_the_pose_is_compared_in_both(same: Flight) -> None:
    flights = [same, replace(without(same, *OF_IMU), name="other")]
    model = model_of(flights, COPTER, candidates(flights))
    assert names(model) == MOTION
    places = localize(model, {"rotor_drag.k_xy_1_s": 0.5}, dict.fromkeys(MOTION, 1e-3))
    assert places[0].channel in MOTION  # one flight alone has more


@pytest.mark.slow
def test_nothing_is_left_where_nothing_is_missing(same: Flight) -> None:
    """What is left is the noise of the pose, differentiated: no constant, little of the motion."""
    for channel in modelled(without(same, *OF_IMU)).channels([])[0]:
        size = 0.2 if "acc" in channel.name else 1.5
        assert np.sqrt(np.mean(channel.residual**2)) < size, channel.name
        assert abs(np.mean(channel.residual)) < 0.02 * size, channel.name


@pytest.mark.slow
@pytest.mark.parametrize("kept", ["velocity", "position", "acceleration"])
def test_weak_rotors_are_told_by_the_vertical_balance(kept: str) -> None:
    thrust = tuple(0.9 * c for c in COPTER.rotors.thrust_n)
    flight = bare(replace(COPTER, rotors=replace(COPTER.rotors, thrust_n=thrust)))
    if kept == "position":
        flight = without(flight, "vel_")
    if kept == "acceleration":
        flight = with_acceleration(flight)
    found = solved(modelled(flight), ["thrust_scale"], "motion_acc_z")
    assert 1 + found["thrust_scale.scale"] == pytest.approx(0.9, rel=0.02)


def with_acceleration(flight: Flight) -> Flight:
    """The same with its acceleration in place of position and velocity."""
    table = flight.table.copy()
    there = table["vel_x"].notna()
    velocity = table.loc[there, [*VEL]].to_numpy()
    moved = np.gradient(velocity, table.loc[there, "time"].to_numpy(), axis=0)
    for i, name in enumerate(ACC_NED):
        table.loc[there, name] = moved[:, i]
    return replace(flight, table=table.drop(columns=[*POS, *VEL]))


@pytest.mark.slow
def test_the_loss_of_one_rotor_is_told_by_all_balances() -> None:
    losses = {f"loss_{i}": 0.1 * (i == 2) for i in range(1, 5)}
    flight = bare(COPTER.with_effects({"rotor_efficiency_loss": losses}))
    found = solved(modelled(flight), ["rotor_efficiency_loss"], "motion_")
    for name, loss in losses.items():
        assert found[f"rotor_efficiency_loss.{name}"] == pytest.approx(loss, abs=0.01)


@pytest.mark.slow
def test_a_centre_of_mass_is_told_by_the_angular_acceleration() -> None:
    shift = COPTER.arm_m * np.array([0.05, 0.03, 0.0])
    rotors = replace(COPTER.rotors, position_m=COPTER.rotors.position_m - shift)
    found = solved(modelled(bare(replace(COPTER, rotors=rotors))), ["cog_offset"], "motion_rate")
    assert found["cog_offset.x_m"] == pytest.approx(shift[0], rel=0.05)
    assert found["cog_offset.y_m"] == pytest.approx(shift[1], rel=0.05)


@pytest.mark.slow
def test_an_old_pose_is_an_age_of_position_and_attitude(same: Flight) -> None:
    """A pose of two ages, predicted with these, leaves what the prompt one leaves."""
    place_s, turn_s = 0.1, 0.05
    prompt = without(same, *OF_IMU)
    old = replace(prompt, table=prompt.table.copy())
    for group, age_s in (([*POS, *VEL], place_s), ([*QUAT], turn_s)):
        old.table[group] = prompt.table[group].shift(round(age_s * 200))
    ages = {"position_delay.delay_s": place_s, "position_delay.attitude_s": turn_s}
    model = modelled(old)
    there = {c.name: c for c in modelled(prompt).channels([])[0]}
    wrong = {c.name: c for c in model.channels([])[0]}
    for channel in model.channels([], ages)[0]:
        size = np.std(there[channel.name].residual)
        assert np.std(channel.residual) < 1.15 * size, channel.name
    assert np.std(wrong["motion_acc_x"].residual) > 1.5 * np.std(there["motion_acc_x"].residual)
    columns = [i for i, n in enumerate(model.numbers) if n.effect == "position_delay"]
    step = 1e-3
    for i in columns:
        ahead = {**ages, model.numbers[i].full: ages[model.numbers[i].full] + step}
        for a, b in zip(model.channels([i], ages)[0], model.channels([i], ahead)[0], strict=True):
            slope = (a.residual - b.residual) / step
            off = np.sqrt(np.mean((slope - a.slopes[:, 0]) ** 2))
            assert off <= 0.15 * np.sqrt(np.mean(slope**2)) + 1e-9, (a.name, model.numbers[i].full)


@pytest.mark.slow
def test_a_pose_that_is_compared_is_held_out(same: Flight) -> None:
    flight = without(same, *OF_IMU)
    spans = [(4.0, 6.0)]
    fit, held = (hidden(flight, spans, inside) for inside in (True, False))
    for column in (*POS, *VEL, *QUAT):
        a, b, whole = (f.table[column].notna() for f in (fit, held, flight))
        assert not (a & b).any()
        assert ((a | b) == whole).all()
    assert fit.table["cmd_1"].equals(flight.table["cmd_1"])
    times = modelled(fit).channels([])[0][2].t_s
    assert len(times) and not np.any((times > 4.02) & (times < 6.0))


def test_effects_on_the_body_stay_visible_and_those_of_the_imu_do_not(same: Flight) -> None:
    flight = without(same, *OF_IMU)
    body = ("thrust_scale", "cog_offset", "rotor_efficiency_loss", "rotor_drag", "command_delay")
    assert all(lacking(EFFECTS[e], flight) == () for e in body)
    for of_imu in ("accel_bias", "gyro_bias", "imu_lever_arm", "imu_delay", "accel_scale"):
        assert lacking(EFFECTS[of_imu], flight)
    assert lacking(EFFECTS["slung_load"], flight) == ("acc",)  # followed by what is felt
    assert lacking(EFFECTS["gust"], flight) == ("acc",)


def test_without_an_attitude_the_balances_are_unknown(same: Flight) -> None:
    """Level flight is not assumed."""
    flight = without(same, *OF_IMU, "q_")
    assert lacking(EFFECTS["thrust_scale"], flight) == ("acc",)
    assert lacking(EFFECTS["cog_offset"], flight) == ("gyro",)
    assert not candidates([flight])


def test_a_velocity_is_told_from_the_position(same: Flight) -> None:
    assert lacking(EFFECTS["rotor_drag"], without(same, "vel_")) == ()
    assert lacking(EFFECTS["rotor_drag"], without(same, "vel_", "pos_")) == ("vel",)


@pytest.mark.slow
def test_the_drag_of_a_real_crazyflie_is_told_without_its_imu(data_dir: Path) -> None:
    """0.39 1/s is what this and other flights of it tell with the IMU."""
    flights = [without(f, *OF_IMU) for f in real(data_dir)]
    vehicle = load_vehicle("crazyflie")
    model = model_of(flights, vehicle, [EFFECTS["rotor_drag"], EFFECTS["thrust_tilt"]])
    found = solved(model, ["rotor_drag", "thrust_tilt"], "motion_acc")
    assert found["rotor_drag.k_xy_1_s"] == pytest.approx(0.39, rel=0.3)


def real(data_dir: Path) -> list[Flight]:
    """Two flights of NanoBench."""
    path = Path(__file__).parents[4] / "examples" / "nanobench_to_flight_table.py"
    spec = importlib.util.spec_from_file_location("nanobench_to_flight_table", path)
    assert spec is not None and spec.loader is not None
    converter = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(converter)
    sources = ("B2_circle_medium_rep2", "B3_figure8_medium_rep2")
    raw = [pd.read_parquet(data_dir / "nanobench" / f"{n}.parquet") for n in sources]
    return [converter.convert(r.astype(float), n) for r, n in zip(raw, sources, strict=True)]


@pytest.mark.slow
def test_flights_of_a_pose_alone_are_explained() -> None:
    """Weak rotors, told by the pose; what the IMU would show is not looked for."""
    thrust = tuple(0.85 * c for c in COPTER.rotors.thrust_n)
    flight = bare(replace(COPTER, rotors=replace(COPTER.rotors, thrust_n=thrust)))
    found = explain([flight], [], COPTER, missions=[])
    assert found.naming is not None and found.comparison is not None
    assert found.naming.probability_of("thrust_scale") > 0.5
    gaps = {g.name: g for g in found.comparison.gaps}
    assert set(gaps) == {*MOTION}
    assert gaps["motion_acc_z"].after < 0.5 * gaps["motion_acc_z"].before
    assert not {"accel_bias", "gyro_bias"} & {*found.naming.inclusion}


# -- angles that the log has not ----------------------------------------------------------------


def logged(folder: Path, flight: Flight, *missing: str) -> Flight:
    """As a table with Euler angles, but for some, and no IMU."""
    table = without(flight, *OF_IMU).table
    there = table["q_w"].notna()
    for k, name in enumerate(EULER):
        if name not in missing:
            table.loc[there, name] = to_euler(table.loc[there, [*QUAT]].to_numpy().T)[k]
    table.drop(columns=[*QUAT]).to_parquet(folder / "flight.parquet")
    return read_flight(folder / "flight.parquet")


LEFT = {
    ("pitch_rad",): ["acc_y", "acc_z", "rate_x", "rate_y", "rate_z"],
    ("roll_rad",): ["acc_x", "acc_z", "rate_x", "rate_y", "rate_z"],
    ("roll_rad", "pitch_rad"): ["acc_z", "rate_x", "rate_y", "rate_z"],
    ("yaw_rad",): ["acc_z", "rate_x", "rate_y"],
    ("pitch_rad", "yaw_rad"): ["acc_z", "rate_x"],
    EULER: ["acc_z"],
}
"""Axes that are compared without some angles."""


@pytest.mark.slow
@pytest.mark.parametrize("missing", LEFT)
def test_an_angle_that_is_missing_takes_its_axes_alone(
    missing: tuple[str, ...], same: Flight, tmp_path: Path
) -> None:
    model = modelled(logged(tmp_path, same, *missing))
    assert names(model) == [f"motion_{c}" for c in LEFT[missing]]
    for channel in model.channels([])[0]:
        size = 0.25 if "acc" in channel.name else 1.5
        assert abs(np.mean(channel.residual)) < 0.1 * size, channel.name


@pytest.mark.slow
def test_without_pitch_and_motion_the_moments_are_told(same: Flight, tmp_path: Path) -> None:
    flight = logged(tmp_path, without(same, "pos_", "vel_"), "pitch_rad")
    (said,) = [t for t in drive_warnings(flight, COPTER) if "attitude" in t]
    assert "not told without it: force along x" in said
    model = modelled(flight)
    assert names(model) == ["motion_rate_x", "motion_rate_y", "motion_rate_z"]
    assert trim_of(model, slopes=False) is not None
    for channel in model.channels([])[0]:
        assert abs(np.mean(channel.residual)) < 0.2, channel.name


@pytest.mark.slow
def test_without_pitch_a_weak_rotor_is_told_by_the_means(tmp_path: Path) -> None:
    losses = {f"loss_{i}": 0.1 * (i == 2) for i in range(1, 5)}
    flight = flown(COPTER.with_effects({"rotor_efficiency_loss": losses}))
    model = modelled(logged(tmp_path, flight, "pitch_rad"))
    found = solved(model, ["rotor_efficiency_loss"], "motion_")
    for name, loss in losses.items():
        assert found[f"rotor_efficiency_loss.{name}"] == pytest.approx(loss, abs=0.02)


CRAZYPAD = DATA / "crazypad"


@needs(CRAZYPAD.is_dir(), "no crazypad: set UAVTWIN_DATA")
@pytest.mark.slow
@pytest.mark.parametrize("name", ["flight_002", "flight_054"])
def test_recorded_flights_without_pitch_have_the_balance_of_those_whose_pitch_was_made_up(
    name: str,
) -> None:
    """Of the same flights somebody else rebuilt the pitch by the same law; the means are one."""
    vehicle = load_vehicle(CRAZYPAD / "crazyflie21_with_decks.toml")
    means = []
    for folder in ("tables", "tables_pitch_rebuilt"):
        flight = read_flight(CRAZYPAD / folder / f"{name}.parquet")
        found = trim_of(model_of([flight], vehicle, candidates([flight])), slopes=False)
        assert found is not None
        means.append(found.means[0])
    plain, rebuilt = means
    assert np.abs(rebuilt).max() > 1.0
    assert plain == pytest.approx(rebuilt, rel=0.03, abs=0.3)
