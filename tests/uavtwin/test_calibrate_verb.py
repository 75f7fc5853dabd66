"""`uavtwin calibrate` and `explain --since`: what a normal aircraft is, and what has changed."""

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from cli_rig import run

import uavtwin as ut
from twin.effects import EFFECTS
from twin.errors import TwinError
from twin.explain.calibration import Calibrated
from twin.explain.explanation import Explanation
from twin.explain.inference.estimate import Estimate
from twin.explain.model.numbers import numbers_of
from twin.logs import read_flight, write_flight
from twin.vehicle import Calibration, Vehicle
from uavtwin.calibration import CalibrateResult
from uavtwin.demo.flights import Waypoints, fly
from uavtwin.explain_record import explain_record
from uavtwin.headline import _within, headline
from uavtwin.wording import said

COPTER = ut.load_vehicle("copter_default")
DRAG_1_S = 0.5
NORMAL = replace(
    COPTER,
    drag_linear_n_s_m=COPTER.drag_linear_n_s_m
    + DRAG_1_S * COPTER.mass_kg * np.array([1.0, 1.0, 0.0]),
)
LOADED_KG = 0.3
Place = tuple[float, float, float]


def legs(first: Place, second: Place) -> Waypoints:
    """Take off, fly to two places, hover."""
    return (
        ("ground", 0.5, (0.0, 0.0, 0.0)),
        ("takeoff", 3.0, (0.0, 0.0, -1.0)),
        ("forward", 2.0, first),
        ("forward", 2.0, second),
        ("hover", 1.5, second),
    )


ACROSS = legs((2.0, 1.0, -1.0), (0.0, 0.0, -1.3))
BACK = legs((-1.0, 2.0, -1.0), (0.0, 0.0, -1.3))
NOTE = "# as weighed on Monday"


def written(
    folder: Path, name: str, plant: Vehicle, seed: int, waypoints: Waypoints = ACROSS
) -> Path:
    path = folder / f"{name}.parquet"
    write_flight(fly(COPTER, plant, seed, name, waypoints), path)
    return path


# -- words ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("effect", "change", "words"),
    [
        (
            "rotor_efficiency_loss",
            {"loss_1": 0.002, "loss_3": 0.14},
            "rotor 3 has lost 14 % of its thrust",
        ),
        ("mass_offset", {"mass_kg": 0.1}, "it carries 0.1 kg more"),
        ("mass_offset", {"mass_kg": -0.1}, "it is 0.1 kg lighter"),
        (
            "cog_offset",
            {"x_m": 0.004, "y_m": -0.002, "z_m": 0.0},
            "its centre of mass has moved 4 mm forward and 2 mm left",
        ),
        (
            "payload_cg",
            {"mass_kg": 0.1, "moment_x_kg_m": -0.002, "moment_y_kg_m": 5e-6},
            "it carries 0.1 kg more, 20 mm back",
        ),
        (
            "payload_cg",
            {"mass_kg": 0.1, "moment_x_kg_m": 5e-6, "moment_y_kg_m": 5e-6},
            "it carries 0.1 kg more",
        ),
        ("slung_load", {"mass_kg": 0.2}, "a load of 0.2 kg hangs below it on a rope"),
        (
            "command_delay",
            {"delay_s": 0.012},
            "its motors get their commands 12 ms later than at calibration",
        ),
        ("heading_offset", {"yaw_rad": np.pi / 18}, "its heading is off by another 10°"),
        ("accel_bias", {"x_m_s2": 0.3}, "its accelerometer reads 0.3 m/s² more in x than it did"),
        ("parasitic_drag", {"c_1_m": 0.1}, "parasitic drag (c_1_m 0.1 1/m)"),
        ("rotor_drag", {"k_xy_1_s": 0.3}, "linear drag has changed by 0.3 (m/s²)/(m/s) horizontal"),
        ("rotor_drag", {"height_m": 0.02}, "rotor drag (height_m 20 mm)"),
    ],
)
def test_a_change_is_said_as_a_pilot_says_it(
    effect: str, change: dict[str, float], words: str
) -> None:
    assert said(effect, change, since=True) == words


