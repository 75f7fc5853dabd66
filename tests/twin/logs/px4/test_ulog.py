"""PX4 logs: small written ones, and the recorded flights."""

import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from fuzzing.ulog import layout
from numpy.typing import ArrayLike
from sample_logs import foreign, ulog

from twin.errors import LogError, TwinError
from twin.logs import Flight, read_flight
from twin.logs.columns import motor_columns
from twin.logs.motors import MotorOutput
from twin.logs.px4.log import Topic
from twin.logs.px4.outputs import Outputs
from twin.logs.px4.rebuild import Match, compare
from twin.logs.stamps import monotonic

REAL = ("real_1", "real_2", "real_3")
SIMULATED = ("sim_1", "sim_2", "sim_3")
Fields = dict[str, ArrayLike]


@functools.cache
def recorded(data_dir: Path, name: str) -> Flight:
    """A recorded flight, read once."""
    return read_flight(data_dir / "rflysimdt" / f"{name}.ulg")


def saved(folder: Path, blob: bytes) -> Flight:
    """Bytes as a file, read."""
    path = folder / "log.ulg"
    path.write_bytes(blob)
    return read_flight(path)


def modern() -> dict[str, Fields]:
    """Topics of a PX4 1.14 log: 2 s of hover with full-rate commands."""
    t = 0.004 + 0.004 * np.arange(500)
    zero, f4 = np.zeros((500, 3)), np.float32
    control = np.full((500, 12), np.nan, dtype=f4)
    control[:, :4] = 0.4 + 0.01 * np.sin(20 * t)[:, None]
    return {
        "sensor_combined": {
            "t": t,
            "gyro_rad": zero.astype(f4),
            "gyro_integral_dt": np.full(500, 4000, dtype=np.uint32),
            "accelerometer_timestamp_relative": np.zeros(500, dtype=np.int32),
            "accelerometer_m_s2": (zero - np.array((0, 0, 9.8))).astype(f4),
            "accelerometer_integral_dt": np.full(500, 4000, dtype=np.uint32),
        },
        "actuator_motors": {"t": t, "control": control},
        "vehicle_attitude": {"t": t, "q": np.tile(np.array([1, 0, 0, 0], dtype=f4), (500, 1))},
        "vehicle_magnetometer": {"t": t, "magnetometer_ga": np.full((500, 3), 0.3, dtype=f4)},
        "vehicle_local_position": {
            "t": t,
            **{k: np.zeros(500, dtype=f4) for k in ("x", "y", "z", "vx", "vy", "vz")},
        },
    }


def test_a_modern_log_needs_no_rebuilding(tmp_path: Path) -> None:
    flight = saved(tmp_path, ulog(modern(), {"CA_ROTOR_COUNT": 4}))
    t, cmd = flight.signal(motor_columns("cmd", 4))
    np.testing.assert_allclose(cmd[:, 0], 0.4 + 0.01 * np.sin(20 * t), atol=1e-6)
    assert "cmd_5" not in flight.table
    assert flight.facts["commands"] == "actuator_motors, 250 Hz"
    assert flight.facts["firmware"] == "PX4 1.14.0"
    assert flight.signal(["mag_x"])[1][0, 0] == pytest.approx(3e-5)
    t_acc, acc = flight.signal(["acc_z", "gyro_x"])
    assert acc[0, 0] == pytest.approx(-9.8)
    assert t_acc[0] == pytest.approx(0.002, abs=1e-9)  # middle of the first window
    assert t_acc[0] > 0.0


@pytest.mark.parametrize("gone", list(modern()))
def test_a_missing_topic_is_said_not_raised(tmp_path: Path, gone: str) -> None:
    flight = saved(tmp_path, ulog({k: v for k, v in modern().items() if k != gone}))
    assert len(flight.table) >= 500
    if gone != "vehicle_magnetometer":
        assert any(f.severity == "warning" for f in flight.findings)


def damaged(topic: str, **fields: ArrayLike) -> Mapping[str, Fields]:
    """The modern log with fields of one topic replaced."""
    topics = modern()
    topics[topic] = {**topics[topic], **fields}
    return topics


def counted(flight: Flight, where: str, text: str) -> int:
    """Count of the finding at `where` whose message contains `text`."""
    return sum(f.count for f in flight.findings if f.where == where and text in f.message)


