"""What is of a record and not of an aircraft: clocks that are apart, a pose that is smoothed or of
another point."""

from collections.abc import Iterable, Sequence
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from rig import fitted, rows_of
from scipy.ndimage import gaussian_filter1d

from twin.effects import EFFECTS
from twin.explain.inference.priors import priors_of
from twin.explain.inference.selection import name_effects
from twin.explain.model.model import Model, candidates, model_of
from twin.explain.model.numbers import with_effects
from twin.flight.manoeuvres import Manoeuvre, plan, rehearse
from twin.logs import Flight
from twin.logs.columns import GYRO, POS, QUAT, VEL
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import WAYPOINTS, fly

VEHICLE = load_vehicle("copter_default")
CLOCKS = {
    "pose_s": ("pos", "vel"),
    "attitude_s": ("q",),
    "accelerometer_s": ("acc",),
    "command_s": ("cmd",),
}


@cache
def recorded() -> Flight:
    return fly(VEHICLE, VEHICLE, 3, waypoints=WAYPOINTS[:5])


def shifted(stems: Iterable[str], later_s: float) -> Flight:
    """The flight with signals that are that much older than their time stamps say."""
    table = recorded().table.copy()
    time = table["time"].to_numpy()
    for column in table:
        if str(column).rpartition("_")[0] in stems:
            known = table[column].notna().to_numpy()
            values = table.loc[known, column].to_numpy()
            table.loc[known, column] = np.interp(time[known] - later_s, time[known], values)
    return Flight("shifted", table)


def seen(flight: Flight, *effects: str) -> Model:
    return model_of([flight], VEHICLE, [EFFECTS[e] for e in effects])


@pytest.mark.slow
@pytest.mark.parametrize("later_s", [-0.04, 0.04])
@pytest.mark.parametrize("number", CLOCKS)
def test_a_clock_that_is_apart_is_found_with_its_sign(number: str, later_s: float) -> None:
    """Against the same record with the clocks as they are, which are apart by what is held."""
    name = f"clock_offset.{number}"
    before, after = (
        fitted(seen(flight, "clock_offset"), [name])[name]
        for flight in (recorded(), shifted(CLOCKS[number], later_s))
    )
    assert before == pytest.approx(0.0, abs=0.006)
    assert after - before == pytest.approx(later_s, abs=0.004)


@pytest.mark.slow
def test_a_gyroscope_that_is_old_makes_all_others_young() -> None:
    names = [f"clock_offset.{n}" for n in CLOCKS]
    before, after = (
        fitted(seen(flight, "clock_offset"), names)
        for flight in (recorded(), shifted(("gyro",), 0.02))
    )
    for name in names:
        assert after[name] - before[name] == pytest.approx(-0.02, abs=0.004), name


@pytest.mark.slow
@pytest.mark.parametrize("age_s", [0.003, 0.005])
def test_an_age_of_the_gyroscope_alone_is_nothing(age_s: float) -> None:
    """All signals are younger than it, though none is early."""
    assert name_effects([shifted(("gyro",), age_s)], VEHICLE).verdict == "nothing"


@pytest.mark.slow
def test_clocks_move_what_the_delays_of_the_aircraft_move() -> None:
    """A command that acts late was shown when it was young; all others are old in both."""
    model = seen(recorded(), "clock_offset", "imu_delay", "position_delay", "command_delay")
    names = [n.full for n in model.numbers]

    def slopes(*numbers: str) -> NDArray[np.float64]:
        columns = [names.index(n) for n in numbers]
        flights = model.channels(columns)
        return np.asarray(rows_of(flights, ["acc", "pose_acc"])[1].sum(axis=1))

    delays = {
        "imu_delay.delay_s": ("accelerometer_s",),
        "position_delay.delay_s": ("pose_s",),
        "position_delay.attitude_s": ("attitude_s",),
    }
    for delay, clocks in delays.items():
        own = slopes(*(f"clock_offset.{c}" for c in clocks))
        np.testing.assert_allclose(own, slopes(delay), rtol=1e-9, atol=1e-9)
    for sign, name in ((1, "command_delay.delay_s"), (-1, "clock_offset.command_s")):
        late = {name: sign * 0.02}
        residuals = rows_of(model.channels([], late))[0]
        np.testing.assert_allclose(
            residuals, rows_of(model.channels([], {"command_delay.delay_s": 0.02}))[0]
        )


