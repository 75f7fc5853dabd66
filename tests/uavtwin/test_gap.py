"""The gap: batch equals co-simulation, silence without a hidden effect, and planted effects."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmu_gap import open_fmus, start_values, window_ends_of_fmus

from cosim.master import Master
from twin.errors import LogError
from twin.frames import to_body
from twin.logs import Flight, StoredFlight, open_flight, write_flight
from twin.residuals.aligned import AlignedFlight, align_flight
from twin.residuals.channels import BAND_HZ, low_pass, rate_over_step
from twin.residuals.flight_gap import end_channels, flight_gap
from twin.residuals.gap import Channel, FlightGap
from twin.residuals.short_horizon import READ, whole_windows, window_ends
from twin.residuals.teacher_forced import GRID_S, predicted_readings, sensor_readings
from twin.vehicle import GRAVITY_M_S2, Vehicle
from twin.vehicle_file import load_vehicle
from twin.why.flight import FlightFrame
from uavtwin.demo.flights import (
    ACC_NOISE_M_S2,
    ATT_NOISE,
    GYRO_NOISE_RAD_S,
    POS_NOISE_M,
    VEL_NOISE_M_S,
    fly,
)
from uavtwin.file_check import check_flight
from uavtwin.gaps import gap, unfit

Array = np.ndarray
FEISI = load_vehicle("feisi_x150")
MOTION = {
    "pose": [f"{s}_{a}" for s in ("pos", "vel") for a in "xyz"] + [f"q_{a}" for a in "wxyz"],
    "gyro": [f"gyro_{a}" for a in "xyz"],
    "acc": [f"acc_{a}" for a in "xyz"],
}


def without(flight: Flight, *columns: str) -> Flight:
    return replace(flight, table=flight.table.drop(columns=list(columns)))


def cut(flight: Flight, start_s: float, end_s: float) -> Flight:
    time = flight.table["time"]
    return replace(
        flight, table=flight.table[(time >= start_s) & (time < end_s)].reset_index(drop=True)
    )


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


LEFT_OF_ACC = ACC_NOISE_M_S2 * rms(
    low_pass(np.random.default_rng(0).standard_normal(20_000), BAND_HZ)
)
"""Noise of the accelerometer within the band of the channels."""


def channels(gap: FlightGap) -> dict[str, Channel]:
    return {c.name if c.horizon_s == 0 else f"{c.name}@": c for c in gap.channels}


@pytest.fixture(scope="module")
def quiet() -> Flight:
    """Nothing hidden."""
    return fly(FEISI, FEISI, seed=0, name="quiet")


@pytest.fixture(scope="module")
def quiet_gap(quiet: Flight) -> dict[str, Channel]:
    return channels(flight_gap(quiet, FEISI))


# -- batch, Python and FMU agree ----------------------------------------------------------


@pytest.fixture(scope="module", params=["copter_default", "crazyflie"])
def system(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[AlignedFlight, Master]]:
    """A flight and its twin, as batch and as FMUs."""
    vehicle = load_vehicle(request.param)
    vehicle = replace(vehicle, imu_position_m=np.array([0.02, -0.01, 0.005]))
    flight = fly(vehicle, vehicle, seed=2)
    twin = align_flight(flight, vehicle)
    with open_fmus(flight, twin, tmp_path_factory.mktemp("fmus")) as master:
        yield twin, master


@pytest.mark.slow
def test_teacher_forced_batch_is_what_the_fmus_say_at_a_restart(
    system: tuple[AlignedFlight, Master],
) -> None:
    twin, master = system
    readings, names = predicted_readings(twin.airframe, twin.imu, twin.states, twin.inputs.u)
    known = np.flatnonzero(twin.airborne & np.all(np.isfinite(twin.states), axis=1))
    for k in known[:: len(known) // 23]:
        begin = float(twin.inputs.t_s[k])
        master.initialize(begin, start_values(twin, int(k)))
        row = master.run(begin, GRID_S, "settled")
        for i, name in enumerate(names):
            slave = "imu" if name in twin.imu.output_names else "airframe"
            scale = np.max(np.abs(readings[known, i]))
            assert abs(row[f"{slave}.{name}"][0] - readings[k, i]) <= 1e-12 * scale, (name, k)


@pytest.mark.slow
def test_short_horizon_of_the_fmus_is_that_of_the_equations(
    system: tuple[AlignedFlight, Master],
) -> None:
    twin, master = system
    p = twin.airframe.parameter_values({"ground.enabled": 0.0})
    names = [s.name for s in twin.airframe.states]
    steps = 300
    for k in (5000, 9003, 17000):
        begin = float(twin.inputs.t_s[k])
        master.initialize(begin, start_values(twin, k))
        recording = master.run(begin + steps * GRID_S, GRID_S, "settled")
        x = twin.states[k]
        for j in range(steps):
            x = twin.airframe.advance(x, twin.inputs.u[k + j], p, GRID_S)
        outputs = [n for n in names if f"airframe.{n}" in recording.names]
        assert len(outputs) >= 13
        for name in outputs:
            simulated = recording[f"airframe.{name}"][-1]
            exact = x[names.index(name)]
            assert simulated == pytest.approx(exact, rel=1e-9, abs=1e-9), name
        # Rotor states of the batch are those that the airframe integrates from the same inputs.
        for i, name in enumerate(names):
            if name.startswith(("rotor_", "effort_")):
                assert twin.states[k + steps, i] == pytest.approx(x[i], rel=1e-9), name


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("feisi_x150", {}),
        ("copter_default", {"accel_cutoff_hz": 40.0, "gyro_cutoff_hz": 30.0}),
    ],
)
def test_windows_in_a_batch_end_where_the_fmus_do(
    name: str, changes: dict[str, Any], tmp_path: Path
) -> None:
    """All windows of a flight, 500 steps each; numpy's sine differs from that of C in the last bit.

    Found: 3e-16 of the largest value.
    """
    vehicle = replace(load_vehicle(name), **changes)
    flight = cut(fly(vehicle, vehicle, seed=3), 1.0, 14.0)
    twin, steps = align_flight(flight, vehicle), 500
    starts = whole_windows(twin, steps)
    assert len(starts) > 20
    batch = window_ends(twin, starts, steps, tail=0)[:, 0]
    fmus = window_ends_of_fmus(flight, twin, starts.tolist(), steps, tmp_path)
    worst = np.abs(batch - fmus).max(axis=0) / np.abs(fmus).max(axis=0)
    assert worst.max() < 1e-13, dict(zip(READ, worst.tolist(), strict=True))
    ours = [c for c in flight_gap(flight, vehicle).channels if c.horizon_s > 0]
    for got, want in zip(ours, end_channels(twin, starts + steps, fmus, 0.5), strict=True):
        assert (got.name, got.unit, got.horizon_s) == (want.name, want.unit, want.horizon_s)
        np.testing.assert_array_equal(got.t_s, want.t_s)
        np.testing.assert_array_equal(got.phase, want.phase)
        np.testing.assert_array_equal(got.measured, want.measured)
        np.testing.assert_allclose(got.simulated, want.simulated, rtol=1e-12, atol=1e-13)


@pytest.mark.slow
def test_channels_of_the_gap_are_the_python_twin(
    quiet: Flight, quiet_gap: dict[str, Channel]
) -> None:
    """The same numbers once more through the public entry: windows end where they should."""
    twin = align_flight(quiet, FEISI)
    p = twin.airframe.parameter_values({"ground.enabled": 0.0})
    names = [s.name for s in twin.airframe.states]
    for row in (0, 17, 40):
        end = round(float(quiet_gap["vel_x@"].t_s[row]) / GRID_S)
        k = end - 500
        x = twin.states[k]
        for j in range(500):
            x = twin.airframe.advance(x, twin.inputs.u[k + j], p, GRID_S)
        for name in ("pos_x", "pos_z", "vel_x", "vel_y"):
            simulated = quiet_gap[f"{name}@"].simulated[row]
            assert simulated == pytest.approx(x[names.index(name)], rel=1e-9, abs=1e-9)
            measured = twin.states[end, names.index(name)]
            assert quiet_gap[f"{name}@"].measured[row] == measured


@pytest.mark.slow
def test_low_pass_of_the_imu_bridges_what_is_unknown() -> None:
    vehicle = replace(FEISI, accel_cutoff_hz=20.0)
    twin_imu = align_flight(fly(vehicle, vehicle, seed=0), vehicle).imu
    sensed = np.tile([0, 0, -9.8, 0, 0, 0, 0, 0, 0.0], (400, 1))
    sensed[:10] = np.nan
    sensed[100:150, 4] = np.nan
    readings = sensor_readings(twin_imu, sensed)
    unknown = np.isnan(readings).any(axis=1)
    np.testing.assert_array_equal(np.flatnonzero(unknown), [*range(10), *range(100, 150)])
    np.testing.assert_allclose(readings[~unknown, 2], -9.8, rtol=1e-12)
    assert np.isnan(sensor_readings(twin_imu, sensed * np.nan)).all()


# -- nothing hidden -----------------------------------------------------------------------


@pytest.mark.slow
def test_nothing_hidden_leaves_the_noise_of_the_sensors(quiet_gap: dict[str, Channel]) -> None:
    """White before the low-pass; after it, what a low-pass leaves of white noise."""
    white = np.random.default_rng(0).standard_normal((20_000, 1))
    rates = GYRO_NOISE_RAD_S * rate_over_step(white)
    for axis in "xyz":
        channel, rate = quiet_gap[f"acc_{axis}"], quiet_gap[f"gyro_rate_{axis}"]
        assert rms(channel.residual) == pytest.approx(LEFT_OF_ACC, rel=0.08)
        assert rms(rate.residual) == pytest.approx(rms(low_pass(rates, BAND_HZ)), rel=0.08)
        residual = channel.wide.residual
        assert rms(residual) == pytest.approx(ACC_NOISE_M_S2, rel=0.05)
        assert abs(residual.mean()) < 4 * ACC_NOISE_M_S2 / np.sqrt(len(residual))
        correlated = np.corrcoef(residual[1:], residual[:-1])[0, 1]
        assert abs(correlated) < 4 / np.sqrt(len(residual))
        assert rms(rate.wide.residual) == pytest.approx(rms(rates), rel=0.05)


def test_nothing_hidden_leaves_the_noise_of_the_restarts(quiet_gap: dict[str, Channel]) -> None:
    """Measured start and end are noisy; interpolation between samples takes up to half of it.

    The table holds commands for 5 ms that changed every ms: a little more than noise.
    """
    horizon = 0.5
    tilt = 2 * ATT_NOISE
    bounds = {
        "pos": np.hypot(np.sqrt(2) * POS_NOISE_M, VEL_NOISE_M_S * horizon),
        "vel": np.hypot(np.sqrt(2) * VEL_NOISE_M_S, GRAVITY_M_S2 * tilt * horizon),
        "att": np.hypot(np.sqrt(2) * tilt, GYRO_NOISE_RAD_S * horizon),
        "gyro": np.sqrt(2) * GYRO_NOISE_RAD_S,
    }
    for group, bound in bounds.items():
        for axis in "xyz":
            channel = quiet_gap[f"{group}_{axis}@"]
            assert len(channel.t_s) > 40
            assert 0.3 * bound < rms(channel.residual) < 1.2 * bound, channel.name


# -- planted effects ----------------------------------------------------------------------


TEACHER_FORCED_ONLY = 60.0
"""A horizon longer than the flight: no windows, no co-simulation."""


def gap_of(plant: Vehicle, horizon_s: float = TEACHER_FORCED_ONLY) -> dict[str, Channel]:
    return channels(flight_gap(fly(FEISI, plant, seed=0), FEISI, horizon_s))


def in_hover(channel: Channel, start_s: float = 6.0, end_s: float = 8.0) -> Array:
    return np.asarray(channel.residual[(channel.t_s > start_s) & (channel.t_s < end_s)])


@pytest.mark.slow
def test_extra_mass_shows_in_acc_z_alone(quiet_gap: dict[str, Channel]) -> None:
    """Hover: measured -g, simulated -g (1 + s)."""
    found = gap_of(replace(FEISI, mass_kg=1.1 * FEISI.mass_kg), horizon_s=0.5)
    assert in_hover(found["acc_z"]).mean() == pytest.approx(0.1 * GRAVITY_M_S2, rel=0.02)
    assert in_hover(found["acc_x"]).mean() == pytest.approx(0.0, abs=0.02)
    for axis in "xyz":
        quiet_rms = rms(quiet_gap[f"gyro_rate_{axis}"].residual)
        assert rms(found[f"gyro_rate_{axis}"].residual) < 1.05 * quiet_rms
    # Over the horizon it integrates against the drag of the model.
    rate = FEISI.drag_linear_n_s_m[2] / FEISI.mass_kg
    fall = 0.1 * GRAVITY_M_S2 * -np.expm1(-rate * 0.5) / rate
    assert in_hover(found["vel_z@"]).mean() == pytest.approx(fall, rel=0.03)


@pytest.mark.slow
def test_missing_thrust_shows_in_acc_z_with_its_size() -> None:
    """Hover: measured -g, simulated -g / (1 - s)."""
    rotors = replace(FEISI.rotors, thrust_n=tuple(0.9 * c for c in FEISI.rotors.thrust_n))
    found = gap_of(replace(FEISI, rotors=rotors))
    expected = GRAVITY_M_S2 * (1 / 0.9 - 1)
    assert in_hover(found["acc_z"]).mean() == pytest.approx(expected, rel=0.02)


@pytest.mark.slow
def test_extra_drag_shows_along_the_velocity() -> None:
    """Residual of the specific force against body velocity: slope -k, in x and y, not in z."""
    k = 0.5
    drag = FEISI.drag_linear_n_s_m + k * FEISI.mass_kg * np.array([1.0, 1.0, 0.0])
    plant = replace(FEISI, drag_linear_n_s_m=drag)
    flight = fly(FEISI, plant, seed=0)
    found = channels(flight_gap(flight, FEISI, TEACHER_FORCED_ONLY))
    t_vel, vel = flight.signal(["vel_x", "vel_y", "vel_z"])
    _, q = flight.signal([f"q_{a}" for a in "wxyz"])
    body = np.stack(to_body(list(q.T), list(vel.T)), axis=-1)
    for i, axis in enumerate("xyz"):
        channel = found[f"acc_{axis}"]
        speed = np.interp(channel.t_s, t_vel, body[:, i])
        slope = float(speed @ channel.residual / (speed @ speed))
        assert slope == pytest.approx(-k if axis != "z" else 0.0, abs=0.03), axis


@pytest.mark.slow
def test_extra_inertia_scales_the_angular_acceleration() -> None:
    found = gap_of(replace(FEISI, inertia_kg_m2=1.4 * FEISI.inertia_kg_m2))
    for axis in "xy":
        channel = found[f"gyro_rate_{axis}"]
        slope = channel.simulated @ channel.measured / (channel.simulated @ channel.simulated)
        assert slope == pytest.approx(1 / 1.4, rel=0.03)
    assert rms(found["acc_z"].residual) == pytest.approx(LEFT_OF_ACC, rel=0.08)


@pytest.mark.slow
def test_shifted_centre_of_mass_shows_as_constant_moments() -> None:
    """The twin sees uneven thrust and predicts a moment that is not there."""
    shift = np.array([0.003, -0.002, 0.0])
    rotors = replace(FEISI.rotors, position_m=FEISI.rotors.position_m - shift)
    found = gap_of(replace(FEISI, rotors=rotors))
    weight = FEISI.mass_kg * GRAVITY_M_S2
    roll = shift[1] * weight / FEISI.inertia_kg_m2[0, 0]
    pitch = -shift[0] * weight / FEISI.inertia_kg_m2[1, 1]
    assert in_hover(found["gyro_rate_x"]).mean() == pytest.approx(roll, rel=0.03)
    assert in_hover(found["gyro_rate_y"]).mean() == pytest.approx(pitch, rel=0.03)
    assert in_hover(found["acc_z"]).mean() == pytest.approx(0.0, abs=0.02)


# -- flights that lack something ----------------------------------------------------------


@pytest.fixture(scope="module")
def short(quiet: Flight) -> Flight:
    """Take-off to hover: enough for every channel."""
    return cut(quiet, 0.0, 7.0)


def kinds(gap: FlightGap) -> set[str]:
    return {name.rpartition("_")[0] + ("@" if "@" in name else "") for name in channels(gap)}


EVERYTHING = {"acc", "gyro_rate", "pos@", "vel@", "att@", "gyro@"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("dropped", "left", "note"),
    [
        ([], EVERYTHING, "on the ground are left out"),
        (["pose"], {"acc", "gyro_rate"}, "no attitude, no velocity: channels that need them"),
        (["gyro"], EVERYTHING - {"gyro_rate"}, "body rates derived from attitude"),
        (["acc"], EVERYTHING - {"acc"}, ""),
        (["pose", "acc"], {"gyro_rate"}, "no short-horizon residuals"),
        (["pose", "gyro"], {"acc"}, "no attitude, no velocity, no body rates"),
        (["acc", "gyro"], EVERYTHING - {"acc", "gyro_rate"}, "body rates derived from attitude"),
    ],
    ids=lambda v: "-".join(v) if isinstance(v, list) else None,
)
def test_what_is_missing_leaves_the_channels_possible(
    short: Flight, dropped: list[str], left: set[str], note: str
) -> None:
    gap = flight_gap(without(short, *[c for d in dropped for c in MOTION[d]]), FEISI)
    assert kinds(gap) == left
    assert note in " / ".join(gap.warnings)
    for channel in gap.channels:
        assert len(channel.t_s) > 5
        assert np.isfinite(channel.residual).all()


@pytest.mark.slow
def test_velocity_is_derived_from_position(short: Flight) -> None:
    gap = flight_gap(without(short, "vel_x", "vel_y", "vel_z"), FEISI)
    assert kinds(gap) == EVERYTHING
    assert any("velocity derived from position" in w for w in gap.warnings)
    assert rms(channels(gap)["acc_x"].residual) < 1.3 * LEFT_OF_ACC
    assert rms(channels(gap)["vel_x@"].residual) < 0.05


def test_a_column_without_samples_counts_as_missing(short: Flight) -> None:
    table = short.table.copy()
    table["q_w"] = np.nan
    gap = flight_gap(replace(short, table=table), FEISI)
    assert kinds(gap) == {"acc", "gyro_rate"}


@pytest.mark.slow
def test_measured_rotor_speeds_replace_the_commands() -> None:
    vehicle = load_vehicle("copter_default")
    flight = cut(fly(vehicle, vehicle, seed=0), 0.0, 7.0)
    twin = align_flight(flight, vehicle)
    rows = np.round(flight.table["time"].to_numpy() / GRID_S).astype(int)
    table = flight.table.copy()
    table[[f"rotor_{i}" for i in range(1, 5)]] = twin.inputs.rotor_states[rows]
    measured = replace(flight, table=table)
    for one in (measured, without(measured, *[f"cmd_{i}" for i in range(1, 5)])):
        gap = flight_gap(one, vehicle)
        assert kinds(gap) == EVERYTHING
        assert rms(channels(gap)["acc_z"].residual) == pytest.approx(LEFT_OF_ACC, rel=0.15)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda f: without(f, "cmd_4"), r"quiet: no samples of cmd_4, which drive the 4 rotors"),
        (lambda f: without(f, *[f"cmd_{i}" for i in range(1, 5)]), r"no samples of cmd_1, cmd_2"),
        (
            lambda f: replace(f, table=f.table.assign(cmd_5=0.5)),
            r"more motor commands than the 4 rotors of feisi_x150",
        ),
        (lambda f: replace(f, table=f.table.assign(rotor_5=500.0)), r"more rotor speeds than the"),
        (lambda f: without(f, *[c for g in MOTION.values() for c in g]), r"no motion signal.*cmd"),
        (lambda f: cut(f, 0.0, 0.004), r"quiet: too short: 1 samples"),
        (lambda f: cut(f, 0.0, 0.9), r"quiet: never airborne"),
        (lambda f: replace(f, table=f.table.assign(phase="ground")), r"never airborne"),
    ],
)
def test_what_cannot_be_compared_is_said(short: Flight, change: object, expected: str) -> None:
    with pytest.raises(LogError, match=expected):
        flight_gap(change(short), FEISI)  # type: ignore[operator]


@pytest.mark.parametrize("seconds", [0.02, 0.2, 0.45, 0.6, 1.4, 1.6, 3.0])
@pytest.mark.parametrize("lacks", [(), ("acc_x", "gyro_x"), ("q_w",)])
def test_check_and_gap_ask_one_rule(short: Flight, seconds: float, lacks: tuple[str, ...]) -> None:
    """What is good for something is compared; what is refused by its length is good for nothing."""
    flight = without(cut(short, 2.0, 2.0 + seconds), *lacks)
    report = check_flight(flight, "quiet")
    good = [use for use in report.good_for if use.startswith("gap")]
    why = [p for p in report.problems if p.startswith("good for nothing")]
    assert bool(good) != bool(why)
    if good:
        assert flight_gap(flight, FEISI).channels
    else:
        with pytest.raises(LogError, match=re.escape(why[0].partition("yet: ")[2])):
            flight_gap(flight, FEISI)


@pytest.mark.parametrize("horizon", [0.0, 0.005, 0.0123, -1.0, float("nan"), float("inf")])
def test_horizon_must_be_whole_milliseconds(short: Flight, horizon: float) -> None:
    with pytest.raises(LogError, match="multiple of 1 ms"):
        flight_gap(short, FEISI, horizon)


def test_a_horizon_longer_than_the_flight_leaves_the_other_channels(short: Flight) -> None:
    gap = flight_gap(short, FEISI, 20.0)
    assert kinds(gap) == {"acc", "gyro_rate"}
    assert any("no stretch of 20 s" in w for w in gap.warnings)


@pytest.mark.slow
@pytest.mark.parametrize("end_s", [1.6, 2.2, 2.5, 2.515])
def test_a_flight_cut_anywhere_gives_finite_channels_or_one_error(
    quiet: Flight, end_s: float
) -> None:
    try:
        gap = flight_gap(cut(quiet, 1.0, end_s), FEISI)
    except LogError as error:
        assert "quiet: never airborne" in str(error)
        return
    assert all(np.isfinite(c.residual).all() for c in gap.channels)


@pytest.mark.slow
def test_a_gap_in_the_pose_is_left_out_not_bridged(quiet: Flight) -> None:
    """A second without pose in mid-flight: no prediction there, no window across."""
    table = quiet.table.copy()
    blind = table["time"].between(9.0, 10.0)
    table.loc[blind, MOTION["pose"]] = np.nan
    found = channels(flight_gap(replace(quiet, table=table), FEISI))
    inside = (found["acc_x"].t_s > 9.02) & (found["acc_x"].t_s < 9.98)
    assert not inside.any()
    ends = found["pos_x@"].t_s
    assert not np.any((ends > 9.02) & (ends < 10.45))
    assert rms(found["acc_x"].residual) == pytest.approx(LEFT_OF_ACC, rel=0.08)
    assert rms(found["pos_x@"].residual) < 0.01


@pytest.mark.slow
def test_progress_runs_from_nothing_to_all(short: Flight) -> None:
    shares: list[float] = []
    flight_gap(short, FEISI, progress=shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def flipped(flight: Flight, columns: Sequence[str]) -> Flight:
    return replace(flight, table=flight.table.assign(**{c: -flight.table[c] for c in columns}))


@pytest.mark.slow
def test_a_conjugated_quaternion_is_noticed(quiet: Flight) -> None:
    """Attitude that turns the other way round than the gyroscope: said, not passed over."""
    told = flight_gap(flipped(quiet, ("q_x", "q_y", "q_z")), FEISI).warnings
    assert any("do not turn together" in w for w in told)
    assert not any("turn together" in w for w in flight_gap(quiet, FEISI).warnings)


@pytest.mark.slow
def test_altitude_instead_of_down_is_named() -> None:
    flight = fly(FEISI, FEISI, seed=1)
    with pytest.raises(LogError, match="is it an altitude"):
        flight_gap(flipped(flight, ("pos_z", "vel_z")), FEISI)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("factor", "doubted"), [(0.4, True), (0.75, True), (0.9, False), (1.1, False), (2.2, True)]
)
def test_a_vehicle_of_another_size_is_told(short: Flight, factor: float, doubted: bool) -> None:
    """Beyond what a battery between empty and full explains."""
    table = short.table.assign(acc_z=factor * short.table["acc_z"])
    told = gap(replace(short, table=table), FEISI, horizon_s=20.0).claim
    assert told.startswith("feisi_x150 does not fit this aircraft") == doubted
    assert (f"it carries {100 / factor:.0f} % of its weight" in told) == doubted


@pytest.mark.parametrize("factor", [0.0, -1.0, 1 / GRAVITY_M_S2, 1e-9, 1e3])
def test_a_wrong_accelerometer_is_told_not_a_wrong_vehicle(short: Flight, factor: float) -> None:
    """None at all, sign, g, a tiny unit and mm/s²."""
    table = short.table.assign(acc_z=factor * short.table["acc_z"])
    found = gap(replace(short, table=table), FEISI, horizon_s=20.0)
    assert found.claim.startswith("The accelerometer is probably wrong, not feisi_x150: acc_z has")
    assert found.record.flights[0].hover is None


@pytest.mark.parametrize(
    ("factors", "says"),
    [
        ((1.0, 1.0, 0.75), "1 of 3 flights, 2: feisi_x150 does not fit this flight"),
        ((0.75, 0.75, 1.0), "2 of 3 flights, 0 and 1: feisi_x150 does not fit this aircraft"),
        ((1.0, -1.0, 0.75), "1 of 3 flights, 1: The accelerometer is probably wrong"),
        ((0.7,) * 5, "5 of 5 flights, 0, 1, 2 and 2 more: feisi_x150 does not fit this aircraft"),
    ],
)
def test_of_several_flights_those_that_do_not_fit_are_named(
    factors: tuple[float, ...], says: str
) -> None:
    t_s, phase = np.arange(0.0, 5.0, 0.02), np.full(250, "hover")
    simulated = np.full(250, -GRAVITY_M_S2)
    gaps = [
        FlightGap(
            flight=str(i),
            vehicle="feisi_x150",
            channels=(Channel("acc_z", "m/s^2", 0.0, t_s, k * simulated, simulated, phase),),
            phases=(),
            warnings=(),
            facts={},
        )
        for i, k in enumerate(factors)
    ]
    assert unfit(gaps).startswith(says)
    assert ("It fits the 2 others" in unfit(gaps)) == (factors.count(1.0) == 2)
    assert unfit(gaps[:1]).startswith("feisi_x150 does not" if factors[0] != 1.0 else "")


@pytest.mark.parametrize("lost_s", [6.0, 3.0, None])
def test_a_flight_that_crashes_is_compared_until_control_is_lost(
    short: Flight, monkeypatch: pytest.MonkeyPatch, lost_s: float | None
) -> None:
    """With less than five seconds before it, all of it is compared."""
    monkeypatch.setattr(FlightFrame, "crash_begins_s", lost_s)
    found = gap(short, FEISI)
    parts = [w for w in found.record.warnings if w.startswith("compared until")]
    assert len(parts) == (lost_s == 6.0)
    assert (found.record.flights[0].phases[-1].end_s < 6.1) == (lost_s == 6.0)


def test_a_flight_that_stays_in_its_file_is_said_to_crash(
    short: Flight, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twin.logs.table.HELD_CELLS", 0)
    monkeypatch.setattr(FlightFrame, "crash_begins_s", 6.0)
    write_flight(short, tmp_path / "long.parquet")
    stored = open_flight(tmp_path / "long.parquet")
    assert isinstance(stored, StoredFlight)
    found = gap(stored, FEISI).record
    assert any("compared to its end" in w and "6.00 s" in w for w in found.warnings)
    assert found.flights[0].phases[-1].end_s > 6.1
