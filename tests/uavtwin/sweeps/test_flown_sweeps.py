"""Sweeps that are flown: the same as single runs, whatever engine, order, kill or crash."""

import json
import shlex
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pandas as pd
import pytest
from bad_fmu import bad_fmu
from cli_rig import run
from job_rigs.killing import killed_beyond
from page_rigs.browser import VIEWS, browser, faults, needs_browser, pictures

import uavtwin as ut
from cosim.lanes import LaneMaster
from cosim.ssp import write_ssp
from cosim.system import System
from fmus.lanes import LANES
from twin.errors import FmuError, TwinError
from uavtwin.sweeps.outcome import JOURNAL, Journal
from uavtwin.sweeps.plan import Job
from uavtwin.sweeps.sweep import WORTH, RunWorker, blocks

pytestmark = pytest.mark.slow
VARY = {
    "airframe.mass": {"low": 1.2, "high": 1.7},
    "wind.speed": {"low": 0.0, "high": 6.0},
    "wind.from": {"low": 0.0, "high": 360.0},
    "gusts": [True, False],
    "controller": ["lqr", "px4"],
}
RUNS, SECONDS = 10, 6.0


def swept(out: Path, workers: int = 2) -> ut.SweepResult:
    return ut.sweep("tour", out=out, vary=VARY, runs=RUNS, duration=SECONDS, workers=workers)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("sweep") / "out"
    swept(out)
    return out


@pytest.fixture(scope="module")
def table(folder: Path) -> pd.DataFrame:
    return pd.read_parquet(folder / "runs.parquet")


def test_every_run_has_a_row_with_its_factors(folder: Path, table: pd.DataFrame) -> None:
    assert table["run"].tolist() == list(range(RUNS))
    assert {*VARY} <= {*table.columns}
    assert table["airframe.mass"].between(1.2, 1.7).all()
    assert {*table["controller"]} == {"lqr", "px4"}
    assert table["tracking_rms_m"].nunique() == RUNS  # every one flies another flight
    assert {p.name for p in folder.iterdir()} == {"runs.parquet", "report.html", "sweep.json"}


