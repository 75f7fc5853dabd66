"""Four missions of the paper's figures 9 to 11, as systems correct them.

Takeoff and hover are of the real quadrotor, flight 3 of the paper's tables, which no training saw.
Real flights of forward and tour there are none: these are flown by a simulated aircraft with hidden
effects. One flight of each mission is its training, a second one of forward and tour the test:
where it learns of takeoff and hover alone, gyroscopes in motion are hundreds of spreads away from
all that was seen.
"""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from benchmarks.compensator.residuals import residuals
from benchmarks.compensator.simulated import Individual, produce
from learning.compute import one_thread
from learning.data.flights import DEFAULT_RATE_HZ, ResidualFlight, restart_before_s
from learning.data.scaling import in_spans
from learning.model.family import Model
from learning.preset import Protocol

from .trainings import MODALITIES, Run, fitted, rows_of, units

Array = NDArray[np.float64]
AIRCRAFT = Individual("worn", 0)
"""With rotor drag, a battery that sags and a crooked accelerometer, none in its vehicle file."""
MOTION = ("forward", "tour")
MISSIONS = ("hover", "takeoff", *MOTION)


@dataclass(frozen=True, slots=True)
class CorrectedMission:
    """A mission, and what systems said of it.

    Attributes:
        name: Of the mission.
        aircraft: `real` or `simulated`.
        t_s: Times, s, shape (n,).
        virtual: What the twin's sensors read, shape (n, 15).
        residual: Measured minus virtual, shape (n, 15).
        unit: Spread of the training residual, shape (15,).
        by_system: Correction of each system, shape (n, 15).
    """

    name: str
    aircraft: str
    t_s: Array
    virtual: Array
    residual: Array
    unit: Array
    by_system: Mapping[str, Array]

    def left(self) -> dict[str, Array]:
        """What each system leaves, in spreads of the training residual, shape (n, 15)."""
        return {n: (self.residual - said) / self.unit for n, said in self.by_system.items()}


def real_missions(
    flights: Sequence[ResidualFlight], by_system: Mapping[str, Array]
) -> dict[str, CorrectedMission]:
    """Hover and takeoff of the last flight, which the others taught.

    Args:
        flights: Of the paper's tables.
        by_system: What each system said of the last, shape (n, 15).
    """
    *trained, held = flights
    unit = units(MODALITIES[0], trained, flights)["standardised"]
    return {
        name: _part(name, "real", held, rows_of(held, name), unit, by_system) for name in MODALITIES
    }


def simulated_missions(out: Path, runs: Sequence[Run], jobs: int) -> dict[str, CorrectedMission]:
    """Forward and tour of the simulated aircraft.

    Args:
        out: Folder of its flights; what is there already is taken.
        runs: Systems of one role and horizon, as they are trained on the paper's tables.
        jobs: Processes that make residuals.
    """
    produce(out, [AIRCRAFT])
    ((role, horizon),) = {(run.role, run.horizon) for run in runs}
    before_s = restart_before_s(cast(Protocol, role), horizon, DEFAULT_RATE_HZ)
    every = [
        flight
        for use in ("train", "test")
        for flight in residuals(out, [AIRCRAFT], use, jobs, restart_s=before_s)[AIRCRAFT.name]
    ]
    trained = [f for f in every if f.name.endswith("_1")]
    tests = {k: next(f for f in every if f.name.endswith(f"{k}_2")) for k in MOTION}
    models = {run.name: _trained(run, trained, out) for run in runs}
    unit = np.nanstd(np.concatenate([f.residual[in_spans(f)] for f in trained]), axis=0)
    return {
        kind: _part(
            kind,
            "simulated",
            flight,
            in_spans(flight),
            unit,
            {name: model.run(flight).correction for name, model in models.items()},
        )
        for kind, flight in tests.items()
    }


@one_thread()
def _trained(run: Run, flights: Sequence[ResidualFlight], out: Path) -> Model:
    with tempfile.TemporaryDirectory(dir=out) as folder:
        return fitted(run, flights, Path(folder))


def _part(
    name: str,
    aircraft: str,
    flight: ResidualFlight,
    rows: NDArray[np.bool_],
    unit: Array,
    by_system: Mapping[str, Array],
) -> CorrectedMission:
    """The samples of a flight that are its mission, and are measured."""
    rows = rows & np.isfinite(flight.residual).all(axis=1)
    said = {n: values[rows] for n, values in by_system.items()}
    t_s = flight.t_s[rows] - flight.t_s[rows][0]
    return CorrectedMission(
        name, aircraft, t_s, flight.virtual[rows], flight.residual[rows], unit, said
    )