@pytest.mark.slow
@pytest.mark.parametrize("age", ["delay_s", "attitude_s"])
def test_the_answer_to_an_age_is_that_of_the_force_that_was_found(age: str) -> None:
    """How it changes in time is told by the numbers in question, not by a file with half of it."""
    weak = VEHICLE.with_effects({"thrust_scale": {"scale": 0.5}})
    model = model_of([recorded()], weak, [EFFECTS[e] for e in ("position_delay", "thrust_scale")])
    name, step, found = f"position_delay.{age}", 0.002, {"thrust_scale.scale": 1.0}
    column = [n.full for n in model.numbers].index(name)
    here, slopes = rows_of(model.channels([column], found), ["pose_acc"])
    ahead, _ = rows_of(model.channels([], {**found, name: step}), ["pose_acc"])
    moved, slope = (here - ahead) / step, slopes[:, 0]  # the former with the noise of the pose
    assert moved @ slope / (slope @ slope) == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_an_age_is_a_delay_and_what_its_clock_adds_on_a_day() -> None:
    b = priors_of(seen(recorded(), "position_delay", "clock_offset"))
    found = {b.names[i]: {b.names[k] for k in own} for i, own in b.ages.items()}
    of_pose = {"clock_offset.pose_s", "position_delay.delay_s"}
    of_attitude = {"clock_offset.attitude_s", "position_delay.attitude_s"}
    assert found == {"clock_offset.pose_s": of_pose, "clock_offset.attitude_s": of_attitude}


@pytest.mark.slow
def test_a_signal_that_is_not_there_has_no_clock() -> None:
    flight = recorded()
    bare = Flight("bare", flight.table.drop(columns=[*QUAT, *VEL, *POS]))
    assert "clock_offset" in {e.name for e in candidates([bare])}
    assert "pose_smoothing" not in {e.name for e in candidates([bare])}
    model = seen(bare, "clock_offset")
    assert {n.name for n in model.numbers} == {"accelerometer_s", "command_s"}
    assert "rotor_s" not in {n.name for n in seen(flight, "clock_offset").numbers}
    (rows, _) = rows_of(model.channels(range(len(model.numbers)), {"clock_offset.command_s": 0.01}))
    assert np.all(np.isfinite(rows))


@pytest.mark.parametrize("effect", ["clock_offset", "pose_smoothing", "pose_lever_arm"])
def test_what_is_of_a_record_is_not_written_to_a_vehicle(effect: str) -> None:
    values = {f"{effect}.{p.name}": p.start for p in EFFECTS[effect].of_logs}
    values |= {"mass_offset.mass_kg": 0.1}
    found = with_effects(VEHICLE, [effect, "mass_offset"], values)
    assert found.effects == {"mass_offset": {"mass_kg": 0.1}}
    assert not EFFECTS[effect].of_vehicle


@pytest.mark.slow
def test_a_position_of_another_point_is_told_from_the_place_of_the_imu() -> None:
    """Pose and accelerometer tell the difference, thrust and accelerometer the place of the IMU."""
    numbers = {"x_m": 0.04, "y_m": -0.03, "z_m": 0.05}
    imu = {"x_m": 0.03, "y_m": 0.02, "z_m": -0.02}
    plant = VEHICLE.with_effects({"imu_lever_arm": imu, "pose_lever_arm": numbers})
    flight = flown(plant)
    model = seen(flight, "imu_lever_arm", "pose_lever_arm")
    truth = {f"imu_lever_arm.{k}": v for k, v in imu.items()}
    truth |= {f"pose_lever_arm.{k}": v for k, v in numbers.items()}
    found = fitted(model, list(truth))
    assert found == pytest.approx(truth, abs=0.004)


def flown(plant: Vehicle) -> Flight:
    """To and fro, recorded without noise."""
    moves = plan(VEHICLE, [Manoeuvre("shaken", "", 10.0, shaking)])
    return rehearse(moves, VEHICLE, plant, [recorded()])


@cache
def shaken(**numbers: float) -> Flight:
    """With the pose averaged: it is smooth, not what flies."""
    return flown(VEHICLE.with_effects({"pose_smoothing": numbers}))


