"""Observers and envelopes of a flight that is left out, against a drag that is known exactly."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from learning.data.envelope import BEYOND
from learning.force.forecast import AHEAD_S, NEVER_S, NO_OBSERVER, Observer
from learning.force.instants import inputs_of, instants
from learning.force.laws import Candidate, prepare
from twin.physics.residual_force import FEATURES, OUTPUTS
from twin.residuals.teacher_forced import choose_drive
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import Waypoints, fly
from uavtwin.force.learn import (
    ALONE_S,
    OBSERVER,
    WIDER,
    Choice,
    Fold,
    Lesson,
    accepted,
    chosen_observers,
)
from uavtwin.force.memory import Memory
from uavtwin.force.open_loop import DISTANCE, Replay

COPTER = load_vehicle("copter_default")
DRAGGED = replace(
    COPTER,
    drag_linear_n_s_m=COPTER.drag_linear_n_s_m + 0.6 * COPTER.mass_kg * np.array([1.0, 1.0, 0.0]),
)
QUICK = Observer(0.05, 0.5)
"""Takes what noise says for what stays."""
ROUND: Waypoints = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 2.5, (0.0, 0.0, -2.0)),
    ("tour", 3.5, (6.0, 3.0, -2.0)),
    ("tour", 3.5, (-3.0, -2.0, -2.5)),
)


def _fold(plant: Vehicle, observer: Observer, place: Path, memory: Memory) -> Fold:
    """A flight of a plant, and a twin of COPTER with this observer of every output."""
    flight = fly(COPTER, plant, 1, "one", ROUND)
    seen = instants(flight, COPTER)
    prepared = prepare([seen], COPTER)
    fitted = [{"none": Candidate("none", np.zeros(len(prepared.size)), 0.0, observer)}]
    lesson = Lesson(
        prepared, len(OUTPUTS) * fitted, choose_drive(flight, COPTER), place / "twin.fmu"
    )
    return Fold(Replay(flight, COPTER, AHEAD_S), lesson, memory)


def _used(lesson: Lesson) -> list[str]:
    """Outputs that have an observer."""
    found = lesson.chosen(["none"] * len(OUTPUTS))
    return [
        f"{kind} {a}"
        for (kind, a), c in zip(OUTPUTS, found, strict=True)
        if c.observer.lag_s < NEVER_S
    ]


@pytest.mark.slow
def test_an_observer_of_what_is_there_is_kept_and_of_noise_is_not(
    tmp_path: Path, memory: Memory
) -> None:
    fold = _fold(DRAGGED, QUICK, tmp_path, memory)
    (kept,), lesson, flown = chosen_observers([fold], fold.lesson, lambda _: None)
    assert "force x" in _used(lesson) == _used(kept.lesson)
    assert not [name for name in _used(lesson) if name.startswith("moment")]
    assert [f.law for f in flown] == [OBSERVER] * len(OUTPUTS)
    assert flown[0].ratio is not None and flown[0].ratio < 0.9


@pytest.mark.slow
def test_where_nothing_is_left_no_observer_is_kept(tmp_path: Path, memory: Memory) -> None:
    fold = _fold(COPTER, QUICK, tmp_path, memory)
    _, lesson, _ = chosen_observers([fold], fold.lesson, lambda _: None)
    assert _used(lesson) == []


@pytest.mark.slow
def test_the_envelope_holds_where_the_twin_goes_by_itself(tmp_path: Path, memory: Memory) -> None:
    """But not where a law has faded before."""
    fold = _fold(DRAGGED, NO_OBSERVER, tmp_path, memory)
    narrow = replace(fold.lesson.prepared.empty, reach=fold.lesson.prepared.empty.reach / 2.6)
    lesson = replace(fold.lesson, prepared=replace(fold.lesson.prepared, empty=narrow))
    wide = lesson.running([fold.replay], fold.memory)
    share = wide.prepared.empty.reach / narrow.reach
    assert 1.0 < share < WIDER
    starts = wide.starts(["none"] * len(OUTPUTS))
    away = fold.replay.through(wide.fmu, starts, (DISTANCE,)).watched[..., 0]
    near = np.array(AHEAD_S) <= ALONE_S
    assert np.mean(away[:, near] <= 1) >= 0.98
    tiny = replace(narrow, reach=narrow.reach / 10)
    capped = replace(lesson, prepared=replace(lesson.prepared, empty=tiny), place=tmp_path / "2")
    widest = capped.running([fold.replay], fold.memory).prepared.empty.reach
    assert widest == pytest.approx(WIDER * tiny.reach)


@pytest.mark.slow
def test_a_law_says_at_most_so_many_times_what_it_said_in_its_flights() -> None:
    drag_1_s = 0.6
    prepared = prepare([instants(fly(COPTER, DRAGGED, 1, "one", ROUND), COPTER)], COPTER)
    weights = np.zeros((len(OUTPUTS), len(FEATURES)))
    weights[0, FEATURES.index("air_x")] = -drag_1_s
    laws = [Candidate("linear", w * prepared.size, 1.0, NO_OBSERVER) for w in weights]
    law, _ = prepared.law(laws)
    (seen,) = prepared.flights
    speed = np.abs(inputs_of(seen)[:, FEATURES.index("air_x") - 1]).max()
    assert law.most[0] == pytest.approx(BEYOND * drag_1_s * speed, rel=0.05)  # low-passed
    assert not law.most[1:].any()


@pytest.mark.parametrize(
    ("law", "observer", "motion", "kept"),
    [(0.8, 1.0, 1.0, True), (0.95, 1.0, 1.0, False), (0.8, 1.0, 0.7, False)],
)
def test_a_law_has_to_beat_observer_and_last_motion(
    law: float, observer: float, motion: float, kept: bool
) -> None:
    """Errors of every cell: with the law, with the untrained observer, of the last motion."""
    cells = (len(AHEAD_S), 4, 3)
    flown = SimpleNamespace(off=np.full((2, *cells), motion))
    fold = SimpleNamespace(
        squares_of=lambda _: np.full(cells, law**2),
        squares=lambda *_: np.full(cells, observer**2),
        lesson=SimpleNamespace(place=Path("a"), fmu=Path("a"), starts=lambda _: {}),
        memory=SimpleNamespace(array=lambda _, make: make()),
        replay=SimpleNamespace(last_motion=lambda: flown),
    )
    choice = Choice(("linear", *["none"] * 5), ((),) * 6)
    found, acceptance = accepted(cast(list[Fold], [fold, fold]), choice)
    assert found.laws == (choice.laws if kept else Choice.nothing().laws)
    assert acceptance.over_observer == pytest.approx(law / observer)
    assert acceptance.over_last_motion == pytest.approx(law / motion)
    assert acceptance.withdrawn == (() if kept else ("force x linear",))
