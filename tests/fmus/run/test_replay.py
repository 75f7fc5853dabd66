"""Replay against NumPy, at and between samples, in gaps, outside the record, on damaged files."""

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from instance import Array, Instance, unzip
from kinds import recorded, replay_example

from fmus import build, replay_model
from twin.errors import LogError

FmuFile = Callable[[str, int], Path]
SIGNALS = ("cmd_1", "baro_pa")  # held, linear
SIZE = 1e6  # of the values
GRID_S = 1 / 64  # times that add up without rounding


def reference(time: Array, value: Array, linear: bool, t: float) -> tuple[float, bool]:
    """Value and validity of a signal at one instant."""
    gap = 5 * float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    if t < time[0]:
        return value[0], False
    j = int(np.searchsorted(time, t, side="right")) - 1
    if not linear or j == len(time) - 1:
        return value[j], bool(t - time[j] <= gap)
    if time[j + 1] - time[j] > gap:
        return value[j], t == time[j]
    return float(np.interp(t, time[j : j + 2], value[j : j + 2])), True


@pytest.fixture(scope="module")
def folders(fmu_file: FmuFile, tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """Extracted replay FMUs whose records the tests replace."""
    return {
        fmi: unzip(fmu_file("replay", fmi), tmp_path_factory.mktemp("100%d") / str(fmi))
        for fmi in (2, 3)
    }


def query(instance: Instance, t: float) -> list[tuple[float, bool]]:
    """Start the FMU anew at an instant and read it."""
    instance.fmu.reset()
    instance.start(time_s=t)
    return [(instance.get(n), bool(instance.get(f"valid.{n}"))) for n in SIGNALS]


def close(got: tuple[float, bool], wanted: tuple[float, bool]) -> bool:
    """Equal to rounding of the largest values: two formulas of one straight line."""
    return got[1] == wanted[1] and got[0] == pytest.approx(wanted[0], rel=1e-14, abs=1e-15 * SIZE)


tables = st.lists(
    st.tuples(
        st.integers(1, 12), st.floats(-SIZE, SIZE), st.sampled_from(["both", "held", "linear"])
    ),
    min_size=2,
    max_size=25,
)


@pytest.mark.slow
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(tables, st.lists(st.integers(-40, 1200), min_size=1, max_size=20), st.sampled_from([2, 3]))
def test_any_record_at_any_time(
    folders: dict[int, Path],
    rows: list[tuple[int, float, str]],
    instants: list[int],
    fmi: int,
) -> None:
    """Uneven sampling, signals with samples in different rows, queries in any order."""
    time = np.cumsum([r[0] for r in rows]) * 4 * GRID_S
    value = {s: np.array([r[1] for r in rows]) for s in SIGNALS}
    value["cmd_1"][[r[2] == "linear" for r in rows]] = np.nan
    value["baro_pa"][[r[2] == "held" for r in rows]] = np.nan
    if any(np.isnan(v).all() for v in value.values()):
        return
    model = replay_model(recorded(time=time, **value), SIGNALS, linear=("baro_pa",))
    (folders[fmi] / "resources/record.bin").write_bytes(model.resources["record.bin"])
    instance = Instance(folders[fmi])
    try:
        known = {s: (time[~np.isnan(v)], v[~np.isnan(v)]) for s, v in value.items()}
        for t in (*(GRID_S * np.array(instants)), *time):
            wanted = [reference(*known[s], s == "baro_pa", t) for s in SIGNALS]
            got = query(instance, float(t))
            assert all(map(close, got, wanted)), (t, got, wanted)
        # The same walking forward, where the FMU remembers its place.
        t = GRID_S * min(instants)
        instance.fmu.reset()
        instance.start(time_s=t)
        for n in instants:
            h = GRID_S * (1 + abs(n) % 50)
            instance.step(t, h)
            t += h
            for s in SIGNALS:
                got_now = instance.get(s), bool(instance.get(f"valid.{s}"))
                assert close(got_now, reference(*known[s], s == "baro_pa", t)), (s, t)
    finally:
        instance.close()


@pytest.mark.parametrize("fmi", [2, 3])
def test_samples_come_back_to_the_bit(new: Callable[[str, int], Instance], fmi: int) -> None:
    """At the times k * 0.01 s as a master computes them, with their rounding errors."""
    instance = new("replay", fmi).start()
    record = np.frombuffer(replay_example().resources["record.bin"])
    count = struct.unpack("<Q", record[2].tobytes())[0]
    time, value = record[5 : 5 + count], record[5 + count : 5 + 2 * count]
    assert instance.get("cmd_1") == value[0]
    for k in range(1, count):
        instance.step((k - 1) * 0.01, 0.01)
        assert abs(k * 0.01 - time[k]) < 1e-12
        assert instance.get("cmd_1") == value[k]


@pytest.mark.parametrize("fmi", [2, 3])
def test_before_after_and_in_a_gap(folders: dict[int, Path], fmi: int) -> None:
    """10 Hz from 1 s on, nothing between 2 and 4 s, end at 5 s; five intervals are bridged."""
    time = np.concatenate([np.arange(10, 21), np.arange(40, 51)]) / 10
    flight = recorded(time=time, cmd_1=time / 10, baro_pa=1000 * time)
    model = replay_model(flight, SIGNALS, linear=("baro_pa",))
    (folders[fmi] / "resources/record.bin").write_bytes(model.resources["record.bin"])
    instance = Instance(folders[fmi])
    expected = {  # time: held, valid, linear, valid
        0.5: (0.1, 0, 1000, 0),
        1.0: (0.1, 1, 1000, 1),
        1.25: (0.12, 1, 1250, 1),
        2.0: (0.2, 1, 2000, 1),
        2.4: (0.2, 1, 2000, 0),
        2.6: (0.2, 0, 2000, 0),
        3.99: (0.2, 0, 2000, 0),
        4.0: (0.4, 1, 4000, 1),
        5.4: (0.5, 1, 5000, 1),
        5.6: (0.5, 0, 5000, 0),
    }
    got = {t: [x for pair in query(instance, t) for x in pair] for t in expected}
    instance.close()
    for t, wanted in expected.items():
        assert got[t] == pytest.approx(wanted, rel=1e-12), t


def refusal(folder: Path, fmi: int) -> str:
    """The message with which an FMU declines to be instantiated."""
    instance = Instance(folder, instantiated=False)
    with pytest.raises(Exception, match="Failed to instantiate"):
        instance.instantiate()
    instance.fmu.freeLibrary()
    (message,) = instance.messages
    return message


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
def test_damaged_record_is_refused(folders: dict[int, Path], fmi: int) -> None:
    good = replay_example().resources["record.bin"]
    path = folders[fmi] / "resources/record.bin"
    lies = {  # word -> value
        0: b"UAVTWIN2",
        1: struct.pack("<Q", 3),
        2: struct.pack("<Q", 0),
    }
    lengths = [*range(0, 48), *range(48, len(good), 97), len(good) - 8, len(good) - 1]
    damaged = [good[:n] for n in lengths]
    damaged += [good[: 8 * w] + v + good[8 * w + 8 :] for w, v in lies.items()]
    damaged += [
        good[:16] + struct.pack("<Q", huge) + good[24:] for huge in (201, 2**61, 2**63, 2**64 - 1)
    ]
    for content in damaged:
        path.write_bytes(content)
        message = refusal(folders[fmi], fmi)
        # FMI 2 loggers get a printf format, so the percent sign of the folder comes doubled.
        shown = message % () if fmi == 2 else message
        assert "100%d" in shown
        assert shown.endswith("record.bin is damaged or belongs to another FMU"), len(content)
    path.unlink()
    assert "cannot open the recorded flight" in refusal(folders[fmi], fmi)
    path.write_bytes(good)
    Instance(folders[fmi]).close()


def test_columns_are_checked() -> None:
    flight = recorded(time=[0.0, 1.0], cmd_1=[0.1, 0.2], baro_pa=[np.nan, np.nan])
    with pytest.raises(LogError, match=r"no samples of baro_pa"):
        replay_model(flight, ("cmd_1", "baro_pa"))
    with pytest.raises(LogError, match=r"cannot interpolate \['baro_pa'\]: not replayed"):
        replay_model(flight, ("cmd_1",), linear=("baro_pa",))


def test_units_come_from_the_flight_table(tmp_path: Path) -> None:
    flight = recorded(time=[0.0, 1.0], acc_z=[-9.8, -9.7], rotor_12=[300.0, 310.0])
    model = replay_model(flight, ("acc_z", "rotor_12"))
    assert [v.unit for v in model.variables[:2]] == ["m/s2", "rad/s"]
    assert (
        model.variables[1].description == "Recorded measured speed of rotor i, not negative, i = 12"
    )
    build(model, tmp_path / "r.fmu")
