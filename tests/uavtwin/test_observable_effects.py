"""What `check` says that `explain` can do with a file."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from twin.effects import EFFECTS, Average, Displacement, Equation, Shift
from twin.errors import LogError
from twin.explain.model.model import candidates
from twin.explain.model.numbers import observable_effects
from twin.logs import Flight, read_flight, write_flight
from twin.logs.columns import COLUMNS
from uavtwin.file_check import check_file


def whole() -> Flight:
    """A flight that has every column that a file may have."""
    names = [
        c.name.replace("{i}", str(i))
        for c in COLUMNS
        for i in (range(1, 5) if c.per_motor else (0,))
        if c.name not in ("time", "phase") and not c.name.endswith("_rad")
    ]
    time = 0.01 * np.arange(50)
    return Flight("whole", pd.DataFrame({"time": time} | dict.fromkeys(names, 0.5)))


def without(*stems: str) -> Flight:
    flight = whole()
    drop = [c for c in flight.table if c.startswith(stems)]
    return replace(flight, table=flight.table.drop(columns=drop))


@pytest.mark.parametrize(
    "stems", [(), ("mag_",), ("acc_", "gyro_"), ("acc_", "gyro_", "q_"), ("baro", "vbat", "ibat")]
)
def test_what_is_observable_is_what_the_search_looks_for(stems: tuple[str, ...]) -> None:
    flight = without(*stems)
    observable = observable_effects(flight)
    listed = {e for names in observable.effects.values() for e in names}
    unknown = {e for names in observable.unknown.values() for e in names}
    assert listed | unknown == {*EFFECTS}
    assert not listed & unknown
    mean = Average | Displacement | Equation | Shift
    steady = {n for n in listed if isinstance(EFFECTS[n].observable_as, mean)}
    assert steady == {e.name for e in candidates([flight], since=True)}


def test_the_missing_column_is_named() -> None:
    observable = observable_effects(without("mag_", "baro"))
    (compass,) = (why for why, names in observable.unknown.items() if "mag_hard_iron" in names)
    assert compass == "no mag_x, mag_y, mag_z"
    (thrust,) = (
        w
        for w, n in observable_effects(without("acc_", "q_")).unknown.items()
        if "mass_offset" in n
    )
    assert thrust == "no acc_x, acc_y, acc_z (or q with vel, pos or acc_ned)"


def test_without_commands_nothing_is_observable() -> None:
    observable = observable_effects(without("cmd_", "rotor_"))
    assert observable.effects == {}
    (why,) = observable.unknown
    assert why.startswith("neither commands")


def test_check_lists_it(tmp_path: Path) -> None:
    path = tmp_path / "f.parquet"
    write_flight(without("mag_", "acc_", "gyro_"), path)
    report = check_file(path)
    assert any(
        text.startswith("airframe: ") and "thrust_scale" in text for text in report.observable
    )
    assert any("accel_bias" in text and "acc_x" in text for text in report.not_observable)
    assert json.loads(json.dumps(report.json()))["observable"] == list(report.observable)
    assert any("explain cannot look for: " in text for _, text in report.lines())


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_recording_of_a_simulation_is_called_what_it_is(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"hover{suffix}"
    frame = pd.DataFrame({"time": [0.0, 0.01], "airframe.pos_x": 0.0, "imu.acc_x": 0.0})
    frame.to_csv(path, index=False) if suffix == ".csv" else frame.to_parquet(path, index=False)
    report = check_file(path)
    assert "recording of uavtwin simulate" in report.facts["format"]
    assert "airframe, imu" in report.facts["holds"]
    assert report.good_for == ()
    with pytest.raises(LogError, match="recording of uavtwin simulate"):
        read_flight(path)
