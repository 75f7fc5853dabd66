"""Effects that hide each other: what leaves room for them, and that a search finds both."""

from dataclasses import replace

import numpy as np
import pytest
from search_rigs.hypotheses import against, nothing_of
from search_rigs.library import library

from twin.explain.explanation import explain
from twin.explain.inference import search
from twin.explain.inference.selection import name_effects
from twin.explain.inference.spectrum import Rows, Spectrum
from twin.explain.inference.valley import MORE, STARTS, hidden_starts, leaves_motion
from twin.logs import Flight
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import Waypoints, fly
from uavtwin.headline import headline

COPTER = load_vehicle("copter_default")
LEGS: Waypoints = (
    ("ground", 1.0, (0.0, 0.0, 0.0)),
    ("takeoff", 3.0, (0.0, 0.0, -3.0)),
    *(("tour", 2.5, p) for p in ((3, 0, -3), (3, 3, -3), (0, 3, -4), (0, 0, -3), (-3, 2, -3))),
    ("hover", 3.0, (-3.0, 2.0, -3.0)),
)
LOAD_KG, ROPE_M = 0.1 * COPTER.mass_kg, 0.9
HIDDEN = {
    "mass_offset": {"mass_kg": -LOAD_KG},
    "slung_load": {"mass_kg": LOAD_KG, "length_m": ROPE_M},
}
FEW = [*HIDDEN, "thrust_scale", "rotor_drag"]


def left(**power: float) -> Spectrum:
    """One flight with residuals of a mean square, by channel, in one band."""
    none, columns = np.zeros((4, 0)), np.zeros(0, dtype=np.intp)
    band = np.full(4, 2, dtype=np.intp)
    rows = [(Rows(band, np.full(4, np.sqrt(p)), columns, none),) for p in power.values()]
    return Spectrum(tuple(power), tuple(rows), np.zeros(0), np.zeros((1, 0)), columns)


def test_more_is_left_than_sensor_and_pose_do_of_each_other() -> None:
    """In mean square, by the square of the ratio of amplitudes; nobody knows without a pose."""
    more = left(acc_x=1.01 * MORE**2, pose_acc_x=1.0, acc_y=0.99 * MORE**2, pose_acc_y=1.0, acc_z=9)
    assert leaves_motion(more) == {"acc_x": True, "acc_y": False}


def test_constants_are_no_motion() -> None:
    trim = left(acc_x=100.0, pose_acc_x=1.0)
    for own in trim.rows:
        own[0].band[:] = 0
    assert leaves_motion(trim) == {"acc_x": False}


def hidden_load() -> Flight:
    """In hover neither shows: load and lack of mass weigh what the file says."""
    return fly(COPTER, COPTER.with_effects(HIDDEN), 1, "tour", LEGS)


@pytest.mark.slow
def test_places_are_compared_with_the_set_at_their_own_day_to_day_variation() -> None:
    """Whatever the set's own evidence is, at its own factor on it."""
    problem = against(hidden_load(), COPTER, *HIDDEN)
    state = nothing_of(problem)
    laplace = problem.linearised(state)
    starts = [on for on, _ in hidden_starts(problem, laplace, state)]
    assert starts == [tuple(sorted(HIDDEN))] * STARTS
    other = replace(state, best=replace(state.best, kappa=1 / 64, evidence=np.inf))
    assert [on for on, _ in hidden_starts(problem, laplace, other)] == starts


@pytest.mark.slow
def test_a_load_that_takes_back_a_lack_of_mass_is_found_with_it() -> None:
    with library(FEW):
        naming = name_effects([hidden_load()], COPTER)
    assert naming.verdict == "named"
    assert set(naming.named) == set(HIDDEN)
    values = naming.conditional.values
    assert values["slung_load.mass_kg"] == pytest.approx(LOAD_KG, rel=0.2)
    assert values["slung_load.length_m"] == pytest.approx(ROPE_M, rel=0.1)


@pytest.mark.slow
def test_what_moves_an_aircraft_is_not_called_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search that does not find it says that something is there."""
    monkeypatch.setattr(search, "hidden_starts", lambda *_: [])
    with library(FEW):
        found = explain([hidden_load()], [], COPTER, missions=(), suggest=False)
    assert found.verdict == "cannot_tell"
    assert found.naming is not None
    assert found.naming.unexplained == ("acc_x", "acc_y", "acc_z")
    (reason,) = found.reasons
    assert reason.startswith("the model leaves more in acc_x, acc_y and acc_z than")
    assert headline(found).text == f"No effect is detectable, but something is missing: {reason}."
