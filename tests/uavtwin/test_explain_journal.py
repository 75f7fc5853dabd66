"""A run of `explain` that is killed goes on where its search was, to the same bytes."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_rig import run

from twin.explain.inference import search
from twin.explain.inference.search import SearchPoint
from twin.logs import write_flight
from twin.vehicle_file import load_vehicle
from uavtwin import vehicles
from uavtwin.demo.flights import Waypoints, fly
from uavtwin.explain_journal import JOURNAL, ExplainJournal, run_key
from uavtwin.serve.work import LogWork

pytestmark = pytest.mark.slow
COPTER = load_vehicle("copter_default")
DRAGGED = replace(
    COPTER, drag_linear_n_s_m=COPTER.drag_linear_n_s_m + 0.6 * np.array([1.0, 1.0, 0.0])
)
LEGS: Waypoints = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 3.0, (0.0, 0.0, -1.0)),
    ("forward", 2.0, (2.0, 1.0, -1.0)),
    ("forward", 2.0, (0.0, 0.0, -1.3)),
    ("hover", 1.5, (0.0, 0.0, -1.3)),
)
Steps = list[tuple[str, ...]]
Explained = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A flight with rotor drag that the twin lacks."""
    path = tmp_path_factory.mktemp("logs") / "one.parquet"
    write_flight(fly(COPTER, DRAGGED, 1, "one", LEGS), path)
    return path


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> Steps:
    """The set that each step of a search begins with, as the steps are done."""
    done: Steps = []
    real = search._move

    def move(problem: Any, laplace: Any, at: SearchPoint, last: bool) -> Any:
        done.append(at.state.effects)
        return real(problem, laplace, at, last)

    monkeypatch.setattr(search, "_move", move)
    monkeypatch.setattr("twin.flight.closed_loop.mission_names", lambda: ("takeoff",))
    return done


@pytest.fixture
def explained(capsys: pytest.CaptureFixture[str], log: Path) -> Explained:
    """The verb on the flight, into a folder."""

    def explained(out: Path, *more: object) -> tuple[int, str, str]:
        given = ("--vehicle", "copter_default", "--indoor", "--no-fmus", "--out", out)
        return run(capsys, "explain", log, *given, *more)

    return explained


def interrupted(patch: pytest.MonkeyPatch, after: int) -> None:
    """From now on a search ends after so many points."""
    real, kept = ExplainJournal.keep, []

    def keep(self: ExplainJournal, point: SearchPoint) -> SearchPoint:
        kept.append(real(self, point))
        if len(kept) == after:
            raise KeyboardInterrupt
        return kept[-1]

    patch.setattr(ExplainJournal, "keep", keep)


def results(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.is_file()}


def test_a_run_that_is_killed_goes_on_to_the_same_bytes(
    explained: Explained, steps: Steps, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    assert explained(whole)[0] == 1
    unbroken = list(steps)
    assert len(unbroken) > 1 and JOURNAL not in results(whole)
    steps.clear()
    with monkeypatch.context() as patch:
        interrupted(patch, 2)  # the start and a step
        assert explained(broken)[0] == 130
    assert list(results(broken)) == [JOURNAL]
    code, _, said = explained(broken)
    assert code == 1 and "moves so far: 1" in said
    assert steps == unbroken
    assert results(broken) == results(whole)
    code, _, said = explained(broken)
    assert code == 2 and "not empty" in said


def test_another_run_begins_anew_and_says_so(
    explained: Explained, steps: Steps, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        interrupted(patch, 2)
        explained(tmp_path)
        steps.clear()
        interrupted(patch, 2)
        assert "other flights, vehicle, options or version" in explained(tmp_path, "--seed", 1)[2]
        assert steps[0] == ()
        (tmp_path / JOURNAL).write_bytes((tmp_path / JOURNAL).read_bytes()[:-100])
        interrupted(patch, 2)
        assert "is damaged" in explained(tmp_path, "--seed", 1)[2]


def test_a_job_of_the_page_that_is_killed_goes_on(
    log: Path, steps: Steps, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = {"kind": "explain", "log": log, "folder": tmp_path, "flight": "f" * 64}
    job |= {"vehicle": "copter_default"}
    with monkeypatch.context() as patch:
        interrupted(patch, 2)
        with pytest.raises(KeyboardInterrupt):
            LogWork(1 << 30).do(job)
    done = len(steps)
    assert done == 1
    assert "rotor drag" in LogWork(1 << 30).do(job)["note"]["explain_text"]
    assert steps[0] == () and () not in steps[done:]
    assert not (tmp_path / JOURNAL).exists()


def test_a_point_that_comes_back_is_written_as_it_was(
    explained: Explained, steps: Steps, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, written = ExplainJournal.keep, []

    def keep(self: ExplainJournal, point: SearchPoint) -> SearchPoint:
        for _ in range(2):
            point = real(self, point)
            written.append((tmp_path / JOURNAL).read_bytes())
        return point

    with monkeypatch.context() as patch:
        patch.setattr(ExplainJournal, "keep", keep)
        interrupted(patch, 2)
        explained(tmp_path)
    assert len(written) == 4
    assert written[0] == written[1] != written[2] == written[3]


def test_a_mapping_and_the_sources_are_of_the_key(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = tmp_path / "day.mcap"
    bag.write_bytes(b"bag")

    def key() -> str:
        return run_key([bag], [], vehicles.load_vehicle("copter_default"), ())

    alone = key()
    (tmp_path / "day.topics.toml").write_text("one")
    one = key()
    (tmp_path / "day.topics.toml").write_text("two")
    two = key()
    assert two == key()
    monkeypatch.setattr("uavtwin.explain_journal._sources_hash", lambda: "of another state")
    assert len({alone, one, two, key()}) == 4