def test_bad_samples_are_left_out_and_counted(tmp_path: Path) -> None:
    q = np.tile(np.array([1, 0, 0, 0], dtype=np.float32), (500, 1))
    q[5:15] = 0.0
    q[20] = np.nan
    q[30:33, 0] = 1.01
    flight = saved(tmp_path, ulog(damaged("vehicle_attitude", q=q)))
    assert counted(flight, "q", "far from unit norm") == 11
    assert counted(flight, "q", "normalised") == 3
    quaternions = flight.signal(["q_w", "q_x", "q_y", "q_z"])[1]
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1.0, atol=1e-6)
    assert len(quaternions) == 489

    q[:] = 0.0
    assert not saved(tmp_path, ulog(damaged("vehicle_attitude", q=q))).has("q_w")

    gyro = np.zeros((500, 3), dtype=np.float32)
    gyro[7, 1], gyro[9, 2] = np.nan, 1e30
    flight = saved(tmp_path, ulog(damaged("sensor_combined", gyro_rad=gyro)))
    assert counted(flight, "gyro", "NaN") == 1
    assert counted(flight, "gyro", "beyond") == 1


@pytest.mark.parametrize(
    ("counts", "steps"),
    [
        ((3, 4), 1),
        ((3, 4, 4, 6), 2),
        ((255, 0), 1),
        ((254, 1), 1),
        ((4, 3), 0),
        ((200, 0), 0),
        ((2, 77, 2), 0),
        ((0, 0), 0),
    ],
    ids=["step", "steps", "wraps", "wraps by 3", "back", "restart", "damaged byte", "none"],
)
def test_counters_of_resets_count_small_steps_forward(
    tmp_path: Path, counts: tuple[int, ...], steps: int
) -> None:
    """Each count for 100 samples of 4 ms, the last one to the end."""
    each = np.array(counts, dtype=np.uint8)[np.minimum(np.arange(500) // 100, len(counts) - 1)]
    flight = saved(tmp_path, ulog(damaged("vehicle_local_position", vxy_reset_counter=each)))
    assert flight.autopilot is not None
    resets = flight.autopilot.resets
    assert len(resets) == steps and {r.of for r in resets} <= {"velocity"}
    if counts == (3, 4):
        assert resets[0].t_s == pytest.approx(0.4, abs=0.01)


def test_backward_and_repeated_times_are_dropped_and_counted(tmp_path: Path) -> None:
    blob = ulog(modern())
    mark = b"".join([(1_000_000 + 4000 * k).to_bytes(8, "little") for k in (100,)])
    late = (1_000_000 + 4000 * 90).to_bytes(8, "little")  # repeats and runs backward
    flight = saved(tmp_path, blob.replace(mark, late))
    for topic in ("sensor_combined", "actuator_motors", "vehicle_attitude"):
        assert counted(flight, topic, "dropped") == 1
    assert np.all(np.diff(flight.table["time"]) > 0)


@pytest.mark.parametrize(
    ("t", "kept"),
    [
        ([1, 2, 3], (3, 0, 0, 0)),
        ([1, 2, 2, 3], (3, 0, 1, 0)),
        ([1, 5, 2, 3, 4], (4, 1, 0, 0)),
        ([*range(200), 10**15], (200, 0, 0, 1)),
        ([7], (1, 0, 0, 0)),
    ],
)
def test_as_few_samples_as_possible_are_dropped(t: list[int], kept: tuple[int, ...]) -> None:
    keep, *counts = monotonic(np.array(t, dtype=np.int64))
    assert (int(keep.sum()), *counts) == kept
    assert np.all(np.diff(np.array(t)[keep]) > 0)


def test_log_without_samples(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="cut short within its definitions"):
        saved(tmp_path, ulog({}))
    with pytest.raises(LogError, match="without any sample"):
        saved(tmp_path, ulog({"cpuload": {"t": np.ones(3), "load": np.ones(3, dtype=np.float32)}}))
    only = {"vehicle_magnetometer": modern()["vehicle_magnetometer"]}
    with pytest.raises(LogError, match="no sample of acceleration"):
        saved(tmp_path, ulog(only))


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_rebuilt_commands_match_the_logged_outputs(data_dir: Path, name: str) -> None:
    """Within 10 us rms of pulse width for each motor while flying (850 us is full range)."""
    flight = recorded(data_dir, name)
    told = flight.facts["commands_match"]
    rms = [float(x) for x in told.split(" us")[0].removeprefix("rms ").split(", ")]
    n = int(told.split("n = ")[1].split()[0])
    assert len(rms) == 4
    assert max(rms) < 6.0, told
    assert n > 150
    t, cmd = flight.signal(motor_columns("cmd", 4))
    assert len(t) / (t[-1] - t[0]) == pytest.approx(666, abs=2)
    assert 0.0 <= cmd.min() <= cmd.max() <= 1.0


@pytest.mark.slow
@pytest.mark.parametrize("name", SIMULATED)
def test_rebuilt_commands_of_the_simulated_flights(data_dir: Path, name: str) -> None:
    told = recorded(data_dir, name).facts["commands_match"]
    rms = [float(x) for x in told.split(" us")[0].removeprefix("rms ").split(", ")]
    assert max(rms) < 6.0, told


def test_match_is_measured_against_the_logged_samples(data_dir: Path) -> None:
    """The same figure, computed here from two readings of the log."""
    path = data_dir / "rflysimdt" / "real_3.ulg"
    t, logged = read_flight(path, rebuild_commands=False).signal(motor_columns("cmd", 4))
    t_full, rebuilt = recorded(data_dir, "real_3").signal(motor_columns("cmd", 4))
    hover = (t > 10.0) & (t < 28.0)
    at = np.column_stack([np.interp(t[hover], t_full, rebuilt[:, k]) for k in range(4)])
    rms_us = 850.0 * np.sqrt(np.mean((logged[hover] - at) ** 2, axis=0))
    assert np.all(rms_us < 6.0), rms_us
    assert np.all(850.0 * logged[hover].std(axis=0) > 30.0)  # what holding the mean would miss


@pytest.mark.parametrize(
    ("name", "hover_s"), [("real_1", 10.0), ("real_2", 20.0), ("real_3", 20.0), ("sim_1", 20.0)]
)
def test_phases_follow_the_markers(data_dir: Path, name: str, hover_s: float) -> None:
    """Times of the data's README: takeoff 5 s, hover, land 5 s."""
    table = recorded(data_dir, name).table
    phase, t = table["phase"].to_numpy(), table["time"].to_numpy()
    begin = {p: t[phase == p].min() for p in ("takeoff", "hover", "land")}
    assert begin["hover"] - begin["takeoff"] == pytest.approx(5.0, abs=0.05)
    assert begin["land"] - begin["hover"] == pytest.approx(hover_s, abs=0.05)
    assert t[phase == "land"].max() - begin["land"] == pytest.approx(5.0, abs=0.05)
    assert set(phase) == {"ground", "takeoff", "hover", "land"}


@pytest.mark.parametrize("name", [*REAL, "sim_1"])
def test_units_and_frames(data_dir: Path, name: str) -> None:
    flight = recorded(data_dir, name)
    table = flight.table
    hover = table[table["phase"] == "hover"]
    assert hover["acc_z"].mean() == pytest.approx(-9.8, abs=0.15)
    norm = np.linalg.norm(table[["q_w", "q_x", "q_y", "q_z"]].dropna(), axis=1)
    np.testing.assert_allclose(norm, 1.0, atol=1e-6)
    field = np.linalg.norm(hover[["mag_x", "mag_y", "mag_z"]].dropna(), axis=1)
    assert 2e-5 < field.mean() < 1.5e-4
    assert 9.5e4 < table["baro_pa"].median() < 1.05e5
    ground = table[table["phase"] == "ground"]
    assert hover["pos_z"].median() < ground["pos_z"].median() - 0.5
    assert table["time"].iloc[0] >= 0.0
    assert np.all(np.diff(table["time"]) > 0)
    assert not flight.has("ibat_a")
    assert not flight.has("rotor_1")


def test_findings_tell_what_is_known_about_these_logs(data_dir: Path) -> None:
    findings = {(f.where, f.severity) for f in recorded(data_dir, "real_3").findings}
    expected = {("ibat_a", "warning"), ("rotor", "warning"), ("sensor_combined", "warning")}
    assert expected <= findings
    assert "over 10 us" not in " ".join(f.message for f in recorded(data_dir, "real_3").findings)


def test_rebuilding_that_is_impossible_says_why(data_dir: Path, tmp_path: Path) -> None:
    blob = (data_dir / "rflysimdt" / "real_1.ulg").read_bytes()
    path = tmp_path / "x.ulg"
    path.write_bytes(blob.replace(b"IMU_GYRO_CUTOFF", b"IMU_GYRO_KUTOFF"))
    flight = read_flight(path)
    assert counted(flight, "cmd", "not rebuilt at full rate: parameters not in the log: IMU_GYRO_C")
    assert flight.facts["commands"] == "actuator_outputs, 10 Hz"
    assert len(flight.signal(["cmd_1"])[0]) == 251


@pytest.mark.slow
def test_what_another_controller_flew_is_not_rebuilt(data_dir: Path, tmp_path: Path) -> None:
    """The log of an aircraft whose parameters are not those that flew it."""
    path = foreign(data_dir / "rflysimdt" / "real_1.ulg", tmp_path)
    flight = read_flight(path)
    assert flight.facts["commands"] == "actuator_outputs, 10 Hz"
    assert flight.facts["commands_not_rebuilt"].startswith("they miss the logged ones by up to ")
    assert counted(flight, "cmd", "not rebuilt at full rate: they miss the logged ones")
    asked = read_flight(path, rebuild_commands=True)
    assert "commands_match" in asked.facts
    assert counted(asked, "cmd", "rebuilt commands miss the logged ones by over 10 us")


@pytest.mark.parametrize(
    ("logged_us", "rebuilt", "why"),
    [
        ((1500, 1500), (0.5, 0.5), ""),
        ((1500, 1500), (0.5, 0.54), "they miss the logged ones by up to 40 us rms"),
        ((2000, 1500), (1.0, 0.5), ""),
        ((1999, 1500), (1.0, 0.5), ""),
    ],
)
def test_a_match_says_whether_it_is_one(
    logged_us: tuple[float, ...], rebuilt: tuple[float, ...], why: str
) -> None:
    assert match_of([logged_us] * 200, [rebuilt] * 200).misses == why


def test_a_motor_at_its_limit_in_one_alone_is_no_match() -> None:
    """Few samples that the root mean square hides."""
    logged = [(1500.0, 1500.0)] * 198 + [(2000.0, 1500.0)] * 3
    rebuilt = [(0.5, 0.5)] * 198 + [(0.9, 0.5)] * 3
    assert match_of(logged, rebuilt).misses.startswith("in 1 % of the logged outputs a motor is at")
    assert match_of(logged[:-1], rebuilt[:-1]).misses == ""


def match_of(logged_us: Sequence[Sequence[float]], cmd: Sequence[Sequence[float]]) -> Match:
    """Of logged pulse widths and rebuilt commands at the same times, range 1000 to 2000 us."""
    t_us = 100_000 * np.arange(len(logged_us), dtype=np.int64)
    topic = cast(Topic, SimpleNamespace(t_us=t_us))
    motors = tuple(MotorOutput(k, "", "us", 1000.0, 2000.0, "") for k in (1, 2))
    outputs = Outputs(topic, np.array(logged_us, dtype=float), motors)
    return compare(outputs, t_us, np.array(cmd), np.ones(len(t_us), dtype=np.bool_))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("topic", "field"),
    [
        ("vehicle_rates_setpoint", "roll"),
        ("vehicle_rates_setpoint", "thrust_body[2]"),
        ("rate_ctrl_status", "rollspeed_integ"),
        ("estimator_sensor_bias", "gyro_bias[1]"),
    ],
)
@pytest.mark.parametrize("value", [np.nan, 1e38])
def test_absurd_inputs_of_the_rebuild_are_counted(
    data_dir: Path, tmp_path: Path, topic: str, field: str, value: float
) -> None:
    blob = (data_dir / "rflysimdt" / "real_1.ulg").read_bytes()
    place = layout(blob)[topic]
    values = place.get(blob, field).copy()
    values[10:14] = value
    flight = saved(tmp_path, place.put(blob, field, values))
    assert counted(flight, topic, "left out of the rebuilt commands") == 4


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 0.001, 0.01, 0.03, 0.05, 0.1, 0.3, 0.5, 0.77, 0.9, 0.999])
def test_a_cut_log_is_read_as_far_as_it_goes(data_dir: Path, tmp_path: Path, share: float) -> None:
    whole = recorded(data_dir, "real_1")
    blob = (data_dir / "rflysimdt" / "real_1.ulg").read_bytes()
    for extra in (1, 2, 13, 50):
        try:
            flight = saved(tmp_path, blob[: int(share * len(blob)) + extra])
        except LogError as error:
            assert share < 0.1
            assert "log.ulg" in str(error)
            continue
        assert any("cut short" in f.message for f in flight.findings)
        assert flight.table["time"].iloc[-1] <= whole.table["time"].iloc[-1]
        common = np.isin(whole.table["time"], flight.signal(["acc_x"])[0])
        np.testing.assert_array_equal(
            whole.table.loc[common, "acc_x"], flight.table["acc_x"].dropna()
        )


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(30))
def test_damaged_bytes_never_raise_anything_but_a_twin_error(
    data_dir: Path, tmp_path: Path, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    blob = np.frombuffer((data_dir / "rflysimdt" / "real_1.ulg").read_bytes(), np.uint8).copy()
    region = (100, 60_000, len(blob))[seed % 3]
    at = rng.integers(0, region, int(10 ** rng.uniform(0, 3)))
    blob[at] = rng.integers(0, 256, len(at))
    try:
        table = saved(tmp_path, blob.tobytes()).table
    except TwinError as error:
        assert "log.ulg" in str(error)
    else:
        assert np.all(np.diff(table["time"]) > 0)
        assert np.isfinite(table["time"]).all()
        assert not np.isinf(table.drop(columns="phase")).any(axis=None)
