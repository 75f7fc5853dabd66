"""Residual flights: the channels of the gap, silence without an effect, samples held, gaps cut."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from learning.data.channels import CHANNELS, GROUPS, PHASE_CODES, UNKNOWN_PHASE
from learning.data.flights import ResidualFlight, held, residual_flight, restart_before_s
from twin.errors import LogError, ModelError
from twin.flight import closed_loop
from twin.flight.lqr import controller
from twin.logs import Flight
from twin.physics.airframe import airframe
from twin.physics.sensors.imu import imu
from twin.physics.sensors.magnetometer import magnetometer
from twin.residuals.flight_gap import flight_gap
from twin.residuals.teacher_forced import sensor_readings
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import fly

Array = np.ndarray
FEISI = load_vehicle("feisi_x150")
COPTER = load_vehicle("copter_default")
WAYPOINTS = (
    ("ground", 1.0, (0.0, 0.0, 0.0)),
    ("takeoff", 2.0, (0.0, 0.0, -1.5)),
    ("forward", 2.5, (4.0, 2.0, -2.0)),
    ("hover", 0.6, (4.0, 2.0, -2.0)),
)


def cut(flight: Flight, start_s: float, end_s: float) -> Flight:
    time = flight.table["time"]
    table = flight.table[(time >= start_s) & (time < end_s)].reset_index(drop=True)
    return replace(flight, table=table)


def without(flight: Flight, *columns: str) -> Flight:
    return replace(flight, table=flight.table.drop(columns=list(columns)))


def rms(flight: ResidualFlight, group: str) -> float:
    columns = GROUPS[group]
    return float(np.sqrt(np.mean(flight.residual[:, columns][flight.fresh[:, columns]] ** 2)))


@pytest.fixture(scope="module")
def noisy() -> Flight:
    """A stretch in the air; IMU at 200 Hz, pose at 100 Hz, no magnetometer."""
    return cut(fly(FEISI, FEISI, seed=0, waypoints=WAYPOINTS), 3.0, 5.5)


@pytest.fixture(scope="module")
def noisy_residual(noisy: Flight) -> ResidualFlight:
    return residual_flight(noisy, FEISI)


def clean_flight(vehicle: Vehicle, seconds: float, slow: int = 100) -> Flight:
    """A sideways move flown by the twin itself, recorded every ms without noise.

    Magnetometer every `slow` ms. The first half second, in which the rotors settle, is left out.
    """
    body, sensor, compass = airframe(vehicle, "command"), imu(vehicle), magnetometer(vehicle)
    n = round(seconds / closed_loop.STEP_S)
    t = np.arange(n) * closed_loop.STEP_S
    setpoints = np.zeros((n, 11))
    setpoints[:, 2], setpoints[:, 10] = -10.0, 1.0
    s = np.clip((t - 1.0) / 1.5, 0.0, 1.0)
    setpoints[:, 1] = 10 * s**3 - 15 * s**4 + 6 * s**5
    states, inputs = closed_loop.fly(body, controller(vehicle), setpoints)
    truth = dict(zip(body.output_names, body.outputs_along(states, inputs).T, strict=True))
    table = pd.DataFrame({"time": t})
    for name, u in zip(body.input_names, inputs.T, strict=True):
        if name.startswith("cmd_"):
            table[name] = u
    for part in (sensor, compass):
        sensed = np.stack([truth[name] for name in part.input_names], axis=-1)
        for name, values in zip(part.output_names, sensor_readings(part, sensed).T, strict=True):
            table[name] = values
    for name in [*CHANNELS[GROUPS["pos"]], *CHANNELS[GROUPS["vel"]], *(f"q_{a}" for a in "wxyz")]:
        table[name] = truth[name]
    table.loc[np.arange(n) % slow != 0, list(CHANNELS[GROUPS["mag"]])] = np.nan
    table["phase"] = "hover"
    return cut(Flight("clean", table), 0.5, seconds)


@pytest.fixture(scope="module")
def clean() -> ResidualFlight:
    return residual_flight(clean_flight(COPTER, 3.0), COPTER)


# -- against the gap ------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("case", ["plain", "filtered", "late"])
def test_channels_are_those_of_the_gap(noisy: Flight, case: str) -> None:
    """To rounding: the same equations and windows, placed differently.

    But for the accelerometer, which the gap compares every 5 ms in the band of the body: before
    its low-pass, and where the sensor has none of its own, the two predict the same.
    """
    late = {
        "imu_delay": {"delay_s": 0.012},
        "gyro_bias": dict.fromkeys(("x_rad_s", "y_rad_s"), 0.1),
    }
    late["gyro_bias"]["z_rad_s"] = 0.0
    vehicle = {
        "plain": FEISI,
        "filtered": replace(FEISI, accel_cutoff_hz=40.0, gyro_cutoff_hz=30.0),
        "late": FEISI.with_effects(late),
    }[case]
    gap = flight_gap(noisy, vehicle)
    ours = residual_flight(noisy, vehicle)
    compared = set()
    for channel in (c.wide for c in gap.channels if c.name in CHANNELS):
        near = 0.2 if channel.name.startswith("acc") and case != "plain" else 1e-9
        i = CHANNELS.index(channel.name)
        row = np.searchsorted(ours.t_s, channel.t_s - 1e-9)
        on_grid = (row < len(ours.t_s)) & np.isfinite(
            ours.virtual[np.minimum(row, len(ours.t_s) - 1), i]
        )
        on_grid &= np.abs(ours.t_s[np.minimum(row, len(ours.t_s) - 1)] - channel.t_s) < 1e-9
        row = row[on_grid]
        assert len(row) >= 4
        scale = np.max(np.abs(channel.simulated)) + 1.0
        np.testing.assert_allclose(
            ours.virtual[row, i], channel.simulated[on_grid], atol=near * scale
        )
        if not channel.name.startswith("gyro"):  # there the gap filters what is measured
            np.testing.assert_allclose(
                ours.residual[row, i], channel.residual[on_grid], atol=near * scale
            )
        compared.add(channel.name)
    assert compared == set(CHANNELS) - {"mag_x", "mag_y", "mag_z"}


@pytest.mark.slow
def test_windows_at_once_do_not_change_the_numbers(
    noisy: Flight, noisy_residual: ResidualFlight, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twin.residuals.short_horizon.WINDOWS_AT_ONCE", 17)
    done: list[float] = []
    again = residual_flight(noisy, FEISI, progress=done.append)
    np.testing.assert_array_equal(again.virtual, noisy_residual.virtual)
    assert done == sorted(done) and done[-1] == 1.0 and len(done) > 5


# -- nothing hidden -------------------------------------------------------------------------


@pytest.mark.slow
def test_flight_of_the_twin_itself_leaves_nothing(clean: ResidualFlight) -> None:
    """What remains: the low-pass of the body rates from which windows start."""
    assert clean.fresh[:, GROUPS["gyro"]].any()
    assert np.nanstd(clean.virtual[:, CHANNELS.index("vel_y")]) > 0.2
    for group, bound in (
        ("gyro", 1e-5),
        ("acc", 1e-5),
        ("mag", 1e-12),
        ("pos", 1e-4),
        ("vel", 2e-4),
    ):
        assert rms(clean, group) < bound, group


# -- samples --------------------------------------------------------------------------------


def test_slow_samples_are_held_and_counted_once(clean: ResidualFlight) -> None:
    mag = GROUPS["mag"]
    rows = np.flatnonzero(clean.fresh[:, mag].all(axis=1))
    inside = np.concatenate([np.arange(a, b) for a, b in clean.spans])
    tenths = np.round(clean.t_s[inside] * 100) % 10 == 0
    np.testing.assert_array_equal(rows, inside[tenths])
    seen = clean.residual[rows[0] :, mag]
    changes = rows[0] + 1 + np.flatnonzero((np.diff(seen, axis=0) != 0).any(axis=1))
    assert set(changes) <= set(rows)
    assert np.isnan(clean.residual[: rows[0], mag]).all()
    assert np.isfinite(clean.residual[rows[0] :, mag]).all()


@pytest.mark.slow
def test_a_sample_between_instants_is_compared_at_its_own_time(noisy: Flight) -> None:
    """A position that grows by 3 m/s, sampled 4 ms before the instants: not 12 mm of residual.

    The restart is 4 ms nearer as well, and the unreal drag takes 3 mm less.
    """
    table = noisy.table.copy()
    shift = 3.0 * table["time"].to_numpy()
    table["pos_x"] += shift
    table["vel_x"] += 3.0
    late = table.assign(time=table["time"] + 0.006)
    x = CHANNELS.index("pos_x")
    at_instants, between = (
        flight.residual[flight.fresh[:, x], x].mean()
        for flight in (residual_flight(replace(noisy, table=t), FEISI) for t in (table, late))
    )
    assert abs(between - at_instants) < 5e-3


@pytest.mark.slow
def test_a_reading_that_comes_later_changes_nothing_before(
    noisy: Flight, noisy_residual: ResidualFlight
) -> None:
    before, table = noisy_residual, noisy.table.copy()
    time = table["time"].to_numpy()
    table.loc[time > 4.5, ["acc_x", "acc_y", "acc_z"]] += 5.0
    after = residual_flight(replace(noisy, table=table), FEISI)
    early = before.t_s <= 4.5
    np.testing.assert_array_equal(before.residual[early], after.residual[early])
    np.testing.assert_array_equal(before.virtual, after.virtual)
    assert not np.array_equal(before.residual[~early], after.residual[~early], equal_nan=True)


@pytest.mark.slow
@given(st.lists(st.tuples(*[st.one_of(st.none(), st.floats(-9, 9))] * 2), min_size=1, max_size=30))
def test_held_is_the_last_one_known(rows: list[tuple[float | None, ...]]) -> None:
    values = np.array(rows, dtype=np.float64)
    expected = pd.DataFrame(values).ffill().to_numpy()
    np.testing.assert_array_equal(held(values), expected)


# -- what a flight lacks --------------------------------------------------------------------


def test_missing_sensor_is_not_a_number_and_said(noisy_residual: ResidualFlight) -> None:
    mag = GROUPS["mag"]
    assert np.isnan(noisy_residual.residual[:, mag]).all()
    assert not noisy_residual.fresh[:, mag].any()
    assert any("mag_*" in note for note in noisy_residual.notes)
    assert np.isfinite(noisy_residual.virtual[slice(*noisy_residual.spans[0])]).all()


def test_without_attitude_the_accelerometer_is_left(noisy: Flight) -> None:
    flight = residual_flight(without(noisy, *(f"q_{a}" for a in "wxyz")), FEISI)
    assert {c for i, c in enumerate(CHANNELS) if flight.fresh[:, i].any()} == {
        "acc_x",
        "acc_y",
        "acc_z",
    }
    assert any("attitude" in note for note in flight.notes)


@pytest.mark.slow
def test_a_gap_ends_a_span(noisy: Flight) -> None:
    table = noisy.table.copy()
    hole = (table["time"] > 4.0) & (table["time"] < 4.4)
    table.loc[hole, [f"q_{a}" for a in "wxyz"]] = np.nan
    flight = residual_flight(replace(noisy, table=table), FEISI)
    (a, b), (c, d) = flight.spans
    assert flight.t_s[b - 1] <= 4.0 + 1e-6
    assert flight.t_s[c] >= 4.9 - 1e-6
    assert not flight.fresh[b:c].any()
    assert flight.fresh[a:b].any() and flight.fresh[c:d].any()


@pytest.mark.slow
def test_ground_is_no_span_and_phases_have_codes() -> None:
    whole = fly(FEISI, FEISI, seed=1, waypoints=WAYPOINTS)
    whole.table.loc[whole.table["time"] > 5.8, "phase"] = ""
    flight = residual_flight(whole, FEISI)
    ((a, b),) = flight.spans
    flown = {PHASE_CODES[p] for p in ("takeoff", "forward", "hover")}
    assert set(flight.phase[a:b]) == {*flown, UNKNOWN_PHASE}
    assert np.all(flight.phase[: round(0.9 * flight.rate_hz)] == PHASE_CODES["ground"])
    assert flight.t_s[a] > 1.5
    assert not flight.fresh[:a].any()
    assert flight.commands.shape == (len(flight.t_s), 4)


# -- how long before a reading the twin was at the measured state ---------------------------


@pytest.mark.slow
def test_a_twin_that_follows_is_where_it_is_put(noisy: Flight) -> None:
    follows, later = residual_flight(noisy, FEISI, restart_s=0.0), residual_flight(noisy, FEISI)
    for group in ("acc", "mag"):
        columns, rows = GROUPS[group], np.isfinite(later.virtual[:, 0])
        np.testing.assert_array_equal(
            follows.virtual[rows, columns], later.virtual[rows, columns], group
        )
    assert follows.fresh[:, GROUPS["gyro"]].any()
    for group in ("pos", "vel"):
        assert not follows.fresh[:, GROUPS[group]].any()
        assert np.isfinite(follows.virtual[slice(*follows.spans[0]), GROUPS[group]]).all()


@pytest.mark.slow
def test_a_twin_that_was_just_restarted_nearly_follows(noisy: Flight) -> None:
    """The shortest time there is, at which the start of the window is among what is kept."""
    follows, soon = (residual_flight(noisy, FEISI, restart_s=s) for s in (0.0, 0.01))
    rows = slice(max(f.spans[0][0] for f in (follows, soon)) + 1, soon.spans[0][1])
    speed = GROUPS["vel"]
    off = soon.virtual[rows, speed] - follows.virtual[rows, speed]
    assert np.abs(off).max() < 0.2
    gyro = GROUPS["gyro"]
    fresh = soon.fresh[rows, gyro] & follows.fresh[rows, gyro]
    off = (soon.residual - follows.residual)[rows, gyro][fresh]
    assert len(off) > 100 and np.abs(off).max() < 0.5


@pytest.mark.parametrize(
    ("protocol", "horizon", "before_s"),
    [("free", 0, 0.0), ("track", 1, 0.01), ("track", 50, 0.5), ("reconstruct", 0, 0.5)],
)
def test_the_protocol_says_how_long(protocol: str, horizon: int, before_s: float) -> None:
    assert restart_before_s(protocol, horizon, 100.0) == before_s  # type: ignore[arg-type]


# -- what is refused ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rate_hz", "before_s", "says"),
    [
        (30.0, 0.5, "rate 30 Hz"),
        (0.0, 0.5, "rate 0 Hz"),
        (100.0, 0.0055, "restart 0.0055 s"),
        (100.0, 0.005, "at least one interval"),
        (100.0, float("nan"), "restart nan"),
        (100.0, -0.5, "restart -0.5 s"),
    ],
)
def test_rates_and_times_that_are_refused(
    noisy: Flight, rate_hz: float, before_s: float, says: str
) -> None:
    with pytest.raises(ModelError, match=says):
        residual_flight(noisy, FEISI, rate_hz, before_s)


def test_flight_without_a_sample_to_compare_is_refused(noisy: Flight) -> None:
    short = cut(noisy, 3.0, 3.4)
    with pytest.raises(LogError, match="no sample to compare"):
        residual_flight(without(short, "acc_x", "acc_y", "acc_z"), FEISI)