@pytest.mark.parametrize(
    ("effect", "change", "words"),
    [
        ("steady_wind", {"north_m_s": (4.0, 0.6)}, " (± 0.6 m/s)"),
        ("steady_wind", {"north_m_s": (3.0, 0.6), "east_m_s": (-4.0, 1.0)}, " (± 0.88 m/s)"),
        ("command_delay", {"delay_s": (0.012, 0.004)}, " (± 4 ms)"),
        ("cog_offset", {"x_m": (0.004, 0.001), "y_m": (0.002, 0.001)}, ""),
        ("rotor_efficiency_loss", {"loss_1": (0.2, 0.05)}, ""),
    ],
)
def test_a_change_of_one_number_has_its_interval(
    effect: str, change: dict[str, tuple[float, float]], words: str
) -> None:
    every = {n.name: n for n in numbers_of([EFFECTS[effect]], COPTER)}
    estimates = [
        Estimate(every[name], value, 0.0, (value - half, value + half))
        for name, (value, half) in change.items()
    ]
    assert _within(estimates) == words


def test_a_number_of_this_aircraft_is_held_against_its_file() -> None:
    assert said("thrust_scale", {"scale": -0.07}, since=False) == (
        "its rotors give 7 % less thrust than the model"
    )
    assert said("inertia_error", {"scale_x": 0.2, "scale_y": 0.19}, since=False) == (
        "its inertia is 20 % larger in roll and 19 % larger in pitch than that of the model"
    )


# -- what is refused --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "way_out"),
    [
        ([], "uavtwin vehicle draft LOG"),
        (
            ["--vehicle", "crazyflie", "--since", "mine.toml"],
            "--since FILE, a file of `uavtwin calibrate`",
        ),
    ],
)
def test_one_of_vehicle_and_since(
    given: list[str], way_out: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, err = run(capsys, "explain", "one.ulg", *given, "--out", tmp_path / "out")
    assert code == 2
    assert way_out in err
    with pytest.raises(TwinError, match="to ask what has changed since then"):
        ut.explain([], [], *([COPTER] if given else []), since=COPTER if given else None)


@pytest.mark.slow
def test_since_takes_what_was_calibrated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path, "one", COPTER, 1)
    out = tmp_path / "out"
    code, _, err = run(capsys, "explain", path, "--since", "copter_default", "--out", out)
    assert code == 2
    assert "copter_default: holds no [calibration]" in err
    assert "uavtwin calibrate" in err
    assert not out.exists()
    with pytest.raises(TwinError, match="holds no"):
        ut.explain(read_flight(path), [], since=COPTER)


@pytest.mark.slow
def test_what_cannot_be_calibrated_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, "one", COPTER, 1)
    flight = read_flight(path)
    with pytest.raises(TwinError, match="no flight to calibrate on"):
        ut.calibrate([], COPTER)
    with pytest.raises(TwinError, match="two flights have this name"):
        ut.calibrate([flight, flight], COPTER)
    with pytest.raises(TwinError, match="there is no flight 'two'"):
        ut.calibrate(flight, COPTER, payloads={"two": 0.1})
    upward = replace(flight, table=flight.table.assign(acc_z=-flight.table["acc_z"]))
    with pytest.raises(TwinError, match=r"none of the flights can be used: .*check the axes"):
        ut.calibrate(upward, COPTER)
    there = tmp_path / "there.toml"
    there.write_text("mine")
    arguments = ("calibrate", path, "--vehicle", "copter_default", "--out", there)
    code, _, err = run(capsys, *arguments)
    assert (code, there.read_text()) == (2, "mine")
    assert "exists. Choose another --out or add --force." in err


# -- what to fly ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("undetermined", "says"),
    [
        ("rotor_drag.k_xy_1_s", "fast straight legs"),
        ("yaw_torque_scale.scale", "yaw steps"),
        ("inertia_error.scale_z", "yaw steps"),
        ("inertia_error.scale_x", "doublets"),
        ("motor_lag.tau_s", "doublets"),
        ("battery_sag.slope", "from full to low"),
        ("thrust_scale.scale", "known mass aboard"),
    ],
)
def test_what_is_undetermined_is_flown_next(undetermined: str, says: str) -> None:
    flights = ("a", "b", "c")
    vehicle = replace(COPTER, calibration=Calibration(flights, (), np.zeros((0, 0)), {}, {}))
    details = cast(Calibrated, SimpleNamespace(undetermined=(undetermined,), vehicle=vehicle))
    (only,) = CalibrateResult(details, COPTER).fly_next()
    assert says in only