def averaged(flight: Flight, width_s: float) -> Flight:
    """With an attitude that a Gaussian kernel averaged, and with noise on it and the gyroscope."""
    table, rng = flight.table.copy(), np.random.default_rng(1)
    for column in QUAT:
        known = table[column].notna().to_numpy()
        period = float(np.median(np.diff(table["time"].to_numpy()[known])))
        values = table.loc[known, column].to_numpy()
        if width_s:
            values = gaussian_filter1d(values, width_s / period)
        table.loc[known, column] = values + 5e-4 * rng.standard_normal(len(values))
    for column in GYRO:
        table[column] += 0.005 * rng.standard_normal(len(table))
    return Flight("averaged", table)


@pytest.mark.slow
@pytest.mark.parametrize("width_s", [0.02, 0.03])
def test_the_width_of_an_average_is_found(width_s: float) -> None:
    """Beside the little that noise of the gyroscope feigns."""
    name = "pose_smoothing.attitude_s2"
    before, after = (
        fitted(seen(averaged(shaken(), w), "pose_smoothing"), [name], ["pose_gyro"])[name]
        for w in (0.0, width_s)
    )
    assert before < 2.5e-5
    assert after - before == pytest.approx(width_s**2, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(("share", "rel"), [(0.25, 0.05), (1.0, 0.2)])
def test_averages_of_attitude_and_velocity_are_told_apart(share: float, rel: float) -> None:
    """The laws are of second order: what they lack shrinks with the averages."""
    names = ["pose_smoothing.attitude_s2", "pose_smoothing.position_s2"]
    true = 4e-4 * share, 9e-4 * share
    flight = shaken(attitude_s2=true[0], position_s2=true[1])
    found = fitted(seen(flight, "pose_smoothing"), names, ["pose"])
    assert [found[n] for n in names] == pytest.approx(true, rel=rel)


@pytest.mark.slow
def test_a_wide_average_of_a_position_is_found() -> None:
    """Of 45 ms: by the second derivative, 7 % less."""
    name = "pose_smoothing.position_s2"
    found = fitted(seen(shaken(position_s2=2e-3), "pose_smoothing"), [name], ["pose"])[name]
    assert found == pytest.approx(2e-3, rel=0.03)


def thinned(flight: Flight, columns: Sequence[str], every: int) -> Flight:
    """With fewer samples of some columns."""
    table = flight.table.copy()
    known = np.flatnonzero(table[columns[0]].notna())
    table.loc[np.setdiff1d(known, known[::every]), list(columns)] = np.nan
    return Flight("thinned", table)


@pytest.mark.slow
@pytest.mark.parametrize(("attitude", "velocity"), [(1, 1), (5, 1), (2, 10), (5, 10)])
def test_few_samples_are_no_average(attitude: int, velocity: int) -> None:
    """Of 100 a second every fifth, as PX4 logs an attitude, and every tenth."""
    names = ["pose_smoothing.attitude_s2", "pose_smoothing.position_s2"]
    flight = thinned(thinned(shaken(), QUAT, attitude), (*VEL, *POS), velocity)
    found = fitted(seen(flight, "pose_smoothing"), names, ["pose"])
    assert found[names[0]] < 1e-5
    assert found[names[1]] < 1e-5


@pytest.mark.slow
def test_a_velocity_that_is_known_later_than_the_attitude_leaves_no_hole() -> None:
    """Samples of an attitude before the velocity count for nothing, and no slope is unknown."""
    flight = thinned(thinned(recorded(), QUAT, 7), (*VEL, *POS), 10)
    flight.table.loc[flight.table["time"] < 4.02, [*VEL, *POS]] = np.nan
    model = seen(flight, "imu_lever_arm", "gyro_scale", "accel_scale")
    (channels,) = model.channels(range(len(model.numbers)), {"imu_lever_arm.x_m": 0.02})
    posed = [c for c in channels if c.name.startswith("pose_")]
    assert len(posed) == 6
    for channel in posed:
        assert np.all(np.isfinite(channel.residual)) and np.all(np.isfinite(channel.slopes))
        assert channel.t_s[0] > 4.0


def shaking(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """To and fro, about once per second."""
    ramp, w = np.sin(np.pi * np.clip(t / 10.0, 0, 1)) ** 2, 2 * np.pi * t
    x, y, z = (a * np.sin(f * w) for a, f in ((0.6, 0.7), (0.5, 0.9), (0.3, 0.6)))
    return np.column_stack([ramp * x, ramp * y, ramp * z, ramp * 0.3 * np.sin(0.5 * w)])
