"""Laws that have to fly before they are shipped, by exported FMUs in random air."""

from dataclasses import replace

import numpy as np
import pytest

from learning.force.equations import Equations
from learning.force.laws import Taught
from learning.force.model import Acceptance, ForceModel, TrainingFlight
from learning.force.windows import FlightWindows
from twin.errors import ModelError
from twin.explain.model.numbers import with_effects
from twin.flight.assembly import COMPONENTS
from twin.physics.residual_force import FEATURES, OUTPUTS, ForceLaw
from twin.residuals.aligned import components_of
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import fly
from uavtwin.exports.parts import LearnedForce
from uavtwin.force.closed_loop import (
    FLIGHTS,
    MissionPair,
    MissionTrack,
    fly_both,
    flyable,
    random_air,
)
from uavtwin.force.memory import Memory
from uavtwin.force.train import _claim

COPTER = load_vehicle("copter_default")
DRAG = ("force_x", "air_x", -0.3)
"""Of body drag, 1/s: harmless."""
TURNS = ("moment_y", "air_x", -300.0)
"""Angular acceleration per speed through the air, rad/(m s): turns the vehicle over."""


@pytest.fixture(scope="module")
def empty() -> ForceLaw:
    """A law that says nothing, whose envelope is that of one flight."""
    legs = (
        ("ground", 0.5, (0.0, 0.0, 0.0)),
        ("takeoff", 2.5, (0.0, 0.0, -2.0)),
        ("tour", 4.0, (4.0, 2.0, -2.0)),
    )
    equations = Equations(COPTER, components_of(COPTER, "command")[0])
    windows = FlightWindows.of(fly(COPTER, COPTER, 1, "one", legs), COPTER, equations)
    return Taught.by([windows], equations).empty


def _model(
    empty: ForceLaw, *weights: tuple[str, str, float], ridge: float | None = None
) -> ForceModel:
    """Linear laws of `(output, feature, weight)`, SI units."""
    linear = np.zeros_like(empty.linear)
    names = [f"{kind}_{a}" for kind, a in OUTPUTS]
    for output, feature, weight in weights:
        linear[names.index(output), FEATURES.index(feature)] = weight
    arrays = {**empty.arrays(), "linear": linear, "most": np.full(len(OUTPUTS), 1e3)}
    return ForceModel(
        law=ForceLaw.of(arrays),
        flights=(),
        vehicle=COPTER.name,
        vehicle_sha256="",
        seed=0,
        ridge=ridge,
    )


@pytest.mark.parametrize(
    ("outputs", "says"),
    [
        (("force_z",), "force_z"),
        (("force_x", "force_y", "force_z", "moment_y"), "force and moment_y"),
    ],
)
def test_the_claim_names_the_outputs_of_the_law(
    empty: ForceLaw, outputs: tuple[str, ...], says: str
) -> None:
    law = _model(empty, *((o, "air_x", 1.0) for o in outputs), ridge=0.1)
    flights = (TrainingFlight("1", ""), TrainingFlight("2", ""))
    model = replace(law, flights=flights, acceptance=Acceptance(0.5, 0.5, None))
    assert _claim(model).startswith(f"force: a law of {says}, ridge 0.1: on flights left out")


@pytest.mark.long
def test_what_loses_missions_is_withdrawn_and_what_does_not_stays(
    empty: ForceLaw, memory: Memory
) -> None:
    laws = [_model(empty, TURNS, ridge=0.1), _model(empty, DRAG, ridge=1.0)]
    found = flyable(laws, _model(empty), COPTER, memory, lambda _: None)
    assert found.ridge == 1.0
    check = found.closed_loop
    assert (check.unsteady, check.withdrawn) in ((1, 0), (0, 1)), "in still air, or in wind"
    assert (check.lost > 0) == (check.withdrawn > 0) and check.flights == FLIGHTS


def test_a_vehicle_that_no_controller_can_fly_gets_the_best_law_of_its_flights(
    empty: ForceLaw, memory: Memory
) -> None:
    """Its thrust hardly rises with the command, so that no controller can invert it: said so."""
    flat = with_effects(COPTER, ["thrust_curve"], {"thrust_curve.slope": -0.95})
    laws = [_model(empty, TURNS, ridge=0.1), _model(empty, DRAG, ridge=1.0)]
    found = flyable(laws, _model(empty), flat, memory, lambda _: None)
    assert found.law is laws[0].law and found.closed_loop.flights == 0
    flights = (TrainingFlight("1", ""), TrainingFlight("2", ""))
    told = replace(found, flights=flights, acceptance=Acceptance(0.5, 0.5, None))
    assert "no controller can be designed: copter_default: its thrust map" in _claim(told)


def test_what_is_no_matter_of_the_controller_is_not_taken_for_it(
    empty: ForceLaw, memory: Memory, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise ModelError("imu: broken")

    monkeypatch.setitem(COMPONENTS, "imu", broken)
    with pytest.raises(ModelError, match="imu: broken"):
        flyable([_model(empty, DRAG, ridge=1.0)], _model(empty), COPTER, memory, lambda _: None)


@pytest.mark.slow
def test_a_drag_is_felt_in_the_wind_and_not_without_the_law(empty: ForceLaw) -> None:
    """Both flights of a pair are in the same air: a law that says nothing changes no bit. Of a law
    that has faded nothing is felt: this wind is no faster than the flight that taught it."""
    air = random_air(1, 3, 0.2)
    (nothing,) = fly_both(COPTER, LearnedForce(_model(empty)), "hover", air)
    (drag,) = fly_both(COPTER, LearnedForce(_model(empty, DRAG)), "hover", air)
    assert nothing.learned == nothing.alone == drag.alone
    assert drag.learned != drag.alone and not drag.lost


def test_air_is_drawn_by_its_seed() -> None:
    assert random_air(3, 1) == random_air(4, 1)[:3] != random_air(3, 2)
    (still,) = random_air(1, 1, 0.0)
    assert still["environment.wind.x"] == still["environment.gust.enabled"] == 0.0


@pytest.mark.parametrize(
    ("learned", "alone", "lost"),
    [
        (12.0, 0.3, True),
        (12.0, 9.0, False),
        (25.0, 9.0, True),
        (80.0, 20.0, False),
        (9.0, 1, False),
    ],
)
def test_only_a_mission_that_is_flown_without_a_law_condemns_one(
    learned: float, alone: float, lost: bool
) -> None:
    """Twins that are all but lost without a law are so by chance."""
    pair = MissionPair(*(MissionTrack(m / 2, m, 1.0) for m in (learned, alone)))
    assert pair.lost == lost
