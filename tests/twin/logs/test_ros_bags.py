"""ROS 2 bags: PX4's topics, MAVROS and topics of one's own are the same flight."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from log_rigs.ros_rig import OUTPUTS, START_NS, Messages, bag, mavros_bag, needs_rosbags, px4_bag
from sample_logs import flown_table

from twin.errors import LogError, TwinError
from twin.logs import Flight, read_flight
from uavtwin.file_check import check_file

pytestmark = [pytest.mark.slow, needs_rosbags]
MOTION = ("acc", "gyro", "vel")
MAG = """
[mag]
topic = "/mavros/imu/data"
fields = [FIRST, "linear_acceleration.y", "linear_acceleration.z"]
"""


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return flown_table().iloc[:1000]


def compare(flight: Flight, table: pd.DataFrame, names: list[str], atol: float) -> None:
    """Every sample that the bag has, at its time."""
    for name in names:
        t_s, values = flight.signal([name])
        want = np.interp(t_s, table["time"], table[name])
        assert len(t_s) > 100, name
        np.testing.assert_allclose(values[:, 0], want, atol=atol, err_msg=name)


def columns(*stems: str) -> list[str]:
    return [f"{s}_{a}" for s in stems for a in ("wxyz" if s == "q" else "xyz")]


@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
def test_topics_of_px4_are_a_flight(table: pd.DataFrame, suffix: str, tmp_path: Path) -> None:
    file = tmp_path / f"flight{suffix}"
    file.write_bytes(bag(px4_bag(table), suffix))
    flight = read_flight(file)
    commands = [f"cmd_{i}" for i in range(1, 5)]
    compare(flight, table, [*columns(*MOTION, "q", "pos"), *commands], 2e-6)
    assert flight.signal(["pos_x"])[0][0] >= 1.0, "invalid before"
    assert flight.facts["cmd from"] == "/fmu/out/actuator_motors"
    assert flight.autopilot is not None
    assert [(m.name, round(m.start_s, 1)) for m in flight.autopilot.modes] == [
        ("Takeoff", 0.0),
        ("Mission", 5.0),
    ]
    assert list(flight.table["phase"][:100]) == ["ground"] * 100
    assert {"thrust", "invalid"} <= {w for f in flight.findings for w in f.message.split()}


def test_topics_of_mavros_are_turned(table: pd.DataFrame, tmp_path: Path) -> None:
    """ENU and FLU by scipy on the way there, by our own algebra on the way back."""
    file = tmp_path / "flight.mcap"
    file.write_bytes(bag(mavros_bag(table)))
    flight = read_flight(file)
    compare(flight, table, columns(*MOTION, "pos"), 1e-9)
    q, truth = flight.signal(columns("q"))[1], table[columns("q")].to_numpy()
    assert np.abs(np.sum(q * truth, axis=1)) == pytest.approx(1.0, abs=1e-9)
    assert flight.facts["acc from"] == "/mavros/imu/data_raw"
    assert flight.table["ibat_a"].dropna().tolist() == [12.0] * 5
    assert not flight.has("cmd_1") and any("mapping file" in f.message for f in flight.findings)


def test_a_mapping_file_names_other_topics(table: pd.DataFrame, tmp_path: Path) -> None:
    file = tmp_path / "flight.mcap"
    file.write_bytes(bag(mavros_bag(table)))
    (tmp_path / "flight.topics.toml").write_text(OUTPUTS)
    flight = read_flight(file)
    compare(flight, table, [f"cmd_{i}" for i in range(1, 5)], 5.1e-4)
    assert not any("mapping file" in f.message for f in flight.findings)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ("[cmd", "no mapping of topics"),
        ("[command]\ntopic='/mavros/rc/out'\nfields=[]", r"\[command\] is no signal"),
        (OUTPUTS.replace("rc/out", "none"), "topic /mavros/none: the bag has"),
        (OUTPUTS.replace('"us"', '"weeks"'), "unit 'weeks'"),
        (OUTPUTS.replace('"channels[3]"', '"__class__[x"'), "write a path such as"),
        (OUTPUTS.replace("high = 2000", "high = 1000"), "low = 1000, high = 1000"),
        (OUTPUTS.replace("low = ", "least = "), "least"),
        (OUTPUTS.replace("low = 1000", "low = nan"), "low = nan, high = 2000"),
        (OUTPUTS.replace('"us"', '"V"'), r"\[cmd\] unit 'V': write us"),
        (OUTPUTS.replace("channels[1]", "channels[0]"), r"\[cmd\] names a field twice: channels"),
        (OUTPUTS.replace("channels[3]", "channels[9]"), r"\[cmd\] cmd needs 4 values.* give 3"),
        (OUTPUTS.replace("channels[3]", "channels"), r"\[cmd\] cmd needs 4 values.* give 7"),
        (
            MAG.replace("FIRST", "'linear_acceleration.q'"),
            r"flight.topics.toml: \[mag\] field linear_acceleration.q: the message "
            r"sensor_msgs/msg/Imu has linear_acceleration.x, .*_acceleration.z\.",
        ),
        (MAG.replace("FIRST", "'linear_acceleration.x.y'"), "the message .* has linear_acc.*x"),
        (MAG.replace("FIRST", "'header.frame_id'"), "header.frame_id: it is text, no number"),
        (MAG.replace("FIRST", "'header.stamp'"), "a message, no number. It has header.stamp.sec"),
        (MAG.replace("FIRST", "'linear_acceleration.x[0]'"), "it is no array"),
        (MAG.replace("FIRST", "'orientation_covariance[9]'"), "has 9 elements"),
        (MAG.replace("FIRST", "'orientation_covariance'"), "needs 3 values; .* give 11"),
        (MAG.replace("FIRST, ", ""), r"\[mag\] mag needs 3 values; .* give 2"),
        (MAG.replace("FIRST, ", "").replace("[mag]", "[q]"), "q needs 4 values; .* give 2"),
        (MAG.replace("FIRST, ", "").replace("[mag]", "[baro]"), "has 2 fields: baro needs 1"),
        (MAG.replace("FIRST", "'header.stamp.sec'") + "unit = 'rpm'", "write T or gauss"),
    ],
)
def test_a_wrong_mapping_is_said(
    table: pd.DataFrame, wrong: str, said: str, tmp_path: Path
) -> None:
    file = tmp_path / "flight.mcap"
    file.write_bytes(bag(mavros_bag(table.iloc[:5])))
    (tmp_path / "flight.topics.toml").write_text(wrong)
    with pytest.raises(LogError, match=said):
        read_flight(file)


def test_the_folder_of_a_bag_is_the_bag(table: pd.DataFrame, tmp_path: Path) -> None:
    bag(px4_bag(table.iloc[:200]), folder=tmp_path)
    assert read_flight(tmp_path / "bag").has("acc_x")
    assert "acc_x" in check_file(tmp_path / "bag").facts["holds"]
    with pytest.raises(TwinError, match="is a folder"):
        check_file(tmp_path)
    (tmp_path / "bag" / "second.mcap").write_bytes(b"")
    with pytest.raises(LogError, match="of 2 files"):
        read_flight(tmp_path / "bag")


def since_boot(messages: Messages) -> Messages:
    """The same, stamped by a clock that began 20 s before the record."""
    boot_s = 1e-9 * START_NS - 20.0
    return replace(messages, t_s=messages.t_s - boot_s, late_s=boot_s + messages.late_s)


def test_a_topic_of_another_clock_is_shifted(table: pd.DataFrame, tmp_path: Path) -> None:
    """Stamped an hour behind, recorded with the others a little later each."""
    topics = mavros_bag(table)
    topics[2] = replace(topics[2], t_s=topics[2].t_s - 3600.0, late_s=3600.002)
    file = tmp_path / "flight.mcap"
    file.write_bytes(bag(topics))
    flight = read_flight(file)
    compare(flight, table, columns("pos"), 1e-6)
    said = [f.where for f in flight.findings if "another clock" in f.message]
    assert said == ["/mavros/local_position/odom"], "three signals, one warning"


def test_topics_of_two_clocks_keep_their_stamps(table: pd.DataFrame, tmp_path: Path) -> None:
    """Two signals since boot and two since 1970: that of the IMU counts."""
    imu, attitude, _, outputs, *_ = px4_bag(table)
    file = tmp_path / "flight.mcap"
    file.write_bytes(bag([imu, since_boot(attitude), since_boot(outputs)]))
    flight = read_flight(file)
    compare(flight, table, [*columns("acc", "gyro", "q"), "cmd_1", "cmd_4"], 2e-6)
    said = [f.where for f in flight.findings if "another clock" in f.message]
    assert sorted(said) == ["/fmu/out/actuator_motors", "/fmu/out/vehicle_attitude"]
    assert not any("no times" in f.message for f in flight.findings)


def test_an_impossible_stamp_costs_its_message(
    table: pd.DataFrame, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """2^64 us, in every fourth message."""
    import log_rigs.ros_rig as rig

    made = rig._message

    def damaged(store: object, kind: str, fields: dict[str, object], stamp_ns: int) -> object:
        message = made(store, kind, fields, stamp_ns)
        if kind.endswith("ActuatorMotors") and stamp_ns // 10_000_000 % 4 == 0:
            message.timestamp_sample = 2**64 - 1
        return message

    monkeypatch.setattr(rig, "_message", damaged)
    file = tmp_path / "flight.mcap"
    file.write_bytes(bag(px4_bag(table)))
    flight = read_flight(file)
    compare(flight, table, ["acc_x"], 2e-6)
    (lost,) = [f for f in flight.findings if "no possible time" in f.message]
    assert lost.where == "/fmu/out/actuator_motors"
    assert lost.count + len(flight.signal(["cmd_1"])[0]) == len(table)


def test_a_message_of_another_version_costs_one_signal(
    table: pd.DataFrame, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Of a battery without a current, the voltage is read."""
    import log_rigs.ros_rig as rig

    monkeypatch.setitem(rig.PX4, "BatteryStatus", "uint64 timestamp\nfloat32 voltage_v\n")
    file = tmp_path / "flight.mcap"
    file.write_bytes(bag(px4_bag(table)))
    flight = read_flight(file)
    assert flight.has("vbat_v") and not flight.has("ibat_a")
    (said,) = [f for f in flight.findings if "current_a" in f.message]
    assert said.message.endswith("the message px4_msgs/msg/BatteryStatus has timestamp, voltage_v.")


def test_what_is_no_bag_of_ros_is_said(tmp_path: Path) -> None:
    import sqlite3

    file = tmp_path / "mine.db3"
    with sqlite3.connect(file) as made:
        made.execute("CREATE TABLE notes (text)")
    made.close()
    with pytest.raises(LogError, match="no ROS 2 bag that can be read"):
        read_flight(file)
    file.with_suffix(".mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    with pytest.raises(LogError, match="mcap recover"):
        read_flight(file.with_suffix(".mcap"))


def test_a_bag_without_motion_lists_its_topics(tmp_path: Path) -> None:
    file = tmp_path / "flight.mcap"
    said = Messages("/chatter", "std_msgs/msg/String", np.arange(3.0), [{"data": "hello"}] * 3)
    file.write_bytes(bag([said]))
    with pytest.raises(LogError, match=r"It has /chatter \(String\)"):
        read_flight(file)
