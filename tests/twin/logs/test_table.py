"""The flight table: definition, checks, files."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.errors import LogError
from twin.logs import Finding, Flight, read_flight, write_flight
from twin.logs.columns import COLUMNS, is_known, motor_columns


def table(n: int = 200, motors: int = 4) -> pd.DataFrame:
    """A quiet hover of 2 s at 1 m, every column present."""
    t = np.arange(n) * 0.01
    rng = np.random.default_rng(3)
    frame = pd.DataFrame({"time": t})
    for name in (*motor_columns("cmd", motors), *motor_columns("rotor", motors)):
        frame[name] = rng.uniform(0.3, 0.4, n) * (1.0 if name.startswith("cmd") else 1000.0)
    for group, mean in (("acc", (0, 0, -9.8)), ("gyro", (0, 0, 0)), ("pos", (0, 0, -1))):
        for axis, value in zip("xyz", mean, strict=True):
            frame[f"{group}_{axis}"] = value + 0.01 * rng.standard_normal(n)
    frame[["mag_x", "mag_y", "mag_z"]] = (2e-5, 0.0, 4e-5)
    frame["baro_pa"] = 101325.0
    frame[["vel_x", "vel_y", "vel_z"]] = 0.01 * rng.standard_normal((n, 3))
    frame[["q_w", "q_x", "q_y", "q_z"]] = (1.0, 0.0, 0.0, 0.0)
    frame[["vbat_v", "ibat_a"]] = (11.1, 8.0)
    frame.loc[1::2, ["baro_pa", "vbat_v"]] = np.nan
    frame["phase"] = pd.Series("hover", index=frame.index, dtype=object)
    frame.loc[:9, "phase"] = ""
    return frame


def read(frame: pd.DataFrame, folder: Path) -> Flight:
    """The frame written as CSV by somebody else, and read."""
    path = folder / "flight.csv"
    frame.to_csv(path, index=False)
    return read_flight(path)


def test_every_column_is_described() -> None:
    assert all(c.description for c in COLUMNS)
    assert {c.unit for c in COLUMNS} >= {"s", "m/s^2", "rad/s", "T", "Pa", "V", "A"}
    assert is_known("cmd_12")
    assert not is_known("cmd_0")
    assert not is_known("cmd_01")


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_round_trip_is_exact_to_the_bit(tmp_path: Path, suffix: str) -> None:
    flight = Flight(
        "f", table(), findings=(Finding("info", "acc", "three lost", 3),), facts={"vehicle": "x"}
    )
    path = tmp_path / f"f{suffix}"
    write_flight(flight, path)
    back = read_flight(path)
    pd.testing.assert_frame_equal(back.table, flight.table, check_exact=True)
    assert [f for f in back.findings if f.severity != "info"] == []
    if suffix == ".parquet":
        assert back.findings == flight.findings
        assert back.facts["vehicle"] == "x"


@pytest.mark.slow
@given(st.lists(st.floats(-1e12, 1e12), min_size=2, max_size=20, unique=True), st.data())
def test_any_numbers_survive_csv(
    tmp_path_factory: pytest.TempPathFactory, times: list[float], data: st.DataObject
) -> None:
    n = len(times)
    values = data.draw(st.lists(st.floats(-99.0, 99.0) | st.just(np.nan), min_size=n, max_size=n))
    if np.isnan(values).all():
        values[0] = 1.0
    frame = pd.DataFrame({"time": sorted(times), "gyro_x": values})
    path = tmp_path_factory.mktemp("t") / "f.csv"
    write_flight(Flight("f", frame), path)
    np.testing.assert_array_equal(read_flight(path).table[["time", "gyro_x"]], frame)


def test_a_clean_table_raises_no_doubt(tmp_path: Path) -> None:
    assert read(table(), tmp_path).findings == ()


@pytest.mark.parametrize(
    ("column", "wrong", "hint"),
    [
        ("acc_x", "acc_X", "Did you mean 'acc_x'"),
        ("gyro_z", "gyr_z", "Did you mean 'gyro_z'"),
        ("time", "times", "Did you mean 'time'"),
        ("cmd_2", "cmd_02", "Did you mean 'cmd_2'"),
        ("q_z", "q_zz", "Did you mean 'q_z'"),
    ],
)
def test_misspelt_column_names_the_right_one(
    tmp_path: Path, column: str, wrong: str, hint: str
) -> None:
    with pytest.raises(LogError, match=hint):
        read(table().rename(columns={column: wrong}), tmp_path)


def test_foreign_column_is_ignored_and_reported(tmp_path: Path) -> None:
    flight = read(table().assign(mood=1.0), tmp_path)
    assert "mood" not in flight.table
    assert [f.where for f in flight.findings] == ["mood"]


def broken(case: str) -> pd.DataFrame:
    """A table with one contradiction."""
    f = table()
    match case:
        case "backward":
            f.loc[50, "time"] = 0.2
        case "repeated":
            f.loc[50, "time"] = f.loc[49, "time"]
        case "no time":
            f.loc[50, "time"] = np.nan
        case "infinite":
            f.loc[7, "gyro_y"] = np.inf
        case "command":
            f["cmd_1"] *= 100.0
        case "pulse width":
            f["cmd_1"] = 1400.0
        case "hole":
            f = f.drop(columns="cmd_2")
        case "count":
            f = f.drop(columns="rotor_4")
        case "quaternion":
            f.loc[3, "q_w"] = 0.5
        case "half attitude":
            f = f.drop(columns="q_y")
        case "text":
            f["acc_y"] = f["acc_y"].astype(object)
            f.loc[4, "acc_y"] = "n/a"
        case "phase":
            f.loc[5, "phase"] = "Hover"
        case "no motion":
            f = f[["time", "cmd_1", "cmd_2", "cmd_3", "cmd_4", "baro_pa"]]
        case "no sample":
            f = f[["time", "gyro_x"]].assign(gyro_x=np.nan)
        case "no rows":
            f = f.iloc[:0]
    return f


@pytest.mark.parametrize(
    ("case", "text"),
    [
        ("backward", r"runs backward in data row 51: 0.2 s after 0.49 s"),
        ("repeated", r"repeats in data row 51"),
        ("no time", r"time in data row 51 is nan"),
        ("infinite", r"gyro_y in data row 8 is infinite"),
        ("command", r"cmd_1 in data row \d+ is .* outside 0..1.*percent"),
        ("pulse width", r"cmd_1 in data row 1 is 1400, outside 0..1.*PWM_MIN"),
        ("hole", r"cmd_2 is not"),
        ("count", r"4 commands but 3 rotor speeds"),
        ("quaternion", r"quaternion in data row 4 has norm 0.5"),
        ("half attitude", r"lacks q_y"),
        ("text", r"acc_y in data row 5 is 'n/a', not a number"),
        ("phase", r"unknown phase 'Hover' in data row 6.*Did you mean 'hover'"),
        ("no motion", r"no motion signal"),
        ("no sample", r"have no sample"),
        ("no rows", r"no row"),
    ],
)
def test_contradiction_names_place_and_value(tmp_path: Path, case: str, text: str) -> None:
    with pytest.raises(LogError, match=text):
        read(broken(case), tmp_path)


def doubtful(case: str) -> pd.DataFrame:
    """A table that is formally right but in the wrong unit or frame."""
    f = table()
    match case:
        case "acc":  # in g
            f[["acc_x", "acc_y", "acc_z"]] /= 9.80665
        case "acc up":  # FLU
            f["acc_z"] *= -1.0
        case "gyro":  # in degrees per second
            f["gyro_x"] = 60.0 * np.sin(f["time"])
        case "rotor":  # in rpm
            f[list(motor_columns("rotor", 4))] *= 30.0 / np.pi * 1.5
        case "mag":  # in gauss
            f[["mag_x", "mag_y", "mag_z"]] *= 1e4
        case "baro_pa":  # in hPa
            f["baro_pa"] /= 100.0
        case "pos":  # height instead of z down
            f["pos_z"] *= -1.0
            f.loc[:50, ["phase", "pos_z"]] = ("ground", 0.0)
        case "vel":
            f["pos_z"] = -1.0 + 0.5 * np.sin(3 * f["time"])
            f["vel_z"] = -1.5 * np.cos(3 * f["time"])
        case "time":  # in milliseconds
            f["time"] = np.arange(len(f)) * 10.0
    return f


@pytest.mark.slow
@pytest.mark.parametrize(
    "case", ["acc", "acc up", "gyro", "rotor", "mag", "baro_pa", "pos", "vel", "time"]
)
def test_wrong_unit_or_frame_becomes_a_finding(tmp_path: Path, case: str) -> None:
    findings = read(doubtful(case), tmp_path).findings
    errors = [f.where for f in findings if f.severity == "error"]
    assert errors == case.split(maxsplit=1)[:1]
    if case != "time":  # its constant attitude and magnetic field stand still for seconds
        assert len(findings) == 1


def test_slightly_long_quaternions_are_normalised_and_counted(tmp_path: Path) -> None:
    frame = table()
    frame.loc[10:19, "q_w"] = 1.01
    flight = read(frame, tmp_path)
    assert [(f.where, f.count) for f in flight.findings] == [("q", 10)]
    assert flight.table["q_w"].max() == pytest.approx(1.0)


def test_empty_cells_are_gaps(tmp_path: Path) -> None:
    path = tmp_path / "f.csv"
    path.write_text("time,gyro_x,vbat_v,phase\n0,1,,\n0.1,,11.1,hover\n0.2,2,nan,\n")
    flight = read_flight(path)
    t, x = flight.signal(["gyro_x"])
    assert t.tolist() == [0.0, 0.2]
    assert x[:, 0].tolist() == [1.0, 2.0]
    assert flight.table["phase"].tolist() == ["", "hover", ""]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,gyro_x\n0,1\n0.1,2,3\n", "data row 2 has 3 fields"),
        ("time,gyro_x\n0,1\n0.1\n", "data row 2 has 1 fields"),
        ("time;gyro_x\n0;1\n", "separated by commas"),
        ("time,gyro_x,gyro_x\n0,1,1\n", "stands there twice"),
        ("time,gyro_x\n", "no row"),
        ("time", "no row below"),
        ("time,gyro_x\n0,\xff\n", "not UTF-8"),
    ],
)
def test_malformed_csv(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "f.csv"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(LogError, match=message):
        read_flight(path)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_table_cut_anywhere_is_read_or_refused(tmp_path: Path, suffix: str) -> None:
    whole = tmp_path / f"whole{suffix}"
    write_flight(Flight("f", table(30)), whole)
    blob = whole.read_bytes()
    path = tmp_path / f"cut{suffix}"
    read_back = 0
    for size in range(0, len(blob), max(len(blob) // 60, 1)):
        path.write_bytes(blob[:size])
        try:
            flight = read_flight(path)
        except LogError as error:
            assert path.name in str(error)
        else:
            read_back += 1
            if not blob[:size].endswith(b"\n"):
                assert any("cut short" in f.message for f in flight.findings)
            n = len(flight.table)
            pd.testing.assert_frame_equal(
                flight.table.drop(columns=["phase"]), table(30).drop(columns=["phase"]).iloc[:n]
            )
    assert (read_back > 30) == (suffix == ".csv")


def test_only_known_endings_are_written(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"parquet or \.csv"):
        write_flight(Flight("f", table()), tmp_path / "f.xlsx")
    with pytest.raises(LogError, match="cannot be written"):
        write_flight(Flight("f", table()), tmp_path / "nowhere" / "f.csv")


def test_vectors_with_holes_are_counted(tmp_path: Path) -> None:
    """A NaN inside a vector costs the whole vector there, and the reader says so."""
    n = 50
    table = pd.DataFrame({"time": np.arange(n) * 0.01, "acc_x": 0.0, "acc_y": 0.0, "acc_z": -9.8})
    table.loc[10:14, "acc_y"] = np.nan
    table.loc[20:29, ["acc_x", "acc_y", "acc_z"]] = np.nan  # no sample: nothing wrong
    table.to_parquet(tmp_path / "holes.parquet")
    findings = [f for f in read_flight(tmp_path / "holes.parquet").findings if f.where == "acc"]
    assert [(f.severity, f.count) for f in findings] == [("error", 5)]