# -- the whole way ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Normal flights, an unusable one, and a draft."""
    folder = tmp_path_factory.mktemp("calibrate")
    for seed, name in enumerate(("one", "two", "three"), start=1):
        written(folder, name, NORMAL, seed, ACROSS if seed == 1 else BACK)
    flight = read_flight(folder / "three.parquet")
    table = flight.table.assign(acc_z=-flight.table["acc_z"])
    write_flight(replace(flight, name="flipped", table=table), folder / "flipped.parquet")
    text = COPTER.text.replace("[body]", f"[body]  {NOTE}")
    (folder / "draft.toml").write_text(text, "utf-8")
    return folder


@pytest.fixture(scope="module")
def calibrated(folder: Path) -> dict[str, Any]:
    """What `calibrate --json` says; the vehicle file lies in the folder."""
    with pytest.MonkeyPatch.context() as patch:
        kept: list[Any] = []
        patch.setattr("uavtwin.cli.results.print_json", kept.append)
        patch.chdir(folder)
        names = ["one.parquet", "two.parquet", "three.parquet", "flipped.parquet"]
        options = ["--vehicle", "draft.toml", "--out", "mine.toml", "--json", "--outdoor"]
        patch.setattr("sys.argv", ["uavtwin", "calibrate", *names, *options])
        from uavtwin.cli.main import main

        with pytest.raises(SystemExit) as stop:
            main()
        assert stop.value.code == 1  # the reader itself doubts the flight that is left out
    content = json.loads(json.dumps(kept[0].json(), allow_nan=False))
    assert isinstance(content, dict)
    return content


@pytest.mark.slow
def test_the_numbers_of_the_aircraft(calibrated: dict[str, Any]) -> None:
    first = calibrated["numbers"][0]
    assert first["name"] == "rotor_drag.k_xy_1_s"
    assert first["value"] == pytest.approx(DRAG_1_S, rel=0.03)
    assert first["ci95"][0] < first["value"] < first["ci95"][1]
    assert first["determined"]
    assert calibrated["flights"] == ["one", "two", "three"]
    assert calibrated["days"]["determined"]
    assert calibrated["days"]["sd"]["cog_offset.x_m"] > 0
    (warning,) = calibrated["warnings"]
    assert warning.startswith("left out: flipped: ")
    rooms = [n["name"].startswith("clock_offset") for n in calibrated["numbers"]]
    assert rooms == sorted(rooms)


@pytest.mark.slow
def test_the_vehicle_file(calibrated: dict[str, Any], folder: Path) -> None:
    text = (folder / "mine.toml").read_text("utf-8")
    mine = ut.load_vehicle(folder / "mine.toml")
    assert NOTE in text
    assert mine.toml() == text
    told = {n["name"]: n for n in calibrated["numbers"]}
    key = "rotor_drag.k_xy_1_s"
    assert mine.effects["rotor_drag"]["k_xy_1_s"] == pytest.approx(told[key]["value"], rel=1e-8)
    sd = mine.deviations[f"effects.{key}"].numbers
    low, high = told[key]["ci95"]
    assert sd is not None
    assert sd[0] == pytest.approx((high - low) / 2 / 1.96, rel=1e-3)
    assert mine.sources[f"effects.{key}"] == "uavtwin calibrate, one, two, three"
    assert "[effects.clock_offset]" not in text
    known = mine.calibration
    assert known is not None
    assert known.flights == ("one", "two", "three")
    assert key in known.numbers
    assert np.linalg.eigvalsh(known.covariance).min() > 0
    record = json.loads((folder / "mine.run.json").read_text())
    assert record["verb"] == "calibrate"
    assert record["options"]["left_out"] == ["flipped"]
    assert [i["name"] for i in record["inputs"]][-1] == "draft.toml"
    assert not list(folder.glob(".uavtwin*"))


