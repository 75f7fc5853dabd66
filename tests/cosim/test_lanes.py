"""Several runs at once: each the same as the FMU in the master, to the last bit."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from kinds import replay_example
from msgspec import json

from benchmarks.lanes import Compared, compared, design, different, same, switches
from cosim.lanes import LaneMaster
from cosim.master import Master
from cosim.system import System
from fmus import build
from fmus.lanes import LANES
from twin.errors import FmuError
from twin.flight.assembly import flying_twin
from twin.vehicle_file import load_vehicle
from uavtwin.simulation import Scenario, scenario_system

VEHICLE = load_vehicle("copter_default")
TWIN = flying_twin(VEHICLE, "tour", "lqr")


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> System:
    """The whole twin in one FMU."""
    folder = tmp_path_factory.mktemp("fmu")
    return scenario_system(Scenario("tour", VEHICLE, fused=True), folder)


def unlike(
    system: System, first: int, blocks: int, seconds: float, lanes: int = LANES
) -> list[list[dict[str, float]]]:
    """Of each block the random aircraft whose outputs in a lane are not those of the FMU."""
    return [*different(TWIN, system, range(first, first + blocks), seconds, lanes)]


def test_each_lane_is_the_fmu(system: System) -> None:
    assert len(switches(TWIN)) > 30
    assert unlike(system, first=0, blocks=4, seconds=1.5) == [[]] * 4


@pytest.mark.slow
def test_each_of_hundreds_of_lanes_is_the_fmu(system: System) -> None:
    """On the ground, through the climb and in turns."""
    assert unlike(system, first=1000, blocks=48, seconds=4.0) == [[]] * 48


@pytest.mark.slow
@pytest.mark.parametrize("lanes", [1, 2, 3, 4, 16])
def test_as_many_lanes_as_one_likes(system: System, lanes: int) -> None:
    assert unlike(system, first=2000, blocks=4, seconds=1.0, lanes=lanes) == [[]] * 4


@pytest.mark.slow
def test_the_other_controller(tmp_path: Path) -> None:
    other = scenario_system(Scenario("tour", VEHICLE, controller="px4", fused=True), tmp_path)
    assert unlike(other, first=3000, blocks=8, seconds=4.0) == [[]] * 8


def test_fewer_runs_than_lanes_and_rows_now_and_then(system: System) -> None:
    starts = [design(TWIN, np.random.default_rng(k), 0.1) for k in range(3)]
    record = ("twin.airframe.pos_z", "twin.imu.gyro_x", "twin.mission.phase")
    flown = LaneMaster(system, record).run(starts, 0.5, 1.5, 0.002, every=7)
    assert len(flown) == len(starts)
    with Master(system, record) as master:
        for own, recording in zip(starts, flown, strict=True):
            master.initialize(0.5, own)
            assert same(master.run(1.5, 0.002, every=7), recording)


@pytest.mark.parametrize(
    ("starts", "says"),
    [
        ({"twin.airframe.mass": -1.0}, "airframe.mass = -1 is below its minimum"),
        ({"twin.airframe.vel_z": np.nan}, "no number"),
        ({"twin.imu.sample_period": 0.002}, "one lane samples every 0.00"),
    ],
)
def test_what_one_lane_cannot_do_is_said(
    system: System, starts: dict[str, float], says: str
) -> None:
    with pytest.raises(FmuError, match=re.escape(says)):
        LaneMaster(system).run([{}, starts], 0.0, 0.1, 0.01)


def test_what_cannot_be_flown_in_lanes_says_why(
    system: System, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    replayed = System({"replay": build(replay_example(), tmp_path / "replay.fmu")})
    with pytest.raises(FmuError, match=r"replay\.fmu: flies one aircraft at a time: .*replay\.h"):
        LaneMaster(replayed)
    with pytest.raises(FmuError, match="one FMU of ours"):
        LaneMaster(replace(system, foreign=True))
    monkeypatch.setattr("fmus.lanes.machine_compiler", lambda: None)
    with pytest.raises(FmuError, match="no C compiler for the processor"):
        LaneMaster(system, lanes=5)


def test_a_journal_torn_by_a_kill_is_used_up_to_its_last_line(tmp_path: Path) -> None:
    journal, blocks = tmp_path / "journal", [Compared(0, "a", ()), Compared(1, "a", ({"x": 1.0},))]
    assert compared(journal) == []
    whole = b"".join(json.encode(b) + b"\n" for b in blocks)
    journal.write_bytes(whole + whole[:9])
    assert compared(journal) == blocks and journal.read_bytes() == whole