def test_a_row_is_what_the_command_beside_it_flies(
    folder: Path, table: pd.DataFrame, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """At the usual 1 ms, where the sweep steps by 10 ms, which inside are 1 ms: the same bits."""
    result = swept(tmp_path / "again")
    pick = int(table.index[table["controller"] == "px4"][0])
    _, verb, *arguments = shlex.split(result.again(pick))
    code, out, _ = run(
        capsys, verb, *arguments, "--stop", SECONDS, "--out", tmp_path / "flown", "--json"
    )
    assert code == 0
    told = json.loads(out)
    for name in ("tracking_rms_m", "tracking_worst_m", "tilt_worst_rad"):
        assert told[name] == table.loc[pick, name], name
    assert told["end_pos_m"] == table.loc[pick, [f"end_pos_{a}_m" for a in "xyz"]].tolist()


def test_the_number_of_workers_changes_no_byte(folder: Path, tmp_path: Path) -> None:
    for workers in (1, 3):
        out = tmp_path / str(workers)
        swept(out, workers)
        for name in ("runs.parquet", "sweep.json", "report.html"):
            assert (out / name).read_bytes() == (folder / name).read_bytes(), (workers, name)


def test_runs_in_lanes_are_those_one_by_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With any number of workers, and where a block of lanes has to be flown again."""
    vary = {k: v for k, v in VARY.items() if k != "controller"} | {
        "effect.rotor_drag": [True, False]
    }

    def flown(name: str, workers: int) -> list[bytes]:
        """The files of a sweep, of which the last block is short."""
        out = tmp_path / name
        ut.sweep("tour", out=out, vary=vary, runs=WORTH + 3, duration=2.0, workers=workers)
        return [(out / file).read_bytes() for file in ("runs.parquet", "sweep.json")]

    with monkeypatch.context() as patched:
        patched.setattr(RunWorker, "_alone", None)  # no run goes by itself
        lanes = [flown(f"lanes {workers}", workers) for workers in (1, 2, 4)]
    with monkeypatch.context() as patched:
        patched.setattr("uavtwin.sweeps.sweep.WORTH", 10**6)
        patched.setattr("uavtwin.sweeps.sweep.LaneMaster", None)  # no run goes with others
        alone = flown("alone", 2)
    with monkeypatch.context() as patched:
        patched.setattr(LaneMaster, "run", failing)
        again = flown("again", 2)
    assert lanes == [alone] * 3
    assert again == alone


def failing(*_: object) -> None:
    raise FmuError("lanes: one of them")


def test_lanes_are_of_one_system_and_alike() -> None:
    few = [Job(k, 0, {}) for k in range(WORTH - 1)]
    many = [
        Job(100 + k, 1, {"a.drag.enabled": float(k % 2), "a.mass": 1.0 + k}) for k in range(WORTH)
    ]
    found = list(blocks([*many, *few]))
    assert sorted(job.run for block in found for job in block) == [j.run for j in [*few, *many]]
    assert [len(block) for block in found] == [1] * len(few) + [LANES] * (WORTH // LANES)
    for block in found:
        assert len({(job.stand, job.starts.get("a.drag.enabled")) for job in block}) == 1


COMMAND = [
    *(sys.executable, "-c", "from uavtwin.cli.main import main; main()"),
    *("sweep", "tour", "--vary", "airframe.mass=1.2:1.7", "--runs", "40", "--duration", "4"),
]


def test_a_killed_sweep_goes_on_and_loses_nothing(tmp_path: Path) -> None:
    subprocess.run([*COMMAND, "--out", tmp_path / "whole"], check=True, capture_output=True)
    out = tmp_path / "killed"
    for wanted in (3, 11, 25):
        assert killed_beyond([*COMMAND, "--out", out], out / JOURNAL, wanted)
    with (out / JOURNAL).open("a") as journal:
        journal.write('{"run": 39, "outco')  # a kill in the middle of a line
    subprocess.run([*COMMAND, "--out", out], check=True, capture_output=True)
    for name in ("runs.parquet", "sweep.json", "run.json"):
        assert (out / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    assert not (out / JOURNAL).exists()


def test_an_aircraft_that_cannot_carry_itself_is_lost(tmp_path: Path) -> None:
    made = ut.sweep("hover", out=tmp_path, vary={"airframe.mass": [1.4, 9.0]}, method="grid")
    assert made.table["outcome"].tolist() == ["flown", "lost"]
    assert made.table.loc[1, "why"].startswith("stayed down: rose 0.")
    assert made.worst()["run"].tolist() == [1, 0]


def test_two_sweeps_do_not_write_into_one_folder(tmp_path: Path) -> None:
    with (
        closing(Journal(tmp_path / JOURNAL, "one")),
        pytest.raises(TwinError, match="another sweep is writing it"),
    ):
        Journal(tmp_path / JOURNAL, "one")
    Journal(tmp_path / JOURNAL, "one").close()  # what has ended goes on


def test_another_sweep_does_not_go_on_there(tmp_path: Path) -> None:
    (tmp_path / JOURNAL).write_text('{"sweep": "of somebody"}\n')
    with pytest.raises(TwinError, match="is of another sweep, which was not finished"):
        swept(tmp_path)
    (tmp_path / JOURNAL).write_text("nonsense\n")
    with pytest.raises(TwinError, match="line 1 is not of a sweep"):
        swept(tmp_path)


@pytest.mark.parametrize(
    ("vary", "says"),
    [
        ({"airframe.mas": {"low": 1.0, "high": 2.0}}, "Did you mean 'mass'?"),
        ({"airframe.mass": {"low": -1.0, "high": 2.0}}, "is outside its range"),
        ({"mission": ["tour", "tuor"]}, "there is no mission 'tuor'"),
        ({"vehicle": ["copter_defult"]}, "copter_default"),
    ],
)
def test_what_cannot_be_flown_is_refused_before_anything_is(
    vary: dict[str, object], says: str, tmp_path: Path
) -> None:
    with pytest.raises(TwinError) as caught:
        ut.sweep("tour", out=tmp_path / "out", vary=vary, runs=4)
    assert says in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_a_crash_costs_the_run_in_which_it_happens(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    system = System({"segv": bad_fmu(tmp_path)}, stop_time_s=1.0, step_s=0.1)
    ssp = write_ssp(system, tmp_path / "crashes.ssp")
    arguments = ("--vary", "segv.bad=0,0,0,0,1", "--runs", 20, "--out", tmp_path / "out")
    code, said, _ = run(capsys, "sweep", ssp, *arguments)
    assert code == 1  # findings
    table = pd.read_parquet(tmp_path / "out" / "runs.parquet")
    crashed = table["segv.bad"] == 1
    assert crashed.sum() == 4
    assert (table["outcome"][crashed] == "failed").all()
    assert table["why"][crashed].str.contains("ended with signal SIGSEGV").all()
    assert (table["outcome"][~crashed] == "run").all()
    assert (table["end.segv.y"][~crashed] == 10).all()  # its last step
    assert (table["end.segv.y"][crashed] == 4).all()  # as far as it came
    assert "20 runs, 16 run, 4 failed" in said


def test_recordings_are_those_of_their_runs(tmp_path: Path) -> None:
    vary = {"airframe.mass": [1.3, 1.5]}
    made = ut.sweep("hover", out=tmp_path / "o", vary=vary, runs=4, duration=3, recordings=True)
    files = sorted((tmp_path / "o" / "recordings").iterdir())
    assert [f.name for f in files] == [f"run_{k:06d}.parquet" for k in range(4)]
    last = pd.read_parquet(files[2]).iloc[-1]
    assert last["twin.airframe.pos_z"] == made.table.loc[2, "end_pos_z_m"]
    assert last["time"] == 3


@needs_browser
def test_the_page_is_fine_to_look_at(folder: Path, tmp_path: Path) -> None:
    with browser(tmp_path / "browser") as opened:
        for view in VIEWS:
            picture = pictures(tmp_path) / f"sweep_{view}.png"
            assert faults(opened, folder / "report.html", view, picture) == []
    assert (folder / "report.html").stat().st_size < 1_500_000