@pytest.mark.slow
def test_every_key_is_in_the_documentation(calibrated: dict[str, Any]) -> None:
    text = (Path(__file__).parents[2] / "docs/reference/json.md").read_text("utf-8")
    lines = text.partition("## calibrate --json")[2].partition("\n## ")[0].splitlines()
    told = {k for line in lines for k in re.findall(r"`(\w+)`", line.split(" | ")[0])}
    assert told == set(calibrated)


def since(folder: Path, name: str, plant: Vehicle) -> ut.ExplainResult:
    flight = read_flight(written(folder, name, plant, 9))
    mine = ut.load_vehicle(folder / "mine.toml")
    return ut.explain(flight, [], since=mine, missions=("takeoff",), indoors=False)


@pytest.fixture(scope="module")
def loaded(calibrated: dict[str, Any], folder: Path) -> ut.ExplainResult:
    """What has changed on an aircraft that carries something."""
    assert calibrated
    plant = replace(NORMAL, mass_kg=NORMAL.mass_kg + LOADED_KG)
    return since(folder, "loaded", plant)


@pytest.mark.slow
def test_what_was_strapped_on_is_named(loaded: ut.ExplainResult) -> None:
    assert loaded.effects == ("payload_cg",)
    told = re.fullmatch(
        r"Since the calibration on one, two and three: it carries ([\d.]+) (k?g) more.*",
        loaded.sentence,
    )
    assert told is not None, loaded.sentence
    assert float(told[1]) / (1 if told[2] == "kg" else 1e3) == pytest.approx(LOADED_KG, rel=0.1)
    assert loaded.json()["headline"] == {
        "text": loaded.sentence,
        "numbers": ["payload_cg.mass_kg"],
    }
    assert loaded.json()["effects"][0]["parameters"]["mass_kg"]["no_effect"] == 0.0
    assert loaded.json()["since"] == ["one", "two", "three"]
    assert "rotor_drag.k_xy_1_s" in str(loaded.calibrated_table())
    assert "set by the calibration" in str(loaded.calibrated_table())
    assert loaded.vehicle.calibration is None
    assert "[calibration]" not in loaded.vehicle.toml()


@pytest.mark.slow
def test_the_page_says_what_has_changed(loaded: ut.ExplainResult, tmp_path: Path) -> None:
    page = loaded.report(tmp_path / "report.html").read_text("utf-8")
    assert "What has changed on copter_default" in page
    order = ("<h1>Since the calibration on", "Payload cg</h2>", '<h2 id="doubt">')
    places = [page.index(words) for words in order]
    assert places == sorted(places)


@pytest.mark.slow
def test_a_tie_names_both(loaded: ut.ExplainResult) -> None:
    balance = loaded.details.balance
    assert balance is not None
    chance = {"rotor_efficiency_loss": 0.02, "payload_cg": 0.6, "nothing": 0.0, "vibration": 0.0}
    torn = tuple(replace(h, probability=chance[h.cause]) for h in balance.hypotheses)
    tied = replace(
        loaded.details,
        verdict="cannot_tell",
        stochastic=(),
        balance=replace(balance, hypotheses=torn, sure=0.7),
    )
    assert isinstance(tied, Explanation)
    text = headline(tied).text
    assert text.startswith("Since the calibration on one, two and three: rotor")
    assert "more thrust than at calibration: it carries " in text
    assert text.endswith("These flights cannot tell which.")
    causes = explain_record(tied).json()["one_of_causes"]
    assert {c["cause"] for c in causes} == {"rotor_efficiency_loss", "payload_cg"}


@pytest.mark.slow
def test_a_normal_flight_has_not_changed(calibrated: dict[str, Any], folder: Path) -> None:
    assert calibrated
    quiet = since(folder, "quiet", NORMAL)
    assert quiet.verdict == "nothing"
    assert "no change is detectable" in quiet.sentence
    assert "would not show in these flights" in quiet.sentence
    assert quiet.details.added is None
    assert quiet.vehicle.calibration is not None
