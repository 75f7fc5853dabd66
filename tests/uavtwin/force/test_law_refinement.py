"""Weights refined by flying, against a drag that is known exactly."""

from contextlib import closing
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from learning.data.envelope import BEYOND
from learning.force.candidates import Candidate
from learning.force.forecast import AHEAD_S, NO_OBSERVER
from learning.force.instants import inputs_of, instants
from learning.force.train import Prepared, prepare
from twin.physics.residual_force import FEATURES, OUTPUTS
from twin.residuals.teacher_forced import choose_drive
from twin.vehicle.file import load_vehicle
from uavtwin.demo.flights import Waypoints, fly
from uavtwin.force.fold import Lesson
from uavtwin.force.memory import Memory
from uavtwin.force.open_loop import Replay
from uavtwin.force.refinement import MOST, REFINED, refined

COPTER = load_vehicle("copter_default")
DRAG_1_S = 0.6
ROUND: Waypoints = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 2.5, (0.0, 0.0, -2.0)),
    ("tour", 3.5, (4.0, 2.0, -2.0)),
    ("tour", 3.5, (-3.0, -2.0, -2.5)),
)


@pytest.fixture(scope="module")
def lesson(tmp_path_factory: pytest.TempPathFactory) -> tuple[Lesson, Replay]:
    """A flight of a vehicle with more drag than its file says."""
    more = DRAG_1_S * COPTER.mass_kg * np.array([1.0, 1.0, 0.0])
    plant = replace(COPTER, drag_linear_n_s_m=COPTER.drag_linear_n_s_m + more)
    flight = fly(COPTER, plant, 1, "one", ROUND)
    fmu = tmp_path_factory.mktemp("twin") / "twin.fmu"
    prepared = prepare([instants(flight, COPTER)], COPTER, 0)
    taught = Lesson(prepared, [], choose_drive(flight, COPTER), fmu)
    return taught, Replay(flight, COPTER, AHEAD_S)


def _laws(prepared: Prepared, weights: dict[tuple[str, str], float]) -> list[dict[str, Candidate]]:
    """Linear laws of these weights, `(output, feature) -> weight`, in SI units."""
    found = []
    for kind, a in OUTPUTS:
        own = np.zeros(len(prepared.size))
        for (output, feature), weight in weights.items():
            if output == f"{kind}_{a}":
                i = FEATURES.index(feature)
                own[i] = weight * prepared.size[i]
        found.append({"linear": Candidate("linear", 0.0, own, 1.0, NO_OBSERVER)})
    return found


def _refined(lesson: tuple[Lesson, Replay], weights: dict[tuple[str, str], float]) -> np.ndarray:
    """Weights after it, SI units, shape (6, features)."""
    taught, replay = lesson
    given = replace(taught, fitted=_laws(taught.prepared, weights))
    with TemporaryDirectory() as name, closing(Memory(Path(name, "steps.jsonl"), "")) as memory:
        better = refined(given, ["linear"] * len(OUTPUTS), [replay], memory)
    law = better.law([REFINED] * len(OUTPUTS))
    return np.asarray(law.linear)


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.7, 1.0, 1.5])
def test_a_weight_that_is_off_is_put_right(lesson: tuple[Lesson, Replay], share: float) -> None:
    given = {(f"force_{a}", f"air_{a}"): -DRAG_1_S * share for a in "xy"}
    found = _refined(lesson, given)
    for i, a in enumerate("xy"):
        assert found[i, FEATURES.index(f"air_{a}")] == pytest.approx(-DRAG_1_S, rel=0.05)


@pytest.mark.slow
def test_a_weight_is_at_most_so_many_times_what_the_instants_say(
    lesson: tuple[Lesson, Replay],
) -> None:
    far = DRAG_1_S / MOST / 2
    found = _refined(lesson, {("force_x", "air_x"): -far})
    assert -MOST * far <= found[0, FEATURES.index("air_x")] < -0.95 * MOST * far


@pytest.mark.slow
def test_what_is_not_there_goes(lesson: tuple[Lesson, Replay]) -> None:
    """A moment that turns with the thrust, beside the drag."""
    false = 2.0
    given = {("force_x", "air_x"): -DRAG_1_S, ("moment_y", "thrust"): false}
    found = _refined(lesson, given)
    assert abs(found[4, FEATURES.index("thrust")]) < 0.1 * false


def test_a_law_says_at_most_so_many_times_what_it_said_in_its_flights(
    lesson: tuple[Lesson, Replay],
) -> None:
    taught, _ = lesson
    laws = _laws(taught.prepared, {("force_x", "air_x"): -DRAG_1_S})
    law, _ = taught.prepared.law([every["linear"] for every in laws])
    (seen,) = taught.prepared.seen
    speed = np.abs(inputs_of(seen)[:, FEATURES.index("air_x") - 1]).max()
    assert law.most[0] == pytest.approx(BEYOND * DRAG_1_S * speed, rel=0.05)  # low-passed
    assert not law.most[1:].any()


def test_nothing_is_refined_where_no_law_is(lesson: tuple[Lesson, Replay]) -> None:
    assert not _refined(lesson, {}).any()
