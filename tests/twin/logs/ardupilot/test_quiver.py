"""Five recorded logs of an 18 kg quadrotor: what its README says, and what must agree in them."""

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from cli_rig import run
from places import DATA, needs

import uavtwin as ut
from twin.logs import Flight, read_flight
from twin.logs.agreement import turns
from twin.logs.ardupilot.airframe import geometry, yaw_trim
from twin.logs.ardupilot.log import open_ardupilot
from twin.vehicle_file import parse_vehicle

FOLDER = DATA / "quiver_pt1"
LOGS = ("80", "81", "83", "87", "92")
RPM = {
    "80": (3832, 3901, 4214, 4417),
    "83": (3850, 3989, 4160, 4359),
    "87": (3826, 3928, 4110, 4440),
    "92": (3664, 3815, 4080, 4477),
}
"""Medians while airborne, of the README."""
RESIDUAL_RAD_S = 0.005
"""Worst axis of all PX4 flights: 0.0045."""
COMMANDS = [f"cmd_{k}" for k in range(1, 5)]
ROTORS = [f"rotor_{k}" for k in range(1, 5)]

pytestmark = needs(FOLDER.is_dir(), "no quiver_pt1: set UAVTWIN_DATA")


def path_of(log: str) -> Path:
    return FOLDER / f"pt1_000000{log}.BIN"


@cache
def flight(log: str) -> Flight:
    return read_flight(path_of(log))


@pytest.mark.slow
@pytest.mark.parametrize("log", LOGS)
def test_all_are_read_without_an_error(log: str) -> None:
    found = flight(log)
    assert [f.message for f in found.findings if f.severity == "error"] == []
    assert found.indoors is False and found.facts["airframe"] == "quad x"
    assert found.facts["firmware"] == "ArduCopter V4.5.7 (2a3dc4b7)"
    assert found.has("acc_x", "gyro_x", "mag_x", "baro_pa", "q_w", "vel_x", "pos_x", "vbat_v")
    assert found.has(*COMMANDS, *ROTORS)
    assert 35.0 < found.table["time"].iloc[-1] < 104.0
    assert {"ground", "hover", "forward", "land"} <= set(found.table["phase"])


@pytest.mark.slow
@pytest.mark.parametrize("log", RPM)
def test_rotor_speeds_are_those_of_the_readme(log: str) -> None:
    table = flight(log).table
    airborne = table.loc[table["phase"].isin(["hover", "forward"]), ROTORS].median()
    np.testing.assert_allclose(airborne * 30.0 / np.pi, RPM[log], rtol=0.012)


@pytest.mark.slow
@pytest.mark.parametrize("log", LOGS)
def test_the_yaw_trim_between_the_pairs(log: str) -> None:
    """Clockwise rotors get more in every flight, and turn faster."""
    rotors = geometry(1, 1)
    assert rotors is not None
    found = yaw_trim(flight(log).table, rotors)
    assert found is not None and 0.05 < found.command < 0.1 and 0.08 < found.share < 0.14
    table = flight(log).table
    speeds = table.loc[table["phase"].isin(["hover", "forward"]), ROTORS].median().to_numpy()
    assert 1.05 < speeds[2:].mean() / speeds[:2].mean() < 1.15


@pytest.mark.slow
def test_gyroscope_and_attitude_agree_as_they_do_in_px4_logs() -> None:
    """Kinematic residual, half-second windows, worst axis of each flight."""
    ours = [turns(flight(log).columns) for log in LOGS]
    theirs = [
        turns(read_flight(DATA / "rflysimdt" / f"real_{k}.ulg", rebuild_commands=False).columns)
        for k in (1, 2, 3)
    ]
    worst = [max(t.residual_rad_s.max() for t in each if t) for each in (ours, theirs)]
    assert max(worst) < RESIDUAL_RAD_S, worst
    shares = [
        [t.residual_rad_s / np.std(t.by_gyro / t.lasting_s[:, None], axis=0) for t in each if t]
        for each in (ours, theirs)
    ]
    relative = [np.max(each) for each in shares]
    assert relative[0] < relative[1]  # of the motion there is


