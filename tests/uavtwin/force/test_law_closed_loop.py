"""Laws that have to fly before they are shipped, by exported FMUs in random air."""

from collections.abc import Sequence

import numpy as np
import pytest

from learning.force.forecast import NO_OBSERVER
from learning.force.instants import instants
from learning.force.laws import prepare
from learning.force.model import ForceModel, LawScore, MissionCheck, Output
from twin.physics.residual_force import FEATURES, OUTPUTS, ForceLaw
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import fly
from uavtwin.exports.parts import LearnedForce
from uavtwin.force.closed_loop import FLIGHTS, fly_both, flyable, random_air
from uavtwin.force.memory import Memory

COPTER = load_vehicle("copter_default")
DRAG = ("force_x", "air_x", -0.3)
"""Of body drag, 1/s: harmless."""
TURNS = ("moment_y", "air_x", -30.0)
"""Angular acceleration per speed through the air, rad/(m s): turns the vehicle over."""


@pytest.fixture(scope="module")
def empty() -> ForceLaw:
    """A law that says nothing, whose envelope is that of one flight."""
    legs = (
        ("ground", 0.5, (0.0, 0.0, 0.0)),
        ("takeoff", 2.5, (0.0, 0.0, -2.0)),
        ("tour", 4.0, (4.0, 2.0, -2.0)),
    )
    return prepare([instants(fly(COPTER, COPTER, 1, "one", legs), COPTER)], COPTER).empty


def _model(empty: ForceLaw, *weights: tuple[str, str, float]) -> ForceModel:
    """Linear laws of `(output, feature, weight)`, SI units."""
    linear, laws = np.zeros_like(empty.linear), ["none"] * len(OUTPUTS)
    names = [f"{kind}_{a}" for kind, a in OUTPUTS]
    for output, feature, weight in weights:
        linear[names.index(output), FEATURES.index(feature)] = weight
        laws[names.index(output)] = "linear"
    arrays = {**empty.arrays(), "linear": linear, "most": np.full(len(OUTPUTS), 1e3)}
    return ForceModel(
        law=ForceLaw.of(arrays),
        rivals={},
        outputs=tuple(
            Output(law, NO_OBSERVER, (LawScore(law, 1.0, 0.8 + 0.01 * i, 1.0),))
            for i, law in enumerate(laws)
        ),
        closed_loop=MissionCheck.nothing(),
        taken=0.0,
        flights=(),
        vehicle=COPTER.name,
        vehicle_sha256="",
        seed=0,
    )


@pytest.mark.long
def test_what_loses_missions_is_withdrawn_and_what_does_not_stays(
    empty: ForceLaw, memory: Memory
) -> None:
    def model(laws: Sequence[str]) -> ForceModel:
        both = zip((laws[0], laws[4]), (DRAG, TURNS), strict=True)
        return _model(empty, *(weight for law, weight in both if law == "linear"))

    found = flyable(
        _model(empty, DRAG, TURNS),
        model,
        COPTER,
        memory,
        lambda _: None,
    )
    assert [o.law for o in found.outputs] == ["linear", *["none"] * 5]
    assert found.closed_loop.withdrawn == ("moment y linear",)
    assert 0 < found.closed_loop.lost <= found.closed_loop.flights == FLIGHTS


@pytest.mark.slow
def test_no_law_has_nothing_to_fly(empty: ForceLaw, memory: Memory) -> None:
    none = _model(empty)
    found = flyable(
        none,
        lambda _: none,
        COPTER,
        memory,
        lambda _: None,
    )
    assert found.closed_loop == MissionCheck.nothing()


@pytest.mark.slow
def test_a_drag_is_felt_in_the_wind_and_not_without_the_law(empty: ForceLaw) -> None:
    """Both flights of a pair are in the same air: a law that says nothing changes no bit."""
    air = random_air(1, 3)
    (nothing,) = fly_both(COPTER, LearnedForce(_model(empty)), "hover", air)
    (drag,) = fly_both(COPTER, LearnedForce(_model(empty, DRAG)), "hover", air)
    assert nothing.learned == nothing.alone == drag.alone
    assert drag.learned != drag.alone and not drag.lost


def test_air_is_drawn_by_its_seed() -> None:
    assert random_air(3, 1) == random_air(4, 1)[:3] != random_air(3, 2)
    (still,) = random_air(1, 1, 0.0)
    assert still["environment.wind.x"] == still["environment.gust.enabled"] == 0.0
