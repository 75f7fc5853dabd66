"""Laws through the rollout: the rows of the fit against exported FMUs, slopes against differences,
and the choice between laws."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cosim.whole_twin import fused_model
from fmus import build
from learning.data.envelope import BEYOND
from learning.force import windows
from learning.force.equations import Equations
from learning.force.laws import RIDGES, Taught
from learning.force.model import RidgeScore
from learning.force.rollout import fitted, rolled
from learning.force.windows import HORIZONS_S, FlightWindows, accelerometer_confirms, sizes
from twin.flight.assembly import driven_twin
from twin.logs import Flight
from twin.physics.residual_force import FEATURES, OUTPUTS
from twin.residuals.aligned import components_of
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import Waypoints, fly
from uavtwin.force.learn import (
    Fold,
    accepted,
    best,
    in_force,
    mean_squares,
    ranked,
    score,
)
from uavtwin.force.open_loop import HORIZONS_S as JUDGED_S
from uavtwin.force.open_loop import Replay

COPTER = load_vehicle("copter_default")
DRAG_1_S = 0.6
DRAGGED = replace(
    COPTER,
    drag_linear_n_s_m=COPTER.drag_linear_n_s_m
    + DRAG_1_S * COPTER.mass_kg * np.array([1.0, 1.0, 0.0]),
)
ROUND: Waypoints = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 2.5, (0.0, 0.0, -2.0)),
    ("tour", 3.5, (6.0, 3.0, -2.0)),
    ("tour", 3.5, (-3.0, -2.0, -2.5)),
)
BACK: Waypoints = (("tour", 3.5, (-4.0, 3.0, -2.0)), ("tour", 3.5, (3.0, 3.0, -1.5)))
AIR_X = FEATURES.index("air_x")
OFTEN_S = 0.25
"""Between two windows of the rollout, and two starts of the replay."""
SHORT = HORIZONS_S.index(0.5) + 1
"""Horizons after which no twin has tumbled."""


@pytest.fixture(scope="module")
def flight() -> Flight:
    """Of a vehicle with more drag than its file says."""
    return fly(COPTER, DRAGGED, 1, "one", ROUND)


@pytest.fixture(scope="module")
def taught(flight: Flight) -> Taught:
    """By that flight, in close windows."""
    equations = Equations(COPTER, components_of(COPTER, "command")[0])
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(windows, "EVERY_S", OFTEN_S)
        return Taught.by([FlightWindows.of(flight, COPTER, equations)], equations)


def test_a_law_of_the_moment_pushes_no_centre_of_mass() -> None:
    """Wherever that is: what the observer learns beside it is a moment alone, too."""
    offset = COPTER.with_effects({"cog_offset": {"x_m": 0.02, "y_m": -0.01, "z_m": 0.03}})
    units = Equations(offset, components_of(offset, "command")[0]).units
    both = np.zeros((6, 6))
    both[:3, :3], both[3:, 3:] = COPTER.mass_kg * np.eye(3), COPTER.inertia_kg_m2
    np.testing.assert_allclose(units, both, rtol=1e-9, atol=1e-12)


def _turns() -> np.ndarray:
    """A law that pushes and turns by what it sees."""
    weights = np.zeros((len(OUTPUTS), len(FEATURES)))
    weights[0, AIR_X], weights[2, FEATURES.index("thrust")] = -0.3, 0.5
    weights[4, AIR_X], weights[3, FEATURES.index("omega_x")] = 0.2, -0.5
    return weights


@pytest.mark.slow
@pytest.mark.parametrize("weights", [np.zeros((len(OUTPUTS), len(FEATURES))), _turns()])
def test_rows_are_flown_as_by_the_exported_fmu(
    flight: Flight, taught: Taught, weights: np.ndarray, tmp_path: Path
) -> None:
    """Observer and law included; the fit takes 10 ms a step, and commands as means over them.

    Up to half a second: from then on some have tumbled, which small differences decide.
    """
    law = replace(taught.of(weights), most=np.full(len(OUTPUTS), 1e3))
    parts = driven_twin(COPTER, "command", (), taught.empty)
    fmu = build(fused_model(parts, COPTER.name), tmp_path / "twin.fmu")
    exported = Replay(flight, COPTER, HORIZONS_S, OFTEN_S).through(fmu, in_force(law)).off
    (taught_by,) = taught.flights
    off, _ = rolled(taught.equations, taught_by, weights)
    assert off.reshape(exported.shape).shape == exported.shape
    off, exported = (v.reshape(exported.shape)[:, :SHORT] for v in (off, exported))
    away = np.sqrt(np.mean((off - exported) ** 2, axis=0))
    assert (away < 0.03 * np.sqrt(np.mean(exported**2, axis=(0, 3), keepdims=True))[0] + 1e-4).all()


@pytest.mark.slow
def test_slopes_are_differences(taught: Taught) -> None:
    (taught_by,) = taught.flights
    rng = np.random.default_rng(0)
    step = 1e-4 * rng.normal(size=(len(OUTPUTS), len(FEATURES)))

    def flown(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return rolled(taught.equations, taught_by, weights, True, HORIZONS_S[SHORT - 1])

    _, slopes = flown(_turns())
    more, less = (flown(_turns() + s * step)[0] for s in (1, -1))
    there = (more - less) / 2
    along = slopes @ step.ravel()
    assert np.sqrt(np.mean((along - there) ** 2)) < 0.05 * np.sqrt(np.mean(there**2))


@pytest.mark.slow
def test_the_accelerometer_tells_a_force_from_a_tilted_attitude(taught: Taught) -> None:
    """The drag that is missing, and 3 degrees that the attitude of a flight without it is off."""
    assert accelerometer_confirms(taught.flights)
    own = fly(COPTER, COPTER, 1, "own", ROUND)
    q, table = ["q_x", "q_y", "q_z", "q_w"], own.table.copy()
    known = table[q].notna().all(axis=1)
    tilted = Rotation.from_quat(table.loc[known, q]) * Rotation.from_euler("xy", [3, -3], True)
    table.loc[known, q] = tilted.as_quat()
    windows_of = FlightWindows.of(replace(own, table=table), COPTER, taught.equations)
    lacks = np.abs(windows_of.lacks[:, :2]).mean(axis=0)
    assert (lacks > 0.5 * COPTER.gravity_m_s2 * np.sin(np.radians(3))).all()
    assert not accelerometer_confirms([windows_of])
    assert not Taught.by([windows_of], taught.equations).path()[:, :2].any()


@pytest.mark.slow
def test_the_drag_that_is_missing_is_found_and_bounded(taught: Taught) -> None:
    """Over all features that move with the airspeed: which of them is told by no flight of 7 s."""
    other = fly(COPTER, DRAGGED, 2, "two", (*ROUND[:2], *BACK))
    flights = [*taught.flights, FlightWindows.of(other, COPTER, taught.equations)]
    weights = fitted(taught.equations, flights, sizes(flights), RIDGES[-1])
    said = flights[1].features @ weights.T
    along = flights[1].features[:, AIR_X]
    assert said[:, 0] @ along / (along @ along) == pytest.approx(-DRAG_1_S, rel=0.15)
    before, after = (
        np.mean(rolled(taught.equations, flights[1], w)[0] ** 2) for w in (0 * weights, weights)
    )
    assert after < 0.3 * before
    both = np.abs(np.vstack([f.features for f in flights]) @ weights.T).max(axis=0)
    law = Taught.by(flights, taught.equations).of(weights)
    np.testing.assert_allclose(law.most, BEYOND * both)


def test_the_strongest_ridge_that_is_as_good_is_taken() -> None:
    def taken(*scores: tuple[float, float, float]) -> float | None:
        found = best([RidgeScore("both", *s) for s in scores])
        return None if found is None else found[1]

    assert taken((1.0, 0.805, 1.0), (0.1, 0.8, 1.0)) == 1.0
    assert taken((1.0, 0.9, 1.0), (0.1, 0.8, 1.0)) == 0.1
    assert taken((1.0, 0.9, 1.1), (0.1, 0.995, 1.0)) is None
    scores = [RidgeScore("both", 1.0, 0.9, 1.0), RidgeScore("force", 0.1, 0.8, 1.0)]
    assert ranked([*scores, RidgeScore("both", 0.1, 0.7, 1.1)]) == [("force", 0.1), ("both", 1.0)]


def test_a_twin_that_has_tumbled_is_no_forecast() -> None:
    """No law is worse than that; but how far each is off there tells laws from each other."""
    without = np.full((2, len(JUDGED_S), 4), 0.1)
    without[:, -1] = 4.0
    squares = 0.25 * without
    flies = score(("both", 1.0), squares, without)
    squares[:, -1] = 400.0
    tumbles = score(("both", 1.0), squares, without)
    assert flies.worst == tumbles.worst == pytest.approx(0.5)
    assert flies.ratio == pytest.approx(0.5) and tumbles.ratio > 0.9
    assert score(("both", 1.0), 100.0 * without, 40.0 * without).worst == pytest.approx(2.5**0.5)


LAW = ("both", 1.0)


def _fold(law: float, observer: float, motion: float, fast: bool) -> Fold:
    """Errors of every cell: with the law, with the untrained observer, of the last motion."""
    cells = (len(JUDGED_S), 4, 3)
    flown = SimpleNamespace(off=np.full((2, *cells), motion))
    replay = SimpleNamespace(speed_m_s=1.0 if fast else 0.1, last_motion=lambda: flown)
    with_law = {None: np.full(cells, observer**2), LAW: np.full(cells, law**2)}
    fold = SimpleNamespace(squares=with_law.get, last_motion=None, replay=replay, fast=fast)
    fold.last_motion = Fold.last_motion.fget(fold)  # type: ignore[attr-defined]
    return cast(Fold, fold)


@pytest.mark.parametrize(
    ("law", "observer", "motion", "fast", "refused"),
    [
        (0.8, 1.0, 1.0, True, False),
        (0.95, 1.0, 1.0, True, True),
        (0.8, 1.0, 0.7, True, False),
        (0.8, 1.0, 0.7, False, False),
    ],
)
def test_a_law_has_to_beat_the_observer_and_is_held_against_the_last_motion(
    law: float, observer: float, motion: float, fast: bool, refused: bool
) -> None:
    folds = [_fold(law, observer, motion, fast)] * 2
    squares, without = mean_squares(folds, LAW), mean_squares(folds, None)
    found = accepted(folds, squares, without)
    assert found.over_observer == pytest.approx(law / observer)
    assert found.over_last_motion == pytest.approx(law / motion)
    assert found.fast == (pytest.approx(law / motion) if fast else None)
    assert found.refused == refused
    assert score(LAW, squares, without).ratio == pytest.approx(law / observer)