@pytest.mark.slow
@pytest.mark.parametrize("log", ["83", "87"])
def test_the_frame_is_the_one_that_flew(log: str) -> None:
    """What the rate controller asks for (RATE) comes out of the motors as the frame mixes it.

    The commands are taken back through the thrust curve; a roll to the right takes thrust from
    rotors on the right, and a yaw to the right is the reaction of rotors that turn to the left.
    """
    frame, told = geometry(1, 1), flight(log).airframe
    assert frame is not None and told is not None and told.thrust is not None
    opened = open_ardupilot(path_of(log), path_of(log).read_bytes())
    rate, outputs = opened.topic("RATE"), opened.topic("RCOU")
    assert rate is not None and outputs is not None
    wanted = np.column_stack([rate.raw(c) for c in ("ROut", "POut", "YOut")])
    wanted = np.column_stack([np.interp(outputs.t_us, rate.t_us, w) for w in wanted.T])
    widths = np.column_stack([outputs.raw(f"C{k}") for k in range(1, 5)])
    thrust = told.thrust.value.thrust((widths - 1000.0) / 1000.0)
    flying = (widths > 1300.0).all(axis=1)
    apart = thrust[flying] - thrust[flying].mean(axis=1, keepdims=True)
    mixed, *_ = np.linalg.lstsq(wanted[flying], apart, rcond=None)
    x, y = frame.direction.T
    for row, expected in zip(mixed, (-y, x, frame.turn), strict=True):
        assert np.corrcoef(row, expected)[0, 1] > 0.95


VEHICLE = """
name = "quiver_pt1"
[body]
mass = { value = 18.0, unit = "kg", source = "CAD" }
inertia = { value = [1.24, 1.225, 2.17], unit = "kg*m^2", source = "CAD" }
[rotors]
position = { value = [[0.46, 0.46, 0.0], [-0.46, -0.46, 0.0], [0.46, -0.46, 0.0],
    [-0.46, 0.46, 0.0]], unit = "m", source = "made up" }
direction = { value = ["ccw", "ccw", "cw", "cw"], source = "ArduPilot, quad x" }
thrust_from_speed = { value = 2.4e-4, unit = "N*s^2/rad^2", source = "hover of the logs" }
torque_from_speed = { value = 4.5e-6, unit = "N*m*s^2/rad^2", source = "made up" }
speed_from_command = { coefficients = [42.0, 570.0], unit = "rad/s", source = "fit to the logs" }
lag = { value = 0.1, unit = "s", source = "made up" }
"""


@pytest.mark.slow
def test_check_and_gap_take_them(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """The twin carries its weight on the logged commands, and needs no yaw trim."""
    code, said, _ = run(capsys, "check", path_of("92"), "--all")
    assert (
        code == 1
        and "problem" not in said
        and "clockwise rotors get 0.087 more" in said
        and "good for: gap" in said
    )
    (tmp_path / "quiver.toml").write_text(VEHICLE)
    code, _, _ = run(
        capsys, "gap", path_of("92"), "--vehicle", tmp_path / "quiver.toml", "--out", tmp_path / "o"
    )
    assert code == 0
    channels = json.loads((tmp_path / "o" / "gap.json").read_text())["channels"]
    assert abs(channels["acc_z"]["mean"]) < 0.5
    assert channels["gyro_rate_z"]["mean"] > 0.1  # the twin turns left by what is trimmed


@pytest.mark.slow
def test_the_log_tells_its_aircraft_in_the_words_of_all_formats() -> None:
    """What `vehicle draft` begins with."""
    told = flight("83").airframe
    assert told is not None and told.no_multirotor == "" and told.layout is not None
    assert told.rotors is not None and told.rotors.value == 4
    assert told.layout.position[0, 0] > 0 and told.layout.position[0, 1] > 0  # front right
    assert told.layout.direction.tolist() == [-1.0, -1.0, 1.0, 1.0] and not told.layout.metric
    assert told.thrust is not None
    curve, step = told.thrust.value, 1e-6
    x = (0.5 - curve.start) / (curve.full - curve.start)
    thrust = curve.factor * x**2 + (1 - curve.factor) * x
    more = x + step / (curve.full - curve.start)
    slope = (curve.factor * more**2 + (1 - curve.factor) * more - thrust) / step
    assert curve.elasticity(0.5) == pytest.approx(0.5 * slope / thrust, rel=1e-4)
    assert told.origin is not None and told.origin.source == "ORGN of the log"
    place, origin = told.place, told.origin.value
    assert place is not None and origin.height_m == pytest.approx(place.value.height_m, abs=20)
    assert origin.latitude_rad == pytest.approx(place.value.latitude_rad, abs=1e-4)
    assert told.place is not None and told.gyro_cutoff_hz is not None


@pytest.mark.slow
@pytest.mark.parametrize("log", LOGS)
def test_a_draft_hovers_as_the_log_does(log: str) -> None:
    """By the mass of the README, with an arm that nobody wrote down; inertia by the study."""
    found = ut.draft_vehicle(flight(log), 18.0, arm_m=0.6)
    assert found.hover_command == pytest.approx(found.details.level, rel=0.03)
    inertia = np.diag(parse_vehicle(found.details.text, "quiver.toml").inertia_kg_m2)
    np.testing.assert_allclose(inertia, (1.24, 1.225, 2.17), rtol=2 * 0.3)
