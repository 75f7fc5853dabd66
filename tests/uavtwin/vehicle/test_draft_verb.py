"""`uavtwin vehicle draft` and `ut.draft_vehicle`: known aircraft fly, and are drafted from it."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from cli_rig import run
from sample_logs import moving_topics, ulog

import uavtwin as ut
from twin.logs.airframe import Airframe, Cells, Place, SourcedValue, ThrustCurve
from twin.vehicle.vehicle import relative_deviation
from uavtwin.demo.flights import ACC_NOISE_M_S2, GYRO_NOISE_RAD_S, Waypoints, fly

FLIGHT: Waypoints = (
    ("ground", 1.0, (0.0, 0.0, 0.0)),
    ("takeoff", 2.5, (0.0, 0.0, -1.5)),
    ("hover", 2.0, (0.0, 0.0, -1.5)),
    ("hover", 2.5, (0.0, 0.0, -2.1)),
    ("hover", 2.5, (0.0, 0.0, -1.5)),
    ("forward", 2.5, (3.0, 2.0, -2.0)),
)
SIZE = {"arm_m": 0.225, "frame": "x"}
COPTER = {"mass_kg": 1.4, "arm_m": 0.225, "frame": "x"}


@pytest.fixture(scope="module")
def copter() -> ut.Flight:
    vehicle = ut.vehicle("copter_default")
    return fly(vehicle, vehicle, 4, "copter", FLIGHT)


@pytest.fixture(scope="module")
def drafted(copter: ut.Flight) -> ut.DraftResult:
    return ut.draft_vehicle(copter, **COPTER, name="mine")  # type: ignore[arg-type]


def within(found: ut.Vehicle, key: str, true: float, drafted: float) -> bool:
    """Whether a true number lies within two standard deviations of a drafted one."""
    known = relative_deviation(found, key)
    assert known is not None
    assert known.stated
    return abs(true / drafted - 1.0) < 2 * known.sd


def test_the_draft_hovers_as_the_flight_did(drafted: ut.DraftResult, copter: ut.Flight) -> None:
    commands = copter.table.loc[copter.table.phase == "hover", [f"cmd_{i}" for i in range(1, 5)]]
    assert drafted.hover_command == pytest.approx(float(commands.mean().mean()), rel=0.01)
    assert drafted.vehicle.with_mass(1.4).mass_kg == drafted.vehicle.mass_kg


def test_true_numbers_lie_within_the_drafted_deviations(drafted: ut.DraftResult) -> None:
    """Of the aircraft that flew. Its rotors' inertia, a simulator's, is thrice the usual."""
    true, found = ut.vehicle("copter_default"), drafted.vehicle
    for axis in range(3):
        pair = (v.inertia_kg_m2[axis, axis] for v in (true, found))
        assert within(found, "body.inertia", *pair)
    assert found.rotors.position_m == pytest.approx(true.rotors.position_m, abs=2e-4)
    assert found.rotors.direction.tolist() == true.rotors.direction.tolist()
    torque, thrust = true.rotors.torque_n_m[2], true.rotors.thrust_n[2]
    ratio = found.rotors.torque_n_m[1] / found.rotors.thrust_n[1]
    assert within(found, "rotors.torque", torque / thrust, ratio)
    assert within(found, "rotors.lag", true.rotors.lag_up_s, found.rotors.lag_up_s)


def test_the_thrust_curve_is_that_of_the_aircraft(drafted: ut.DraftResult) -> None:
    """Relative thrust per relative command: 2 (1148 u) / (1148 u - 141.4), of its motors."""
    u = drafted.hover_command
    true = 2 * 1148.0 * u / (1148.0 * u - 141.4)
    _, c1, c2 = drafted.vehicle.rotors.thrust_n
    found = (c1 + 2 * c2 * u) / (c1 + c2 * u)
    doubt = drafted.vehicle.deviations["effects.thrust_curve.slope"].numbers
    assert doubt is not None
    assert abs(true / found - 1.0) < 2 * doubt[0]


def test_noise_is_that_of_the_sensors(drafted: ut.DraftResult) -> None:
    sensors = drafted.vehicle.sensors
    assert sensors.accel_noise_m_s2 == pytest.approx(ACC_NOISE_M_S2, rel=0.15)
    assert sensors.gyro_noise_rad_s == pytest.approx(GYRO_NOISE_RAD_S, rel=0.15)


def test_every_number_says_where_it_comes_from(drafted: ut.DraftResult) -> None:
    told = {n["key"]: n for n in drafted.json()["numbers"]}
    assert told["body.mass"]["from"] == "given"
    assert told["rotors.thrust_from_command"]["from"] == "log"
    assert told["body.inertia"]["from"] == "usual"
    assert [k for k, n in told.items() if n["sd"] is None] == ["rotors.direction"]
    assert {f.kind for f in drafted.details.facts} == {"given", "log", "usual"}
    assert "mine: 4 rotors, 1.4 kg, hovers at command" in str(drafted)


def test_an_unknown_frame_is_told_by_how_it_turned(copter: ut.Flight) -> None:
    found = ut.draft_vehicle(copter, 1.4, arm_m=0.225)
    direction = ut.vehicle("copter_default").rotors.direction
    assert found.vehicle.rotors.direction.tolist() == direction.tolist()
    assert "turns like this one" in found.vehicle.sources["rotors.position"]


def test_a_numbering_that_contradicts_the_flight_gives_way(copter: ut.Flight) -> None:
    found = ut.draft_vehicle(copter, 1.4, arm_m=0.225, frame="betaflight x")
    (warning,) = found.warnings
    assert "turn it otherwise" in warning
    assert "it turns like frame 'x' of the same shape, whose numbering is taken" in warning
    as_given = ut.draft_vehicle(copter, 1.4, arm_m=0.225, frame="x").vehicle.rotors
    np.testing.assert_array_equal(found.vehicle.rotors.position_m, as_given.position_m)
    np.testing.assert_array_equal(found.vehicle.rotors.direction, as_given.direction)


def test_wheelbase_arm_and_propeller_say_the_size(copter: ut.Flight) -> None:
    by_arm = ut.draft_vehicle(copter, 1.4, arm_m=0.225, frame="x", propeller="10x4.5")
    across = ut.draft_vehicle(copter, 1.4, wheelbase_m=0.45, frame="X", propeller="10x4.5x2")
    assert by_arm.vehicle.toml() == across.vehicle.toml()
    known = relative_deviation(by_arm.vehicle, "rotors.torque")
    guessed = relative_deviation(
        ut.draft_vehicle(copter, 1.4, arm_m=0.225, frame="x").vehicle, "rotors.torque"
    )
    assert known is not None
    assert guessed is not None
    assert known.sd < guessed.sd


def test_several_flights_are_put_together(copter: ut.Flight) -> None:
    more = {f"cmd_{i}": 1.1 * copter.table[f"cmd_{i}"] for i in range(1, 5)}
    heavy = replace(copter, name="heavy", table=copter.table.assign(**more))
    found = ut.draft_vehicle([copter, heavy], 1.4, arm_m=0.225, frame="x")
    one = ut.draft_vehicle(copter, 1.4, arm_m=0.225, frame="x")
    pooled, single = (relative_deviation(d.vehicle, "rotors.thrust") for d in (found, one))
    assert pooled is not None
    assert single is not None
    assert pooled.sd > 2 * single.sd  # they do not agree
    with pytest.raises(ut.TwinError, match="two flights are named copter"):
        ut.draft_vehicle([copter, copter], 1.4, arm_m=0.225)


@pytest.mark.parametrize(
    ("change", "given", "told"),
    [
        (
            {},
            {"frame": None, "arm_m": None},
            "Give the wheelbase, the distance of two motors across",
        ),
        ({}, {"frame": "hex x"}, "'hex x' is none with 4 rotors. Those are: x, "),
        ({}, {"mass_kg": -1.0}, "give the mass as it flew"),
        ({}, {"wheelbase_m": 0.45}, "say the same; give one of them"),
        ({}, {"arm_m": 240.0}, "arm 240 m: give it in m"),
        ({}, {"propeller": "ten inch"}, "write diameter and pitch in inches"),
        (
            {"airframe": Airframe(no_multirotor="MAV_TYPE is 1, a fixed-wing aircraft")},
            {},
            "this is no multirotor: MAV_TYPE is 1, a fixed-wing aircraft",
        ),
    ],
)
def test_what_is_missing_or_wrong_is_told(
    copter: ut.Flight, change: dict[str, object], given: dict[str, object], told: str
) -> None:
    with pytest.raises(ut.TwinError) as error:
        ut.draft_vehicle(replace(copter, **change), **{**COPTER, **given})  # type: ignore[arg-type]
    assert told in str(error.value)


def test_no_motors_and_no_flight_are_told(copter: ut.Flight) -> None:
    blind = replace(copter, table=copter.table.drop(columns="cmd_3"))
    with pytest.raises(ut.TwinError, match="neither commands nor speeds of 3"):
        ut.draft_vehicle(blind, 1.4, arm_m=0.225, frame="x")
    parked = replace(copter, table=copter.table.assign(phase="ground"))
    with pytest.raises(ut.TwinError, match="in the air for less than 2 s"):
        ut.draft_vehicle(parked, 1.4, arm_m=0.225, frame="x")


def test_measured_rotor_speeds_make_a_map_of_the_speed(copter: ut.Flight) -> None:
    """Speeds by the map of the aircraft: its thrust coefficient comes back."""
    speeds = {f"rotor_{i}": -141.4 + 1148.0 * copter.table[f"cmd_{i}"] for i in range(1, 5)}
    spun = replace(copter, table=copter.table.assign(**speeds))
    found = ut.draft_vehicle(spun, 1.4, arm_m=0.225, frame="x")
    assert found.vehicle.rotors.from_speed
    assert found.vehicle.rotors.thrust_n[2] == pytest.approx(1.105e-5, rel=0.02)
    assert found.hover_command == pytest.approx(0.609, rel=0.01)


def test_facts_of_the_log_enter(copter: ut.Flight) -> None:
    """The curve of the autopilot instead of the usual one."""
    airframe = Airframe(thrust=SourcedValue(ThrustCurve(0.3), "THR_MDL_FAC 0.3 of the log"))
    found = ut.draft_vehicle(replace(copter, airframe=airframe), **COPTER)  # type: ignore[arg-type]
    _, c1, c2 = found.vehicle.rotors.thrust_n
    assert c2 / (c1 + c2) == pytest.approx(0.3, rel=1e-3)


def test_all_that_a_log_can_tell_is_in_the_file() -> None:
    """A made hover of 20 s with rotor speeds, a battery, a place: no number without an sd."""
    t = 0.01 * np.arange(2000)
    table = pd.DataFrame({"time": t, "phase": "hover", "ibat_a": 12.0, "vbat_v": 11.0 - 0.02 * t})
    table[["acc_x", "acc_y", "acc_z"]] = (0.0, 0.0, -9.81)
    for i in range(1, 5):
        table[f"cmd_{i}"], table[f"rotor_{i}"] = 0.4 + 0.001 * t, 500.0
    airframe = Airframe(
        place=SourcedValue(Place(np.radians(48.0), np.radians(11.0), 500.0, 2025.3), "satellites"),
        cells=SourcedValue(Cells(3, 4.2, 3.5, 18000.0, 0.02), "BAT1"),
        imu_position_m=SourcedValue((0.01, 0.0, 0.0), "EKF2_IMU_POS_X"),
        gyro_cutoff_hz=SourcedValue(60.0, "IMU_GYRO_CUTOFF"),
    )
    found = ut.draft_vehicle(ut.Flight("made", table, airframe=airframe), 1.0, **SIZE)  # type: ignore[arg-type]
    told = {n["key"]: n for n in found.json()["numbers"]}
    assert [k for k, n in told.items() if n["sd"] is None] == ["rotors.direction"]
    vehicle = found.vehicle
    assert vehicle.battery is not None
    assert vehicle.battery.full_voltage_v == pytest.approx(12.6)
    assert vehicle.battery.hover_current_a == pytest.approx(12.0)
    assert vehicle.gravity_m_s2 == pytest.approx(9.8081, abs=1e-3)
    assert vehicle.gyro_cutoff_hz == 60.0
    assert vehicle.rotors.reference_voltage_v == pytest.approx(10.8)
    assert np.linalg.norm(vehicle.sensors.field_n_t) == pytest.approx(4.86e-5, rel=0.02)
    assert "sd" in told["effects.thrust_curve.slope"]
    assert found.hover_command == pytest.approx(0.41, rel=0.01)


# -- command line -----------------------------------------------------------------------------


@pytest.mark.slow
def test_the_verb_writes_a_file_and_says_what_next(
    capsys: pytest.CaptureFixture[str], copter: ut.Flight, tmp_path: Path
) -> None:
    log, out = tmp_path / "copter.parquet", tmp_path / "my.toml"
    ut.write_flight(copter, log)
    arguments = ("vehicle", "draft", log, "--mass", "1400g", "--wheelbase", "450mm", "--out", out)
    code, said, error = run(capsys, *arguments)
    assert (code, error) == (0, "")
    assert said.splitlines()[0].startswith("my: 4 rotors, 1.4 kg, hovers at command 0.6")
    assert f"uavtwin calibrate {log} --vehicle {out}" in said
    assert tomllib.loads(out.read_text())["body"]["mass"]["value"] == 1.4
    code, _, error = run(capsys, *arguments)
    assert code == 2
    assert "my.toml" in error
    code, said, _ = run(capsys, *arguments, "--force", "--json")
    told = json.loads(said)
    assert code == 0
    assert told["hover"]["draft"] == pytest.approx(told["hover"]["flights"][0]["level"], rel=0.01)
    code, said, _ = run(capsys, "check", out)
    assert code == 0, said
    code, said, _ = run(capsys, "check", log, "--vehicle", out)
    assert code == 0, said
    assert "hover            command 0.60" in said
    assert "At the logged commands my carries 100 % of its weight" in said
    assert "good for: vehicle draft" in said


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ((), "--mass is missing"),
        (("--mass", "heavy"), "'heavy' is no number with a unit such as kg: write 1.3kg or 1300g"),
        (
            ("--mass", "1.4", "--wheelbase", "450"),
            "--wheelbase 450: '450' has no unit such as m: write 480mm or 0.48m",
        ),
        (
            ("--mass", "1.4"),
            "Give the wheelbase, the distance of two motors across (--wheelbase 480mm)",
        ),
    ],
)
def test_what_the_verb_lacks_is_told(
    capsys: pytest.CaptureFixture[str],
    copter: ut.Flight,
    tmp_path: Path,
    options: tuple[str, ...],
    told: str,
) -> None:
    ut.write_flight(copter, tmp_path / "log.parquet")
    out = tmp_path / "my.toml"
    code, _, error = run(
        capsys, "vehicle", "draft", tmp_path / "log.parquet", *options, "--out", out
    )
    assert code == 2
    assert told in error
    assert not out.exists()


def test_check_of_a_plane_says_that_it_is_none_of_ours(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / "plane.ulg"
    path.write_bytes(ulog(moving_topics(), {"MAV_TYPE": 1}))
    code, said, _ = run(capsys, "check", path)
    assert code == 1
    assert "kind             this is no multirotor: MAV_TYPE is 1, a fixed-wing aircraft" in said
    assert "good for: " not in said


# -- recorded flights -------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("log", "mass_kg", "arm_m"), [("real_2", 0.3175, 0.075), ("sim_1", 1.4, 0.225)]
)
def test_a_recorded_flight_gives_an_aircraft_that_hovers_as_logged(
    data_dir: Path, log: str, mass_kg: float, arm_m: float
) -> None:
    """Goal of the draft: within 3 % of the command in the log. True inertia within 2 sd."""
    flight = ut.read_flight(data_dir / "rflysimdt" / f"{log}.ulg")
    found = ut.draft_vehicle(flight, mass_kg, arm_m=arm_m)
    hover = flight.table.loc[flight.table.phase == "hover"]
    level = float(np.nanmedian(hover[[f"cmd_{i}" for i in range(1, 5)]].mean(axis=1)))
    assert found.hover_command == pytest.approx(level, rel=0.03)
    true = ut.vehicle("feisi_x150" if log == "real_2" else "copter_default")
    for axis in range(3):
        pair = (v.inertia_kg_m2[axis, axis] for v in (true, found.vehicle))
        assert within(found.vehicle, "body.inertia", *pair)
    assert found.vehicle.rotors.direction.tolist() == true.rotors.direction.tolist()
    assert found.warnings == ()
